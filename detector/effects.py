"""What a session asks the daemon to do: closed, frozen values; the daemon has one handler for each."""

from dataclasses import dataclass
from typing import TypeAlias

from detector.states import State
from mavdiag.baseline import Baseline
from mavdiag.decision.events import Event
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Telemetry

__all__ = [
    "AskInterval",
    "BaselineLearned",
    "Effect",
    "EventClosed",
    "EventOpened",
    "Learn",
    "Note",
    "Record",
    "SendFloat",
    "SendText",
    "StateChanged",
    "TextSuppressed",
]


@dataclass(frozen=True, slots=True)
class SendText:
    """One STATUSTEXT, at most 50 bytes."""

    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class SendFloat:
    """One NAMED_VALUE_FLOAT. name: at most 10 bytes; vehicle_ns: the vehicle's time of the value."""

    name: str
    value: float
    vehicle_ns: int


@dataclass(frozen=True, slots=True)
class AskInterval:
    """MAV_CMD_SET_MESSAGE_INTERVAL to the vehicle's autopilot. interval_us: period [us]."""

    msgid: int
    interval_us: int


@dataclass(frozen=True, slots=True, eq=False)
class Learn:
    """Make a baseline from this healthy flight; the answer comes back in an inbox."""

    profile: str
    telemetry: Telemetry


@dataclass(frozen=True, slots=True)
class StateChanged:
    """The session went from one state to another."""

    old: State
    new: State
    reason: str


@dataclass(frozen=True, slots=True)
class EventOpened:
    """A monitor went above its threshold; its figures are those of that moment."""

    event: Event


@dataclass(frozen=True, slots=True)
class EventClosed:
    """The whole event. Its end_ns is None if the end was not seen."""

    event: Event


@dataclass(frozen=True, slots=True)
class TextSuppressed:
    """A text was held back by the rate limits. count: all of this session so far."""

    text: str
    count: int


@dataclass(frozen=True, slots=True)
class Note:
    """Anything else worth a line: what was asked and got, what was refused."""

    text: str


@dataclass(frozen=True, slots=True)
class BaselineLearned:
    """A baseline was made in flight: keep it if asked to."""

    baseline: Baseline


Effect: TypeAlias = (
    SendText
    | SendFloat
    | AskInterval
    | Learn
    | StateChanged
    | EventOpened
    | EventClosed
    | TextSuppressed
    | Note
    | BaselineLearned
)
Record: TypeAlias = SendText | StateChanged | EventOpened | EventClosed | TextSuppressed | Note | BaselineLearned
