"""The time from a sample's arrival to its verdict: each sample once, none for those that are never judged."""

import numpy as np
import pytest

from detector.metrics import BOUNDS_S, Awaiting, LatencyCounts
from mavdiag.telemetry import Series, Signal

MS = 1_000_000


def gyro(*ms: int) -> Series:
    """Samples of these vehicle times, which come 5 ms later on a clock that is 1 s ahead."""
    t_ns = np.array(ms, dtype=np.int64) * MS
    return Series(Signal.BODY_RATE, t_ns, t_ns + 1005 * MS, np.zeros((len(t_ns), 3)))


def test_a_sample_is_counted_once_when_the_judged_time_has_reached_it() -> None:
    awaiting = Awaiting()
    assert awaiting.step(gyro(0, 10, 20), None, 1030 * MS).tolist() == []
    assert awaiting.step(gyro(30), 10 * MS, 1040 * MS).tolist() == [1005 * MS, 1015 * MS]
    assert awaiting.step(None, 30 * MS, 1050 * MS).tolist() == [1025 * MS, 1035 * MS]
    assert awaiting.step(None, 30 * MS, 1060 * MS).tolist() == []


def test_the_histogram_counts_each_latency_in_its_bin() -> None:
    counts = LatencyCounts()
    counts.add(np.array([0, 55 * MS, 1500 * MS], dtype=np.int64), 2000 * MS)
    counts.add(np.array([], dtype=np.int64), 2000 * MS)
    assert counts.counts.sum() == 3
    assert counts.counts[-1] == 2  # beyond the last bound
    assert counts.counts[BOUNDS_S.index(0.5)] == 1
    assert counts.sum_s == pytest.approx(2.0 + 1.945 + 0.5)
