"""The one pass over rows of flight: every monitor, what the envelope lets count, and what the decision looks at.

    rows ─▶ columns x ─▶ bins of conditions ─▶ each slot: its monitor's loop ─▶ value, as the envelope lets it count
         ─▶ a record for each slot and look (0.1 s), alarms, and how long each slot judged

A slot is a monitor with its threshold; its ratio is its value over its threshold. A value belongs to the first look at
which it is known: its time stamp and the monitor's delay have passed, and its row has come. So no look depends on how
the rows were cut. All of a segment's memory is in a few arrays, which are copied once a pass.

An alarm opens at the first valid value strictly above the threshold, so its start is the time of detection. It closes
when the value has come back and stayed there for `Monitor.clear_s`; what happens within that time belongs to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from mavdiag.jit import allocating, cached, jit
from mavdiag.monitors import MONITORS
from mavdiag.monitors.base import FaultKind, Monitor, RotorEvidence
from mavdiag.monitors.columns import (
    COVERED,
    DOUBT,
    LEVEL,
    PLACES,
    SETPOINT,
    SOUND,
    TRIM_CONDITIONS,
    TRIM_MEMORY_S,
    VALID,
    VALUE,
    columns_of,
)
from mavdiag.monitors.conditions import COUNT, conditions_memory, most_bins, take_rows
from mavdiag.rows.conditions import BIN_S, Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.quality import DOUBTS
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray, IntArray, Signal
from mavdiag.thresholds.envelope import ORDER, Covered, excess_of, farthest, limits_of, seen_from
from mavdiag.units import NS_PER_S

LOOK_NS = NS_PER_S // 10  # time between two looks (our choice)
STALE_LOOKS = 10  # a slot whose last valid value is older does not count (our choice)
CALM_BELOW, RAISED_FROM = 0.7, 0.8  # of the threshold (our choice); one emulated flight in 62 healthy h was suspected
LATE_NS = (
    NS_PER_S  # by so much a value may come after the rows of its time: half a filter's window at most (our choice)
)
WAITING = "waiting for enough unbroken flight"  # why a monitor does not judge although its signals are known
NAN, NEVER = float("nan"), -1e18
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
    """A monitor and its threshold.

    decides: its alarm is a fault by itself; else it is a suspicion.
    evidence: how it tells of rotors; None if it does not.
    """

    monitor: Monitor[Any]
    threshold: float
    decides: bool
    evidence: RotorEvidence | None = None

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
# Columns of an open alarm: whether one is open and its last value was above, its highest value and level; and of times.
OPEN, TOUCHING, TOP, TOP_LEVEL = range(4)
START, ABOVE = range(2)
# Columns of an alarm that is told: look, slot, start and end [ns], end -1 while it lasts.
AT_LOOK, OF_SLOT, FROM, TO = range(4)
# Columns of what is counted of a slot: values that were valid, the highest; of a condition: values outside, the
# farthest condition and its excess.
VALUES, PEAK = range(2)
BEYOND, FARTHEST, EXCESS = range(3)
# Numbers of a pass: what goes in, and what comes out.
FIRST_LOOK, LOOKS, BINS, OPEN_ROWS, SETTLED, LATE, TRIMS, TRIMS_NS, BINS_NS, TOLD, GONE, FLOWN, COVERED_ROWS = range(13)
NUMBERS = 13


def joined_loops(runs: Sequence[Callable[..., int]]) -> Callable[..., int]:
    """One compiled function that calls the loop of the monitor with a number."""

    @allocating
    def none(kind: int, par: Any, mem: Any, x: Any, flags: Any, lag: int, out: Any, rotors: Any, at: Any) -> int:
        return 0

    found: Callable[..., int] = none
    for number, run in enumerate(runs):
        found = _or_else(number, run, found)
    return found


def _or_else(this: int, run: Callable[..., int], others: Callable[..., int]) -> Callable[..., int]:
    @allocating
    def either(kind: int, par: Any, mem: Any, x: Any, flags: Any, lag: int, out: Any, rotors: Any, at: Any) -> int:
        if kind == this:
            return run(par, mem, x, flags, lag, out, rotors, at)
        return others(kind, par, mem, x, flags, lag, out, rotors, at)

    return either


loop = joined_loops([monitor.run for monitor in MONITORS])


@jit
def _tell(
    told: FloatArray, told_ns: IntArray, k: int, look: int, slot: int, start: int, end: int, top: float, level: float
) -> int:
    told_ns[k, AT_LOOK], told_ns[k, OF_SLOT], told_ns[k, FROM], told_ns[k, TO] = look, slot, start, end
    told[k, 0], told[k, 1] = top, level
    return k + 1


@jit
def _alarm(
    alarms: FloatArray,
    alarms_ns: IntArray,
    told: FloatArray,
    told_ns: IntArray,
    k: int,
    slot: int,
    look: int,
    t_ns: int,
    above: bool,
    value: float,
    level: float,
    clear_ns: int,
) -> int:
    """The alarm of a slot after its next value; what opens or closes is told from k on."""
    back = alarms[slot, OPEN] > 0.5 and not (above and alarms[slot, TOUCHING] > 0.5)
    if back and t_ns - alarms_ns[slot, ABOVE] >= clear_ns:
        start, end = alarms_ns[slot, START], alarms_ns[slot, ABOVE]
        k = _tell(told, told_ns, k, look, slot, start, end, alarms[slot, TOP], alarms[slot, TOP_LEVEL])
        alarms[slot, OPEN] = 0.0
    alarms[slot, TOUCHING] = 1.0 if above else 0.0
    if above:
        if alarms[slot, OPEN] < 0.5:
            k = _tell(told, told_ns, k, look, slot, t_ns, -1, value, level)
            alarms[slot, OPEN], alarms[slot, TOP], alarms[slot, TOP_LEVEL] = 1.0, value, level
            alarms_ns[slot, START] = t_ns
        alarms[slot, TOP], alarms[slot, TOP_LEVEL] = max(alarms[slot, TOP], value), max(alarms[slot, TOP_LEVEL], level)
        alarms_ns[slot, ABOVE] = t_ns
    return k


@jit
def _note(record: FloatArray, ratio: float, value: float, level: float, rotors: FloatArray, k: int) -> None:
    """A valid value, in the record of its look."""
    if not record[HIGHEST] >= ratio:
        record[HIGHEST] = ratio
    record[LAST], record[LAST_LEVEL] = value, level
    record[JUDGED], record[SQUARES] = record[JUDGED] + 1.0, record[SQUARES] + level * level
    count = rotors.shape[1]
    for rotor in range(count):
        record[EVIDENCE + rotor] = rotors[k, rotor]
        record[EVIDENCE + count + rotor] += rotors[k, rotor]


@jit
def _checked(x: FloatArray, flags: FloatArray, checks: IntArray, i: int) -> int:
    """A bit for each check that a column fails. checks: (n, 2) rows of x that must be finite; or -1 and a flag."""
    bits = 0
    for number in range(checks.shape[0]):
        first, stop = checks[number, 0], min(checks[number, 1], x.shape[0])
        known = first < stop
        if first < 0:
            known = flags[checks[number, 1], i] > 0.5
        else:
            for row in range(first, stop):
                known = known and np.isfinite(x[row, i])
        if not known:
            bits |= 1 << number
    return bits


@jit
def _cover(
    plan: IntArray, out: FloatArray, times: IntArray, count: int, slot: int, open_ns: IntArray, bits: IntArray, n: int
) -> None:
    """Mark the open rows (bit 62) that a valid value of this slot judged: the first one after a row, in its reach."""
    row = 0
    for k in range(count):
        if out[SOUND, k] < 0.5:
            continue
        while row < n and open_ns[row] <= times[k]:
            if times[k] - open_ns[row] < plan[slot, REACH] and not bits[row] & plan[slot, NEEDS]:
                bits[row] |= 1 << 62
            row += 1


@jit
def _read(
    plan: IntArray,
    looks: FloatArray,
    latest: FloatArray,
    readings: FloatArray,
    heights: IntArray,
    leads: IntArray,
    first: int,
) -> None:
    """The latest readings at each whole look; the height of the highest that is fresh, and whose it is, -1 for none."""
    for look in range(len(heights)):
        height, deciding, lead, top = -1, False, -1, -1.0
        for slot in range(len(plan)):
            if looks[look, slot, HIGHEST] >= 0.0 and looks[look, slot, JUDGED] > 0.0:
                latest[slot, RATIO], latest[slot, READ] = looks[look, slot, HIGHEST], looks[look, slot, LAST]
                latest[slot, AT] = first + look
                for rotor in range(latest.shape[1] - READ_ROTORS):
                    latest[slot, READ_ROTORS + rotor] = looks[look, slot, EVIDENCE + rotor]
            if first + look - latest[slot, AT] > STALE_LOOKS:
                continue
            ratio, over = latest[slot, RATIO], latest[slot, RATIO] > 1.0
            own, rank = 3 if over else 1, ratio
            if plan[slot, DECIDES]:
                deciding, rank = True, ratio + RANK
                own = 4 if over else 3 if ratio >= RAISED_FROM else 2 if ratio >= CALM_BELOW else 1
            if own > height or (own == height and rank > top):
                height, top, lead = own, rank, slot
        heights[look], leads[look] = height if deciding else -1, lead
        for slot in range(len(plan)):
            for column in range(latest.shape[1]):
                readings[look, slot, column] = latest[slot, column]


def compiled() -> Callable[..., None]:
    """The pass over rows, with the loops that `loop` joins now."""

    @cached
    def run(
        plan: IntArray,
        thresholds: FloatArray,
        checks: IntArray,
        limits: FloatArray,
        par: FloatArray,
        mem: FloatArray,
        numbers: IntArray,
        x: FloatArray,
        flags: FloatArray,
        lag: int,
        t_ns: IntArray,
        rates_ns: IntArray,
        bins_ns: IntArray,
        bins: FloatArray,
        out: FloatArray,
        rotors: FloatArray,
        none: FloatArray,
        at: IntArray,
        counts: IntArray,
        looks: FloatArray,
        latest: FloatArray,
        readings: FloatArray,
        heights: IntArray,
        leads: IntArray,
        alarms: FloatArray,
        alarms_ns: IntArray,
        told: FloatArray,
        told_ns: IntArray,
        tally: FloatArray,
        outside: FloatArray,
        missing: IntArray,
        doubts: IntArray,
        open_ns: IntArray,
        bits: IntArray,
    ) -> None:
        """Take the next rows; the state arrays are changed in place."""
        n, far_at, known = x.shape[1], np.zeros(2, dtype=np.int64), numbers[BINS]
        times = np.empty(n, dtype=np.int64)
        if limits[0, 3] >= 0.0:  # some condition is limited
            stop = take_rows(mem, 0, x, flags, lag, t_ns, rates_ns, bins_ns, bins, known)
            for number in range(known, stop):
                for condition in range(COUNT):
                    bins[number, COUNT + condition] = excess_of(bins[number, condition], limits, condition)
            numbers[BINS] = known = stop
        anywhere = 0  # bits of the conditions that were beyond what was learnt
        for number in range(known):
            for condition in range(COUNT):
                if bins[number, COUNT + condition] > 0.0:
                    anywhere |= 1 << condition
        first = stop = fresh = 0
        if anywhere & numbers[TRIMS]:
            for i in range(n):
                first = seen_from(bins_ns, first, known, t_ns[i], numbers[TRIMS_NS])
                stop = seen_from(bins_ns, stop, known, t_ns[i], numbers[BINS_NS])
                flags[COVERED, i] = farthest(bins, first, stop, numbers[TRIMS], far_at) <= 1.0

        rows = numbers[OPEN_ROWS]
        for i in range(n):
            failed = _checked(x, flags, checks, i)
            if failed and flags[VALID, i] > 0.5:
                for number in range(len(missing)):
                    missing[number] += failed >> number & 1
            doubts[int(flags[DOUBT, i])] += 1
            if t_ns[i] >= numbers[SETTLED]:
                open_ns[rows], bits[rows] = t_ns[i], failed
                rows, fresh = rows + 1, fresh + 1

        k = 0
        for slot in range(len(plan)):
            mine, evidence, where = out[slot], none, at[slot]
            if plan[slot, ROTORS] >= 0:
                evidence = rotors[plan[slot, ROTORS]]
            own_par = par[plan[slot, PAR] : plan[slot, PAR_END]]
            own_mem = mem[plan[slot, MEM] : plan[slot, MEM_END]]
            count = loop(plan[slot, KIND], own_par, own_mem, x, flags, lag, mine, evidence, where)
            counts[slot], first, stop, far, room, condition = count, 0, 0, 0.0, 1.0, 0
            depends, shift = plan[slot, DEPENDS] & anywhere, lag if plan[slot, BY_RATES] else 0
            arrived, until, delay = 0, numbers[FIRST_LOOK] * LOOK_NS, plan[slot, DELAY]
            for value_number in range(count):
                row = where[value_number] + shift
                t = rates_ns[where[value_number]] if plan[slot, BY_RATES] else t_ns[row]
                times[value_number] = t
                if depends:
                    left = seen_from(bins_ns, first, known, t, plan[slot, MEMORY_NS])
                    right = seen_from(bins_ns, stop, known, t, numbers[BINS_NS])
                    if left != first or right != stop or value_number == 0:
                        first, stop = left, right
                        far = farthest(bins, first, stop, depends, far_at)
                        condition = far_at[1]
                        room = 1.0 + limits[condition, 3] * min(far, 1.0) if plan[slot, GROWS] and far > 0.0 else 1.0
                    if far > 0.0:
                        mine[VALUE, value_number] /= room
                    if far > 1.0:
                        mine[SOUND, value_number] = 0.0
                        outside[slot, condition, BEYOND] += 1.0
                        if far > outside[slot, condition, EXCESS]:
                            outside[slot, condition, EXCESS] = far
                            outside[slot, condition, FARTHEST] = bins[far_at[0], condition]
                while t_ns[row] > until:  # the first look from the row's own on
                    arrived, until = arrived + 1, until + LOOK_NS
                look = arrived + 1 if t + delay > until else arrived
                record, value, level = looks[look, slot], mine[VALUE, value_number], mine[LEVEL, value_number]
                above = False
                if mine[SOUND, value_number] > 0.5:
                    _note(record, value / thresholds[slot], value, level, evidence, value_number)
                    tally[slot, VALUES] += 1.0
                    tally[slot, PEAK] = max(tally[slot, PEAK], value)
                    above = value > thresholds[slot]
                elif np.isnan(record[HIGHEST]):
                    record[HIGHEST] = -1.0
                if above or alarms[slot, OPEN] > 0.5:
                    clear_ns = plan[slot, CLEAR]
                    k = _alarm(alarms, alarms_ns, told, told_ns, k, slot, look, t, above, value, level, clear_ns)
            if plan[slot, OWN]:
                _cover(plan, mine, times, count, slot, open_ns, bits, rows)

        kept = gone = 0
        for row in range(rows):
            if bits[row] >> 62:
                numbers[COVERED_ROWS] += 1
                continue
            open_ns[kept], bits[kept] = open_ns[row], bits[row]
            kept += 1
            gone += open_ns[row] < numbers[LATE]
        numbers[OPEN_ROWS], numbers[GONE], numbers[TOLD] = kept, gone, k
        numbers[FLOWN] += fresh
        _read(plan, looks, latest, readings, heights, leads, numbers[FIRST_LOOK])

    return run


judge = compiled()


@dataclass(frozen=True, slots=True)
class Alarm:
    """What opened (end_ns -1) or closed: of which slot, between which times, and the highest value and level so far."""

    look: int
    slot: int
    start_ns: int
    end_ns: int
    statistic: float
    level: float


@dataclass(frozen=True, slots=True)
class Gauge:
    """The latest value of one slot, for a display; fields as in `Slot` and `Statistic`."""

    monitor: str
    axis: Axis | None
    unit: str
    statistic: float
    threshold: float
    signal: float
    reference: float
    valid: bool


@dataclass(frozen=True, eq=False)
class Piece:
    """What was made of some rows: the values of each slot, as the envelope lets them count."""

    rows: Rows
    slots: tuple[Slot, ...]
    plan: IntArray
    out: FloatArray
    rotors: FloatArray
    at: IntArray
    counts: IntArray

    @cached_property
    def found(self) -> tuple[Statistic, ...]:
        """The statistic of each slot."""
        return tuple(self._statistic(number) for number in range(len(self.slots)))

    @property
    def gauges(self) -> tuple[Gauge, ...]:
        """The latest value of every slot that has one."""
        found = []
        for slot, count, out in zip(self.slots, self.counts.tolist(), self.out, strict=True):
            if count:
                monitor, (value, sound, _, signal) = slot.monitor, out[:, count - 1].tolist()
                figures = (value, slot.threshold, signal, monitor.reference)
                found.append(Gauge(*slot.key, monitor.unit, *figures, valid=sound > 0.5))
        return tuple(found)

    def _statistic(self, number: int) -> Statistic:
        monitor, count, place = self.slots[number].monitor, self.counts[number], self.plan[number, ROTORS]
        times = self.rows.rates.t_ns if monitor.by_rates else self.rows.block.t_ns
        value, sound, level, signal = self.out[number, :, :count]
        rotors = self.rotors[place, :count] if place >= 0 else np.empty((count, 0))
        period_s = monitor.period_s(self.rows.block.dt_s)
        return Statistic(times[self.at[number, :count]], period_s, value, sound > 0.5, level, signal, rotors)


@dataclass(frozen=True, slots=True)
class Looked:
    """Looks that are whole. first: number of the first one; the number times `LOOK_NS` is its vehicle time.

    readings: (looks, slots, ..) as `RATIO` and its fellows say. sums: (looks, slots, ..) as `HIGHEST` and its fellows.
    heights, leads: how high the highest fresh ratio of each look is, and whose, -1 for none; a height is None where it
        is to be found anew. alarms: what opened or closed, in order of looks.
    end_ns: vehicle time of the last look, where it is none of every 0.1 s.
    """

    first: int = 0
    readings: FloatArray = field(default_factory=lambda: np.empty((0, 0, READ_ROTORS)))
    sums: FloatArray = field(default_factory=lambda: np.empty((0, 0, EVIDENCE)))
    heights: Sequence[int | None] = ()
    leads: Sequence[int] = ()
    alarms: tuple[Alarm, ...] = ()
    end_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Outside:
    """Time that a slot did not judge for a condition [s], and the condition's farthest value and its excess."""

    span_s: float
    value: float
    excess: float


