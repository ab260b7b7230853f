"""Bring the streams of one vehicle onto one uniform grid: `step(state, telemetry) -> (state, blocks)`.

The gyro is the master. On a *native* grid every row is one gyro sample, untouched, and the other signals are
interpolated to its time; lost samples become rows of their own, so the grid stays uniform without ever slipping
against the vehicle's clock. On a *resampled* grid (senders with uneven periods) all signals are interpolated to a
fixed period. Which one a link needs is measured by `measure_grid` and kept in the baseline.

What is invented is never judged: a row inside a gap longer than `max_gap_s`, and `settle_gap_s` after it, is marked
invalid; a gap longer than `break_s` starts a new segment, whose first `settle_start_s` are invalid. Gaps up to
35 ms may be interpolated at 100 Hz, longer ones plus 0.3 s are blanked, start-up takes 1 s (METHOD section 4).

Samples may arrive out of order by up to `reorder_s`; later ones are dropped and counted, duplicates too. The result
does not depend on how the telemetry was cut into chunks.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from mavdiag.errors import InputError
from mavdiag.rows.block import Block
from mavdiag.telemetry import NS_PER_S, BoolArray, FloatArray, IntArray, Series, Signal, Telemetry

__all__ = ["AlignCounts", "AlignSpec", "AlignState", "Grid", "align", "finish", "measure_grid", "start"]

NATIVE_TOLERANCE = 0.25  # of a period: a sample this near to its place counts as uniform (our choice)
NATIVE_SHARE = 0.99  # of the steps that must be uniform for a native grid (our choice)

# Interpolated to the row, by column count; a gap of the first is a gap of the row.
LINEAR = {Signal.ATTITUDE_SETPOINT: 3, Signal.SPECIFIC_FORCE: 3, Signal.TORQUE_COMMAND: 3, Signal.RATE_SETPOINT: 3}
# The last value holds; None: as many columns as the vehicle has outputs.
HELD = {
    Signal.THRUST_SETPOINT: 1,
    Signal.HEIGHT: 1,
    Signal.ARMED: 1,
    Signal.VIBRATION: 3,
    Signal.ACTUATOR: None,
}


class Grid(StrEnum):
    """How rows are placed."""

    NATIVE = "native"  # one row a gyro sample
    RESAMPLED = "resampled"  # fixed period, linear interpolation


@dataclass(frozen=True, slots=True)
class AlignSpec:
    """Grid and limits. dt_s: row period; all spans in seconds of the vehicle's clock."""

    dt_s: float
    grid: Grid = Grid.NATIVE
    max_gap_s: float = 0.035
    settle_gap_s: float = 0.3
    settle_start_s: float = 1.0
    break_s: float = 1.0
    reorder_s: float = 0.05

    def __post_init__(self) -> None:
        if not 0 < self.dt_s < self.break_s:
            raise InputError(f"sample time {self.dt_s} s must lie between 0 and {self.break_s} s")


@dataclass(frozen=True, slots=True)
class AlignCounts:
    """What was not used, and how many rows were filled in (and marked, where the gap was long)."""

    late: int = 0
    duplicate: int = 0
    filled: int = 0
    breaks: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """Samples of one signal that may still be needed, in order of time; newest is the latest time seen."""

    t: IntArray
    v: FloatArray
    newest: int


@dataclass(frozen=True, slots=True, eq=False)
class AlignState:
    """All that the aligner remembers between chunks."""

    streams: dict[Signal, _Stream] = field(default_factory=dict)
    segment: int = -1
    last_ns: int | None = None  # time of the last row placed
    done_ns: int | None = None  # gyro samples up to here are dealt with
    blank_until_ns: int = 0
    counts: AlignCounts = AlignCounts()


def start() -> AlignState:
    """A fresh state: nothing heard yet."""
    return AlignState()


