"""What kind of fault it is, whose evidence counts how much, and when a rotor is named: alone, and in the decision."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_statistics import decide, made_slot, statistic

from mavdiag.airframe.layout import Motor, layout_named
from mavdiag.decision.alarm import DecisionSpec, DecisionState
from mavdiag.decision.diagnosis import Change, Event, Stage
from mavdiag.decision.kinds import Reading, grown, isolate, named
from mavdiag.monitors import MONITORS
from mavdiag.monitors.base import FaultKind, RotorEvidence
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim, RotorTrimSpec
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

HOW = RotorEvidence(8.0)
FIRST, THIRD = (0.9, 0.0, 0.0, 0.0), (0.0, 0.0, 0.9, 0.0)
SPEC = DecisionSpec(
    (
        made_slot("unbalance", 1.0, evidence=HOW),
        made_slot("sensor_noise", 1.0, kind=FaultKind.SENSOR),
        made_slot("control_loss", 1.0, kind=FaultKind.LOSS_OF_CONTROL),
        made_slot("thrust_loss", 1.0, evidence=HOW, kind=FaultKind.GROSS_LOSS),
    )
)
PROPELLER, SENSOR, CONTROL, THRUST = (Reading(slot, 2.0) for slot in SPEC.slots)
PROPELLER, THRUST = replace(PROPELLER, rotors=FIRST), replace(THRUST, rotors=THIRD)
STEP_S = 0.02


@pytest.mark.parametrize(
    ("held", "readings", "kind"),
    [
        (None, [PROPELLER], FaultKind.PROPELLER),
        (None, [PROPELLER, SENSOR], FaultKind.SENSOR),
        (None, [SENSOR, CONTROL], FaultKind.LOSS_OF_CONTROL),
        (None, [THRUST, CONTROL, SENSOR, PROPELLER], FaultKind.GROSS_LOSS),
        (FaultKind.PROPELLER, [PROPELLER, CONTROL], FaultKind.LOSS_OF_CONTROL),
        (FaultKind.SENSOR, [PROPELLER], FaultKind.SENSOR),  # it never shrinks
        (FaultKind.GROSS_LOSS, [], FaultKind.GROSS_LOSS),
        (None, [PROPELLER, replace(SENSOR, ratio=0.9)], FaultKind.PROPELLER),  # below its threshold
        (None, [PROPELLER, replace(SENSOR, slot=replace(SENSOR.slot, decides=False))], FaultKind.PROPELLER),
    ],
)
def test_the_gravest_kind_holds(held: FaultKind | None, readings: list[Reading], kind: FaultKind) -> None:
    assert grown(held, readings, NS_PER_S) is kind


def test_a_propeller_fault_of_long_ago_becomes_no_sensor_fault_but_may_get_out_of_control() -> None:
    assert grown(FaultKind.PROPELLER, [PROPELLER, SENSOR], 10 * NS_PER_S) is FaultKind.SENSOR
    assert grown(FaultKind.PROPELLER, [PROPELLER, SENSOR], 11 * NS_PER_S) is FaultKind.PROPELLER
    assert grown(FaultKind.PROPELLER, [PROPELLER, SENSOR, CONTROL], 11 * NS_PER_S) is FaultKind.LOSS_OF_CONTROL


def test_a_rotor_is_named_only_while_that_is_certain() -> None:
    assert named(FaultKind.PROPELLER, [PROPELLER], False).rotor == 1
    assert named(FaultKind.PROPELLER, [PROPELLER, replace(SENSOR, ratio=0.84)], False).rotor == 1
    assert named(FaultKind.PROPELLER, [PROPELLER, replace(SENSOR, ratio=0.85)], False).rotor is None
    assert named(FaultKind.PROPELLER, [PROPELLER, replace(CONTROL, ratio=0.49)], False).rotor == 1
    assert named(FaultKind.PROPELLER, [PROPELLER, replace(CONTROL, ratio=0.5)], False).rotor is None
    for kind in (FaultKind.SENSOR, FaultKind.LOSS_OF_CONTROL):
        assert named(kind, [PROPELLER, THRUST], False).rotor is None
    assert [named(FaultKind.GROSS_LOSS, [PROPELLER, THRUST], has).rotor for has in (False, True)] == [3, None]


def level(*pieces: tuple[float, float]) -> FloatArray:
    """Pieces of (seconds, ratio)."""
    return np.concatenate([np.full(round(span / STEP_S), ratio) for span, ratio in pieces])


def values(x: FloatArray, *rotors: tuple[float, tuple[float, ...]]) -> Statistic:
    """With evidence for the rotors, in pieces of (seconds, evidence)."""
    found = statistic(x, first_s=0.0, dt_s=STEP_S, rotors=(0.0,) * 4 if rotors else ())
    at = 0
    for span, evidence in rotors:
        found.rotors[at : at + round(span / STEP_S)] = evidence
        at += round(span / STEP_S)
    return found


def decided(shaking: Statistic, *others: FloatArray) -> tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]:
    found = [shaking, *(values(x) for x in others)]
    found += [values(np.zeros(len(shaking)))] * (3 - len(others))
    return decide(SPEC, found)


def test_a_name_that_a_sensor_gave_is_withdrawn_from_the_fault_and_its_events() -> None:
    shaking = values(level((2, 0.3), (4, 3.0)), (6, FIRST))
    _, events, changes = decided(shaking, level((3, 0.1), (3, 2.0)))
    faults = [one for one in changes if one.stage is Stage.FAULT]
    assert [(one.kind, one.rotor) for one in faults] == [(FaultKind.PROPELLER, 1), (FaultKind.SENSOR, None)]
    assert (faults[1].monitor, faults[1].reason) == ("sensor_noise", "it is a sensor fault")
    assert [(one.monitor, one.kind, one.rotor) for one in events] == [
        ("unbalance", FaultKind.PROPELLER, 1),
        ("sensor_noise", FaultKind.SENSOR, None),
    ]


def test_in_an_upset_the_first_name_stays_and_the_kind_grows() -> None:
    """The last name overwrote the first: right at 0.7 s in 7 of 7, wrong at the end in 6 of 7."""
    shaking = values(level((2, 0.3), (4, 3.0)), (3, FIRST), (3, tuple(2.0 * x for x in THIRD)))
    state, _, changes = decided(shaking, level((6, 0.1)), level((2.9, 0.1), (3.1, 3.0)))
    assert [(one.kind, one.rotor) for one in changes if one.stage is Stage.FAULT] == [
        (FaultKind.PROPELLER, 1),
        (FaultKind.LOSS_OF_CONTROL, 1),
    ]
    assert (state.diagnosis.kind, state.diagnosis.rotor) == (FaultKind.LOSS_OF_CONTROL, 1)


def test_a_fault_without_a_name_waits_three_looks_where_sensors_are_checked() -> None:
    """The noise of a gyro was announced as a propeller fault before its own monitor had spoken."""
    unnamed = values(level((2, 0.3), (2, 3.0)), (4, (0.0,) * 4))
    _, _, changes = decided(unnamed, level((4, 0.1)))
    assert [(one.t_ns, one.kind) for one in changes[1:]] == [
        (2 * NS_PER_S, None),
        (round(2.3 * NS_PER_S), FaultKind.PROPELLER),
    ]
    _, _, noisy = decided(unnamed, level((2.15, 0.1), (1.85, 3.0)))
    assert [one.kind for one in noisy[1:]] == [None, FaultKind.SENSOR]


SHAKING = (0.05, 0.95, -0.45, -0.5)
DIRECT = [kind for kind in MONITORS if kind.evidence is not None]


def reading(how: RotorEvidence | None, ratio: float, threshold: float, rotors: tuple[float, ...]) -> Reading:
    return Reading(made_slot("any", threshold, evidence=how), ratio, rotors=rotors)


def of(kind: type[Unbalance | RotorSignature | RotorTrim], ratio: float, *rotors: float) -> Reading:
    return reading(kind.evidence, ratio, 0.5, rotors)


def test_two_that_contradict_each_other_name_none() -> None:
    how = RotorEvidence(8.0)
    found = isolate([reading(how, 2.0, 0.5, (0.9, 0, 0, 0)), reading(how, 2.0, 0.5, (0, 0.9, 0, 0))])
    assert found.rotor is None
    assert found.confidence == pytest.approx(0.5, abs=0.01)


def test_a_monitor_far_below_its_threshold_does_not_count() -> None:
    calm = of(RotorSignature, 0.5, 1.0, -1.0, -1.0, -1.0)
    assert isolate([calm]).confidence == 0.0
    assert isolate([calm, of(Unbalance, 1.2, *SHAKING)]).rotor == 2


def test_trim_does_not_count_while_the_damage_itself_is_observed() -> None:
    trim = of(RotorTrim, 3.0, 2.0, -1.0, -1.0, -1.0)
    assert isolate([trim]).rotor == 1
    assert isolate([trim, of(Unbalance, 0.9, *SHAKING)]).rotor != 2
    assert isolate([trim, of(Unbalance, 1.1, *SHAKING)]).rotor == 2


@given(
    st.lists(
        st.tuples(st.sampled_from(DIRECT), st.floats(0, 5), st.lists(st.floats(-1, 1), min_size=4, max_size=4)),
        max_size=4,
    )
)
def test_confidence_is_a_probability_and_a_name_needs_enough_of_it(
    readings: list[tuple[type[Unbalance], float, list[float]]],
) -> None:
    found = isolate([of(kind, ratio, *rotors) for kind, ratio, rotors in readings])
    assert found.confidence == 0.0 or 0.25 - 1e-12 <= found.confidence <= 1.0 + 1e-12
    assert (found.rotor is not None) == (found.confidence >= 0.9)


def test_16_monitors_of_different_layouts_do_not_end_the_session() -> None:
    """It raised a ValueError, which ended the daemon."""
    four = reading(RotorEvidence(8.0), 4.0, 0.5, (0.1, 0.9, -0.4, -0.5))
    three = reading(RotorEvidence(8.0), 4.0, 0.5, (0.9, 0.1, -0.4))
    assert isolate([three, four, three]).rotor == isolate([four]).rotor == 2


def test_rotors_of_an_arm_are_one_place() -> None:
    """Evidence that fits both rotors of an arm names the arm, where two rotors alike would name none."""
    how, both = RotorEvidence(8.0), (0.9, 0.1, 0.0, 0.9)
    apart = reading(how, 2.0, 0.5, both)
    arms = replace(how, arms=(Motor(1, 4), Motor(2, 3)))
    slot, trim = (
        made_slot("any", 0.5, evidence=arms),
        RotorTrimSpec(layout=layout_named("x"), source="actuator", spread=(1.0, 1.0, 1.0)),
    )
    together = Reading.of(replace(slot, monitor=RotorTrim(trim)), 2.0, 0.9, both)
    assert together.rotors == (0.9, 0.1)
    assert isolate([apart]).rotor is None
    named = isolate([together]).rotor
    assert (named, str(named), f"{named}") == (1, "1/4", "1/4")
    assert pickle.loads(pickle.dumps(named)).members == (1, 4)
