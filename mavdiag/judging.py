"""Judge a whole log by a baseline: one verdict, with its reason, for every log that can be opened."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from mavdiag.airframe.fingerprint import FIRST_S, Likeness, Outcome, compare
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.baseline import Baseline, check_link
from mavdiag.chain import Account, Chain, ChainState, Piece, chain_of
from mavdiag.decision.account import reason_of
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import BaselineError, InputError
from mavdiag.monitors import by_name
from mavdiag.monitors.base import FaultKind
from mavdiag.rows.align import measure_grid
from mavdiag.rows.front import Rows
from mavdiag.rows.gate import Border
from mavdiag.telemetry import Axis, Log, pandas_module
from mavdiag.units import NS_PER_S

__all__ = [
    "JudgedEvent",
    "JudgedFlight",
    "LogVerdict",
    "MonitorSummary",
    "Verdict",
    "exit_code",
    "judge",
    "judge_in_full",
    "why_not",
]

PIECE_ROWS = 8000  # rows that are judged together (our choice: 6,000 to 12,000 take the same time)
MIN_JUDGED_S = 1.0  # less judged time of every deciding monitor supports no verdict (our choice)


class Verdict(StrEnum):
    """What can be said of a log."""

    HEALTHY = "healthy"
    FAULT = "fault"
    NOT_JUDGEABLE = "not_judgeable"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class MonitorSummary:
    """One monitor over the whole log, on the axis where it came nearest to its threshold.

    name, axis: whose it is.
    maximum: highest judged statistic; None if it never judged.
    threshold, unit: of the statistic.
    alarms: its events on all axes.
    judged_s: time that it judged [s].
    not_judged: why it did not judge for the longest; None if it judged all the flight but its warm-up.
    outside_s: flight time outside of the envelope [s].
    decides: its alarm is a fault by itself.
    """

    name: str
    axis: Axis | None
    maximum: float | None
    threshold: float
    unit: str
    alarms: int
    judged_s: float = 0.0
    not_judged: str | None = None
    decides: bool = True
    outside_s: float = 0.0


@dataclass(frozen=True, slots=True)
class JudgedEvent:
    """An event in seconds of the vehicle's clock. end_s is None if it lasted to the end of the log."""

    t_s: float
    end_s: float | None
    event: Event


@dataclass(frozen=True, slots=True)
class LogVerdict:
    """The verdict on one log.

    judged_s: judged time of the monitor that decides about propellers and judged for longest.
    rate_hz: of the gyro stream.
    changes: the decision's log.
    notes: what a reader must know of the log or the baseline, one sentence each; the reason has them, too.
    kind: the gravest kind of fault that was declared; None if none was.
    """

    log: str
    verdict: Verdict
    reason: str
    judged_s: float = 0.0
    profile: str = ""
    rate_hz: float = 0.0
    monitors: tuple[MonitorSummary, ...] = ()
    events: tuple[JudgedEvent, ...] = ()
    changes: tuple[Change, ...] = ()
    notes: tuple[str, ...] = ()
    kind: FaultKind | None = None

    def __str__(self) -> str:
        return f"{self.log}: {self.verdict.value}, {self.reason}"

    def to_frame(self) -> Any:
        """The events as a pandas DataFrame, one row each. Raises UsageError if pandas is not installed."""
        pandas = pandas_module()
        names = ("monitor", "axis", "statistic", "threshold", "rotor", "fault_type", "severity", "confidence", "kind")
        rows = [
            {"t_s": one.t_s, "end_s": one.end_s, **{name: getattr(one.event, name) for name in names}}
            for one in self.events
        ]
        return pandas.DataFrame(rows, columns=["t_s", "end_s", *names])


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFlight:
    """A verdict and what the chain showed on the way. chain: None if the log could not be judged at all."""

    verdict: LogVerdict
    chain: Chain | None = None
    pieces: tuple[Piece, ...] = ()


def judge(log: Log, baseline: Baseline) -> LogVerdict:
    """Run the chain over a log. A log that the baseline cannot judge is `not_judgeable`, with the reason.

    Rows are made and judged some thousands at a time, so that it takes little memory beside the log's own.
    """
    return _judged(log, baseline, keep=False).verdict


def judge_in_full(log: Log, baseline: Baseline) -> JudgedFlight:
    """As `judge`, and keep all that `mavdiag.traces` draws from; it takes as much memory as the rows."""
    return _judged(log, baseline, keep=True)


