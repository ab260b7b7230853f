"""Judge a whole log by a baseline: one verdict, with its reason, for every log that can be opened."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from mavdiag.airframe.fingerprint import FIRST_S, Likeness, Outcome, compare
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainState, chain_of
from mavdiag.decision.diagnosis import Change, Event, Stage
from mavdiag.decision.words import fault_reason
from mavdiag.errors import InputError
from mavdiag.kernel import Account, Piece, Stretch
from mavdiag.monitors import by_name
from mavdiag.monitors.base import FaultKind
from mavdiag.rows.align import measure_grid
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.gate import Border, Hidden, hidden_flight
from mavdiag.rows.upsets import Upset, motion_of, upset_in
from mavdiag.telemetry import Axis, FloatArray, Log, Signal, pandas_module
from mavdiag.units import NS_PER_S

__all__ = [
    "JudgedEvent",
    "JudgedFlight",
    "LogVerdict",
    "MonitorSummary",
    "NamedRotor",
    "Verdict",
    "exit_code",
    "judge",
    "judge_in_full",
    "why_not",
]

PIECE_ROWS = 8000  # rows that are judged together (our choice: 6,000 to 12,000 take the same time)
MIN_JUDGED_S = 1.0  # less judged time supports no verdict (our choice)
MOST_STRETCHES = 3  # that were not judged, which a reason names (our choice)
NEVER_FLEW = "never airborne: no armed flight with thrust"
JUDGED_SHARE = 0.8  # of the flown time that must be judged for "healthy", unless told otherwise (our choice)


class Verdict(StrEnum):
    """What can be said of a log."""

    HEALTHY = "healthy"
    SUSPECTED = "suspected"
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
class NamedRotor:
    """A rotor that was named, from 1, and the span of it [s of the vehicle's clock]; end_s None if it lasted."""

    rotor: int
    since_s: float
    end_s: float | None


@dataclass(frozen=True, slots=True)
class LogVerdict:
    """The verdict on one log.

    flown_s: time in the air, without take-offs and landings; what nobody could judge, as without a gyro, is in it.
    judged_s: how much of it any monitor that decides about propellers judged.
    rate_hz: of the gyro stream.
    changes: the decision's log.
    notes: what a reader must know of the log or the baseline, one sentence each; the reason has them, too.
    kind: the gravest kind of fault that was declared; None if none was.
    since_s: when it was declared first, of the vehicle's clock.
    rotor: the one that was named last; None without one.
    rotors: every one that was named, in order of time.
    """

    log: str
    verdict: Verdict
    reason: str
    judged_s: float = 0.0
    flown_s: float = 0.0
    profile: str = ""
    rate_hz: float = 0.0
    monitors: tuple[MonitorSummary, ...] = ()
    events: tuple[JudgedEvent, ...] = ()
    changes: tuple[Change, ...] = ()
    notes: tuple[str, ...] = ()
    kind: FaultKind | None = None
    since_s: float | None = None
    rotor: int | None = None
    rotors: tuple[NamedRotor, ...] = ()

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
    """A verdict and what the chain showed on the way.

    chain: None if the log could not be judged at all. unjudged: what of the flown time was not judged.
    """

    verdict: LogVerdict
    chain: Chain | None = None
    pieces: tuple[Piece, ...] = ()
    unjudged: tuple[Stretch, ...] = ()


def judge(log: Log, baseline: Baseline, judged_share: float = JUDGED_SHARE) -> LogVerdict:
    """Run the chain over a log. A log that the baseline cannot judge is `not_judgeable`, with the reason.

    judged_share: of the flown time that must be judged before a flight is called healthy, 0..1.
    Rows are made and judged some thousands at a time, so that it takes little memory beside the log's own.
    """
    return _judged(log, baseline, judged_share, keep=False).verdict


def judge_in_full(log: Log, baseline: Baseline, judged_share: float = JUDGED_SHARE) -> JudgedFlight:
    """As `judge`, and keep all that `mavdiag.traces` draws from; it takes as much memory as the rows."""
    return _judged(log, baseline, judged_share, keep=True)


@dataclass(slots=True)
class _Run:
    """What the chain made of a whole log.

    spans: first and last row of each part of it that flew [ns]. motion: of its rows, for `rows.upsets`.
    """

    state: ChainState
    events: list[Event] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    kept: list[Piece] = field(default_factory=list)
    spans: list[Stretch] = field(default_factory=list)
    motion: list[FloatArray] = field(default_factory=list)

    def add(self, block: Block) -> None:
        """More rows that flew."""
        first, last = int(block.t_ns[0]), int(block.t_ns[-1])
        if self.spans and first - self.spans[-1][1] <= NS_PER_S:
            self.spans[-1] = (self.spans[-1][0], last)
        else:
            self.spans.append((first, last))
        self.motion.append(motion_of(block))


def _judged(log: Log, baseline: Baseline, judged_share: float, keep: bool) -> JudgedFlight:
    def refused(reason: str, rate_hz: float = 0.0) -> JudgedFlight:
        return JudgedFlight(LogVerdict(log.name, Verdict.NOT_JUDGEABLE, reason, profile=log.profile, rate_hz=rate_hz))

    try:
        dt_s, _ = measure_grid(log.telemetry)
    except InputError as error:
        return refused(str(error))
    chain = replace(chain_of(baseline, log.started_ns, log.profile), fingerprint=None)  # compared before it is judged
    if refusal := chain.refusal(log.telemetry):
        return refused(refusal, 1 / dt_s)
    if log.motor_order:  # its outputs are by motor already
        chain = replace(chain, front=replace(chain.front, outputs=None))
    telemetry = chain.front.align.believed(log.telemetry)
    parts = chain.front.pieces(telemetry, PIECE_ROWS)
    first = _beginning(parts, baseline)
    likeness = _likeness(first, baseline)
    alike = likeness.sentence(baseline.airframe.name)
    if likeness.outcome is Outcome.FAR:
        return refused(f"another vehicle: {alike}", 1 / dt_s)
    run = _run(chain, itertools.chain(first, parts), keep)
    events, memory = _merged(run.events), chain.kernel.fresh(run.state.memory)
    monitors = _summaries(chain, run.state, events)
    hidden = hidden_flight(telemetry, chain.front.gate, run.spans)
    air_s, judged_s = memory.flown * chain.kernel.dt_s, memory.judged * chain.kernel.dt_s
    flown_s = air_s + sum(one.span_s for one in hidden)
    upset, rotors = upset_in(run.motion), _rotors(run.changes)
    takeoff_s = memory.rows * chain.kernel.dt_s - air_s
    seen = (events, run.changes, memory.unjudged, hidden, judged_s, flown_s, takeoff_s)
    verdict, reason = _Evidence(log, monitors, *seen, upset, judged_share).verdict()
    kind, since = _declared(run.changes)
    if kind is None and verdict is Verdict.FAULT and upset is not None:
        kind, since = FaultKind.LOSS_OF_CONTROL, upset.begin_s
    notes = (*((alike,) if alike else ()), *log.notes, *_layout_notes(log, baseline))
    found = LogVerdict(
        log.name,
        verdict,
        "; ".join((reason, *notes)),
        min(judged_s, flown_s),
        flown_s,
        log.profile,
        1 / dt_s,
        monitors,
        tuple(JudgedEvent(e.start_ns / NS_PER_S, _seconds(e.end_ns), e) for e in events),
        tuple(run.changes),
        notes,
        kind,
        since,
        rotors[-1].rotor if rotors else None,
        rotors,
    )
    return JudgedFlight(found, chain, tuple(run.kept), memory.unjudged)


def _beginning(parts: Iterator[Rows | Border], baseline: Baseline) -> list[Rows | Border]:
    """The first rows, as many as are compared with the vehicle of the baseline, and those of half a window more."""
    taken: list[Rows | Border] = []
    left_s = FIRST_S + baseline.window.samples * baseline.link.dt_s
    while left_s > 0 and baseline.fingerprint is not None and (part := next(parts, None)) is not None:
        taken.append(part)
        if isinstance(part, Rows):
            left_s -= float(np.count_nonzero(part.block.valid)) * part.block.dt_s
    return taken


def _run(chain: Chain, parts: Iterable[Rows | Border], keep: bool) -> _Run:
    """All parts through the chain."""
    run = _Run(chain.start())
    for part in parts:
        if isinstance(part, Rows) and len(part.block):
            run.add(part.block)
        run.state, output = chain.judge(run.state, (part,))
        run.events += output.events
        run.changes += output.changes
        run.kept += output.pieces if keep else ()
    run.state, output = chain.finish(run.state)
    run.events += output.events
    run.changes += output.changes
    run.kept += output.pieces if keep else ()
    return run


def _likeness(parts: Sequence[Rows | Border], baseline: Baseline) -> Likeness:
    """How the beginning of the flight compares with the vehicle of the baseline."""
    if baseline.fingerprint is None:
        return Likeness(Outcome.ALIKE)
    rows = [part for part in parts if isinstance(part, Rows)]
    return compare(baseline.fingerprint, rows, baseline.airframe.layout)


def _layout_notes(log: Log, baseline: Baseline) -> tuple[str, ...]:
    """That the rotor layout is unknown or doubtful, or that the log's own parameters have another one."""
    own, said = baseline.airframe.layout, layout_from_parameters(log.parameters, log.mav_type)
    other = own is not None and said.layout is not None and not said.layout.alike(own)
    differ = f"the log is of another rotor layout: {said.layout.name} by {said.reason}" if other and said.layout else ""
    return tuple(note for note in (baseline.layout_doubt, differ) if note)


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Exit code of a scan: the first of 2 error, 1 fault, 4 suspected, 3 not judgeable that occurs, else 0."""
    order = ((Verdict.ERROR, 2), (Verdict.FAULT, 1), (Verdict.SUSPECTED, 4), (Verdict.NOT_JUDGEABLE, 3))
    return next((code for verdict, code in order if verdict in verdicts), 0)


@dataclass(frozen=True, slots=True)
class _Evidence:
    """All that a verdict rests on."""

    log: Log
    monitors: Sequence[MonitorSummary]
    events: Sequence[Event]
    changes: Sequence[Change]
    unjudged: Sequence[Stretch]
    hidden: Sequence[Hidden]
    judged_s: float
    flown_s: float
    takeoff_s: float
    upset: Upset | None
    judged_share: float

    def verdict(self) -> tuple[Verdict, str]:
        """A fault if one was declared or the flight has an upset, healthy only if enough of it was judged."""
        faults = [change for change in self.changes if change.stage is Stage.FAULT]
        upset = "" if self.upset is None else self.upset.text
        if faults:
            told = fault_reason(_kind(faults), faults, self.events) + _when(faults[0].t_ns, self.log)
            return Verdict.FAULT, "; ".join(filter(None, (told, upset, self._share())))
        if upset:
            return Verdict.FAULT, f"{FaultKind.LOSS_OF_CONTROL}: {upset}; {self._share()}"
        if self.flown_s == 0:
            return (
                Verdict.NOT_JUDGEABLE,
                f"only {self.takeoff_s:.1f} s of take-off or start" if self.takeoff_s else NEVER_FLEW,
            )
        if suspicion := self._suspicion():
            return Verdict.SUSPECTED, f"{suspicion}; {self._share()}"
        if self.judged_s < max(MIN_JUDGED_S, self.judged_share * self.flown_s):
            return Verdict.NOT_JUDGEABLE, self._share()
        return Verdict.HEALTHY, f"no alarm; {self._share()}"

    def _suspicion(self) -> str:
        """What was suspected though no fault was declared; empty if nothing was."""
        if self.events:
            names = ", ".join(dict.fromkeys(event.monitor for event in self.events))
            count = f"{len(self.events)} alarm{'s' if len(self.events) != 1 else ''} of {names}"
            single = all(not one.decides for one in self.monitors if one.alarms)
            own = ", which decides nothing alone" if single else ""
            return f"{count}{own}{_when(self.events[0].start_ns, self.log)}"
        near = next((change for change in self.changes if change.stage is Stage.SUSPECTED), None)
        if near is None:
            return ""
        ratios = {one.name: (one.maximum or 0.0) / one.threshold for one in self.monitors if one.decides}
        name = max(ratios, key=lambda one: ratios[one], default="a monitor")
        return f"{name} came to {100 * ratios.get(name, 0.0):.0f} % of its threshold{_when(near.t_ns, self.log)}"

    def _share(self) -> str:
        """How much of the flight was judged, by what, and why the rest was not."""
        judged_s = min(self.judged_s, self.flown_s)
        share = judged_s / self.flown_s if self.flown_s else 0.0
        own = [one for one in self.monitors if one.decides and by_name(one.name).kind is FaultKind.PROPELLER]
        spoken = ", ".join(one.name for one in own if one.judged_s >= MIN_JUDGED_S)
        text = f"judged {judged_s:.1f} s of {self.flown_s:.1f} s ({100 * share:.0f} %)"
        text += f" by {spoken}" if spoken else ""
        text += f", without {self.takeoff_s:.1f} s of take-off or start" if self.takeoff_s >= 0.1 else ""
        why = [f"{one.reason} {_between(one.begin_s, one.end_s, self.log)}" for one in self.hidden]
        if 0 < share < self.judged_share:
            longest = [one for one in self.unjudged if one[1] - one[0] >= MIN_JUDGED_S * NS_PER_S]
            longest = sorted(longest, key=lambda one: one[0] - one[1])[:MOST_STRETCHES]
            why += [f"nothing judged {_between(*_in_s(one), self.log)}" for one in sorted(longest)]
        lacking = [one for one in own if one.judged_s < MIN_JUDGED_S or (one.not_judged and share < self.judged_share)]
        reasons = ", ".join(f"{one.name} ({one.not_judged})" for one in lacking)
        why += [f"not judged by {reasons}"] if reasons else []
        return f"{text}{': ' if share < self.judged_share else '; '}{'; '.join(why)}" if why else text


def _in_s(stretch: Stretch) -> tuple[float, float]:
    return stretch[0] / NS_PER_S, stretch[1] / NS_PER_S


def _clock(log: Log) -> tuple[float, float]:
    """First and last time of a log [s of the vehicle's clock]."""
    t_ns = log.telemetry.need(Signal.BODY_RATE).t_ns
    last_ns = max(int(np.max(one.t_ns)) for one in log.telemetry.series if len(one))
    return float(np.min(t_ns)) / NS_PER_S, last_ns / NS_PER_S


def _when(t_ns: int, log: Log) -> str:
    """A time of the vehicle's clock, and of the log where it begins at another one."""
    t_s, begin_s = t_ns / NS_PER_S, _clock(log)[0]
    into = f" of the vehicle's clock, {t_s - begin_s:.1f} s into the log" if begin_s >= 1 else ""
    return f", first at {t_s:.2f} s{into}"


def _between(begin_s: float, end_s: float, log: Log) -> str:
    """A stretch of the vehicle's clock."""
    return f"from {begin_s:.1f} s" + ("" if end_s > _clock(log)[1] - 1.0 else f" to {end_s:.1f} s")


def _declared(changes: Sequence[Change]) -> tuple[FaultKind | None, float | None]:
    """The gravest kind of fault, and when one was declared first [s of the vehicle's clock]."""
    return _kind(changes), next((one.t_ns / NS_PER_S for one in changes if one.stage is Stage.FAULT), None)


def _kind(changes: Sequence[Change]) -> FaultKind | None:
    """The gravest kind of them."""
    kinds = [one.kind for one in changes if one.kind is not None]
    return max(kinds, key=lambda one: one.rank, default=None)


def _rotors(changes: Sequence[Change]) -> tuple[NamedRotor, ...]:
    """Every rotor that was named, with its span, as the decision held it at the end."""
    spans = changes[-1].rotors if changes else ()
    return tuple(NamedRotor(one.rotor, one.since_ns / NS_PER_S, _seconds(one.end_ns)) for one in spans)


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
    sentence = {one.condition: one.sentence for one in chain.covered}
    outside = {sentence[condition](one.value): one.span_s for condition, one in account.outside.items()}
    reasons = {**waiting, **account.missing, **outside}
    if not reasons or max(reasons.values()) < MIN_JUDGED_S:
        return "no flight" if account.flight_s == 0 else None if account.judged_s else "too short a flight"
    return max(reasons, key=lambda reason: reasons[reason])


def _seconds(t_ns: int | None) -> float | None:
    return None if t_ns is None else t_ns / NS_PER_S
