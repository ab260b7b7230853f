"""Which samples of a link are believed, and how good the link is, by what its healthy flights showed.

A sample is *lost* if it is no number, is beyond what any sensor measures, or leaps:

    leap_i = |x_i - x_last - c (t_i - t_last)| / n > most,    n = max(1, |t_i - t_last|/T)          in some column

x_last is the last sample that was believed, T the usual period, angles are taken the short way round; `most` is twice
the healthy leap, or a small one. c is zero, or the slope between the two samples that were believed last, where the
healthy signal leaps less by it (n (n + 1)/2 then stands for n, as a changing slope adds up): a set-point is
differentiated, and what moves fast but smoothly must not hide an error of the size of its steps.

Samples that leap wait for the next ones: if after 3 of them (2 at 50 Hz and below) the signal leaps back, they were a
glitch. If not, or if 5 of the 20 samples before leapt at least half as far, it is how the signal moves now, and it is
believed: a glitch of 30 ms never reaches a monitor, and a fault that shakes or throws the vehicle loses hardly
anything. What holds its last value does not wait, and is lost.

A sample whose stamp leaps is lost until another one follows it: a stamp that goes back by more than a period, or ahead
by more than ever, or ahead of the next sample by more than a period.

A sample is *dead* if it repeats the one before (gyro and accelerometer: or changes by less than a twentieth of the
quietest healthy noise) for four times as long as ever in health, but not above a second unless health did; the
attitude's set-point for two samples more than it did, for its slope is what the model is driven by; likewise one axis
of gyro or accelerometer alone; and at once if all that the accelerometer, the outputs, the attitude or its
set-point read is zero. Then it is unknown.

The gyro is *doubted* (`Doubt`) where it is dead, where its time stamps scatter more about their grid than they did in
health, and where its resolution is coarser. Rows keep it, and say why they must not be judged.

Samples are looked at in the order in which they came, so that a log and a live link believe the same ones.
"""

import math
from collections.abc import Iterable, Sequence
from enum import StrEnum
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict

from mavdiag.jit import cached_loop, inline, jit
from mavdiag.rows.windows import forgetting
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

FAR = 2.0  # healthy leaps; a longer one is a glitch until it is seen again: it hardly shows in a mean (our choice)
GLITCH_S, MOST_LOST = 0.03, 3  # an I2C glitch spoils up to three samples, and two may be struck (our choice)
AMONG, OFTEN, AS_FAR = 20, 5, 0.5  # so many of the last samples that leapt so far are no glitches (our choice)
OUT_OF_ORDER, EARLY = 1.5, 2.5  # periods back, and ahead: two samples that changed places are in order (our choice)
USUAL_SHARE = 0.95  # quantile of the largest leaps of the seconds of healthy flight (our choice: glitches are rarer)
STILL_SHARE = 0.999  # quantile of the repetitions of the attitude's set-point that is the longest (our choice)
STILL_FACTOR, STILL_MORE = 4.0, 2  # of the longest healthy repetition, and samples more (our choice)
STILL_S, STILL_LEAST = 0.8, 1.5  # no longer than this, but by so much longer than in health (our choice)
QUIET_SHARE = 0.05  # of the healthy noise: 26 dB below it (our choice)
CALM_SHARE = 0.1  # the quantile of the noise of the seconds of healthy flight that is its quietest (our choice)
JITTER_S = 5.0  # memory of the jitter: one wrong stamp in it is none (our choice)
MISSING = 2.5  # periods: a longer step says nothing of jitter (our choice)
JITTER_FACTOR, LEAST_JITTER = 2.0, 0.05  # of the healthy one, and of a period, which no monitor notices (our choice)
RESOLUTION_FACTOR = 1.5  # of the healthy one: 2 mrad/s in place of 1 is another sensor or link (our choice)
RESOLUTION_NOISE = 0.25  # of the rms step: a finer resolution than this is hidden by the noise (our choice)
RESOLUTION_SAMPLES = 200  # before it is judged: the finest of so many steps of noise is far below that
SAME = 1e-6  # rad/s: rounding of a conversion, no step
REORDER_S = 0.05  # a stamp that leaps ahead by more must be followed by others (our choice, as rows wait for samples)

