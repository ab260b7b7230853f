"""The one pass over rows of flight: every monitor, what the envelope lets count, and what the decision looks at.

    rows ─▶ columns x ─▶ bins of conditions ─▶ each slot: its monitor's loop ─▶ value, as the envelope lets it count
         ─▶ a record for each slot and look (80 ms), alarms, and how long each slot judged

A value belongs to the first look at which it is known: its time stamp and the monitor's delay have passed, and its row
has come. So no look depends on how the rows were cut. All of a segment's memory is in a few arrays.

An alarm opens at the first valid value strictly above the threshold, so its start is the time of detection. It closes
when the value has come back and stayed there for `Monitor.clear_s`; what happens within that time belongs to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import mavdiag.rows.block as col
from mavdiag.jit import cached, inline, jit
from mavdiag.monitors import MONITORS
from mavdiag.monitors.base import FaultKind, Monitor, RotorEvidence
from mavdiag.monitors.conditions import COMMANDS, COUNT, MOST, conditions_memory, most_bins, take_rows
from mavdiag.rows.conditions import BIN_S, TRIM_CONDITIONS, TRIM_MEMORY_S, Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.quality import DOUBTS
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray, IntArray, Signal
from mavdiag.thresholds.envelope import ORDER, Covered, excess_of, farthest, limits_of, seen_from
from mavdiag.units import NS_PER_MS, NS_PER_S

LOOK_NS = 80 * NS_PER_MS  # between two looks; 40 would take twice as much of the processor, live (our choice)
STALE_LOOKS = 12  # a slot whose last valid value is older does not count (our choice)
CALM_BELOW = 0.7  # of the threshold (our choice)
LATE_NS = NS_PER_S  # so much a value may come after the rows of its time: half a filter's window (our choice)
WAITING = "waiting for enough unbroken flight"  # why a monitor does not judge although its signals are known
NAN, NEVER = float("nan"), -1e18
MORE_BINS = 32  # that there is room for before old ones are dropped
RANK = 1e9  # more than any ratio: of two at the same height the one that decides leads


class Height(IntEnum):
    """How high the highest ratio is. SETTLED: calm for 2 s. UNKNOWN: nothing judged."""

    UNKNOWN = -1
    SETTLED = 0
    CALM = 1
    HELD = 2
    RAISED = 3
    OVER = 4


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """A monitor and its threshold; its ratio is its value over its threshold."""

    monitor: Monitor[Any]
    threshold: float
    decides: bool  # its alarm is a fault by itself; else it is a suspicion
    evidence: RotorEvidence | None = None  # how it tells of rotors; None if it does not
    suspected: float = 1.0  # the ratio from which a fault is suspected (`thresholds.rule`)

    @property
    def key(self) -> tuple[str, Axis | None]:
        """Name and axis of the monitor."""
        return self.monitor.name, self.monitor.axis

    @property
    def of_propellers(self) -> bool:
        """It decides about propellers; "healthy" rests on such slots alone."""
        return self.decides and self.monitor.kind is FaultKind.PROPELLER


# Columns of the plan, a row for each slot: which loop, where its parameters and its memory lie, of which rotors' array
# it writes, whether its times are those of rates, and its delay, memory, reach and clear time [ns], the bits of the
# checks and of the conditions that it depends on, whether it grows with these, decides, and decides about propellers.
KIND, PAR, PAR_END, MEM, MEM_END, ROTORS, BY_RATES, DELAY, MEMORY_NS, REACH, CLEAR, NEEDS, DEPENDS = range(13)
GROWS, DECIDES, OWN, PLAN = 13, 14, 15, 16
# Columns of a look's record: highest ratio, nan without a value and -1 if none is valid; the last valid value; number
# of valid ones and sum of their squared levels; level and rotor evidence of the last one; sums of the evidence.
HIGHEST, LAST, JUDGED, SQUARES, LAST_LEVEL, EVIDENCE = range(6)
# Columns of a reading, a slot's latest look with a valid value: its highest ratio, last value, number, and evidence.
RATIO, READ, AT, READ_ROTORS = range(4)
# Columns of an open alarm: whether one is open and its last value was above, its highest value and level; of its times
# [ns]: first and last value above.
OPEN, TOUCHING, TOP, TOP_LEVEL = range(4)
START, ABOVE = range(2)
# What is counted of a slot: valid values, the highest; of a condition: values outside, the farthest and its excess.
VALUES, PEAK = range(2)
BEYOND, FARTHEST, EXCESS = range(3)
# Numbers of a pass. In: columns of before, and without rates; number of the first look; times from which rows count as
# flown, and before which no value reaches back; bits and memory of the conditions of trims; age from which on a bin is
# known. In and out: bins, open rows. Out: alarms told, open rows that are out of reach, rows flown and covered.
BEFORE, LAG, FIRST_LOOK, SETTLED, LATE, TRIMS, TRIMS_NS, BINS_NS, BINS, OPEN_ROWS, TOLD, GONE, FLOWN = range(13)
COVERED_ROWS, NUMBERS = 13, 14


def joined_loops(runs: Sequence[Callable[..., int]]) -> Callable[..., int]:
    """One function that calls the loop of the monitor with a number; merged into its caller, it compiles sooner."""

    @inline
    def none(kind: int, par: Any, mem: Any, x: Any, first: int, known: int, out: Any, rotors: Any, at: Any) -> int:
        return 0

    found: Callable[..., int] = none
    for number, run in enumerate(runs):
        found = _or_else(number, run, found)
    return found


def _or_else(this: int, run: Callable[..., int], others: Callable[..., int]) -> Callable[..., int]:
    @inline
    def either(kind: int, par: Any, mem: Any, x: Any, first: int, known: int, out: Any, rotors: Any, at: Any) -> int:
        if kind == this:
            return run(par, mem, x, first, known, out, rotors, at)
        return others(kind, par, mem, x, first, known, out, rotors, at)

    return either


loop = joined_loops([monitor.run for monitor in MONITORS])


@jit
def _take_bins(x: Any, times: Any, bins: Any, limits: FloatArray, mem: FloatArray, numbers: IntArray) -> int:
    """Measure the conditions, and flag what trims were learnt in; return the bits of those beyond what was learnt."""
    t_ns, (ends_ns, values, commands), known, first = times[0], bins, numbers[BINS], numbers[BEFORE]
    anywhere, begin, stop, covered = 0, -1, -1, True
    numbers[BINS] = take_rows(mem, x, first, first + numbers[LAG], times, (ends_ns, values), commands, known)
    for condition in range(COMMANDS.start, COMMANDS.stop):
        if excess_of(mem[MOST + condition - COMMANDS.start], limits, condition) > 0.0:
            anywhere |= 1 << condition
    for number in range(numbers[BINS]):
        for condition in range(COUNT):
            if number >= known:
                values[number, COUNT + condition] = excess_of(values[number, condition], limits, condition)
            if values[number, COUNT + condition] > 0.0:
                anywhere |= 1 << condition
    if anywhere & numbers[TRIMS]:
        for i in range(len(t_ns)):
            left = seen_from(ends_ns, max(begin, 0), numbers[BINS], t_ns[i], numbers[TRIMS_NS])
            right = seen_from(ends_ns, max(stop, 0), numbers[BINS], t_ns[i], numbers[BINS_NS])
            if left != begin or right != stop:
                begin, stop = left, right
                at = farthest(values, begin, stop, numbers[TRIMS])
                covered = at[0] < 0 or values[at[0], COUNT + at[1]] <= 1.0
            x[col.COVERED, first + i] = covered
    return anywhere


@jit
def _check_rows(x: Any, t_ns: IntArray, failed: IntArray, checks: IntArray, counts: Any, opened: Any, n: Any) -> None:
    """Count the rows that fail a check, and open those in the air for the values that are to judge them.

    checks: (n, 2) rows of x that must be finite; or -1 and a flag. A failed one is a bit. failed: room for these.
    """
    (missing, doubts), (open_ns, bits), first = counts, opened, n[BEFORE]
    failed[:] = 0
    for number in range(len(checks)):
        row, stop, bit = checks[number, 0], min(checks[number, 1], len(x)), 1 << number
        for k in range(max(row, 0), stop if row >= 0 else 0):
            known = x[k, first:]
            for i in range(len(t_ns)):
                failed[i] |= 0 if abs(known[i]) < np.inf else bit
        if row < 0:
            known = x[checks[number, 1], first:]
            for i in range(len(t_ns)):
                failed[i] |= 0 if known[i] > 0.5 else bit
        elif row >= stop:
            failed |= bit
    anything = 0
    for i in range(len(t_ns)):
        anything |= failed[i]
    for number in range(len(checks)):
        for i in range(len(t_ns) if anything >> number & 1 else 0):
            missing[number] += 1 if x[col.VALID, first + i] > 0.5 and failed[i] >> number & 1 else 0
    plain, opens = 0, n[OPEN_ROWS]
    for i in range(len(t_ns)):
        if x[col.DOUBT, first + i] == 0.0:
            plain += 1
        else:
            doubts[int(x[col.DOUBT, first + i])] += 1
        if t_ns[i] >= n[SETTLED]:
            open_ns[opens], bits[opens] = t_ns[i], failed[i]
            opens += 1
    doubts[0] += plain
    n[FLOWN] += opens - n[OPEN_ROWS]
    n[OPEN_ROWS] = opens


@jit
def _alarm(
    alarm: Any, spans: Any, told: Any, k: int, slot: int, look: int, t_ns: int, above: bool, value: float, level: float
) -> int:
    """The alarm of a slot after its next value; what opens or closes is told from k on."""
    (figures, times), (tops, whose) = alarm, told
    back = figures[slot, OPEN] > 0.5 and not (above and figures[slot, TOUCHING] > 0.5)
    if back and t_ns - times[slot, ABOVE] >= spans[slot, CLEAR]:
        whose[k, 0], whose[k, 1], whose[k, 2], whose[k, 3] = look, slot, times[slot, START], times[slot, ABOVE]
        tops[k, 0], tops[k, 1] = figures[slot, TOP], figures[slot, TOP_LEVEL]
        figures[slot, OPEN], k = 0.0, k + 1
    figures[slot, TOUCHING] = 1.0 if above else 0.0
    if above:
        if figures[slot, OPEN] < 0.5:
            whose[k, 0], whose[k, 1], whose[k, 2], whose[k, 3] = look, slot, t_ns, -1
            tops[k, 0], tops[k, 1] = value, level
            figures[slot, OPEN], figures[slot, TOP], figures[slot, TOP_LEVEL], k = 1.0, value, level, k + 1
            times[slot, START] = t_ns
        figures[slot, TOP] = max(figures[slot, TOP], value)
        figures[slot, TOP_LEVEL], times[slot, ABOVE] = max(figures[slot, TOP_LEVEL], level), t_ns
    return k


@jit
def _let_count(plan: Any, slot: int, written: Any, bins: Any, anywhere: int, limits: Any, outside: Any, n: Any) -> None:
    """Let a slot's values count as the envelope has it: less where a condition is near its limits, not beyond them."""
    (out, _, at, stamps), (ends_ns, conditions, commands) = written, bins
    depends, known = plan[slot, DEPENDS] & anywhere, n[BINS]
    late_ns = 0 if plan[slot, BY_RATES] else n[BINS_NS]  # a bin ends with a rate, and what is commanded is told sooner
    told = COMMANDS.stop if plan[slot, BY_RATES] else COMMANDS.start
    first, stop, worst, excess, measured = -1, -1, (-1, 0), 0.0, 0.0
    for number in range(len(stamps) if depends else 0):
        left = seen_from(ends_ns, max(first, 0), known, stamps[number], plan[slot, MEMORY_NS])
        right = seen_from(ends_ns, max(stop, 0), known, stamps[number], late_ns)
        if left != first or right != stop:
            begin = left if first < 0 or 0 <= worst[0] < left else max(stop, left)  # the worst so far left, or it stays
            newer = farthest(conditions, begin, right, depends)
            if begin == left or worst[0] < 0 or (newer[0] >= 0 and conditions[newer[0], COUNT + newer[1]] > excess):
                worst = newer
            first, stop, excess, measured = left, right, 0.0, 0.0
            if worst[0] >= 0:
                measured, excess = conditions[worst[0], worst[1]], conditions[worst[0], COUNT + worst[1]]
        far, which, value = excess, worst[1], measured
        for condition in range(COMMANDS.start, told):
            now = commands[condition - COMMANDS.start, at[number]]
            beyond = excess_of(now, limits, condition)
            if depends >> condition & 1 and beyond > far:
                far, which, value = beyond, condition, now
        out[col.VALUE, number] /= 1.0 + limits[which, 3] * min(far, 1.0) if plan[slot, GROWS] and far > 0.0 else 1.0
        if far > (1.0 if plan[slot, GROWS] else 0.0):
            out[col.SOUND, number] = 0.0
            outside[slot, which, BEYOND] += 1.0
            if far > outside[slot, which, EXCESS]:
                outside[slot, which, EXCESS], outside[slot, which, FARTHEST] = far, value


