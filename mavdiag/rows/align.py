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
USED = (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, *LINEAR, *HELD)
PLACES = {signal: place for place, signal in enumerate(USED)}
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
PIECE_ROWS = 8192  # of a block at most, about: what a long log needs beside itself (our choice)
TURN = 2 * math.pi
MISSING = 1.5  # usual steps: in a longer one a sample is missing
SLOWER = 1.0625  # by how much the usual step may grow with each chunk, so that losses do not stretch it (our choice)
# Of each stream: its samples in its arrays, those that may still be needed; latest time seen; earlier samples and this
# one are settled, what comes for them is dropped; usual step, 0 while it is not known [ns].
LO, HI, NEWEST, FLOOR, STEP = range(5)
# Behind the limits of the streams.
BREAK, REORDER, USABLE, SETTLE_GAP, SETTLE_START = range(len(USED), len(USED) + 5)


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
        self.times: list[IntArray] = [np.empty(0, dtype=np.int64) for _ in USED]
        self.values: list[FloatArray] = [np.empty((0, width)) for width in WIDTHS]
        self.marks: IntArray = np.tile(np.array([0, 0, -NEVER_NS, -NEVER_NS, 0]), (len(USED), 1))
        self.turns: FloatArray = np.zeros((len(USED), 3))
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
        native = self.grid is Grid.NATIVE
        until_ns = _horizon(
            tuple(state.times), state.marks, self.limits_ns, state.calm_ns, native, self.dt_s * NS_PER_S
        )
        blocks = list(self.rows(state, until_ns))
        most_ns = 2 * int(self.limits_ns[BREAK])  # of samples without a row (B22)
        if int(state.marks[:, NEWEST].max()) - most_ns > state.last_ns:
            _forget(tuple(state.times), tuple(state.values), state.marks, state.turns, state.last_ns, most_ns)
        return blocks

    def finish(self, state: AlignState) -> list[Block]:
        """The end of a log: what waited for late samples comes out."""
        return list(self.rows(state, NEVER_NS))

    def believed(self, telemetry: Telemetry) -> Telemetry:
        """What is believed of a whole log."""
        return believed(self.quality, telemetry)

    def take(self, state: AlignState, telemetry: Telemetry) -> None:
        """Take in what is believed of a chunk."""
        gyro = telemetry.get(Signal.BODY_RATE)
        fresh, hosts = (NO_TIMES, NO_TIMES) if gyro is None else (gyro.t_ns, gyro.host_ns)
        before_ns, late = int(state.marks[GYRO, NEWEST]), False
        for series in telemetry.series:
            place = PLACES.get(series.signal)
            if place is None or not len(series):
                continue
            _make_room(state, place, series)
            came = (series.t_ns, series.host_ns, series.values, fresh, hosts)
            reorder_ns = int(self.limits_ns[REORDER])
            stream = state.times[place], state.values[place], state.marks, place
            steps = np.empty(len(series), dtype=np.int64)
            late |= _merge(*stream, *came, before_ns, reorder_ns, steps)
        if len(fresh) and state.calm_ns == NEVER_NS:
            state.calm_ns = int(fresh[0]) + BEGIN_NS
        if late:
            state.calm_ns = max(state.calm_ns, int(state.marks[GYRO, NEWEST]) + CALM_NS)

    def rows(self, state: AlignState, until_ns: int, most: int = PIECE_ROWS) -> Iterator[Block]:
        """The rows up to a time, one block of at most about so many at a time."""
        step_ns = 0 if self.grid is Grid.NATIVE else round(self.dt_s * NS_PER_S)
        spans = (self.dt_s * NS_PER_S, step_ns, int(self.limits_ns[BREAK]))
        while True:
            done_ns, times = state.done_ns, state.times[GYRO]
            t_ns, broken, state.done_ns = _place(times, state.marks, done_ns, state.last_ns, until_ns, *spans, most)
            if broken:
                state.segment, state.blank_ns[0] = state.segment + 1, t_ns[0] + self.limits_ns[SETTLE_START]
            if len(t_ns):
                yield self._filled(state, t_ns)
            elif state.done_ns == done_ns:
                return

    def reached_ns(self, state: AlignState, chunks: Sequence[Telemetry]) -> int | None:
        """No row later than this comes of the next chunks [ns]; None if they hold no sample."""
        newest = state.marks[:, NEWEST].tolist()
        came = False
        for chunk in chunks:
            for series in chunk.series:
                if (place := PLACES.get(series.signal)) is not None and len(series):
                    newest[place], came = max(newest[place], int(series.t_ns[-1])), True
        if not came:
            return None
        limits, gyro_ns = self.limits_ns, newest[GYRO]
        safe = max(gyro_ns, max(newest) - int(limits[BREAK])) - int(limits[REORDER])
        waited = [
            t
            for t, limit in zip(newest[SETPOINT:THRUST], limits[SETPOINT:THRUST], strict=True)
            if -NEVER_NS < t and safe < t + limit
        ]
        hurries = self.grid is Grid.NATIVE and gyro_ns > state.calm_ns
        return min(max(safe, gyro_ns - ORDER_NS) if hurries else safe, *waited, NEVER_NS)

    def _filled(self, state: AlignState, t_ns: IntArray) -> Block:
        """The rows at these times."""
        outputs = state.values[-1].shape[1]
        x, flags = np.empty((FIRST[-1] + outputs, len(t_ns))), np.empty((2, len(t_ns)), dtype=np.bool_)
        streams = tuple(state.times), tuple(state.values), state.marks, state.turns
        _fill(*streams, self.limits_ns, t_ns, x, flags, state.blank_ns)
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


