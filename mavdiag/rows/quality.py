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
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
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
LEARNT_SIGNALS = (*GREATEST, Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT, Signal.ACTUATOR)
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

    @property
    def patience(self) -> int:
        """How many samples that leap may be lost."""
        return min(max(round(GLITCH_S / self.period_s), 2), MOST_LOST)

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
    def known(self) -> dict[tuple[Signal, int], FloatArray]:
        """The parameters of each signal that was learnt, by its name and number of columns."""
        return {(one.signal, len(one.leap)): self._parameters(one) for one in self.habits}

    def _parameters(self, habit: Habit) -> FloatArray:
        """See `LEAPS`."""
        signal, par = habit.signal, _unlearnt(habit.signal, len(habit.leap)).copy()
        ahead_s = max(REORDER_S, 3 * habit.period_s, FAR * habit.pause_s)
        early_s = max(EARLY * habit.period_s, habit.pause_s)
        par[LEARNT], par[PERIOD], par[ALPHA] = 1.0, habit.period_s * NS_PER_S, forgetting(JITTER_S, habit.period_s)
        par[PATIENCE] = habit.patience
        spans_s = OUT_OF_ORDER * habit.period_s, early_s, ahead_s
        par[BACK], par[SOON], par[AHEAD] = (round(span_s * NS_PER_S) for span_s in spans_s)
        par[ZERO_IS_DEAD] = signal in ANGLES and any(habit.leap)  # no vehicle that flies has all of them at zero
        par[LOWEST] = habit.lowest if signal is Signal.THRUST_SETPOINT else -np.inf  # below it nothing moves
        par[WHEN_DEAD] = KEPT if signal in MAY_REST else DROPPED if signal in ANGLES else UNKNOWN
        par[MOST_JITTER] = max(JITTER_FACTOR * self.jitter, LEAST_JITTER)
        noise = RESOLUTION_NOISE / QUIET_SHARE * min(habit.quiet)
        par[MOST_STEP] = max(RESOLUTION_FACTOR * self.resolution_rad_s, noise)
        leads = habit.leads or (False,) * len(habit.leap)
        par[RATE], par[LEADING] = 1.0 / par[PERIOD], any(leads)
        par[LEAPS:] = np.concatenate((habit.most_leap(), leads, habit.quiet, habit.most_still()))
        return par


# Places in the parameters of a signal: whether it was learnt; its period [ns]; forgetting of the jitter; whether its
# columns are angles, and hold their last value; how many samples may be lost; spans of stamps back, early and ahead
# [ns]; the greatest value, and whether a sample must be a number; whether zeros, and zeros of an unlearnt signal, are
# dead; from what value on it may be dead, and what becomes of it then; whether it is the gyro, its most jitter [share
# of a period] and coarsest step; samples a ns; whether the slope of any column leads; how many columns
# there are; of each column the longest leap, whether its slope leads, and what is silent; then for
# how many samples all columns, and each one, may be still.
LEARNT, PERIOD, ALPHA, ANGLE, HOLDS, PATIENCE, BACK, SOON, AHEAD, GREATEST_AT, FINITE_AT = range(11)
ZERO_IS_DEAD, NEVER_ZERO_AT, LOWEST, WHEN_DEAD, GYRO, MOST_JITTER, MOST_STEP, RATE, LEADING, COLUMNS, LEAPS = range(
    11, 22
)
KEPT, UNKNOWN, DROPPED = range(3)
# Places in the figures: jitter, and how far the latest samples leapt; then of each column the last believed value, its
# slope [1/ns], the value that came last, and the smallest step. In the counts: samples so far; stamps of the last one
# that was believed, and that came [ns]; whether its stamp leapt; how many leapt lately; samples traced; numbers of those that leapt; repetitions.
JITTER, SIZES, COLUMN = 0, 1, 1 + AMONG + MOST_LOST + 1
COUNT, LAST_NS, CAME_NS, ALONE, FAR_COUNT, TRACED, NUMBERS = range(7)
RUNS = NUMBERS + AMONG + MOST_LOST + 1
STAMPS_CODE, RESOLUTION_CODE, FROZEN_CODE = (
    DOUBTS.index(one) for one in (Doubt.STAMPS, Doubt.RESOLUTION, Doubt.FROZEN)
)
NO_TRACE = np.empty((0, 0))