@jit
def _take_values(
    slot: int, fixed: Any, t_ns: IntArray, values: Any, looks: FloatArray, alarm: Any, told: Any, judged: Any, n: Any
) -> int:
    """Note a slot's new values in their looks, and what they do to its alarm; return the alarms told."""
    (plan, thresholds), (out, rotors, at, stamps), k = fixed, values, n[TOLD]
    shift, delay, threshold = n[LAG] if plan[slot, BY_RATES] else 0, plan[slot, DELAY], thresholds[slot]
    look, until, own, width, many, peak = 0, n[FIRST_LOOK] * LOOK_NS, 0, rotors.shape[1], 0.0, judged[slot, PEAK]
    record = looks[0, slot]
    highest, last, last_level, count, squares = record[0], record[1], record[4], record[2], record[3]
    for number in range(len(stamps)):
        t, value, level, above = stamps[number], out[col.VALUE, number], out[col.LEVEL, number], False
        while t_ns[at[number] + shift] > until:  # the first look from the row's own on
            look, until = look + 1, until + LOOK_NS
        if (look + 1 if t + delay > until else look) != own:
            record[0], record[1], record[4], record[2], record[3] = highest, last, last_level, count, squares
            own = look + 1 if t + delay > until else look
            record = looks[own, slot]
            highest, last, last_level, count, squares = record[0], record[1], record[4], record[2], record[3]
        if out[col.SOUND, number] > 0.5:
            ratio, above = value / threshold, value > threshold
            highest = highest if highest >= ratio else ratio
            last, last_level, count, squares = value, level, count + 1.0, squares + level * level
            for rotor in range(width):
                record[EVIDENCE + rotor] = rotors[number, rotor]
                record[EVIDENCE + width + rotor] += rotors[number, rotor]
            many, peak = many + 1.0, max(peak, value)
        elif np.isnan(highest):
            highest = -1.0
        if above or alarm[0][slot, OPEN] > 0.5:
            k = _alarm(alarm, plan, told, k, slot, own, t, above, value, level)
    record[0], record[1], record[4], record[2], record[3] = highest, last, last_level, count, squares
    judged[slot, VALUES] += many
    judged[slot, PEAK] = peak
    return int(k)


