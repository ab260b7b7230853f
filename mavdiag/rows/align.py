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

A link is orderly while every sample comes before the gyro is `ORDER_NS` further than its time. On a native grid and an
orderly link a row waits only for what is missing: it comes out when the gyro is so much further, if gyro and
interpolated signals miss no sample up to it. On a link that stops being orderly the aligner cannot see that a held
signal misses a sample, or that a stopped one has begun again. So the first such sample that comes late counts in a log
from its own time on, and live from the next row on; then rows wait for all for `CALM_NS`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavdiag.errors import InputError
from mavdiag.jit import cached, cached_loop, inline, jit
from mavdiag.rows.block import Block
from mavdiag.rows.grid import Grid, measure_grid
from mavdiag.rows.quality import GLITCH_S, MOST_LOST, LinkQuality, Memories, believed
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_MS, NS_PER_S

__all__ = ["USED", "AlignSpec", "AlignState", "Grid", "measure_grid"]

# Interpolated to the row where two samples this near surround it [s]; a slow command stream may have 4 Hz (our choice).
LINEAR = {  # or max_gap_s if longer
    Signal.SPECIFIC_FORCE: 0.0,
    Signal.TORQUE_COMMAND: 0.25,
    Signal.RATE_SETPOINT: 0.25,
    Signal.ATTITUDE: 0.25,
}
# How long the last value holds [s]: ACTUATOR comes at 10-50 Hz, VIBRATION at 2-10 Hz, a battery changes slowly (our
# choices). Logs write ARMED only when it changes.
HELD = {
    Signal.THRUST_SETPOINT: 1.0,
    Signal.HEIGHT: 2.0,
    Signal.VOLTAGE: 10.0,
    Signal.ARMED: math.inf,
    Signal.VIBRATION: 1.0,
    Signal.ACTUATOR: 1.0,
}
STREAMS = (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, *LINEAR, *HELD)
USED = frozenset(STREAMS)
PLACES = {signal: place for place, signal in enumerate(STREAMS)}
GYRO, SETPOINT, ATTITUDE, THRUST = (
    PLACES[one] for one in (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, Signal.ATTITUDE, Signal.THRUST_SETPOINT)
)  # from THRUST on signals are held
WIDTHS = (
    4,
    3,
    3,
    3,
    3,
    3,
    1,
    1,
    1,
    1,
    3,
    0,
)  # columns; the gyro's last is its doubt; those of outputs are the sent ones
FIRST = np.cumsum((0, *WIDTHS[:-1]))  # row of x that each signal's columns begin with

NEVER_NS = 2**62
ORDER_NS = 5 * NS_PER_MS  # our choice
CALM_NS = 10 * NS_PER_S  # after a late sample, until the link counts as orderly again (our choice)
BEGIN_NS = NS_PER_S  # after the first gyro sample, likewise; nothing is judged so early (our choice)
TURN = 2 * math.pi
MISSING = 1.5  # usual steps: in a longer one a sample is missing
SLOWER = 1.0625  # by how much the usual step may grow with each chunk, so that losses do not stretch it (our choice)
# Of each stream: its samples in its arrays, those that may still be needed; latest time seen; earlier samples and this
# one are settled, what comes for them is dropped; usual step, 0 while it is not known [ns].
LO, HI, NEWEST, FLOOR, STEP = range(5)
# Behind the limits of the streams.
BREAK, REORDER, USABLE, SETTLE_GAP, SETTLE_START = range(len(STREAMS), len(STREAMS) + 5)