@lru_cache(maxsize=64)
def _unlearnt(signal: Signal, columns: int) -> FloatArray:
    """Parameters of a signal of which nothing was learnt."""
    par = np.zeros(LEAPS + 3 * columns + 1 + columns)
    commands = GREATEST_SHARE if signal in LEARNT_SIGNALS else np.inf
    par[GREATEST_AT], par[FINITE_AT] = GREATEST.get(signal, commands), signal in FINITE
    par[ANGLE], par[HOLDS], par[NEVER_ZERO_AT] = signal in ANGLES, signal in HELD, signal in NEVER_ZERO
    par[GYRO], par[COLUMNS] = signal is Signal.BODY_RATE, columns
    return par


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
    """Parameters and memory of a signal, and its samples: (n,) times of vehicle and receiver, (n, k) values.

    The gyro has a column more, for `Doubt` as a number.
    """

    par: FloatArray
    mem: FloatArray
    counts: IntArray
    t_ns: IntArray
    host_ns: IntArray
    v: FloatArray


@inline
def _short(s: _Samples, step: float) -> float:
    """A step; of an angle the short way round."""
    if s.par[ANGLE] < 0.5 or abs(step) <= math.pi:
        return step
    return float(step - TURN * np.round(step / TURN))


@inline
def _away(s: _Samples, column: int, value: float, span_ns: int) -> float:
    """How far a value is from where those before it lead."""
    at = COLUMN + column
    return _short(s, value - s.mem[at] - s.mem[at + int(s.par[COLUMNS])] * span_ns)


@inline
def _near(s: _Samples, i: int, span_ns: int) -> bool:
    """Whether a sample leaps nowhere by more than is believed after one period: the usual case."""
    for column in range(int(s.par[COLUMNS])):
        if abs(_away(s, column, s.v[i, column], span_ns)) > s.par[LEAPS + column]:
            return False
    return True


@jit
def _size(s: _Samples, column: int, away: float, span_ns: int) -> float:
    """How large that is for the time: above 1 it leaps; nan where it is not known."""
    n = max(min(abs(span_ns), s.par[AHEAD]) / s.par[PERIOD], 1.0)
    grown = n * (n + 1.0) / 2.0 if s.par[LEAPS + int(s.par[COLUMNS]) + column] > 0.5 else n
    return float(abs(away) / grown / s.par[LEAPS + column])


@jit
def _leap(s: _Samples, i: int) -> float:
    """The largest of all columns of a sample."""
    found, span_ns = 0.0, s.t_ns[i] - s.counts[LAST_NS]
    for column in range(int(s.par[COLUMNS])):
        size = _size(s, column, _away(s, column, s.v[i, column], span_ns), span_ns)
        found = max(found, size) if size == size else found
    return found


@jit
def _misdated(s: _Samples, there: int, i: int) -> int:
    """1 if the stamp of a sample leaps by the last believed and the next one, 0 if not; -1 if the next must come."""
    par, span_ns = s.par, s.t_ns[i] - s.counts[LAST_NS]
    followed = s.counts[ALONE] > 0 and abs(s.t_ns[i] - s.counts[CAME_NS]) <= par[AHEAD]
    if -par[BACK] <= span_ns <= par[SOON] or followed:
        return 0
    if span_ns < 0 or span_ns > par[AHEAD]:
        return 1
    if par[HOLDS] > 0.5:
        return 0
    if i + 1 == there:
        return -1
    return 1 if s.t_ns[i + 1] < s.t_ns[i] - par[BACK] else 0


