"""From looks to a diagnosis: stages, kinds, rotors, types, what is latched, and what withdraws nothing."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_statistics import decide, made_slot, statistic
from scipy.stats import multivariate_normal

from mavdiag.airframe.layout import Motor, layout_named
from mavdiag.airframe.propellers import FaultType
from mavdiag.decision.alarm import LEFT_ALONE, NEXT, DecisionSpec, DecisionState
from mavdiag.decision.diagnosis import Change, Diagnosis, Event, Stage, graded
from mavdiag.decision.grading import Assessment, FaultTypes, Gathered, assess, known_fault_types
from mavdiag.decision.kinds import Reading, grown, isolate, named
from mavdiag.decision.words import fault_reason
from mavdiag.kernel import EVIDENCE, LAST_LEVEL, LOOK_NS, Alarm, Height, Looked
from mavdiag.monitors import MONITORS
from mavdiag.monitors.base import FaultKind, Feature, RotorEvidence
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim, RotorTrimSpec
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray
from mavdiag.units import NS_PER_S

HOW = RotorEvidence(8.0)
SHAKING = made_slot("unbalance", 0.5, evidence=HOW, feature=Feature.UNBALANCE)
MOVING = made_slot("rotor_signature", 4.0, evidence=HOW, feature=Feature.MOTION, delay_s=0.05)
THESIS = made_slot("fsd", 0.1, decides=False, axis=Axis.ROLL, delay_s=0.05, clear_s=0.0)
SPEC = DecisionSpec((SHAKING, MOVING, THESIS))
STEP_S = 0.02
TRIM = made_slot("trim_step", 0.01, evidence=RotorEvidence(10.0, relative=True, direct=False))
SHAKING_KINDS = (0.05, 0.95, -0.45, -0.5)
DIRECT = [kind for kind in MONITORS if kind.evidence is not None]
TRAINED = ("qdrone2", 1000.0)  # profile and rate of the links that the classifier was trained for
KNOWN = known_fault_types("qdrone2-emulated", *TRAINED)
LATE = max(KNOWN, key=lambda one: one.after_s)
Decided = tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]


def at(rotor: int | None) -> tuple[float, ...]:
    return tuple(0.9 * (i + 1 == rotor) for i in range(4))


def values(x: FloatArray, rotor: int | None = 1, first_s: float = 0.0, dt_s: float = STEP_S) -> Statistic:
    return statistic(x, first_s=first_s, dt_s=dt_s, rotors=at(rotor))


def profile(*pieces: tuple[float, float]) -> FloatArray:
    """Pieces of (seconds, level)."""
    return np.concatenate([np.full(round(span / STEP_S), level) for span, level in pieces])


NOTHING = values(np.empty(0))


def decided(shaking: Statistic, moving: Statistic = NOTHING, thesis: Statistic = NOTHING) -> Decided:
    return decide(SPEC, (shaking, moving, thesis))


def stages(changes: tuple[Change, ...]) -> list[Stage]:
    return [change.stage for change in changes]


def test_one_monitor_above_its_threshold_is_a_fault_and_names_the_rotor() -> None:
    _, events, changes = decided(values(profile((3, 0.3), (3, 2.1)), rotor=2), values(profile((6, 1.0)), None))
    assert stages(changes) == [Stage.QUIET, Stage.FAULT]
    fault = changes[1]
    assert (fault.monitor, fault.statistic, fault.threshold, fault.rotor) == ("unbalance", 2.1, 0.5, 2)
    assert fault.t_ns == 38 * LOOK_NS
    assert [(e.monitor, e.start_ns, e.end_ns, e.rotor) for e in events] == [("unbalance", 3 * NS_PER_S, None, 2)]
    _, _, changes = decided(NOTHING, values(profile((3, 1.0), (3, 6.0))))
    assert changes[1].t_ns == 39 * LOOK_NS  # when the value is known


def test_coming_near_is_suspected_with_its_rotor_and_goes_away_after_two_calm_seconds() -> None:
    _, events, changes = decided(values(profile((2, 0.3), (1, 0.42), (1, 0.3), (1, 0.36), (4, 0.3))))
    assert changes[2].t_ns == pytest.approx(7 * NS_PER_S, abs=2 * LOOK_NS)
    told = [(one.stage, one.rotor) for one in changes]
    assert (told, events) == ([(Stage.QUIET, None), (Stage.SUSPECTED, 1), (Stage.QUIET, None)], ())
    near = Diagnosis(Stage.SUSPECTED, "near", monitor="unbalance", statistic=0.42, threshold=0.5)
    assert str(near) == "suspected: near (unbalance 0.42 of 0.5)"


@pytest.mark.parametrize(("memory_s", "raised_s", "suspected"), [(1.3, 0.6, False), (1.3, 0.9, True), (3.0, 0.2, True)])
def test_a_suspicion_rests_on_two_seconds_of_flight(memory_s: float, raised_s: float, suspected: bool) -> None:
    spec = DecisionSpec((made_slot("innovation", 0.5, memory_s=memory_s),))
    _, _, changes = decide(spec, (statistic(profile((2, 0.3), (raised_s, 0.42), (1, 0.3))),))
    assert (Stage.SUSPECTED in stages(changes)) == suspected


def seen(changes: tuple[Change, ...]) -> list[bool]:
    return [change.seen for change in changes if change.stage is Stage.FAULT]


def test_a_fault_lasts_is_only_no_longer_seen_and_a_rotor_that_comes_back_goes_on() -> None:
    """H3: the end of a transient was the end of the fault: 12 of 12 lasting losses were called clear."""
    state, _, changes = decided(values(profile((2, 0.3), *[(1.5, 1.0), (1.5, 0.2)] * 3, (30, 0.2))))
    assert (stages(changes), seen(changes)) == ([Stage.QUIET, Stage.FAULT, Stage.FAULT], [True, False])
    assert (state.diagnosis.stage, state.diagnosis.rotor, state.diagnosis.declared_ns) == (Stage.FAULT, 1, 2 * NS_PER_S)
    (span,) = state.diagnosis.rotors
    assert (span.rotor, span.since_ns) == (1, 2 * NS_PER_S)
    assert span.end_ns == pytest.approx(9.5 * NS_PER_S, abs=0.11 * NS_PER_S)
    _, _, changes = decided(values(profile((2, 0.3), *[(3, 1.0), (5, 0.1)] * 3, (1, 1.0)), rotor=3))
    assert [(one.rotor, one.since_ns, one.end_ns) for one in changes[-1].rotors] == [(3, 2 * NS_PER_S, None)]


def test_3a_another_slot_that_is_calm_does_not_speak_for_the_one_that_was_over() -> None:
    """A fault of a monitor that left its envelope at 0.9 of its threshold was cleared by any other calm one."""
    shaking = values(profile((2, 0.3), (2, 1.0), (1, 0.45), (20, np.nan)))
    state, _, changes = decided(shaking, values(profile((25, 0.1))))
    assert (seen(changes), state.diagnosis.stage, state.diagnosis.seen) == ([True], Stage.FAULT, True)
    state, _, changes = decided(values(profile((2, 0.3), (2, 1.0), (5, 0.1), (20, np.nan))), values(profile((29, 0.1))))
    assert (state.diagnosis.stage, state.diagnosis.seen) == (Stage.FAULT, False)


def test_u2_every_rotor_is_named_with_its_span_and_its_own_figure() -> None:
    shaking = values(profile((2, 0.3), (10, 1.0), (10, 0.1), (10, 2.0), (10, 0.1), (5, 1.5), (5, 0.1)), first_s=0.32)
    shaking.rotors[int(21 / STEP_S) :] = at(4)
    shaking.rotors[int(41 / STEP_S) :] = at(1)
    state, events, changes = decided(shaking)
    rotors = [(one.rotor, round(one.since_ns / 1e9), round((one.end_ns or 0) / 1e9)) for one in changes[-1].rotors]
    assert (rotors, seen(changes)) == ([(1, 2, 12), (4, 22, 32), (1, 42, 47)], [True, False] * 3)
    named = [(one.rotor, one.statistic) for one in changes if one.stage is Stage.FAULT and one.seen]
    assert named == [(1, 1.0), (4, 2.0), (1, 1.5)]  # H12: the first motor had the figure of the second
    assert ([one.rotor for one in events], state.diagnosis.declared_ns) == ([1, 1, 4, 4, 1, 1], 2.32 * NS_PER_S)
    told = fault_reason(FaultKind.PROPELLER, changes, events)
    assert "; rotor 1 from 2.3 s, rotor 4 from 22.3 s, rotor 1 from 42.3 s" in told
    assert str(replace(events[0], statistic=0.5004)) == "unbalance 0.5004 > 0.5 from 2.32 s, rotor 1"


def test_a_name_that_was_wrong_at_first_is_replaced() -> None:
    shaking = values(profile((2, 0.3), (8, 1.0)), rotor=2)
    shaking.rotors[: int(3 / STEP_S)] = (0.2, 0.6, 0.0, 0.0)
    shaking.rotors[int(3 / STEP_S) :] = at(3)
    _, _, changes = decided(shaking)
    assert [one.rotor for one in changes if one.stage is Stage.FAULT] == [2, 3]
    assert [one.rotor for one in changes[-1].rotors] == [3]


@pytest.mark.parametrize(("named", "rotors"), [(1, [1]), (3, [1, 2])])
def test_h3_the_command_of_a_weak_rotor_that_falls_back_is_no_new_fault(named: int, rotors: list[int]) -> None:
    """A trim is compared with the minute before: the repair of rotor 1 looked like a rise of its neighbours.

    named: whose command falls at 20 s. It is the rotor that was weak, or another one: then rotor 2 rises.
    """
    trim = values(profile((5, 0.001), (8, 0.05), (7, 0.001), (8, 0.04)), rotor=1)
    trim.rotors[:] = 0.0
    trim.rotors[trim.value > 0.04] = (0.05, 0.01, -0.02, -0.02)
    fallen = np.full(4, -0.01)
    fallen[[1, named - 1]] = (0.04, -0.045)
    trim.rotors[int(20 / STEP_S) :] = fallen
    state, _, changes = decide(DecisionSpec((TRIM,)), (trim,))
    assert ([one.rotor for one in changes[-1].rotors], state.diagnosis.seen) == (rotors, named != 1)


def test_9a_an_alarm_that_does_not_overlap_a_fault_belongs_to_none() -> None:
    """A harmless alarm long after a fault carried its rotor and kind."""
    shaking = values(profile((2, 0.3), (3, 1.0), (40, 0.1)), rotor=2)
    _, events, _ = decided(shaking, NOTHING, values(profile((3, 0.0), (1, 0.5), (30, 0.0), (1, 0.5), (10, 0.0))))
    told = {(one.monitor, one.start_ns // NS_PER_S): one.rotor for one in events if one.end_ns is not None}
    assert told == {("unbalance", 2): 2, ("fsd", 3): 2, ("fsd", 34): None}


def test_b1_without_a_deciding_monitor_nothing_is_judged() -> None:
    """B1: what no monitor judged was called healthy."""
    hidden = values(np.full(500, np.nan))
    state, events, changes = decided(hidden, hidden, values(np.full(500, 0.01)))
    assert (state.diagnosis.stage, events, changes) == (Stage.NOT_JUDGED, (), ())


def test_11_a_gap_in_the_values_withdraws_no_fault() -> None:
    """A CRITICAL was withdrawn when the link was lost for a second, or the vehicle flew out of its envelope."""
    state, events, changes = decided(values(profile((2, 0.3), (1, 1.0), (6, np.nan), (1, 0.2))))
    assert (stages(changes), seen(changes)) == ([Stage.QUIET, Stage.FAULT], [True])
    assert (len({one.start_ns for one in events}), state.diagnosis.statistic) == (1, 1.0)


def test_the_rotor_may_be_named_later() -> None:
    moving = values(profile((2, 1.0), (4, 5.0)), None)
    moving.rotors[200:, 2] = 0.9
    _, _, changes = decided(NOTHING, moving)
    assert [(one.stage, one.rotor) for one in changes[1:]] == [(Stage.FAULT, None), (Stage.FAULT, 3)]
    assert changes[2].reason == "the rotor is named"
    assert changes[2].t_ns == pytest.approx(4.1 * NS_PER_S, abs=0.05 * NS_PER_S)


def test_a_slot_that_does_not_decide_raises_a_suspicion_at_most_and_only_above() -> None:
    calm = values(profile((8, 0.1)))
    _, events, changes = decided(calm, NOTHING, values(profile((2, 0.0), (2, 0.099), (4, 0.0))))
    assert (stages(changes), events) == ([Stage.QUIET], ())
    state, events, changes = decided(calm, NOTHING, values(profile((2, 0.0), (6, 50.0))))
    assert (stages(changes), state.diagnosis.stage) == ([Stage.QUIET, Stage.SUSPECTED], Stage.SUSPECTED)
    assert [(one.monitor, one.axis) for one in events] == [("fsd", Axis.ROLL)]


def test_b3_the_end_of_a_flight_closes_its_events_and_forgets_them() -> None:
    """B3: an open event lived through the landing."""
    state, opened, _ = decided(values(profile((2, 0.3), (2, 2.0)), rotor=4))
    assert [one.end_ns for one in opened] == [None]
    after, _, changes = SPEC.end_segment(state, Looked(), (), 4 * NS_PER_S, flies=True)  # the data broke off
    assert (after.diagnosis, after.episode, changes) == (state.diagnosis, state.episode, ())
    (broken,) = SPEC.end_segment(decided(values(profile((2, 0.3))))[0], Looked(), (), 4 * NS_PER_S, flies=True)[2]
    assert (broken.stage, broken.reason) == (Stage.NOT_JUDGED, "the data broke off")
    open_ = Alarm(0, 0, 2 * NS_PER_S, round(3.98 * NS_PER_S), 2.0, 2.0)
    state, closed, changes = SPEC.end_segment(state, Looked(), [open_], 4 * NS_PER_S)
    assert [(one.start_ns, one.end_ns, one.rotor) for one in closed] == [(2 * NS_PER_S, open_.end_ns, 4)]
    assert [(one.stage, one.rotor) for one in changes] == [(Stage.INSPECT, 4)]
    assert decide(SPEC, (values(profile((4, 0.3)), first_s=100.0), NOTHING, NOTHING), state)[1:] == ((), ())


def test_a_name_that_is_corrected_in_one_episode_stays_of_the_one_before() -> None:
    x = values(profile((2, 0.3), (10, 1.0), (10, 0.1), (10, 2.0)))
    x.rotors[round(24 / STEP_S) :] = 2 * np.array(at(3))
    spans = decided(x)[0].diagnosis.rotors
    assert [(one.rotor, one.since_ns / NS_PER_S) for one in spans] == [(1, 2.0), (3, 22.0)]
    assert spans[0].end_ns == pytest.approx(12 * NS_PER_S, abs=LOOK_NS)


def test_what_declares_a_fault_is_its_evidence_though_it_shows_another_rotor() -> None:
    trim, risen = replace(TRIM, threshold=0.1), values(profile((2, 0.01), (6, 0.12)))
    risen.rotors[:] = (0.12, 0.11, -0.1, -0.1)
    _, _, (_, fault) = decide(DecisionSpec((SHAKING, trim)), (values(profile((2, 0.3), (6, 0.48)), rotor=2), risen))
    assert (fault.rotor, fault.monitor, fault.statistic) == (2, "trim_step", 0.12)


def test_an_inspection_lasts_through_flights_until_it_is_acknowledged() -> None:
    state, _, _ = decided(values(profile((2, 0.3), (2, 2.0)), rotor=4))
    assert SPEC.acknowledge(state, 4 * NS_PER_S) == (state, (), ())  # not in flight
    state, _, _ = SPEC.end_segment(state, Looked(), (), 4 * NS_PER_S)
    calm, bad = (values(profile((4, level)), rotor=2, first_s=100.0) for level in (0.3, 2.0))
    flown, _, _ = decide(SPEC, (calm, NOTHING, NOTHING), state)
    landed, _, changes = SPEC.end_segment(flown, Looked(), (), 104 * NS_PER_S)
    assert (landed.diagnosis, changes) == (state.diagnosis, ())
    _, _, (fault,) = decide(SPEC, (bad, NOTHING, NOTHING), state)
    assert (fault.stage, fault.rotor, [span.rotor for span in fault.rotors]) == (Stage.FAULT, 2, [4, 2])
    closed, _, changes = SPEC.acknowledge(landed, 105 * NS_PER_S)
    assert (stages(changes), closed.diagnosis.rotors) == ([Stage.NOT_JUDGED], ())
    _, _, changes = decide(SPEC, (calm, NOTHING, NOTHING), DecisionState(state.diagnosis))
    assert changes == ()  # after a restart as well


def test_type_and_severity_are_named_when_known_and_not_without_a_classifier() -> None:
    known = known_fault_types("qdrone2-emulated", "qdrone2", 1000.0)
    cloud = next(c for c in known[0].clouds if (c.fault_type, c.severity, c.strength) == ("F2", 2, 1.0))
    u, a = np.exp(cloud.mean[:2])
    shaking = values(profile((2, 0.1), (12, max(u, 0.6))), rotor=2)
    moving = statistic(profile((2, 1.0), (12, 5.0)), rotors=at(2))
    moving.level[:] = a
    for types in ((), known):
        _, _, changes = decide(DecisionSpec((SHAKING, MOVING), types), (shaking, moving))
        named = [one for one in changes if one.fault_type is not None]
        assert bool(named) == bool(types)
    assert named[0].reason == "the kind of fault is named"
    late = statistic(profile((3.6, 5.0)), rotors=at(2), first_s=10.4)  # nothing was judged when it was to be named
    late.level[:] = a
    assert decide(DecisionSpec((SHAKING, MOVING), known), (shaking, late))[0].diagnosis.fault_type == "F2"
    withdrawn, over = replace(named[-1], fault_type=None), replace(named[-1], seen=False)
    assert (graded((*changes, withdrawn)), graded((*changes, over, withdrawn))) == (None, over)


def test_the_table_has_one_way_into_a_fault_and_no_height_ends_it() -> None:
    for (came, height), (stage, _) in NEXT.items():
        assert stage is not came
        assert (stage is Stage.FAULT, stage is Stage.NOT_JUDGED) == (height is Height.OVER, height is Height.UNKNOWN)
        assert came is not Stage.FAULT
        assert came is not Stage.INSPECT or stage is Stage.FAULT
    assert {came for came, height in NEXT if height is Height.OVER} == set(Stage) - {Stage.FAULT}
    assert all((stage, height) not in NEXT for stage, heights in LEFT_ALONE.items() for height in heights)


FIRST, THIRD = (0.9, 0.0, 0.0, 0.0), (0.0, 0.0, 0.9, 0.0)
SPEC_KINDS = DecisionSpec(
    (
        made_slot("unbalance", 1.0, evidence=HOW),
        made_slot("sensor_noise", 1.0, kind=FaultKind.SENSOR),
        made_slot("control_loss", 1.0, kind=FaultKind.LOSS_OF_CONTROL),
        made_slot("thrust_loss", 1.0, evidence=HOW, kind=FaultKind.GROSS_LOSS),
    )
)
PROPELLER, SENSOR, CONTROL, THRUST = (Reading(slot, 2.0) for slot in SPEC_KINDS.slots)
PROPELLER, THRUST = PROPELLER._replace(rotors=FIRST), THRUST._replace(rotors=THIRD)


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
        (None, [PROPELLER, SENSOR._replace(ratio=0.9)], FaultKind.PROPELLER),  # below its threshold
        (None, [PROPELLER, SENSOR._replace(slot=replace(SENSOR.slot, decides=False))], FaultKind.PROPELLER),
    ],
)
def test_the_gravest_kind_holds(held: FaultKind | None, readings: list[Reading], kind: FaultKind) -> None:
    """But a propeller fault of long ago becomes no sensor fault; it may get out of control."""
    assert grown(held, readings, NS_PER_S) is kind
    assert grown(FaultKind.PROPELLER, [PROPELLER, SENSOR], 10 * NS_PER_S) is FaultKind.SENSOR
    assert grown(FaultKind.PROPELLER, [PROPELLER, SENSOR], 11 * NS_PER_S) is FaultKind.PROPELLER
    assert grown(FaultKind.PROPELLER, [PROPELLER, SENSOR, CONTROL], 11 * NS_PER_S) is FaultKind.LOSS_OF_CONTROL


def test_a_rotor_is_named_only_while_that_is_certain() -> None:
    assert named(FaultKind.PROPELLER, [PROPELLER], False).rotor == 1
    assert named(FaultKind.PROPELLER, [PROPELLER, SENSOR._replace(ratio=0.84)], False).rotor == 1
    assert named(FaultKind.PROPELLER, [PROPELLER, SENSOR._replace(ratio=0.85)], False).rotor is None
    assert named(FaultKind.PROPELLER, [PROPELLER, CONTROL._replace(ratio=0.49)], False).rotor == 1
    assert named(FaultKind.PROPELLER, [PROPELLER, CONTROL._replace(ratio=0.5)], False).rotor is None
    for kind in (FaultKind.SENSOR, FaultKind.LOSS_OF_CONTROL):
        assert named(kind, [PROPELLER, THRUST], False).rotor is None
    assert [named(FaultKind.GROSS_LOSS, [PROPELLER, THRUST], has).rotor for has in (False, True)] == [3, None]


def values_kinds(x: FloatArray, *rotors: tuple[float, tuple[float, ...]]) -> Statistic:
    """With evidence for the rotors, in pieces of (seconds, evidence)."""
    found, at = statistic(x, first_s=0.0, dt_s=STEP_S, rotors=(0.0,) * 4 if rotors else ()), 0
    for span, evidence in rotors:
        found.rotors[at : at + round(span / STEP_S)] = evidence
        at += round(span / STEP_S)
    return found


def decided_kinds(shaking: Statistic, *others: FloatArray) -> Decided:
    found = [shaking, *(values_kinds(x) for x in others)]
    found += [values_kinds(np.zeros(len(shaking)))] * (3 - len(others))
    return decide(SPEC_KINDS, found)


def test_a_name_that_a_sensor_gave_is_withdrawn_from_the_fault_and_its_events() -> None:
    shaking = values_kinds(profile((2, 0.3), (4, 3.0)), (6, FIRST))
    _, events, changes = decided_kinds(shaking, profile((3, 0.1), (3, 2.0)))
    faults = [one for one in changes if one.stage is Stage.FAULT]
    assert [(one.kind, one.rotor) for one in faults] == [(FaultKind.PROPELLER, 1), (FaultKind.SENSOR, None)]
    assert (faults[1].monitor, faults[1].reason) == ("sensor_noise", "it is a sensor fault")
    told = [(one.monitor, one.kind, one.rotor) for one in events]
    assert told == [("unbalance", FaultKind.PROPELLER, 1), ("sensor_noise", FaultKind.SENSOR, None)]


def test_in_an_upset_the_first_name_stays_and_the_kind_grows() -> None:
    """The last name overwrote the first: right at 0.7 s in 7 of 7, wrong at the end in 6 of 7."""
    shaking = values_kinds(profile((2, 0.3), (4, 3.0)), (3, FIRST), (3, tuple(2.0 * x for x in THIRD)))
    state, _, changes = decided_kinds(shaking, profile((6, 0.1)), profile((2.9, 0.1), (3.1, 3.0)))
    faults = [(one.kind, one.rotor) for one in changes if one.stage is Stage.FAULT]
    assert faults == [(FaultKind.PROPELLER, 1), (state.diagnosis.kind, state.diagnosis.rotor)]
    assert (state.diagnosis.kind, state.diagnosis.rotor) == (FaultKind.LOSS_OF_CONTROL, 1)


def test_a_fault_without_a_name_waits_0_3_s_where_sensors_are_checked() -> None:
    """The noise of a gyro was announced as a propeller fault before its own monitor had spoken."""
    unnamed = values_kinds(profile((2, 0.3), (2, 3.0)), (4, (0.0,) * 4))
    _, _, changes = decided_kinds(unnamed, profile((4, 0.1)))
    assert [(one.t_ns, one.kind) for one in changes[1:]] == [(2 * NS_PER_S, None), (29 * LOOK_NS, FaultKind.PROPELLER)]
    _, _, noisy = decided_kinds(unnamed, profile((2.15, 0.1), (1.85, 3.0)))
    assert [one.kind for one in noisy[1:]] == [None, FaultKind.SENSOR]


def reading(how: RotorEvidence | None, ratio: float, threshold: float, rotors: tuple[float, ...]) -> Reading:
    return Reading(made_slot("any", threshold, evidence=how), ratio, rotors=rotors)


def of(kind: type[Unbalance | RotorSignature | RotorTrim], ratio: float, *rotors: float) -> Reading:
    return reading(kind.evidence, ratio, 0.5, rotors)


def test_what_contradicts_is_far_below_its_threshold_or_follows_from_the_damage_names_no_rotor() -> None:
    found = isolate([reading(HOW, 2.0, 0.5, (0.9, 0, 0, 0)), reading(HOW, 2.0, 0.5, (0, 0.9, 0, 0))])
    assert found.rotor is None
    assert found.confidence == pytest.approx(0.5, abs=0.01)
    calm = of(RotorSignature, 0.5, 1.0, -1.0, -1.0, -1.0)
    assert (isolate([calm]).confidence, isolate([calm, of(Unbalance, 1.2, *SHAKING_KINDS)]).rotor) == (0.0, 2)
    trim = of(RotorTrim, 3.0, 2.0, -1.0, -1.0, -1.0)
    step = reading(TRIM.evidence, 2.9, 0.5, (-1.0, 3.0, -1.0, -1.0))  # it reads the same outputs
    assert isolate([trim, step]).rotor == isolate([trim]).rotor == 1
    assert isolate([trim, step._replace(ratio=3.1)]).rotor == 2
    assert isolate([trim, of(Unbalance, 0.9, *SHAKING_KINDS)]).rotor != 2
    assert isolate([trim, of(Unbalance, 1.1, *SHAKING_KINDS)]).rotor == 2


@given(
    st.lists(
        st.tuples(st.sampled_from(DIRECT), st.floats(0, 5), st.lists(st.floats(-1, 1), min_size=4, max_size=4)),
        max_size=4,
    )
)
def test_confidence_is_a_probability_for_a_name(readings: list[tuple[type[Unbalance], float, list[float]]]) -> None:
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
    apart, arms = reading(how, 2.0, 0.5, both), replace(how, arms=(Motor(1, 4), Motor(2, 3)))
    trim = RotorTrim(RotorTrimSpec(layout=layout_named("x"), source="actuator", spread=(1.0, 1.0, 1.0)))
    together = Reading.of(replace(made_slot("any", 0.5, evidence=arms), monitor=trim), (2.0, 0.9, 0.0, *both))
    assert together.rotors == (0.9, 0.1)
    assert isolate([apart]).rotor is None
    named = isolate([together]).rotor
    assert (named, str(named), f"{named}", pickle.loads(pickle.dumps(named)).members) == (1, "1/4", "1/4", (1, 4))


def centre(code: str, strength: float = 1.0) -> FloatArray:
    wanted = (FaultType(code[:2]), int(code[-1]), strength)
    return next(c.mean for c in LATE.clouds if (c.fault_type, c.severity, c.strength) == wanted)


def look(level: float, rotors: tuple[float, ...] = (), count: int = 10) -> FloatArray:
    """What a look found of a feature, the same in every value."""
    return np.array([1.0, level, count, count * level**2, level, *rotors, *[count * one for one in rotors]])


@pytest.mark.parametrize("link", [("qdrone2", 100.0), ("qdrone2", 500.0), ("ardupilot", 1000.0), ("spec", 1000.0)])
def test_u3_no_fault_type_is_known_without_a_classifier_or_on_other_links(link: tuple[str, float]) -> None:
    """B17: types of one emulated vehicle were reported for any. U3: at 100 Hz four of five names were wrong."""
    assert known_fault_types("qdrone2-emulated", *link) == known_fault_types("another", *TRAINED) == ()
    assert known_fault_types("qdrone2-emulated", "qdrone2", 999.0)


@pytest.mark.parametrize("strength", [1.0, 0.5])
@pytest.mark.parametrize("code", ["F1/SV1", "F1/SV2", "F1/SV3", "F2/SV1", "F3/SV1", "F3/SV3"])
def test_the_middle_of_a_cloud_is_its_fault(code: str, strength: float) -> None:
    found = assess(centre(code, strength), LATE)
    assert found.fault_type == code[:2]
    assert found.severity is not None
    assert abs(found.severity - int(code[-1])) <= 1
    assert (found.confidence or 0.0) > 0.8


def test_the_shares_are_those_of_bayes_by_scipy() -> None:
    near = np.add(centre("F3/SV1", 0.5), (0.05, 0.1, 0.2))
    density = [(c.fault_type, multivariate_normal(c.mean, c.covariance).pdf(near)) for c in LATE.clouds]
    found = assess(near, LATE)
    share = sum(one for kind, one in density if kind is found.fault_type) / sum(one for _, one in density)
    assert found.confidence == pytest.approx(share, rel=1e-9)


def test_without_the_trim_the_others_decide_and_what_no_fault_looks_like_or_lies_between_two_gets_no_name() -> None:
    assert assess(np.array([*centre("F2/SV2")[:2], np.nan]), LATE).fault_type is FaultType.CRACK
    for unlike in ((*centre("F2/SV2")[:1], np.nan, 1.0), (np.log(60.0), np.log(2.0), 30.0)):
        assert assess(np.array(unlike), LATE) == Assessment()
    a, b = centre("F2/SV3", 0.5), centre("F3/SV1", 1.0)
    known = FaultTypes(0.0, tuple(c for c in LATE.clouds if c.strength == 1.0))
    named = {assess((1 - weight) * a + weight * b, known).fault_type for weight in np.linspace(0, 1, 60)}
    assert {None, FaultType.SURFACE_UNBALANCE} <= named


def test_only_windows_after_the_declaration_are_gathered_and_rises_of_the_rotor_that_is_named_at_last() -> None:
    """Rises of two rotors were averaged when the name changed: a true 0.0 was 0.15."""
    state = Gathered(10 * NS_PER_S)
    for number in range(-50, 100):  # looks after the declaration
        until_ns = state.since_ns + number * LOOK_NS
        state = state.add(Feature.UNBALANCE, look(9.0 if number < 6 else 2.0), until_ns)
        state = state.add(Feature.MOTION, look(9.0 if number < 30 else 0.1), until_ns - LOOK_NS // 2)
        state = state.add(Feature.RISE, look(0.0, (0.0, 0.5 if number < 40 else 0.03, 0.0, 0.0)), until_ns)
    assert state.features(2) == pytest.approx([np.log(2.0), np.log(0.1), 3.0])
    mixed = look(9.0, (0.9, 0.9))  # it began too early: its last value counts
    mixed[LAST_LEVEL], mixed[EVIDENCE : EVIDENCE + 2] = 2.0, (0.1, 0.2)
    state = Gathered(0).add(Feature.UNBALANCE, mixed, round(0.65 * NS_PER_S))
    found = state.add(Feature.RISE, mixed, 4 * NS_PER_S).features(2)
    assert found == pytest.approx([np.log(2.0), np.nan, 20.0], nan_ok=True)
    state = Gathered(0).add(Feature.RISE, look(0.0, (0.1, 0.3)), 5 * NS_PER_S)
    assert [state.features(rotor)[2] for rotor in (1, 2)] == pytest.approx([10.0, 30.0])
    assert np.isnan([state.features(None), state.features(3)]).all()
