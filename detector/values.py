"""What goes into a session and what comes out of it: closed, frozen values. The daemon has one action for each effect."""

from dataclasses import dataclass, field
from typing import TypeAlias

from detector.states import State
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Event
from mavdiag.link.messages import Severity
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import Axis, Telemetry

__all__ = [
    "Ack",
    "AskInterval",
    "BaselineLearned",
    "Effect",
    "EventClosed",
    "EventOpened",
    "Inbox",
    "Learn",
    "Learned",
    "LearningFailed",
    "Note",
    "Record",
    "SendFloat",
    "SendText",
    "SessionSpec",
    "StageChanged",
    "StateChanged",
    "TextSuppressed",
]


@dataclass(frozen=True, slots=True, eq=False)
class SessionSpec:
    """What a session is to do.

    profile: how the vehicle speaks.
    baseline: what it judges by; None to learn one.
    learn_s: how much flight it learns from [s].
    min_rate_hz: slowest gyro and set-point streams that will do.
    ask_hz: rate to ask for when learning; None for the profile's own.
    negotiate: whether to ask for streams at all.
    link_lost_s: silence that means that the link is lost.
    clear_s: quiet time that ends an alert.
    takeoff_s: time after a take-off in which no alert is raised.
    suspect: monitors ("fsd", or "fsd.pitch" for one axis) that only raise a suspicion.
    texts_per_minute: budget of texts.
    named_values_hz: rate of the NAMED_VALUE_FLOATs.
    named_values_axis: whose figures they carry.
    """

    profile: Profile
    baseline: Baseline | None = None
    learn_s: float = 60.0
    min_rate_hz: float = 45.0
    ask_hz: float | None = None
    negotiate: bool = True
    link_lost_s: float = 3.0
    clear_s: float = 5.0
    takeoff_s: float = 3.0
    suspect: tuple[str, ...] = ()
    texts_per_minute: int = 30
    named_values_hz: float = 5.0
    named_values_axis: Axis = Axis.ROLL


@dataclass(frozen=True, slots=True)
class Ack:
    """A COMMAND_ACK from the autopilot. It does not say which message it was for."""

    command: int
    result: int


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """The answer to `Learn`: a baseline."""

    baseline: Baseline


@dataclass(frozen=True, slots=True)
class LearningFailed:
    """The answer to `Learn`: why there is no baseline, in one line."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Inbox:
    """What came for one vehicle since the last step.

    telemetry: its samples.
    alive: whether any frame of its autopilot came.
    reboots: of the vehicle, all so far.
    acks: its autopilot's acknowledgements.
    outcome: what came of the last `Learn`.
    """

    telemetry: Telemetry = field(default_factory=Telemetry)
    alive: bool = False
    reboots: int = 0
    acks: tuple[Ack, ...] = ()
    outcome: Learned | LearningFailed | None = None


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
class StageChanged:
    """The decision went from one stage to another."""

    change: Change


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


Record: TypeAlias = (
    SendText | StateChanged | StageChanged | EventOpened | EventClosed | TextSuppressed | Note | BaselineLearned
)
Effect: TypeAlias = Record | SendFloat | AskInterval | Learn
