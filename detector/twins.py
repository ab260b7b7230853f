"""The alert's structured twin: residual, margin, FSD and FML as NAMED_VALUE_FLOAT, a few times a second.

    PF_RES  [rad/s] residual of largest magnitude since the last one sent      PF_MARG [rad/s] its margin
    PF_FSD  [s] longest fault signature duration since the last one sent       PF_FML  [s] its limit

Both figures are samples of the latest row of each step, so what is shorter than a step may be missed here; the events
miss nothing.
"""

from dataclasses import dataclass

from detector.effects import SendFloat
from mavdiag.pipeline import Findings, Level
from mavdiag.quantities import Axis, Instant

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


def tell(twins: Twins, findings: Findings, now: Instant) -> tuple[Twins, tuple[SendFloat, ...]]:
    """Take in a step's findings; return the floats that are due."""
    level = _of_axis(findings.levels, twins.axis)
    if level is None or findings.now_ns is None:
        return twins, ()
    residual = max(twins.residual, level.signal, key=abs)
    fsd_s = max(twins.fsd_s, level.statistic)
    if twins.sent is not None and now - twins.sent < twins.period_s:
        return Twins(twins.period_s, twins.axis, twins.sent, residual, fsd_s), ()
    values = (residual, level.reference, fsd_s, level.threshold)
    floats = tuple(SendFloat(name, value, findings.now_ns) for name, value in zip(NAMES, values, strict=True))
    return Twins(twins.period_s, twins.axis, now), floats


def _of_axis(levels: tuple[Level, ...], axis: Axis) -> Level | None:
    thesis = [level for level in levels if level.monitor == "latency"]
    return next((level for level in thesis if level.axis is axis), thesis[0] if thesis else None)
