"""Bring the streams of one vehicle onto one uniform grid: `AlignSpec.start`, `.step`, `.finish`.

The gyro is the master: rows come where it has samples, whatever else is sent. On a *native* grid every row is one gyro
sample, untouched, and the other signals are brought to its time; lost samples become rows of their own, so the grid
stays uniform without ever slipping against the vehicle's clock. On a *resampled* grid (senders with uneven periods) all
signals are interpolated to a fixed period. Which one a link needs is measured by `measure_grid` and kept in the
baseline.

What is not believed never comes so far (`rows.quality`), and what is invented is never judged. A row inside a gyro gap
longer than `max_gap_s`, or than a glitch leaves, and `settle_gap_s` after it, is marked invalid; a gap longer than
`break_s` starts a new segment, whose first `settle_start_s` are invalid. Gaps up to 35 ms may be interpolated at 100
Hz, longer ones plus 0.3 s are blanked, start-up takes 1 s (METHOD section 4). The set-point has the same limits and a
mark of its own. Every other signal is nan where it is unknown: where no two samples within its limit surround the row,
or where the last value is older than its limit.

Samples may arrive out of order by up to `reorder_s`; later ones and duplicates are dropped. A row waits that long for
its samples, and for the next sample of an interpolated signal until that sample could not be used any more. So the
result does not depend on how the telemetry was cut into chunks, as long as no stream lags the gyro by more than
`reorder_s`.

On a native grid and an orderly link (`order`) a row waits only for what is missing: it comes out when the gyro is 5 ms
further, if gyro and interpolated signals miss no sample up to it.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from mavdiag.errors import InputError
from mavdiag.rows.block import Block
from mavdiag.rows.grid import Grid, measure_grid
from mavdiag.rows.order import ORDER_NS, calm_from_ns
from mavdiag.rows.places import pieces, uneven_places
from mavdiag.rows.quality import GLITCH_S, MOST_LOST, LinkQuality, Memories, believed
from mavdiag.rows.stream import NEVER_NS, Stream
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["AlignSpec", "AlignState", "Grid", "measure_grid"]

# Interpolated to the row where two samples this near surround it [s]; a slow command stream may have 4 Hz (our choice).
LINEAR = {  # or max_gap_s if longer
    Signal.SPECIFIC_FORCE: 0.0,
    Signal.TORQUE_COMMAND: 0.25,
    Signal.RATE_SETPOINT: 0.25,
    Signal.ATTITUDE: 0.25,
}
# How long the last value holds [s]: ACTUATOR comes at 10-50 Hz, VIBRATION at 2-10 Hz, a battery changes slowly (our
# choices). Logs write ARMED
# only when it changes.
HELD = {
    Signal.THRUST_SETPOINT: 1.0,
    Signal.HEIGHT: 2.0,
    Signal.VOLTAGE: 10.0,
    Signal.ARMED: math.inf,
    Signal.VIBRATION: 1.0,
    Signal.ACTUATOR: 1.0,
}
WIDTHS = {Signal.VIBRATION: 3, Signal.ACTUATOR: 0}  # columns of a held signal that was never sent, if not 1
MAIN = (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT)
BETWEEN = (Signal.ATTITUDE_SETPOINT, *LINEAR)  # interpolated to the gyro's times
USED = frozenset((*MAIN, *LINEAR, *HELD))
ANGLES = (Signal.ATTITUDE_SETPOINT, Signal.ATTITUDE)  # read without jumps of 2 pi

Streams: TypeAlias = dict[Signal, Stream]


@dataclass(frozen=True, slots=True, eq=False)
class AlignState:
    """All that the aligner remembers between chunks."""

    streams: Streams = field(default_factory=dict)
    memories: Memories = field(default_factory=dict)
    segment: int = -1
    last_ns: int | None = None  # time of the last row placed
    done_ns: int = -NEVER_NS  # gyro samples up to here are dealt with
    calm_ns: int = NEVER_NS  # from here on the link is orderly
    blank_until_ns: int = -NEVER_NS  # of the gyro
    setpoint_blank_ns: int = -NEVER_NS


@dataclass(frozen=True, slots=True)
class AlignSpec:
    """Grid and limits; all spans in seconds of the vehicle's clock. Raises InputError on an impossible period.

    dt_s: row period.
    grid: how rows are placed.
    max_gap_s: longest gap of gyro and set-point that is interpolated and used.
    settle_gap_s: what is not used after a longer gap.
    settle_start_s: what is not used after a start or a break.
    break_s: longest gap within a segment; how long a row waits for a set-point.
    reorder_s: how late a sample may come.
    quality: what healthy flights showed of the link; samples that do not fit it are not believed (`rows.quality`).
    """

    dt_s: float
    grid: Grid = Grid.NATIVE
    max_gap_s: float = 0.035
    settle_gap_s: float = 0.3
    settle_start_s: float = 1.0
    break_s: float = 1.0
    reorder_s: float = 0.05
    quality: LinkQuality = field(default_factory=LinkQuality)

    def __post_init__(self) -> None:
        if not 0 < self.dt_s < self.break_s:
            raise InputError(f"sample time {self.dt_s} s must lie between 0 and {self.break_s} s")

    @property
    def usable_gap_s(self) -> float:
        """Longest gap of gyro and set-point that is interpolated and used: a glitch leaves none that is longer."""
        return max(self.max_gap_s, (min(MOST_LOST, GLITCH_S / self.dt_s) + 1.2) * self.dt_s)

    def start(self) -> AlignState:
        """A fresh state: no sample yet."""
        return AlignState()

    def step(self, state: AlignState, telemetry: Telemetry) -> tuple[AlignState, tuple[Block, ...]]:
        """Take in a chunk, return the rows that it completes, one block a segment."""
        memories, telemetry = believed(self.quality, state.memories, telemetry)
        state = replace(state, memories=memories)
        calm_ns = calm_from_ns(state.calm_ns, state.streams.get(Signal.BODY_RATE), telemetry, USED)
        streams = _merged(self, state.streams, telemetry)
        return _emit(self, state, streams, _horizon(self, streams, calm_ns), calm_ns)

    def finish(self, state: AlignState) -> tuple[AlignState, tuple[Block, ...]]:
        """The end of a log: what waited for late samples comes out."""
        return _emit(self, state, state.streams, NEVER_NS, state.calm_ns)

    def believed(self, telemetry: Telemetry) -> Telemetry:
        """What is believed of a whole log."""
        return believed(self.quality, {}, telemetry)[1]

    def whole(self, telemetry: Telemetry, most: int) -> Iterator[Block]:
        """The rows of what is believed of a whole log, as `step` and `finish` give them, in blocks of about `most`.

        One block is made at a time, so that a long log takes no more memory than its telemetry and a block.
        """
        merged = _merged(self, {}, telemetry)
        streams = {signal: stream.unwrapped() for signal, stream in merged.items()}
        gyro, state = streams.get(Signal.BODY_RATE), self.start()
        stretches = [] if gyro is None else pieces(gyro.t, None, _ns(self.break_s))
        for stretch, broken in stretches:
            state = _begun(self, state, int(stretch[0])) if broken else state
            for first in range(0, len(stretch), most):
                rows = _place(self, state.last_ns, stretch[first : first + most])
                if len(rows):
                    state, block = _fill(self, state, streams, rows)
                    yield block

    def reached_ns(self, state: AlignState, chunks: Sequence[Telemetry]) -> int | None:
        """No row later than this comes of the next chunks [ns]; None if they hold no sample."""
        fresh = {series.signal: int(series.t_ns[-1]) for one in chunks for series in one.series if len(series)}
        if not fresh:
            return None
        newest = {signal: max(fresh.get(signal, -NEVER_NS), one.newest) for signal, one in state.streams.items()}
        newest = fresh | newest
        gyro_ns = newest.get(Signal.BODY_RATE, -NEVER_NS)
        safe = max(gyro_ns, max(newest.values()) - _ns(self.break_s)) - _ns(self.reorder_s)
        waited = [newest[one] for one in BETWEEN if one in newest and safe < newest[one] + _limit_ns(self, one)]
        return min(max(safe, gyro_ns - ORDER_NS) if self.hurries(gyro_ns, state.calm_ns) else safe, *waited, NEVER_NS)

    def hurries(self, gyro_ns: int, calm_ns: int) -> bool:
        """Whether rows wait only for what is missing. gyro_ns: the gyro's newest; calm_ns: as in `AlignState`."""
        return self.grid is Grid.NATIVE and gyro_ns > calm_ns