def _make_room(state: AlignState, place: int, series: Series) -> None:
    """Arrays that have room for more samples; those of the first ones themselves where they are in order."""
    lo, hi = state.marks[place, :2].tolist()
    columns, before = series.values.shape[1], state.values[place].shape[1]
    if columns != before and (hi > 0 or place < len(USED) - 1):
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


@jit
def _whole_ns(t: IntArray, lo: int, hi: int, since_ns: int, usual_ns: float) -> int:
    """Up to where no sample is missing among those after `since_ns`; that time itself if that is not known."""
    first = lo
    while first < hi and t[first] <= since_ns:
        first += 1
    if usual_ns == 0 or first == hi:
        return since_ns
    last = max(first - 1, lo)
    while last + 1 < hi and t[last + 1] - t[last] <= MISSING * usual_ns:
        last += 1
    return int(t[last])


@inline
def _advance(t: IntArray, v: FloatArray, turns: FloatArray, angle: bool, at: int) -> int:
    """To the next sample; of an angle with the full turns that belong to it."""
    if angle:
        for column in range(3):
            turns[column] += _turn(v[at, column], v[at + 1, column])
    return at + 1


@inline
def _turn(before: float, after: float) -> float:
    """Full turns that a step of an angle seems to jump by."""
    step = after - before
    return 0.0 if abs(step) <= math.pi else float(-np.round(step / TURN))


@inline
def _keep_from(t: IntArray, marks: IntArray, place: int, at: int) -> None:
    """Samples before this one are settled."""
    if at > marks[place, LO]:
        marks[place, LO], marks[place, FLOOR] = at, t[at]


@cached_loop
def _merge(
    t: IntArray,
    v: FloatArray,
    marks: IntArray,
    place: int,
    came_t: IntArray,
    came_host: IntArray,
    came_v: FloatArray,
    gyro_t: IntArray,
    gyro_host: IntArray,
    gyro_ns: int,
    reorder_ns: int,
    steps: IntArray,
) -> bool:
    """Take in new samples of a stream; whether one is late. Of equal times the last to come counts.

    gyro_t, gyro_host, gyro_ns: what the gyro brings with this chunk, and how far it was before. steps: room for as many
    as come. `came` may be `t` itself, of a stream that begins.
    """
    lo, hi, newest, floor = marks[place, LO], marks[place, HI], marks[place, NEWEST], marks[place, FLOOR]
    count, late, behind = len(came_t), False, 0
    risen, expected = 0, count if hi > lo else count - 1
    for i in range(count):
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
        elif at_ns < newest - reorder_ns or at_ns <= floor:
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
    marks[place, HI], marks[place, NEWEST] = hi, newest
    if risen and risen == expected:  # all new and in order
        middle, before = _middle(steps, risen), marks[place, STEP]
        marks[place, STEP] = min(middle, int(SLOWER * before)) if before else middle
    return late


@cached_loop
def _horizon(
    times: tuple[IntArray, ...], marks: IntArray, limits_ns: IntArray, calm_ns: int, native: bool, dt_ns: float
) -> int:
    """Rows up to here are complete: every sample that they need has come, or cannot come any more.

    All samples up to `safe` have come. If only the gyro stops, the time of the others shows it after `break_s`.
    """
    gyro_ns = marks[GYRO, NEWEST]
    if gyro_ns == -NEVER_NS:
        return -NEVER_NS
    latest = gyro_ns
    for place in range(len(marks)):
        latest = max(latest, marks[place, NEWEST])
    found = safe = max(gyro_ns, latest - limits_ns[BREAK]) - limits_ns[REORDER]
    hurries = native and gyro_ns > calm_ns
    if hurries:
        usual_ns = min(float(marks[GYRO, STEP]), dt_ns)
        whole_ns = _whole_ns(times[GYRO], marks[GYRO, LO], marks[GYRO, HI], safe, usual_ns)
        found = max(safe, min(gyro_ns - ORDER_NS, whole_ns))
    for place in range(SETPOINT, THRUST):
        t, lo, hi = times[place], marks[place, LO], marks[place, HI]
        if lo == hi:
            continue
        settled = max(safe, marks[place, NEWEST] - limits_ns[REORDER])
        if hurries:
            settled = max(settled, _whole_ns(t, lo, hi, settled, float(marks[place, STEP])))
        behind = hi - 1
        while behind >= lo and t[behind] > settled:
            behind -= 1
        if behind >= lo and settled < t[behind] + limits_ns[place]:  # the next sample may still count
            found = min(found, t[behind])
        elif behind + 1 < hi:
            found = min(found, settled)
    return found


