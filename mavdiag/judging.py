"""Judge a whole log by a baseline: one verdict, with its reason, for every log that can be opened."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeAlias

import numpy as np

from mavdiag.airframe.fingerprint import Likeness, Outcome
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.baseline import Baseline
from mavdiag.chain import Chain, ChainOutput, chain_of, suited
from mavdiag.decision.diagnosis import Change, Event, RotorSpan, Stage
from mavdiag.decision.words import MOSTLY, fault_reason, inspect_words
from mavdiag.errors import BaselineError, InputError, UsageError
from mavdiag.kernel import WAITING, Account, Piece, Stretch
from mavdiag.monitors import by_name
from mavdiag.monitors.base import FaultKind
from mavdiag.printable import counted
from mavdiag.rows.front import Rows, in_pieces
from mavdiag.rows.gate import hidden_flight
from mavdiag.rows.grid import measure_grid, onward
from mavdiag.rows.upsets import motion_of, upset_in
from mavdiag.tabular import Tabular
from mavdiag.telemetry import Axis, FloatArray, Log, Signal
from mavdiag.units import NS_PER_S

PIECE_ROWS = 4000  # rows that are judged together (our choice: 3,000 to 6,000 take the same time)
MIN_JUDGED_S = 1.0  # less judged time supports no verdict (our choice)
MOST_STRETCHES = 3  # that were not judged, which a reason names (our choice)
LONG_S = 10.0  # a stretch that a reason names although the rest of the flight is enough for a verdict (our choice)
NEVER_FLEW = "never airborne: no armed flight with thrust"
Show: TypeAlias = Callable[[Chain, Sequence[Piece]], None]
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

    maximum: highest judged statistic, or None. alarms: its events on all axes. decides: its alarm is a fault by itself.
    not_judged: why it did not judge for the longest. judged_s, outside_s: time judged, and outside of the envelope [s].
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

    @property
    def ratio(self) -> float:
        """The highest statistic over its threshold; 0 if it never judged."""
        return (self.maximum or 0.0) / self.threshold


@dataclass(frozen=True, slots=True)
class LogVerdict(Tabular):
    """The verdict on one log. rate_hz: of the gyro. changes: the decision's log.

    flown_s: in the air, without take-offs and landings; what nobody could judge, as without a gyro, is in it.
    judged_s: how much of it any monitor that decides about propellers judged.
    notes: what a reader must know of the log or the baseline, one sentence each; the reason has them, too.
    kind, since_s: the gravest kind of fault that was declared, and when it was, of the vehicle's clock.
    rotor: named last, by a fault or else by a suspicion.
    """

    log: str
    verdict: Verdict
    reason: str
    judged_s: float = 0.0
    flown_s: float = 0.0
    profile: str = ""
    rate_hz: float = 0.0
    monitors: tuple[MonitorSummary, ...] = ()
    events: tuple[Event, ...] = ()
    changes: tuple[Change, ...] = ()
    notes: tuple[str, ...] = ()
    kind: FaultKind | None = None
    since_s: float | None = None
    rotor: int | None = None
    rotors: tuple[RotorSpan, ...] = ()

    def columns(self) -> dict[str, list[Any]]:
        """What each monitor said."""
        return {
            "monitor": [f"{one.name} {one.axis or ''}".strip() for one in self.monitors],
            "maximum": [one.maximum for one in self.monitors],
            "threshold": [one.threshold for one in self.monitors],
            "ratio": [one.ratio for one in self.monitors],
            "unit": [one.unit for one in self.monitors],
            "alarms": [one.alarms for one in self.monitors],
            "judged [s]": [one.judged_s for one in self.monitors],
            "not judged": [one.not_judged for one in self.monitors],
        }

    def __str__(self) -> str:
        return f"{self.log}: {self.verdict.value}, {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFlight:
    """A verdict and what the chain showed on the way; chain is None if the log could not be judged at all.

    unjudged: stretches of flight that were not judged. hidden: of these, where no rows came.
    """

    verdict: LogVerdict
    chain: Chain | None = None
    pieces: tuple[Piece, ...] = ()
    unjudged: tuple[Stretch, ...] = ()
    hidden: tuple[Stretch, ...] = ()


def judge(log: Log, baseline: Baseline, judged_share: float = JUDGED_SHARE) -> LogVerdict:
    """Run the chain over a log. A log that the baseline cannot judge is `not_judgeable`, with the reason.

    judged_share: of the flown time that must be judged before a flight is called healthy, 0..1.
    """
    return judge_in_full(log, baseline, judged_share, keep=False).verdict


def judge_in_full(
    log: Log, baseline: Baseline, judged_share: float = JUDGED_SHARE, *, keep: bool = True, show: Show | None = None
) -> JudgedFlight:
    """As `judge`, and keep all that `mavdiag.traces` draws from; it takes as much memory as the rows.

    show: is called with each piece at once, which takes no memory with keep=False.
    """

    def refused(reason: str, rate_hz: float = 0.0) -> JudgedFlight:
        return JudgedFlight(LogVerdict(log.name, Verdict.NOT_JUDGEABLE, reason, profile=log.profile, rate_hz=rate_hz))

    log = onward(log)
    try:
        dt_s, _ = measure_grid(log.telemetry)
    except InputError as error:
        return refused(f"{error}; see `mavdiag look`")
    chain = chain_of(suited(baseline, log), log.started_ns, log.profile)
    if refusal := chain.refusal(log.telemetry, mean_s=dt_s):
        return refused(refusal, 1 / dt_s)
    run = _Run(log, chain, judged_share, keep, show)
    alike = run.likeness.sentence(baseline.airframe.name)
    if run.likeness.outcome is Outcome.FAR:
        return refused(alike, 1 / dt_s)
    notes = (*((alike,) if alike else ()), *log.notes, *_layout_notes(log, baseline))
    hidden = tuple((round(one.begin_s * NS_PER_S), round(one.end_s * NS_PER_S)) for one in run.hidden)
    unjudged = tuple(sorted((*run.state.memory.unjudged, *hidden)))
    return JudgedFlight(run.verdict(notes, 1 / dt_s), chain, tuple(run.kept), unjudged, hidden)


def playable(baseline: Baseline, log: Log, from_s: float = 0.0) -> Baseline:
    """The baseline as `suited`. Raises BaselineError, with the log's name, if it is for another link than the log's.

    from_s: into the log, where it begins to play. Raises UsageError if that is beyond its end.
    """
    t_ns = log.telemetry.need(Signal.BODY_RATE).t_ns
    span_s = float(np.max(t_ns) - np.min(t_ns)) / NS_PER_S if len(t_ns) else 0.0
    if not from_s <= span_s:
        raise UsageError(f"--from {from_s:g}: {log.name} has {span_s:.1f} s; begin within it")
    fitting = suited(baseline, log)
    if refusal := chain_of(fitting, log.started_ns, log.profile).refusal(log.telemetry):
        raise BaselineError(f"{log.name}: {refusal}")
    return fitting


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Exit code of a scan: the first of 2 error, 1 fault, 4 suspected, 3 not judgeable that occurs, else 0."""
    order = ((Verdict.ERROR, 2), (Verdict.FAULT, 1), (Verdict.SUSPECTED, 4), (Verdict.NOT_JUDGEABLE, 3))
    return next((code for verdict, code in order if verdict in verdicts), 0)


