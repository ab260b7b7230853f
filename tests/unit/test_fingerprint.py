"""The fingerprint: another vehicle is said to be one before it is judged, a damaged rotor is not."""

import dataclasses

import numpy as np
import pytest
from flying_telemetry import START_NS, flying, flying_front, flying_rows
from made_baselines import FRAME, NOW, healthy, logged, whole
from made_telemetry import cut

from mavdiag.airframe.fingerprint import Figure, Fingerprint, Likeness, Outcome, compare, fingerprint_of
from mavdiag.airframe.layout import layout_named
from mavdiag.airframe.traits import TRAITS, beginning, traits
from mavdiag.baseline import dump, parse
from mavdiag.errors import InputError
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, Signal, Telemetry

X = layout_named("x")


def altered(telemetry: Telemetry, signal: Signal, factor: float = 1.0, offset: FloatArray | float = 0.0) -> Telemetry:
    """The telemetry with one signal scaled and shifted."""
    return Telemetry(
        tuple(
            dataclasses.replace(one, values=factor * one.values + offset) if one.signal is signal else one
            for one in telemetry.series
        )
    )


def learnt() -> Fingerprint:
    found = fingerprint_of([flying_rows(flying(3000, seed)) for seed in range(100, 105)], X)
    assert found is not None
    return found


def compared(telemetry: Telemetry) -> Likeness:
    return compare(learnt(), flying_rows(telemetry), X)


def test_new_flights_of_the_same_vehicle_are_alike() -> None:
    for seed in range(7, 12):
        assert compared(flying(3000, seed)) == Likeness(Outcome.ALIKE)


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
@pytest.mark.parametrize("rise", [0.03, 0.2, 0.5])
def test_a_rise_of_one_rotor_is_damage_and_not_another_vehicle(rotor: int, rise: float) -> None:
    assert compared(flying(3000, 7, weak_rotor=rotor, rise=rise)).outcome is Outcome.ALIKE


def test_more_vibration_is_damage_and_not_another_vehicle() -> None:
    rng = np.random.default_rng(2)
    shaken = flying(3000, 7)
    gyro = shaken.need(Signal.BODY_RATE)
    shaken = altered(shaken, Signal.BODY_RATE, offset=0.2 * rng.standard_normal(gyro.values.shape))
    assert compared(shaken).outcome is Outcome.ALIKE


def yawed(telemetry: Telemetry, share: float) -> Telemetry:
    """Outputs trimmed in yaw by a share of the hover command, which no single rotor does."""
    return altered(telemetry, Signal.ACTUATOR, offset=0.5 * share * X.mixing[:, 2])


def test_a_trim_that_no_rotor_explains_is_another_vehicle() -> None:
    found = compared(yawed(flying(3000, 7), 0.12))
    assert found.outcome is Outcome.FAR
    assert found.sentence("E8").startswith("does not look like E8: yaw trim +0.12")
    assert "(learnt -0.000 +- 0.00" in found.sentence("E8") or "(learnt +0.000 +- 0.00" in found.sentence("E8")


def test_a_small_shift_of_the_yaw_trim_is_noted() -> None:
    found = compared(yawed(flying(3000, 7), 0.006))
    assert found.outcome is Outcome.NEAR
    assert found.sentence("E8").startswith(
        "may be another vehicle than E8, or have new propellers or another load: yaw"
    )


def test_quieter_sensors_are_another_vehicle() -> None:
    """Nothing that breaks makes a sensor quieter; better balanced propellers do, by as much as 7."""
    assert compared(altered(flying(3000, 7), Signal.SPECIFIC_FORCE, 0.15)).outcome is Outcome.NEAR
    found = compared(altered(flying(3000, 7), Signal.SPECIFIC_FORCE, 0.03))
    assert found.outcome is Outcome.FAR
    assert "accelerometer noise x x0.03" in found.sentence("E8")


def test_a_lower_hover_throttle_is_another_vehicle_and_a_higher_one_is_noted() -> None:
    assert compared(altered(flying(3000, 7), Signal.THRUST_SETPOINT, 0.6)).outcome is Outcome.FAR
    assert compared(altered(flying(3000, 7), Signal.THRUST_SETPOINT, 1.6)).outcome is Outcome.NEAR