@jit
def _cover(plan: IntArray, slot: int, out: FloatArray, stamps: IntArray, opened: Any, rows: int) -> None:
    """Mark the open rows (bit 62) that a valid value of this slot judged: the first one after a row, in its reach."""
    (open_ns, bits), row = opened, 0
    for k in range(len(stamps)):
        if out[col.SOUND, k] < 0.5:
            continue
        while row < rows and open_ns[row] <= stamps[k]:
            if stamps[k] - open_ns[row] < plan[slot, REACH] and not bits[row] & plan[slot, NEEDS]:
                bits[row] |= 1 << 62
            row += 1


@jit
def _close_rows(opened: Any, numbers: IntArray) -> None:
    """Drop the rows that were judged, and count those that no value reaches any more."""
    (open_ns, bits), kept = opened, 0
    for row in range(numbers[OPEN_ROWS]):
        if bits[row] >> 62:
            numbers[COVERED_ROWS] += 1
            continue
        open_ns[kept], bits[kept] = open_ns[row], bits[row]
        kept += 1
        numbers[GONE] += open_ns[row] < numbers[LATE]
    numbers[OPEN_ROWS] = kept


@jit
def _read_looks(fixed: Any, looks: FloatArray, latest: FloatArray, read: Any, first: int) -> None:
    """The latest readings at each whole look; the height of the highest that is fresh, and whose it is, -1 for none."""
    (plan, suspected), (readings, heights, leads) = fixed, read
    for look in range(len(heights)):
        height, deciding, lead, top = -1, False, -1, -1.0
        for slot in range(len(plan)):
            if looks[look, slot, HIGHEST] >= 0.0 and looks[look, slot, JUDGED] > 0.0:
                latest[slot, RATIO], latest[slot, READ] = looks[look, slot, HIGHEST], looks[look, slot, LAST]
                latest[slot, AT] = first + look
                for rotor in range(latest.shape[1] - READ_ROTORS):
                    latest[slot, READ_ROTORS + rotor] = looks[look, slot, EVIDENCE + rotor]
            for column in range(latest.shape[1]):
                readings[look, slot, column] = latest[slot, column]
            if first + look - latest[slot, AT] > STALE_LOOKS:
                continue
            ratio, over = latest[slot, RATIO], latest[slot, RATIO] > 1.0
            own, rank = 3 if over or ratio >= suspected[slot] else 1, ratio
            if plan[slot, DECIDES]:
                deciding, rank = True, ratio + RANK
                own = 4 if over else max(own, 2 if ratio >= CALM_BELOW else 1)
            if own > height or (own == height and rank > top):
                height, top, lead = own, rank, slot
        heights[look], leads[look] = height if deciding else -1, lead


