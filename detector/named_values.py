"""The figures of the thesis rule as NAMED_VALUE_FLOAT, a few times a second.

PF_RES  [rad/s] residual of largest magnitude since the last one sent, as sampled once a step
PF_MARG [rad/s] its margin
PF_FSD  [s] longest fault signature duration since the last one sent, as sampled once a step
PF_FML  [s] its limit
"""

from dataclasses import dataclass, replace

from detector.values import SendFloat
from mavdiag.chain import ChainOutput
from mavdiag.kernel import Gauge
from mavdiag.telemetry import Axis, Instant

__all__ = ["NAMES", "NamedValues", "named_values"]

NAMES = ("PF_RES", "PF_MARG", "PF_FSD", "PF_FML")  # at most 10 bytes: NAMED_VALUE_FLOAT.name


@dataclass(frozen=True, slots=True)
class NamedValues:
    """What is sent next.

    period_s: how often.
    axis: whose figures; of another axis if that one is not judged.
    sent: when they were sent last (host).
    residual, fsd_s: extremes since then.
    """

    period_s: float = 0.2
    axis: Axis = Axis.ROLL
    sent: Instant | None = None
    residual: float = 0.0
    fsd_s: float = 0.0


def named_values(values: NamedValues, output: ChainOutput, now: Instant) -> tuple[NamedValues, tuple[SendFloat, ...]]:
    """Take in the gauges of a step; return the floats that are to be sent."""
    gauge = _selected(output.gauges, values.axis)
    if gauge is None or output.now_ns is None:
        return values, ()
    residual, fsd_s = max(values.residual, gauge.signal, key=abs), max(values.fsd_s, gauge.statistic)
    if values.sent is not None and now - values.sent < values.period_s:
        return replace(values, residual=residual, fsd_s=fsd_s), ()
    figures = (residual, gauge.reference, fsd_s, gauge.threshold)
    floats = tuple(SendFloat(name, value, output.now_ns) for name, value in zip(NAMES, figures, strict=True))
    return replace(values, sent=now, residual=0.0, fsd_s=0.0), floats


def _selected(gauges: tuple[Gauge, ...], axis: Axis) -> Gauge | None:
    """The thesis rule on the wanted axis, or on the first there is."""
    thesis = [gauge for gauge in gauges if gauge.monitor == "fsd"]
    return next((gauge for gauge in thesis if gauge.axis is axis), thesis[0] if thesis else None)
