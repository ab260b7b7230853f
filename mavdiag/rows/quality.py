"""Which samples of a link are believed, and how good the link is, by what its healthy flights showed.

A sample is *lost* if it is no number, is beyond what any sensor measures, or leaps:

    leap_i = |x_i - x_last - c (t_i - t_last)| / n > most,    n = max(1, |t_i - t_last|/T)          in some column

x_last is the last believed sample, T the usual period, `most` twice the healthy leap or a small one; c the slope of
the two samples believed last where the healthy signal leaps less by it (n (n + 1)/2 then stands for n), else 0. What
leaps waits: if it leaps back within 3 samples (2 at 50 Hz and below) it was a glitch; else, or if 5 of the 20 before
leapt half as far, it is how the signal moves. What holds its last value does not wait. A stamp that leaps is lost until
one follows, at the pace of the stream as it is now, for a ground station may have slowed it; but of outputs and rotor
speeds, in which a monitor sees more than there is where they come more seldom than it learnt, at the healthy pace.

A sample is *dead* if it repeats the one before for much longer than ever in health (gyro and accelerometer: each axis,
within a twentieth of the quietest noise), and at once if all zero where no vehicle reads so. Then it is unknown. The
gyro is *doubted* (`Doubt`) where it is dead, its stamps scatter or its resolution is coarser than in health: rows keep
it, and say why. Stamps scatter where the sum S_i = max(0, S_(i-1) + e_i^2 - k) passes `UNEVEN`, until it has fallen by
as much again; e_i: how far a step is off a whole number of periods [periods], k: what is allowed of e^2 (E. S. Page,
Biometrika 41, 1954). Samples are looked at in order of arrival, so that a log and a live link believe the same ones.
"""

import math
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mavdiag.jit import cached_loop, inline, jit
from mavdiag.rows.grid import median_step
from mavdiag.rows.windows import forgetting
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

FAR = 2.0  # healthy leaps; a longer one is a glitch until it is seen again: it hardly shows in a mean (our choice)
GLITCH_S, MOST_LOST = 0.03, 3  # an I2C glitch spoils up to three samples, and two may be struck (our choice)
AMONG, OFTEN, AS_FAR = 20, 5, 0.5  # so many of the last samples that leapt so far are no glitches (our choice)
OUT_OF_ORDER = 1.5  # periods back: two samples of a slow stream that changed places are in order (our choice)
USUAL_SHARE = 0.95  # quantile of the largest leaps of the seconds of healthy flight (our choice: glitches are rarer)
STILL_SHARE = 0.999  # quantile of the repetitions of the attitude's set-point that is the longest (our choice)
STILL_FACTOR, STILL_MORE = 4.0, 2  # of the longest healthy repetition, and samples more (our choice)
STILL_S, STILL_LEAST = 0.8, 1.5  # no longer than this, but by so much longer than in health (our choice)
QUIET_SHARE = 0.05  # of the healthy noise: 26 dB below it (our choice)
CALM_SHARE = 0.1  # the quantile of the noise of the seconds of healthy flight that is its quietest (our choice)
JITTER_S = 5.0  # memory of the jitter that is learnt: one wrong stamp in it is none (our choice)
MISSING = 2.5  # periods: a longer step says nothing of jitter (our choice)
JITTER_FACTOR, LEAST_JITTER = 1.5, 0.05  # of the healthy one, and of a period, which no monitor notices (our choice)
UNEVEN = 1.0  # periods^2: two stamps, with two steps each, half a period off are borne, three are not (our choice)
RESOLUTION_FACTOR = 1.5  # of the healthy one: 2 mrad/s in place of 1 is another sensor or link (our choice)
RESOLUTION_NOISE = 0.25  # of the rms step: a finer resolution than this is hidden by the noise (our choice)
RESOLUTION_SAMPLES = 200  # before it is judged: the finest of so many steps of noise is far below that
SAME = 1e-6  # rad/s: rounding of a conversion, no step
SLOWEST_NS = 2 * NS_PER_S  # twice the step of a stream that is slower than in health, at most (our choice)
REORDER_S = 0.05  # by so much rows wait for samples; a stamp that leaps farther must be followed by others (our choice)