@lru_cache(maxsize=64)  # every step asks for the same spans many times
def _ns(span_s: float) -> int:
    return NEVER_NS if span_s == math.inf else round(span_s * NS_PER_S)


def _limit_ns(spec: AlignSpec, signal: Signal) -> int:
    """Two samples farther apart than this are not interpolated."""
    return _ns(spec.break_s if signal in MAIN else max(LINEAR[signal], spec.usable_gap_s))


def _merged(spec: AlignSpec, streams: Streams, telemetry: Telemetry) -> Streams:
    streams = dict(streams)
    for series in telemetry.series:
        signal, t, v = series.signal, series.t_ns, series.values
        if signal not in USED:
            continue
        old = streams.get(signal)
        if len(t):
            old = old or Stream(t[:0], v[:0], angle=signal in ANGLES)
            streams[signal] = old.merged(t, v, _ns(spec.reorder_s))
    return streams


def _bounded(spec: AlignSpec, streams: Streams, last_ns: int | None) -> Streams:
    """What a later row may need: samples since the last row, but no more than the last seconds (B22)."""
    span_ns = 2 * _ns(spec.break_s)
    row_ns = -NEVER_NS if last_ns is None else last_ns
    return {signal: stream.since(max(row_ns, stream.newest - span_ns)) for signal, stream in streams.items()}


