"""The rotor-trim monitor: one rotor is commanded more, against the others, than it was when all were healthy.

A controller with an integrator hides a weak rotor from its own attitude error: it commands more. That command is the
evidence, and it names the rotor (METHOD section 5). It does not show why.

    g = b1 r + b2 dr/dt - b3 dm_yaw/dt,    tick = median over its parts of m_roll - k1 h1, m_pitch - k2 h2, m_yaw - g
    weight = 1/(1 + (max |g|/G)^2),        h = (-f_y, f_x)/9.81

Air that comes from the side pulls at the vehicle and tips its rotors' discs, both in proportion to its speed (Leishman,
Principles of Helicopter Aerodynamics, ch. 4). The accelerometer feels the pull h along the discs; without one the
commanded lean is in its place, k is zero, and the errors of k stay those of the prior. In calm air what is no larger
than the trim's floor may go with h in all ticks (`fitting.updated`).

A vehicle whose nose turns has its rotors commanded apart: against the drag of its rotation (b1), for its inertia (b2)
and for that of the rotors, whose change of speed turns the vehicle too (b3, never negative). The three are fitted to
the ticks of healthy flights, and to their means, by least squares about a physical prior; their covariance P says what
the trim cannot tell (`TrimMonitor.blindness`). The law errs by a share of g, so a window is the mean of its ticks
weighted as above, where the tick before counts too, for rotors lag.

A tick has five parts of 0.1 s, and g is taken off each: means obey the law however fast the nose turns, medians do not.
The median over the parts then hides a few wild samples.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal, TypeVar

import numpy as np

import mavdiag.airframe.trim as trims
import mavdiag.rows.block as col
from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import allocating, cached, jit
from mavdiag.monitors.base import Begin, Feature, Flights, LearnContext, Monitor, RotorEvidence, segments
from mavdiag.monitors.fitting import held_law, of_each, three, updated
from mavdiag.monitors.spec import Positive, Span, spec
from mavdiag.rows.block import Floats, Ints
from mavdiag.rows.conditions import TRIM_CONDITIONS
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, Signal, Three
from mavdiag.units import G

MOST_RISE = 0.5  # of a rotor that lost more than a third of its thrust no output can answer (our choice)
WINDOW_S = 5.0  # our choice; 3.5 s works as well on the recorded flights
TICK_S, PART_S = 0.5, 0.1  # a value twice a second, of parts longer than a rotor's lag (our choices)
# G, of hover: where a turn takes so much its tick counts half. The law errs by a fifth of it (ArduCopter in the loop):
# by 0.004, as a tick scatters anyway (our choice).
TURN_TRIM = 0.02
# What is held of b1 [1/(rad/s)], b2 [1/(rad/s^2)] and b3 [s] before any flight, and its standard deviation (our
# choice). b2 is I_zz over weight and drag arm of the rotors, 0.04 for a QDrone 2 and an ArduCopter of 3 kg; b1 is 0.11
# for the latter; b3 is the spin that a unit of yaw trim gives the rotors over the torque that it makes.
PRIOR, PRIOR_SD = np.array([0.0, 0.04, 0.0]), np.array([0.1, 0.04, 0.2])
SURE_SD = 3.0  # so far a law may err, or a load hang along an arm (our choice)
APART = 0.07, 0.07, 0.012  # of roll, pitch and yaw trim, between flights of other days (sd; METHOD section 5)
# Places in the parameters: 1 for torque commands; 1 where the pull is felt; how many rotors; parts of a tick, rows of a
# part, row period, ticks of a window; of the spec pull, turn, variances of k1, k2 and 9 of b1, mean, about and spread;
# gains of torque commands; what a monitor has of its own; variance of the yaw trim between its days, and that of
# the drag; the curve of the thrust; the unmixing C, (3, rotors), and 1/max |c_k|.
TORQUES, FELT, ROTORS, PARTS, ROWS, DT, WINDOW, PULL, TURN, ERROR, MEAN, ABOUT, SPREAD = *range(8), 9, 12, 15, 18, 21
GAIN, OWN, DAYS, DRAG, CURVE, UNMIXING = 24, 27, 30, 31, 32, 33
# And in the memory: parts of the tick, rows of the part, known ones of the tick, whether a trim changed, the first one;
# usable ticks in a row, ticks so far, weight of the last; what a monitor has of its own; then the parts, the last two
# of the tick before in front, room for the median, and the ticks of two windows.
PART, ROW, KNOWN, MOVED, FIRST, RUN, TICKS, WEIGHT, MINE, SUMS = *range(5), 7, 8, 9, 10, 22
SUMMED, FIGURES = 7, 9  # of a part: trim, pull, yaw rate, mean output; slope of the rate and that of the yaw trim, less
MEANS, RATE, LIFT = 7, 5, 6  # of a window: trim, pull, yaw rate and lift, ln of the mean output
# Behind the figures in the trace of a tick: usable ticks in a row, means of a window but for lift; shift of the trim.
RUNS, SHIFT = FIGURES, FIGURES + 1 + LIFT

Spec = TypeVar("Spec", bound="TrimSpec")


@spec
class TrimSpec:
    """What every fit of the trim holds. Raises InputError if the layout gives no trim of that source."""

    kind: str
    layout: RotorLayout
    source: trims.Source  # where the trim comes from: the motors' outputs, or the torque commands over the thrust
    mean: Three = (0.0, 0.0, 0.0)  # healthy roll, pitch and yaw trim [fraction of hover]
    about: Three = (0.0, 0.0, 0.0)  # mean pull [9.81 m/s^2] and yaw rate [rad/s], at which it was learnt
    felt: bool = False  # whether the accelerometer tells the pull; else the lean stands for it
    pull: tuple[float, float] = (0.0, 0.0)  # k1 and k2, and their standard deviations
    pull_sd: tuple[Positive, Positive] = (trims.TILT_TRIM, trims.TILT_TRIM)
    turn: Three = (0.0, 0.0, 0.0)  # b1, b2 and b3
    turn_covariance: tuple[Three, Three, Three] = ((0.0, 0.0, 0.0),) * 3
    spread: tuple[Positive, Positive, Positive]  # of the 5 s means about the mean, or about the reference
    window_s: Span = WINDOW_S

    def __post_init__(self) -> None:
        if self.source == "torque" and self.layout.torque_gain is None:
            lacking = f"what a torque command does to the motors of {self.layout.name}"
            raise InputError(f"{self.kind}: {lacking} is not known")


@spec
class RotorTrimSpec(TrimSpec):
    """Healthy trim."""

    kind: Literal["rotor_trim"] = "rotor_trim"


@jit
def _trim(par: Floats, x: Floats, i: int) -> tuple[float, float, float, float]:
    """Trim of a row [fraction of hover], not finite where it is unknown (`airframe.trim.trim_of`), and mean output."""
    roll, pitch, yaw, rotors, level = 0.0, 0.0, 0.0, int(par[ROTORS]), 0.0
    if par[TORQUES] > 0.5:
        level = x[col.THRUST, i]
        share = 1.0 / level if level > trims.MIN_OUTPUT else math.nan
        roll, pitch = x[col.TORQUE, i] * par[GAIN], x[col.TORQUE + 1, i] * par[GAIN + 1]
        return roll * share, pitch * share, x[col.TORQUE + 2, i] * par[GAIN + 2] * share, level
    if x.shape[0] < col.OUTPUTS + rotors:
        return math.nan, math.nan, math.nan, math.nan
    for rotor in range(rotors):
        level += x[col.OUTPUTS + rotor, i] / rotors
    level = level if level > trims.MIN_OUTPUT else math.nan
    for rotor in range(rotors):
        at, w = UNMIXING + rotor, x[col.OUTPUTS + rotor, i] / level - 1.0
        w += par[CURVE] * w * w
        roll, pitch, yaw = roll + par[at] * w, pitch + par[at + rotors] * w, yaw + par[at + 2 * rotors] * w
    return roll, pitch, yaw, level


@jit
def take_rows(par: Floats, mem: Floats, x: Floats, begin: int) -> tuple[int, bool]:
    """Take rows of one part; returns where the next one begins, and whether they completed a tick."""
    stop = min(begin + int(par[ROWS] - mem[ROW]), x.shape[1])
    if mem[PART] == 0.0 and mem[ROW] == 0.0 and begin < stop:
        for j in range(2 * FIGURES):
            mem[SUMS + j] = mem[SUMS + FIGURES * int(par[PARTS]) + j]
        mem[KNOWN] = mem[MOVED] = 0.0
        mem[FIRST], mem[FIRST + 1], mem[FIRST + 2], _ = _trim(par, x, begin)
    _add_rows(par, mem, x, begin, stop)
    mem[ROW] += stop - begin
    if mem[ROW] < par[ROWS]:
        return stop, False
    mem[ROW], mem[PART] = 0.0, mem[PART] + 1.0
    if mem[PART] < par[PARTS]:
        return stop, False
    whole = mem[KNOWN] >= par[PARTS] * par[ROWS] and mem[MOVED] > 0.5
    mem[PART] = 0.0
    _find(par, mem, whole)
    _take_tick(par, mem, whole and x[col.COVERED, stop - 1] > 0.5)
    return stop, True


@jit
def _add_rows(par: Floats, mem: Floats, x: Floats, begin: int, stop: int) -> None:
    """Add rows to the sums of their part."""
    sums, known, felt = mem[SUMS + FIGURES * (2 + int(mem[PART])) :][:SUMMED], mem[KNOWN], par[FELT] > 0.5
    if mem[ROW] == 0.0:
        sums[:] = 0.0
    for i in range(begin, stop):
        (roll, pitch, yaw, level), rate = _trim(par, x, i), x[col.RATE + 2, i]
        if felt:
            pull_x, pull_y = -x[col.FORCE + 1, i] / G, x[col.FORCE, i] / G
        else:
            pull_x, pull_y = x[col.LEAN, i], x[col.LEAN + 1, i]
        if x[col.VALID, i] > 0.5 and math.isfinite(roll + pitch + yaw + rate + pull_x + pull_y):
            known += 1.0
            sums[0], sums[1], sums[2] = sums[0] + roll, sums[1] + pitch, sums[2] + yaw
            sums[3], sums[4], sums[5] = sums[3] + pull_x, sums[4] + pull_y, sums[5] + rate
            sums[6] += level
            if roll != mem[FIRST] or pitch != mem[FIRST + 1] or yaw != mem[FIRST + 2]:
                mem[MOVED] = 1.0
    mem[KNOWN] = known


@jit
def _ticks_at(par: Floats) -> int:
    """Where the ticks of the windows stand, behind room for the median."""
    return SUMS + FIGURES * (int(par[PARTS]) + 2) + int(par[PARTS])


@jit
def _find(par: Floats, mem: Floats, whole: bool) -> None:
    """From sums to the parts of a tick; nan where it is not whole.

    A slope is that from the part before to the part after, so the parts of a tick end one part before its last row.
    """
    rows, first = int(par[ROWS]), SUMS + 2 * FIGURES
    for j in range(FIGURES * int(par[PARTS])):
        mem[first + j] = mem[first + j] / rows if whole else math.nan
    for part in range(2):
        for j in range(SUMMED if math.isnan(mem[SUMS + FIGURES * part + 5]) else 0):
            mem[SUMS + FIGURES * part + j] = mem[first + j]
    for of in range(SUMS + FIGURES, first + FIGURES * (int(par[PARTS]) - 1), FIGURES):
        before, after, span_s = of - FIGURES, of + FIGURES, 2 * rows * par[DT]
        mem[of + 7] = (mem[after + 5] - mem[before + 5]) / span_s
        mem[of + 8] = (mem[before + 2] - mem[after + 2]) / span_s


@jit
def _median(mem: Floats, at: int, count: int) -> float:
    """Median of so many values, which are sorted on the way."""
    for i in range(1, count):
        value, j = mem[at + i], i
        while j > 0 and mem[at + j - 1] > value:
            mem[at + j] = mem[at + j - 1]
            j -= 1
        mem[at + j] = value
    return float(0.5 * (mem[at + (count - 1) // 2] + mem[at + count // 2]))


@jit
def _take_tick(par: Floats, mem: Floats, usable: bool) -> None:
    """Put the tick whose parts were found into the windows, without what pull and turn take of its trim."""
    parts, ticks, most = int(par[PARTS]), _ticks_at(par), 0.0
    scratch, to = ticks - parts, ticks + (MEANS + 1) * (int(mem[TICKS]) % (2 * int(par[WINDOW])))
    for j in range(MEANS):
        for part in range(parts):
            of, taken = SUMS + FIGURES * (part + 1), 0.0
            if j < 2:
                taken = par[PULL + j] * mem[of + 3 + j]
            elif j == 2:
                taken = par[TURN] * mem[of + 5] + par[TURN + 1] * mem[of + 7] + par[TURN + 2] * mem[of + 8]
                most = abs(taken) if abs(taken) > most else most  # not of nan
            mem[scratch + part] = mem[of + j] - taken
        mem[to + j] = _median(mem, scratch, parts)
    mem[to + LIFT] = math.log(max(mem[to + LIFT], trims.MIN_OUTPUT))
    weight = 1.0 / (1.0 + (most / TURN_TRIM) ** 2)
    counts = min(weight, mem[WEIGHT]) if mem[TICKS] > 0.0 else weight  # rotors lag
    for j in range(MEANS):
        mem[to + j] *= counts
    mem[to + MEANS], mem[WEIGHT] = counts, weight
    mem[TICKS] += 1.0
    mem[RUN] = mem[RUN] + 1.0 if usable else 0.0


@jit
def window_means(par: Floats, mem: Floats, back: int, means: Floats) -> None:
    """Weighted means, (MEANS,), over the ticks of a window that ended so many ticks ago."""
    window, ring = int(par[WINDOW]), _ticks_at(par)
    first, weight = int(mem[TICKS]) - back - window, 0.0
    means[:] = 0.0
    for tick in range(first, first + window):
        at = ring + (MEANS + 1) * (tick % (2 * window))
        weight += mem[at + MEANS]
        for j in range(MEANS):
            means[j] += mem[at + j]
    for j in range(MEANS):
        means[j] /= weight


@jit
def rise(par: Floats, rotor: int, shift: Floats, roll: float, pitch: float, yaw: float) -> tuple[float, float]:
    """The rise a_j of one rotor that explains a shift of trim with these variances, and a_j |c_j| (`trims`)."""
    n = int(par[ROTORS])
    c, d, e = par[UNMIXING + rotor], par[UNMIXING + n + rotor], par[UNMIXING + 2 * n + rotor]
    above = c * shift[0] / roll + d * shift[1] / pitch + e * shift[2] / yaw
    below = c * c / roll + d * d / pitch + e * e / yaw
    return above / below, above / math.sqrt(below)


@jit
def best_rise(par: Floats, shift: Floats) -> float:
    """That of the rotor whose rise leaves least of a shift of trim, pull, yaw rate and lift, (7,).

    Roll and pitch vary with a load that is so heavy, and with the errors of k. Less by what the yaw trim errs at this
    yaw rate. Or b_j of `TrimStep`, if it is larger: what roll, pitch and lift tell alike, whatever yaw does.
    """
    n, pull, load = int(par[ROTORS]), shift[3] ** 2 + shift[4] ** 2, (trims.BESIDE * shift[LIFT]) ** 2
    roll, pitch = par[SPREAD] ** 2 + load + par[ERROR] * pull, par[SPREAD + 1] ** 2 + load + par[ERROR + 1] * pull
    found, most, lifted, lift = 0.0, -math.inf, 0.0, n * shift[LIFT]
    for rotor in range(n):
        a, explained = rise(par, rotor, shift, roll, pitch, par[SPREAD + 2] ** 2)
        if explained > most:
            found, most = a, explained
        c, d = par[UNMIXING + rotor], par[UNMIXING + n + rotor]
        told = (c * shift[0] + d * shift[1] - abs(c * shift[1] - d * shift[0])) / (c * c + d * d)
        away = SURE_SD * math.sqrt(c * c * roll + d * d * pitch) / (c * c + d * d)
        if lift > away:
            lifted = max(lifted, (min(told, lift) - away) / (1.0 - away / lift))
    error = max(0.0, par[ERROR + 2] * shift[RATE] ** 2 - par[DAYS])
    return max(lifted, found / math.sqrt(1.0 + error / par[SPREAD + 2] ** 2))


@allocating
def write(par: Floats, mem: Floats, shift: Floats, sound: bool, out: Floats, rotors: Floats, k: int) -> None:
    """A value of a shift; for a fit the tick's `FIGURES`, usable ticks, window and shift."""
    parts, n = int(par[PARTS]), int(par[ROTORS])
    out[col.VALUE, k] = out[col.LEVEL, k] = best_rise(par, shift)
    out[col.SOUND, k] = sound
    roll, pitch, yaw = par[SPREAD] ** 2, par[SPREAD + 1] ** 2, par[SPREAD + 2] ** 2
    for rotor in range(rotors.shape[1]):
        c, d, e = par[UNMIXING + rotor], par[UNMIXING + n + rotor], par[UNMIXING + 2 * n + rotor]
        apart = par[DRAG] * e * e * (shift[0] ** 2 + shift[1] ** 2) / max(c * c + d * d, 1e-12)  # 0 in the centre
        rotors[k, rotor] = rise(par, rotor, shift, roll, pitch, yaw + apart)[1] * par[UNMIXING + 3 * n]
    if out.shape[0] > col.TRACE:
        means = np.empty(MEANS)
        window_means(par, mem, 0, means)
        for j in range(FIGURES):
            mean = 0.0
            for part in range(parts):
                mean += mem[SUMS + FIGURES * (part + 1) + j]
            out[col.TRACE + j, k] = mean / parts
        out[col.TRACE + RUNS, k] = mem[RUN]
        for j in range(LIFT):
            out[col.TRACE + RUNS + 1 + j, k] = means[j] if mem[RUN] >= par[WINDOW] else math.nan
        for j in range(3):
            out[col.TRACE + SHIFT + j, k] = shift[j]


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The best single-rotor rise at the end of each tick."""
    k, begin, shift = 0, first, np.empty(MEANS)
    while begin < x.shape[1]:
        begin, ended = take_rows(par, mem, x, begin)
        if not ended:
            continue
        sound = mem[RUN] >= par[WINDOW]
        window_means(par, mem, 0, shift)
        shift[LIFT] = 0.0  # what the vehicle weighed when it was learnt is not known
        for j in range(LIFT):
            shift[j] = shift[j] - par[MEAN + j] if sound else 0.0  # behind mean is about
        write(par, mem, shift, sound, out, rotors, k)
        at[k], k = begin - 1 - first, k + 1
    return k


class TrimMonitor(Monitor[Spec]):
    """A monitor of the trim; its `rotors` are a_j |c_j|/max_k |c_k|, |c|^2 = c' W c (`airframe.trim`)."""

    phrase = "lost {lost}% thrust"
    needs = frozenset({Signal.ACTUATOR, Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT, Signal.SPECIFIC_FORCE})
    depends = TRIM_CONDITIONS
    # Damage that changes a blade's drag by 0.02 shifts the yaw trim towards rotors of the other sense, a lead of 0.04:
    # no smaller unit tells rotors apart (our choice).
    evidence = RotorEvidence(10.0, relative=True, least=0.04, direct=False)
    needs_layout = True
    tick_s = TICK_S
    unit = "fraction of hover"
    reach = MOST_RISE
    drag: ClassVar[float] = 0.0  # what drag changes by apart from thrust, over the rise (sd)
    days: ClassVar[float] = 0.0  # by how much the yaw trim differs on other days than that it is compared with (sd)

    def __init__(self, spec: Spec) -> None:
        super().__init__(spec)
        self.signals = trims.SIGNALS[spec.source] | ({Signal.SPECIFIC_FORCE} if spec.felt else set())
        own = slice(0, spec.layout.rotors)  # those that move a rotor
        self.takes = {Signal.ACTUATOR: own, Signal.SPECIFIC_FORCE: trims.ALONG_DISCS}

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[Spec, ...]:
        """What pull and turns take, mean over flights of their mean trims, and the spread about it."""
        layout, dt_s, before = context.layout, context.dt_s, (trims.YAW_FLOOR, trims.YAW_FLOOR, trims.YAW_FLOOR)
        source = trims.source_among(of_each(flights, layout, lambda flight: trims.sources_of(flight, layout)), layout)
        felt = min(of_each(flights, "share of rows with x and y", trims.felt_share)) > trims.FELT_SHARE
        still = cls(cls.spec_type(layout=layout, source=source, felt=felt, spread=before))
        parts = of_each(flights, (layout, source, felt), still._parts_of)
        known = cls(_with_laws(still.spec, [still._walked(one, dt_s) for one in parts], dt_s))
        walked = [known._walked(flight, dt_s) for flight in parts]
        found = _at(known.spec, _means_of(walked).mean(axis=0))
        return (replace(found, spread=cls.spread(walked, found.mean)),)

    @classmethod
    @abstractmethod
    def spread(cls, flights: Sequence[Sequence[FloatArray]], mean: Three) -> Three:
        """Spread of what it judges of healthy flights. Raises IdentificationError. flights: (rows of `write`, k)."""

    def _parts_of(self, flight: Sequence[Rows]) -> list[FloatArray]:
        """The parts of ticks of each segment as x of `rows.block`: trim as torque command at a thrust, pull as lean."""
        found, spec = [], self.spec
        for segment in segments(flight):
            parts, rest = list[FloatArray](), np.empty((8, 0))
            for block in (rows.block for rows in segment):
                size, (trim, known) = _tick_shape(block.dt_s)[1], trims.trim_of(block, spec.layout, spec.source)
                level = trims.level_of(block, spec.layout, spec.source)
                fresh = np.vstack((trim.T, trims.pull_of(block, spec.felt).T, block.rate[:, 2], level))
                known = known & np.isfinite(fresh).all(axis=0)
                each = np.concatenate((rest, np.vstack((np.where(np.isfinite(fresh), fresh, 0.0), known))), axis=1)
                n = each.shape[1] // size
                parts.append(each[:, : n * size].reshape(8, n, size).mean(axis=2))
                rest = each[:, n * size :]
            seen = np.concatenate(parts, axis=1)
            x = np.zeros((col.OUTPUTS, seen.shape[1]))
            x[col.TORQUE : col.TORQUE + 3], x[col.LEAN : col.LEAN + 2] = seen[:3] * seen[6], seen[3:5]
            x[col.RATE + 2], x[col.THRUST], x[col.COVERED] = seen[5], seen[6], 1.0
            x[col.VALID] = seen[7] > 1.0 - 0.5 / size  # all rows are known
            found.append(x)
        return found

    def _walked(self, flight: Sequence[FloatArray], dt_s: float) -> list[FloatArray]:
        """What `run` writes of each segment of a flight's parts, with the figures of `write`."""
        part_s, found = _tick_shape(dt_s)[1] * dt_s, []
        for x in flight:
            begun, n = self.begin(part_s), x.shape[1]
            begun.par[TORQUES], begun.par[FELT], begun.par[GAIN : GAIN + 3] = 1.0, 0.0, 1.0
            out, rotors = np.zeros((col.TRACE + SHIFT + 3, n)), np.empty((n, self.rotors))
            found.append(out[:, : self.run(begun.par, begun.mem, x, 0, 0, out, rotors, np.empty(n, dtype=np.int64))])
        return found

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[Spec, float]:
        """With the trim of the new propellers; how much it varies stays."""
        return _at(self.spec, self._means(flights).mean(axis=0)), 1.0

    def extended(self, flights: Flights, count: int) -> tuple[Spec, float]:
        """With the mean over all flights; no rise grows by more than the one that explains the way of the mean back."""
        spec, means = self.spec, self._means(flights)
        moved = (means - (*spec.mean, *spec.about)).sum(axis=0) / (count + len(means))
        back = trims.rises(-moved[None, :3], spec.layout, spec.spread)
        return _at(spec, moved + np.array([*spec.mean, *spec.about])), float(back.max())

    def _means(self, flights: Flights) -> FloatArray:
        dt_s = next((rows.block.dt_s for flight in flights for rows in flight), TICK_S)
        return _means_of([self._walked(self._parts_of(flight), dt_s) for flight in flights])

    def whole(self, flight: Sequence[Rows]) -> Three | tuple[()]:
        """Trim of a whole flight by roll, pitch and yaw, without what pull and turns take; empty if it is too short.

        Medians over its parts of 0.1 s but for those whose turn takes more than `TURN_TRIM`.
        """
        spec, found = self.spec, [np.empty((3, 0))]
        for x in of_each([flight], (spec.layout, spec.source, spec.felt), self._parts_of)[0]:
            trim, rate = x[col.TORQUE : col.TORQUE + 3] / np.maximum(x[col.THRUST], trims.MIN_OUTPUT), x[col.RATE + 2]
            trim[:2] -= np.array(spec.pull)[:, None] * x[col.LEAN : col.LEAN + 2]
            taken = spec.turn[0] * rate + spec.turn[1] * np.gradient(rate, PART_S) if len(rate) > 1 else rate
            trim[2] -= taken
            found.append(trim[:, (x[col.VALID] > 0.5) & (np.abs(taken) < TURN_TRIM)])
        parts = np.concatenate(found, axis=1)
        return three(np.median(parts, axis=1)) if parts.shape[1] * PART_S >= spec.window_s else ()

    @classmethod
    def tick(cls, dt_s: float) -> int:
        """Of whole parts."""
        return math.prod(_tick_shape(dt_s))

    def blindness(self, threshold: float) -> str:
        """The least loss of one rotor; and what errors of the law of turns cannot be told from.

        Their standard deviation is sqrt(P_11) |r - r0|, r0 the mean yaw rate that was learnt. Beyond where a rise a of
        one rotor, a c_yaw, is as large the yaw trim tells no rotor.
        """
        spec, C = self.spec, self.spec.layout.unmixing
        rate = math.sqrt(spec.turn_covariance[0][0])
        lost = f"blind to losses below {100 * trims.loss_of(threshold, C.shape[1]):.0f} % of one rotor's thrust"
        if rate == 0.0:
            return lost
        pattern, turn = "".join("+" if c > 0 else "-" for c in C[2]), threshold * float(np.abs(C[2]).max()) / rate
        off = f"where the yaw rate is off {spec.about[2]:.2g} by more than {turn:.2g} rad/s"
        return f"{lost}, and to the yaw pattern {pattern} {off}"

    def own(self, tick_s: float) -> tuple[float, float, float]:
        """What the monitor reads of its own (`OWN`)."""
        return 0.0, 0.0, 0.0

    def begin(self, dt_s: float) -> Begin:
        """No row yet."""
        spec, layout, (parts, rows) = self.spec, self.spec.layout, _tick_shape(dt_s)
        window = max(1, round(spec.window_s / self.period_s(dt_s)))
        head = [spec.source == "torque", spec.felt, layout.rotors, parts, rows, dt_s, window]
        gain, C = layout.torque_gain or (0.0, 0.0, 0.0), layout.unmixing
        errors = [*np.square(spec.pull_sd), SURE_SD**2 * spec.turn_covariance[0][0]]
        learnt = [*spec.pull, *spec.turn, *errors, *spec.mean, *spec.about, *spec.spread, *gain]
        mem = np.zeros(SUMS + FIGURES * (parts + 2) + parts + 2 * (MEANS + 1) * window)
        mem[SUMS:][: FIGURES * (parts + 2)] = np.nan
        own, sizes = self.own(self.period_s(dt_s)), np.sqrt(np.power(spec.spread, -2.0) @ np.square(C))
        apart = self.days**2, self.drag**2, trims.curve_of(layout)
        return Begin(np.array([*head, *learnt, *own, *apart, *C.ravel(), 1.0 / sizes.max()]), mem)