def _judged(log: Log, baseline: Baseline, keep: bool) -> JudgedFlight:
    try:
        dt_s, _ = measure_grid(log.telemetry)
    except InputError as error:
        return JudgedFlight(LogVerdict(log.name, Verdict.NOT_JUDGEABLE, str(error), profile=log.profile))
    try:
        check_link(baseline, profile=log.profile, dt_s=dt_s)
    except BaselineError as error:
        reason = f"another link: {error}"
        return JudgedFlight(LogVerdict(log.name, Verdict.NOT_JUDGEABLE, reason, profile=log.profile, rate_hz=1 / dt_s))
    chain = replace(chain_of(baseline, log.started_ns), fingerprint=None)  # compared here, before it is judged
    if log.motor_order:  # its outputs are by motor already
        chain = replace(chain, front=replace(chain.front, outputs=None))
    parts = chain.front.pieces(log.telemetry, PIECE_ROWS)
    first = _beginning(parts, baseline)
    likeness = _likeness(first, baseline)
    alike = likeness.sentence(baseline.airframe.name)
    if likeness.outcome is Outcome.FAR:
        reason = f"another vehicle: {alike}"
        return JudgedFlight(LogVerdict(log.name, Verdict.NOT_JUDGEABLE, reason, profile=log.profile, rate_hz=1 / dt_s))
    state, found, changes, kept = _run(chain, itertools.chain(first, parts), keep)
    events = _merged(found)
    monitors = _summaries(chain, state, events)
    verdict, reason = _verdict(monitors, state, events, changes)
    notes = (*((alike,) if alike else ()), *log.notes, *_layout_notes(log, baseline))
    judged = tuple(JudgedEvent(e.start_ns / NS_PER_S, _seconds(e.end_ns), e) for e in events)
    told = LogVerdict(
        log.name,
        verdict,
        "; ".join((reason, *notes)),
        state.judged_s,
        log.profile,
        1 / dt_s,
        monitors,
        judged,
        tuple(changes),
        notes,
        _kind(changes),
    )
    return JudgedFlight(told, chain, tuple(kept))


def _beginning(parts: Iterator[Rows | Border], baseline: Baseline) -> list[Rows | Border]:
    """The first rows, as many as are compared with the vehicle of the baseline, and those of half a window more."""
    taken: list[Rows | Border] = []
    left_s = FIRST_S + baseline.window.samples * baseline.link.dt_s
    while left_s > 0 and baseline.fingerprint is not None and (part := next(parts, None)) is not None:
        taken.append(part)
        if isinstance(part, Rows):
            left_s -= float(np.count_nonzero(part.block.valid)) * part.block.dt_s
    return taken


def _run(
    chain: Chain, parts: Iterable[Rows | Border], keep: bool
) -> tuple[ChainState, list[Event], list[Change], list[Piece]]:
    """All parts through the chain: its last state, all events and changes, and the pieces if they are to be kept."""
    state, events, changes, kept = chain.start(), list[Event](), list[Change](), list[Piece]()
    for part in parts:
        state, output = chain.judge(state, (part,))
        events += output.events
        changes += output.changes
        kept += output.pieces if keep else ()
    state, output = chain.finish(state)
    return state, [*events, *output.events], [*changes, *output.changes], [*kept, *output.pieces]


def _likeness(parts: Sequence[Rows | Border], baseline: Baseline) -> Likeness:
    """How the beginning of the flight compares with the vehicle of the baseline."""
    if baseline.fingerprint is None:
        return Likeness(Outcome.ALIKE)
    rows = [part for part in parts if isinstance(part, Rows)]
    return compare(baseline.fingerprint, rows, baseline.airframe.layout)