def measure_grid(telemetry: Telemetry) -> tuple[float, Grid]:
    """Period [s] of the gyro stream, and whether its samples are uniform enough to be rows themselves.

    The period is the mean of the steps within 25 % of their median, so losses do not stretch it; if there are none, as
    when two lengths take turns, of all.
    Raises InputError if there are fewer than 20 gyro samples.
    """
    t = np.unique(telemetry.need(Signal.BODY_RATE).t_ns)
    if len(t) < 20:
        raise InputError(f"only {len(t)} gyro samples: at least 20 are needed to measure the rate")
    steps = np.diff(t).astype(np.float64)
    median = float(np.median(steps))
    usual = steps[np.abs(steps - median) <= NATIVE_TOLERANCE * median]
    dt_ns = float(np.mean(usual if len(usual) else steps))
    places = np.maximum(np.round(steps / dt_ns), 1.0)
    uniform = np.abs(steps - places * dt_ns) <= NATIVE_TOLERANCE * dt_ns
    grid = Grid.NATIVE if float(np.mean(uniform)) >= NATIVE_SHARE else Grid.RESAMPLED
    return dt_ns / NS_PER_S, grid


def align(spec: AlignSpec, state: AlignState, telemetry: Telemetry) -> tuple[AlignState, tuple[Block, ...]]:
    """Take in a chunk, return the rows that it completes (delayed by `reorder_s`), one block a segment."""
    state = _take_in(spec, state, telemetry)
    master, setpoint = state.streams.get(Signal.BODY_RATE), state.streams.get(Signal.ATTITUDE_SETPOINT)
    if master is None or setpoint is None:
        return _bounded(spec, state), ()
    reorder_ns, patience_ns = round(spec.reorder_s * NS_PER_S), round(spec.break_s * NS_PER_S)
    horizon = master.newest - reorder_ns
    # A set-point stream that stops must not hold the gyro back for ever: after `break_s` it is a break anyway.
    horizon = min(horizon, max(setpoint.newest - reorder_ns, horizon - patience_ns))
    return _emit(spec, state, horizon)


def finish(spec: AlignSpec, state: AlignState) -> tuple[AlignState, tuple[Block, ...]]:
    """The end of a log: what waited for late samples comes out."""
    master, setpoint = state.streams.get(Signal.BODY_RATE), state.streams.get(Signal.ATTITUDE_SETPOINT)
    if master is None or setpoint is None:
        return state, ()
    return _emit(spec, state, min(master.newest, setpoint.newest))


def _take_in(spec: AlignSpec, state: AlignState, telemetry: Telemetry) -> AlignState:
    streams, counts = dict(state.streams), state.counts
    for series in telemetry.series:
        if len(series) and (series.signal is Signal.BODY_RATE or series.signal in LINEAR or series.signal in HELD):
            streams[series.signal], counts = _merge(spec, streams.get(series.signal), series, counts)
    return replace(state, streams=streams, counts=counts)


def _merge(spec: AlignSpec, old: _Stream | None, series: Series, counts: AlignCounts) -> tuple[_Stream, AlignCounts]:
    t, v = series.t_ns, series.values
    if old is not None and t[0] > old.newest and (t[1:] > t[:-1]).all():  # the usual case: all new and in order
        return _Stream(np.concatenate((old.t, t)), np.concatenate((old.v, v)), int(t[-1])), counts
    before = old.newest if old is not None else int(t[0])
    newest = np.maximum.accumulate(np.maximum(t, before))
    on_time = t >= newest - round(spec.reorder_s * NS_PER_S)
    if not on_time.all():
        counts = replace(counts, late=counts.late + int(np.count_nonzero(~on_time)))
        t, v = t[on_time], v[on_time]
    if old is not None:
        t, v = np.concatenate((old.t, t)), np.concatenate((old.v, v))
    if not (t[1:] > t[:-1]).all():
        order = np.argsort(t, kind="stable")
        t, v = t[order], v[order]
        keep = np.append(np.diff(t) > 0, True)  # of equal times the last to arrive counts
        counts = replace(counts, duplicate=counts.duplicate + int(np.count_nonzero(~keep)))
        t, v = t[keep], v[keep]
    return _Stream(t, v, int(newest[-1])), counts


def _bounded(spec: AlignSpec, state: AlignState) -> AlignState:
    """While one of the two main streams is missing, keep only the last seconds of the other."""
    streams = {
        signal: _forget(stream, stream.newest - 2 * round(spec.break_s * NS_PER_S))
        for signal, stream in state.streams.items()
    }
    return replace(state, streams=streams)


def _forget(stream: _Stream, before_ns: int) -> _Stream:
    """Drop samples older than `before_ns`, but keep the one that a row at `before_ns` needs on its left."""
    first = max(int(np.searchsorted(stream.t, before_ns, side="right")) - 1, 0)
    return _Stream(stream.t[first:], stream.v[first:], stream.newest) if first else stream