class RotorTrim(TrimMonitor[RotorTrimSpec]):
    """Statistic: the rise of ONE rotor's command that explains the trim shift best [fraction of hover].

        m: trim averaged over 5 s,    mu: the healthy one,    a_j: rise of rotor j that explains m - mu
        rotor = argmax_j a_j |c_j|,    statistic = a_rotor / sqrt(1 + max(0, 9 P_11 (r - r0)^2 - s^2)/sd_yaw^2)

    A payload, a weak battery or a shifted centre of mass move roll and pitch, not yaw; these have at least three times
    yaw's spread, so the evidence is mostly yaw, and they settle which rotor it is. To their spread the error of k times
    the change of the pull is added in squares, but not where a rotor is named. r - r0: yaw rate of the same 5 s less
    that of the healthy flights, P_11: variance of b1, s: what the yaw trim differs by on other days anyway.

    Warm-up: 5 s of unbroken valid flight. Latency: up to 5 s. False alarms: a change of propellers or of the centre of
    mass; two flights from two sessions are the worst basis. Blind spots: hops shorter than 5 s; vibration without loss
    of thrust; all rotors ageing alike; a rotor whose outputs saturate.
    """

    name = "rotor_trim"
    label = "rotor trim"
    observes = "one rotor commanded more than in health"
    least = 0.02  # what wind makes (our choice)
    spec_type = RotorTrimSpec
    feature = Feature.RISE
    doubt = "trim shift: propeller, payload or session"  # a trim alone tells no more
    days = APART[2]
    run = staticmethod(run)

    @classmethod
    def spread(cls, flights: Sequence[Sequence[FloatArray]], mean: Three) -> Three:
        """Of all windows of all flights about the mean."""
        return trims.spread_of(np.concatenate([_windows_of(flight)[:, :3] for flight in flights]) - mean)