@jit
def _decide(s: _Samples, there: int, i: int) -> tuple[int, bool]:
    """How many samples from i on are decided, 0 if more must come; whether they are lost: they leap away and back."""
    patience, number, last_ns = int(s.par[PATIENCE]), s.counts[COUNT], s.counts[LAST_NS]
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
    if usual or s.par[HOLDS] > 0.5:
        lost, run = not usual, 1
    elif run > patience:
        run = 1
    elif run == left:
        return 0, False
    else:
        here, before = i + run, i + run - 1
        for column in range(int(s.par[COLUMNS])):
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
    columns, span_ns = int(s.par[COLUMNS]), s.t_ns[i] - s.counts[LAST_NS]
    share = 1.0 / span_ns if span_ns != 0 and s.par[LEADING] > 0.5 else 0.0
    for column in range(columns):
        at, leads = COLUMN + column, s.par[LEAPS + columns + column] > 0.5
        s.mem[at + columns] = _short(s, s.v[i, column] - s.mem[at]) * share if leads and share != 0.0 else 0.0
        s.mem[at] = s.v[i, column]
    s.counts[LAST_NS] = s.t_ns[i]


@inline
def _measure(s: _Samples, i: int) -> float:
    """Count repetitions after a sample, and of the gyro follow jitter and finest step; returns the resolution."""
    par, mem, counts, columns = s.par, s.mem, s.counts, int(s.par[COLUMNS])
    same, coarsest, gyro = True, 0.0, par[GYRO] > 0.5
    for column in range(columns):
        came, finest = COLUMN + 2 * columns + column, COLUMN + 3 * columns + column
        step = abs(s.v[i, column] - mem[came])
        still = not step > par[LEAPS + 2 * columns + column] and counts[COUNT] > 0
        same = same and still
        counts[RUNS + 1 + column] = counts[RUNS + 1 + column] + 1 if still else 0
        mem[came] = s.v[i, column]
        if gyro:
            mem[finest] = min(mem[finest], step) if step > SAME else mem[finest]
            coarsest = max(coarsest, mem[finest])
    counts[RUNS] = counts[RUNS] + 1 if same else 0
    if gyro:
        steps = (s.t_ns[i] - counts[CAME_NS]) * par[RATE]
        apart = steps - np.round(steps) if 0.0 < steps < MISSING else 0.0  # else it is lost or misdated
        mem[JITTER] += par[ALPHA] * (apart * apart - mem[JITTER])
    counts[CAME_NS] = s.t_ns[i]
    counts[COUNT] += 1
    return coarsest if counts[COUNT] > RESOLUTION_SAMPLES and math.isfinite(coarsest) else 0.0


@inline
def _use(s: _Samples, i: int, finest: float) -> bool:
    """Make of a sample what rows may use, after `_measure`; whether they may."""
    par, v, columns = s.par, s.v, int(s.par[COLUMNS])
    stills = LEAPS + 3 * columns
    frozen, zero, alone = s.counts[RUNS] > par[stills], par[ZERO_IS_DEAD] > 0.5, False
    for column in range(columns):
        zero = zero and v[i, column] == 0.0
        alone = alone or s.counts[RUNS + 1 + column] > par[stills + 1 + column]
    dead = (frozen or zero) and not v[i, 0] < par[LOWEST]
    if par[GYRO] > 0.5:
        if dead or alone:
            v[i, columns] = FROZEN_CODE
        elif finest > par[MOST_STEP]:
            v[i, columns] = RESOLUTION_CODE
        elif s.mem[JITTER] > par[MOST_JITTER] ** 2:
            v[i, columns] = STAMPS_CODE
        return True
    if par[WHEN_DEAD] == UNKNOWN and (dead or alone):
        for column in range(columns):
            if dead or s.counts[RUNS + 1 + column] > par[stills + 1 + column]:
                v[i, column] = np.nan
    return not (dead and par[WHEN_DEAD] == DROPPED)


@inline
def _in_range(s: _Samples, i: int) -> bool:
    """Whether a sensor may have measured it; nan where rows may have it: some vehicles log some columns only."""
    for column in range(int(s.par[COLUMNS])):
        size = abs(s.v[i, column])
        if size > s.par[GREATEST_AT] or (size != size and s.par[FINITE_AT] > 0.5):
            return False
    return True