class AlignState:
    """All that the aligner remembers between chunks; changed in place.

    times, values: (n,) and (n, k) samples of each stream, in order of time, times strictly rising. marks: `LO` ... of
    each. turns: (3,) full turns that belong to the first sample of an angle.
    segment: number of the present one. last_ns: time of the last row. done_ns: gyro samples up to here are dealt with.
    calm_ns: from here on the link is orderly. blank_ns: (2,) until when gyro and set-point are not used.
    """

    __slots__ = (
        "blank_ns",
        "calm_ns",
        "done_ns",
        "last_ns",
        "marks",
        "memories",
        "segment",
        "times",
        "turns",
        "values",
    )

    def __init__(self) -> None:
        self.times: list[IntArray] = [np.empty(0, dtype=np.int64) for _ in STREAMS]
        self.values: list[FloatArray] = [np.empty((0, width)) for width in WIDTHS]
        self.marks: IntArray = np.tile(np.array([0, 0, -NEVER_NS, -NEVER_NS, 0]), (len(STREAMS), 1))
        self.turns: FloatArray = np.zeros((len(STREAMS), 3))
        self.memories: Memories = {}
        self.segment, self.last_ns, self.done_ns, self.calm_ns = -1, -NEVER_NS, -NEVER_NS, NEVER_NS
        self.blank_ns: IntArray = np.full(2, -NEVER_NS)

    def newest_ns(self, signal: Signal) -> int:
        """Latest time seen of a signal [ns]."""
        return int(self.marks[PLACES[signal], NEWEST])


@dataclass(frozen=True)
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

    @cached_property
    def limits_ns(self) -> IntArray:
        """How far samples reach, for each stream; then `BREAK` ... [ns]."""
        linear_s = [max(span_s, self.usable_gap_s) for span_s in LINEAR.values()]
        settling = (self.usable_gap_s, self.settle_gap_s, self.settle_start_s)
        spans_s = [self.break_s, self.break_s, *linear_s, *HELD.values(), self.break_s, self.reorder_s, *settling]
        return np.array([NEVER_NS if span_s == math.inf else round(span_s * NS_PER_S) for span_s in spans_s])

    def start(self) -> AlignState:
        """A fresh state: no sample yet."""
        return AlignState()

    def step(self, state: AlignState, telemetry: Telemetry) -> list[Block]:
        """Take in a chunk, return the rows that it completes, in blocks of one segment."""
        self.take(state, believed(self.quality, telemetry, state.memories))
        native, streams = self.grid is Grid.NATIVE, self._streams(state)
        blocks = list(self.rows(state, _horizon(streams, state.calm_ns, native, self.dt_s * NS_PER_S)))
        most_ns = 2 * int(self.limits_ns[BREAK])  # of samples without a row (B22)
        if int(state.marks[:, NEWEST].max()) - most_ns > state.last_ns:
            _forget(streams, state.last_ns, most_ns)
        return blocks

    def finish(self, state: AlignState) -> list[Block]:
        """The end of a log: what waited for late samples comes out."""
        return list(self.rows(state, NEVER_NS))

    def believed(self, telemetry: Telemetry) -> Telemetry:
        """What is believed of a whole log."""
        return believed(self.quality, telemetry)

    def take(self, state: AlignState, telemetry: Telemetry) -> None:
        """Take in what is believed of a chunk."""
        gyro, before_ns, late = telemetry.get(Signal.BODY_RATE), int(state.marks[GYRO, NEWEST]), False
        fresh, hosts = (NO_TIMES, NO_TIMES) if gyro is None else (gyro.t_ns, gyro.host_ns)
        reorder_ns = int(self.limits_ns[REORDER])
        for series in telemetry.series:
            place = PLACES.get(series.signal)
            if place is not None and len(series):
                _make_room(state, place, series)
                came = series.t_ns, series.host_ns, series.values
                stream, steps = (state.times[place], state.values[place]), np.empty(len(series), dtype=np.int64)
                late |= _merge(stream, state.marks[place], came, (fresh, hosts), before_ns, reorder_ns, steps)
        if len(fresh) and state.calm_ns == NEVER_NS:
            state.calm_ns = int(fresh[0]) + BEGIN_NS
        if late:
            state.calm_ns = max(state.calm_ns, int(state.marks[GYRO, NEWEST]) + CALM_NS)

    def rows(self, state: AlignState, until_ns: int, most: int = NEVER_NS) -> Iterator[Block]:
        """The rows up to a time, a block of each segment, or of at most about so many rows."""
        dt_ns, resampled = self.dt_s * NS_PER_S, self.grid is Grid.RESAMPLED
        while True:
            done_ns, streams = state.done_ns, self._streams(state)
            t_ns, broken, state.done_ns = _place(streams, done_ns, state.last_ns, until_ns, dt_ns, resampled, most)
            if broken:
                state.segment, state.blank_ns[0] = state.segment + 1, t_ns[0] + self.limits_ns[SETTLE_START]
            if len(t_ns):
                yield self._filled(state, streams, t_ns)
            elif state.done_ns == done_ns:
                return

    def reached_ns(self, state: AlignState, chunks: Sequence[Telemetry]) -> int | None:
        """No row later than this comes of the next chunks [ns]; None if they hold no sample."""
        newest: list[int] = state.marks[:, NEWEST].tolist()
        came = [one for chunk in chunks for one in chunk.series if one.signal in PLACES and len(one)]
        if not came:
            return None
        for series in came:
            newest[PLACES[series.signal]] = max(newest[PLACES[series.signal]], int(series.t_ns[-1]))
        limits: list[int] = self.limits_ns.tolist()
        gyro_ns, hurries = newest[GYRO], self.grid is Grid.NATIVE and newest[GYRO] > state.calm_ns
        safe = max(gyro_ns, max(newest) - limits[BREAK]) - limits[REORDER]
        sent = [place for place in range(SETPOINT, THRUST) if newest[place] > -NEVER_NS]
        waited = [newest[place] for place in sent if safe < newest[place] + limits[place]]
        return min(max(safe, gyro_ns - ORDER_NS) if hurries else safe, *waited, NEVER_NS)

    def _streams(self, state: AlignState) -> "_Streams":
        times, values = tuple(state.times), tuple(state.values)
        return _Streams(times, values, state.marks, state.turns, state.blank_ns, self.limits_ns)

    def _filled(self, state: AlignState, streams: "_Streams", t_ns: IntArray) -> Block:
        """The rows at these times."""
        outputs = state.values[-1].shape[1]
        x, flags = np.empty((int(FIRST[-1]) + outputs, len(t_ns))), np.empty((2, len(t_ns)), dtype=np.bool_)
        _fill(streams, t_ns, x, flags)
        state.last_ns = int(t_ns[-1])
        return Block(
            segment=state.segment,
            dt_s=self.dt_s,
            t_ns=t_ns,
            rate=x[0:3].T,
            doubt=x[3],
            setpoint=x[4:7].T,
            force=x[7:10].T,
            torque=x[10:13].T,
            rate_setpoint=x[13:16].T,
            attitude=x[16:19].T,
            thrust=x[19],
            height=x[20],
            voltage=x[21],
            armed=x[22],
            vibration=x[23:26].T,
            actuator=x[26:].T,
            valid=flags[0],
            setpoint_valid=flags[1],
        )


