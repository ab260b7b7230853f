"""Where the daemon stands at a moment: for the metrics, the health command and the service manager."""

from collections import Counter
from dataclasses import dataclass

from detector.fleet import VehicleFigures
from mavdiag.link.ports import Traffic

__all__ = ["DaemonFigures", "LinkFigures"]


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
        return not self.vehicles or any(one.working for one in self.vehicles)

    @property
    def status(self) -> str:
        """One line for a person."""
        states = Counter(one.state for one in self.vehicles)
        judged_s = sum(one.judged_s for one in self.vehicles)
        words = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
        return f"{words}; {judged_s:.0f} s judged" if words else "no vehicle was received yet"