@jit
def _blank_if_zero(s: _Samples, i: int) -> None:
    """Unknown, if it has nothing but zeros, which no vehicle in flight has."""
    columns = int(s.par[COLUMNS])
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
    columns = int(s.par[COLUMNS])
    if s.par[GYRO] > 0.5:
        s.v[i, columns] = 0.0
    if s.par[LEARNT] > 0.5:
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
    if s.par[NEVER_ZERO_AT] > 0.5:
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
        if s.par[LEARNT] > 0.5:
            usual = -s.par[BACK] <= span_ns <= s.par[SOON] and _near(s, done, span_ns)
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
        par, memory = quality.known.get(key), memories.get(key)
        if memory is None:
            memory = memories[key] = Memory(key[1])
        series = _looked(_unlearnt(*key) if par is None else par, memory, series)
        if len(series):
            found.append(series)
    return Telemetry(tuple(found))


def _looked(par: FloatArray, memory: Memory, series: Series, trace: FloatArray = NO_TRACE) -> Series:
    """What is believed of the next samples of a signal, and of those that waited."""
    columns, before = series.values.shape[1], memory.waiting
    waited = 0 if before is None else len(before)
    count = waited + len(series)
    t_ns, host_ns = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    values = np.empty((count, columns + (series.signal is Signal.BODY_RATE)))
    if before is not None:
        t_ns[:waited], host_ns[:waited], values[:waited] = before.t_ns, before.host_ns, before.values
    t_ns[waited:], host_ns[waited:], values[waited:, :columns] = series.t_ns, series.host_ns, series.values
    samples = _Samples(par, memory.figures, memory.counts, t_ns, host_ns, values)
    kept, done, there = _look_at(samples, waited, trace)
    memory.waiting = None
    if done < there:
        rest = (array[done:there].copy() for array in (t_ns, host_ns, values))
        memory.waiting = Series(series.signal, *rest)
    return Series(series.signal, t_ns[:kept], host_ns[:kept], values[:kept])


def _departures(signal: Signal, leads: bool, values: FloatArray, t_ns: IntArray) -> FloatArray:
    """(n - 1, columns) how far each sample is from the one before, or from where the two before it lead."""
    step, span_ns = np.diff(values, axis=0), np.diff(t_ns)[:, None]
    step = _wrapped(signal, step)
    if not leads:
        return step
    slopes = np.divide(step, span_ns, out=np.zeros_like(step), where=span_ns != 0)
    first = np.full((1, values.shape[1]), np.nan)
    return _wrapped(signal, step - np.concatenate((first, slopes[:-1])) * span_ns)


def _wrapped(signal: Signal, step: FloatArray) -> FloatArray:
    """Steps, of an angle the short way round."""
    return np.asarray(step - TURN * np.round(step / TURN)) if signal in ANGLES else step


def _by_period(step: FloatArray, periods: FloatArray, leads: bool) -> FloatArray:
    """(n, columns) steps over what they may grow by in so many periods."""
    n = np.maximum(periods, 1.0)[:, None]
    return np.asarray(np.abs(step) / (n * (n + 1) / 2 if leads else n), dtype=np.float64)