def test_more_motors_are_another_vehicle() -> None:
    six = flying(3000, 7)
    outputs = six.need(Signal.ACTUATOR)
    wider = dataclasses.replace(outputs, values=np.concatenate((outputs.values, outputs.values[:, :2]), axis=1))
    found = compared(Telemetry(tuple(wider if one is outputs else one for one in six.series)))
    assert found.differing == ("6 motors (learnt 4)",)
    assert found.outcome is Outcome.FAR


def test_a_log_of_another_vehicle_is_not_judged_and_says_why() -> None:
    verdict = judge(logged(yawed(flying(3000, 7), 0.12)), whole())
    assert verdict.verdict is Verdict.NOT_JUDGEABLE
    assert verdict.reason.startswith("another vehicle: does not look like made: yaw trim +0.12")


def test_a_near_one_is_judged_with_a_note() -> None:
    verdict = judge(logged(altered(flying(3000, 7), Signal.SPECIFIC_FORCE, 0.4)), whole())
    assert verdict.verdict is not Verdict.NOT_JUDGEABLE
    assert verdict.judged_s > 0
    assert "; may be another vehicle than made, or have new propellers" in verdict.reason


def test_a_fault_is_judged_as_one() -> None:
    verdict = judge(logged(flying(3000, 7, weak_rotor=3, rise=0.3)), whole())
    assert verdict.verdict is Verdict.FAULT
    assert "vehicle" not in verdict.reason


def test_the_fingerprint_is_kept_in_the_baseline() -> None:
    baseline = learn(healthy(3), LearnOptions(airframe=FRAME, monitors=("rotor_trim",)), created=NOW)
    assert baseline.fingerprint is not None
    assert baseline.fingerprint.flights == 3
    assert parse(dump(baseline)).fingerprint == baseline.fingerprint


def test_a_baseline_without_a_fingerprint_judges_as_before() -> None:
    old = whole().model_copy(update={"fingerprint": None})
    assert judge(logged(flying(3000, 7)), old).verdict is Verdict.HEALTHY


def test_chunks_change_nothing() -> None:
    telemetry = flying(3000, 7, weak_rotor=1, rise=0.1)
    flight, front = flying_rows(telemetry), flying_front()
    state, pieces = front.start(), list[Rows]()
    for chunk in cut(telemetry, list(range(START_NS, START_NS + 30 * 10**9, 330_000_000))):
        state, parts = front.step(state, chunk)
        pieces += [one for one in parts if isinstance(one, Rows)]
    pieces += [one for one in front.finish(state)[1] if isinstance(one, Rows)]
    assert len(pieces) > 50
    assert traits(pieces, X) == pytest.approx(traits(flight, X), nan_ok=True)
    assert compare(learnt(), pieces, X) == compare(learnt(), flight, X)
    seconds = sum(int(rows.block.valid.sum()) for rows in beginning(pieces, 8.0)) * 0.01
    assert seconds == pytest.approx(8.0, abs=0.02)


def test_an_unknown_layout_leaves_the_other_traits() -> None:
    found = dict(zip((one.name for one in TRAITS), traits(flying_rows(flying(3000, 7)), None), strict=True))
    assert np.isnan(found["yaw trim"])
    assert np.isfinite(found["gyro noise p"])
    assert found["motors"] == 4


def test_nothing_speaks_against_an_empty_flight() -> None:
    assert compare(Fingerprint((Figure("yaw trim", 0.0, 0.01),), 1), [], X) == Likeness(Outcome.ALIKE)


def test_more_flights_make_a_narrower_spread_but_no_certainty() -> None:
    one = fingerprint_of([flying_rows(flying(3000, 100))], X)
    assert one is not None
    spread = {figure.name: figure.spread for figure in one.figures}
    assert spread["yaw trim"] == pytest.approx(0.002)
    many = {figure.name: figure.spread for figure in learnt().figures}
    assert 0 < many["yaw trim"] < spread["yaw trim"]


@pytest.mark.parametrize("figures", [(0.0, 0.0), (0.0, -1.0), (float("nan"), 1.0), (0.0, float("inf"))])
def test_a_figure_without_a_spread_is_refused(figures: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="fingerprint: trim_roll"):
        Figure("trim_roll", *figures)