@dataclass(frozen=True, slots=True)
class Account:
    """How long a slot judged, and why it did not.

    flight_s: flight time so far.
    judged_s: time that its valid values stand for.
    peak: highest valid statistic; None if there was none.
    missing: flight time with a valid gyro in which what it takes of a signal was unknown, and flight time in which the
        gyro is there but must not be judged (`rows.quality.Doubt`), by the reason as a person reads it [s].
    outside: time that it did not judge because a condition was outside of the envelope, and how far that was.
    """

    flight_s: float = 0.0
    judged_s: float = 0.0
    peak: float | None = None
    missing: dict[str, float] = field(default_factory=dict)
    outside: dict[Condition, Outside] = field(default_factory=dict)

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


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """All that the pass remembers; `Kernel.start` and `fresh` say how it begins.

    mem, bins_ns, bins, looks, latest, alarms, alarms_ns: of the present segment: the loops' memory, the bins of
        conditions that may still count, records of looks to come, latest readings, open alarms.
    next_look: number of the first look that is not whole; None before the first row. told: alarms of looks to come.
    tally, outside, missing, doubts, rows: what was counted since the start, of slots, conditions, checks and doubts.
    flown, judged: rows in the air, without take-offs, and how many of them any slot that decides about propellers
        judged: that lie in the window of a valid value of it, as far as it knew its signals there.
    open_ns, bits: rows that later values may still reach back to, and the checks that they fail.
    unjudged: the stretches that nothing can reach any more, in order of time.
    """

    mem: FloatArray
    bins_ns: IntArray
    bins: FloatArray
    looks: FloatArray
    latest: FloatArray
    alarms: FloatArray
    alarms_ns: IntArray
    tally: FloatArray
    outside: FloatArray
    missing: IntArray
    doubts: IntArray
    open_ns: IntArray
    bits: IntArray
    next_look: int | None = None
    told: tuple[Alarm, ...] = ()
    rows: int = 0
    flown: int = 0
    judged: int = 0
    unjudged: tuple[Stretch, ...] = ()


