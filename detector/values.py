"""What goes into a session and what comes out of it, and where daemon, links and vehicles stand. All are values."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from detector.config import SessionSettings
from detector.states import State
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import NOTHING_SEEN, Change, Diagnosis, Event
from mavdiag.link.clock import TimesyncMessage
from mavdiag.link.messages import Severity
from mavdiag.link.ports import Traffic
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import Telemetry


@dataclass(frozen=True, slots=True, eq=False)
class SessionSpec:
    """What a session is to do."""

    profile: Profile  # of the vehicle's link
    baseline: Baseline | None = None  # what it judges by; None to learn one
    settings: SessionSettings = field(default_factory=SessionSettings)
    unix_offset_ns: int = 0  # wall clock less the host's clock [ns]; 0 if the wall clock is not known
    held: Diagnosis = NOTHING_SEEN  # what is known of the vehicle from before: an open inspection


#: The answer to `Learn`: a baseline, or in one line why there is none.
FitOutcome: TypeAlias = Baseline | str


@dataclass(frozen=True, slots=True)
class SendText:
    """One STATUSTEXT, at most 50 bytes."""

    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class SendFloat:
    """One NAMED_VALUE_FLOAT."""

    name: str  # at most 10 bytes
    value: float
    vehicle_ns: int  # the vehicle's time of the value


@dataclass(frozen=True, slots=True)
class AskParameters:
    """PARAM_REQUEST_READ of some parameters of the vehicle's autopilot, by name."""

    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SendCommand:
    """A command (MAV_CMD) to the vehicle's autopilot, with up to seven parameters."""

    command: int
    parameters: tuple[float, ...]
    confirmation: int = 0  # how often it was sent before


@dataclass(frozen=True, slots=True, eq=False)
class Learn:
    """Make a baseline from this healthy flight; the outcome is given to a later step."""

    profile: str
    telemetry: Telemetry
    parameters: Mapping[str, float] = field(default_factory=dict)  # of its autopilot


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


#: What is worth a line in the journal. A `Change` is of the diagnosis, a `Baseline` was learned: keep it.
Record: TypeAlias = SendText | StateChanged | Change | EventOpened | EventClosed | TextSuppressed | Note | Baseline
Effect: TypeAlias = Record | SendFloat | AskParameters | SendCommand | Learn | TimesyncMessage


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """One vehicle at a moment; counts and times so far."""

    vehicle: int  # system id
    state: State
    received: int  # frames of its autopilot
    lost: int
    judged_s: float
    alarms: Mapping[str, int] = field(default_factory=dict)  # that were opened, by monitor
    flight_s: float = 0.0
    rates: tuple[tuple[str, float], ...] = ()  # measured rate of each stream that is metered [Hz]
    ratios: tuple[tuple[str, str, float], ...] = ()  # statistic over threshold of monitor and axis that are valid now
    round_trip_s: float | None = None  # of the last TIMESYNC that was answered
    drift_ppm: float | None = None  # of the first clock of its messages against another; None if they have one clock
    diagnosis: Diagnosis = NOTHING_SEEN

    @property
    def events(self) -> int:
        """All alarms."""
        return sum(self.alarms.values())


@dataclass(frozen=True, slots=True)
class LinkFigures:
    """One link."""

    address: str  # as it was opened
    connected: bool  # whether somebody is there, as far as this side can know
    traffic: Traffic


@dataclass(frozen=True, slots=True)
class DaemonFigures:
    """The daemon at a moment; counts so far."""

    vehicles: tuple[VehicleFigures, ...]
    links: tuple[LinkFigures, ...]  # the vehicle's, then those behind
    late: int  # looks at the links that came too late
    cpu_s: float
    lost_entries: tuple[tuple[str, int], ...] = ()  # what could not be written to each file, by option
    refused: tuple[tuple[str, int], ...] = ()  # frames of the vehicle's link that were not heard, by cause
    delay_s: float = 0.0  # longest that a vehicle waited for its turn lately, because there was much to do


def is_working(states: Collection[State]) -> bool:
    """Whether a daemon with sessions in these states works or still may: not when all of its sessions are off."""
    return not states or any(state is not State.FAULTED for state in states)