# Beyond any sensor of a small vehicle: gyros end at 70 rad/s (4000 deg/s), accelerometers at 3900 m/s^2 (400 g).
GREATEST = {
    Signal.BODY_RATE: 100.0,
    Signal.SPECIFIC_FORCE: 4000.0,
    Signal.ATTITUDE: 1e4,
    Signal.ATTITUDE_SETPOINT: 1e4,
    Signal.RATE_SETPOINT: 1e3,
    Signal.VIBRATION: 4000.0,
    Signal.HEIGHT: 1e5,
}
# A leap up to this is believed at any rate, for a flight may be livelier than those that taught (our choice).
HARMLESS = {
    Signal.ATTITUDE: 0.02,
    Signal.ATTITUDE_SETPOINT: 0.0005,  # three steps of a log in 0.01 deg; within 0.1 s a rate of 0.005 rad/s
    Signal.RATE_SETPOINT: 0.1,
    Signal.TORQUE_COMMAND: 0.1,
    Signal.THRUST_SETPOINT: 0.2,
    Signal.ACTUATOR: 0.05,
    Signal.VIBRATION: 1.0,
    Signal.HEIGHT: 0.5,
}
GREATEST_SHARE = 10.0  # of commands and outputs, which end at 1
ANGLES = (Signal.ATTITUDE, Signal.ATTITUDE_SETPOINT)
SENSORS = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE)  # never silent, and each axis is a sensor of its own
NEVER_ZERO = (Signal.SPECIFIC_FORCE, Signal.ACTUATOR)  # of a vehicle that flies
# Their last value holds, so that rows do not wait for the next one: what leaps is lost at once.
HELD = (Signal.THRUST_SETPOINT, Signal.HEIGHT, Signal.VIBRATION, Signal.ACTUATOR)
MAY_REST = (Signal.HEIGHT,)  # may stay as it is for as long as it likes
FINITE = (Signal.BODY_RATE, *ANGLES)  # rows read them without nan: a sample that is no number is lost
LEARNT = (*GREATEST, Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT, Signal.ACTUATOR)
TURN = 2 * np.pi


class Doubt(StrEnum):
    """Why rows must not be judged though the gyro is there."""

    FROZEN = "gyro repeats one value"
    STAMPS = "time stamps"
    RESOLUTION = "gyro resolution"
    THRUST = "thrust was lost"


DOUBTS = (None, *Doubt)  # by the code that rows carry


