"""Where the daemon and its vehicles stand at a moment: for the metrics, the page and the service manager."""

from collections import Counter
from dataclasses import dataclass, field

from detector.states import State
from mavdiag.decision.alarm import NOTHING_SEEN, Diagnosis
from mavdiag.link.clock import Timesync
from mavdiag.link.ports import Traffic


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """One vehicle at a moment; counts and times so far."""

    vehicle: int  # system id
    state: State
    received: int  # frames of its autopilot
    lost: int
    gyro_hz: float
    judged_s: float
    events: int
    flight_s: float = 0.0
    rates: tuple[tuple[str, float], ...] = ()  # measured rate of each stream that is metered [Hz]
    ratios: tuple[tuple[str, str, float], ...] = ()  # statistic over threshold of monitor and axis that are valid now
    timesync: Timesync = field(default_factory=Timesync)  # as asked last
    drift_ppm: float | None = None  # of the first clock of its messages against another; None if they have one clock
    diagnosis: Diagnosis = NOTHING_SEEN


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

    @property
    def working(self) -> bool:
        """Whether the daemon does its work or still may: not when all of its sessions are off."""
        return not self.vehicles or any(vehicle.state is not State.FAULTED for vehicle in self.vehicles)

    @property
    def status(self) -> str:
        """One line for a person."""
        states = Counter(vehicle.state for vehicle in self.vehicles)
        judged_s = sum(vehicle.judged_s for vehicle in self.vehicles)
        words = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
        return f"{words}; {judged_s:.0f} s judged" if words else "no vehicle was received yet"
