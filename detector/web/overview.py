"""All vehicles and links at a moment, as the live page lists them. Values in and out."""

from collections.abc import Mapping
from dataclasses import dataclass

from detector.figures import DaemonFigures
from detector.states import State
from detector.web.snapshot import Level

__all__ = ["FleetNow", "LinkLine", "VehicleLine", "fleet_now"]


@dataclass(frozen=True, slots=True)
class VehicleLine:
    """A vehicle; fields as in `Now` and `LinkNow`."""

    vehicle: int
    state: State
    level: Level
    sentence: str
    received: int
    lost: int


@dataclass(frozen=True, slots=True)
class LinkLine:
    """A link; the first is the vehicle's. Counts since the start, of messages and of datagrams."""

    address: str
    connected: bool
    sent: int
    dropped: int
    overflowed: int


@dataclass(frozen=True, slots=True)
class FleetNow:
    """late: looks that came too late. cpu_s: processor time of the daemon. refused: frames, by cause."""

    vehicles: tuple[VehicleLine, ...]
    links: tuple[LinkLine, ...]
    late: int
    cpu_s: float
    uptime_s: float
    refused: tuple[tuple[str, int], ...]


def fleet_now(figures: DaemonFigures, levels: Mapping[int, tuple[Level, str]], uptime_s: float) -> FleetNow:
    """levels: level and sentence of each vehicle, by system id. uptime_s: since the daemon began."""
    vehicles = tuple(
        VehicleLine(one.vehicle, one.state, *levels[one.vehicle], one.received, one.lost) for one in figures.vehicles
    )
    links = tuple(
        LinkLine(one.address, one.connected, one.traffic.sent, one.traffic.dropped, one.traffic.overflowed)
        for one in figures.links
    )
    return FleetNow(vehicles, links, figures.late, round(figures.cpu_s, 2), round(uptime_s, 1), figures.refused)