class Kernel:
    """Slots and what their baseline covered, ready for rows of one period.

    dt_s: row period [s]. delay_s: half the window of the rate filters [s].
    """

    def __init__(self, slots: tuple[Slot, ...], covered: tuple[Covered, ...], dt_s: float, delay_s: float) -> None:
        self.slots, self.covered, self.dt_s = slots, covered, dt_s
        self.periods_s = np.array([slot.monitor.period_s(dt_s) for slot in slots])
        self._thresholds = np.array([slot.threshold for slot in slots], dtype=np.float64)
        self._limits = limits_of(covered)
        if not covered:
            self._limits[:, 3] = -1.0
        self._needs = [sorted(slot.monitor.signals) for slot in slots]
        named = {one: None for slot in slots for signal in slot.monitor.signals for one in [_check(slot, signal)]}
        self._checks = np.array(list(named), dtype=np.int64).reshape(-1, 2)
        self._bit = {check: number for number, check in enumerate(named)}
        own = [parameters for slot in slots for parameters in [slot.monitor.parameters_at(dt_s)]]
        self._par = np.concatenate([np.empty(0), *own])
        self._start = [conditions_memory(), *(slot.monitor.memory(dt_s) for slot in slots)]
        self._rotors = max((slot.monitor.rotors for slot in slots), default=0)
        self._plan = self._planned(own)
        reach = (self._plan[self._plan[:, OWN] > 0, REACH]).tolist()
        self._late_ns = max(reach, default=0) + LATE_NS
        bins_ns = round((delay_s + BIN_S) * NS_PER_S)  # from so long on a bin is known
        self._bins = np.array([_bits(TRIM_CONDITIONS), round(TRIM_MEMORY_S * NS_PER_S), bins_ns])
        longest_ns = max(self._plan[:, MEMORY_NS].tolist(), default=0)
        self._longest_ns = longest_ns + bins_ns + round(BIN_S * NS_PER_S)

    def _planned(self, parameters: Sequence[FloatArray]) -> IntArray:
        plan = np.zeros((len(self.slots), PLAN), dtype=np.int64)
        pars = np.cumsum([0, *map(len, parameters)])
        mems = np.cumsum([0, *map(len, self._start)])
        telling = 0
        for number, (row, slot) in enumerate(zip(plan, self.slots, strict=True)):
            monitor = slot.monitor
            row[KIND] = next(i for i, kind in enumerate(MONITORS) if isinstance(monitor, kind))
            row[[PAR, PAR_END, MEM, MEM_END]] = *pars[number : number + 2], *mems[number + 1 : number + 3]
            row[ROTORS], telling = (telling, telling + 1) if monitor.rotors else (-1, telling)
            row[BY_RATES], row[DECIDES], row[OWN] = monitor.by_rates, slot.decides, slot.of_propellers
            spans_s = monitor.delay_s, monitor.memory_s, max(monitor.memory_s, self.periods_s[number]), monitor.clear_s
            row[[DELAY, MEMORY_NS, REACH, CLEAR]] = [round(span_s * NS_PER_S) for span_s in spans_s]
            row[NEEDS] = sum(1 << self._bit[_check(slot, signal)] for signal in self._needs[number])
            row[DEPENDS], row[GROWS] = _bits(monitor.depends), monitor.unit != "s"
        return plan

    def start(self) -> Memory:
        """Nothing seen yet."""
        slots, none = len(self.slots), np.empty(0, dtype=np.int64)
        tally, outside = np.zeros((slots, 2)), np.zeros((slots, COUNT, 3))
        tally[:, PEAK] = -np.inf
        counts = np.zeros(len(self._checks), dtype=np.int64), np.zeros(len(DOUBTS), dtype=np.int64)
        return Memory(*self._segment(), tally, outside, *counts, none, none)

    def fresh(self, memory: Memory) -> Memory:
        """At the border of a segment: only what was counted stays, and no value reaches back over it."""
        unjudged = _stretches(memory.unjudged, memory.open_ns, self.dt_s)
        none = np.empty(0, dtype=np.int64)
        counted = (memory.tally, memory.outside, memory.missing, memory.doubts, none, none)
        rows = (memory.rows, memory.flown, memory.judged, unjudged)
        return Memory(*self._segment(), *counted, None, (), *rows)

    def _segment(self) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray]:
        slots = len(self.slots)
        looks, latest = _records(2, slots, self._rotors), np.zeros((slots, READ_ROTORS + self._rotors))
        latest[:, AT] = NEVER
        no_bins = np.empty(0, dtype=np.int64), np.empty((0, 2 * COUNT))
        return (
            np.concatenate(self._start),
            *no_bins,
            looks,
            latest,
            np.zeros((slots, 4)),
            np.zeros((slots, 2), np.int64),
        )

    def step(self, memory: Memory, rows: Rows) -> tuple[Memory, Looked, Piece]:
        """Take the next rows of the segment; return the looks that they make whole, and all values."""
        block, columns, slots = rows.block, columns_of(rows), len(self.slots)
        n, t_ns, rates_ns = len(block), block.t_ns.copy(), rows.rates.t_ns.copy()  # a log's cannot always be written
        first_ns, now_ns = int(t_ns[0]), int(t_ns[-1])
        first = -(-first_ns // LOOK_NS) if memory.next_look is None else memory.next_look
        done = max(0, now_ns // LOOK_NS + 1 - first)
        mem, latest, alarms, alarms_ns = (
            memory.mem.copy(),
            memory.latest.copy(),
            memory.alarms.copy(),
            memory.alarms_ns.copy(),
        )
        tally, outside = memory.tally.copy(), memory.outside.copy()
        missing, doubts = memory.missing.copy(), memory.doubts.copy()
        old = int(memory.bins_ns.searchsorted(first_ns - self._longest_ns))
        known, more = len(memory.bins_ns) - old, most_bins(rates_ns)
        bins_ns, bins = np.empty(known + more, dtype=np.int64), np.empty((known + more, 2 * COUNT))
        bins_ns[:known], bins[:known] = memory.bins_ns[old:], memory.bins[old:]
        looks = _records(done + 2, slots, self._rotors)
        looks[:2] = memory.looks
        readings, (heights, leads) = np.empty((done, *latest.shape)), np.empty((2, done), dtype=np.int64)
        count = len(memory.open_ns)
        open_ns, bits = np.empty(count + n, dtype=np.int64), np.empty(count + n, dtype=np.int64)
        open_ns[:count], bits[:count] = memory.open_ns, memory.bits
        out, at = np.empty((slots, 4, n)), np.empty((slots, n), dtype=np.int64)
        rotors = np.empty((int(self._plan[:, ROTORS].max(initial=-1)) + 1, n, self._rotors))
        counts = np.zeros(slots, dtype=np.int64)
        told, told_ns = np.empty((2 * slots * n, 2)), np.empty((2 * slots * n, 4), dtype=np.int64)
        numbers = np.array(
            [first, done, known, count, block.settled_ns, now_ns - self._late_ns, *self._bins, 0, 0, 0, 0]
        )
        judge(
            self._plan,
            self._thresholds,
            self._checks,
            self._limits,
            self._par,
            mem,
            numbers,
            columns.x,
            columns.flags,
            columns.lag,
            t_ns,
            rates_ns,
            bins_ns,
            bins,
            out,
            rotors,
            NO_ROTORS,
            at,
            counts,
            looks,
            latest,
            readings,
            heights,
            leads,
            alarms,
            alarms_ns,
            told,
            told_ns,
            tally,
            outside,
            missing,
            doubts,
            open_ns,
            bits,
        )
        *_, open_rows, _, _, _, _, _, tells, gone, fresh, judged = numbers.tolist()
        known = int(numbers[BINS])
        alarms_told = memory.told
        if tells:
            pairs = zip(told_ns[:tells].tolist(), told[:tells].tolist(), strict=True)
            alarms_told += tuple(Alarm(first + look, *whose, *high) for (look, *whose), high in pairs)
        now = tuple(sorted((one for one in alarms_told if one.look < first + done), key=lambda one: one.look))
        later = tuple(one for one in alarms_told if one.look >= first + done)
        unjudged = _stretches(memory.unjudged, open_ns[:gone], self.dt_s) if gone else memory.unjudged
        after = Memory(
            mem,
            bins_ns[:known],
            bins[:known],
            looks[done:],
            latest,
            alarms,
            alarms_ns,
            tally,
            outside,
            missing,
            doubts,
            open_ns[gone:open_rows].copy(),
            bits[gone:open_rows].copy(),
            first + done,
            later,
            memory.rows + n,
            memory.flown + fresh,
            memory.judged + judged,
            unjudged,
        )
        looked = Looked(first, readings, looks, heights.tolist(), leads.tolist(), now)
        return after, looked, Piece(rows, self.slots, self._plan, out, rotors, at, counts)

    def close(self, memory: Memory, end_ns: int) -> Looked:
        """The last look, at the end of a segment or of the data: what no look has had until then."""
        if memory.next_look is None or end_ns <= (memory.next_look - 1) * LOOK_NS:
            return Looked()
        sums, latest = memory.looks[:1].copy(), memory.latest.copy()
        newer, number = memory.looks[1], end_ns / LOOK_NS
        sums[0, :, HIGHEST] = np.fmax(sums[0, :, HIGHEST], newer[:, HIGHEST])
        later = newer[:, JUDGED] > 0
        evidence = slice(EVIDENCE, EVIDENCE + self._rotors)
        for column in (LAST, LAST_LEVEL, *range(evidence.start, evidence.stop)):
            sums[0, later, column] = newer[later, column]
        sums[0, :, [JUDGED, SQUARES]] += newer[:, [JUDGED, SQUARES]].T
        sums[0, :, EVIDENCE + self._rotors :] += newer[:, EVIDENCE + self._rotors :]
        told = (sums[0, :, HIGHEST] >= 0) & (sums[0, :, JUDGED] > 0)
        latest[told, RATIO], latest[told, READ], latest[told, AT] = sums[0, told, HIGHEST], sums[0, told, LAST], number
        latest[told, READ_ROTORS:] = sums[0, told, evidence]
        return Looked(memory.next_look, latest[None], sums, (None,), (-1,), memory.told, end_ns)

    def open_alarms(self, memory: Memory) -> tuple[Alarm, ...]:
        """The alarms that last, with what is known of them."""
        return self._open(memory, lasting=True)

    def ended_alarms(self, memory: Memory) -> tuple[Alarm, ...]:
        """The same at the end of a flight, each with its last value above."""
        return self._open(memory, lasting=False)

    def _open(self, memory: Memory, lasting: bool) -> tuple[Alarm, ...]:
        return tuple(
            Alarm(0, number, start_ns, -1 if lasting else above_ns, top, level)
            for number, ((open_, _, top, level), (start_ns, above_ns)) in enumerate(
                zip(memory.alarms.tolist(), memory.alarms_ns.tolist(), strict=True)
            )
            if open_
        )

    def accounts(self, memory: Memory) -> tuple[Account, ...]:
        """How long each slot judged, and why it did not."""
        doubts = {str(DOUBTS[i]): int(n) * self.dt_s for i, n in enumerate(memory.doubts) if i and n}
        missing, found = (memory.missing * self.dt_s).tolist(), []
        for number, (slot, period_s) in enumerate(zip(self.slots, self.periods_s.tolist(), strict=True)):
            (values, peak), lacking = memory.tally[number].tolist(), dict(doubts)
            for signal in self._needs[number]:
                if span_s := missing[self._bit[_check(slot, signal)]]:
                    lacking[f"no {signal.replace('_', ' ')}"] = span_s
            outside = {
                condition: Outside(beyond * period_s, value, excess)
                for condition, (beyond, value, excess) in zip(ORDER, memory.outside[number].tolist(), strict=True)
                if beyond
            }
            highest = peak if values else None
            found.append(Account(memory.rows * self.dt_s, values * period_s, highest, lacking, outside))
        return tuple(found)


NO_ROTORS = np.empty((0, 0))


def _check(slot: Slot, signal: Signal) -> tuple[int, int]:
    """How it is seen in a column that what a slot takes of a signal is known."""
    if signal in (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT):
        return -1, VALID if signal is Signal.BODY_RATE else SETPOINT
    first, stop = PLACES[signal]
    cut = slot.monitor.columns(signal)
    return first + (cut.start or 0), stop if cut.stop is None else first + cut.stop


def _bits(conditions: frozenset[Condition]) -> int:
    return sum(1 << ORDER.index(condition) for condition in conditions)


def _records(looks: int, slots: int, rotors: int) -> FloatArray:
    records = np.zeros((looks, slots, EVIDENCE + 2 * rotors))
    records[:, :, HIGHEST] = NAN
    return records


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
    from mavdiag.testing import example_rows  # values for tests, which nothing else here needs

    kernel = Kernel((), (), 0.01, 0.02)
    kernel.step(kernel.start(), example_rows(20))
