"""Bring the streams of one vehicle onto one uniform grid: `AlignSpec.start`, `.step`, `.finish`.

The gyro is the master. On a *native* grid every row is one of its samples, other signals are brought to its time, and
lost samples become rows; on a *resampled* grid (uneven senders) all are interpolated to a fixed period. What is made
up is not judged: a row inside a gyro gap longer than `max_gap_s`, or than a glitch leaves, and `SETTLE_GAP_S` after it,
is invalid; a gap above `BREAK_S` starts a segment, whose first `SETTLE_START_S` are invalid (METHOD section 4). The
set-point has these limits and its own mark, and is nan in a gap above `BREAK_S`; others, where none is near enough.

Samples may be out of order by up to `REORDER_S`; later ones and duplicates are dropped. A row waits that long, and for
the next sample of an interpolated signal while it may count, so that the result does not depend on the chunks. On a
native grid and an orderly link (no sample comes after the gyro is `ORDER_NS` further) it waits for what is missing.
The first sample of a held signal that comes late counts in a log from its own time on, and live from the next row on;
then rows wait for all for `CALM_NS`.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import mavdiag.rows.block as col
from mavdiag.errors import InputError
from mavdiag.jit import cached, cached_loop, inline, jit
from mavdiag.rows.block import Block
from mavdiag.rows.grid import Grid as Grid
from mavdiag.rows.grid import measure_grid as measure_grid
from mavdiag.rows.quality import COLUMN, GLITCH_S, MOST_LOST, REORDER_S, RUNS, TURN, LinkQuality, Samples, look_at
from mavdiag.telemetry import FloatArray, IntArray, Signal, Telemetry
from mavdiag.units import NS_PER_MS, NS_PER_S

# Of each signal its number of columns (of outputs the sent ones; the gyro's last is its doubt), and how far its
# samples reach [s]. Up to THRUST they are interpolated where two samples this near, or as near as the gyro's, surround
# the row: a slow command stream may have 4 Hz; the others hold their last value for so long: ACTUATOR comes at 10-50
# Hz, VIBRATION at 2-10 Hz, ESCs tell their speed at 1-10 Hz (our choices). Logs write ARMED when it changes.
SIGNALS = {
    Signal.BODY_RATE: (4, 0.0),
    Signal.ATTITUDE_SETPOINT: (3, 0.0),
    Signal.SPECIFIC_FORCE: (3, 0.0),
    Signal.TORQUE_COMMAND: (3, 0.25),
    Signal.RATE_SETPOINT: (3, 0.25),
    Signal.ATTITUDE: (3, 0.25),
    Signal.THRUST_SETPOINT: (1, 1.0),
    Signal.HEIGHT: (1, 2.0),
    Signal.ARMED: (1, math.inf),
    Signal.VIBRATION: (3, 1.0),
    Signal.ACTUATOR: (0, 1.0),
    Signal.ROTOR_SPEED: (0, 1.5),
}
STREAMS = tuple(SIGNALS)
USED = frozenset(STREAMS)
PLACES = {signal: place for place, signal in enumerate(STREAMS)}
GYRO, SETPOINT, ATTITUDE, THRUST, OUTPUTS, SPEEDS = 0, 1, 5, 6, 10, 11  # the last two have as many columns as come
WIDTHS, REACHES_S = zip(*SIGNALS.values(), strict=True)
FIRST = np.array([col.PLACES[signal][0] for signal in STREAMS])  # row of x that each signal's columns begin with

SETTLE_GAP_S, SETTLE_START_S = 0.3, 1.0  # what is not used after a longer gap, and after a start or a break
BREAK_S = 1.0  # longest gap within a segment; how long a row waits for a set-point
NEVER_NS = 2**62
TWICE = -1e-9  # in place of a doubt about a sample of the gyro: another one had the same time
ORDER_NS = 5 * NS_PER_MS  # our choice
CALM_NS = 10 * NS_PER_S  # after a late sample, until the link counts as orderly again (our choice)
BEGIN_NS = NS_PER_S  # after the first gyro sample, likewise; nothing is judged so early (our choice)
MISSING = 1.5  # usual steps: in a longer one a sample is missing
SLOWER = 1.0625  # by how much the usual step may grow with each chunk, so that losses do not stretch it (our choice)
ROOM = 400  # samples more than half as many again as are kept: how long an array is made (our choice)
# Of each stream: its samples in its arrays, those that may still be needed; end of those that came since; how many of
# these wait for later ones to be believed; latest time seen; earlier samples and this one are settled, what comes for
# them is dropped; usual step, 0 while it is not known [ns].
LO, HI, END, WAITED, NEWEST, FLOOR, STEP = range(7)
BREAK, REORDER, USABLE, SETTLE_GAP, SETTLE_START = range(len(STREAMS), len(STREAMS) + 5)  # behind limits of streams
# Number of the segment; time of the last row; gyro samples up to here are dealt with; from here on the link is orderly;
# until when gyro and set-point are not used.
SEGMENT, LAST, DONE, CALM, BLANK = range(5)


class Streams(NamedTuple):
    """Samples of each signal by their place in `STREAMS`; compiled loops change them in place.

    times, hosts: (streams, n) in order of time, strictly rising up to `HI`; behind it in order of arrival. values:
    (columns, n), those of a stream from `firsts` on. marks: `LO` ... of each. rules, figures, counts: of each what
    `rows.quality` knows. turns: full turns that belong to the first sample of an angle. now: `SEGMENT` ... limits_ns:
    how far samples reach, then `BREAK` ...
    """

    times: IntArray
    hosts: IntArray
    values: FloatArray
    firsts: IntArray
    marks: IntArray
    rules: FloatArray
    figures: FloatArray
    counts: IntArray
    turns: FloatArray
    now: IntArray
    limits_ns: IntArray


class AlignState:
    """All that the aligner remembers between chunks.

    reached, ends: latest stamp and `END` of each as it came. sent, taken: how many columns it has, and which are used.
    room: samples in an array. into: where they are put: times of vehicle and receiver, values (n, k).
    """

    def __init__(self, limits_ns: IntArray) -> None:
        count = len(STREAMS)
        marks, now = np.zeros((count, STEP + 1), dtype=np.int64), np.full(BLANK + 2, -NEVER_NS)
        marks[:, [NEWEST, FLOOR]], now[[SEGMENT, CALM]] = -NEVER_NS, (-1, NEVER_NS)
        knows = np.zeros((count, 0)), np.zeros((count, 0)), np.zeros((count, 0), dtype=np.int64)
        arrays = np.empty((count, 0), np.int64), np.empty((count, 0), np.int64), np.empty((sum(WIDTHS), 0))
        firsts = np.cumsum((0, *WIDTHS))
        self.streams = Streams(*arrays, firsts, marks, *knows, np.zeros((count, 3)), now, limits_ns)
        self.room, self.ends, self.sent, self.reached = 0, [0] * count, [0] * count, [-NEVER_NS] * count
        self.taken: list[list[int] | slice | None] = [None] * count
        self._look()

    @property
    def last_ns(self) -> int:
        """Time of the last row [ns]."""
        return int(self.streams.now[LAST])

    def append(self, telemetry: Telemetry, spec: "AlignSpec") -> None:
        """Put samples behind those that came. Raises InputError if their columns are others than before."""
        places, ends, sent, reached = spec.places, self.ends, self.sent, self.reached
        for series in telemetry.series:
            place, values = places.get(series.signal), series.values
            count, found = values.shape
            if place is None or not count:
                continue
            if not sent[place]:  # all new ones together, before there is much to move
                new = [(places.get(one.signal), one.values.shape) for one in telemetry.series]
                for at, (samples, columns) in new:
                    if at is not None and samples and not sent[at]:
                        self._begin(at, columns, spec)
            if found != sent[place]:  # before anything is moved: the state stays whole
                raise InputError(f"{series.signal} has {found} columns in place of {sent[place]}")
            end = ends[place]
            if end + count > self.room:
                end = self._make_room(place, count)
            (times, hosts, to), taken, stop, t_ns = self.into[place], self.taken[place], end + count, series.t_ns
            times[end:stop], hosts[end:stop], ends[place] = t_ns, series.host_ns, stop
            if taken is None:
                to[end:stop] = values
            elif isinstance(taken, slice):
                to[end:stop] = values[:, taken]
            else:
                for column, of in enumerate(taken):
                    to[end:stop, column] = values[:, of] if of < found else np.nan
            last_ns = t_ns.item(-1)
            if last_ns > reached[place]:
                reached[place] = last_ns

    def _begin(self, place: int, found: int, spec: "AlignSpec") -> None:
        """Learn of the first samples of a stream what is believed of it; a column that is not sent is nan."""
        signal, (times, _, values, firsts) = STREAMS[place], self.streams[:4]
        taken = list(spec.takes.get(signal, range(found)))
        while taken and taken[-1] >= found:  # nothing is known of what is not sent
            del taken[-1]
        columns = len(taken)
        first_ones = slice(columns) if taken == list(range(columns)) else taken
        self.taken[place] = None if taken == list(range(found)) else first_ones
        self.sent[place] = found if place >= OUTPUTS else WIDTHS[place] - (place == GYRO)
        rule = spec.quality.rule(signal, found, taken)
        sizes = len(rule), COLUMN + 4 * columns, RUNS + 1 + columns
        rules, figures, counts = (_widened(*pair) for pair in zip(self.streams[5:8], sizes, strict=True))
        rules[place, : len(rule)] = rule
        if place >= OUTPUTS:
            above, below = np.split(values, [firsts[place + 1]])
            values = np.concatenate((above, np.empty((columns, times.shape[1])), below))
            firsts[place + 1 :] += columns
        self.streams = self.streams._replace(values=values, rules=rules, figures=figures, counts=counts)
        self._look()

    def _make_room(self, place: int, count: int) -> int:
        """Move the samples that are kept to the front, of longer arrays if need be; returns where the next are put."""
        (lo, hi), end, old = self.streams.marks[place, :END].tolist(), self.ends[place], self.streams
        kept, one, rows = end - lo, slice(place, place + 1), slice(*old.firsts[place : place + 2].tolist())
        if kept + count + ROOM // 2 > self.room:
            self.room = ROOM + 3 * (kept + count) // 2
            longer = (_widened(one, self.room, np.empty) for one in self.streams[:3])
            self.streams = self.streams._replace(**dict(zip(("times", "hosts", "values"), longer, strict=True)))
            self._look()
        for at, now, before in zip((one, one, rows), self.streams[:3], old[:3], strict=True):  # with the doubt
            now[at, :kept] = before[at, lo:end]
        self.streams.marks[place, :END] = 0, hi - lo
        return int(kept)

    def _look(self) -> None:
        (times, hosts, values), edges = self.streams[:3], self.streams.firsts.tolist()
        stops = [stop - (place == GYRO) for place, stop in enumerate(edges[1:])]  # without the doubt
        parts = [values[first:stop].T for first, stop in zip(edges, stops, strict=False)]
        self.into = list(zip(times, hosts, parts, strict=True))


@dataclass(frozen=True)
class AlignSpec:
    """Grid and limits; all spans in seconds of the vehicle's clock. Raises InputError on an impossible period.

    max_gap_s: longest gap of gyro and set-point that is interpolated. quality: what healthy flights showed of the link.
    takes: the columns of a signal that rows have, in this order, where not all as they come; none: it is not looked at.
    before: columns of room in front of the rows of each block.
    """

    dt_s: float
    grid: Grid = Grid.NATIVE
    max_gap_s: float = 0.035
    quality: LinkQuality = field(default_factory=LinkQuality)
    takes: Mapping[Signal, Sequence[int]] = field(default_factory=dict)
    before: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.dt_s < BREAK_S:
            raise InputError(f"sample time {self.dt_s} s must lie between 0 and {BREAK_S} s")

    @cached_property
    def places(self) -> dict[Signal, int]:
        """The streams that are looked at."""
        return {signal: place for signal, place in PLACES.items() if self.takes.get(signal) != ()}

    @cached_property
    def limits_ns(self) -> list[int]:
        """How far samples reach, for each stream; then `BREAK` ... [ns]."""
        glitch_s = (min(MOST_LOST, GLITCH_S / self.dt_s) + MISSING) * self.dt_s
        usable_s = max(self.max_gap_s, glitch_s)
        reach_s = [max(span_s, usable_s) if place < THRUST else span_s for place, span_s in enumerate(REACHES_S)]
        spans_s = [BREAK_S, BREAK_S, *reach_s[2:], BREAK_S, REORDER_S, usable_s, SETTLE_GAP_S, SETTLE_START_S]
        return [NEVER_NS if span_s == math.inf else round(span_s * NS_PER_S) for span_s in spans_s]

    def start(self) -> AlignState:
        """A fresh state: no sample yet."""
        return AlignState(np.array(self.limits_ns))

    def step(self, state: AlignState, *telemetry: Telemetry) -> list[Block]:
        """Take in chunks, return the rows that they complete, in blocks of one segment."""
        self.append(state, telemetry)
        return list(self.rows(state, self.take(state)))

    def finish(self, state: AlignState) -> list[Block]:
        """The end of a log: what waited for late samples comes out."""
        return list(self.rows(state, NEVER_NS))

    def append(self, state: AlignState, chunks: Iterable[Telemetry]) -> None:
        """Keep chunks for the next `take`."""
        for telemetry in chunks:
            state.append(telemetry, self)

    def take(self, state: AlignState, *, live: bool = True) -> int:
        """Believe and sort what came; returns up to when rows are complete [ns]. A log's rows always wait."""
        marks, hurries = state.streams.marks, live and self.grid is Grid.NATIVE
        marks[:, END] = state.ends
        room = np.empty((3, max(state.ends)), dtype=np.int64)
        until_ns = _take(state.streams, room, live, hurries, self.dt_s * NS_PER_S)
        state.reached, state.ends = marks[:, NEWEST].tolist(), marks[:, END].tolist()
        return until_ns

    def rows(self, state: AlignState, until_ns: int) -> Iterator[Block]:
        """The rows up to a time, a block of each segment."""
        dt_ns, resampled, more = self.dt_s * NS_PER_S, self.grid is Grid.RESAMPLED, True
        while more:
            t_ns, x, more = _rows(state.streams, until_ns, dt_ns, resampled, self.before)
            if len(t_ns):
                firsts = state.streams.firsts
                outputs = min(int(firsts[SPEEDS] - firsts[OUTPUTS]), col.MOST)
                yield Block(int(state.streams.now[SEGMENT]), self.dt_s, t_ns, x, outputs, 0, self.before)

    def reached_ns(self, state: AlignState) -> int:
        """No row later than this comes of what was appended [ns], if it is believed as what came before."""
        newest, limits, calm_ns = state.reached, self.limits_ns, int(state.streams.now[CALM])
        believed, gyro_ns = state.streams.marks[:, NEWEST].tolist(), newest[GYRO]
        safe = max(gyro_ns, max(newest) - limits[BREAK]) - limits[REORDER]
        found = max(safe, gyro_ns - ORDER_NS) if self.grid is Grid.NATIVE and gyro_ns > calm_ns else safe
        for place in range(SETPOINT, THRUST):
            comes = newest[place] < found and newest[place] - believed[place] < 2 * limits[place]
            if comes and safe < newest[place] + limits[place]:
                found = newest[place]
        return found

    def missing_ns(self, state: AlignState, row_ns: int) -> int:
        """How much of the gyro is missing until a row is complete, if all streams keep their usual steps [ns]."""
        calm = self.grid is Grid.NATIVE and state.reached[GYRO] > int(state.streams.now[CALM])
        expected = row_ns + (ORDER_NS if calm else self.limits_ns[REORDER])
        for newest_ns, step_ns in zip(
            state.reached[SETPOINT:THRUST], state.streams.marks[SETPOINT:THRUST, STEP].tolist(), strict=True
        ):
            if step_ns and newest_ns < row_ns:
                expected = max(expected, row_ns + (newest_ns - row_ns) % step_ns)
        return max(0, expected - state.reached[GYRO])


