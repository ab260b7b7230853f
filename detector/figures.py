"""Where the daemon and its vehicles stand at a moment: for the metrics, the page and the service manager."""

from collections import Counter
from dataclasses import dataclass

from detector.states import State
from mavdiag.decision.alarm import NOTHING_SEEN, Diagnosis
from mavdiag.link.ports import Traffic
from mavdiag.link.timesync import Timesync

NOT_ASKED = Timesync()


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """One vehicle at a moment.

    vehicle: system id.
    state: of its session.
    received, lost: its autopilot's frames, so far.
    gyro_hz: measured rate of the gyro.
    judged_s, events: so far.
    flight_s: flight time so far.
    rates: measured rate of each stream that is metered [Hz].
    ratios: statistic over threshold of each monitor and axis that is valid now.
    timesync: round trip and offset of the vehicle's clock, as asked last.
    drift_ppm: of the first clock of its messages against another one; None if they have one clock.
    diagnosis: what is held of it.
    """

    vehicle: int
    state: State
    received: int
    lost: int
    gyro_hz: float
    judged_s: float
    events: int
    flight_s: float = 0.0
    rates: tuple[tuple[str, float], ...] = ()
    ratios: tuple[tuple[str, str, float], ...] = ()
    timesync: Timesync = NOT_ASKED
    drift_ppm: float | None = None
    diagnosis: Diagnosis = NOTHING_SEEN


@dataclass(frozen=True, slots=True)
class LinkFigures:
    """One link. address: as it was opened; connected: whether somebody is there, as far as this side can know."""

    address: str
    connected: bool
    traffic: Traffic


@dataclass(frozen=True, slots=True)
class DaemonFigures:
    """The daemon at a moment.

    vehicles: those that are watched.
    links: the vehicle's, then those behind.
    late: looks at the links that came too late, so far.
    cpu_s: processor time so far.
    lost_entries: what could not be written to each file, so far, by option.
    refused: frames of the vehicle's link that were not heard, so far, by cause.
    delay_s: longest that a vehicle waited for its turn lately, because there was much to do.
    """

    vehicles: tuple[VehicleFigures, ...]
    links: tuple[LinkFigures, ...]
    late: int
    cpu_s: float
    lost_entries: tuple[tuple[str, int], ...] = ()
    refused: tuple[tuple[str, int], ...] = ()
    delay_s: float = 0.0

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
