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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict

from mavdiag.rows.windows import EmaState, ema, forgetting, start_ema
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


Far: TypeAlias = tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Believed:
    """The last sample that was believed. slope: (columns,) since the one before where it leads [1/ns]; else zero."""

    values: FloatArray
    t_ns: int
    slope: FloatArray

    def followed(self, habit: Habit, values: FloatArray, t_ns: int) -> "_Believed":
        """With the next one."""
        series = np.stack((self.values, values)), np.array((self.t_ns, t_ns))
        return _Believed(values, t_ns, _slopes(habit.signal, habit.leads, *series)[0])


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What is remembered of one signal between chunks.

    count: samples so far. last: that was believed. before, before_ns: the last one that came.
    alone: its stamp leapt. far: numbers of the latest samples that leapt, and how far, in `most_leap`. runs:
    (1 + columns,) samples that repeated, together and each. jitter: mean square deviation of the stamps [periods^2].
    finest: (columns,) smallest steps.
    """

    count: int
    last: _Believed
    before: FloatArray
    before_ns: int
    alone: bool
    far: Far
    runs: IntArray
    jitter: EmaState
    finest: FloatArray
    waiting: Series | None = None


Memories: TypeAlias = Mapping[Signal, Memory]


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """What was found of the samples of one signal that were not lost.

    runs: (n, 1 + columns) how long each repeated. jitter: (n,) in periods. resolution: (n,) [unit], 0 while unknown.
    """

    series: Series
    runs: IntArray
    jitter: FloatArray
    resolution: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """keep: (n,) which samples are believed, as far as that is decided; the others as in `Memory`."""

    keep: BoolArray
    last: _Believed
    far: Far
    alone: bool


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
    near = _near(habit, memory, series)
    count = len(near.keep)
    waiting = _cut(series, slice(count, None)) if count < len(series) else None
    series, nothing = _cut(series, slice(0, count)), np.zeros(count)
    if count == 0:
        runs = np.empty((0, len(memory.runs)), dtype=np.int64)
        return replace(memory, waiting=waiting), Looked(series, runs, nothing, nothing)
    runs = _repeated(habit, memory, series.values)
    gyro = habit.signal is Signal.BODY_RATE
    state, jitter = _jitter(habit, memory, series.t_ns) if gyro else (memory.jitter, nothing)
    finest, resolution = _finest(memory, series.values) if gyro else (memory.finest, nothing)
    before, before_ns = series.values[-1], int(series.t_ns[-1])
    came = (near.last, before, before_ns, near.alone, near.far)
    after = Memory(memory.count + count, *came, runs[-1], state, finest, waiting)
    if np.count_nonzero(near.keep) == count:
        return after, Looked(series, runs, jitter, resolution)
    return after, Looked(_cut(series, near.keep), runs[near.keep], jitter[near.keep], resolution[near.keep])


def _joined(one: Series, other: Series) -> Series:
    arrays = [np.concatenate([getattr(part, name) for part in (one, other)]) for name in ("t_ns", "host_ns", "values")]
    return Series(one.signal, *arrays)


def _begin(series: Series) -> Memory:
    columns, first_ns = series.values.shape[1], int(series.t_ns[0])
    never, runs = np.full(columns, np.nan), np.zeros(1 + columns, dtype=np.int64)
    finest = np.full(columns, np.inf)
    none = _Believed(never, first_ns, never)
    return Memory(0, none, never, first_ns, False, (), runs, start_ema(np.zeros(1)), finest)


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


def _near(habit: Habit, memory: Memory, series: Series) -> _Near:
    """Which of the next samples are believed."""
    t, n, decided = series.t_ns, len(series), len(series)
    keep, last, far = np.ones(n, dtype=np.bool_), memory.last, memory.far
    values, times = np.concatenate((last.values[None], series.values)), np.concatenate(([last.t_ns], t))
    span_ns = np.diff(times)
    leaps = _sizes(habit, _departures(habit.signal, habit.leads, last.slope, values, times), span_ns) > 1.0
    candidates = np.flatnonzero(leaps | (span_ns > habit.early_ns) | (span_ns < -habit.back_ns))
    at, came_ns, alone, known = n, memory.before_ns, memory.alone, 0
    if alone or len(candidates):
        at = 0 if alone else int(candidates[0])
    while at < n:
        if at:
            came_ns = int(t[at - 1])
            if keep[at - 1]:
                last, alone = _followed(habit, last, series, keep, known, at), False
        known = at
        followed = alone and abs(int(t[at]) - came_ns) <= habit.ahead_ns
        misdated = False if followed else _misdated(habit, last.t_ns, t[at : at + 2])
        if misdated is None:  # the next sample decides
            decided = at
            break
        alone = lost = misdated
        stop = at + 1
        if not lost:
            here = _cut(series, slice(at, at + habit.patience + 1))
            found = _glitch(habit, last, here, far, memory.count + at)
            if found is None:
                decided = at
                break
            lost, run, far = found
            stop = at + run
        keep[at:stop] = not lost
        at = stop
        if not lost and keep[max(stop - 2, 0) : stop].all():  # until the next that may leap all are believed
            place = int(candidates.searchsorted(at))
            at = int(candidates[place]) if place < len(candidates) else n
    last = _followed(habit, last, series, keep, known, decided)
    return _Near(keep[:decided], last, far, alone and not keep[decided - 1] if decided else memory.alone)


def _followed(habit: Habit, last: _Believed, series: Series, keep: BoolArray, first: int, stop: int) -> _Believed:
    """The last sample that was believed, of those from `first` to `stop`; without one it is as before."""
    for at in (first + np.flatnonzero(keep[first:stop])[-2:]).tolist():
        last = last.followed(habit, series.values[at], int(series.t_ns[at]))
    return last


def _misdated(habit: Habit, last_ns: int, t_ns: IntArray) -> bool | None:
    """Whether the stamp of a sample leaps, by the last believed one and the next sample's; None if that must come."""
    span_ns = int(t_ns[0]) - last_ns
    if -habit.back_ns <= span_ns <= habit.early_ns:
        return False
    if span_ns < 0 or span_ns > habit.ahead_ns:
        return True
    if habit.signal in HELD:
        return False
    return bool(t_ns[1] < t_ns[0] - habit.back_ns) if len(t_ns) > 1 else None