def _layout_notes(log: Log, baseline: Baseline) -> tuple[str, ...]:
    own, said = baseline.airframe.layout, layout_from_parameters(log.parameters, log.mav_type)
    other = own is not None and said.layout is not None and not said.layout.alike(own)
    differ = f"the log is of another rotor layout: {said.layout.name} by {said.reason}" if other and said.layout else ""
    return tuple(note for note in (baseline.layout_doubt, differ) if note)


class _Run:
    def __init__(self, log: Log, chain: Chain, judged_share: float, keep: bool, show: Show | None) -> None:
        if not 0 <= judged_share <= 1:
            raise UsageError(f"judged_share must be 0 to 1, not {judged_share}")
        self.log, self.chain, self.judged_share, self.keep, self.show = log, chain, judged_share, keep, show
        self.state, self.likeness = chain.start(), Likeness(Outcome.ALIKE)
        self.changes, self.kept = list[Change](), list[Piece]()
        self._found, self._motion, self._spans = list[Event](), list[FloatArray](), list[Stretch]()
        for part in chain.front.pieces(in_pieces(log.telemetry, PIECE_ROWS)):
            if isinstance(part, Rows) and len(part.block):
                first, last = int(part.block.t_ns[0]), int(part.block.t_ns[-1])
                if self._spans and first - self._spans[-1][1] <= NS_PER_S:
                    first, _ = self._spans.pop()
                self._spans.append((first, last))
                self._motion.append(motion_of(part.block))
            self._take(chain.judge(self.state, (part,)))
            if self.likeness.outcome is Outcome.FAR:
                return
        if self.state.beginning is not None and not self.state.beginning.whole:
            self.likeness = self.state.beginning.likeness()
        self._take(chain.finish(self.state))
        self._settle()

    def _take(self, output: ChainOutput) -> None:
        self.likeness = output.likeness or self.likeness
        self._found += output.events
        self.changes += output.changes
        self.kept += [piece.shrunk() for piece in output.pieces] if self.keep else ()
        if self.show is not None:
            self.show(self.chain, output.pieces)

    def _settle(self) -> None:
        latest = {(event.monitor, event.axis, event.start_ns): event for event in self._found}
        self.events = sorted(latest.values(), key=lambda event: (event.start_ns, event.monitor, str(event.axis)))
        self.monitors = _summaries(self.chain, self.state.accounts, self.events)
        self.upset, front = upset_in(self._motion), self.chain.front
        self.hidden = hidden_flight(self.log.telemetry, front.gate, front.align.quality, self._spans)
        faults = (change for change in self.changes if change.stage is Stage.FAULT)
        # Of the gravest kind the first one.
        self.fault = max(faults, key=lambda one: -1 if one.kind is None else one.kind.rank, default=None)
        memory, dt_s = self.state.memory, self.chain.kernel.dt_s
        self.chain.kernel.restart(memory)  # what no value reaches any more is not judged
        self.flown_s = memory.flown * dt_s + sum(one.end_s - one.begin_s for one in self.hidden)
        self.judged_s = min(memory.judged * dt_s, self.flown_s)
        self.takeoff_s = (memory.rows - memory.flown) * dt_s

    def verdict(self, notes: tuple[str, ...], rate_hz: float) -> LogVerdict:
        kind, since = (None, None) if self.fault is None else (self.fault.kind, self.fault.t_ns / NS_PER_S)
        verdict, reason = self._answer()
        if kind is None and verdict is Verdict.FAULT and self.upset is not None:
            kind, since = FaultKind.LOSS_OF_CONTROL, self.upset.begin_s
        rotors = self.changes[-1].rotors if self.changes else ()
        return LogVerdict(
            self.log.name,
            verdict,
            "; ".join((reason, *notes)),
            self.judged_s,
            self.flown_s,
            self.log.profile,
            rate_hz,
            self.monitors,
            tuple(self.events),
            tuple(self.changes),
            notes,
            kind,
            since,
            rotors[-1].rotor if rotors else self._suspected_rotor() if verdict is Verdict.SUSPECTED else None,
            rotors,
        )

    def _answer(self) -> tuple[Verdict, str]:
        """A fault if one was declared or the flight has an upset, healthy only if enough of it was judged."""
        upset, share = "" if self.upset is None else self.upset.text, self._share()
        if self.fault is not None:
            told = fault_reason(self.fault.kind, self.changes, self.events) + self._when(self.fault.t_ns)
            return Verdict.FAULT, "; ".join(filter(None, (told, upset, share)))
        if upset:
            return Verdict.FAULT, f"{FaultKind.LOSS_OF_CONTROL}: {upset}; {share}"
        if self.flown_s == 0:
            only = f"only {self.takeoff_s:.1f} s of take-off or start" if self.takeoff_s else NEVER_FLEW
            return Verdict.NOT_JUDGEABLE, only
        if suspicion := self._suspicion():
            parts = suspicion, inspect_words(self._suspected_rotor()), share
            return Verdict.SUSPECTED, "; ".join(filter(None, parts))
        if self.judged_s < self.judged_share * self.flown_s:
            return Verdict.NOT_JUDGEABLE, share
        if self.judged_s < MIN_JUDGED_S:
            return Verdict.NOT_JUDGEABLE, f"too little flight: {share}"
        return Verdict.HEALTHY, f"no alarm; {share}"

    def _suspected_rotor(self) -> int | None:
        named = (change.rotor for change in reversed(self.changes) if change.stage is Stage.SUSPECTED)
        return next((rotor for rotor in named if rotor is not None), None)

    def _suspicion(self) -> str:
        """What was suspected though no fault was declared; empty if nothing was."""
        if self.events:
            names = ", ".join(dict.fromkeys(event.monitor for event in self.events))
            count = f"{counted(len(self.events), 'alarm')} of {names}"
            single = all(not monitor.decides for monitor in self.monitors if monitor.alarms)
            own = ", which decides nothing alone" if single else ""
            return f"{count}{own}{self._when(self.events[0].start_ns)}"
        near = next((change for change in self.changes if change.stage is Stage.SUSPECTED), None)
        if near is None:
            return ""
        peaks = [one.ratio for one in self.monitors if (one.name, one.axis) == (near.monitor, near.axis)]
        ratio, axis = max([near.statistic / near.threshold, *peaks]), f" on {near.axis}" if near.axis else ""
        return f"{near.monitor}{axis} came to {100 * ratio:.0f} % of its threshold{self._when(near.t_ns)}"

    def _share(self) -> str:
        share = self.judged_s / self.flown_s if self.flown_s else 0.0
        own = [one for one in self.monitors if one.decides and by_name(one.name).kind is FaultKind.PROPELLER]
        spoke = [one for one in own if one.judged_s > (MOSTLY * self.judged_s if one.not_judged else 0.0)]
        text = f"judged {self.judged_s:.1f} s of {self.flown_s:.1f} s ({100 * share:.0f} %)"
        text += f" by {', '.join(one.name for one in spoke)}" if spoke else ""
        text += f", without {self.takeoff_s:.1f} s of take-off or start" if self.takeoff_s >= 0.1 else ""
        why = [f"{one.reason} {self._between(one.begin_s, one.end_s)}" for one in self.hidden]
        short = share < self.judged_share  # then the monitors' reasons follow
        lacking = [one for one in own if one not in spoke or (one.not_judged and short)]
        cause = "" if not own or (short and lacking) else max(own, key=lambda one: one.judged_s).not_judged or WAITING
        spans = [(begin / NS_PER_S, end / NS_PER_S) for begin, end in self.state.memory.unjudged if share > 0]
        spans = [span for span in spans if span[1] - span[0] >= (MIN_JUDGED_S if short else LONG_S)]
        longest = sorted(spans, key=lambda span: span[0] - span[1])[:MOST_STRETCHES]
        why += [f"nothing judged {self._between(*span)}{f' ({cause})' if cause else ''}" for span in sorted(longest)]
        judged = [f"; it judged {one.judged_s:.0f} s" if one.judged_s >= MIN_JUDGED_S else "" for one in lacking]
        reasons = [f"{m.name} ({m.not_judged}{s})" for m, s in zip(lacking, judged, strict=True)]
        why += [f"not judged by {', '.join(reasons)}"] if reasons else []
        return f"{text}{': ' if short else '; '}{'; '.join(why)}" if why else text

    def _when(self, t_ns: int) -> str:
        t_s, begin_s = t_ns / NS_PER_S, self._begin_s
        into = f" of the vehicle's clock, {t_s - begin_s:.1f} s into the log" if begin_s >= 1 else ""
        return f", first at {t_s:.2f} s{into}"

    def _between(self, begin_s: float, end_s: float) -> str:
        last_s = max(int(np.max(series.t_ns)) for series in self.log.telemetry.series if len(series)) / NS_PER_S
        clock = " of the vehicle's clock" if self._begin_s >= 1 else ""
        return f"from {begin_s:.1f} s" + ("" if end_s > last_s - 1.0 else f" to {end_s:.1f} s") + clock

    @property
    def _begin_s(self) -> float:
        return float(np.min(self.log.telemetry.need(Signal.BODY_RATE).t_ns)) / NS_PER_S