def _widened(table: NDArray[Any], width: int, make: Callable[..., NDArray[Any]] = np.zeros) -> NDArray[Any]:
    """A table with at least so many columns, the new ones as they are made."""
    wide = make((len(table), max(width, table.shape[1])), dtype=table.dtype)
    wide[:, : table.shape[1]] = table
    return wide


@jit
def _middle(steps: IntArray) -> int:
    """The lower median, by Hoare's quickselect, which reorders the steps; np.partition compiles for 10 s."""
    middle, first, last = (len(steps) - 1) // 2, 0, len(steps) - 1
    while first < last:
        low, high, pivot = first, last, steps[middle]
        while low <= high:
            while steps[low] < pivot:
                low += 1
            while pivot < steps[high]:
                high -= 1
            if low <= high:
                steps[low], steps[high], low, high = steps[high], steps[low], low + 1, high - 1
        first, last = low if high < middle else first, high if middle < low else last
    return int(steps[middle])


@jit
def _believe(s: Streams, place: int) -> int:
    """Move the believed ones of the samples that came behind the others, then what waits; returns how many they are."""
    first, last, row, stop = s.marks[place, HI], s.marks[place, END], s.firsts[place], s.firsts[place + 1]
    t_ns, host_ns, columns = s.times[place, first:last], s.hosts[place, first:last], stop - row - (place == GYRO)
    own = s.rules[place], s.figures[place], s.counts[place]
    samples = Samples(columns, own[0], own[1], own[2], t_ns, host_ns, s.values[row:stop], first)
    kept, done, there = look_at(samples, s.marks[place, WAITED], s.turns[place][:0], s.counts[place][:0])
    _move(s, place, first + done, first + there, first + kept)
    s.marks[place, WAITED], s.marks[place, END] = there - done, first + kept + there - done
    return int(kept)


