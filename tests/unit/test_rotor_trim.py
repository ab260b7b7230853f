"""The trim monitor: amplitude and rotor by least squares, what it must not react to, refusals."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from hypothesis import example, given
from hypothesis import strategies as st
from made_rows import calibrated, example_context, example_rows

from mavdiag.airframe.layout import LAYOUTS, Place, layout_at, layout_named
from mavdiag.airframe.trim import BESIDE, CURVE, TILT_TRIM, curve_of, rises, source_among, sources_of
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Flights
from mavdiag.monitors.rotor_trim import RotorTrim, RotorTrimSpec, best_rise, rise
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, Signal, Three
from mavdiag.units import G

CALM = (0.03, 0.03, 0.01)
WEIGHTS = (0.03, 0.02, 0.01)
frames = st.sampled_from(sorted(LAYOUTS))


def read(spec: RotorTrimSpec, rows: list[Rows]) -> Statistic:
    return next(RotorTrim(spec).over(rows))


def fit(flights: Flights, frame: str | None) -> RotorTrimSpec:
    return RotorTrim.fit(flights, example_context(frame))[0]


def spec_of(frame: str = "x") -> RotorTrimSpec:
    return RotorTrimSpec(layout=layout_named(frame), source="actuator", mean=(0.0, 0.0, 0.0), spread=CALM)


def fluttering(outputs: FloatArray) -> FloatArray:
    """6 s of outputs that hardly move: what stands still to the last bit is a link that repeats itself."""
    return outputs + np.where(np.arange(600) % 2, 1e-12, -1e-12)[:, None] * np.arange(len(outputs))


@given(frame=st.sampled_from(sorted(LAYOUTS)), which=st.integers(0, 7), rise=st.floats(0.02, 0.5))
def test_the_rise_and_its_rotor_come_out_exactly(frame: str, which: int, rise: float) -> None:
    n = layout_named(frame).rotors
    w, rotor = np.full(n, -rise / n), which % n
    w[rotor] += rise  # one rotor rises, the mean stays
    found = read(spec_of(frame), [example_rows(600, actuator=fluttering(0.5 * (1 + w)))])
    rise += curve_of(layout_named(frame)) * ((rise - rise / n) ** 2 - (rise / n) ** 2)  # by the thrust
    assert found.valid.tolist() == [False] * 9 + [True] * 3
    np.testing.assert_allclose(found.value[found.valid], rise, rtol=1e-8)
    assert int(found.rotors[-1].argmax()) == rotor
    np.testing.assert_array_equal(found.level, found.value)


@given(which=st.integers(0, 3), ratio=st.floats(3.0, 30.0))
def test_a_rotor_is_named_by_what_its_rise_leaves_not_by_its_size(which: int, ratio: float) -> None:
    places = [Place(0.1515, 0.245, "ccw"), Place(-0.1515, -0.1875, "ccw")]
    places += [Place(0.1515, -0.245, "cw"), Place(-0.1515, 0.1875, "cw")]
    spec = replace(spec_of(), layout=layout_at("PX4's Iris", places))
    w = np.full(4, -0.05)
    w[which] += 0.2
    rows = [example_rows(600, actuator=fluttering(0.5 * (1 + w)))]
    found = read(replace(spec, spread=(0.002 * ratio, 0.002 * ratio, 0.002)), rows)
    assert int(found.rotors[-1].argmax()) == which
    assert found.value[-1] == pytest.approx(0.2 + CURVE * (0.15**2 - 0.05**2))


def test_a_shifted_centre_of_mass_counts_little_and_a_rotor_in_the_centre_leaves_evidence_for_all() -> None:
    w = layout_named("x").mixing @ np.array([0.06, 0.04, 0.0])  # roll and pitch only
    assert read(spec_of(), [example_rows(600, actuator=fluttering(0.5 * (1 + w)))]).value[-1] < 0.1
    places = [Place(1, 1, "ccw"), Place(-1, -1, "ccw"), Place(1, -1, "cw"), Place(-1, 1, "cw"), Place(0, 0, "cw")]
    spec = replace(spec_of(), layout=layout_at("five", places))
    found = read(spec, [example_rows(600, actuator=fluttering(np.array([0.5, 0.5, 0.5, 0.5, 0.6])))])
    assert (np.isfinite(found.rotors[-1]).all(), int(found.rotors[-1].argmax())) == (True, 4)


def test_torque_commands_give_the_same_as_outputs() -> None:
    frame, gain = layout_named("crazyflie"), np.array([0.25, 0.25, 0.5]) * 65534 / 65535
    rng, n = np.random.default_rng(2), 800
    torque, thrust = rng.normal([0.02, -0.03, 0.1], 0.05, (n, 3)), rng.uniform(0.5, 0.6, n)
    outputs = thrust[:, None] + (torque * gain) @ frame.mixing.T
    spec = RotorTrimSpec(layout=layout_named("crazyflie"), source="torque", mean=(0.0, 0.0, 0.0), spread=CALM)
    by_torque = read(spec, [example_rows(n, torque=torque, thrust=thrust)])
    by_outputs = read(replace(spec, source="actuator"), [example_rows(n, actuator=outputs)])
    np.testing.assert_allclose(by_torque.rotors, by_outputs.rotors, atol=1e-12)


def test_it_finds_the_weak_rotor_that_healthy_flights_lack() -> None:
    flights = [flying_rows(flying(3000, seed)) for seed in range(3)]
    monitor, threshold = calibrated(RotorTrim, flights, example_context("x"))
    spec = monitor.spec
    assert spec.source == "actuator"
    assert spec.spread[0] >= 3 * spec.spread[2] >= 3 * 0.002
    for seed, rotor in ((11, 1), (12, 2), (13, 3), (14, 4)):
        found = read(spec, flying_rows(flying(2000, seed, weak_rotor=rotor, rise=0.15)))
        assert found.value[found.valid].min() > threshold.value, f"seed {seed}"
        assert (found.rotors[found.valid].argmax(axis=1) + 1 == rotor).all(), f"seed {seed}"
    calm = read(spec, flying_rows(flying(3000, 15)))
    assert calm.value[calm.valid].max() < threshold.value


def test_broken_outputs_are_not_judged_and_leave_no_trace() -> None:
    sound = np.random.default_rng(5).normal(0.5, 0.01, (2500, 4))
    damaged = sound.copy()
    damaged[700:710], damaged[1400], damaged[1401] = np.nan, np.inf, 0.0  # the last one: all motors off for a row
    clean, broken = (read(spec_of(), [example_rows(2500, actuator=x)]) for x in (sound, damaged))
    assert clean.valid[9:].all()  # ticks of half a second
    assert not broken.valid[14:24].any()
    assert not broken.valid[28:38].any()
    assert broken.valid[38:].all()
    # The first tick after a break has no part before it; from the second on nothing is left of the break.
    np.testing.assert_allclose(broken.value[38], clean.value[38], atol=1e-3)
    np.testing.assert_allclose(broken.value[39:], clean.value[39:], atol=1e-12)


def test_why_it_cannot_judge() -> None:
    outputs = np.random.default_rng(1).normal(0.5, 0.01, (1000, 4))
    with pytest.raises(InputError, match="layout"):
        fit([[example_rows(1000, actuator=outputs)]], None)
    for rows in (
        example_rows(1000),
        example_rows(1000, actuator=outputs[:, :3]),
        example_rows(1000, actuator=0 * outputs),
        example_rows(1000, actuator=0 * outputs + 1.0),  # all of them say 100 %, all flight
    ):
        with pytest.raises(InputError, match="outputs of 4 motors"):
            fit([[rows]], "x")
    by_torque = example_rows(1000, torque=0.1 * outputs[:, :3], thrust=np.full(1000, 0.5))
    with pytest.raises(InputError, match="mixing is known"):
        fit([[by_torque]], "x")
    assert RotorTrim(fit([[by_torque]], "crazyflie")).signals == {Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT}
    assert RotorTrim(fit([[example_rows(1000, actuator=outputs)]], "x")).signals == {Signal.ACTUATOR}
    with pytest.raises(IdentificationError, match="no unbroken 5 s"):
        fit([[example_rows(300, actuator=outputs[:300])]], "x")


def turning(seconds: float, seed: int, law: Three, nose: float = 1.0, waves: Sequence[float] = (0.6, 1.7)) -> Rows:
    """A vehicle whose nose turns to and fro, commanded by m + b3 dm/dt = b1 r + b2 dr/dt of hover."""
    rng, n = np.random.default_rng(seed), round(seconds / 0.01)
    t, w, (b1, b2, b3) = 0.01 * np.arange(n), np.array(waves), law
    turn = nose * np.exp(1j * (np.outer(t, w) + 1.0))  # the law is linear: each wave passes it alone
    rate = np.stack((0 * t, 0 * t, turn.imag.sum(axis=1)), axis=1) + rng.normal(0.0, 0.01, (n, 3))
    yaw = (turn * (b1 + 1j * w * b2) / (1 + 1j * w * b3)).imag.sum(axis=1)
    apart = np.outer(yaw, layout_named("x").mixing[:, 2])
    return example_rows(n, rate=rate, actuator=0.5 * (1 + apart) + rng.normal(0.0, 0.002, (n, 4)))


@pytest.mark.parametrize("law", [(0.1, 0.05, 0.0), (0.0, 0.03, 0.2), (-0.05, 0.08, 0.1), (0.0, 0.04, 0.17)])
def test_what_a_turn_takes_is_learnt_and_taken_off(law: Three) -> None:
    spec = fit([[turning(120, 1, law)]], "x")
    np.testing.assert_allclose(spec.turn, law, atol=0.02)
    round_a_square = [[turning(120, seed, law, nose, (0.0, 3.1))] for seed, nose in ((3, 0.0), (4, 1.0))]
    np.testing.assert_allclose(fit(round_a_square, "x").turn[:2], law[:2], atol=0.015)  # by the means
    assert spec.spread[2] < 0.003
    calm = read(spec, [turning(60, 2, law)])
    assert calm.value[calm.valid].max() < RotorTrim.prior.least
    straight = replace(spec, turn=(0.0, 0.0, 0.0))
    assert read(straight, [turning(60, 2, law)]).value.max() > 2 * calm.value[calm.valid].max()


def test_the_errors_of_the_law_are_those_of_its_fits() -> None:
    """P is the covariance over flights, and the ticks of a window count as one: P is no smaller."""
    law = (0.1, 0.05, 0.1)
    fits = [fit([[turning(60, seed, law, nose=0.05)]], "x") for seed in range(10)]
    off = np.array([spec.turn for spec in fits]) - law
    assert (np.square(off).mean(axis=0) < np.diag(fits[0].turn_covariance)).all()
    still = fit([[turning(60, 1, law, nose=0.001)]], "x")
    np.testing.assert_allclose(np.sqrt(np.diag(still.turn_covariance))[:2], (0.1, 0.04), rtol=0.15)
    assert still.turn == pytest.approx((0.0, 0.04, 0.0), abs=0.01)  # the prior: the noise looks like a turn
    told = RotorTrim(still).blindness(0.1)
    assert told.startswith(
        "blind to losses below 9 % of one rotor's thrust, and to the yaw pattern ++-- where the yaw rate is off"
    )
    assert float(told.removesuffix(" rad/s").split()[-1]) == pytest.approx(0.25, rel=0.1)


def test_sudden_turns_explain_themselves_whenever_a_tick_begins() -> None:
    """Steps of the yaw rate with 5 rad/s^2, as PX4 flies them: medians of half a second missed the peaks."""
    rng, n, law = np.random.default_rng(8), 12_000, (0.02, 0.05, 0.0)
    acceleration = np.zeros(n)
    for first in range(300, n - 700, 700):
        acceleration[first : first + 20], acceleration[first + 130 : first + 150] = 5.0, -5.0
    rate = np.column_stack((np.zeros((n, 2)), 0.01 * np.cumsum(acceleration)))
    yaw = law[0] * rate[:, 2] + law[1] * acceleration
    outputs = 0.5 * (1 + np.outer(yaw, layout_named("x").mixing[:, 2])) + rng.normal(0.0, 0.002, (n, 4))
    spec = fit([[example_rows(n, rate=rate, actuator=outputs)]], "x")
    np.testing.assert_allclose(spec.turn, law, atol=0.01)
    for first in range(0, 50, 7):
        late = example_rows(n - first, rate=rate[first:], actuator=outputs[first:])
        found = read(spec, [late])
        assert found.valid[9:].all()
        assert found.value[found.valid].max() < 0.5 * RotorTrim.prior.least


def in_wind(seed: int, law: tuple[float, float], felt: bool = True, size: float = 0.1) -> Rows:
    """A vehicle that air pulls at from changing sides, which takes k times the pull of roll and pitch trim."""
    rng, n = np.random.default_rng(seed), 6000
    pull = size * np.sin(np.outer(0.01 * np.arange(n), [0.4, 0.7]) + rng.uniform(0, 6, 2))
    trim = np.column_stack((pull * law, np.zeros(n)))
    outputs = 0.5 * (1 + trim @ layout_named("x").mixing.T) + rng.normal(0.0, 0.002, (n, 4))
    force = np.column_stack((G * pull[:, 1], -G * pull[:, 0], np.full(n, -G))) + rng.normal(0.0, 0.3, (n, 3))
    return example_rows(n, actuator=outputs, force=force if felt else None)


def test_what_the_air_pulls_is_learnt_by_the_accelerometer_and_taken_off() -> None:
    law = (0.5, -0.6)
    spec = fit([[in_wind(seed, law)] for seed in range(2)], "x")
    np.testing.assert_allclose(spec.pull, law, atol=3 * max(spec.pull_sd))
    assert RotorTrim(spec).signals == {Signal.ACTUATOR, Signal.SPECIFIC_FORCE}
    known, not_known = (read(one, [in_wind(5, law)]) for one in (spec, replace(spec, pull=(0.0, 0.0))))
    assert known.rotors[known.valid].max() < 0.2 * not_known.rotors[not_known.valid].max()
    assert min(fit([[in_wind(seed, law, size=0.003)] for seed in range(2)], "x").pull_sd) > 0.5 * TILT_TRIM  # calm
    blind = fit([[in_wind(1, law, felt=False)]], "x")
    assert (blind.felt, blind.pull, blind.pull_sd) == (False, (0.0, 0.0), (TILT_TRIM, TILT_TRIM))


def test_outputs_are_preferred_to_commands() -> None:
    rng, frame = np.random.default_rng(1), layout_named("crazyflie")
    outputs, torque, thrust = rng.normal(0.5, 0.01, (9, 4)), rng.normal(0.0, 0.01, (9, 3)), np.full(9, 0.5)
    both = example_rows(9, torque=torque, thrust=thrust, actuator=outputs)
    assert source_among([sources_of([both], frame)], frame) == "actuator"


@given(frame=frames, shift=st.lists(st.floats(-0.3, 0.3), min_size=7, max_size=7))
@example(frame="hexa-x", shift=[0.05, 0.04, 0.01, 0.0, 0.0, 0.0, 0.05])  # lifted by one rotor, nearly
def test_the_rises_are_least_squares_and_without_yaw_what_a_load_leaves(frame: str, shift: list[float]) -> None:
    layout, both, C = layout_named(frame), np.array([shift]), layout_named(frame).unmixing
    par = RotorTrim(RotorTrimSpec(layout=layout, source="actuator", spread=WEIGHTS)).begin(0.01).par
    wind, load = TILT_TRIM * math.hypot(*shift[3:5]), BESIDE * shift[6]
    spread = np.array([*(math.hypot(sd, wind, load) for sd in WEIGHTS[:2]), WEIGHTS[2]])
    found, explained = np.array([rise(par, j, both[0], *np.square(spread)) for j in range(layout.rotors)]).T
    np.testing.assert_allclose(found, rises(both[:, :3], layout, spread)[0], rtol=1e-9, atol=1e-12)
    for one, effect in zip(found, C.T, strict=True):  # min || diag(1/spread) (effect rise - shift) ||
        (expected,), *_ = np.linalg.lstsq((effect / spread)[:, None], both[0, :3] / spread, rcond=None)
        assert one == pytest.approx(expected, rel=1e-9, abs=1e-12)
    size, lift, (roll, pitch) = np.square(C[:2]).sum(axis=0), layout.rotors * max(shift[6], 1e-9), both[0, :2]
    told = np.minimum((roll * C[0] + pitch * C[1] - np.abs(pitch * C[0] - roll * C[1])) / size, lift)
    away = 3.0 * np.sqrt(np.square(spread[:2]) @ np.square(C[:2])) / size
    lifted = np.where(lift > away, np.maximum(told - away, 0.0) / np.abs(1.0 - away / lift), 0.0)
    assert best_rise(par, both[0]) == pytest.approx(max(found[explained.argmax()], lifted.max()), rel=1e-9)