NO_TIMES = np.empty(0, dtype=np.int64)


class _Streams(NamedTuple):
    """What compiled loops read and change of `AlignState`, and `AlignSpec.limits_ns`."""

    times: tuple[IntArray, ...]
    values: tuple[FloatArray, ...]
    marks: IntArray
    turns: FloatArray
    blank_ns: IntArray
    limits_ns: IntArray


def _make_room(state: AlignState, place: int, series: Series) -> None:
    """Arrays that have room for more samples; those of the first ones themselves where they are in order."""
    lo, hi = state.marks[place, :2].tolist()
    columns, before = series.values.shape[1], state.values[place].shape[1]
    if columns != before and (hi > 0 or place < len(STREAMS) - 1):
        raise InputError(f"{series.signal} has {columns} columns in place of {before}")
    if hi + len(series) <= len(state.times[place]):
        return
    if hi == 0 and bool(np.all(series.t_ns[1:] > series.t_ns[:-1])):
        state.times[place], state.values[place] = series.t_ns, series.values
        return
    room = len(series) + 2 * (hi - lo)
    times, values = np.empty(room, dtype=np.int64), np.empty((room, columns))
    if hi:
        times[: hi - lo], values[: hi - lo] = state.times[place][lo:hi], state.values[place][lo:hi]
    state.times[place], state.values[place] = times, values
    state.marks[place, :2] = 0, hi - lo