def _glitch(habit: Habit, last: _Believed, series: Series, far: Far, number: int) -> tuple[bool, int, Far] | None:
    """Whether the first samples leap away and back, how many those are, and what leapt lately; None if more must come.

    series: the samples that tell. far: what leapt before. number: of the first one.
    """
    patience = habit.patience
    span_ns = series.t_ns - last.t_ns
    away = _short(habit.signal, series.values - last.values - last.slope * span_ns[:, None])
    sizes = _sizes(habit, away, span_ns)
    leaps = sizes > 1.0
    run = len(leaps) if leaps.all() else int(leaps.argmin())
    if not run:
        return False, 1, far
    far = tuple(one for one in far if one[0] > number - AMONG)
    usual = sum(size >= AS_FAR * sizes[0] for _, size in far) >= OFTEN
    if usual or habit.signal in HELD:
        lost, run = not usual, 1
    elif run > patience:
        lost, run = False, 1
    elif run == len(leaps):
        return None
    else:
        back = _short(habit.signal, away[run : run + 1] - away[run - 1])
        lost = bool(_sizes(habit, back, span_ns[run : run + 1] - span_ns[run - 1])[0] > 1.0)
    return lost, run, (*far, *((number + i, float(sizes[i])) for i in range(run)))


def _departures(
    signal: Signal, leads: Sequence[bool], slope: FloatArray, values: FloatArray, t_ns: IntArray
) -> FloatArray:
    """(n - 1, columns) how far each sample is from where those before it lead. slope: at the first."""
    step = _short(signal, values[1:] - values[:-1])
    if not any(leads):
        return step
    slopes = np.concatenate((slope[None], _slopes(signal, leads, values, t_ns)[:-1]))
    led: FloatArray = slopes * (t_ns[1:] - t_ns[:-1])[:, None]
    return _short(signal, step - led)


