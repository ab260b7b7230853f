"""The rotor-speed monitor: which rotor turns off its command, with its own errors, and what it refuses."""

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from hypothesis import given, settings
from hypothesis import strategies as st
from made_rows import example_rows

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.errors import InputError
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.fitting import held_law
from mavdiag.monitors.rotor_speed import FLOOR, LAW, LAW_SD, MADE_UP_RAD_S, RotorSpeed, RotorSpeedSpec
from mavdiag.rows.block import in_rotor_order
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray

X = layout_named("x")
CONTEXT = LearnContext(Airframe(layout=X), None, 0.01, 11)


def rows_of(seed: int, ratio: FloatArray, n: int = 3000, slope: float = 0.85, wander: float = 0.02) -> list[Rows]:
    """A flight at 100 Hz whose rotors turn with these factors for their commands, which wander by so much."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.standard_normal((n, 4)), axis=0) / np.sqrt(n)
    outputs = 0.5 + wander * (walk - walk.mean(axis=0))
    noise = 1.0 + 1e-3 * rng.standard_normal((n, 4))
    return [example_rows(n, actuator=outputs, rotor_speed=1500.0 * outputs**slope * ratio * noise)]


def last(spec: RotorSpeedSpec, flight: list[Rows]) -> tuple[float, float, FloatArray]:
    """Value, level and evidence at the end of a flight."""
    found = list(RotorSpeed(spec).over(flight))[-1]
    assert found.valid[-1]
    return float(found.value[-1]), float(found.level[-1]), found.rotors[-1]


@pytest.fixture(scope="module")
def healthy() -> RotorSpeedSpec:
    own = np.array([1.0, 1.02, 0.99, 1.01])
    (spec,) = RotorSpeed.fit([rows_of(seed, own) for seed in range(100, 110)], CONTEXT)
    return spec


@settings(max_examples=20, deadline=None)
@given(rotor=st.integers(0, 3), share=st.floats(0.004, 0.05), faster=st.booleans(), seed=st.integers(10, 99))
def test_it_measures_the_share_that_one_rotor_is_off_and_names_it(
    healthy: RotorSpeedSpec, rotor: int, share: float, faster: bool, seed: int
) -> None:
    ratio = np.array([1.0, 1.02, 0.99, 1.01])
    ratio[rotor] *= 1 + share if faster else 1 - share
    value, level, rotors = last(healthy, rows_of(seed, ratio, 1500, wander=0.002))
    assert value == pytest.approx(share, abs=0.2 * share + 5e-4)  # its own errors make it careful
    assert (level > 0, int(rotors.argmax())) == (faster, rotor)
    assert np.sort(rotors)[-2] < 0.5 * value


def test_the_farther_commands_are_from_those_learnt_the_less_a_speed_says(healthy: RotorSpeedSpec) -> None:
    ratio = np.array([1.0, 1.02, 0.99, 1.05])
    values = [last(healthy, rows_of(7, ratio, 1500, wander=wander))[0] for wander in (0.002, 0.05, 0.2)]
    assert values == sorted(values, reverse=True)
    assert values[2] < 0.6 * values[0]
    flight = rows_of(7, np.array([1.0, 1.02, 0.99, 0.9]), 1500)
    flight[0].block.actuator[:, 3] *= 1.2
    flight[0].block.rotor_speed[:, 3] *= 1.2**0.85
    assert last(healthy, flight)[2].argmax() == 3  # it says less of how much, not of which rotor


def test_a_command_that_rises_and_falls_within_a_tick_says_less(healthy: RotorSpeedSpec) -> None:
    (rows,), t = rows_of(8, np.array([1.0, 1.02, 0.99, 1.01]), 1500, wander=0.0), 0.01 * np.arange(1500)
    rows.block.actuator[:, 0] *= 1.0 + 0.05 * np.sin(2 * np.pi * t) ** 2 * (t % 1.0 < 0.5)  # its rotor does not follow
    assert last(healthy, [rows])[0] < 0.002


def test_the_voltage_and_what_all_rotors_share_cancel(healthy: RotorSpeedSpec) -> None:
    own = np.array([1.0, 1.02, 0.99, 1.01])
    assert last(healthy, rows_of(5, 0.8 * own))[0] == pytest.approx(last(healthy, rows_of(5, own))[0], abs=1e-12)


def test_a_fit_that_is_extended_stands_where_one_to_all_flights_does() -> None:
    """And old flights reach no more by it than is said."""
    flights = [rows_of(seed, np.array([1.0, 1.02, 0.99, 1.01 + 0.01 * (seed > 2)])) for seed in range(5)]
    (old,), (whole,) = (RotorSpeed.fit(some, CONTEXT) for some in (flights[:3], flights))
    spec, more = RotorSpeed(old).extended(flights[3:], 3)
    assert (spec.law, spec.spread) == (old.law, old.spread)
    np.testing.assert_allclose((*spec.mean, *np.ravel(spec.about)), (*whole.mean, *np.ravel(whole.about)), atol=1e-12)
    before, after = (max(last(one, flight)[0] for flight in flights[:3]) for one in (old, spec))
    assert before < after <= before + more + 1e-5


def test_wild_frames_of_an_esc_do_not_count(healthy: RotorSpeedSpec) -> None:
    flight = rows_of(6, np.array([1.0, 1.02, 0.99, 1.01]))
    calm = last(healthy, flight)[0]
    flight[0].block.rotor_speed[-80:-70, 2] = 6863.0  # 65535 rpm for 0.1 s
    assert last(healthy, flight)[0] < calm + 5e-4


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_a_speed_that_is_none_is_not_judged(healthy: RotorSpeedSpec, bad: float) -> None:
    flight = rows_of(6, np.ones(4))
    flight[0].block.rotor_speed[1500, 1] = bad
    (found,) = RotorSpeed(healthy).over(flight)
    t_s = (found.t_ns - found.t_ns[0]) / 1e9
    assert not found.valid[(t_s > 14.6) & (t_s < 19.4)].any()
    assert np.isfinite(found.value[found.valid]).all()


def test_the_law_and_its_errors_are_those_of_least_squares() -> None:
    rng, prior = np.random.default_rng(3), (LAW, np.diag(LAW_SD**2))
    x = rng.normal(0, 0.1, (16_000, 2))
    y = x @ np.array([0.7, 0.01]) + rng.normal(0, 0.01, 16_000)
    law, errors = held_law(y, x, *prior, FLOOR, 1)
    np.testing.assert_allclose(law, [0.7, 0.01], atol=4 * np.sqrt(errors[0, 0]))
    assert errors[0, 0] == pytest.approx(0.01**2 / (16000 * 0.1**2), rel=0.05)
    still, unsure = held_law(np.zeros(40), np.zeros((40, 2)), *prior, FLOOR, 1, FLOOR)
    np.testing.assert_allclose(still, LAW)
    np.testing.assert_allclose(unsure, prior[1])
    halfway, errors = held_law(y, x, *prior, FLOOR, 1, 0.1 * LAW_SD[0])  # what goes with x is as large as the prior's
    assert halfway[0] == pytest.approx((0.7 + LAW[0]) / 2, abs=0.002)
    assert errors[0, 0] == pytest.approx(LAW_SD[0] ** 2 / 2, rel=0.01)


def test_speeds_that_are_made_up_of_the_outputs_are_refused() -> None:
    rows = rows_of(1, np.ones(4))[0]
    made = example_rows(3000, actuator=rows.block.actuator, rotor_speed=MADE_UP_RAD_S * rows.block.actuator)
    with pytest.raises(InputError, match="made up"):
        RotorSpeed.fit([[made]], CONTEXT)
    with pytest.raises(InputError, match="ESC telemetry"):
        RotorSpeed.fit([[example_rows(3000, actuator=rows.block.actuator)]], CONTEXT)


def test_speeds_go_to_the_rotors_whose_outputs_they_are_on() -> None:
    outputs, speeds = np.tile([0.1, 0.2, 0.3, 0.4], (2, 1)), np.tile([1.0, 2.0, 3.0], (2, 1))
    ordered = in_rotor_order(example_rows(2, actuator=outputs, rotor_speed=speeds).block, (3, 1, 2, 4))
    np.testing.assert_array_equal(ordered.rotor_speed[0], [3, 1, 2, np.nan])
    np.testing.assert_array_equal(ordered.actuator[0], [0.3, 0.1, 0.2, 0.4])


def test_a_flight_over_a_link_names_the_rotor() -> None:
    """Telemetry at 10 Hz through alignment and gate."""
    (spec,) = RotorSpeed.fit([flying_rows(flying(3000, seed)) for seed in (1, 2)], CONTEXT)
    value, level, rotors = last(spec, flying_rows(flying(3000, 3, fast_rotor=3, faster=-0.02)))
    assert value == pytest.approx(0.02, rel=0.2)
    assert level < 0
    assert int(rotors.argmax()) == 2


def test_a_rotor_that_lags_behind_turns_of_one_sense_is_silent_in_turns_of_the_other() -> None:
    """Commands that make a nose turn by steps; each rotor follows 0.05 s later. Learnt are turns to one side only."""

    def flight(seed: int, sense: float) -> list[Rows]:
        rng, n = np.random.default_rng(seed), 6000
        rate = np.where(np.arange(n) % 1000 < 300, sense, 0.0)
        yaw = 0.02 * rate + 0.1 * np.gradient(np.convolve(rate, np.ones(50) / 50, "same"))
        outputs = 0.5 * (1 + np.outer(yaw, X.mixing[:, 2])) + 0.002 * rng.standard_normal((n, 4))
        behind = np.concatenate((outputs[:5], outputs[:-5]))
        rates = np.column_stack((np.zeros((n, 2)), rate))
        return [example_rows(n, actuator=outputs, rotor_speed=1500.0 * behind**0.95, rate=rates)]

    (spec,) = RotorSpeed.fit([flight(seed, 1.0) for seed in range(3)], CONTEXT)
    assert max([found.value[found.valid].max() for found in RotorSpeed(spec).over(flight(9, -1.0))]) < 0.001


def test_a_law_from_short_pulses_holds_in_a_steady_trim_that_was_not_learnt() -> None:
    """Pulses of a second teach, each rotor 0.08 s behind them; wind leans the vehicle for a whole flight."""

    def flight(seed: int, trim: float) -> list[Rows]:
        rng, n = np.random.default_rng(seed), 6000
        pulses = np.convolve(rng.standard_normal(n) * (rng.random(n) < 0.01), np.hanning(100), "same")
        outputs = 0.4 * (1 + np.outer(0.05 * pulses + trim, X.mixing[:, 1]) + 0.002 * rng.standard_normal((n, 4)))
        return [example_rows(n, actuator=outputs, rotor_speed=1500.0 * np.concatenate((outputs[:8], outputs[:-8])))]

    (spec,) = RotorSpeed.fit([flight(seed, 0.0) for seed in range(3)], CONTEXT)
    assert abs(spec.law[0] - 1.0) < 2 * np.sqrt(spec.errors[0][0]) < 0.07
    assert spec.law[1] == pytest.approx(-0.08, abs=0.01)
    assert max([found.value[found.valid].max() for found in RotorSpeed(spec).over(flight(9, 0.1))]) < 0.0015


def test_days_tell_what_commands_make_of_speeds_and_a_turn_of_the_frame_is_taken_off() -> None:
    """Three hovers turn to one side, their centres of mass differ; ESCs tell the speed against the frame."""

    def flight(seed: int, trim: float, rate: float, ratio: float = 1.0) -> list[Rows]:
        outputs = 0.5 * (1 + trim * X.mixing[:, 0] + 0.002 * np.random.default_rng(seed).standard_normal((3000, 4)))
        told = 1500.0 * outputs * [ratio, 1.0, 1.0, 1.0] + 0.65 * rate * np.sign(X.unmixing[2])
        return [example_rows(3000, actuator=outputs, rotor_speed=told, rate=np.full((3000, 3), [0.0, 0.0, rate]))]

    (spec,) = RotorSpeed.fit([flight(seed, 0.01 * seed, 1.0) for seed in range(3)], CONTEXT)
    assert abs(spec.law[0] - 1.0) < 2 * np.sqrt(spec.errors[0][0]) < 0.1
    assert last(spec, flight(9, 0.0, -1.0))[0] < 5e-4  # 0.65/750 to each side
    assert last(spec, flight(9, 0.03, -1.0, 1.01))[0] == pytest.approx(0.01, rel=0.25)


def test_calm_flights_leave_open_what_a_large_command_makes_of_a_speed() -> None:
    """The less the commands of the teaching flights vary, the larger the error of the law, up to what is believed."""
    own = np.ones(4)
    unsure = [
        np.sqrt(RotorSpeed.fit([rows_of(seed, own, wander=wander) for seed in range(3)], CONTEXT)[0].errors[0][0])
        for wander in (0.0002, 0.002, 0.02)
    ]
    told = np.power(unsure, -2.0) - LAW_SD[0] ** -2.0  # beside the prior
    assert told[2] == pytest.approx(100 * told[1], rel=0.1)
    assert unsure[1] < unsure[0] == pytest.approx(LAW_SD[0], rel=0.1)