@jit
def _middle(steps: IntArray, count: int) -> int:
    """The lower middle one of so many, by Hoare's selection; changes their order."""
    place, low, high = (count - 1) // 2, 0, count - 1
    while low < high:
        pivot, i, j = steps[place], low, high
        while i <= j:
            while steps[i] < pivot:
                i += 1
            while steps[j] > pivot:
                j -= 1
            if i <= j:
                steps[i], steps[j] = steps[j], steps[i]
                i += 1
                j -= 1
        low = i if j < place else low
        high = j if place < i else high
    return int(steps[place])


@cached_loop
def _merge(
    stream: tuple[IntArray, FloatArray],
    marks: IntArray,
    came: tuple[IntArray, IntArray, FloatArray],
    gyro: tuple[IntArray, IntArray],
    gyro_ns: int,
    reorder_ns: int,
    steps: IntArray,
) -> bool:
    """Take in new samples of a stream; whether one is late. Of equal times the last to come counts.

    stream: its times and values; marks: of it. came: times of vehicle and receiver, and values; they may be the
    stream's own arrays, if it begins. gyro: likewise what the gyro brings with this chunk, after gyro_ns. steps: room.
    """
    (t, v), (came_t, came_host, came_v), (gyro_t, gyro_host) = stream, came, gyro
    lo, hi, newest, late, behind, risen = marks[LO], marks[HI], marks[NEWEST], False, 0, 0
    expected = len(came_t) if hi > lo else len(came_t) - 1
    for i in range(len(came_t)):
        while behind < len(gyro_t) and gyro_host[behind] < came_host[i]:
            gyro_ns = max(gyro_ns, gyro_t[behind])
            behind += 1
        late = late or came_t[i] <= gyro_ns - ORDER_NS
        at_ns, at = came_t[i], hi
        if at_ns > newest:
            if hi > lo:
                steps[risen] = at_ns - t[hi - 1]
                risen += 1
            newest = at_ns
        elif at_ns < newest - reorder_ns or at_ns <= marks[FLOOR]:
            continue
        else:
            while at > lo and t[at - 1] >= at_ns:
                at -= 1
        if at == hi or t[at] != at_ns:
            for k in range(hi, at, -1):
                t[k] = t[k - 1]
                for column in range(v.shape[1]):
                    v[k, column] = v[k - 1, column]
            hi += 1
        t[at] = at_ns
        for column in range(v.shape[1]):
            v[at, column] = came_v[i, column]
    marks[HI], marks[NEWEST] = hi, newest
    if risen and risen == expected:  # all new and in order
        middle = _middle(steps, risen)
        marks[STEP] = min(middle, int(SLOWER * marks[STEP])) if marks[STEP] else middle
    return late


@jit
def _whole_ns(s: _Streams, place: int, since_ns: int, most_ns: float) -> int:
    """Up to where no sample is missing among those after `since_ns`; that time itself if that is not known.

    A sample is missing in a step above 1.5 of the usual one, or of `most_ns` if that is shorter.
    """
    t, lo, hi, usual_ns = s.times[place], s.marks[place, LO], s.marks[place, HI], min(s.marks[place, STEP], most_ns)
    first = lo
    while first < hi and t[first] <= since_ns:
        first += 1
    if usual_ns == 0 or first == hi:
        return since_ns
    last = max(first - 1, lo)
    while last + 1 < hi and t[last + 1] - t[last] <= MISSING * usual_ns:
        last += 1
    return int(t[last])