def compiled() -> Callable[..., None]:
    """The pass over rows, with the loops that `loop` joins now."""

    @cached
    def run(
        fixed: Any, state: Any, x: Any, times: Any, bins: Any, values: Any, looked: Any, rows: Any, numbers: Any
    ) -> None:
        """Take the next rows. What is remembered is changed in place, and so are the numbers of the pass."""
        (plan, thresholds, checks, limits, par), (t_ns, rates_ns) = fixed, times
        mem, latest, alarms, alarms_ns, tally, outside, missing, doubts = state
        (out, rotors, none, at, counts), (looks, readings, heights, leads, told, told_ns) = values, looked
        first, all_stamps, opened = numbers[BEFORE], np.empty(len(t_ns), dtype=np.int64), (rows[0], rows[1])
        anywhere = _take_bins(x, times, bins, limits, mem, numbers) if limits[0, 3] >= 0.0 else 0
        _check_rows(x, t_ns, all_stamps, checks, (missing, doubts), opened, numbers)
        for slot in range(len(plan)):
            evidence = rotors[plan[slot, ROTORS]] if plan[slot, ROTORS] >= 0 else none
            own_par = par[plan[slot, PAR] : plan[slot, PAR_END]]
            own_mem = mem[plan[slot, MEM] : plan[slot, MEM_END]]
            kind, known = plan[slot, KIND], first + numbers[LAG]
            count = loop(kind, own_par, own_mem, x, first, known, out[slot], evidence, at[slot])
            counts[slot], stamps, own_ns = count, all_stamps[:count], rates_ns if plan[slot, BY_RATES] else t_ns
            for k in range(count):
                stamps[k] = own_ns[at[slot, k]]
            written, alarm, telling = (out[slot], evidence, at[slot], stamps), (alarms, alarms_ns), (told, told_ns)
            _let_count(plan, slot, written, bins, anywhere, limits, outside, numbers)
            numbers[TOLD] = _take_values(
                slot, (plan, thresholds[0]), t_ns, written, looks, alarm, telling, tally, numbers
            )
            if plan[slot, OWN]:
                _cover(plan, slot, out[slot], stamps, opened, numbers[OPEN_ROWS])
        _close_rows(opened, numbers)
        _read_looks((plan, thresholds[1]), looks, latest, (readings, heights, leads), numbers[FIRST_LOOK])

    return run