@cached
def _place(
    t: IntArray,
    marks: IntArray,
    done_ns: int,
    last_ns: int,
    until_ns: int,
    dt_ns: float,
    step_ns: int,
    break_ns: int,
    most: int,
) -> tuple[IntArray, bool, int]:
    """Times of the next rows, whether they begin a segment, and the last gyro sample that is dealt with.

    On a native grid (step_ns 0) every sample is a row, but for one that is nearer than half a period to the last
    row, and what is missing between two is filled evenly. t: of the gyro. last_ns: of the last row.
    """
    first, hi = marks[GYRO, LO], marks[GYRO, HI]
    while first < hi and t[first] <= done_ns:
        first += 1
    if first >= hi or t[first] > until_ns:
        return np.empty(0, dtype=np.int64), False, done_ns
    broken = t[first] - done_ns > break_ns
    stop = first + 1
    while stop < hi and stop - first < most and t[stop] <= until_ns and t[stop] - t[stop - 1] <= break_ns:
        stop += 1
    if step_ns:
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


@jit
def _hold(
    t: IntArray, v: FloatArray, at: int, hi: int, limit_ns: int, rows: IntArray, x: FloatArray, first: int
) -> int:
    """The last value at each row, nan where it is older than the limit; returns the last sample that was read."""
    i = 0
    while i < len(rows):
        while at + 1 < hi and t[at + 1] <= rows[i]:
            at += 1
        known = at < hi and t[at] <= rows[i] <= t[at] + limit_ns
        stop = i + 1
        if known:
            until = t[at] + limit_ns if at + 1 == hi else min(t[at] + limit_ns, t[at + 1] - 1)
            while stop < len(rows) and rows[stop] <= until:
                stop += 1
        elif at == hi:
            stop = len(rows)
        for column in range(v.shape[1]):
            x[first + column, i:stop] = v[at, column] if known else np.nan
        i = stop
    return at


@jit
def _interpolate(
    t: IntArray,
    v: FloatArray,
    at: int,
    hi: int,
    place: int,
    turns: FloatArray,
    limits_ns: IntArray,
    rows: IntArray,
    x: FloatArray,
    first: int,
    flags: BoolArray,
    blank_ns: IntArray,
) -> int:
    """The value between the samples around each row; returns the last sample before the last row.

    Where they are farther apart than the limit, gyro and set-point keep the last value, others are nan.
    """
    angle, limit_ns, columns = place == SETPOINT or place == ATTITUDE, limits_ns[place], v.shape[1]
    for i in range(len(rows)):
        while at + 1 < hi and t[at + 1] <= rows[i]:
            at = _advance(t, v, turns, angle, at)
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
            if place == GYRO and x[3, i] > 0.0:  # what must settle after a doubt is as after a gap
                x[3, i] = math.ceil(x[3, i])
                gap = max(gap, limits_ns[USABLE] + 1)
            if gap > limits_ns[USABLE]:
                settle = limits_ns[SETTLE_START] if gap > limits_ns[BREAK] else limits_ns[SETTLE_GAP]
                blank_ns[place] = max(blank_ns[place], rows[i] + settle)
            flags[place, i] = rows[i] > blank_ns[place]
    return at


@cached_loop
def _fill(
    times: tuple[IntArray, ...],
    values: tuple[FloatArray, ...],
    marks: IntArray,
    turns: FloatArray,
    limits_ns: IntArray,
    rows: IntArray,
    x: FloatArray,
    flags: BoolArray,
    blank_ns: IntArray,
) -> None:
    """Read all streams at the times of rows; what lies before the last row is settled.

    x: a row for each column of a stream, from FIRST on. flags: whether gyro and set-point may be used.
    """
    for place in range(len(marks)):
        t, v, at, hi, first = times[place], values[place], marks[place, LO], marks[place, HI], FIRST[place]
        if place >= THRUST:
            at = _hold(t, v, at, hi, limits_ns[place], rows, x, first)
        else:
            at = _interpolate(t, v, at, hi, place, turns[place], limits_ns, rows, x, first, flags, blank_ns)
        _keep_from(t, marks, place, at)


@cached_loop
def _forget(
    times: tuple[IntArray, ...],
    values: tuple[FloatArray, ...],
    marks: IntArray,
    turns: FloatArray,
    last_ns: int,
    most_ns: int,
) -> None:
    """Leave out samples that are so much older than the newest, but for the one that a row after them needs."""
    for place in range(len(marks)):
        t, at, hi = times[place], marks[place, LO], marks[place, HI]
        before_ns, angle = max(last_ns, marks[place, NEWEST] - most_ns), place == SETPOINT or place == ATTITUDE
        while at + 1 < hi and t[at + 1] <= before_ns:
            at = _advance(t, values[place], turns[place], angle, at)
        _keep_from(t, marks, place, at)
