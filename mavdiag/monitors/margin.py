"""What healthy flights allow: the margin on |r| and the fault minimal latency FML (T 4.4.3-4.4.5, 5.5.1).

Margin: the 90th percentile of |r| over all healthy flights (T text and Fig 4.1; the default), or its maximum (T
Algorithm 1). The percentile interpolates by Hazen's definition, which is what MATLAB's prctile uses.
FML: the longest run above the margin in any of the healthy flights. **Its price:** the next healthy flight of equal
length has the longest run of all n + 1 with probability 1/(n + 1), so that is the false-alarm probability per flight,
by construction and whatever the airframe. n = 3 gives 0.25, n = 60 gives 0.016; bounding it by 5 % with 95 %
confidence needs n >= 59 (METHOD section 4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.errors import InputError
from mavdiag.monitors.exceedance import exceedance, runs, start
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["MarginRule", "ResidualPiece", "false_alarms_per_flight", "latency_of", "margin_of"]


class MarginRule(StrEnum):
    """How the margin follows from the healthy |r|."""

    PERCENTILE_90 = "p90"
    MAXIMUM = "max"


@dataclass(frozen=True, slots=True, eq=False)
class ResidualPiece:
    """The residual of one segment of a flight. t_ns, r [rad/s], valid: (n,)."""

    t_ns: IntArray
    r: FloatArray
    valid: BoolArray
    dt_s: float


def margin_of(flights: Sequence[Sequence[ResidualPiece]], rule: MarginRule = MarginRule.PERCENTILE_90) -> float:
    """Margin [rad/s] over all judged rows of all flights. Raises InputError if there are none."""
    levels = [np.abs(piece.r[piece.valid]) for flight in flights for piece in flight]
    pooled = np.concatenate(levels) if levels else np.empty(0)
    if len(pooled) == 0:
        raise InputError("the healthy flights have no judged rows: are they long enough and airborne?")
    if rule is MarginRule.MAXIMUM:
        return float(pooled.max())
    return float(np.percentile(pooled, 90, method="hazen"))


def latency_of(flights: Sequence[Sequence[ResidualPiece]], margin: float) -> FloatArray:
    """Longest run above the margin of each flight [s]; the FML is the largest of them."""
    return np.array([max((_longest(piece, margin) for piece in flight), default=0.0) for flight in flights])


def false_alarms_per_flight(flights: int) -> float:
    """Probability that a healthy flight beats the longest run of `flights` equal healthy ones: 1/(n + 1)."""
    return 1.0 / (flights + 1)


def _longest(piece: ResidualPiece, margin: float) -> float:
    _, trace = exceedance(start(), piece.r, piece.valid, margin=margin, dt_s=piece.dt_s)
    return max((run.fsd_s for run in runs(trace, piece.t_ns)), default=0.0)
