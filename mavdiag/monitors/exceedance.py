"""Exceedance of the margin and its duration, the fault signature duration FSD (T 4.4.5, 5.5.1).

A run is a stretch of consecutive judged rows with |r| > margin; a row that must not be judged ends it. Its FSD is its
number of rows times the sample time. `step(state, rows) -> (state, traces)`; batch equals any chunking.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["ExceedState", "Exceedance", "Run", "exceedance", "runs", "start"]


@dataclass(frozen=True, slots=True)
class ExceedState:
    """Rows in the run that is still open, and its highest |r| - margin [unit of r]."""

    rows: int = 0
    peak: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Exceedance:
    """fsd_s: (n,) length so far of the run that each row is in, 0 outside of runs [s].

    peak: (n,) highest |r| - margin of that run so far, 0 outside of runs [unit of r].
    """

    fsd_s: FloatArray
    peak: FloatArray


@dataclass(frozen=True, slots=True)
class Run:
    """One finished or still open run: first and last row (vehicle time), FSD [s], highest |r| - margin."""

    start_ns: int
    end_ns: int
    fsd_s: float
    peak: float


def start() -> ExceedState:
    """No run is open."""
    return ExceedState()


def exceedance(
    state: ExceedState, r: FloatArray, valid: BoolArray, *, margin: float, dt_s: float
) -> tuple[ExceedState, Exceedance]:
    """Trace the runs through the next rows. r: (n,) residual; margin: in its unit.

    >>> import numpy as np
    >>> r, all_valid = np.array([0.0, 2.0, -3.0, 0.5, 4.0]), np.ones(5, dtype=bool)
    >>> state, trace = exceedance(start(), r, all_valid, margin=1.0, dt_s=0.1)
    >>> trace.fsd_s.tolist(), trace.peak.tolist(), state
    ([0.0, 0.1, 0.2, 0.0, 0.1], [0.0, 1.0, 2.0, 0.0, 3.0], ExceedState(rows=1, peak=3.0))
    """
    excess = np.abs(r) - margin
    above = valid & (excess > 0)
    if not above.any():
        nothing = np.zeros(len(r))
        return (ExceedState() if len(r) else state), Exceedance(nothing, nothing)
    count, peak = np.zeros(len(r)), np.zeros(len(r))
    for first, stop in _spans(above):
        carried = state if first == 0 else ExceedState()
        count[first:stop] = np.arange(carried.rows + 1, carried.rows + 1 + stop - first)
        peak[first:stop] = np.maximum(np.maximum.accumulate(excess[first:stop]), carried.peak)
    return ExceedState(int(count[-1]), float(peak[-1])), Exceedance(count * dt_s, peak)


def runs(trace: Exceedance, t_ns: IntArray) -> tuple[Run, ...]:
    """The runs of a whole trace, in order of time."""
    return tuple(
        Run(int(t_ns[first]), int(t_ns[stop - 1]), float(trace.fsd_s[stop - 1]), float(trace.peak[stop - 1]))
        for first, stop in _spans(trace.fsd_s > 0)
    )


def _spans(flags: BoolArray) -> list[tuple[int, int]]:
    """Half-open spans [first, stop) of True."""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