# Greatest size that a sensor of a small vehicle measures (gyros end at 70 rad/s, accelerometers at 3900 m/s^2; commands
# and outputs at 1), and a leap that is believed at any rate, for flights may be livelier than these (our choice).
RANGES = {
    Signal.BODY_RATE: (100.0, 0.0),
    Signal.SPECIFIC_FORCE: (4000.0, 0.0),
    Signal.ATTITUDE: (1e4, 0.02),
    Signal.ATTITUDE_SETPOINT: (1e4, 0.0005),  # three steps of a log in 0.01 deg; within 0.1 s a rate of 0.005 rad/s
    Signal.RATE_SETPOINT: (1e3, 0.1),
    Signal.VIBRATION: (4000.0, 1.0),
    Signal.HEIGHT: (1e5, 0.5),
    Signal.TORQUE_COMMAND: (10.0, 0.1),
    Signal.THRUST_SETPOINT: (10.0, 0.2),
    Signal.ACTUATOR: (10.0, 0.05),
    Signal.ROTOR_SPEED: (math.inf, math.inf),  # the monitor bears wild frames itself
}
ANGLES = (Signal.ATTITUDE, Signal.ATTITUDE_SETPOINT)
# Never silent, and each axis or rotor has a sensor of its own.
SENSORS = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ROTOR_SPEED)
NEVER_ZERO = (Signal.SPECIFIC_FORCE, Signal.ACTUATOR)  # of a vehicle that flies
# Their last value holds, so that rows do not wait for the next one: what leaps is lost at once.
HELD = (Signal.THRUST_SETPOINT, Signal.HEIGHT, Signal.VIBRATION, Signal.ACTUATOR, Signal.ROTOR_SPEED)
MAY_REST = (Signal.HEIGHT,)  # may stay as it is for as long as it likes
PACED = (Signal.ACTUATOR, Signal.ROTOR_SPEED)  # not used where they come more seldom than in health
FINITE = (Signal.BODY_RATE, *ANGLES)  # rows read them without nan: a sample that is no number is lost
TURN = 2 * np.pi


class Doubt(StrEnum):
    """Why rows must not be judged though the gyro is there."""

    FROZEN = "gyro repeats one value"
    STAMPS = "uneven time stamps"
    RESOLUTION = "gyro resolution"
    THRUST = "thrust was lost"


DOUBTS = (None, *Doubt)  # by the code that rows carry
NotNegative: TypeAlias = Annotated[float, Field(ge=0, lt=1e100)]  # its square is finite