def _emit(spec: AlignSpec, state: AlignState, horizon_ns: int) -> tuple[AlignState, tuple[Block, ...]]:
    master, setpoint = state.streams[Signal.BODY_RATE], state.streams[Signal.ATTITUDE_SETPOINT]
    first = 0 if state.done_ns is None else int(np.searchsorted(master.t, state.done_ns, side="right"))
    fresh = master.t[first : int(np.searchsorted(master.t, horizon_ns, side="right"))]
    if len(fresh) == 0:
        return state, ()
    state = replace(state, done_ns=int(fresh[-1]))
    limit = round(spec.break_s * NS_PER_S)
    fresh = fresh[_within(setpoint, fresh, limit)]
    blocks: list[Block] = []
    for piece, broken in _pieces(fresh, state.last_ns, limit):
        state, block = _piece(spec, state, piece, broken)
        blocks.extend(() if block is None else (block,))
    keep_from = state.last_ns if state.last_ns is not None else horizon_ns
    keep_from = max(keep_from, horizon_ns - 2 * limit)
    return replace(state, streams={s: _forget(stream, keep_from) for s, stream in state.streams.items()}), tuple(blocks)


def _pieces(fresh: IntArray, last_ns: int | None, limit_ns: int) -> list[tuple[IntArray, bool]]:
    """Stretches without a step above the limit, and whether one lies before each."""
    if len(fresh) == 0:
        return []
    if last_ns is not None and fresh[-1] - last_ns <= limit_ns:
        return [(fresh, False)]
    broken = np.diff(fresh, prepend=fresh[0] if last_ns is None else last_ns) > limit_ns
    broken[0] |= last_ns is None
    starts = np.union1d([0], np.flatnonzero(broken))
    return list(zip(np.split(fresh, starts[1:]), broken[starts].tolist(), strict=True))


def _within(stream: _Stream, rows: IntArray, limit_ns: int) -> BoolArray:
    """Which rows lie between two samples that are not farther apart than the limit."""
    if rows[0] >= stream.t[0] and rows[-1] <= stream.t[-1] and stream.t[-1] - stream.t[0] <= limit_ns:
        return np.ones(len(rows), dtype=np.bool_)
    right = np.searchsorted(stream.t, rows, side="left")
    inside = (right < len(stream.t)) & (rows >= stream.t[0])
    right = np.minimum(right, len(stream.t) - 1)
    left = np.maximum(right - 1, 0)
    near: BoolArray = (stream.t[right] == rows) | (stream.t[right] - stream.t[left] <= limit_ns)
    result: BoolArray = inside & near
    return result


def _piece(spec: AlignSpec, state: AlignState, fresh: IntArray, broken: bool) -> tuple[AlignState, Block | None]:
    """Rows for gyro samples without a break between them; `broken` if one lies before them."""
    if broken:
        state = replace(
            state,
            segment=state.segment + 1,
            last_ns=None,
            blank_until_ns=int(fresh[0]) + round(spec.settle_start_s * NS_PER_S),
            counts=replace(state.counts, breaks=state.counts.breaks + 1),
        )
    rows, filled = _place(spec, state.last_ns, fresh)
    if len(rows) == 0:
        return state, None
    state = replace(state, last_ns=int(rows[-1]), counts=replace(state.counts, filled=state.counts.filled + filled))
    return _fill(spec, state, rows)


def _place(spec: AlignSpec, last_ns: int | None, fresh: IntArray) -> tuple[IntArray, int]:
    """Times of the rows that the samples at `fresh` complete, and how many of them have no sample of their own."""
    dt_ns = spec.dt_s * NS_PER_S
    if spec.grid is Grid.RESAMPLED:
        step = round(dt_ns)
        return np.arange(fresh[0] if last_ns is None else last_ns + step, fresh[-1] + 1, step, dtype=np.int64), 0
    points = fresh if last_ns is None else np.concatenate(([last_ns], fresh))
    places = (points[1:] - points[:-1]) / dt_ns
    if ((places > 0.5) & (places < 1.5)).all():
        return fresh, 0
    return _place_uneven(points, last_ns is None, dt_ns)


