"""The decision: its table and its stories."""

import numpy as np
import pytest
from made_statistics import decide, made_slot, statistic

from mavdiag.decision.alarm import LEFT_ALONE, NEXT, DecisionSpec, DecisionState
from mavdiag.decision.diagnosis import Change, Event, Stage
from mavdiag.decision.grading import known_fault_types
from mavdiag.kernel import Alarm, Height, Looked
from mavdiag.monitors.base import Feature, RotorEvidence
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray
from mavdiag.units import NS_PER_S

HOW = RotorEvidence(8.0)
SHAKING = made_slot("unbalance", 0.5, evidence=HOW, feature=Feature.UNBALANCE)
MOVING = made_slot("rotor_signature", 4.0, evidence=HOW, feature=Feature.MOTION, delay_s=0.05)
THESIS = made_slot("fsd", 0.1, decides=False, axis=Axis.ROLL, delay_s=0.05, clear_s=0.0)
SPEC = DecisionSpec((SHAKING, MOVING, THESIS))
STEP_S = 0.02


def at(rotor: int | None) -> tuple[float, ...]:
    return tuple(0.9 * (i + 1 == rotor) for i in range(4))


def values(x: FloatArray, rotor: int | None = 1, first_s: float = 0.0, dt_s: float = STEP_S) -> Statistic:
    return statistic(x, first_s=first_s, dt_s=dt_s, rotors=at(rotor))


def profile(*pieces: tuple[float, float]) -> FloatArray:
    """Pieces of (seconds, level)."""
    return np.concatenate([np.full(round(span / STEP_S), level) for span, level in pieces])


NOTHING = values(np.empty(0))


def decided(
    shaking: Statistic, moving: Statistic = NOTHING, thesis: Statistic = NOTHING
) -> tuple[DecisionState, tuple[Event, ...], tuple[Change, ...]]:
    """What comes of values that end together."""
    return decide(SPEC, (shaking, moving, thesis))


def stages(changes: tuple[Change, ...]) -> list[Stage]:
    return [change.stage for change in changes]


def test_one_monitor_above_its_threshold_is_a_fault_and_names_the_rotor() -> None:
    state, events, changes = decided(values(profile((3, 0.3), (3, 2.1)), rotor=2), values(profile((6, 1.0)), None))
    assert stages(changes) == [Stage.QUIET, Stage.FAULT]
    fault = changes[1]
    assert (fault.monitor, fault.statistic, fault.threshold, fault.rotor) == ("unbalance", 2.1, 0.5, 2)
    assert fault.t_ns == 3 * NS_PER_S
    assert [(one.monitor, one.start_ns, one.end_ns, one.rotor) for one in events] == [
        ("unbalance", 3 * NS_PER_S, None, 2)
    ]
    assert state.diagnosis.stage is Stage.FAULT


def test_a_value_counts_from_when_it_is_known() -> None:
    _, _, changes = decided(NOTHING, values(profile((3, 1.0), (3, 6.0))))
    assert changes[1].t_ns == round(3.1 * NS_PER_S)  # the first look after 3.05 s


def test_coming_near_is_suspected_and_goes_away_after_two_calm_seconds() -> None:
    _, events, changes = decided(values(profile((2, 0.3), (1, 0.42), (1, 0.3), (1, 0.36), (4, 0.3))))
    assert stages(changes) == [Stage.QUIET, Stage.SUSPECTED, Stage.QUIET]
    assert changes[2].t_ns == pytest.approx(7 * NS_PER_S, abs=0.11 * NS_PER_S)
    assert events == ()


def test_a_suspicion_names_the_rotor_that_is_to_be_inspected() -> None:
    state, _, changes = decided(values(profile((2, 0.3), (1, 0.42), (4, 0.3)), rotor=3))
    assert [(one.stage, one.rotor) for one in changes[1:]] == [(Stage.SUSPECTED, 3), (Stage.QUIET, None)]
    assert state.diagnosis.rotor is None