@jit
def _move(s: Streams, place: int, first: int, stop: int, to: int) -> None:
    times, hosts = s.times[place], s.hosts[place]
    for i in range(first, stop if to < first else first):
        times[to], hosts[to] = times[i], hosts[i]
        for row in range(s.firsts[place], s.firsts[place + 1]):
            s.values[row, to] = s.values[row, i]
        to += 1


@jit
def _merge(s: Streams, place: int, count: int, gyro: IntArray, gyro_ns: int, steps: IntArray) -> bool:
    """Sort in the samples that came; whether one is late. Of equal times the last to come counts.

    Where the gyro's were two samples, it is not known whose time that is: the row counts as made up.

    gyro: (2, m) times of vehicle and receiver of what the gyro brings, after gyro_ns. steps: room; none in a log, where
    nothing asks for the usual step.
    """
    t, host, marks = s.times[place], s.hosts[place], s.marks[place]
    lo, hi, begin, newest, late, behind, risen = marks[LO], marks[HI], marks[HI], marks[NEWEST], False, 0, 0
    expected = count if hi > lo else count - 1
    for i in range(begin, begin + count):
        while behind < gyro.shape[1] and gyro[1, behind] < host[i]:
            gyro_ns = max(gyro_ns, gyro[0, behind])
            behind += 1
        at_ns, at = t[i], hi
        late = late or at_ns <= gyro_ns - ORDER_NS
        if at_ns > newest:
            if len(steps) and hi > lo:
                steps[risen] = at_ns - t[hi - 1]
                risen += 1
            newest = at_ns
        elif at_ns < newest - s.limits_ns[REORDER] or at_ns <= marks[FLOOR]:
            continue
        if hi < i:
            _move(s, place, i, i + 1, hi)
        while at > lo and t[at - 1] > at_ns:
            t[at], t[at - 1] = t[at - 1], t[at]
            for row in range(s.firsts[place], s.firsts[place + 1]):
                s.values[row, at], s.values[row, at - 1] = s.values[row, at - 1], s.values[row, at]
            at -= 1
        hi += 1
        if at > lo and t[at - 1] == at_ns:
            for row in range(3 if place == GYRO else 0):
                if s.values[row, at] != s.values[row, at - 1] and s.values[3, at] == 0.0:
                    s.values[3, at] = TWICE
            _move(s, place, at, hi, at - 1)
            hi -= 1
    marks[HI], marks[NEWEST] = hi, newest
    _move(s, place, begin + count, marks[END], hi)
    marks[END] += hi - begin - count
    if len(steps) and risen and risen == expected:  # all new and in order
        middle = _middle(steps[:risen])
        marks[STEP] = min(middle, int(SLOWER * marks[STEP])) if marks[STEP] else middle
    return bool(late)


