"""The fingerprint: another vehicle is said to be one before it is judged, a damaged rotor is not."""

import dataclasses

import numpy as np
import pytest
from flying_telemetry import flying, flying_rows
from made_baselines import logged, whole
from made_telemetry import changed

from mavdiag.airframe.fingerprint import TRAITS, Fingerprint, Likeness, Outcome, compare, fingerprint_of, joined, traits
from mavdiag.airframe.layout import layout_named
from mavdiag.judging import Verdict, judge
from mavdiag.telemetry import Signal, Telemetry

X = layout_named("x")
CALM = changed(flying(3000, 7), Signal.SPECIFIC_FORCE, lambda force: 0.4 * force)
SHAKEN = 0.2 * np.random.default_rng(2).standard_normal((3000, 3))


def learnt() -> Fingerprint:
    found = fingerprint_of([flying_rows(flying(3000, seed)) for seed in range(100, 105)], X)
    assert found is not None
    return found


def compared(telemetry: Telemetry) -> Likeness:
    return compare(learnt(), flying_rows(telemetry), X)


@pytest.mark.parametrize(
    ("seed", "rotor", "rise"),
    [*((seed, 0, 0.0) for seed in range(7, 12)), (7, 1, 0.03), (7, 2, 0.2), (7, 3, 0.5), (7, 4, 0.2)],
)
def test_new_flights_of_the_same_vehicle_are_alike_and_a_rise_of_one_rotor_is_damage(
    seed: int, rotor: int, rise: float
) -> None:
    assert compared(flying(3000, seed, weak_rotor=rotor, rise=rise)).outcome is Outcome.ALIKE


def yawed(telemetry: Telemetry, share: float) -> Telemetry:
    """Outputs trimmed in yaw by a share of the hover command, which no single rotor does."""
    return changed(telemetry, Signal.ACTUATOR, lambda outputs: outputs + 0.5 * share * X.mixing[:, 2])


@pytest.mark.parametrize(
    ("flight", "outcome", "words"),
    [
        (yawed(flying(3000, 7), 0.12), Outcome.FAR, "does not look like E8: yaw trim +0.12"),
        (yawed(flying(3000, 7), 0.006), Outcome.NEAR, "may be another vehicle than E8, or have new propellers"),
        # nothing that breaks makes a sensor quieter; better balanced propellers do, by as much as 7
        (changed(flying(3000, 7), Signal.SPECIFIC_FORCE, lambda x: 0.15 * x), Outcome.NEAR, "accelerometer noise"),
        (changed(flying(3000, 7), Signal.SPECIFIC_FORCE, lambda x: 0.03 * x), Outcome.FAR, "noise z 0.03"),
        (changed(flying(3000, 7), Signal.BODY_RATE, lambda rate: rate + SHAKEN), Outcome.ALIKE, ""),
        (changed(flying(3000, 7), Signal.THRUST_SETPOINT, lambda x: 0.6 * x), Outcome.FAR, "hover throttle 0.6 times"),
        (changed(flying(3000, 7), Signal.THRUST_SETPOINT, lambda x: 1.6 * x), Outcome.NEAR, "hover throttle 1.6 times"),
    ],
)
def test_only_what_no_damage_does_is_another_vehicle(flight: Telemetry, outcome: Outcome, words: str) -> None:
    found = compared(flight)
    assert found.outcome is outcome
    assert words in found.sentence("E8")
    assert "the baseline's" in found.sentence("unnamed") or outcome is Outcome.ALIKE


def test_more_motors_are_another_vehicle() -> None:
    six = flying(3000, 7)
    outputs = six.need(Signal.ACTUATOR)
    wider = dataclasses.replace(outputs, values=np.concatenate((outputs.values, outputs.values[:, :2]), axis=1))
    found = compared(Telemetry(tuple(wider if one is outputs else one for one in six.series)))
    assert found.differing == ("6 motors (learnt 4)",)
    assert found.outcome is Outcome.FAR


@pytest.mark.parametrize(
    ("flight", "judged", "words"),
    [
        (yawed(flying(3000, 7), 0.12), False, "another vehicle: does not look like made: yaw trim +0.12"),
        (CALM, True, "; may be another vehicle than made, or have new"),
    ],
)
def test_another_vehicle_is_not_judged_and_a_near_one_has_a_note(flight: Telemetry, judged: bool, words: str) -> None:
    found = judge(logged(flight), whole())
    assert (found.verdict is not Verdict.NOT_JUDGEABLE) == (found.judged_s > 0) == judged
    assert words in found.reason
    damaged = judge(logged(flying(3000, 7, weak_rotor=3, rise=0.3)), whole())
    assert damaged.verdict is Verdict.FAULT
    assert "another vehicle" not in damaged.reason


def test_what_a_trait_varies_by_as_the_vehicle_flies_is_its_spread() -> None:
    """Half of the learnt flight shakes more: a flight that shakes as its calm half did is of the same vehicle."""
    learnt_flight, n = flying(4000, 7), 4000
    factor = np.where(np.arange(n) % 2000 < 1000, 1.0, 4.0)[:, None]
    mixed = changed(
        learnt_flight, Signal.SPECIFIC_FORCE, lambda force: force.mean(axis=0) + (force - force.mean(axis=0)) * factor
    )
    found, steady = fingerprint_of([flying_rows(mixed)], X), fingerprint_of([flying_rows(learnt_flight)], X)
    assert found is not None
    assert steady is not None
    spreads = [{one.name: one.spread for one in each.figures}["accelerometer noise x"] for each in (steady, found)]
    assert spreads[0] < 0.2
    assert spreads[1] > 0.5
    assert compare(found, flying_rows(CALM), X).outcome is Outcome.ALIKE


@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_a_noise_below_the_resolution_of_its_signal_is_the_resolution_s(noise: float) -> None:
    """A sensor that hardly moves its last digit: how often it does follows what is flown."""
    digit = 0.0098
    values = digit * np.round(np.random.default_rng(3).normal(0.0, noise, (3000, 3)))
    coarse = changed(flying(3000, 7), Signal.SPECIFIC_FORCE, lambda _: values)
    seen = dict(zip((one.name for one in TRAITS), traits(joined(flying_rows(coarse)), X), strict=True))
    expected = [np.log(digit * np.sqrt(0.5)) if np.isfinite(seen["accelerometer noise x"]) else np.nan] * 3
    np.testing.assert_allclose([seen[f"accelerometer noise {axis}"] for axis in "xyz"], expected, atol=0.2)