@cached_loop
def _horizon(s: _Streams, calm_ns: int, native: bool, dt_ns: float) -> int:
    """Rows up to here are complete: every sample that they need has come, or cannot come any more.

    All samples up to `safe` have come. If only the gyro stops, the time of the others shows it after `break_s`.
    """
    gyro_ns = latest = s.marks[GYRO, NEWEST]
    if gyro_ns == -NEVER_NS:
        return -NEVER_NS
    for place in range(len(s.marks)):
        latest = max(latest, s.marks[place, NEWEST])
    found = safe = max(gyro_ns, latest - s.limits_ns[BREAK]) - s.limits_ns[REORDER]
    hurries = native and gyro_ns > calm_ns
    if hurries:
        found = max(safe, min(gyro_ns - ORDER_NS, _whole_ns(s, GYRO, safe, dt_ns)))
    for place in range(SETPOINT, THRUST):
        t, lo, hi = s.times[place], s.marks[place, LO], s.marks[place, HI]
        settled = max(safe, s.marks[place, NEWEST] - s.limits_ns[REORDER])
        if hurries:
            settled = max(settled, _whole_ns(s, place, settled, np.inf))
        behind = hi - 1
        while behind >= lo and t[behind] > settled:
            behind -= 1
        if behind >= lo and settled < t[behind] + s.limits_ns[place]:  # the next sample may still count
            found = min(found, t[behind])
        elif behind + 1 < hi:
            found = min(found, settled)
    return int(found)


@cached
def _place(
    s: _Streams, done_ns: int, last_ns: int, until_ns: int, dt_ns: float, resampled: bool, most: int
) -> tuple[IntArray, bool, int]:
    """Times of the next rows, whether they begin a segment, and the last gyro sample that is dealt with.

    On a native grid every sample is a row, but for one that is nearer than half a period to the last row, and what is
    missing between two is filled evenly. last_ns: of the last row.
    """
    t, first, hi, break_ns = s.times[GYRO], s.marks[GYRO, LO], s.marks[GYRO, HI], s.limits_ns[BREAK]
    while first < hi and t[first] <= done_ns:
        first += 1
    if first >= hi or t[first] > until_ns:
        return np.empty(0, dtype=np.int64), False, done_ns
    broken = t[first] - done_ns > break_ns
    stop = first + 1
    while stop < hi and stop - first < most and t[stop] <= until_ns and t[stop] - t[stop - 1] <= break_ns:
        stop += 1
    if resampled:
        step_ns = int(np.round(dt_ns))
        begin = t[first] if broken else last_ns + step_ns
        return np.arange(begin, t[stop - 1] + 1, step_ns), broken, int(t[stop - 1])
    last = t[first] if broken else last_ns
    rows, count = np.empty(int((t[stop - 1] - last) / dt_ns) + 2 * (stop - first) + 2, dtype=np.int64), 0
    if broken:
        rows[0], count = last, 1
    for i in range(first, stop):
        steps = int(np.round((t[i] - last) / dt_ns))
        for k in range(1, steps):
            rows[count] = last + int(np.round(k * (t[i] - last) / steps))
            count += 1
        if steps >= 1:
            rows[count], last = t[i], t[i]
            count += 1
    return rows[:count], broken, int(t[stop - 1])


@inline
def _turn(before: float, after: float) -> float:
    """Full turns that a step of an angle seems to jump by."""
    step = after - before
    return 0.0 if abs(step) <= math.pi else float(-np.round(step / TURN))


@jit
def _behind(s: _Streams, place: int, at: int, row_ns: int) -> int:
    """The last sample up to a row, from one before it on; of an angle with the full turns that belong to it."""
    t, v, hi = s.times[place], s.values[place], s.marks[place, HI]
    while at + 1 < hi and t[at + 1] <= row_ns:
        if place in (SETPOINT, ATTITUDE):
            for column in range(3):
                s.turns[place, column] += _turn(v[at, column], v[at + 1, column])
        at += 1
    return at


@jit
def _settle(s: _Streams, place: int, at: int) -> None:
    """Leave out the samples before this one."""
    if at > s.marks[place, LO]:
        s.marks[place, LO], s.marks[place, FLOOR] = at, s.times[place][at]