def _place_uneven(points: IntArray, first_is_new: bool, dt_ns: float) -> tuple[IntArray, int]:
    """The slow way for a stretch with losses or jitter: a sample too near to the last row is left out."""
    rows = [int(points[0])] if first_is_new else []
    last, filled = int(points[0]), 0
    for t in points[1:].tolist():
        n = round((t - last) / dt_ns)
        if n < 1:
            continue
        rows.extend(last + round(i * (t - last) / n) for i in range(1, n))
        rows.append(t)
        filled += n - 1
        last = t
    return np.array(rows, dtype=np.int64), filled


def _fill(spec: AlignSpec, state: AlignState, rows: IntArray) -> tuple[AlignState, Block]:
    linear = {signal: _interpolate(state.streams.get(signal), rows) for signal in (Signal.BODY_RATE, *LINEAR)}
    bad = _in_gap(spec, state.streams[Signal.BODY_RATE], rows)
    bad |= _in_gap(spec, state.streams[Signal.ATTITUDE_SETPOINT], rows)
    held = {signal: _hold(state.streams.get(signal), rows, width) for signal, width in HELD.items()}
    until = state.blank_until_ns
    if bad.any():
        settle = round(spec.settle_gap_s * NS_PER_S)
        reach = np.maximum.accumulate(np.where(bad, rows + settle, until))
        until, valid = int(reach[-1]), rows > reach
    else:
        valid = rows > until
    block = Block(
        segment=state.segment,
        dt_s=spec.dt_s,
        t_ns=rows,
        setpoint=linear[Signal.ATTITUDE_SETPOINT],
        rate=linear[Signal.BODY_RATE],
        force=linear[Signal.SPECIFIC_FORCE],
        torque=linear[Signal.TORQUE_COMMAND],
        rate_setpoint=linear[Signal.RATE_SETPOINT],
        thrust=held[Signal.THRUST_SETPOINT][:, 0],
        height=held[Signal.HEIGHT][:, 0],
        armed=held[Signal.ARMED][:, 0],
        vibration=held[Signal.VIBRATION],
        actuator=held[Signal.ACTUATOR],
        valid=valid,
    )
    return replace(state, blank_until_ns=until), block


def _interpolate(stream: _Stream | None, rows: IntArray) -> FloatArray:
    """Linear interpolation to the rows; a sample at the very time of a row is taken as it is."""
    if stream is None:
        return np.full((len(rows), 3), np.nan)
    first = int(np.searchsorted(stream.t, rows[0], side="left"))
    if np.array_equal(stream.t[first : first + len(rows)], rows):
        return stream.v[first : first + len(rows)]
    t = stream.t - rows[0]  # small numbers: nanoseconds since the epoch do not fit a double
    x = rows - rows[0]
    return np.column_stack([np.interp(x, t, stream.v[:, j]) for j in range(stream.v.shape[1])])


def _in_gap(spec: AlignSpec, stream: _Stream, rows: IntArray) -> BoolArray:
    """Which rows lie between two samples too far apart to interpolate, or outside of all samples."""
    first = max(int(np.searchsorted(stream.t, rows[0], side="right")) - 1, 0)
    t = stream.t[first : int(np.searchsorted(stream.t, rows[-1], side="left")) + 1]
    limit = spec.max_gap_s * NS_PER_S
    if len(t) and t[0] <= rows[0] and t[-1] >= rows[-1] and (t[1:] - t[:-1] <= limit).all():
        return np.zeros(len(rows), dtype=np.bool_)
    right = np.minimum(np.searchsorted(stream.t, rows, side="left"), len(stream.t) - 1)
    left = np.maximum(right - 1, 0)
    gap: BoolArray = (stream.t[right] != rows) & (stream.t[right] - stream.t[left] > limit)
    outside: BoolArray = (rows > stream.t[-1]) | (rows < stream.t[0])
    return gap | outside


def _hold(stream: _Stream | None, rows: IntArray, width: int | None) -> FloatArray:
    """The last value at or before each row; nan before the first."""
    if stream is None:
        return np.full((len(rows), width or 0), np.nan)
    if stream.t[0] <= rows[0] and (len(stream.t) == 1 or stream.t[1] > rows[-1]):  # one value for all rows
        return np.repeat(stream.v[:1], len(rows), axis=0)
    at = np.searchsorted(stream.t, rows, side="right") - 1
    values: FloatArray = stream.v[np.maximum(at, 0)].copy()
    values[at < 0] = np.nan
    return values