judge = compiled()


class Alarm(NamedTuple):
    """What opened (end_ns -1) or closed: of which slot, between which times, and the highest value and level so far."""

    look: int
    slot: int
    start_ns: int
    end_ns: int
    statistic: float
    level: float


class Piece(NamedTuple):
    """What was made of some rows: the values of each slot, as the envelope lets them count."""

    rows: Rows
    slots: tuple[Slot, ...]
    plan: IntArray
    out: FloatArray | Sequence[FloatArray]
    rotors: FloatArray | Sequence[FloatArray]
    at: IntArray | Sequence[IntArray]
    counts: IntArray

    @property
    def found(self) -> tuple[Statistic, ...]:
        """The statistic of each slot."""
        return tuple(map(self.statistic, range(len(self.slots))))

    def statistic(self, number: int) -> Statistic:
        """The statistic of a slot."""
        count, own = int(self.counts[number]), int(self.plan[number, ROTORS])
        rotors = self.rotors[own][:count] if own >= 0 else np.empty((count, 0))
        return self.slots[number].monitor.statistic(
            self.rows, self.out[number][:, :count], rotors, self.at[number][:count]
        )

    def shrunk(self) -> "Piece":
        """The same without the room for values that a slot did not give."""
        counts, tellers = self.counts.tolist(), self.counts[self.plan[:, ROTORS] >= 0].tolist()
        return self._replace(
            out=[out[:, :count].copy() for out, count in zip(self.out, counts, strict=True)],
            rotors=[rotors[:count].copy() for rotors, count in zip(self.rotors, tellers, strict=True)],
            at=[at[:count].copy() for at, count in zip(self.at, counts, strict=True)],
        )

    def latest(self, number: int) -> list[float] | None:
        """What the monitor of a slot wrote last (`rows.block.VALUE` ...), None if nothing."""
        count = int(self.counts[number])
        return self.out[number][:, count - 1].tolist() if count else None


class Looked(NamedTuple):
    """Looks that are whole."""

    first: int = 0  # number of the first one; the number times `LOOK_NS` is its vehicle time
    readings: FloatArray = np.empty((0, 0, READ_ROTORS))  # (looks, slots, `RATIO`..)
    sums: FloatArray = np.empty((0, 0, EVIDENCE))  # (looks, slots, `HIGHEST`..)
    heights: Sequence[int | None] = ()  # of the highest fresh ratio; None where it is to be found anew
    leads: Sequence[int] = ()  # whose it is, -1 for none
    alarms: tuple[Alarm, ...] = ()  # what opened or closed, in order of looks
    end_ns: int | None = None  # vehicle time of the last look, where it is not at a whole number of `LOOK_NS`


@dataclass(frozen=True, slots=True)
class Outside:
    """Time that a slot did not judge for a condition [s], and the condition's farthest value."""

    span_s: float
    value: float


@dataclass(frozen=True, slots=True)
class Account:
    """How long a slot judged, and why it did not."""

    flight_s: float = 0.0  # flight time so far
    judged_s: float = 0.0  # time that its valid values stand for
    peak: float | None = None  # highest valid statistic
    # Flight time with a valid gyro in which what it takes of a signal was unknown, and flight time in which the gyro is
    # there but must not be judged (`rows.quality.Doubt`), by the reason as a person reads it [s].
    missing: dict[str, float] = field(default_factory=dict)
    outside: dict[Condition, Outside] = field(default_factory=dict)  # the envelope did not let it judge

    @property
    def outside_s(self) -> float:
        """Time outside of the envelope [s]."""
        return sum((one.span_s for one in self.outside.values()), 0.0)

    @property
    def not_judged(self) -> dict[str, float]:
        """Reasons with their seconds: a signal that is unknown, or waiting for unbroken flight."""
        found, idle_s = dict[str, float](), max(0.0, self.flight_s - self.judged_s - self.outside_s)
        for reason, span_s in self.missing.items():
            found[reason] = min(span_s, max(0.0, idle_s))
            idle_s -= span_s
        return {**found, WAITING: idle_s} if idle_s > 0 else found