def learnt_quality(flights: Iterable[tuple[Telemetry, Sequence[tuple[int, int]]]]) -> LinkQuality:
    """What healthy flights show of their link: of each its telemetry, and the spans of flight in it [ns, both ends]."""
    pieces: dict[Signal, list[Series]] = {}
    for telemetry, spans_ns in flights:
        for series in telemetry.series:
            if series.signal in LEARNT_SIGNALS:
                measured = _measurable(series)
                inside = [_between(measured, *span) for span in spans_ns]
                pieces.setdefault(series.signal, []).extend(one for one in inside if len(one) > 1)
    habits, jitter, resolution = [], 0.0, 0.0
    for signal, parts in pieces.items():
        columns = {one.values.shape[1] for one in parts}
        if len(columns) != 1:  # never flew, or another number of outputs in each flight
            continue
        habit = _moved(signal, parts)
        found = [_traced(habit, one) for one in parts]
        runs = np.concatenate(found)[:, :-2].astype(np.int64)
        share = STILL_SHARE if signal is Signal.ATTITUDE_SETPOINT else 1.0
        longest = np.quantile(runs, share, axis=0, method="higher").tolist()
        still = tuple(longest if signal in SENSORS else longest[:1])
        habits.append(habit.model_copy(update={"still": still}))
        if signal is Signal.BODY_RATE:
            jitter = max(float(trace[:, -2].max()) for trace in found)
            resolution = min((float(x) for trace in found for x in trace[-1:, -1] if x > 0), default=0.0)
    return LinkQuality(habits=tuple(habits), jitter=jitter, resolution_rad_s=resolution)


def _measurable(series: Series) -> Series:
    """Without what no sensor measures."""
    columns = series.values.shape[1]
    par = _unlearnt(series.signal, columns).copy()
    par[NEVER_ZERO_AT] = 0.0
    found = _looked(par, Memory(columns), series)
    return Series(found.signal, found.t_ns, found.host_ns, found.values[:, :columns])


def _traced(habit: Habit, series: Series) -> FloatArray:
    """What `_look_at` traces of the samples that are not lost by what the habit says of leaps."""
    columns = series.values.shape[1]
    trace = np.full((len(series), columns + 3), np.nan)
    _looked(LinkQuality(habits=(habit,)).known[series.signal, columns], Memory(columns), series, trace)
    return trace[~np.isnan(trace[:, 0])]


def _between(series: Series, first_ns: int, last_ns: int) -> Series:
    """Its samples within a span of flight, in order of time, each time once."""
    t_ns, order = np.unique(series.t_ns, return_index=True)
    order = order[(t_ns >= first_ns) & (t_ns <= last_ns)]
    return Series(series.signal, series.t_ns[order], series.host_ns[order], series.values[order])


def _moved(signal: Signal, parts: Sequence[Series]) -> Habit:
    """How a signal moved, but for how long it repeats."""
    spans_ns = np.concatenate([np.diff(one.t_ns) for one in parts])
    period_ns = float(np.median(spans_ns))
    held: list[FloatArray] = []
    led: list[FloatArray] = []
    noises, pauses = [], []
    for one in parts:
        span_ns, n = np.diff(one.t_ns), len(one)
        starts = np.unique((one.t_ns[1:] - one.t_ns[0]) // NS_PER_S, return_index=True)[1]
        counts = np.diff(starts, append=n - 1)[:, None]
        for leads, leaps in ((False, held), (True, led)):
            step = _departures(signal, leads, one.values, one.t_ns)
            step = np.nan_to_num(_by_period(step, span_ns / period_ns, leads))
            leaps.append(np.maximum.reduceat(step, starts, axis=0))
            if leaps is held:
                noises.append(np.sqrt(np.add.reduceat(np.square(step), starts, axis=0) / counts))
        pauses.append(np.maximum.reduceat(span_ns, starts))
    plain, bent = (np.quantile(np.concatenate(leaps), USUAL_SHARE, axis=0) for leaps in (held, led))
    leading = (bent < plain) & (signal not in HELD)
    quiet = QUIET_SHARE * np.quantile(np.concatenate(noises), CALM_SHARE, axis=0)
    lowest = float(np.nan_to_num(min(np.min(one.values[:, 0]) for one in parts)))
    return Habit(
        signal=signal,
        period_s=period_ns / NS_PER_S,
        pause_s=float(np.quantile(np.concatenate(pauses), USUAL_SHARE)) / NS_PER_S,
        leap=tuple(np.where(leading, bent, plain).tolist()),
        quiet=tuple(quiet.tolist()) if signal in SENSORS else (0.0,) * len(quiet),
        still=(0,),
        lowest=lowest,
        leads=tuple(leading.tolist()),
    )