def _slopes(signal: Signal, leads: Sequence[bool], values: FloatArray, t_ns: IntArray) -> FloatArray:
    """(n - 1, columns) slopes between samples [1/ns], zero where they do not lead and between equal stamps."""
    span_ns, step = (t_ns[1:] - t_ns[:-1])[:, None], _short(signal, values[1:] - values[:-1])
    where = (span_ns != 0) & (np.array(leads) if leads else False)
    slopes: FloatArray = np.divide(step, span_ns, out=np.zeros_like(step), where=where)
    return slopes


def _short(signal: Signal, step: FloatArray) -> FloatArray:
    """Steps, of an angle the short way round."""
    return np.asarray(step - TURN * np.round(step / TURN)) if signal in ANGLES else step


def _sizes(habit: Habit, step: FloatArray, span_ns: IntArray) -> FloatArray:
    """(n,) how large steps are, (n, columns): above 1 they leap."""
    span_ns = np.minimum(np.abs(span_ns), habit.ahead_ns)  # a longer one is misdated, or an outage
    sizes = _by_period(step, span_ns / (habit.period_s * NS_PER_S), habit.leads) / habit.most_leap
    return np.asarray(np.fmax.reduce(sizes, axis=1), dtype=np.float64)


def _by_period(step: FloatArray, periods: FloatArray, leads: Sequence[bool]) -> FloatArray:
    """(n, columns) steps over what they may grow by in so many periods."""
    n = np.maximum(periods, 1.0)[:, None]
    return np.asarray(np.abs(step) / np.where(np.array(leads or False), n * (n + 1) / 2, n), dtype=np.float64)


def _repeated(habit: Habit, memory: Memory, values: FloatArray) -> IntArray:
    """(n, 1 + columns) for how many samples all columns, and each, have not changed."""
    before = np.concatenate((memory.before[None], values[:-1]))
    still = ~(np.abs(values - before) > np.array(habit.quiet))
    if memory.count == 0:
        still[0] = False
    still = np.column_stack((still.all(axis=1), still))
    places = np.arange(1, 1 + len(values))[:, None]
    changed = np.maximum.accumulate(np.where(still, -memory.runs, places), axis=0)
    return np.asarray(places - changed, dtype=np.int64)


def _jitter(habit: Habit, memory: Memory, t_ns: IntArray) -> tuple[EmaState, FloatArray]:
    """The rms deviation of the stamps from their grid at each sample, (n,) [periods]."""
    steps = np.diff(t_ns, prepend=memory.before_ns) / (habit.period_s * NS_PER_S)
    apart = np.where((steps > 0) & (steps < MISSING), steps - np.round(steps), 0.0)  # else it is lost or misdated
    state, mean = ema(memory.jitter, np.square(apart)[:, None], forgetting(JITTER_S, habit.period_s))
    return state, np.sqrt(mean[:, 0])


def _finest(memory: Memory, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The smallest steps so far, and the resolution at each sample, (n,), 0 while it is not known."""
    steps = np.abs(np.diff(values, axis=0, prepend=memory.before[None]))
    steps = np.where(steps > SAME, steps, np.inf)
    finest = np.minimum(np.minimum.accumulate(steps, axis=0), memory.finest)
    coarsest = finest.max(axis=1)
    known = (memory.count + np.arange(len(values)) >= RESOLUTION_SAMPLES) & np.isfinite(coarsest)
    return finest[-1], np.where(known, coarsest, 0.0)


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
        span_ns, (n, columns) = np.diff(one.t_ns), one.values.shape
        starts = np.unique((one.t_ns[1:] - one.t_ns[0]) // NS_PER_S, return_index=True)[1]
        counts = np.diff(starts, append=n - 1)[:, None]
        for leads, leaps in (((False,) * columns, held), ((True,) * columns, led)):
            step = _departures(signal, leads, np.full(columns, np.nan), one.values, one.t_ns)
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