def seen(changes: tuple[Change, ...]) -> list[bool]:
    return [change.seen for change in changes if change.stage is Stage.FAULT]


def test_a_fault_lasts_and_is_only_no_longer_seen() -> None:
    """H3: the end of a transient was the end of the fault: 12 of 12 lasting losses were called clear."""
    state, _, changes = decided(values(profile((2, 0.3), *[(1.5, 1.0), (1.5, 0.2)] * 3, (30, 0.2))))
    assert stages(changes) == [Stage.QUIET, Stage.FAULT, Stage.FAULT]
    assert seen(changes) == [True, False]
    assert (state.diagnosis.stage, state.diagnosis.rotor, state.diagnosis.declared_ns) == (Stage.FAULT, 1, 2 * NS_PER_S)
    (span,) = state.diagnosis.rotors
    assert (span.rotor, span.since_ns) == (1, 2 * NS_PER_S)
    assert span.end_ns == pytest.approx(9.5 * NS_PER_S, abs=0.11 * NS_PER_S)


def test_3a_another_slot_that_is_calm_does_not_speak_for_the_one_that_was_over() -> None:
    """A fault of a monitor that left its envelope at 0.9 of its threshold was cleared by any other calm one."""
    shaking = values(profile((2, 0.3), (2, 1.0), (1, 0.45), (20, np.nan)))
    state, _, changes = decided(shaking, values(profile((25, 0.1))))
    assert seen(changes) == [True]
    assert (state.diagnosis.stage, state.diagnosis.seen) == (Stage.FAULT, True)
    state, _, changes = decided(values(profile((2, 0.3), (2, 1.0), (5, 0.1), (20, np.nan))), values(profile((29, 0.1))))
    assert (state.diagnosis.stage, state.diagnosis.seen) == (Stage.FAULT, False)


def test_u2_every_rotor_is_named_with_its_span_and_its_own_figure() -> None:
    shaking = values(profile((2, 0.3), (10, 1.0), (10, 0.1), (10, 2.0), (10, 0.1), (5, 1.5), (5, 0.1)))
    shaking.rotors[int(21 / STEP_S) :] = at(4)
    shaking.rotors[int(41 / STEP_S) :] = at(1)
    state, events, changes = decided(shaking)
    rotors = [
        (one.rotor, round(one.since_ns / NS_PER_S), round((one.end_ns or 0) / NS_PER_S)) for one in changes[-1].rotors
    ]
    assert rotors == [(1, 2, 12), (4, 22, 32), (1, 42, 47)]
    assert seen(changes) == [True, False] * 3
    named = [(one.rotor, one.statistic) for one in changes if one.stage is Stage.FAULT and one.seen]
    assert named == [(1, 1.0), (4, 2.0), (1, 1.5)]  # H12: the first motor had the figure of the second
    assert [one.rotor for one in events] == [1, 1, 4, 4, 1, 1]
    assert state.diagnosis.declared_ns == 2 * NS_PER_S


def test_a_rotor_that_comes_back_goes_on_with_its_span() -> None:
    _, _, changes = decided(values(profile((2, 0.3), *[(3, 1.0), (5, 0.1)] * 3, (1, 1.0)), rotor=3))
    assert [(one.rotor, one.since_ns, one.end_ns) for one in changes[-1].rotors] == [(3, 2 * NS_PER_S, None)]


def test_a_name_that_was_wrong_at_first_is_replaced() -> None:
    shaking = values(profile((2, 0.3), (8, 1.0)), rotor=2)
    shaking.rotors[: int(3 / STEP_S)] = (0.2, 0.6, 0.0, 0.0)
    shaking.rotors[int(3 / STEP_S) :] = at(3)
    _, _, changes = decided(shaking)
    assert [one.rotor for one in changes if one.stage is Stage.FAULT] == [2, 3]
    assert [one.rotor for one in changes[-1].rotors] == [3]


