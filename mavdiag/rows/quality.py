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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from mavdiag.jit import cached, jit, source_digest
from mavdiag.rows.running import follow
from mavdiag.rows.savgol import SavgolFilter
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

    @property
    def most_leap(self) -> FloatArray:
        """Of each column the longest step that is believed at once; a column that never moved may do so."""
        leap = np.array(self.leap)
        if self.signal in SENSORS:
            return np.where(leap > 0, FAR * leap, np.inf)
        return np.maximum(FAR * leap, HARMLESS[self.signal])

    @cached_property
    def parameters(self) -> FloatArray:
        """See `LEAPS`."""
        signal, alpha = self.signal, forgetting(JITTER_S, self.period_s)
        spans = [self.back_ns, self.early_ns, self.ahead_ns]
        leads = self.leads or (False,) * len(self.leap)
        head = [self.period_s, alpha, signal in ANGLES, signal in HELD, self.patience, *spans]
        return np.array([*head, *self.most_leap, *leads, *self.quiet])

    @property
    def patience(self) -> int:
        """How many samples that leap may be lost."""
        return min(max(round(GLITCH_S / self.period_s), 2), MOST_LOST)

    @property
    def ahead_ns(self) -> int:
        """A stamp that is further ahead is an outlier until another follows it [ns]."""
        return round(max(REORDER_S, 3 * self.period_s, FAR * self.pause_s) * NS_PER_S)

    @property
    def back_ns(self) -> int:
        """A stamp that goes back by more is an outlier until another follows it [ns]."""
        return round(OUT_OF_ORDER * self.period_s * NS_PER_S)

    @property
    def early_ns(self) -> int:
        """The sample after one that is further ahead tells whether its stamp is an outlier [ns]."""
        return round(max(EARLY * self.period_s, self.pause_s) * NS_PER_S)

    @property
    def most_still(self) -> FloatArray:
        """For how many samples all columns together, and each of a sensor, may repeat."""
        longest = np.array(self.still, dtype=np.float64)
        most = STILL_FACTOR * longest + STILL_MORE
        most[0] = max(min(most[0], STILL_S / self.period_s), STILL_LEAST * longest[0] + STILL_MORE)
        return np.floor(most) if self.signal is not Signal.ATTITUDE_SETPOINT else longest + STILL_MORE


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

    def of(self, signal: Signal) -> Habit | None:
        """How a signal moved; None if that is not known."""
        return next((one for one in self.habits if one.signal is signal), None)


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What is remembered of one signal between chunks (`_look`). waiting: samples that later ones decide on."""

    figures: FloatArray
    counts: IntArray
    waiting: Series | None = None


Memories: TypeAlias = Mapping[Signal, Memory]


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """What was found of the samples of one signal that were not lost.

    runs: (n, 1 + columns) how long each repeated. Of the gyro jitter: (n,) in periods. resolution: (n,) [unit], 0 while
    unknown.
    """

    series: Series
    runs: NDArray[np.int32]
    jitter: FloatArray
    resolution: FloatArray


# Places in the parameters of a signal: period [s]; forgetting of the jitter; whether its columns are angles, and hold
# their last value; how many samples may be lost; spans of stamps back, early and ahead [ns]; of each column the longest
# leap, whether its slope leads, and what is silent.
PERIOD, ALPHA, ANGLE, HOLDS, PATIENCE, BACK, EARLY_NS, AHEAD, LEAPS = range(9)
# Places in the figures: jitter, and how far the latest samples leapt; then of each column the last believed value, its
# slope [1/ns], the value that came last, and the smallest step. In the counts: samples so far; stamps of the last one
# that was believed, and that came [ns]; whether its stamp leapt; how many leapt lately, and their numbers; repetitions.
JITTER, SIZES, COLUMN = 0, 1, 1 + AMONG + MOST_LOST + 1
COUNT, LAST_NS, CAME_NS, ALONE, FAR_COUNT, NUMBERS = range(6)
RUNS = NUMBERS + AMONG + MOST_LOST + 1


@jit
def _short(par: FloatArray, step: float) -> float:
    """A step; of an angle the short way round."""
    return float(step - TURN * np.round(step / TURN)) if par[ANGLE] > 0.5 else step


@jit
def _away(par: FloatArray, mem: FloatArray, columns: int, column: int, value: float, span_ns: int) -> float:
    """How far a value is from where those before it lead."""
    at = COLUMN + column
    return _short(par, value - mem[at] - mem[at + columns] * span_ns)


@jit
def _size(par: FloatArray, columns: int, column: int, away: float, span_ns: int) -> float:
    """How large that is for the time: above 1 it leaps; nan where it is not known."""
    n = max(min(abs(span_ns), par[AHEAD]) / (par[PERIOD] * NS_PER_S), 1.0)
    grown = n * (n + 1.0) / 2.0 if par[LEAPS + columns + column] > 0.5 else n
    return float(abs(away) / grown / par[LEAPS + column])


@jit
def _leap(par: FloatArray, mem: FloatArray, counts: IntArray, t_ns: IntArray, v: FloatArray, i: int) -> float:
    """The largest of all columns of a sample."""
    found, columns, span_ns = 0.0, v.shape[1], t_ns[i] - counts[LAST_NS]
    for column in range(columns):
        size = _size(par, columns, column, _away(par, mem, columns, column, v[i, column], span_ns), span_ns)
        found = max(found, size) if size == size else found
    return found


@jit
def _misdated(par: FloatArray, counts: IntArray, t_ns: IntArray, i: int) -> int:
    """1 if the stamp of a sample leaps by the last believed and the next one, 0 if not; -1 if the next must come."""
    span_ns = t_ns[i] - counts[LAST_NS]
    if -par[BACK] <= span_ns <= par[EARLY_NS]:
        return 0
    if span_ns < 0 or span_ns > par[AHEAD]:
        return 1
    if par[HOLDS] > 0.5:
        return 0
    if i + 1 == len(t_ns):
        return -1
    return 1 if t_ns[i + 1] < t_ns[i] - par[BACK] else 0


@jit
def _decide(
    par: FloatArray, mem: FloatArray, counts: IntArray, t_ns: IntArray, v: FloatArray, i: int
) -> tuple[int, bool]:
    """How many samples from i on are decided, 0 if more must come; whether they are lost: they leap away and back."""
    patience, number, columns = int(par[PATIENCE]), counts[COUNT] + i, v.shape[1]
    first = _leap(par, mem, counts, t_ns, v, i)
    if not first > 1.0:
        return 1, False
    kept, often = 0, 0
    for k in range(counts[FAR_COUNT]):
        if counts[NUMBERS + k] > number - AMONG:
            counts[NUMBERS + kept], mem[SIZES + kept] = counts[NUMBERS + k], mem[SIZES + k]
            often += mem[SIZES + kept] >= AS_FAR * first
            kept += 1
    counts[FAR_COUNT] = kept
    run, there = 1, min(patience + 1, len(t_ns) - i)
    while run < there and _leap(par, mem, counts, t_ns, v, i + run) > 1.0:
        run += 1
    usual, lost = often >= OFTEN, False
    if usual or par[HOLDS] > 0.5:
        lost, run = not usual, 1
    elif run > patience:
        run = 1
    elif run == there:
        return 0, False
    else:
        here, before = i + run, i + run - 1
        for column in range(columns):
            one = _away(par, mem, columns, column, v[here, column], t_ns[here] - counts[LAST_NS])
            other = _away(par, mem, columns, column, v[before, column], t_ns[before] - counts[LAST_NS])
            lost = lost or _size(par, columns, column, _short(par, one - other), t_ns[here] - t_ns[before]) > 1.0
    for k in range(run):
        counts[NUMBERS + kept + k] = number + k
        mem[SIZES + kept + k] = _leap(par, mem, counts, t_ns, v, i + k)
    counts[FAR_COUNT] = kept + run
    return run, lost


@jit
def _believe(par: FloatArray, mem: FloatArray, counts: IntArray, t_ns: IntArray, v: FloatArray, i: int) -> None:
    """Make a sample the last one that is believed."""
    columns, span_ns = v.shape[1], t_ns[i] - counts[LAST_NS]
    for column in range(columns):
        at, leads = COLUMN + column, par[LEAPS + columns + column] > 0.5
        mem[at + columns] = _short(par, v[i, column] - mem[at]) / span_ns if leads and span_ns != 0 else 0.0
        mem[at] = v[i, column]
    counts[LAST_NS] = t_ns[i]


@jit
def _measure(
    par: FloatArray, mem: FloatArray, counts: IntArray, stamp_ns: int, v: FloatArray, i: int, runs: NDArray[np.int32]
) -> float:
    """Count repetitions, and follow jitter and finest step, after a sample; returns the resolution, 0 if unknown."""
    columns, same, coarsest = v.shape[1], True, 0.0
    for column in range(columns):
        came, finest = COLUMN + 2 * columns + column, COLUMN + 3 * columns + column
        step = abs(v[i, column] - mem[came])
        still = not step > par[LEAPS + 2 * columns + column] and counts[COUNT] > 0
        same = same and still
        counts[RUNS + 1 + column] = counts[RUNS + 1 + column] + 1 if still else 0
        runs[i, 1 + column] = counts[RUNS + 1 + column]
        mem[came], mem[finest] = v[i, column], min(mem[finest], step) if step > SAME else mem[finest]
        coarsest = max(coarsest, mem[finest])
    counts[RUNS] = counts[RUNS] + 1 if same else 0
    runs[i, 0] = counts[RUNS]
    steps = (stamp_ns - counts[CAME_NS]) / (par[PERIOD] * NS_PER_S)
    apart = steps - np.round(steps) if 0.0 < steps < MISSING else 0.0  # else it is lost or misdated
    follow(mem, JITTER, apart * apart, par[ALPHA])
    counts[CAME_NS] = stamp_ns
    counts[COUNT] += 1
    return coarsest if counts[COUNT] > RESOLUTION_SAMPLES and math.isfinite(coarsest) else 0.0


def _compiled(digest: int) -> Callable[..., int]:
    @cached
    def look_at(
        par: FloatArray,
        mem: FloatArray,
        counts: IntArray,
        t_ns: IntArray,
        v: FloatArray,
        keep: BoolArray,
        runs: NDArray[np.int32],
        jitter: FloatArray,
        resolution: FloatArray,
    ) -> int:
        """Which samples are believed, (n,), and what `Looked` says of each; returns how many are decided."""
        i = 0
        while i < (len(t_ns) if digest else 0):
            came_ns = t_ns[i - 1] if i else counts[CAME_NS]
            followed = counts[ALONE] > 0 and abs(t_ns[i] - came_ns) <= par[AHEAD]
            misdated = 0 if followed else _misdated(par, counts, t_ns, i)
            if misdated < 0:
                break
            run, lost = 1, misdated > 0
            counts[ALONE] = misdated
            if not lost:
                run, lost = _decide(par, mem, counts, t_ns, v, i)
                if run == 0:
                    break
            for k in range(i, i + run):
                keep[k] = not lost
                if not lost:
                    _believe(par, mem, counts, t_ns, v, k)
            i += run
        for k in range(i):
            finest = _measure(par, mem, counts, t_ns[k], v, k, runs)
            if len(jitter):
                resolution[k], jitter[k] = finest, math.sqrt(mem[JITTER])
        return i

    return look_at


_look_at = _compiled(source_digest())


def believed(quality: LinkQuality, memories: Memories, telemetry: Telemetry) -> tuple[dict[Signal, Memory], Telemetry]:
    """The telemetry without its lost samples, nan where it is dead; the gyro with a fourth column, `Doubt` as a number.

    The number is the place in `DOUBTS`.
    """
    after, found = dict(memories), []
    for series in telemetry.series:
        series = _in_range(series)
        habit = quality.of(series.signal)
        if habit is not None and len(series) and series.values.shape[1] == len(habit.leap):
            after[series.signal], looked = look(habit, after.get(series.signal), series)
            series = _known(quality, habit, looked)
        elif series.signal is Signal.BODY_RATE:
            series = _with(series, np.hstack((series.values, np.zeros((len(series), 1)))))
        if len(series):
            found.append(_alive(series))
    return after, Telemetry(tuple(found))


def differences(quality: LinkQuality, jitter: FloatArray, resolution: FloatArray) -> Iterator[tuple[Doubt, BoolArray]]:
    """In what, and at which samples, a measured link is not that of the healthy flights.

    jitter: (n,) [share of a period]. resolution: (n,) of the gyro [rad/s], 0 where it is not known.
    """
    gyro = quality.of(Signal.BODY_RATE)
    if gyro is not None:
        most = max(JITTER_FACTOR * quality.jitter, LEAST_JITTER)
        yield Doubt.STAMPS, np.asarray(jitter > most, dtype=np.bool_)
        noise = RESOLUTION_NOISE / QUIET_SHARE * min(gyro.quiet)
        yield (
            Doubt.RESOLUTION,
            np.asarray(resolution > max(RESOLUTION_FACTOR * quality.resolution_rad_s, noise), dtype=np.bool_),
        )


def look(habit: Habit, memory: Memory | None, series: Series) -> tuple[Memory, Looked]:
    """Leave out what is lost of the next samples of a signal, and measure the others. Its columns are the habit's."""
    memory = memory or _begin(series)
    if memory.waiting is not None:
        series = _joined(memory.waiting, series)
    n, columns = series.values.shape
    figures, counts, keep = memory.figures.copy(), memory.counts.copy(), np.empty(n, dtype=np.bool_)
    measured = n if habit.signal is Signal.BODY_RATE else 0
    runs, jitter, resolution = np.empty((n, 1 + columns), dtype=np.int32), np.empty(measured), np.empty(measured)
    found = (keep, runs, jitter, resolution)
    # one kind of array, for one compilation
    t_ns, values = (np.require(array, requirements=("C", "W")) for array in (series.t_ns, series.values))
    done = _look_at(habit.parameters, figures, counts, t_ns, values, *found)
    after = Memory(figures, counts, _cut(series, slice(done, None)) if done < n else None)
    keep[done:] = False
    used = slice(0, done) if np.count_nonzero(keep) == done else keep
    figures_used = used if measured else slice(0, 0)
    return after, Looked(_cut(series, used), runs[used], jitter[figures_used], resolution[figures_used])