class Habit(BaseModel):
    """How one signal moved in healthy flight.

    period_s: its usual period [s]. pause_s: the longest one of an ordinary second [s].
    leap: of each column the largest leap of an ordinary second, before `most` divides it [unit of the signal].
    quiet: of each column the step below which it is silent; 0 where only equal values are.
    still: longest repetition [samples] of all columns together; of gyro and accelerometer also of each one.
    lowest: least value of the first column in flight.
    leads: of each column whether its slope tells where the next sample is to be; empty if none does.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    signal: Signal
    period_s: Annotated[float, Field(gt=0, le=3600)]
    pause_s: Annotated[float, Field(ge=0, le=3600)]
    leap: Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    quiet: Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    still: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]
    lowest: float
    leads: tuple[bool, ...] = ()

    def limits(self, taken: Sequence[int]) -> list[float]:
        """Longest leap, whether it leads, step of silence, longest repetition: of each column; the last also of all.

        taken: these columns; nothing is known of those that there are not.
        """
        (whole, *each), columns, least = self.still, len(self.leap), RANGES[self.signal][1]
        unmoved = math.inf if self.signal in SENSORS else least  # an axis that never moved may do so
        leap = [max(FAR * one, least) if one > 0 else unmoved for one in self.leap]
        if self.signal is Signal.ATTITUDE_SETPOINT:
            longest = float(whole + STILL_MORE)
        else:
            most = min(STILL_FACTOR * whole + STILL_MORE, STILL_S / self.period_s)
            longest = float(math.floor(max(most, STILL_LEAST * whole + STILL_MORE)))
        alone = [float(math.floor(STILL_FACTOR * one + STILL_MORE)) for one in each]
        tables = leap, self.leads, self.quiet, alone
        unknown = math.inf, 0.0, 0.0, math.inf
        found = [
            float(table[at]) if at < len(table) else none
            for table, none in zip(tables, unknown, strict=True)
            for at in (min(one, columns) for one in taken)
        ]
        return [*found, longest]


class LinkQuality(BaseModel):
    """What healthy flights showed of a link; without habits nothing is known of it, and nothing compared.

    jitter: highest rms of 5 s of the time stamps of the gyro about their grid [share of a period].
    resolution_rad_s: smallest step of the gyro, of its coarsest axis [rad/s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    habits: tuple[Habit, ...] = ()
    jitter: NotNegative = 0.0
    resolution_rad_s: NotNegative = 0.0

    def rule(self, signal: Signal, columns: int, taken: Sequence[int] | None = None) -> FloatArray:
        """What is believed of a signal: `GYRO` and its fellows, then `Habit.limits`; 0 where nothing was learnt.

        columns: that it has. taken: those that are looked at, None for all.
        """
        taken = range(columns) if taken is None else taken
        rule = np.zeros(LEAP + 4 * len(taken) + 1)
        kinds = (ANGLES, HELD, FINITE, NEVER_ZERO, MAY_REST, PACED)
        rule[GYRO : KEEPS_PACE + 1] = signal is Signal.BODY_RATE, *(signal in kind for kind in kinds)
        rule[GREATEST] = RANGES.get(signal, (math.inf, 0.0))[0]
        habit = next((one for one in self.habits if (one.signal, len(one.leap)) == (signal, columns)), None)
        if habit is not None:
            period_s, pause_s, quietest = habit.period_s, habit.pause_s, min(habit.quiet)
            rule[LEARNT:LEAP] = (
                1.0,
                period_s * NS_PER_S,
                min(max(round(GLITCH_S / period_s), 2), MOST_LOST),
                round(max(REORDER_S, OUT_OF_ORDER * period_s) * NS_PER_S),
                round(max(REORDER_S, 3 * period_s, FAR * pause_s) * NS_PER_S),
                signal in ANGLES and any(habit.leap),
                habit.lowest if signal is Signal.THRUST_SETPOINT else -math.inf,
                max(JITTER_FACTOR * self.jitter, LEAST_JITTER) ** 2,
                max(RESOLUTION_FACTOR * self.resolution_rad_s, RESOLUTION_NOISE / QUIET_SHARE * quietest),
                any(habit.leads),
            )
            rule[LEAP:] = habit.limits(taken)
        return rule


# Places in a rule: what the signal is: of the gyro, an angle, one whose last value holds, one that must be a number,
# never zero in flight, may rest, keeps its pace; its range; whether more is known of it: its period [ns], how many
# samples that leap may be lost, spans of stamps [ns], whether zeros are dead, below which value nothing moves, variance
# of the jitter that is allowed and step beyond which the gyro is doubted, whether a column leads.
GYRO, ANGLE, HOLDS, MUST_BE_FINITE, NOT_ZERO, RESTS, KEEPS_PACE, GREATEST = range(8)
LEARNT, PERIOD, PATIENCE, BACK, AHEAD, ZERO_IS_DEAD, LOWEST, MOST_JITTER, MOST_STEP, LEADING = range(8, 18)
LEAP = 18
# Places in the figures: scatter of the stamps, and how far the latest samples leapt; then of each column the last
# believed value, its slope [1/ns], the value that came last, and the smallest step. In the counts: samples so far;
# stamps of the last one that was believed, and that came [ns]; the step to the latter, 0 if it goes back [ns]; whether
# its stamp leapt; how many leapt lately; samples not lost; numbers of those that leapt; repetitions.
SCATTER, SIZES, COLUMN = 0, 1, 1 + AMONG + MOST_LOST + 1
COUNT, LAST_NS, CAME_NS, STEP_NS, ALONE, FAR_COUNT, TRACED, NUMBERS = range(8)
RUNS = NUMBERS + AMONG + MOST_LOST + 1
STAMPS_CODE, RESOLUTION_CODE, FROZEN_CODE = (
    DOUBTS.index(one) for one in (Doubt.STAMPS, Doubt.RESOLUTION, Doubt.FROZEN)
)
PIECE = 1 << 16  # samples that learning looks at together
TOGETHER = 64  # samples of the usual case that are looked at together


class Memory:
    """What is remembered of one signal between pieces; changed in place. waiting: samples that later ones decide on."""

    def __init__(self, columns: int) -> None:
        self.figures, self.counts = np.zeros(COLUMN + 4 * columns), np.zeros(RUNS + 1 + columns, dtype=np.int64)
        self.waiting: Series | None = None


class Samples(NamedTuple):
    """Rule and memory of a signal, and its samples: (n,) times of vehicle and receiver, (columns, ..) values.

    The values of the samples are those from place `at` on. The gyro has a column more, for `Doubt` as a number.
    """

    columns: int
    rule: FloatArray
    mem: FloatArray
    counts: IntArray
    t_ns: IntArray
    host_ns: IntArray
    v: FloatArray
    at: int


@inline
def _short(s: Samples, step: float) -> float:
    if s.rule[ANGLE] == 0.0 or abs(step) <= math.pi:
        return step
    return float(step - TURN * np.round(step / TURN))


@inline
def _away(s: Samples, column: int, value: float, span_ns: int) -> float:
    at = COLUMN + column
    return _short(s, value - s.mem[at] - s.mem[at + s.columns] * span_ns)


@inline
def _ahead(s: Samples) -> float:
    """How far a sample may be ahead of the one before and still follow it [ns]."""
    return float(max(s.rule[AHEAD], 0.0 if s.rule[KEEPS_PACE] else min(FAR * s.counts[STEP_NS], SLOWEST_NS)))


@jit
def _size(s: Samples, column: int, away: float, span_ns: int) -> float:
    """How large that is for the time: above 1 it leaps; nan where it is not known."""
    n = max(min(abs(span_ns), _ahead(s)) / s.rule[PERIOD], 1.0)
    grown = n * (n + 1.0) / 2.0 if s.rule[LEAP + s.columns + column] else n
    return float(abs(away) / grown / s.rule[LEAP + column])


@jit
def _leap(s: Samples, i: int) -> float:
    found, span_ns = 0.0, s.t_ns[i] - s.counts[LAST_NS]
    for column in range(s.columns):
        size = _size(s, column, _away(s, column, s.v[column, s.at + i], span_ns), span_ns)
        found = max(found, size) if size == size else found
    return found


@jit
def _plain(s: Samples, first: int, stop: int) -> int:
    """Up to where no sample leaps and rows use each as it came: the usual case, looked at column by column."""
    rule, mem, counts, columns, t_ns = s.rule, s.mem, s.counts, s.columns, s.t_ns
    scatter, shown, frozen, gyro = mem[SCATTER], False, rule[LEAP + 4 * columns], rule[GYRO] > 0.0
    for i in range(first, stop):
        if gyro:
            scatter = _scattered(s, scatter, t_ns[i] - (t_ns[i - 1] if i > first else counts[CAME_NS]))
        span_ns = t_ns[i] - (t_ns[i - 1] if i > first else counts[LAST_NS])
        if not -rule[BACK] <= span_ns <= rule[AHEAD] or scatter > UNEVEN:
            stop = i
            break
    for column in range(columns):
        at, run, before_ns, moves = COLUMN + column, float(counts[RUNS + 1 + column]), counts[LAST_NS], True
        last, slope, came = mem[at], mem[at + columns], mem[at + 2 * columns]
        leap, leads, quiet = rule[LEAP + column], rule[LEAP + columns + column], rule[LEAP + 2 * columns + column]
        alone, may_rest = rule[LEAP + 3 * columns + column], rule[ZERO_IS_DEAD] + rule[NOT_ZERO] == 0.0
        if gyro and not mem[at + 3 * columns] <= rule[MOST_STEP]:
            return first
        row, longest = s.v[column, s.at :], 0.0
        for i in range(first, stop):
            value, span_ns = row[i], t_ns[i] - before_ns
            run = run + 1.0 if not abs(value - came) > quiet else 0.0
            if (run > alone and value == value) or abs(_short(s, value - last - slope * span_ns)) > leap:
                stop = i
                break
            slope = _short(s, value - last) * (1.0 / span_ns) if leads and span_ns != 0 else 0.0
            longest, moves = max(longest, run), moves & (value != 0.0) & math.isfinite(value)
            last, came, before_ns = value, value, t_ns[i]
        moves = longest <= frozen and (may_rest or moves)
        shown = shown or moves
    return stop if shown else first


@jit
def _misdated(s: Samples, i: int) -> bool:
    """Whether the stamp of a sample leaps, by the last believed one and the one before."""
    ahead_ns = _ahead(s)
    followed = s.counts[ALONE] > 0 and abs(s.t_ns[i] - s.counts[CAME_NS]) <= ahead_ns
    return not (followed or -s.rule[BACK] <= s.t_ns[i] - s.counts[LAST_NS] <= ahead_ns)


@jit
def _decide(s: Samples, there: int, i: int) -> tuple[int, bool]:
    """How many samples from i on are decided, 0 if more must come; whether they are lost: they leap away and back."""
    patience, number, last_ns = int(s.rule[PATIENCE]), s.counts[COUNT], s.counts[LAST_NS]
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
    if usual or s.rule[HOLDS]:
        lost, run = not usual, 1
    elif run > patience:
        run = 1
    elif run == left:
        return 0, False
    else:
        here, before = i + run, i + run - 1
        for column in range(s.columns):
            one = _away(s, column, s.v[column, s.at + here], s.t_ns[here] - last_ns)
            other = _away(s, column, s.v[column, s.at + before], s.t_ns[before] - last_ns)
            back, span_ns = _short(s, one - other), s.t_ns[here] - s.t_ns[before]
            lost = lost or (back * other < 0.0 and _size(s, column, back, span_ns) > 1.0)
    for k in range(run):
        s.counts[NUMBERS + kept + k] = number + k
        s.mem[SIZES + kept + k] = _leap(s, i + k)
    s.counts[FAR_COUNT] = kept + run
    return run, lost


@inline
def _scattered(s: Samples, scatter: float, span_ns: int) -> float:
    """The sum of `UNEVEN` after the next step; one that is lost or misdated does not count."""
    steps = span_ns / s.rule[PERIOD]
    apart = steps - np.round(steps) if 0.0 < steps < MISSING else 0.0
    after = min(max(0.0, scatter + apart * apart - s.rule[MOST_JITTER]), 2.0 * UNEVEN)
    return 2.0 * UNEVEN if scatter <= UNEVEN < after else after


@jit
def _believe(s: Samples, first: int, stop: int) -> None:
    i, several = stop - 1, stop - 1 > first
    span_ns = s.t_ns[i] - (s.t_ns[i - 1] if several else s.counts[LAST_NS])
    share = 1.0 / span_ns if span_ns != 0 and s.rule[LEADING] else 0.0
    for column in range(s.columns):
        at, leads = COLUMN + column, share != 0.0 and s.rule[LEAP + s.columns + column]
        before, value = s.v[column, s.at + i - 1] if several else s.mem[at], s.v[column, s.at + i]
        s.mem[at + s.columns], s.mem[at] = _short(s, value - before) * share if leads else 0.0, value
    s.counts[LAST_NS] = s.t_ns[i]


@jit
def _measure(s: Samples, first: int, stop: int, seen: FloatArray, runs: IntArray) -> float:
    """Count repetitions after some samples, and of the gyro follow stamps and finest step; returns the resolution.

    seen, runs: as in `look_at`, or empty.
    """
    mem, counts, columns, gyro, knows = s.mem, s.counts, s.columns, s.rule[GYRO] > 0.0, s.counts[COUNT] > 0
    coarsest, before_ns, same = 0.0, counts[CAME_NS], 1 << 62
    noted, traced = len(seen) > 0, runs[counts[TRACED] :]
    for column in range(columns):
        at, run, longest = COLUMN + 2 * columns + column, counts[RUNS + 1 + column], 0
        came, finest, quiet, row = mem[at], mem[at + columns], s.rule[LEAP + 2 * columns + column], s.v[column, s.at :]
        for i in range(first, stop):
            step, came = abs(row[i] - came), row[i]
            run = run + 1 if knows and not step > quiet else 0
            if gyro:
                finest = min(finest, step) if step > SAME else finest
            if noted:
                longest, traced[i - first] = max(longest, run), run if column == 0 else min(traced[i - first], run)
        mem[at], counts[RUNS + 1 + column], same = came, run, min(same, run)
        if noted:
            seen[1 + column] = max(seen[1 + column], longest)
        if gyro:
            mem[at + columns], coarsest = finest, max(coarsest, finest)
    for i in range(first, stop if gyro or noted else first):
        if gyro:
            mem[SCATTER], before_ns = _scattered(s, mem[SCATTER], s.t_ns[i] - before_ns), s.t_ns[i]
        if noted:
            seen[0] = max(seen[0], traced[i - first])
    counts[STEP_NS] = max(s.t_ns[stop - 1] - (s.t_ns[stop - 2] if stop - 1 > first else counts[CAME_NS]), 0)
    counts[RUNS], counts[CAME_NS] = same, s.t_ns[stop - 1]
    counts[COUNT] += stop - first
    resolution = coarsest if counts[COUNT] > RESOLUTION_SAMPLES and math.isfinite(coarsest) else 0.0
    if noted:
        seen[1 + columns] = resolution
        counts[TRACED] += stop - first
    return resolution


@inline
def _use(s: Samples, i: int, finest: float) -> bool:
    """Make of a sample what rows may use, after `_measure`; whether they may."""
    rule, v, columns = s.rule, s.v, s.columns
    frozen, zero, alone = s.counts[RUNS] > rule[LEAP + 4 * columns], rule[ZERO_IS_DEAD] > 0.0, False
    for column in range(columns):
        zero = zero and v[column, s.at + i] == 0.0
        alone = alone or s.counts[RUNS + 1 + column] > rule[LEAP + 3 * columns + column]
    dead = columns > 0 and (frozen or zero) and not v[0, s.at + i] < rule[LOWEST]
    if rule[GYRO]:
        if dead or alone:
            v[columns, s.at + i] = FROZEN_CODE
        elif finest > rule[MOST_STEP]:
            v[columns, s.at + i] = RESOLUTION_CODE
        elif s.mem[SCATTER] > UNEVEN:
            v[columns, s.at + i] = STAMPS_CODE
        return True
    if (dead or alone) and not (rule[RESTS] or rule[ANGLE]):
        for column in range(columns):
            if dead or s.counts[RUNS + 1 + column] > rule[LEAP + 3 * columns + column]:
                v[column, s.at + i] = np.nan
    return not (dead and rule[ANGLE])


@inline
def _in_range(s: Samples, i: int) -> bool:
    """Whether a sensor may have measured it; nan where rows may have it: some vehicles log some columns only."""
    for column in range(s.columns):
        size = abs(s.v[column, s.at + i])
        if size > s.rule[GREATEST] or (size != size and s.rule[MUST_BE_FINITE]):
            return False
    return True


@inline
def _move(s: Samples, i: int, to: int) -> None:
    if to < i:
        s.t_ns[to], s.host_ns[to] = s.t_ns[i], s.host_ns[i]
        for column in range(s.v.shape[0]):
            s.v[column, s.at + to] = s.v[column, s.at + i]


@inline
def _take(s: Samples, i: int, lost: bool, kept: int, seen: FloatArray, runs: IntArray) -> int:
    """Measure a sample that is decided, and move it to the believed ones, if it is; returns how many there are."""
    if s.rule[GYRO]:
        s.v[s.columns, s.at + i] = 0.0
    if s.rule[LEARNT]:
        finest = _measure(s, i, i + 1, seen[:0] if lost else seen, runs)
        if lost or not _use(s, i, finest):
            return kept
    zero = s.rule[NOT_ZERO] > 0.0
    for column in range(s.columns):
        zero = zero and (s.v[column, s.at + i] == 0.0 or not math.isfinite(s.v[column, s.at + i]))
    if zero:  # which no vehicle in flight has
        s.v[: s.columns, s.at + i] = np.nan
    _move(s, i, kept)
    return kept + 1


@cached_loop
def look_at(s: Samples, waited: int, seen: FloatArray, runs: IntArray) -> tuple[int, int, int]:
    """Move the samples that are believed to the front, as rows may use them.

    waited: how many came before. seen: (columns + 2,) of those not lost the longest repetitions, last resolution; runs:
    of each. Both may be empty. Returns how many are believed, decided, within range.
    """
    there = waited
    for i in range(waited, len(s.t_ns)):
        if _in_range(s, i):
            _move(s, i, there)
            there += 1
    if s.counts[COUNT] == 0 and waited == 0 and there:
        s.counts[LAST_NS] = s.counts[CAME_NS] = s.t_ns[0]
        s.mem[COLUMN : COLUMN + 3 * s.columns], s.mem[COLUMN + 3 * s.columns : COLUMN + 4 * s.columns] = np.nan, np.inf
    kept = done = 0
    while done < there:
        stop, run, lost = done, 1, False
        if s.rule[LEARNT] and s.counts[COUNT]:
            stop = _plain(s, done, min(done + TOGETHER, there))
        if stop > done:
            s.counts[ALONE] = 0
            _believe(s, done, stop)
            _measure(s, done, stop, seen, runs)
            s.v[s.columns :, s.at + done : s.at + stop] = 0.0
            for i in range(done, stop if kept < done else done):
                _move(s, i, kept + i - done)
            kept, done = kept + stop - done, stop
            continue
        if s.rule[LEARNT]:
            lost = _misdated(s, done)
            s.counts[ALONE] = int(lost)
            if not lost:
                run, lost = _decide(s, there, done)
                if run == 0:
                    break
        if s.rule[LEARNT] and not lost:
            _believe(s, done, done + run)
        for i in range(done, done + run):
            kept = _take(s, i, lost, kept, seen, runs)
        done += run
    return kept, done, there


NO_FIGURES, NO_RUNS = np.empty(0), np.empty(0, dtype=np.int64)


def believed(quality: LinkQuality, telemetry: Telemetry) -> Telemetry:
    """A log without its lost samples, nan where it is dead; the gyro with a fourth column, a place in `DOUBTS`."""
    sized = ((one, one.values.shape[1]) for one in telemetry.series)
    looked = (_looked(quality.rule(one.signal, columns), Memory(columns), one) for one, columns in sized)
    return Telemetry(tuple(filter(len, looked)))


def adds_nothing(quality: LinkQuality, pieces: Iterable[Telemetry]) -> bool:
    """Whether the same of a log, which comes in pieces, is believed of a link of which nothing is known, and at once.

    What comes out as it came in would do so there as well.
    """
    memories = dict[Signal, Memory]()
    for series in (series for piece in pieces for series in piece.series):
        columns = series.values.shape[1]
        memory = memories.setdefault(series.signal, Memory(columns))
        found = _looked(quality.rule(series.signal, columns), memory, series)
        if memory.waiting is not None and len(memory.waiting):
            return False
        if np.array_equal(found.values[:, :columns], series.values) and not found.values[:, columns:].any():
            continue
        other = _looked(LinkQuality().rule(series.signal, columns), Memory(columns), series)
        if not np.array_equal(found.values, other.values, equal_nan=True):
            return False
    return True


def _looked(
    rule: FloatArray, memory: Memory, series: Series, seen: FloatArray = NO_FIGURES, runs: IntArray = NO_RUNS
) -> Series:
    """What is believed of the next samples of a signal, and of those that waited."""
    columns, before = series.values.shape[1], memory.waiting
    waited = 0 if before is None else len(before)
    count = waited + len(series)
    t_ns, host_ns = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    values = np.empty((columns + int(rule[GYRO]), count))
    if before is not None:
        t_ns[:waited], host_ns[:waited], values[:, :waited] = before.t_ns, before.host_ns, before.values.T
    t_ns[waited:], host_ns[waited:], values[:columns, waited:] = series.t_ns, series.host_ns, series.values.T
    samples = Samples(columns, rule, memory.figures, memory.counts, t_ns, host_ns, values, 0)
    kept, done, there = look_at(samples, waited, seen, runs)
    memory.waiting = Series(series.signal, t_ns[done:there], host_ns[done:there], values[:, done:there].T)
    return Series(series.signal, t_ns[:kept], host_ns[:kept], values[:, :kept].T)


def learnt_quality(flights: Iterable[tuple[Telemetry, Sequence[tuple[int, int]]]]) -> LinkQuality:
    """What healthy flights show of their link: of each its telemetry, and the spans of flight in it [ns, both ends]."""
    flown: dict[Signal, list[Series]] = {}
    for telemetry, spans_ns in flights:
        for series in telemetry.series:
            if series.signal in RANGES:
                inside = [_between(series, *span) for span in spans_ns]
                flown.setdefault(series.signal, []).extend(one for one in inside if len(one) > 1)
    habits, jitter, steps = [], 0.0, [0.0]
    for signal, parts in flown.items():
        if len({one.values.shape[1] for one in parts}) != 1:  # never flew, or other numbers of outputs
            continue
        habit = _moved(signal, parts)
        watched = [(seen, runs) for seen, runs in (_watched(habit, part) for part in parts) if len(runs)]
        if not watched:
            continue
        longest = np.max([seen for seen, _ in watched], axis=0)[:-1]
        if signal is Signal.ATTITUDE_SETPOINT:
            longest[0] = np.quantile(np.concatenate([runs for _, runs in watched]), STILL_SHARE, method="higher")
        if signal is Signal.BODY_RATE:
            jitter = max(_jitter(one.t_ns, habit.period_s, forgetting(JITTER_S, habit.period_s)) for one in parts)
            steps = [float(seen[-1]) for seen, _ in watched]
        still = longest.astype(int).tolist()
        habits.append(habit.model_copy(update={"still": tuple(still if signal in SENSORS else still[:1])}))
    return LinkQuality(habits=tuple(habits), jitter=jitter, resolution_rad_s=min(filter(None, steps), default=0.0))


def _between(series: Series, first_ns: int, last_ns: int) -> Series:
    """What a sensor can measure in a span of flight, in order of time, each time once."""
    most, finite, wrong = RANGES[series.signal][0], series.signal in FINITE, np.zeros(len(series), dtype=np.bool_)
    for column in series.values.T:
        wrong |= (np.abs(column) > most) | (np.isnan(column) & finite)
    series = series.where(~wrong) if wrong.any() else series
    t_ns = series.t_ns
    if np.all(t_ns[1:] > t_ns[:-1]):  # a part of the same memory
        at: IntArray | slice = slice(int(t_ns.searchsorted(first_ns)), int(t_ns.searchsorted(last_ns, side="right")))
    else:
        t_ns, order = np.unique(t_ns, return_index=True)
        at = order[(t_ns >= first_ns) & (t_ns <= last_ns)]
    return series.where(at)


def _watched(habit: Habit, series: Series) -> tuple[FloatArray, IntArray]:
    """`seen` and `runs` of `look_at`, of the samples that are not lost by what the habit says of leaps."""
    columns, runs = series.values.shape[1], np.empty(len(series), dtype=np.int64)
    rule = LinkQuality(habits=(habit,)).rule(series.signal, columns)
    rule[[ZERO_IS_DEAD, NOT_ZERO]], rule[[MOST_JITTER, MOST_STEP]], rule[LEAP + 3 * columns :] = 0.0, np.inf, np.inf
    memory, seen = Memory(columns), np.zeros(columns + 2)
    for first in range(0, len(series), PIECE):
        _looked(rule, memory, series.where(slice(first, first + PIECE)), seen, runs)
    return seen, runs[: memory.counts[TRACED]]


@cached_loop
def _jitter(t_ns: IntArray, period_s: float, share: float) -> float:
    """Highest rms of how far steps are off whole periods, over the memory of that share [periods]."""
    mean = most = 0.0
    for i in range(1, len(t_ns)):
        steps = (t_ns[i] - t_ns[i - 1]) / (period_s * NS_PER_S)
        mean += share * ((steps - np.round(steps) if steps < MISSING else 0.0) ** 2 - mean)
        most = max(most, mean)
    return math.sqrt(most)


def _moved(signal: Signal, parts: Sequence[Series]) -> Habit:
    """How a signal moved, but for how long it repeats."""
    period_ns, columns = median_step([one.t_ns for one in parts]), parts[0].values.shape[1]
    found = []
    for one in parts:
        seconds = np.zeros((min(len(one), int(one.t_ns[-1] - one.t_ns[0]) // NS_PER_S + 1), 2 + 3 * columns))
        values = np.ascontiguousarray(one.values.T, dtype=np.float64)
        found.append(seconds[: _by_second(one.t_ns, values, signal in ANGLES, period_ns, seconds)])
    steps, pauses, *figures = np.concatenate(found).T
    plain, bent, squares = np.split(np.array(figures), 3)
    usual, led = (np.quantile(leaps, USUAL_SHARE, axis=1) for leaps in (plain, bent))
    leading = (led < usual) & (signal not in HELD)
    quiet = QUIET_SHARE * np.quantile(np.sqrt(squares / steps), CALM_SHARE, axis=1) * (signal in SENSORS)
    return Habit(
        signal=signal,
        period_s=period_ns / NS_PER_S,
        pause_s=float(np.quantile(pauses, USUAL_SHARE)) / NS_PER_S,
        leap=tuple(np.where(leading, led, usual).tolist()),
        quiet=tuple(quiet.tolist()),
        still=(0,),
        lowest=float(np.nan_to_num(min(np.min(one.values[:, 0]) for one in parts))),
        leads=tuple(leading.tolist()),
    )


@cached_loop
def _by_second(t_ns: IntArray, values: FloatArray, angle: bool, period_ns: float, seconds: FloatArray) -> int:
    """Sum up each second of a signal, (columns, n), that has steps; returns how many there are.

    seconds: (.., 2 + 3 columns) the steps, the longest [ns]; of each column the greatest departure from the value
    before and from where the two before lead, for the time, and the sum of squares of the former.
    """
    row, columns, until_ns = -1, len(values), t_ns[0]
    for i in range(1, len(t_ns)):
        if t_ns[i] >= until_ns:
            row, until_ns = row + 1, t_ns[i] + NS_PER_S - (t_ns[i] - t_ns[0]) % NS_PER_S
        second, span_ns = seconds[row], t_ns[i] - t_ns[i - 1]
        n = max(span_ns / period_ns, 1.0)
        second[0] += 1.0
        second[1] = max(second[1], span_ns)
        for column in range(columns):
            step = values[column, i] - values[column, i - 1]
            before = values[column, i - 1] - values[column, i - 2] if i > 1 else np.nan
            if angle:
                step, before = step - TURN * np.round(step / TURN), before - TURN * np.round(before / TURN)
            bend = step - before / (t_ns[i - 1] - t_ns[i - 2]) * span_ns if i > 1 else np.nan
            bend = bend - TURN * np.round(bend / TURN) if angle else bend
            plain, led = abs(step) / n, abs(bend) / (n * (n + 1.0) / 2.0)
            if plain == plain:
                second[2 + column] = max(second[2 + column], plain)
                second[2 + 2 * columns + column] += plain * plain
            if led == led:
                second[2 + columns + column] = max(second[2 + columns + column], led)
    return row + 1