def _tick_shape(dt_s: float) -> tuple[int, int]:
    """Parts of a tick, at least 2, and rows of a part."""
    rows = max(1, round(PART_S / dt_s))
    return max(2, round(TICK_S / (rows * dt_s))), rows


def _with_laws(spec: Spec, flights: Sequence[Sequence[FloatArray]], dt_s: float) -> Spec:
    """With k and b of healthy flights, each as `TrimMonitor._walked` gives it, and their errors.

    Usable ticks, but for the first one after a break, about their flight's mean; and the means of the flights, between
    which other days lie, about that of all.
    """
    found, window = [np.empty((0, FIGURES))], max(1, round(WINDOW_S / (math.prod(_tick_shape(dt_s)) * dt_s)))
    for flight in flights:
        usable = [segment[col.TRACE : col.TRACE + FIGURES, segment[col.TRACE + RUNS] > 1].T for segment in flight]
        if sum(map(len, usable)):
            found.append(np.concatenate(usable))
    means = np.array([each.mean(axis=0) for each in found[1:]]).reshape(-1, FIGURES)
    ticks = np.concatenate([found[0], *(each - mean for each, mean in zip(found[1:], means, strict=True))])
    means -= means.mean(axis=0) if len(means) else 0.0

    def fitted(axis: int, of: list[int], prior: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
        known = updated(prior, np.diag(sd**2.0), means[:, axis], means[:, of], APART[axis] ** 2)
        held = trims.YAW_FLOOR if axis < 2 else 0.0  # manoeuvres in calm air repeat
        return held_law(ticks[:, axis], ticks[:, of], *known, trims.YAW_FLOOR, window, held)

    law, P = fitted(2, [5, 7, 8], PRIOR, PRIOR_SD)
    if law[2] < 0.0:  # rotors without inertia where that is the best one: a command that answers noise
        law, P = (np.pad(found, (0, 1)) for found in fitted(2, [5, 7], PRIOR[:2], PRIOR_SD[:2]))
    spec = replace(spec, turn=three(law), turn_covariance=(three(P[0]), three(P[1]), three(P[2])))
    if not spec.felt:
        return spec
    (k1, P1), (k2, P2) = (fitted(i, [3 + i], np.zeros(1), np.full(1, trims.TILT_TRIM)) for i in range(2))
    return replace(spec, pull=(float(k1[0]), float(k2[0])), pull_sd=(math.sqrt(P1[0, 0]), math.sqrt(P2[0, 0])))


def _at(spec: Spec, means: FloatArray) -> Spec:
    """With this mean trim, pull and yaw rate, (6,)."""
    return replace(spec, mean=three(means[:3]), about=three(means[3:]))


def _windows_of(flight: Sequence[FloatArray]) -> FloatArray:
    """Mean trim, pull and yaw rate of all full windows of a flight, (k, 6)."""
    means = (segment[col.TRACE + RUNS + 1 : col.TRACE + SHIFT] for segment in flight)
    windows = np.concatenate([np.empty((LIFT, 0)), *means], axis=1).T
    return np.asarray(windows[np.isfinite(windows[:, 0])], dtype=np.float64)


def _means_of(flights: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """Those of the flights that have one, (k, 6). Raises IdentificationError if none has."""
    means = [windows.mean(axis=0) for windows in map(_windows_of, flights) if len(windows)]
    if not means:
        raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight to average the trim over; fly longer")
    return np.array(means)