@jit
def _latest(s: Streams) -> int:
    latest = -NEVER_NS
    for place in range(len(s.marks)):
        latest = max(latest, s.marks[place, NEWEST])
    return int(latest)


@cached_loop
def _take(s: Streams, room: IntArray, live: bool, hurries: bool, dt_ns: float) -> int:
    """Take in what came; returns up to when rows are complete. room: (3, ..)."""
    late, gyro_ns, fresh, most_ns = False, s.marks[GYRO, NEWEST], 0, 2 * s.limits_ns[BREAK]
    if _latest(s) - most_ns > s.now[LAST]:  # samples without a row (B22), but for one that rows may need
        for place in range(len(s.marks)):
            before_ns = max(s.now[LAST], s.marks[place, NEWEST] - most_ns)
            _settle(s, place, _behind(s, place, s.marks[place, LO], before_ns))
    for place in range(len(s.marks)):
        first = s.marks[place, HI]
        if first == s.marks[place, END]:
            continue
        count = _believe(s, place)
        if place == GYRO:
            fresh = count
            for i in range(fresh):
                room[1, i], room[2, i] = s.times[GYRO, first + i], s.hosts[GYRO, first + i]
        late |= _merge(s, place, count, room[1:, :fresh], gyro_ns, room[0] if live else room[0, :0])
    if fresh and s.now[CALM] == NEVER_NS:
        s.now[CALM] = room[1, 0] + BEGIN_NS
    if late:
        s.now[CALM] = max(s.now[CALM], s.marks[GYRO, NEWEST] + CALM_NS)
    return _horizon(s, hurries, dt_ns)


