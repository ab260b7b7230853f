"""Sliding windows, a high-pass and exponential means of rows, restartable and independent of how a stream was cut.

Windows over an array depend on their own rows alone, so a NaN spoils the windows that hold it and no other. Running
means are folds in the order of the rows, so any chunking gives the same bits. Nothing pads: what a running window has
not seen yet counts as zero, and a flag for each window says whether it is full. numpy only: importing scipy.signal
takes 0.8 s.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = [
    "EmaState",
    "MeanState",
    "ema",
    "forgetting",
    "highpass",
    "sliding_mean",
    "spans",
    "start_ema",
    "start_mean",
    "window_all",
    "window_mean",
    "window_rows",
    "window_sums",
]

GROWTH, MOST_ROWS = 1e9, 4096  # of the weights of an exponential mean until it is scaled anew (our choice)
FEW_WINDOWS = 4  # fewer are added up one by one
BETA = 4.0  # of the Kaiser window: 45 dB of stop band (our choice)


@lru_cache(maxsize=64)  # a display asks for it in every step
def highpass(corner: float, taps: int) -> FloatArray:
    """Linear-phase high-pass, (taps,), corner as a share of the sample rate; windowed sinc, unit gain at half the rate.

    Its delay is (taps - 1)/2 samples; a constant does not pass. Read-only. Raises UsageError unless taps is odd and
    above 2 and 0 < corner < 0.5.

    >>> taps = highpass(0.06, 61)
    >>> gain = abs(np.exp(-2j * np.pi * np.outer([0.0, 0.03, 0.06, 0.1, 0.167], np.arange(61))) @ taps)
    >>> gain.round(2).tolist()
    [0.0, 0.0, 0.5, 1.0, 1.0]
    """
    if taps < 3 or taps % 2 == 0 or not 0.0 < corner < 0.5:
        raise UsageError(
            f"a high-pass needs an odd number of taps and a corner below half the rate, not {taps}, {corner}"
        )
    k = np.arange(taps) - taps // 2
    low = 2 * corner * np.sinc(2 * corner * k) * np.kaiser(taps, BETA)
    high = -low / low.sum()
    high[taps // 2] += 1.0
    found = np.asarray(high / (high @ (-1.0) ** k), dtype=np.float64)
    found.setflags(write=False)
    return found


def window_mean(x: FloatArray, window: int) -> FloatArray:
    """Mean over each full window of rows, (n, k) -> (n - window + 1, k), none if there are fewer rows than that.

    The rows that windows share are added up once.

    >>> window_mean(np.array([[1.0], [3.0], [5.0]]), 2)[:, 0].tolist()
    [2.0, 4.0]
    """
    known, columns = max(0, len(x) - window + 1), x.shape[1]
    if known <= window:  # they share the rows between the first and the last one, which are added up once
        out = np.empty((columns, known))
        if known:
            out[:] = np.add.reduce(x[known - 1 : window].T, axis=1)[:, None]
            out[:, :-1] += np.add.accumulate(x[: known - 1].T[:, ::-1], axis=1)[:, ::-1]
            out[:, 1:] += np.add.accumulate(x[window:].T, axis=1)
            out /= window
        return out.T
    # Each window is the end of one stretch of `window` rows and the begin of the next one.
    count = -(-len(x) // window)
    stretches = np.zeros((columns, count, window))
    stretches.reshape(columns, -1)[:, : len(x)] = x.T
    ends = np.empty(stretches.shape)
    np.add.accumulate(stretches[:, :, ::-1], axis=2, out=ends[:, :, ::-1])
    begins = np.add.accumulate(stretches, axis=2, out=stretches).reshape(columns, -1)[:, window - 1 :]
    begins[:, ::window] = 0.0  # these windows are whole stretches
    out = ends.reshape(columns, -1)[:, :known]
    out += begins[:, :known]
    out /= window
    return out.T


def window_sums(x: FloatArray, window: int) -> FloatArray:
    """Sum over each full window of rows, (n, k) -> (n - window + 1, k), n at least `window`.

    For short windows: each is added up by itself, one row after the other, so that no cut changes a bit.
    """
    count = len(x) - window + 1
    if count < FEW_WINDOWS:
        rows = np.ascontiguousarray(x)
        return np.stack([np.add.reduce(rows[first : first + window], axis=0) for first in range(count)])
    columns = np.ascontiguousarray(x.T)
    sums = columns[:, :count].copy()
    for row in range(1, window):
        sums += columns[:, row : row + count]
    return sums.T


def window_all(flags: BoolArray, window: int) -> BoolArray:
    """Whether each full window of flags is True throughout, (n,) -> (n - window + 1,)."""
    known = max(0, len(flags) - window + 1)
    if known == 0 or np.count_nonzero(flags) == len(flags):
        return np.ones(known, dtype=np.bool_)
    bad = np.concatenate(([0], np.cumsum(~flags)))
    whole: BoolArray = bad[window:] == bad[:known]
    return whole


def spans(flags: BoolArray) -> list[tuple[int, int]]:
    """Half-open spans [first, stop) of True, (n,).

    >>> spans(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    if not np.count_nonzero(flags):
        return []
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class MeanState:
    """What a sliding mean remembers.

    sums: running sums up to each of the last rows, in the pieces (h, k) in which they came, oldest first.
    skip: rows of the first piece that no window needs any more.
    rows: how many others there are, at most the window.
    run: valid rows since the last bad one.
    """

    sums: tuple[FloatArray, ...]
    skip: int
    rows: int
    run: int


def start_mean(columns: int) -> MeanState:
    """Before the first row."""
    return MeanState((np.zeros((1, columns)),), 0, 1, 0)


@lru_cache(maxsize=64)
def window_rows(window_s: float, dt_s: float) -> int:
    """Rows in a window of `window_s` at a period of `dt_s` [s], at least 1. Raises UsageError if one is not positive.

    >>> window_rows(5.0, 0.01)
    500
    """
    if not (math.isfinite(window_s) and window_s > 0 and math.isfinite(dt_s) and dt_s > 0):
        raise UsageError(f"window {window_s} s and sample time {dt_s} s must be positive")
    return max(1, round(window_s / dt_s))


def sliding_mean(
    state: MeanState, x: FloatArray, valid: BoolArray, window: int
) -> tuple[MeanState, FloatArray, BoolArray]:
    """Mean of the last `window` rows at each row: x (n, k), valid (n,) -> mean (n, k), full (n,).

    An invalid row counts as zero; `full` is True where all rows of the window are there and valid, and only there the
    mean means anything.

    >>> state, mean, full = sliding_mean(start_mean(1), np.array([[1.0], [3.0], [5.0]]), np.ones(3, dtype=bool), 2)
    >>> mean[:, 0].tolist(), full.tolist()
    ([0.5, 2.0, 4.0], [False, True, True])
    """
    n = len(x)
    if n == 0:
        return state, np.empty(x.shape), np.empty(0, dtype=np.bool_)
    good = np.count_nonzero(valid) == n
    # sums[h + i] = x[0] + .. + x[i], in that order whatever the chunks; mean[i] = (sums[h + i] - sums[h + i - w]) / w
    sums = np.empty((x.shape[1], n + 1))  # column by column
    sums[:, 0], sums[:, 1:] = state.sums[-1][-1], x.T if good else np.where(valid, x.T, 0.0)
    fresh = np.add.accumulate(sums, axis=1, out=sums)[:, 1:].T
    pieces = (*state.sums, fresh)
    mean = fresh - _before(pieces, state.skip, state.rows - window, n)
    mean /= window
    skip, rows = state.skip + max(0, state.rows + n - window), min(state.rows + n, window)
    done = 0
    while skip >= len(pieces[done]):
        skip -= len(pieces[done])
        done += 1
    if good and state.run + 1 >= window:  # the usual case: unbroken, and full since before
        return MeanState(pieces[done:], skip, rows, state.run + n), mean, np.ones(n, dtype=np.bool_)
    run = np.arange(state.run + 1, state.run + 1 + n) if good else _run_lengths(state.run, valid)
    return MeanState(pieces[done:], skip, rows, int(run[-1])), mean, run >= window


def _before(pieces: Sequence[FloatArray], skip: int, first: int, n: int) -> FloatArray:
    """The n rows of the pieces from `first` on, which is counted from row `skip`; that row for those before it."""
    early = min(max(-first, 0), n)
    if early == n:
        return pieces[0][skip : skip + 1]
    at, parts, missing = skip + max(first, 0), [pieces[0][skip : skip + 1]] * early, n - early
    for piece in pieces:
        if not missing:
            break
        if at < len(piece):
            parts.append(piece[at : at + missing])
            missing -= len(parts[-1])
            at = 0
        else:
            at -= len(piece)
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _run_lengths(carried: int, valid: BoolArray) -> IntArray:
    """Number of valid rows up to each row without a break, (n,)."""
    at = np.arange(len(valid))
    run: IntArray = at - np.maximum.accumulate(np.where(valid, -1 - carried, at))
    return run


@lru_cache(maxsize=64)
def forgetting(memory_s: float, dt_s: float) -> float:
    """The factor alpha of an exponential mean with a time constant of `memory_s`: 1 - exp(-dt/memory)."""
    return -math.expm1(-dt_s / memory_s)


@dataclass(frozen=True, slots=True, eq=False)
class EmaState:
    """What an exponential mean remembers: its present value is sums (1 - alpha)^place.

    sums: (k,) weighted sums, as they were scaled `place` rows ago.
    """

    sums: FloatArray
    place: int = 0


@lru_cache(maxsize=64)
def _weights(alpha: float) -> tuple[FloatArray, FloatArray]:
    """(L,) each: alpha (1 - alpha)^-j and (1 - alpha)^j for j = 1 .. L, until they have grown `GROWTH` times."""
    most = min(MOST_ROWS, max(1, int(math.log(GROWTH) / -math.log1p(-alpha))))
    shrink = np.exp(math.log1p(-alpha) * np.arange(1, most + 1))
    grow = alpha / shrink
    for one in (grow, shrink):
        one.setflags(write=False)
    return grow, shrink


def start_ema(values: FloatArray) -> EmaState:
    """A mean that begins with these values, (k,)."""
    return EmaState(np.array(values))


def ema(state: EmaState, x: FloatArray, alpha: float) -> tuple[EmaState, FloatArray]:
    """Exponential mean s(t) = s(t-1) + alpha (x(t) - s(t-1)), x (n, k) -> s (n, k), 0 < alpha < 1.

    With b = 1 - alpha and S(0) = s(0):    S(j) = S(j-1) + alpha b^-j x(j),    s(j) = b^j S(j)
    so a plain running sum does it; after some rows, always the same ones, it is scaled anew. What is rounded in S(j)
    decays with it, so that the growing weights cost no digits. About 5 ns a value.
    """
    grow, shrink = _weights(alpha)
    out = np.empty(x.shape[::-1])  # column by column: the inner loops of numpy then run over rows
    sums, place, first = state.sums, state.place, 0
    while first < len(x):
        if place == len(grow):
            sums, place = sums * shrink[-1], 0
        count = min(len(x) - first, len(grow) - place)
        part = out[:, first : first + count]
        np.multiply(x[first : first + count].T, grow[place : place + count], out=part)
        part[:, 0] += sums
        np.add.accumulate(part, axis=1, out=part)
        sums = part[:, -1].copy()
        part *= shrink[place : place + count]
        first, place = first + count, place + count
    return EmaState(sums, place), out.T
