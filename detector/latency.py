"""How long a gyro sample waits: until a look takes it, and until its verdict; each sample counts in a histogram.

The second is longer by what the filter waits for, half of its window, and by what the chain gathers before it judges.
"""

from dataclasses import dataclass, field

import numpy as np

from mavdiag.telemetry import IntArray, Series
from mavdiag.units import NS_PER_S

__all__ = ["BOUNDS_S", "Awaiting", "LatencyCounts"]

BOUNDS_S = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.15, 0.2, 0.5, 1.0)  # upper ends of the bins
MOST = 8192  # samples that may wait for their verdict: several seconds (our choice)
FORGET_NS = NS_PER_S  # a sample without a verdict for so long gets none: nothing is judged (our choice)


def _none() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Awaiting:
    """Samples that came and are not yet judged.

    t_ns: (n,) vehicle clock.
    host_ns: (n,) when they came.
    """

    t_ns: IntArray = field(default_factory=_none)
    host_ns: IntArray = field(default_factory=_none)

    def step(self, gyro: Series | None, judged_ns: int | None, now_ns: int) -> tuple["Awaiting", IntArray]:
        """Take in new samples; return when those came that have their verdict now.

        judged_ns: the vehicle's time up to which was judged, None for nothing. now_ns: host clock.
        """
        t_ns, host_ns = self.t_ns, self.host_ns
        if gyro is not None and len(gyro):
            t_ns, host_ns = np.append(t_ns, gyro.t_ns)[-MOST:], np.append(host_ns, gyro.host_ns)[-MOST:]
        fresh = host_ns >= now_ns - FORGET_NS
        if judged_ns is None:
            return Awaiting(t_ns[fresh], host_ns[fresh]), _none()
        judged = t_ns <= judged_ns
        left = fresh & ~judged
        return Awaiting(t_ns[left], host_ns[left]), host_ns[judged & fresh]


class LatencyCounts:
    """A histogram with the bins of `BOUNDS_S` and one beyond.

    counts: samples in each bin.
    sum_s: of all latencies.
    """

    def __init__(self) -> None:
        self.counts = np.zeros(len(BOUNDS_S) + 1, dtype=np.int64)
        self.sum_s = 0.0

    def copy(self) -> "LatencyCounts":
        """The same, which later samples do not change."""
        same = LatencyCounts()
        same.counts, same.sum_s = self.counts.copy(), self.sum_s
        return same

    def add(self, arrived_ns: IntArray, now_ns: int) -> None:
        """Count samples that came at these times and are judged now (host clock)."""
        if len(arrived_ns):
            latency_s = (now_ns - arrived_ns) / NS_PER_S
            bins = np.searchsorted(BOUNDS_S, latency_s)
            self.counts += np.bincount(bins, minlength=len(self.counts))
            self.sum_s += float(latency_s.sum())