@jit
def _whole_ns(s: Streams, place: int, since_ns: int, most_ns: float) -> int:
    """Up to where no step after `since_ns` is above 1.5 of the usual one, or of `most_ns`; `since_ns` if not known."""
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


@jit
def _horizon(s: Streams, hurries: bool, dt_ns: float) -> int:
    """Rows up to here are complete: every sample that they need has come, or cannot come any more.

    All samples up to `safe` have come. If only the gyro stops, the time of the others shows it after `BREAK_S`.
    """
    gyro_ns = s.marks[GYRO, NEWEST]
    if gyro_ns == -NEVER_NS:
        return -NEVER_NS
    found = safe = max(gyro_ns, _latest(s) - s.limits_ns[BREAK]) - s.limits_ns[REORDER]
    hurries = hurries and gyro_ns > s.now[CALM]
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
def _rows(s: Streams, until_ns: int, dt_ns: float, resampled: bool, before: int) -> tuple[IntArray, FloatArray, bool]:
    """Times of the next rows of one segment, and x of `rows.block` without rates, behind some room.

    On a native grid every sample is a row, but for one that is nearer than half a period to the last row, and what is
    missing between two is filled evenly. The last: whether gyro samples are left.
    """
    t, first, hi, break_ns = s.times[GYRO], s.marks[GYRO, LO], s.marks[GYRO, HI], s.limits_ns[BREAK]
    while first < hi and t[first] <= s.now[DONE]:
        first += 1
    if first >= hi or t[first] > until_ns:
        return np.empty(0, dtype=np.int64), np.empty((0, 0)), False
    stop, broken = first + 1, t[first] - s.now[DONE] > break_ns
    while stop < hi and t[stop] <= until_ns and t[stop] - t[stop - 1] <= break_ns:
        stop += 1
    last, count = t[first] if broken else s.now[LAST], 0
    if resampled:
        step_ns = int(np.round(dt_ns))
        rows = np.arange(last if broken else last + step_ns, t[stop - 1] + 1, step_ns)
        count = len(rows)
    else:
        rows = np.empty(int((t[stop - 1] - last) / dt_ns) + 2 * (stop - first) + 2, dtype=np.int64)
        if broken:
            rows[0], count = last, 1
        for i in range(first, stop):
            begin, apart = last, (t[i] - last) / dt_ns
            steps = 1 if 0.5 < apart < 1.5 else int(np.round(apart))
            for k in range(1, steps + 1):
                rows[count] = last = t[i] if k == steps else begin + int(np.round(k * (t[i] - begin) / steps))
                count += 1
    if broken:
        s.now[SEGMENT], s.now[BLANK] = s.now[SEGMENT] + 1, rows[0] + s.limits_ns[SETTLE_START]
    s.now[DONE] = t[stop - 1]
    speeds = s.firsts[SPEEDS + 1] - s.firsts[SPEEDS]
    outputs = FIRST[OUTPUTS] + min(s.firsts[SPEEDS] - s.firsts[OUTPUTS], col.MOST)
    x = np.empty((FIRST[SPEEDS] + speeds if speeds else outputs, before + count))
    x[col.COVERED], x[outputs : FIRST[SPEEDS]] = 1.0, np.nan  # rates are put in by `rows.rates`
    if count:
        _fill(s, rows[:count], x, before)
        s.now[LAST] = rows[count - 1]
    for row in range(0 if resampled else count):
        while t[first] < rows[row]:
            first += 1
        if t[first] > rows[row] and x[col.VALID, before + row] > 0.0:
            x[col.VALID, before + row] = col.MADE_UP
    return rows[:count], x, stop < hi and t[stop] <= until_ns


