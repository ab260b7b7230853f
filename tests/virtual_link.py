"""A vehicle's frames over a (bad) link into the daemon's fleet, on a virtual clock: what it hears, judges and says."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from detector.config import SessionSettings
from detector.fleet import Fleet
from detector.values import EventOpened, SendText, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Stage
from mavdiag.link.datagrams import as_columns
from mavdiag.link.sequence import LinkCount
from mavdiag.link.shim import Shim
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S

__all__ = ["Heard", "heard"]

START_NS = 1000 * NS_PER_S  # of the receiver's clock
TICK_NS = 40_000_000


@dataclass(slots=True)
class Heard:
    """What came of a flight; times are of the vehicle's clock [s], those of texts the receiver's."""

    declared: list[tuple[float, int | None]] = field(default_factory=list)
    texts: list[tuple[float, SendText]] = field(default_factory=list)
    events: int = 0
    judged_s: float = 0.0
    count: LinkCount | None = None


def heard(frames: Iterable[tuple[int, bytes]], baseline: Baseline, shim: Shim | None = None) -> Heard:
    """Send every frame at its time [ns] and let the fleet look at the link every 40 ms."""
    fleet = Fleet(
        lambda sysid, profile: SessionSpec(profile, baseline, SessionSettings(negotiate=False)),
        profile=None,
        only=None,
        datagrams=True,
    )
    found, waiting, now_ns = Heard(), list[bytes](), TICK_NS
    for t_ns, data in frames:
        while t_ns > now_ns:
            _look(fleet, found, waiting if shim is None else shim.due(now_ns), now_ns)
            waiting, now_ns = [], now_ns + TICK_NS
        if shim is None:
            waiting.append(data)
        else:
            shim.offer(data, t_ns)
    for _ in range(5):
        _look(fleet, found, waiting if shim is None else shim.due(now_ns), now_ns)
        waiting, now_ns = [], now_ns + TICK_NS
    for vehicle in fleet.vehicles.values():
        found.judged_s, found.count = vehicle.judged_s, vehicle.count
    return found


def _look(fleet: Fleet, found: Heard, messages: Iterable[bytes], now_ns: int) -> None:
    host_ns = START_NS + now_ns
    fleet.take(as_columns([(data, host_ns) for data in messages]), Instant(host_ns))
    for turn in fleet.judge(Instant(host_ns)):
        for effect in turn.effects:
            match effect:
                case SendText():
                    found.texts.append((now_ns / NS_PER_S, effect))
                case Change(stage=Stage.FAULT):
                    found.declared.append((effect.t_ns / NS_PER_S, effect.rotor))
                case EventOpened():
                    found.events += 1