Stretch = tuple[int, int]
"""First and last row of a part of a flight [ns]."""


@dataclass(slots=True, eq=False)
class Memory:
    """All that the pass remembers; it is changed in place."""

    mem: FloatArray  # of the present segment: the loops' memory, latest columns and readings, open alarms
    past: FloatArray
    latest: FloatArray
    alarms: FloatArray
    alarms_ns: IntArray
    tally: FloatArray  # what was counted since the start: of slots, conditions, checks and doubts
    outside: FloatArray
    missing: IntArray
    doubts: IntArray
    bins_ns: IntArray  # of conditions that may still count
    bins: FloatArray
    looks: FloatArray  # records of the next two looks
    opened: IntArray  # (2, k) rows that later values may still reach back to: times, and the checks that they fail
    known: int = 0  # how many bins there are
    next_look: int | None = None  # number of the first look that is not whole; None before the first row
    told: tuple[Alarm, ...] = ()  # of looks to come
    rows: int = 0
    flown: int = 0  # rows in the air, without take-offs
    judged: int = 0  # those in the window of a valid value of a slot that decides about propellers and knew its signals
    unjudged: tuple[Stretch, ...] = ()  # the stretches that nothing can reach any more, in order of time


class Kernel:
    """Slots and what their baseline covered, ready for rows of one period.

    dt_s: row period [s]. delay_s: half the window of the rate filters [s].
    """

    def __init__(self, slots: tuple[Slot, ...], covered: tuple[Covered, ...], dt_s: float, delay_s: float) -> None:
        self.slots, self.dt_s = slots, dt_s
        self.periods_s = [slot.monitor.period_s(dt_s) for slot in slots]
        self._needs = [sorted(slot.monitor.signals) for slot in slots]
        checks = dict.fromkeys(_check(slot, signal) for slot in slots for signal in sorted(slot.monitor.signals))
        self._bit = {check: number for number, check in enumerate(checks)}
        begun = [slot.monitor.begin(dt_s) for slot in slots]
        own, memories = [one.par for one in begun], [conditions_memory(), *(one.mem for one in begun)]
        self.back, self._start = max((one.back for one in begun), default=0), np.concatenate(memories)
        self._rotors = max((slot.monitor.rotors for slot in slots), default=0)
        plan = self._plan(np.cumsum([0, *map(len, own)]), np.cumsum(list(map(len, memories))))
        limits = limits_of(covered)
        limits[:, 3] = limits[:, 3] if covered else -1.0
        thresholds = np.array([[slot.threshold for slot in slots], [slot.suspected for slot in slots]])
        checked = np.array(list(checks), dtype=np.int64).reshape(-1, 2)
        self._fixed = (plan, thresholds, checked, limits, np.concatenate([np.empty(0), *own]))
        self._tellers = int(plan[:, ROTORS].max(initial=-1)) + 1
        bins_ns = round((delay_s + BIN_S) * NS_PER_S)  # from so long on a bin is known
        self._bins = (_bits(TRIM_CONDITIONS), round(TRIM_MEMORY_S * NS_PER_S), bins_ns)
        self._late_ns = int(plan[plan[:, OWN] > 0, REACH].max(initial=0)) + LATE_NS
        self._longest_ns = int(plan[:, MEMORY_NS].max(initial=0)) + bins_ns + round(BIN_S * NS_PER_S)

    def _plan(self, pars: IntArray, mems: IntArray) -> IntArray:
        plan, tellers = np.zeros((len(self.slots), PLAN), dtype=np.int64), 0
        for number, (row, slot) in enumerate(zip(plan, self.slots, strict=True)):
            monitor = slot.monitor
            row[KIND] = next(i for i, kind in enumerate(MONITORS) if isinstance(monitor, kind))
            row[[PAR, PAR_END, MEM, MEM_END]] = *pars[number : number + 2], *mems[number : number + 2]
            row[ROTORS], tellers = (tellers, tellers + 1) if monitor.rotors else (-1, tellers)
            row[BY_RATES], row[DECIDES], row[OWN] = monitor.by_rates, slot.decides, slot.of_propellers
            spans_s = monitor.delay_s, monitor.memory_s, max(monitor.memory_s, self.periods_s[number]), monitor.clear_s
            row[[DELAY, MEMORY_NS, REACH, CLEAR]] = [round(span_s * NS_PER_S) for span_s in spans_s]
            row[NEEDS] = sum(1 << self._bit[_check(slot, signal)] for signal in self._needs[number])
            row[DEPENDS], row[GROWS] = _bits(monitor.depends), monitor.unit != "s"
        return plan

    def start(self) -> Memory:
        """Nothing seen yet."""
        slots, never = len(self.slots), np.empty(0, dtype=np.int64)
        latest = np.zeros((slots, READ_ROTORS + self._rotors))
        tally, outside, alarms = np.zeros((slots, 2)), np.zeros((slots, COUNT, 3)), np.zeros((slots, 4))
        latest[:, AT], tally[:, PEAK] = NEVER, -np.inf
        counts = np.zeros(len(self._bit), dtype=np.int64), np.zeros(len(DOUBTS), dtype=np.int64)
        segment = self._start.copy(), col.no_past(self.back), latest, alarms, np.zeros((slots, 2), dtype=np.int64)
        bins = never, np.empty((0, 2 * COUNT))
        return Memory(*segment, tally, outside, *counts, *bins, self._records(2), np.empty((2, 0), dtype=np.int64))

    def restart(self, memory: Memory) -> None:
        """At the border of a segment: only what was counted stays, and no value reaches back over it."""
        memory.unjudged = _stretches(memory.unjudged, memory.opened[0], self.dt_s)
        fresh = self.start()
        for name in ("mem", "past", "latest", "alarms", "alarms_ns", "bins_ns", "bins", "known", "looks", "opened"):
            setattr(memory, name, getattr(fresh, name))
        memory.next_look, memory.told = None, ()

    def step(self, memory: Memory, rows: Rows) -> tuple[Looked, Piece]:
        """Take the next rows of the segment; return the looks that they make whole, and all values."""
        block, columns, slots = rows.block, col.columns_of(rows, memory.past), len(self.slots)
        n, times = len(block), (block.t_ns, rows.rates_ns)
        first_ns, now_ns = times[0].item(0), times[0].item(-1)
        first = -(-first_ns // LOOK_NS) if memory.next_look is None else memory.next_look
        done = max(0, now_ns // LOOK_NS + 1 - first)
        known, more, opened = memory.known, most_bins(times[1]), memory.opened.shape[1]
        if known + more > len(memory.bins_ns):
            old = int(memory.bins_ns[:known].searchsorted(first_ns - self._longest_ns))
            ends_ns, conditions, known = memory.bins_ns[old:known], memory.bins[old:known], known - old
            memory.bins_ns, memory.bins = _grown(ends_ns, more + MORE_BINS), _grown(conditions, more + MORE_BINS)
        bins = memory.bins_ns, memory.bins, np.empty((3, len(times[1])))
        rows_open = np.empty((2, opened + n), dtype=np.int64)
        rows_open[:, :opened] = memory.opened
        looks = self._records(done + 2)
        looks[:2] = memory.looks
        readings, found = np.empty((done, *memory.latest.shape)), np.empty((2, done), dtype=np.int64)
        told = np.empty((2 * slots * n, 2)), np.empty((2 * slots * n, 4), dtype=np.int64)
        out, rotors = np.empty((slots, 4, n)), np.empty((self._tellers, n, self._rotors))
        at, counts = np.empty((slots, n), dtype=np.int64), np.empty(slots, dtype=np.int64)
        lag, settled_ns, late_ns = columns.known - columns.first, block.settled_ns, now_ns - self._late_ns
        given = [columns.first, lag, first, settled_ns, late_ns, *self._bins, known, opened]
        numbers = np.array(given + [0] * (NUMBERS - len(given)))
        state = (memory.mem, memory.latest, memory.alarms, memory.alarms_ns)
        counted = (memory.tally, memory.outside, memory.missing, memory.doubts)
        looked = (looks, readings, found[0], found[1], *told)
        values = (out, rotors, NO_ROTORS, at, counts)
        judge(self._fixed, (*state, *counted), columns.x, times, bins, values, looked, rows_open, numbers)
        memory.known, opened, tells, gone, flown, covered = numbers[BINS:].tolist()
        if tells:
            pairs = zip(told[1][:tells].tolist(), told[0][:tells].tolist(), strict=True)
            memory.told += tuple(Alarm(first + look, *whose, *high) for (look, *whose), high in pairs)
        memory.past, memory.next_look, alarms = columns.past, first + done, memory.told
        if alarms:
            memory.told = tuple(one for one in alarms if one.look >= first + done)
            alarms = tuple(sorted((one for one in alarms if one.look < first + done), key=lambda one: one.look))
        memory.unjudged = _stretches(memory.unjudged, rows_open[0, :gone], self.dt_s)
        memory.looks, memory.opened = looks[done:], rows_open[:, gone:opened]
        memory.rows, memory.flown, memory.judged = memory.rows + n, memory.flown + flown, memory.judged + covered
        piece = Piece(rows, self.slots, self._fixed[0], out, rotors, at, counts)
        heights, leads = found.tolist()
        return Looked(first, readings, looks, heights, leads, alarms), piece

    def close(self, memory: Memory, end_ns: int) -> Looked:
        """The last look, at the end of a segment or of the data: what no look has had until then."""
        if memory.next_look is None or end_ns <= (memory.next_look - 1) * LOOK_NS:
            return Looked()
        (sums, newer), latest, evidence = memory.looks.copy(), memory.latest.copy(), EVIDENCE + self._rotors
        sums[:, HIGHEST] = np.fmax(sums[:, HIGHEST], newer[:, HIGHEST])
        for column in (LAST, *range(LAST_LEVEL, evidence)):
            sums[:, column] = np.where(newer[:, JUDGED] > 0, newer[:, column], sums[:, column])
        for column in (JUDGED, SQUARES, *range(evidence, sums.shape[1])):
            sums[:, column] += newer[:, column]
        for reading, record in zip(latest, sums, strict=True):
            if record[HIGHEST] >= 0 and record[JUDGED]:
                reading[:] = (record[HIGHEST], record[LAST], end_ns / LOOK_NS, *record[EVIDENCE:evidence])
        return Looked(memory.next_look, latest[None], sums[None], (None,), (-1,), memory.told, end_ns)

    def open_alarms(self, memory: Memory, *, ended: bool = False) -> tuple[Alarm, ...]:
        """The alarms that last, with what is known of them. ended: each with its last value above as its end."""
        pairs = enumerate(zip(memory.alarms.tolist(), memory.alarms_ns.tolist(), strict=True))
        return tuple(
            Alarm(0, number, start_ns, above_ns if ended else -1, top, level)
            for number, ((lasts, _, top, level), (start_ns, above_ns)) in pairs
            if lasts
        )

    def ratios(self, memory: Memory) -> tuple[tuple[Slot, float], ...]:
        """Latest statistic over its threshold of each slot whose latest value is not stale."""
        oldest = (memory.next_look or 0) - 1 - STALE_LOOKS
        fresh = zip(self.slots, memory.latest[:, (RATIO, AT)].tolist(), strict=True)
        return tuple((slot, ratio) for slot, (ratio, at) in fresh if at >= oldest)

    def accounts(self, memory: Memory) -> tuple[Account, ...]:
        """How long each slot judged, and why it did not."""
        return tuple(self._account(memory, number) for number in range(len(self.slots)))

    def _account(self, memory: Memory, number: int) -> Account:
        slot, period_s, (values, peak) = self.slots[number], self.periods_s[number], memory.tally[number].tolist()
        lacking = {str(DOUBTS[i]): int(n) * self.dt_s for i, n in enumerate(memory.doubts) if i and n}
        for signal in self._needs[number]:
            if rows := int(memory.missing[self._bit[_check(slot, signal)]]):
                lacking[f"no {signal.replace('_', ' ')}"] = rows * self.dt_s
        outside = {
            condition: Outside(beyond * period_s, value)
            for condition, (beyond, value, _) in zip(ORDER, memory.outside[number].tolist(), strict=True)
            if beyond
        }
        return Account(memory.rows * self.dt_s, values * period_s, peak if values else None, lacking, outside)

    def _records(self, looks: int) -> FloatArray:
        records = np.zeros((looks, len(self.slots), EVIDENCE + 2 * self._rotors))
        records[:, :, HIGHEST] = NAN
        return records


NO_ROTORS = np.empty((0, 0))


def _check(slot: Slot, signal: Signal) -> tuple[int, int]:
    """How it is seen in a column that what a slot takes of a signal is known."""
    if signal in (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT):
        return -1, col.VALID if signal is Signal.BODY_RATE else col.SETPOINT
    first, stop = col.PLACES[signal]
    cut = slot.monitor.takes.get(signal, slice(None))
    return first + (cut.start or 0), stop if cut.stop is None else first + cut.stop


def _bits(conditions: frozenset[Condition]) -> int:
    return sum(1 << ORDER.index(condition) for condition in conditions)


def _grown(array: NDArray[Any], more: int) -> NDArray[Any]:
    grown = np.empty((len(array) + more, *array.shape[1:]), dtype=array.dtype)
    grown[: len(array)] = array
    return grown


def _stretches(before: tuple[Stretch, ...], rows_ns: IntArray, dt_s: float) -> tuple[Stretch, ...]:
    """With the stretches of further rows that were not judged."""
    if len(rows_ns) == 0:
        return before
    most_ns = 1.5 * dt_s * NS_PER_S  # between two rows that follow each other
    edges = np.flatnonzero(np.diff(rows_ns) > most_ns)
    firsts, lasts = rows_ns[np.append(0, edges + 1)], rows_ns[np.append(edges, len(rows_ns) - 1)]
    fresh: list[Stretch] = list(zip(firsts.tolist(), lasts.tolist(), strict=True))
    if before and fresh[0][0] - before[-1][1] <= most_ns:
        fresh[0] = (before[-1][0], fresh[0][1])
        before = before[:-1]
    return (*before, *fresh)


def warm() -> None:
    """Compile the pass, or load it from where it is kept."""
    kernel, t_ns = Kernel((), (), 0.01, 0.02), 10_000_000 * np.arange(20)
    kernel.step(kernel.start(), Rows(col.Block(0, 0.01, t_ns, np.zeros((col.OUTPUTS, len(t_ns)))), t_ns))
