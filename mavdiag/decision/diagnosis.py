"""What the monitors add up to, over time: `step(spec, state, readings) -> state`, and what to write beside an event.

Fusion says when a fault is declared, isolation names the rotor, and at fixed times after the declaration the features
gathered so far name type and severity. Each change is an `Opinion` with its vehicle time. What is said of an event is
the last opinion up to its end, so it depends on the rows alone: a live link and its recording say the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.airframe.propellers import FaultType
from mavdiag.decision import fusion, grading
from mavdiag.decision.events import Event, Reading
from mavdiag.decision.fusion import Change, Finding, FusionSpec, FusionState, Stage
from mavdiag.decision.grading import FaultTypes, Gathered
from mavdiag.telemetry import NS_PER_S

__all__ = ["DiagnosisSpec", "DiagnosisState", "Opinion", "named", "opinion_at", "start", "step"]

KEPT = 64  # opinions remembered between steps


@dataclass(frozen=True, slots=True)
class Opinion:
    """What is held from `t_ns` on; None where it is not known. confidence: of the rotor, 0..1."""

    t_ns: int
    stage: Stage
    rotor: int | None = None
    confidence: float | None = None
    fault_type: FaultType | None = None
    severity: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisSpec:
    """fusion: the monitors that decide, in the order of their readings. feature: which of them gives which feature
    ("vibration" in g mm, "energy", "effort"), by its place. known: parameters for types, empty to name none."""

    fusion: FusionSpec
    feature: Mapping[str, int]
    known: tuple[FaultTypes, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisState:
    """Memory of the fusion, what was gathered since the declaration, readings still to be gathered, and opinions."""

    fusion: FusionState
    gathered: Gathered | None = None
    pending: tuple[Mapping[str, Reading], ...] = ()
    looked: int = 0  # how many of the fixed times have passed
    opinions: tuple[Opinion, ...] = ()


def start(spec: DiagnosisSpec) -> DiagnosisState:
    """Nothing seen yet."""
    return DiagnosisState(fusion.start(spec.fusion))


def step(spec: DiagnosisSpec, state: DiagnosisState, readings: Sequence[Reading]) -> DiagnosisState:
    """Take the next readings of the deciding monitors, one each."""
    fused, findings = fusion.step(spec.fusion, state.fusion, readings)
    if not findings and state.gathered is None:
        return replace(state, fusion=fused)
    chunk = {name: readings[place] for name, place in spec.feature.items() if len(readings[place].t_ns)}
    state = replace(state, fusion=fused, pending=(*state.pending, chunk), opinions=state.opinions[-KEPT:])
    for finding in findings:
        state = _hear(_gather_until(spec, state, finding.t_ns), finding)
    state = _gather_until(spec, state, _common_ns(spec, state))
    waiting = state.gathered is not None and state.looked < len(spec.known)
    return replace(state, pending=state.pending if waiting else ())


def opinion_at(state: DiagnosisState, t_ns: int | None) -> Opinion | None:
    """The opinion held at a vehicle time, None for the latest; None while no fault is declared."""
    held = [one for one in state.opinions if t_ns is None or one.t_ns <= t_ns]
    return held[-1] if held and held[-1].stage is Stage.DECLARED else None


def named(state: DiagnosisState, event: Event) -> Event:
    """The event with rotor, type, severity and confidence as they were known at its end."""
    opinion = opinion_at(state, event.end_ns)
    if opinion is None:
        return event
    return replace(
        event,
        rotor=opinion.rotor,
        confidence=opinion.confidence,
        fault_type=opinion.fault_type,
        severity=opinion.severity,
    )


def _hear(state: DiagnosisState, finding: Finding) -> DiagnosisState:
    """A finding of the fusion: a declaration starts the gathering, a clearance ends it."""
    match finding.change:
        case Change.SUSPECTED:
            return state
        case Change.CLEARED:
            cleared = Opinion(finding.t_ns, Stage.QUIET)
            return replace(state, gathered=None, pending=(), looked=0, opinions=(*state.opinions, cleared))
        case Change.DECLARED:
            state = replace(state, gathered=grading.start(finding.t_ns), looked=0)
    before = opinion_at(state, None) or Opinion(finding.t_ns, Stage.DECLARED)
    now = replace(before, t_ns=finding.t_ns, rotor=finding.rotor, confidence=finding.confidence)
    return replace(state, opinions=(*state.opinions, now))


def _common_ns(spec: DiagnosisSpec, state: DiagnosisState) -> int:
    """The time up to which every feature's readings are in."""
    newest = [
        max((int(chunk[name].t_ns[-1]) for chunk in state.pending if name in chunk), default=-1)
        for name in spec.feature
    ]
    return min(newest, default=-1)


def _gather_until(spec: DiagnosisSpec, state: DiagnosisState, until_ns: int) -> DiagnosisState:
    """Look at type and severity at each of the fixed times up to `until_ns`."""
    while state.gathered is not None and state.looked < len(spec.known):
        due_ns = state.gathered.since_ns + round(spec.known[state.looked].after_s * NS_PER_S)
        if due_ns > until_ns:
            break
        state = _look(spec, state, due_ns)
    return state


def _look(spec: DiagnosisSpec, state: DiagnosisState, due_ns: int) -> DiagnosisState:
    opinion = opinion_at(state, due_ns)
    gathered, rest = state.gathered, []
    for chunk in state.pending:
        upto = {name: _cut(reading, None, due_ns) for name, reading in chunk.items()}
        if gathered is not None:
            gathered = grading.gather(
                gathered,
                vibration=upto.get("vibration"),
                energy=upto.get("energy"),
                effort=upto.get("effort"),
                rotor=None if opinion is None else opinion.rotor,
            )
        after = {name: _cut(reading, due_ns, None) for name, reading in chunk.items()}
        rest.append({name: reading for name, reading in after.items() if len(reading.t_ns)})
    left = tuple(chunk for chunk in rest if chunk)
    state = replace(state, gathered=gathered, pending=left, looked=state.looked + 1)
    if gathered is None or opinion is None:
        return state
    found = grading.assess(replace(gathered, latest_ns=due_ns), spec.known)
    now = replace(opinion, t_ns=due_ns, fault_type=found.fault_type, severity=found.severity)
    later = tuple(one for one in state.opinions if one.t_ns > due_ns)
    earlier = tuple(one for one in state.opinions if one.t_ns <= due_ns)
    return replace(state, opinions=(*earlier, now, *later))


def _cut(reading: Reading, after_ns: int | None, until_ns: int | None) -> Reading:
    """The rows with after_ns < t <= until_ns."""
    first = 0 if after_ns is None else int(np.searchsorted(reading.t_ns, after_ns, side="right"))
    stop = len(reading.t_ns) if until_ns is None else int(np.searchsorted(reading.t_ns, until_ns, side="right"))
    rows = slice(first, stop)
    rotors = reading.rotors[rows] if len(reading.rotors) else reading.rotors
    return Reading(
        reading.t_ns[rows],
        reading.statistic[rows],
        reading.level[rows],
        reading.signal[rows],
        reading.valid[rows],
        rotors,
    )