def _horizon(spec: AlignSpec, streams: Streams, calm_ns: int) -> int:
    """Rows up to here are complete: every sample that they need has come, or cannot come any more.

    All samples up to `safe` have come. If only the gyro stops, the time of the others shows it after `break_s`.
    """
    gyro, reorder_ns = streams.get(Signal.BODY_RATE), _ns(spec.reorder_s)
    if gyro is None:
        return -NEVER_NS
    latest = max(stream.newest for stream in streams.values())
    horizon = safe = max(gyro.newest, latest - _ns(spec.break_s)) - reorder_ns
    hurries = spec.hurries(gyro.newest, calm_ns)
    if hurries:
        horizon = max(safe, min(gyro.newest - ORDER_NS, gyro.whole_ns(safe, spec.dt_s * NS_PER_S)))
    for signal in BETWEEN:
        stream = streams.get(signal)
        if stream is None:
            continue
        settled = max(safe, stream.newest - reorder_ns)
        if hurries:
            settled = max(settled, stream.whole_ns(settled))
        behind = int(stream.t.searchsorted(settled, side="right")) - 1
        if behind >= 0 and settled < stream.t[behind] + _limit_ns(spec, signal):  # the next sample may still count
            horizon = min(horizon, int(stream.t[behind]))
        elif behind + 1 < len(stream.t):
            horizon = min(horizon, settled)
    return horizon


def _emit(
    spec: AlignSpec, state: AlignState, streams: Streams, horizon_ns: int, calm_ns: int
) -> tuple[AlignState, tuple[Block, ...]]:
    t = streams[Signal.BODY_RATE].t if Signal.BODY_RATE in streams else np.empty(0, dtype=np.int64)
    fresh = t[int(t.searchsorted(state.done_ns, side="right")) : int(t.searchsorted(horizon_ns, side="right"))]
    done_ns = int(fresh[-1]) if len(fresh) else state.done_ns
    blocks: list[Block] = []
    for piece, broken in pieces(fresh, state.last_ns, _ns(spec.break_s)):
        state = _begun(spec, state, int(piece[0])) if broken else state
        rows = _place(spec, state.last_ns, piece)
        if len(rows):
            state, block = _fill(spec, state, streams, rows)
            blocks.append(block)
    kept = _bounded(spec, streams, state.last_ns)
    blank_ns, setpoint_blank_ns = state.blank_until_ns, state.setpoint_blank_ns
    told = (state.segment, state.last_ns, done_ns, calm_ns, blank_ns, setpoint_blank_ns)
    state = AlignState(kept, state.memories, *told)
    return state, tuple(blocks)


def _begun(spec: AlignSpec, state: AlignState, first_ns: int) -> AlignState:
    """With a new segment, whose first sample that is."""
    blank_ns = first_ns + _ns(spec.settle_start_s)
    return replace(state, segment=state.segment + 1, last_ns=None, blank_until_ns=blank_ns)