def warm() -> None:
    """Compile what looks at samples and filters rows, or load it from where it is kept."""
    never, values = np.empty(0, dtype=np.int64), np.empty((0, 1))
    none = np.empty((0, 2), dtype=np.int32)
    counts, figures = np.zeros(RUNS + 2, dtype=np.int64), np.zeros(COLUMN + 4)
    _look_at(np.zeros(LEAPS + 3), figures, counts, never, values, np.empty(0, dtype=np.bool_), none, *np.empty((2, 0)))
    SavgolFilter.smoother(5).batch(np.zeros(8))


def _joined(one: Series, other: Series) -> Series:
    arrays = [np.concatenate([getattr(part, name) for part in (one, other)]) for name in ("t_ns", "host_ns", "values")]
    return Series(one.signal, *arrays)


def _begin(series: Series) -> Memory:
    columns = series.values.shape[1]
    figures, counts = np.zeros(COLUMN + 4 * columns), np.zeros(RUNS + 1 + columns, dtype=np.int64)
    figures[COLUMN : COLUMN + 3 * columns], figures[COLUMN + 3 * columns :] = np.nan, np.inf
    counts[LAST_NS] = counts[CAME_NS] = series.t_ns[0]
    return Memory(figures, counts)


def _with(series: Series, values: FloatArray) -> Series:
    return Series(series.signal, series.t_ns, series.host_ns, values)