@inline
def _turn(before: float, after: float) -> float:
    step = after - before
    return 0.0 if abs(step) <= math.pi else float(-np.round(step / TURN))


@jit
def _behind(s: Streams, place: int, at: int, row_ns: int) -> int:
    """The last sample up to a row, from one before it on; of an angle with the full turns that belong to it."""
    t, first, hi = s.times[place], s.firsts[place], s.marks[place, HI]
    while at + 1 < hi and t[at + 1] <= row_ns:
        if place in (SETPOINT, ATTITUDE):
            for column in range(3):
                s.turns[place, column] += _turn(s.values[first + column, at], s.values[first + column, at + 1])
        at += 1
    return at


@jit
def _settle(s: Streams, place: int, at: int) -> None:
    if at > s.marks[place, LO]:
        s.marks[place, LO], s.marks[place, FLOOR] = at, s.times[place, at]


@jit
def _fill(s: Streams, rows: IntArray, x: FloatArray, before: int) -> None:
    """Read all streams at the times of rows into x; what lies before is settled."""
    for place in range(len(s.marks)):
        read = _hold(s, place, rows, x, before) if place >= THRUST else _interpolate(s, place, rows, x, before)
        _settle(s, place, read)


@jit
def _hold(s: Streams, place: int, rows: IntArray, x: FloatArray, before: int) -> int:
    """The last value at each row, nan where it is older than the limit; returns the last sample that was read."""
    t, at, hi, limit_ns = s.times[place], s.marks[place, LO], s.marks[place, HI], s.limits_ns[place]
    i, first, of, columns = 0, FIRST[place], s.firsts[place], s.firsts[place + 1] - s.firsts[place]
    columns = min(columns, col.MOST) if place == OUTPUTS else columns
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
        for column in range(columns):
            value = s.values[of + column, at] if known else np.nan
            x[first + column, before + i : before + stop] = value
        i = stop
    return int(at)