def _layout_notes(log: Log, baseline: Baseline) -> tuple[str, ...]:
    """That the rotor layout is unknown or doubtful, or that the log's own parameters have another one."""
    own, said = baseline.airframe.layout, layout_from_parameters(log.parameters)
    other = own is not None and said.layout is not None and not said.layout.alike(own)
    differ = f"the log is of another rotor layout: {said.layout.name} by {said.reason}" if other and said.layout else ""
    return tuple(note for note in (baseline.layout_doubt, differ) if note)


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Exit code of a scan: the first of 2 error, 1 fault, 3 not judgeable that occurs, else 0."""
    order = ((Verdict.ERROR, 2), (Verdict.FAULT, 1), (Verdict.NOT_JUDGEABLE, 3))
    return next((code for verdict, code in order if verdict in verdicts), 0)


def _verdict(
    monitors: Sequence[MonitorSummary], state: ChainState, events: Sequence[Event], changes: Sequence[Change]
) -> tuple[Verdict, str]:
    """The verdict and its reason: a fault if the decision declared one, healthy only if a deciding monitor judged."""
    faults = [change for change in changes if change.stage is Stage.FAULT]
    if faults:
        return Verdict.FAULT, _fault_reason(faults, events)
    deciding = [one for one in monitors if one.decides]
    spoken = [one for one in deciding if one.judged_s >= MIN_JUDGED_S]
    others = ", ".join(f"{one.name} ({one.not_judged})" for one in deciding if one not in spoken)
    if not any(by_name(one.name).kind is FaultKind.PROPELLER for one in spoken):
        flight_s = max((account.flight_s for account in state.accounts), default=0.0)
        if flight_s == 0:
            return Verdict.NOT_JUDGEABLE, "never airborne: no armed flight with thrust"
        return Verdict.NOT_JUDGEABLE, f"{flight_s:.1f} s of flight, but no deciding monitor judged: {others}"
    suspected = any(change.stage is Stage.SUSPECTED for change in changes)
    basis = ", ".join(f"{one.name} {one.judged_s:.1f} s" for one in spoken)
    kind = f"only suspected ({len(events)} alarms)" if events else "only suspected" if suspected else "no alarm"
    return Verdict.HEALTHY, f"{kind}; judged by {basis}" + (f"; not judged by {others}" if others else "")


def _kind(changes: Sequence[Change]) -> FaultKind | None:
    """The gravest kind of them."""
    kinds = [one.kind for one in changes if one.kind is not None]
    return max(kinds, key=lambda one: one.rank, default=None)


def _fault_reason(faults: Sequence[Change], events: Sequence[Event]) -> str:
    """The kind, the highest evidence, and the rotor and type that were named last and not withdrawn."""
    kind = _kind(faults)
    faults = [one for one in faults if one.kind is kind]
    worst = max(faults, key=lambda one: one.statistic / one.threshold if one.threshold else 0.0)
    highest = max(
        (event for event in events if (event.monitor, event.axis) == (worst.monitor, worst.axis)),
        key=lambda event: event.statistic,
        default=None,
    )
    statistic = worst.statistic if highest is None else highest.statistic
    places = 3
    while places < 9 and f"{statistic:.{places}g}" == f"{worst.threshold:.{places}g}" != "0":
        places += 1
    rotor = next((f"; rotor {one.rotor}" for one in reversed(faults) if one.rotor is not None), "")
    graded = next((f"; {one.fault_type}" for one in reversed(faults) if one.fault_type is not None), "")
    axis = f" on {worst.axis}" if worst.axis is not None else ""
    count = f"{len(events)} alarm{'s' if len(events) != 1 else ''}"
    evidence = f"{worst.monitor}{axis} {statistic:.{places}g} > {worst.threshold:.{places}g}"
    doubts = {by_name(event.monitor).doubt for event in events if by_name(event.monitor).decides}
    doubt = "".join(f"; {text}" for text in doubts if text and len(doubts) == 1)
    what = "" if kind in (None, FaultKind.PROPELLER) else f"{kind}: "
    return f"{what}{evidence}{rotor}{graded}{doubt}, {count}, first at {faults[0].t_ns / NS_PER_S:.2f} s"


def _merged(found: Sequence[Event]) -> tuple[Event, ...]:
    """Each event once, as it was last known, in order of time."""
    latest = {(event.monitor, event.axis, event.start_ns): event for event in found}
    return tuple(sorted(latest.values(), key=lambda event: (event.start_ns, event.monitor, str(event.axis))))


def _summaries(chain: Chain, state: ChainState, events: Sequence[Event]) -> tuple[MonitorSummary, ...]:
    nearest: dict[str, MonitorSummary] = {}
    for slot, account in zip(chain.slots, state.accounts, strict=True):
        alarms = sum(event.monitor == slot.monitor.name for event in events)
        name, axis = slot.key
        one = MonitorSummary(
            name,
            axis,
            account.peak,
            slot.threshold,
            slot.monitor.unit,
            alarms,
            account.judged_s,
            why_not(chain, account),
            slot.decides,
            account.outside_s,
        )
        old = nearest.get(name)
        if old is None or (one.maximum or 0.0) / one.threshold > (old.maximum or 0.0) / old.threshold:
            nearest[name] = one
    return tuple(nearest.values())


def why_not(chain: Chain, account: Account) -> str | None:
    """Why a slot did not judge: the reason that cost most time. One that judged and only warmed up has none."""
    waiting = account.not_judged if account.judged_s == 0 else {}
    reasons = {**waiting, **{reason_of(s): t for s, t in account.missing.items()}}
    outside = {chain.envelope.sentence(c, one.value): one.span_s for c, one in account.outside.items()}
    reasons = {**reasons, **outside}
    if not reasons or max(reasons.values()) < MIN_JUDGED_S:
        return "no flight" if account.flight_s == 0 else None if account.judged_s else "too short a flight"
    return max(reasons, key=lambda reason: reasons[reason])


def _seconds(t_ns: int | None) -> float | None:
    return None if t_ns is None else t_ns / NS_PER_S