class Habit(BaseModel):
    """How one signal moved in healthy flight.

    signal: which one.
    period_s: its usual period [s]. pause_s: the longest one of an ordinary second [s].
    leap: of each column the largest leap of an ordinary second, before `most` divides it [unit of the signal].
    quiet: of each column the step below which it is silent; 0 where only equal values are.
    still: longest repetition [samples] of all columns together; of gyro and accelerometer also of each one.
    lowest: least value of the first column in flight.
    leads: of each column whether its slope tells where the next sample is to be; empty if none does.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    signal: Signal
    period_s: float
    pause_s: float
    leap: tuple[float, ...]
    quiet: tuple[float, ...]
    still: tuple[int, ...]
    lowest: float
    leads: tuple[bool, ...] = ()

    def most_leap(self) -> FloatArray:
        """Of each column the longest step that is believed at once; a column that never moved may do so."""
        leap = np.array(self.leap)
        if self.signal in SENSORS:
            return np.where(leap > 0, FAR * leap, np.inf)
        return np.maximum(FAR * leap, HARMLESS[self.signal])

    def most_still(self) -> FloatArray:
        """For how many samples all columns together, and each of a sensor, may repeat."""
        longest = np.array(self.still, dtype=np.float64)
        most = STILL_FACTOR * longest + STILL_MORE
        most[0] = max(min(most[0], STILL_S / self.period_s), STILL_LEAST * longest[0] + STILL_MORE)
        most = np.floor(most) if self.signal is not Signal.ATTITUDE_SETPOINT else longest + STILL_MORE
        return np.append(most, np.full(1 + len(self.leap) - len(most), np.inf))


class LinkQuality(BaseModel):
    """What healthy flights showed of a link; without habits nothing is known of it, and nothing compared.

    habits: of each signal.
    jitter: highest rms of 5 s of the time stamps of the gyro about their grid [share of a period].
    resolution_rad_s: smallest step of the gyro, of its coarsest axis [rad/s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    habits: tuple[Habit, ...] = ()
    jitter: float = 0.0
    resolution_rad_s: float = 0.0

    @cached_property
    def rules(self) -> "dict[tuple[Signal, int], _Rule]":
        """The rule of each signal that was learnt, by its name and number of columns."""
        return {(one.signal, len(one.leap)): self._rule(one) for one in self.habits}

    def _rule(self, habit: Habit) -> "_Rule":
        signal, leads = habit.signal, habit.leads or (False,) * len(habit.leap)
        early_s = max(EARLY * habit.period_s, habit.pause_s)
        ahead_s = max(REORDER_S, 3 * habit.period_s, FAR * habit.pause_s)
        noise = RESOLUTION_NOISE / QUIET_SHARE * min(habit.quiet)
        return _unlearnt(signal, len(habit.leap))._replace(
            learnt=True,
            period_ns=habit.period_s * NS_PER_S,
            alpha=forgetting(JITTER_S, habit.period_s),
            patience=min(max(round(GLITCH_S / habit.period_s), 2), MOST_LOST),
            back_ns=round(OUT_OF_ORDER * habit.period_s * NS_PER_S),
            early_ns=round(early_s * NS_PER_S),
            ahead_ns=round(ahead_s * NS_PER_S),
            zero_is_dead=signal in ANGLES and any(habit.leap),
            lowest=habit.lowest if signal is Signal.THRUST_SETPOINT else -math.inf,
            most_jitter=max(JITTER_FACTOR * self.jitter, LEAST_JITTER),
            most_step=max(RESOLUTION_FACTOR * self.resolution_rad_s, noise),
            leading=any(leads),
            leap=habit.most_leap(),
            leads=np.array(leads),
            quiet=np.array(habit.quiet),
            still=habit.most_still(),
        )


class _Rule(NamedTuple):
    """What is believed of a signal.

    learnt: whether anything is known but its range. columns: how many. gyro, angle: what it is. holds: its last value
    does. greatest, finite: its range, and whether it must be a number. never_zero: a sample of zeros is unknown. rests:
    what is dead stays as it is; else it is unknown, or dropped if it is an angle. leap, leads, quiet: of each column.
    still: of all columns together, and of each. patience: how many samples that leap may be lost. back_ns, early_ns,
    ahead_ns: spans of stamps. zero_is_dead: a sample of zeros is, of a vehicle that flies. lowest: below it nothing
    moves. most_jitter [periods], most_step [unit]: beyond them the gyro is doubted. leading: any column leads.
    """

    learnt: bool
    columns: int
    gyro: bool
    angle: bool
    holds: bool
    greatest: float
    finite: bool
    never_zero: bool
    rests: bool
    leap: FloatArray
    leads: BoolArray
    quiet: FloatArray
    still: FloatArray
    period_ns: float = 1.0
    alpha: float = 0.0
    patience: int = 0
    back_ns: int = 0
    early_ns: int = 0
    ahead_ns: int = 0
    zero_is_dead: bool = False
    lowest: float = -math.inf
    most_jitter: float = 0.0
    most_step: float = 0.0
    leading: bool = False


@lru_cache(maxsize=64)
def _unlearnt(signal: Signal, columns: int) -> _Rule:
    """The rule of a signal of which nothing was learnt."""
    none = np.zeros(columns)
    return _Rule(
        learnt=False,
        columns=columns,
        gyro=signal is Signal.BODY_RATE,
        angle=signal in ANGLES,
        holds=signal in HELD,
        greatest=GREATEST.get(signal, GREATEST_SHARE if signal in LEARNT else math.inf),
        finite=signal in FINITE,
        never_zero=signal in NEVER_ZERO,
        rests=signal in MAY_REST,
        leap=none,
        leads=none > 0,
        quiet=none,
        still=np.zeros(1 + columns),
    )


# Places in the figures: jitter, and how far the latest samples leapt; then of each column the last believed value, its
# slope [1/ns], the value that came last, and the smallest step. In the counts: samples so far; stamps of the last one
# that was believed, and that came [ns]; whether its stamp leapt; how many leapt lately; samples traced; numbers of
# those that leapt; repetitions.
JITTER, SIZES, COLUMN = 0, 1, 1 + AMONG + MOST_LOST + 1
COUNT, LAST_NS, CAME_NS, ALONE, FAR_COUNT, TRACED, NUMBERS = range(7)
RUNS = NUMBERS + AMONG + MOST_LOST + 1
STAMPS_CODE, RESOLUTION_CODE, FROZEN_CODE = (
    DOUBTS.index(one) for one in (Doubt.STAMPS, Doubt.RESOLUTION, Doubt.FROZEN)
)
NO_TRACE = np.empty((0, 0))


class Memory:
    """What is remembered of one signal between chunks; changed in place.

    figures, counts: see `COLUMN` and `RUNS`. waiting: samples that later ones decide on.
    """

    __slots__ = ("counts", "figures", "waiting")

    def __init__(self, columns: int) -> None:
        self.figures, self.counts = np.zeros(COLUMN + 4 * columns), np.zeros(RUNS + 1 + columns, dtype=np.int64)
        self.figures[COLUMN : COLUMN + 3 * columns], self.figures[COLUMN + 3 * columns :] = np.nan, np.inf
        self.waiting: Series | None = None


Memories: TypeAlias = dict[tuple[Signal, int], Memory]


class _Samples(NamedTuple):
    """Rule and memory of a signal, and its samples: (n,) times of vehicle and receiver, (n, k) values.

    The gyro has a column more, for `Doubt` as a number.
    """

    rule: _Rule
    mem: FloatArray
    counts: IntArray
    t_ns: IntArray
    host_ns: IntArray
    v: FloatArray


@inline
def _short(s: _Samples, step: float) -> float:
    """A step; of an angle the short way round."""
    if not s.rule.angle or abs(step) <= math.pi:
        return step
    return float(step - TURN * np.round(step / TURN))


@inline
def _away(s: _Samples, column: int, value: float, span_ns: int) -> float:
    """How far a value is from where those before it lead."""
    at = COLUMN + column
    return _short(s, value - s.mem[at] - s.mem[at + s.rule.columns] * span_ns)


@inline
def _near(s: _Samples, i: int, span_ns: int) -> bool:
    """Whether a sample leaps nowhere by more than is believed after one period: the usual case."""
    for column in range(s.rule.columns):
        if abs(_away(s, column, s.v[i, column], span_ns)) > s.rule.leap[column]:
            return False
    return True


@jit
def _size(s: _Samples, column: int, away: float, span_ns: int) -> float:
    """How large that is for the time: above 1 it leaps; nan where it is not known."""
    n = max(min(abs(span_ns), s.rule.ahead_ns) / s.rule.period_ns, 1.0)
    grown = n * (n + 1.0) / 2.0 if s.rule.leads[column] else n
    return float(abs(away) / grown / s.rule.leap[column])


@jit
def _leap(s: _Samples, i: int) -> float:
    """The largest of all columns of a sample."""
    found, span_ns = 0.0, s.t_ns[i] - s.counts[LAST_NS]
    for column in range(s.rule.columns):
        size = _size(s, column, _away(s, column, s.v[i, column], span_ns), span_ns)
        found = max(found, size) if size == size else found
    return found


@jit
def _misdated(s: _Samples, there: int, i: int) -> int:
    """1 if the stamp of a sample leaps by the last believed and the next one, 0 if not; -1 if the next must come."""
    rule, span_ns = s.rule, s.t_ns[i] - s.counts[LAST_NS]
    followed = s.counts[ALONE] > 0 and abs(s.t_ns[i] - s.counts[CAME_NS]) <= rule.ahead_ns
    if -rule.back_ns <= span_ns <= rule.early_ns or followed:
        return 0
    if span_ns < 0 or span_ns > rule.ahead_ns:
        return 1
    if rule.holds:
        return 0
    if i + 1 == there:
        return -1
    return 1 if s.t_ns[i + 1] < s.t_ns[i] - rule.back_ns else 0


@jit
def _decide(s: _Samples, there: int, i: int) -> tuple[int, bool]:
    """How many samples from i on are decided, 0 if more must come; whether they are lost: they leap away and back."""
    patience, number, last_ns = s.rule.patience, s.counts[COUNT], s.counts[LAST_NS]
    first = _leap(s, i)
    if not first > 1.0:
        return 1, False
    kept, often = 0, 0
    for k in range(s.counts[FAR_COUNT]):
        if s.counts[NUMBERS + k] > number - AMONG:
            s.counts[NUMBERS + kept], s.mem[SIZES + kept] = s.counts[NUMBERS + k], s.mem[SIZES + k]
            often += s.mem[SIZES + kept] >= AS_FAR * first
            kept += 1
    s.counts[FAR_COUNT] = kept
    run, left = 1, min(patience + 1, there - i)
    while run < left and _leap(s, i + run) > 1.0:
        run += 1
    usual, lost = often >= OFTEN, False
    if usual or s.rule.holds:
        lost, run = not usual, 1
    elif run > patience:
        run = 1
    elif run == left:
        return 0, False
    else:
        here, before = i + run, i + run - 1
        for column in range(s.rule.columns):
            one = _away(s, column, s.v[here, column], s.t_ns[here] - last_ns)
            other = _away(s, column, s.v[before, column], s.t_ns[before] - last_ns)
            lost = lost or _size(s, column, _short(s, one - other), s.t_ns[here] - s.t_ns[before]) > 1.0
    for k in range(run):
        s.counts[NUMBERS + kept + k] = number + k
        s.mem[SIZES + kept + k] = _leap(s, i + k)
    s.counts[FAR_COUNT] = kept + run
    return run, lost


@inline
def _believe(s: _Samples, i: int) -> None:
    """Make a sample the last one that is believed."""
    columns, span_ns = s.rule.columns, s.t_ns[i] - s.counts[LAST_NS]
    share = 1.0 / span_ns if span_ns != 0 and s.rule.leading else 0.0
    for column in range(columns):
        at, leads = COLUMN + column, s.rule.leads[column]
        s.mem[at + columns] = _short(s, s.v[i, column] - s.mem[at]) * share if leads and share != 0.0 else 0.0
        s.mem[at] = s.v[i, column]
    s.counts[LAST_NS] = s.t_ns[i]


@inline
def _measure(s: _Samples, i: int) -> float:
    """Count repetitions after a sample, and of the gyro follow jitter and finest step; returns the resolution."""
    mem, counts, columns, gyro = s.mem, s.counts, s.rule.columns, s.rule.gyro
    same, coarsest = True, 0.0
    for column in range(columns):
        came, finest = COLUMN + 2 * columns + column, COLUMN + 3 * columns + column
        step = abs(s.v[i, column] - mem[came])
        still = not step > s.rule.quiet[column] and counts[COUNT] > 0
        same = same and still
        counts[RUNS + 1 + column] = counts[RUNS + 1 + column] + 1 if still else 0
        mem[came] = s.v[i, column]
        if gyro:
            mem[finest] = min(mem[finest], step) if step > SAME else mem[finest]
            coarsest = max(coarsest, mem[finest])
    counts[RUNS] = counts[RUNS] + 1 if same else 0
    if gyro:
        steps = (s.t_ns[i] - counts[CAME_NS]) / s.rule.period_ns
        apart = steps - np.round(steps) if 0.0 < steps < MISSING else 0.0  # else it is lost or misdated
        mem[JITTER] += s.rule.alpha * (apart * apart - mem[JITTER])
    counts[CAME_NS] = s.t_ns[i]
    counts[COUNT] += 1
    return coarsest if counts[COUNT] > RESOLUTION_SAMPLES and math.isfinite(coarsest) else 0.0


@inline
def _use(s: _Samples, i: int, finest: float) -> bool:
    """Make of a sample what rows may use, after `_measure`; whether they may."""
    rule, v, columns = s.rule, s.v, s.rule.columns
    frozen, zero, alone = s.counts[RUNS] > rule.still[0], rule.zero_is_dead, False
    for column in range(columns):
        zero = zero and v[i, column] == 0.0
        alone = alone or s.counts[RUNS + 1 + column] > rule.still[1 + column]
    dead = (frozen or zero) and not v[i, 0] < rule.lowest
    if rule.gyro:
        if dead or alone:
            v[i, columns] = FROZEN_CODE
        elif finest > rule.most_step:
            v[i, columns] = RESOLUTION_CODE
        elif s.mem[JITTER] > rule.most_jitter**2:
            v[i, columns] = STAMPS_CODE
        return True
    if (dead or alone) and not (rule.rests or rule.angle):
        for column in range(columns):
            if dead or s.counts[RUNS + 1 + column] > rule.still[1 + column]:
                v[i, column] = np.nan
    return not (dead and rule.angle)


@inline
def _in_range(s: _Samples, i: int) -> bool:
    """Whether a sensor may have measured it; nan where rows may have it: some vehicles log some columns only."""
    for column in range(s.rule.columns):
        size = abs(s.v[i, column])
        if size > s.rule.greatest or (size != size and s.rule.finite):
            return False
    return True


@jit
def _blank_if_zero(s: _Samples, i: int) -> None:
    """Unknown, if it has nothing but zeros, which no vehicle in flight has."""
    columns = s.rule.columns
    for column in range(columns):
        if s.v[i, column] != 0.0 and math.isfinite(s.v[i, column]):
            return
    for column in range(columns):
        s.v[i, column] = np.nan


@inline
def _move(s: _Samples, i: int, to: int) -> None:
    if to < i:
        s.t_ns[to], s.host_ns[to] = s.t_ns[i], s.host_ns[i]
        for column in range(s.v.shape[1]):
            s.v[to, column] = s.v[i, column]


@inline
def _take(s: _Samples, i: int, lost: bool, kept: int, trace: FloatArray) -> int:
    """Measure a sample that is decided, and move it to the believed ones, if it is; returns how many there are."""
    columns = s.rule.columns
    if s.rule.gyro:
        s.v[i, columns] = 0.0
    if s.rule.learnt:
        finest = _measure(s, i)
        if lost:
            return kept
        if len(trace):
            traced = s.counts[TRACED]
            s.counts[TRACED] += 1
            for k in range(1 + columns):
                trace[traced, k] = s.counts[RUNS + k]
            trace[traced, 1 + columns], trace[traced, 2 + columns] = math.sqrt(s.mem[JITTER]), finest
        if not _use(s, i, finest):
            return kept
    if s.rule.never_zero:
        _blank_if_zero(s, i)
    _move(s, i, kept)
    return kept + 1


@cached_loop
def _look_at(s: _Samples, waited: int, trace: FloatArray) -> tuple[int, int, int]:
    """Move the samples that are believed to the front, as rows may use them.

    waited: how many of them came before. trace: (n, columns + 3) of each that was not lost how long it repeated, the
    jitter, and the resolution, 0 if unknown; or empty.
    Returns how many are believed, how many are decided, and how many there are within range.
    """
    there = waited
    for i in range(waited, len(s.t_ns)):
        if _in_range(s, i):
            _move(s, i, there)
            there += 1
    if s.counts[COUNT] == 0 and waited == 0 and there:
        s.counts[LAST_NS] = s.counts[CAME_NS] = s.t_ns[0]
    kept = done = 0
    while done < there:
        span_ns, run, lost = s.t_ns[done] - s.counts[LAST_NS], 1, False
        if s.rule.learnt:
            usual = -s.rule.back_ns <= span_ns <= s.rule.early_ns and _near(s, done, span_ns)
            misdated = 0 if usual else _misdated(s, there, done)
            if misdated < 0:
                break
            s.counts[ALONE], lost = misdated, misdated > 0
            if not usual and not lost:
                run, lost = _decide(s, there, done)
                if run == 0:
                    break
            if not lost:
                for i in range(done, done + run):
                    _believe(s, i)
        for i in range(done, done + run):
            kept = _take(s, i, lost, kept, trace)
        done += run
    return kept, done, there


def believed(quality: LinkQuality, telemetry: Telemetry, memories: Memories | None = None) -> Telemetry:
    """The telemetry without its lost samples, nan where it is dead; the gyro with a fourth column, `Doubt` as a number.

    The number is the place in `DOUBTS`. memories: of what came before, changed in place; None if that is all there is.
    """
    memories, found = {} if memories is None else memories, []
    for series in telemetry.series:
        key = series.signal, series.values.shape[1]
        rule, memory = quality.rules.get(key) or _unlearnt(*key), memories.get(key)
        if memory is None:
            memory = memories[key] = Memory(key[1])
        series = _looked(rule, memory, series)
        if len(series):
            found.append(series)
    return Telemetry(tuple(found))


def _looked(rule: _Rule, memory: Memory, series: Series, trace: FloatArray = NO_TRACE) -> Series:
    """What is believed of the next samples of a signal, and of those that waited."""
    columns, before = series.values.shape[1], memory.waiting
    waited = 0 if before is None else len(before)
    count = waited + len(series)
    t_ns, host_ns = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    values = np.empty((count, columns + (series.signal is Signal.BODY_RATE)))
    if before is not None:
        t_ns[:waited], host_ns[:waited], values[:waited] = before.t_ns, before.host_ns, before.values
    t_ns[waited:], host_ns[waited:], values[waited:, :columns] = series.t_ns, series.host_ns, series.values
    samples = _Samples(rule, memory.figures, memory.counts, t_ns, host_ns, values)
    kept, done, there = _look_at(samples, waited, trace)
    memory.waiting = None
    if done < there:
        rest = slice(done, there)
        memory.waiting = Series(series.signal, t_ns[rest].copy(), host_ns[rest].copy(), values[rest].copy())
    return Series(series.signal, t_ns[:kept], host_ns[:kept], values[:kept])


def learnt_quality(flights: Iterable[tuple[Telemetry, Sequence[tuple[int, int]]]]) -> LinkQuality:
    """What healthy flights show of their link: of each its telemetry, and the spans of flight in it [ns, both ends]."""
    pieces: dict[Signal, list[Series]] = {}
    for telemetry, spans_ns in flights:
        for series in telemetry.series:
            if series.signal in LEARNT:
                inside = [_between(_measurable(series), *span) for span in spans_ns]
                pieces.setdefault(series.signal, []).extend(one for one in inside if len(one) > 1)
    habits, jitter = [], 0.0
    steps: list[float] = []
    for signal, parts in pieces.items():
        if len({one.values.shape[1] for one in parts}) != 1:  # never flew, or other numbers of outputs
            continue
        habit, runs = _moved(signal, parts), []
        for part in parts:
            if not len(trace := _traced(habit, part)):
                continue
            runs.append(trace[:, :1] if signal is Signal.ATTITUDE_SETPOINT else trace[:, :-2].max(axis=0)[None])
            if signal is Signal.BODY_RATE:
                jitter = max(jitter, float(trace[:, -2].max()))
                steps.append(float(trace[-1, -1]))
        if not runs:
            continue
        share = STILL_SHARE if signal is Signal.ATTITUDE_SETPOINT else 1.0
        longest = np.quantile(np.concatenate(runs), share, axis=0, method="higher").astype(int).tolist()
        habits.append(habit.model_copy(update={"still": tuple(longest if signal in SENSORS else longest[:1])}))
    resolution = min((step for step in steps if step > 0), default=0.0)
    return LinkQuality(habits=tuple(habits), jitter=jitter, resolution_rad_s=resolution)


def _measurable(series: Series) -> Series:
    """Without what no sensor measures; the same where there is nothing of it."""
    columns = series.values.shape[1]
    rule = _unlearnt(series.signal, columns)._replace(never_zero=False)
    if not len(series) or np.abs(series.values).max() <= rule.greatest:
        return series
    found = _looked(rule, Memory(columns), series)
    return Series(found.signal, found.t_ns, found.host_ns, found.values[:, :columns])


def _between(series: Series, first_ns: int, last_ns: int) -> Series:
    """Its samples within a span of flight, in order of time, each time once."""
    t_ns = series.t_ns
    if np.all(t_ns[1:] > t_ns[:-1]):  # a part of the same memory
        at: IntArray | slice = slice(int(t_ns.searchsorted(first_ns)), int(t_ns.searchsorted(last_ns, side="right")))
    else:
        t_ns, order = np.unique(t_ns, return_index=True)
        at = order[(t_ns >= first_ns) & (t_ns <= last_ns)]
    return Series(series.signal, series.t_ns[at], series.host_ns[at], series.values[at])


def _traced(habit: Habit, series: Series) -> FloatArray:
    """What `_look_at` traces of the samples that are not lost by what the habit says of leaps."""
    columns = series.values.shape[1]
    trace = np.full((len(series), columns + 3), np.nan)
    _looked(LinkQuality(habits=(habit,)).rules[series.signal, columns], Memory(columns), series, trace)
    return trace[~np.isnan(trace[:, 0])]


def _moved(signal: Signal, parts: Sequence[Series]) -> Habit:
    """How a signal moved, but for how long it repeats."""
    period_ns = float(np.median(np.concatenate([np.diff(one.t_ns) for one in parts])))
    held: list[FloatArray] = []
    led: list[FloatArray] = []
    noises, pauses = [], []
    for one in parts:
        span_ns = np.diff(one.t_ns)
        starts = np.unique((one.t_ns[1:] - one.t_ns[0]) // NS_PER_S, return_index=True)[1]
        step, bend = _departures(signal, one, span_ns)
        n = np.maximum(span_ns / period_ns, 1.0)[:, None]
        plain = np.nan_to_num(np.abs(step) / n)
        held.append(np.maximum.reduceat(plain, starts, axis=0))
        led.append(np.maximum.reduceat(np.nan_to_num(np.abs(bend) / (n * (n + 1) / 2)), starts, axis=0))
        counts = np.diff(starts, append=len(span_ns))[:, None]
        noises.append(np.sqrt(np.add.reduceat(np.square(plain), starts, axis=0) / counts))
        pauses.append(np.maximum.reduceat(span_ns, starts))
    usual, bent = (np.quantile(np.concatenate(leaps), USUAL_SHARE, axis=0) for leaps in (held, led))
    leading = (bent < usual) & (signal not in HELD)
    quiet = QUIET_SHARE * np.quantile(np.concatenate(noises), CALM_SHARE, axis=0)
    lowest = float(np.nan_to_num(min(np.min(one.values[:, 0]) for one in parts)))
    return Habit(
        signal=signal,
        period_s=period_ns / NS_PER_S,
        pause_s=float(np.quantile(np.concatenate(pauses), USUAL_SHARE)) / NS_PER_S,
        leap=tuple(np.where(leading, bent, usual).tolist()),
        quiet=tuple(quiet.tolist()) if signal in SENSORS else (0.0,) * len(quiet),
        still=(0,),
        lowest=lowest,
        leads=tuple(leading.tolist()),
    )


def _departures(signal: Signal, series: Series, span_ns: IntArray) -> tuple[FloatArray, FloatArray]:
    """(n - 1, columns) how far samples are from the one before, and from where the two before it lead."""
    step, turn = np.diff(series.values, axis=0).astype(np.float64), TURN * (signal in ANGLES)
    step -= turn * np.round(step / TURN)
    slope = np.divide(step, span_ns[:, None], out=np.zeros_like(step), where=span_ns[:, None] != 0)
    bend = step - np.concatenate((np.full((1, step.shape[1]), np.nan), slope[:-1])) * span_ns[:, None]
    bend -= turn * np.round(bend / TURN)
    return step, bend