@jit
def _interpolate(s: Streams, place: int, rows: IntArray, x: FloatArray, before: int) -> int:
    """The value between the samples around each row (too far apart: the last, or nan); returns the last one read.

    Rows are taken together as far as they lie between the same two samples, or each at the time of the next sample.
    """
    t, at, hi, limit_ns = s.times[place], s.marks[place, LO], s.marks[place, HI], s.limits_ns[place]
    angle, turns, i, count = place in (SETPOINT, ATTITUDE), s.turns[place], 0, len(rows)
    while i < count:
        if at + 1 < hi and t[at + 1] <= rows[i]:
            at = _behind(s, place, at, rows[i])
        since, gap, until = rows[i] - t[at] if at < hi else -1, NEVER_NS, NEVER_NS
        stop, matches = i + 1, since == 0
        if matches:
            gap = 0
            while stop < count and at + stop - i < hi and t[at + stop - i] == rows[stop]:
                stop += 1
        elif since < 0:
            until = t[at] if at < hi else NEVER_NS
        elif at + 1 < hi:
            gap, until = t[at + 1] - t[at], t[at + 1]
        while not matches and stop < count and rows[stop] < until:
            stop += 1
        for column in range(s.firsts[place + 1] - s.firsts[place]):
            v, row = s.values[s.firsts[place] + column], FIRST[place] + column if column < 3 else col.DOUBT
            to = x[row, before + i : before + stop]
            if since < 0 or gap > (limit_ns if place > SETPOINT else max(limit_ns, s.limits_ns[BREAK])):
                to[:] = np.nan
            elif not angle and matches:
                new = v[at:]
                for k in range(len(to)):
                    to[k] = new[k]
            elif matches:
                to[0] = v[at] + TURN * turns[column]
                for k in range(1, stop - i):
                    turns[column] += _turn(v[at + k - 1], v[at + k])
                    to[k] = v[at + k] + TURN * turns[column]
            else:
                value = v[at] + (TURN * turns[column] if angle else 0.0)
                after = v[at + 1] if gap <= limit_ns else value
                if gap <= limit_ns and angle:
                    after += TURN * (turns[column] + _turn(v[at], after))
                for k in range(i, stop):
                    to[k - i] = value + ((rows[k] - t[at]) / gap * (after - value) if gap <= limit_ns else 0.0)
        if place <= SETPOINT:
            _mark_usable(s, place, rows[i:stop], gap, x, before + i)
        at, i = at + (stop - i - 1 if matches else 0), stop
    return int(at)


@jit
def _mark_usable(s: Streams, place: int, rows: IntArray, gap: int, x: FloatArray, begin: int) -> None:
    """Mark rows outside of gaps and of what must settle after them; what follows a doubt is as after a gap."""
    blank_ns, doubt = s.now[BLANK + place], x[col.DOUBT, begin:]
    to = x[col.VALID if place == GYRO else col.SETPOINT, begin:]
    for i in range(len(rows)):
        doubted = place == GYRO and doubt[i] > 0.0
        long_ns = max(gap, s.limits_ns[USABLE] + 1) if doubted else gap
        if long_ns > s.limits_ns[USABLE]:
            settle = s.limits_ns[SETTLE_START] if long_ns > s.limits_ns[BREAK] else s.limits_ns[SETTLE_GAP]
            blank_ns = max(blank_ns, rows[i] + settle)
        to[i] = 1.0 if rows[i] > blank_ns else 0.0
        if place == GYRO and doubt[i] < 0.0:
            to[i], doubt[i] = col.MADE_UP * to[i], 0.0
        if doubted:
            doubt[i] = math.ceil(doubt[i])
    s.now[BLANK + place] = blank_ns