def _place(spec: AlignSpec, last_ns: int | None, fresh: IntArray) -> IntArray:
    """Times of the rows that the samples at `fresh` complete."""
    dt_ns = spec.dt_s * NS_PER_S
    if spec.grid is Grid.RESAMPLED:
        step = round(dt_ns)
        return np.arange(fresh[0] if last_ns is None else last_ns + step, fresh[-1] + 1, step, dtype=np.int64)
    points = fresh if last_ns is None else np.concatenate(([last_ns], fresh))
    places = (points[1:] - points[:-1]) / dt_ns
    if np.minimum.reduce(places, initial=1.0) > 0.5 and np.maximum.reduce(places, initial=1.0) < 1.5:
        return fresh
    return uneven_places(points, last_ns is None, dt_ns)


def _fill(spec: AlignSpec, state: AlignState, streams: Streams, rows: IntArray) -> tuple[AlignState, Block]:
    gyro, gap = streams[Signal.BODY_RATE].interpolated(rows, _ns(spec.break_s))
    rate, doubt = gyro[:, :3], np.ceil(gyro[:, 3])
    if np.count_nonzero(doubt):  # what must settle after a doubt is as after a gap
        gap = np.where(doubt > 0, np.maximum(gap, _ns(spec.usable_gap_s) + 1), gap)
    valid, blank_ns = _usable(spec, rows, gap, state.blank_until_ns)
    setpoint, gap = _setpoint(spec, streams, rows)
    setpoint_valid, setpoint_blank_ns = _usable(spec, rows, gap, state.setpoint_blank_ns)
    force, torque, rate_setpoint, attitude = (_linear(spec, streams, signal, rows) for signal in LINEAR)
    thrust, height, voltage, armed, vibration, actuator = (_held(streams, signal, rows) for signal in HELD)
    block = Block(
        segment=state.segment,
        dt_s=spec.dt_s,
        t_ns=rows,
        setpoint=np.asfortranarray(setpoint),
        rate=np.asfortranarray(rate),
        force=np.asfortranarray(force),
        torque=np.asfortranarray(torque),
        rate_setpoint=np.asfortranarray(rate_setpoint),
        thrust=thrust[:, 0],
        attitude=np.asfortranarray(attitude),
        height=height[:, 0],
        voltage=voltage[:, 0],
        armed=armed[:, 0],
        vibration=np.asfortranarray(vibration),
        actuator=np.asfortranarray(actuator),
        valid=valid,
        setpoint_valid=setpoint_valid,
        doubt=doubt,
    )
    told = (state.segment, int(rows[-1]), state.done_ns, state.calm_ns, blank_ns, setpoint_blank_ns)
    return AlignState(streams, state.memories, *told), block


def _usable(spec: AlignSpec, rows: IntArray, gap: IntArray, until_ns: int) -> tuple[BoolArray, int]:
    """(n,) rows outside of gaps and of what must settle after them, and until when the last one blanks."""
    most_ns = _ns(spec.usable_gap_s)
    if np.maximum.reduce(gap) <= most_ns:
        return rows > until_ns, until_ns
    settle = np.where(gap > _ns(spec.break_s), _ns(spec.settle_start_s), _ns(spec.settle_gap_s))
    reach = np.where(gap > most_ns, rows + settle, until_ns)
    reach = np.maximum.accumulate(np.maximum(reach, until_ns))
    return rows > reach, int(reach[-1])


def _setpoint(spec: AlignSpec, streams: Streams, rows: IntArray) -> tuple[FloatArray, IntArray]:
    """Commanded angles, finite everywhere: 0 before the first, the last one in an outage; and the gap at each row."""
    stream = streams.get(Signal.ATTITUDE_SETPOINT)
    if stream is None:
        return np.zeros((len(rows), 3)), np.full(len(rows), NEVER_NS)
    values, gap = stream.interpolated(rows, _ns(spec.break_s))
    return (values if math.isfinite(values[0, 0]) else np.nan_to_num(values)), gap


def _linear(spec: AlignSpec, streams: Streams, signal: Signal, rows: IntArray) -> FloatArray:
    """Interpolated values; nan where no two samples within the limit surround the row."""
    stream, limit_ns = streams.get(signal), _limit_ns(spec, signal)
    if stream is None:
        return np.full((len(rows), 3), np.nan, order="F")
    values, gap = stream.interpolated(rows, limit_ns)
    if np.maximum.reduce(gap) > limit_ns:
        values[gap > limit_ns] = np.nan
    return values


def _held(streams: Streams, signal: Signal, rows: IntArray) -> FloatArray:
    stream = streams.get(signal)
    if stream is None:
        return np.full((len(rows), WIDTHS.get(signal, 1)), np.nan)
    return stream.held(rows, _ns(HELD[signal]))