@cached_loop
def _forget(s: _Streams, last_ns: int, most_ns: int) -> None:
    """Leave out samples that are so much older than the newest, but for the one that a row after them needs."""
    for place in range(len(s.marks)):
        before_ns = max(last_ns, s.marks[place, NEWEST] - most_ns)
        _settle(s, place, _behind(s, place, s.marks[place, LO], before_ns))


@cached_loop
def _fill(s: _Streams, rows: IntArray, x: FloatArray, flags: BoolArray) -> None:
    """Read all streams at the times of rows; what lies before the last row is settled.

    x: a row for each column of a stream, from FIRST on. flags: whether gyro and set-point may be used.
    """
    for place in range(len(s.marks)):
        _settle(s, place, _hold(s, place, rows, x) if place >= THRUST else _interpolate(s, place, rows, x, flags))


@jit
def _hold(s: _Streams, place: int, rows: IntArray, x: FloatArray) -> int:
    """The last value at each row, nan where it is older than the limit; returns the last sample that was read."""
    t, v, at, hi, limit_ns = s.times[place], s.values[place], s.marks[place, LO], s.marks[place, HI], s.limits_ns[place]
    i = 0
    while i < len(rows):
        while at + 1 < hi and t[at + 1] <= rows[i]:
            at += 1
        known, stop = at < hi and t[at] <= rows[i] <= t[at] + limit_ns, i + 1
        if known:
            until = t[at] + limit_ns if at + 1 == hi else min(t[at] + limit_ns, t[at + 1] - 1)
            while stop < len(rows) and rows[stop] <= until:
                stop += 1
        elif at == hi:
            stop = len(rows)
        for column in range(v.shape[1]):
            x[FIRST[place] + column, i:stop] = v[at, column] if known else np.nan
        i = stop
    return int(at)


@jit
def _interpolate(s: _Streams, place: int, rows: IntArray, x: FloatArray, flags: BoolArray) -> int:
    """The value between the samples around each row; returns the last sample before the last row.

    Where they are farther apart than the limit, gyro and set-point keep the last value, others are nan.
    """
    t, v, at, hi, limit_ns = s.times[place], s.values[place], s.marks[place, LO], s.marks[place, HI], s.limits_ns[place]
    angle, first, columns, turns = place in (SETPOINT, ATTITUDE), FIRST[place], v.shape[1], s.turns[place]
    for i in range(len(rows)):
        if at + 1 < hi and t[at + 1] <= rows[i]:
            at = _behind(s, place, at, rows[i])
        since = rows[i] - t[at] if at < hi else -1
        gap = 0 if since == 0 else t[at + 1] - t[at] if since > 0 and at + 1 < hi else NEVER_NS
        if since < 0 or (gap > limit_ns and place > SETPOINT):
            for column in range(columns):
                x[first + column, i] = 0.0 if place == SETPOINT else np.nan
        else:
            for column in range(columns):
                x[first + column, i] = v[at, column] + (TURN * turns[column] if angle else 0.0)
        if 0 < gap <= limit_ns:
            share = since / gap
            for column in range(columns):
                after, value = v[at + 1, column], x[first + column, i]
                if angle:
                    after += TURN * (turns[column] + _turn(v[at, column], after))
                x[first + column, i] = value + share * (after - value)
        if place <= SETPOINT:
            flags[place, i] = _usable(s, place, rows[i], gap, place == GYRO and x[3, i] > 0.0)
            if place == GYRO:
                x[3, i] = math.ceil(x[3, i])
    return int(at)


@inline
def _usable(s: _Streams, place: int, row_ns: int, gap: int, doubted: bool) -> bool:
    """Whether a row is outside of gaps and of what must settle after them; what follows a doubt is as after a gap."""
    if doubted:
        gap = max(gap, s.limits_ns[USABLE] + 1)
    if gap > s.limits_ns[USABLE]:
        settle = s.limits_ns[SETTLE_START] if gap > s.limits_ns[BREAK] else s.limits_ns[SETTLE_GAP]
        s.blank_ns[place] = max(s.blank_ns[place], row_ns + settle)
    return bool(row_ns > s.blank_ns[place])
