"""Where the gyro's samples break off, and where rows go that are missing between them. Pure functions of times."""

import numpy as np

from mavdiag.telemetry import IntArray

__all__ = ["pieces", "uneven_places"]


def pieces(fresh: IntArray, last_ns: int | None, limit_ns: int) -> list[tuple[IntArray, bool]]:
    """Stretches of times (n,) [ns] without a step above the limit, and whether one lies before each."""
    if len(fresh) == 0:
        return []
    if last_ns is not None and fresh[-1] - last_ns <= limit_ns:
        return [(fresh, False)]
    broken = np.diff(fresh, prepend=fresh[0] if last_ns is None else last_ns) > limit_ns
    broken[0] |= last_ns is None
    starts = np.union1d([0], np.flatnonzero(broken))
    return list(zip(np.split(fresh, starts[1:]), broken[starts].tolist(), strict=True))


def uneven_places(points: IntArray, first_is_new: bool, dt_ns: float) -> IntArray:
    """Times of rows of period `dt_ns` for a stretch with losses or jitter; a sample too near to a row is left out.

    points: (n,) [ns], the first one a row already unless `first_is_new`.
    """
    steps = points[1:] - points[:-1]
    counts = np.rint(steps / dt_ns).astype(np.int64)
    if np.minimum.reduce(counts, initial=1) == 1:  # no sample is too near to the one before
        ends = np.add.accumulate(counts)
        number = np.arange(1, counts.sum() + 1) - np.repeat(ends - counts, counts)  # 1, 2, .. within each step
        share = number * np.repeat(steps, counts) / np.repeat(counts, counts)
        rest = np.repeat(points[:-1], counts) + np.rint(share).astype(np.int64)
        return np.concatenate((points[:1], rest)) if first_is_new else rest
    rows = [int(points[0])] if first_is_new else []
    last = int(points[0])
    for t in points[1:].tolist():
        n = round((t - last) / dt_ns)
        if n < 1:
            continue
        rows.extend(last + round(i * (t - last) / n) for i in range(1, n))
        rows.append(t)
        last = t
    return np.array(rows, dtype=np.int64)
