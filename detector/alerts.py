"""What is said to the operator, how loudly and how often: a table, and a speaker that keeps to it.

A text is one STATUSTEXT of at most 50 bytes. A declared fault is CRITICAL, a suspicion or a detector that cannot work
is a WARNING, everything else INFO. A *lasting* matter is offered at every step: it is said when it begins, when what it
is about changes, and every `repeat_s` while it lasts. Anything else is offered once and said once. Nothing of a kind
is said twice within 2 s (MAVProxy drops identical texts within that time), and all texts of a vehicle keep to a budget
a minute, half of it for declared faults and half for the rest. What the budget holds back is counted and recorded.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from detector.effects import Effect, SendText, TextSuppressed
from mavdiag.decision.events import Event
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Instant

__all__ = [
    "GAP_S",
    "POLICY",
    "TEXT_BYTES",
    "Cause",
    "Kind",
    "Notice",
    "Policy",
    "Speaker",
    "evidence",
    "figure",
    "speak",
]

TEXT_BYTES = 50  # STATUSTEXT.text; Mission Planner and MAVROS do not put longer ones together
GAP_S = 2.0  # MAVProxy suppresses identical text within 2 s
MINUTE_S = 60.0


class Kind(StrEnum):
    """What a text is about."""

    FAULT = "fault"
    SUSPECT = "suspect"
    CLEARED = "cleared"
    UNSETTLED = "unsettled"
    WAITING = "waiting"
    LEARNING = "learning"
    FITTING = "fitting"
    LEARNED = "learned"
    MONITORING = "monitoring"
    LINK_LOST = "link lost"
    LINK_BACK = "link back"
    REBOOT = "reboot"
    OFF = "off"
    RATES = "rates"


@dataclass(frozen=True, slots=True)
class Policy:
    """How a kind is said. template: takes the notice's words; repeat_s: how often a lasting matter is said again, None
    for what is said once."""

    severity: Severity
    template: str
    repeat_s: float | None = None


# Repeat times are our choices; the severities follow what ground stations do with them (they pop up 0 to 3).
POLICY: Mapping[Kind, Policy] = {
    Kind.FAULT: Policy(Severity.CRITICAL, "PROP FAULT {} {}", 5.0),  # who, evidence
    Kind.SUSPECT: Policy(Severity.WARNING, "PROP suspect {} {}", 5.0),  # who, evidence
    Kind.CLEARED: Policy(Severity.INFO, "PROP clear after {}s max {}"),  # how long, evidence
    Kind.UNSETTLED: Policy(Severity.INFO, "PROP alert unjudged, max {}"),  # evidence
    Kind.WAITING: Policy(Severity.INFO, "PROP waiting: {}", 60.0),  # reason
    Kind.LEARNING: Policy(Severity.INFO, "PROP learning {}%{}", 60.0),  # progress, ": reason"
    Kind.FITTING: Policy(Severity.INFO, "PROP fitting the baseline"),
    Kind.LEARNED: Policy(Severity.INFO, "PROP baseline learned, FML {}s"),  # FML
    Kind.MONITORING: Policy(Severity.INFO, "PROP monitoring {}{}", 300.0),  # axes, ": reason"
    Kind.LINK_LOST: Policy(Severity.INFO, "PROP link lost"),
    Kind.LINK_BACK: Policy(Severity.INFO, "PROP link back after {}s"),  # how long
    Kind.REBOOT: Policy(Severity.INFO, "PROP vehicle rebooted, starting anew"),
    Kind.OFF: Policy(Severity.WARNING, "PROP OFF: {}", 60.0),  # reason
    Kind.RATES: Policy(Severity.INFO, "PROP got {}"),  # message and rate, ...
}


@dataclass(frozen=True, slots=True)
class Notice:
    """Something to say. words: fill the template; key: what a lasting matter is about (another key is news)."""

    kind: Kind
    words: tuple[str, ...] = ()
    key: str = ""

    @property
    def text(self) -> str:
        """The text, within `TEXT_BYTES`: free text that does not fit is cut, at a whole character."""
        text = POLICY[self.kind].template.format(*self.words)
        if len(text.encode()) <= TEXT_BYTES:
            return text
        return text.encode()[: TEXT_BYTES - 2].decode(errors="ignore").rstrip() + ".."


@dataclass(frozen=True, slots=True)
class Cause:
    """Who did it, as far as it is known. rotor: from 1; fault_type: F1 to F3; severity: 1 to 3 (T Tables 3.1, 3.2)."""

    rotor: int | None = None
    fault_type: str | None = None
    severity: int | None = None

    def who(self, event: Event) -> str:
        """Rotor and fault where known, else the axis.

        >>> Cause(1, "F2", 2).who(Event("latency", None, 0, None, 0.4, 0.1, 0.0))
        'r1 F2/SV2'
        """
        rotor = f"r{self.rotor}" if self.rotor is not None else ""
        level = f"/SV{self.severity}" if self.severity is not None else ""
        fault = f"{self.fault_type}{level}" if self.fault_type is not None else ""
        axis = event.axis.value if event.axis is not None else "vehicle"
        return " ".join(part for part in (rotor, fault) if part) or axis


# How a monitor's statistic and threshold are called and in what unit; another one goes by its name.
_LABELS: Mapping[str, tuple[str, str, str]] = {
    "latency": ("FSD ", "FML ", "s"),
    "effort": ("trim shift ", "", ""),
}
_NAME_CHARS = 9


def evidence(event: Event) -> str:
    """Statistic against threshold, with as many decimals as it takes to tell them apart.

    >>> evidence(Event("latency", None, 0, None, 0.41, 0.12, 0.0))
    'FSD 0.41s>FML 0.12s'
    >>> evidence(Event("latency", None, 0, None, 0.124, 0.121, 0.0))
    'FSD 0.124s>FML 0.121s'
    """
    one, other, unit = _LABELS.get(event.monitor, (f"{event.monitor[:_NAME_CHARS]} ", "", ""))
    found, limit = figure(event.statistic), figure(event.threshold)
    if found == limit:
        found, limit = figure(event.statistic, 3), figure(event.threshold, 3)
    return f"{one}{found}{unit}>{other}{limit}{unit}"


def figure(value: float, decimals: int = 2) -> str:
    """A number in at most six characters.

    >>> [figure(x) for x in (0.118, 12.345, 4321.0, 5e6, float("nan"))]
    ['0.12', '12.3', '4321', '>9999', '?']
    """
    if value != value:
        return "?"
    size = abs(value)
    if size >= 9999.5:
        return ">9999" if value > 0 else "<-9999"
    places = decimals if size < 9.995 else 1 if size < 99.95 else 0
    return f"{value:.{places}f}"


@dataclass(frozen=True, slots=True)
class _Said:
    kind: Kind
    key: str
    at: Instant


@dataclass(frozen=True, slots=True)
class _Sent:
    loud: bool
    at: Instant


@dataclass(frozen=True, slots=True)
class Speaker:
    """What was said lately. per_minute: the budget. held: matters that were held back and counted already."""

    per_minute: int = 30
    sent: tuple[_Sent, ...] = ()
    said: tuple[_Said, ...] = ()
    held: frozenset[tuple[Kind, str]] = frozenset()
    suppressed: int = 0


def speak(speaker: Speaker, notices: tuple[Notice, ...], now: Instant) -> tuple[Speaker, tuple[Effect, ...]]:
    """Say what is due of the notices of this step, loudest first."""
    out: list[Effect] = []
    speaker = replace(speaker, sent=tuple(one for one in speaker.sent if now - one.at < MINUTE_S))
    for notice in sorted(notices, key=lambda notice: POLICY[notice.kind].severity):
        if _due(speaker, notice, now):
            speaker, effect = _say(speaker, notice, now)
            out += () if effect is None else (effect,)
    # A lasting matter that was not offered is over: the next one is news again.
    offered = {notice.kind for notice in notices}
    said = tuple(one for one in speaker.said if one.kind in offered or not _forgettable(one, now))
    held = frozenset(one for one in speaker.held if one[0] in offered)
    return replace(speaker, said=said, held=held), tuple(out)


def _forgettable(said: _Said, now: Instant) -> bool:
    return now - said.at >= GAP_S


def _due(speaker: Speaker, notice: Notice, now: Instant) -> bool:
    """Whether a lasting matter has something to say; what is offered once always has."""
    repeat_s = POLICY[notice.kind].repeat_s
    last = next((one for one in speaker.said if one.kind is notice.kind), None)
    if repeat_s is None or last is None:
        return True
    return now - last.at >= (repeat_s if last.key == notice.key else GAP_S)


def _say(speaker: Speaker, notice: Notice, now: Instant) -> tuple[Speaker, Effect | None]:
    policy = POLICY[notice.kind]
    loud = policy.severity <= Severity.CRITICAL
    spent = sum(one.loud == loud for one in speaker.sent) >= speaker.per_minute // 2
    if spent or any(one.kind is notice.kind and now - one.at < GAP_S for one in speaker.said):
        matter = (notice.kind, notice.key)
        if policy.repeat_s is not None and matter in speaker.held:
            return speaker, None
        held = speaker.held | {matter} if policy.repeat_s is not None else speaker.held
        count = speaker.suppressed + 1
        return replace(speaker, suppressed=count, held=held), TextSuppressed(notice.text, count)
    said = (*(one for one in speaker.said if one.kind is not notice.kind), _Said(notice.kind, notice.key, now))
    held = frozenset(one for one in speaker.held if one[0] is not notice.kind)
    said_now = replace(speaker, said=said, held=held, sent=(*speaker.sent, _Sent(loud, now)))
    return said_now, SendText(policy.severity, notice.text)
