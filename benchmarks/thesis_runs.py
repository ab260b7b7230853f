"""Runs of the free-run residual above the healthy margin in whole records (T 4.4.3), for tables of the thesis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, lfiltic

from mavdiag.errors import InputError
from mavdiag.identify import ArxModel
from mavdiag.monitors.base import segments
from mavdiag.monitors.run_length import MarginRule
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """The residual of one segment: t_ns, r [rad/s], valid: (n,)."""

    t_ns: IntArray
    r: FloatArray
    valid: BoolArray
    dt_s: float


@dataclass(frozen=True, slots=True)
class Run:
    """One run: first and last row (vehicle time), FSD [s], highest |r| - margin [rad/s]."""

    start_ns: int
    end_ns: int
    fsd_s: float
    peak: float


def exceedances(r: FloatArray, valid: BoolArray, margin: float, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """FSD so far [s] and highest |r| - margin so far, (n,), of whole records; 0 outside of runs.

    A run is a stretch of consecutive judged rows with |r| > margin; a row that must not be judged ends it.

    >>> fsd_s, peak = exceedances(np.array([0.0, 2.0, -3.0, 0.5, 4.0]), np.ones(5, dtype=bool), margin=1.0, dt_s=0.1)
    >>> fsd_s.tolist(), peak.tolist()
    ([0.0, 0.1, 0.2, 0.0, 0.1], [0.0, 1.0, 2.0, 0.0, 3.0])
    """
    excess = np.abs(r) - margin
    count, peak = np.zeros(len(r)), np.zeros(len(r))
    for first, stop in spans(valid & (excess > 0)):
        count[first:stop] = np.arange(1, stop - first + 1)
        peak[first:stop] = np.maximum.accumulate(excess[first:stop])
    return count * dt_s, peak


def runs(residual: Residual, margin: float) -> tuple[Run, ...]:
    """The runs above the margin in one segment, in order of time."""
    fsd_s, peak = exceedances(residual.r, residual.valid, margin, residual.dt_s)
    t_ns = residual.t_ns
    return tuple(
        Run(int(t_ns[first]), int(t_ns[stop - 1]), float(fsd_s[stop - 1]), float(peak[stop - 1]))
        for first, stop in spans(fsd_s > 0)
    )


def longest_runs(flights: Sequence[Sequence[Residual]], margin: float) -> FloatArray:
    """Longest run above the margin of each flight [s]; the largest of them is the FML of the thesis."""
    return np.array(
        [max((run.fsd_s for one in flight for run in runs(one, margin)), default=0.0) for flight in flights]
    )


def margin_of(flights: Sequence[Sequence[Residual]], rule: MarginRule = MarginRule.PERCENTILE_90) -> float:
    """Margin [rad/s] over all judged rows of all flights. Raises InputError if there are none.

    The percentile is Hazen's, which MATLAB's prctile uses.
    """
    pooled = np.concatenate([np.empty(0), *(np.abs(one.r[one.valid]) for flight in flights for one in flight)])
    if len(pooled) == 0:
        raise InputError("the healthy flights have no judged rows: are they long enough and airborne?")
    return float(pooled.max() if rule is MarginRule.MAXIMUM else np.percentile(pooled, 90, method="hazen"))


def residuals(flight: Sequence[Rows], axis: Axis, model: ArxModel) -> list[Residual]:
    """Free-run residual of each segment of a flight."""
    found = []
    for segment in segments(flight):
        rates = [rows.rates for rows in segment if len(rows.rates)]
        if rates:
            t_ns, valid = (np.concatenate([getattr(one, name) for one in rates]) for name in ("t_ns", "commanded"))
            u, y = (np.concatenate([getattr(one, name)[:, axis.column] for one in rates]) for name in ("u", "y"))
            past_u, past_y = np.full(len(model.b), u[0]), np.full(len(model.a), np.nan_to_num(y[0]))
            simulated, _ = lfilter(model.b, model.a, u, zi=lfiltic(model.b, model.a, past_y, past_u))
            found.append(Residual(t_ns, y - simulated, valid, rates[0].dt_s))
    return found
