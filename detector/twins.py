"""The alert's structured twin: residual, margin, FSD and FML as NAMED_VALUE_FLOAT, a few times a second.

PF_RES  [rad/s] residual of largest magnitude since the last one sent, as sampled once a step
PF_MARG [rad/s] its margin
PF_FSD  [s] longest fault signature duration since the last one sent
PF_FML  [s] its limit
"""

from dataclasses import dataclass, replace

from detector.effects import SendFloat
from mavdiag.chain import Findings, Level, Watch
from mavdiag.telemetry import Axis, Instant

__all__ = ["NAMES", "NAME_BYTES", "Twins", "tell"]

NAME_BYTES = 10  # NAMED_VALUE_FLOAT.name
NAMES = ("PF_RES", "PF_MARG", "PF_FSD", "PF_FML")


@dataclass(frozen=True, slots=True)
class Twins:
    """What to say next. period_s: how often; axis: whose figures."""

    period_s: float = 0.2
    axis: Axis = Axis.ROLL
    sent: Instant | None = None
    residual: float = 0.0
    fsd_s: float = 0.0


def tell(
    twins: Twins, watches: tuple[Watch, ...], findings: Findings, now: Instant
) -> tuple[Twins, tuple[SendFloat, ...]]:
    """Take in a step's findings of these watches; return the floats that are due."""
    watch = _chosen(watches, twins.axis)
    level = None if watch is None else _level(findings.levels, watch)
    if watch is None or level is None or findings.now_ns is None:
        return twins, ()
    residual = max(twins.residual, level.signal, key=abs)
    fsd_s = max(twins.fsd_s, findings.peaks[watches.index(watch)])
    if twins.sent is not None and now - twins.sent < twins.period_s:
        return replace(twins, residual=residual, fsd_s=fsd_s), ()
    values = (residual, level.reference, fsd_s, level.threshold)
    floats = tuple(SendFloat(name, value, findings.now_ns) for name, value in zip(NAMES, values, strict=True))
    return replace(twins, sent=now, residual=0.0, fsd_s=0.0), floats


def _chosen(watches: tuple[Watch, ...], axis: Axis) -> Watch | None:
    """The thesis rule on the wanted axis, or on the first there is."""
    thesis = [watch for watch in watches if watch.monitor.name == "latency"]
    return next((watch for watch in thesis if watch.monitor.axis is axis), thesis[0] if thesis else None)


def _level(levels: tuple[Level, ...], watch: Watch) -> Level | None:
    of_watch = (one for one in levels if (one.monitor, one.axis) == (watch.monitor.name, watch.monitor.axis))
    return next(of_watch, None)