def _summaries(chain: Chain, accounts: Sequence[Account], events: Sequence[Event]) -> tuple[MonitorSummary, ...]:
    nearest: dict[str, MonitorSummary] = {}
    for slot, account in zip(chain.slots, accounts, strict=True):
        name, axis = slot.key
        alarms = sum(event.monitor == name for event in events)
        highest = (account.peak, slot.threshold, slot.monitor.unit, alarms, account.judged_s)
        one = MonitorSummary(name, axis, *highest, why_not(chain, account), slot.decides, account.outside_s)
        if name not in nearest or one.ratio > nearest[name].ratio:
            nearest[name] = one
    return tuple(nearest.values())


def why_not(chain: Chain, account: Account) -> str | None:
    """Why a slot did not judge: the reason that cost most time. One that judged and only warmed up has none."""
    sentence = {one.condition: one.sentence for one in chain.baseline.envelope}
    outside = {sentence[condition](one.value): one.span_s for condition, one in account.outside.items()}
    reasons = {**(account.not_judged if account.judged_s == 0 else {}), **account.missing, **outside}
    if not reasons or max(reasons.values()) < MIN_JUDGED_S:
        return "no flight" if account.flight_s == 0 else None if account.judged_s else "too short a flight"
    return max(reasons, key=lambda reason: reasons[reason])
