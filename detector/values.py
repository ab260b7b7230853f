"""The values of a session: what it is told to do, what it is given, what it remembers, and how it changes state."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from detector.alerts import Notice, Speaker
from detector.collect import Collection
from detector.effects import Effect, StateChanged
from detector.judge import Alarm, Judge
from detector.negotiate import Ack, Negotiation
from detector.states import State, Trigger, advance
from detector.streams import Streams
from detector.twins import Twins
from mavdiag.baseline import Baseline
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import Axis, Instant, Telemetry

__all__ = ["Handler", "Inbox", "Learned", "LearningFailed", "Next", "Out", "SessionSpec", "SessionState", "move"]


@dataclass(frozen=True, slots=True, eq=False)
class SessionSpec:
    """What a session is to do. Without a baseline it learns one from `learn_s` seconds of flight.

    min_rate_hz: slowest streams that will do. ask_hz: rate to ask for when learning, None for the profile's own.
    negotiate: whether to ask at all. link_lost_s: silence that means it is lost. clear_s: quiet that ends an alert.
    suspect: monitors ("latency", or "latency.pitch" for one axis) that only raise a suspicion.
    """

    profile: Profile
    baseline: Baseline | None = None
    learn_s: float = 60.0
    min_rate_hz: float = 45.0
    ask_hz: float | None = None
    negotiate: bool = True
    link_lost_s: float = 3.0
    clear_s: float = 5.0
    suspect: tuple[str, ...] = ()
    texts_per_minute: int = 30
    twins_hz: float = 5.0
    twins_axis: Axis = Axis.ROLL


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
    """What came for one vehicle since the last step. heard: any frame came; reboots: of the vehicle, all so far."""

    telemetry: Telemetry = field(default_factory=Telemetry)
    heard: bool = False
    reboots: int = 0
    acks: tuple[Ack, ...] = ()
    outcome: Learned | LearningFailed | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SessionState:
    """All that a session remembers.

    reason: why it is where it is; heard: when the vehicle was heard last (host). waited: the latest telemetry that came
    while it waited; judging begins with it, as a scan of the recording does.
    """

    state: State
    reason: str
    heard: Instant
    baseline: Baseline | None
    speaker: Speaker
    twins: Twins
    streams: Streams = field(default_factory=Streams)
    negotiation: Negotiation = field(default_factory=Negotiation)
    collection: Collection = field(default_factory=Collection)
    waited: tuple[Telemetry, ...] = ()
    judge: Judge | None = None
    alarm: Alarm | None = None
    reboots: int = 0


Out: TypeAlias = Effect | Notice
Next: TypeAlias = tuple[SessionState, tuple[Out, ...]]
Handler: TypeAlias = Callable[[SessionSpec, SessionState, Inbox, Instant], Next]


def move(state: SessionState, trigger: Trigger, reason: str = "") -> tuple[SessionState, StateChanged]:
    """Go where the table says. reason: in place of the trigger's own words. Raises ValueError as `advance` does."""
    new, reason = advance(state.state, trigger), reason or trigger.value
    return replace(state, state=new, reason=reason), StateChanged(state.state, new, reason)