def _cut(series: Series, keep: BoolArray | slice) -> Series:
    return Series(series.signal, series.t_ns[keep], series.host_ns[keep], series.values[keep])


def _in_range(series: Series) -> Series:
    """Without what no sensor measures; nan stays where rows may have it: some vehicles log some columns only."""
    greatest = GREATEST.get(series.signal, GREATEST_SHARE if series.signal in LEARNT else np.inf)
    size = np.abs(series.values)
    if len(series) == 0 or np.maximum.reduce(size, axis=None) <= greatest:
        return series
    lost = ~(size <= greatest) if series.signal in FINITE else size > greatest
    return _cut(series, np.asarray(~lost.any(axis=1), dtype=np.bool_))


def _alive(series: Series) -> Series:
    """With nan for zeros that no vehicle in flight has."""
    if series.signal not in NEVER_ZERO:
        return series
    dead = ~((series.values != 0.0) & np.isfinite(series.values)).any(axis=1)
    if not np.count_nonzero(dead):
        return series
    return _with(series, np.where(dead[:, None], np.nan, series.values))


def _known(quality: LinkQuality, habit: Habit, looked: Looked) -> Series:
    """The samples as rows may use them."""
    series, values = looked.series, looked.series.values
    most = habit.most_still
    dead = looked.runs[:, : len(most)] > most
    if habit.signal in ANGLES and any(habit.leap):  # no vehicle that flies has all of them at zero
        dead |= np.all(values == 0.0, axis=1, keepdims=True)
    if habit.signal is Signal.THRUST_SETPOINT:  # below it the vehicle stands, and nothing moves
        dead &= values[:, :1] >= habit.lowest
    if habit.signal is Signal.BODY_RATE:
        codes = np.zeros(len(series))
        for doubt, where in differences(quality, looked.jitter, looked.resolution):
            codes[where] = DOUBTS.index(doubt)
        codes[dead.any(axis=1)] = DOUBTS.index(Doubt.FROZEN)
        return _with(series, np.column_stack((values, codes)))
    if habit.signal in MAY_REST or not np.count_nonzero(dead):
        return series
    if habit.signal in ANGLES:
        return _cut(series, ~dead[:, 0])
    spoilt = dead[:, :1] | dead[:, 1:] if dead.shape[1] > 1 else dead
    return _with(series, np.where(spoilt, np.nan, values))


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
            if series.signal in LEARNT:
                inside = [_between(_in_range(series), *span) for span in spans_ns]
                pieces.setdefault(series.signal, []).extend(one for one in inside if len(one) > 1)
    habits, jitter, resolution = [], 0.0, 0.0
    for signal, parts in pieces.items():
        columns = {one.values.shape[1] for one in parts}
        if len(columns) != 1:  # never flew, or another number of outputs in each flight
            continue
        habit = _moved(signal, parts)
        found = [look(habit, None, one)[1] for one in parts]
        runs = np.concatenate([one.runs for one in found])
        share = STILL_SHARE if signal is Signal.ATTITUDE_SETPOINT else 1.0
        longest = np.quantile(runs, share, axis=0, method="higher").tolist()
        still = tuple(longest if signal in SENSORS else longest[:1])
        habits.append(habit.model_copy(update={"still": still}))
        if signal is Signal.BODY_RATE:
            jitter = max(float(one.jitter.max()) for one in found)
            resolution = min((float(x) for one in found for x in one.resolution[-1:] if x > 0), default=0.0)
    return LinkQuality(habits=tuple(habits), jitter=jitter, resolution_rad_s=resolution)


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