TRIM = made_slot("trim_step", 0.01, evidence=RotorEvidence(10.0, relative=True, direct=False))


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
    assert [one.rotor for one in changes[-1].rotors] == rotors
    assert state.diagnosis.seen == (named != 1)


def test_9a_an_alarm_that_does_not_overlap_a_fault_belongs_to_none() -> None:
    """A harmless alarm long after a fault carried its rotor and kind."""
    shaking = values(profile((2, 0.3), (3, 1.0), (40, 0.1)), rotor=2)
    thesis = values(profile((3, 0.0), (1, 0.5), (30, 0.0), (1, 0.5), (10, 0.0)))
    _, events, _ = decided(shaking, NOTHING, thesis)
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
    assert len({one.start_ns for one in events}) == 1
    assert state.diagnosis.statistic == 1.0


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
    assert stages(changes) == [Stage.QUIET, Stage.SUSPECTED]
    assert [(one.monitor, one.axis) for one in events] == [("fsd", Axis.ROLL)]
    assert state.diagnosis.stage is Stage.SUSPECTED


def test_b3_the_end_of_a_flight_closes_its_events_and_forgets_them() -> None:
    """B3: an open event lived through the landing."""
    state, opened, _ = decided(values(profile((2, 0.3), (2, 2.0)), rotor=4))
    assert [one.end_ns for one in opened] == [None]
    open_ = Alarm(0, 0, 2 * NS_PER_S, round(3.98 * NS_PER_S), 2.0, 2.0)
    state, closed, changes = SPEC.end_flight(state, Looked(), [open_], 4 * NS_PER_S)
    assert [(one.start_ns, one.end_ns, one.rotor) for one in closed] == [(2 * NS_PER_S, open_.end_ns, 4)]
    assert [(one.stage, one.rotor) for one in changes] == [(Stage.INSPECT, 4)]
    after = values(profile((4, 0.3)), first_s=100.0)
    assert decide(SPEC, (after, NOTHING, NOTHING), state)[1:] == ((), ())


def test_an_inspection_lasts_through_flights_until_it_is_acknowledged() -> None:
    state, _, _ = decided(values(profile((2, 0.3), (2, 2.0)), rotor=4))
    assert SPEC.acknowledge(state, 4 * NS_PER_S) == (state, (), ())  # not in flight
    state, _, _ = SPEC.end_flight(state, Looked(), (), 4 * NS_PER_S)
    calm, bad = (values(profile((4, level)), rotor=2, first_s=100.0) for level in (0.3, 2.0))
    flown, _, _ = decide(SPEC, (calm, NOTHING, NOTHING), state)
    landed, _, changes = SPEC.end_flight(flown, Looked(), (), 104 * NS_PER_S)
    assert (landed.diagnosis, changes) == (state.diagnosis, ())
    _, _, changes = decide(SPEC, (bad, NOTHING, NOTHING), state)
    assert [(one.stage, one.rotor, [span.rotor for span in one.rotors]) for one in changes] == [
        (Stage.FAULT, 2, [4, 2])
    ]
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


def test_the_table_has_one_way_into_a_fault_and_no_height_ends_it() -> None:
    for (came, height), (stage, reason) in NEXT.items():
        assert stage is not came
        assert reason
        assert (stage is Stage.FAULT) == (height is Height.OVER)
        assert (stage is Stage.NOT_JUDGED) == (height is Height.UNKNOWN)
        assert came is not Stage.FAULT
        assert came is not Stage.INSPECT or stage is Stage.FAULT
    assert {came for came, height in NEXT if height is Height.OVER} == set(Stage) - {Stage.FAULT}
    assert (Stage.QUIET, Height.HELD) not in NEXT
    assert all((stage, height) not in NEXT for stage, heights in LEFT_ALONE.items() for height in heights)
