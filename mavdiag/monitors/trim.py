"""What the two monitors of the trim share: ticks of half a second, what a turn takes of them, and the healthy trim.

    g = b1 r + b2 dr/dt,    tick = median over its parts of m_yaw - g,    weight = 1/(1 + (max |g|/G)^2)

A vehicle whose nose turns has its rotors commanded apart: a steady turn against the drag of its rotation, the start and
the stop of a turn for its inertia. A tick has five parts of 0.1 s, and g is taken off each of them: means of both sides
obey the law however fast the nose turns, medians would not. The median then hides a few wild samples. b1 and b2 are
fitted to the ticks of the healthy flights by least squares (REVIEW H1: 5 s means of a real ArduCopter's healthy yaw
trim 0.131 -> 0.009). The law errs by a share of g, so a window is the mean of its ticks weighted as above, where the
tick before counts too, for rotors lag. Nothing here depends much on when a tick begins.
"""

import itertools
import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import (
    MIN_OUTPUT,
    MOST_LOSS,
    SIGNALS,
    TILT_TRIM,
    YAW_FLOOR,
    Source,
    rise_of,
    source_among,
    sources_of,
    tilt_of,
    trim_of,
)
from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import jit
from mavdiag.monitors.base import Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.columns import (
    LEAN,
    OUTPUTS,
    RATE,
    THRUST,
    TORQUE,
    TRACE,
    TRIM_CONDITIONS,
    VALID,
    Floats,
)
from mavdiag.monitors.fitting import of_each, three
from mavdiag.monitors.spec import Positive, spec
from mavdiag.rows.block import ALL
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, Signal, Three

MOST_RISE = rise_of(MOST_LOSS)
WINDOW_S = 5.0  # our choice; 3.5 s works as well on the recorded flights
TICK_S, PART_S = 0.5, 0.1  # a value twice a second, of parts longer than a rotor's lag (our choices)
# G, of hover: where a turn takes so much its tick counts half. In the loop the law errs by a fifth (ArduCopter) and a
# sixth (PX4, which steps its heading) of what a turn takes: here by 0.004, as a tick scatters anyway (our choice).
TURN_TRIM = 0.02
# What is held of b1 [1/(rad/s)] and b2 [1/(rad/s^2)] before any flight, and its standard deviation. b2 is I_zz over
# weight and drag arm of the rotors, 0.04 for a QDrone 2 and an ArduCopter of 3 kg; b1 is 0.11 for the latter.
PRIOR, PRIOR_SD = np.array([0.0, 0.04]), np.array([0.1, 0.04])
UNKNOWN = (YAW_FLOOR, YAW_FLOOR, YAW_FLOOR)  # spreads before any were learnt

Spec = TypeVar("Spec", bound="TrimSpec")


@spec
class TrimSpec:
    """What every fit of the trim holds.

    layout: where the rotors are.
    source: where the trim comes from: the motors' outputs, or the torque commands over the thrust.
    mean: healthy roll, pitch and yaw trim [fraction of hover].
    spread: of the 5 s means of roll, pitch and yaw trim [fraction of hover].
    turn: b1 and b2, the yaw trim that a yaw rate of 1 rad/s and a yaw acceleration of 1 rad/s^2 take.
    window_s: length of the means [s].
    Raises InputError if the layout gives no trim of that source.
    """

    kind: str
    layout: RotorLayout
    source: Source
    mean: Three = (0.0, 0.0, 0.0)
    turn: tuple[float, float] = (0.0, 0.0)
    spread: tuple[Positive, Positive, Positive]
    window_s: Positive = WINDOW_S

    def __post_init__(self) -> None:
        if self.source == "torque" and self.layout.torque_gain is None:
            lacking = f"what a torque command does to the motors of {self.layout.name}"
            raise InputError(f"{self.kind}: {lacking} is not known")


# Places in the parameters: 1 for torque commands, how many rotors; parts of a tick, rows of a part, row period, ticks
# of a window; of the spec turn, mean and spread; gains of torque commands; what a monitor has of its own; the unmixing
# C, (3, rotors).
TORQUES, ROTORS, PARTS, ROWS, DT, WINDOW, TURN, MEAN, SPREAD, GAIN, OWN, UNMIXING = *range(7), 8, 11, 14, 17, 21
# And in the memory: rows of the tick, known ones, whether a trim changed, the first one; usable ticks in a row, ticks
# so far, weight of the last; what a monitor has of its own; then the parts, the last two of the tick before in front.
ROW, KNOWN, MOVED, FIRST, RUN, TICKS, WEIGHT, MINE, SUMS = 0, 1, 2, 3, 6, 7, 8, 9, 20


@jit
def found_at(par: FloatArray) -> int:
    """Where the parts of the last tick stand: of each trim, lean, yaw rate and acceleration."""
    return SUMS + 6 * (int(par[PARTS]) + 2) + int(par[PARTS])


@jit
def _ring_at(par: FloatArray) -> int:
    """Where the ticks of two windows stand: trim less what the turn takes, lean, both times the weight; weight."""
    return found_at(par) + 7 * int(par[PARTS])


@jit
def _trim(par: FloatArray, x: FloatArray, i: int, axis: int) -> float:
    """Trim of a row [fraction of hover], not finite where it is unknown (`airframe.trim.trim_of`)."""
    if par[TORQUES] > 0.5:
        if not x[THRUST, i] > MIN_OUTPUT:
            return math.nan
        return float(x[TORQUE + axis, i] * par[GAIN + axis] / x[THRUST, i])
    rotors, level, found = int(par[ROTORS]), 0.0, 0.0
    if x.shape[0] < OUTPUTS + rotors:
        return math.nan
    for rotor in range(rotors):
        level += x[OUTPUTS + rotor, i]
    level /= rotors
    if not level > MIN_OUTPUT:
        return math.nan
    for rotor in range(rotors):
        found += par[UNMIXING + axis * rotors + rotor] * (x[OUTPUTS + rotor, i] / level - 1.0)
    return found


@jit
def take_row(par: FloatArray, mem: FloatArray, x: FloatArray, i: int, valid: bool) -> bool:
    """Take a row; True where it completes a tick, whose parts stand at `found_at`, and `mem[KNOWN]` if it is whole."""
    parts, rows, row = int(par[PARTS]), int(par[ROWS]), int(mem[ROW])
    to = SUMS + 6 * (2 + row // rows)
    roll, pitch, yaw, rate = _trim(par, x, i, 0), _trim(par, x, i, 1), _trim(par, x, i, 2), x[RATE + 2, i]
    if row % rows == 0:
        for j in range(6):
            mem[to + j] = 0.0
    if row == 0:
        mem[KNOWN] = mem[MOVED] = 0.0
        mem[FIRST], mem[FIRST + 1], mem[FIRST + 2] = roll, pitch, yaw
    if valid and math.isfinite(roll + pitch + yaw + rate):
        mem[KNOWN] += 1.0
        mem[to], mem[to + 1], mem[to + 2] = mem[to] + roll, mem[to + 1] + pitch, mem[to + 2] + yaw
        mem[to + 3], mem[to + 4] = mem[to + 3] + x[LEAN, i], mem[to + 4] + x[LEAN + 1, i]
        mem[to + 5] += rate
        if roll != mem[FIRST] or pitch != mem[FIRST + 1] or yaw != mem[FIRST + 2]:
            mem[MOVED] = 1.0
    mem[ROW] = row + 1.0
    if row + 1 < parts * rows:
        return False
    whole = mem[KNOWN] >= parts * rows and mem[MOVED] > 0.5
    mem[ROW], mem[KNOWN] = 0.0, 1.0 if whole else 0.0
    _found(par, mem, whole)
    return True


@jit
def _found(par: FloatArray, mem: FloatArray, whole: bool) -> None:
    """From sums to the parts of a tick; zero where it is not whole.

    The acceleration is the slope from the part before to the part after, so the parts of a tick end one part before its
    last row. Before the first whole tick there is what it begins with.
    """
    parts, rows, out = int(par[PARTS]), int(par[ROWS]), found_at(par)
    for j in range(6 * parts):
        mem[SUMS + 12 + j] = mem[SUMS + 12 + j] / rows if whole else math.nan
    for part in range(2):
        for j in range(6 if whole and math.isnan(mem[SUMS + 6 * part + 5]) else 0):
            mem[SUMS + 6 * part + j] = mem[SUMS + 12 + j]
    for part in range(parts):
        for j in range(6):
            mem[out + 7 * part + j] = mem[SUMS + 6 * (part + 1) + j] if whole else 0.0
        slope = (mem[SUMS + 6 * (part + 2) + 5] - mem[SUMS + 6 * part + 5]) / (2 * rows * par[DT])
        mem[out + 7 * part + 6] = slope if whole else 0.0
    for j in range(12):
        mem[SUMS + j] = mem[SUMS + 6 * parts + j]


@jit
def _median(mem: FloatArray, at: int, count: int) -> float:
    """Median of so many values, which are sorted on the way."""
    for i in range(1, count):
        value, j = mem[at + i], i
        while j > 0 and mem[at + j - 1] > value:
            mem[at + j] = mem[at + j - 1]
            j -= 1
        mem[at + j] = value
    return float(0.5 * (mem[at + (count - 1) // 2] + mem[at + count // 2]))


@jit
def take_tick(par: FloatArray, mem: FloatArray, usable: bool) -> None:
    """Put the tick whose parts were found into the windows, without what the turn takes of its yaw trim."""
    parts, found, ring = int(par[PARTS]), found_at(par), _ring_at(par)
    scratch, most = found - parts, 0.0
    to = ring + 6 * (int(mem[TICKS]) % (2 * int(par[WINDOW])))
    for j in range(5):
        for part in range(parts):
            of = found + 7 * part
            taken = par[TURN] * mem[of + 5] + par[TURN + 1] * mem[of + 6]
            most = max(most, abs(taken))
            mem[scratch + part] = mem[of + j] - (taken if j == 2 else 0.0)
        mem[to + j] = _median(mem, scratch, parts)
    weight = 1.0 / (1.0 + (most / TURN_TRIM) ** 2)
    counts = min(weight, mem[WEIGHT]) if mem[TICKS] > 0.0 else weight  # rotors lag
    for j in range(5):
        mem[to + j] *= counts
    mem[to + 5], mem[WEIGHT] = counts, weight
    mem[TICKS] += 1.0
    mem[RUN] = mem[RUN] + 1.0 if usable else 0.0


@jit
def window_mean(par: FloatArray, mem: FloatArray, back: int, j: int) -> float:
    """Weighted mean of trim or lean over the ticks of a window that ended so many ticks ago."""
    window, ring, last = int(par[WINDOW]), _ring_at(par), int(mem[TICKS]) - 1 - back
    found, weight = 0.0, 0.0
    for tick in range(last - window + 1, last + 1):
        at = ring + 6 * (tick % (2 * window))
        found, weight = found + mem[at + j], weight + mem[at + 5]
    return found / weight


@jit
def rise(par: Floats, rotor: int, shift: Floats, tilted: bool) -> float:
    """The rise of one rotor that explains a shift of trim and lean, (5,) (`airframe.trim`). tilted: the lean counts."""
    rotors, more = int(par[ROTORS]), TILT_TRIM**2 * (shift[3] ** 2 + shift[4] ** 2) if tilted else 0.0
    above, below = 0.0, 0.0
    for j in range(3):
        column = par[UNMIXING + j * rotors + rotor]
        weight = column / ((more if j < 2 else 0.0) + par[SPREAD + j] ** 2)
        above, below = above + weight * shift[j], below + weight * column
    return float(above / below)


@jit
def highest_rise(par: Floats, shift: Floats, tilted: bool) -> float:
    """The largest of all rotors."""
    found = -math.inf
    for rotor in range(int(par[ROTORS])):
        found = max(found, rise(par, rotor, shift, tilted))
    return found


@jit
def trace_tick(par: Floats, mem: Floats, out: Floats, k: int) -> None:
    """Of the last tick for a fit: means of its yaw trim, yaw rate and acceleration, usable ticks in a row, window."""
    parts, found = int(par[PARTS]), found_at(par)
    for j in range(3):
        mean = 0.0
        for part in range(parts):
            mean += mem[found + 7 * part + (2 if j == 0 else 4 + j)]
        out[TRACE + j, k] = mean / parts
        out[TRACE + 4 + j, k] = window_mean(par, mem, 0, j) if mem[RUN] >= par[WINDOW] else math.nan
    out[TRACE + 3, k] = mem[RUN]


def tick_shape(dt_s: float) -> tuple[int, int]:
    """Parts of a tick, at least 2, and rows of a part."""
    rows = max(1, round(PART_S / dt_s))
    return max(2, round(TICK_S / (rows * dt_s))), rows


def tick_rows(dt_s: float) -> int:
    """Rows of a tick."""
    return math.prod(tick_shape(dt_s))


def window_ticks(window_s: float, dt_s: float) -> int:
    """Ticks of a window."""
    return max(1, round(window_s / (tick_rows(dt_s) * dt_s)))


def parts_of(flight: Sequence[Rows], layout: RotorLayout, source: Source) -> list[tuple[FloatArray, FloatArray]]:
    """The parts of ticks of each segment as rows that come so seldom: x and flags of `monitors.columns`.

    Their trim stands for torque commands at a thrust of 1, so that `run` makes the same ticks of them as of the rows.
    """
    found = []
    for _, segment in itertools.groupby(flight, key=lambda rows: rows.block.segment):
        parts, rest = list[FloatArray](), np.empty((0, 7))
        for block in (rows.block for rows in segment):
            size, (trim, known) = tick_shape(block.dt_s)[1], trim_of(block, layout, source)
            known = known & np.isfinite(block.rate[:, 2])
            fresh = np.column_stack((trim, tilt_of(block), np.nan_to_num(block.rate[:, 2]), known))
            each = np.asarray(np.concatenate((rest, fresh)), dtype=np.float64)
            n = len(each) // size
            parts.append(each[: n * size].reshape(n, size, 7).mean(axis=1))
            rest = each[n * size :]
        columns = np.concatenate(parts).T
        x, flags = np.zeros((OUTPUTS, columns.shape[1])), np.ones((3, columns.shape[1]))
        x[TORQUE:THRUST], x[LEAN : LEAN + 2], x[RATE + 2] = columns[:3], columns[3:5], columns[5]
        x[THRUST], flags[VALID] = 1.0, columns[6] > 1.0 - 0.5 / size  # all of its rows are known
        found.append((x, flags))
    return found


def turn_of(flights: Sequence[Sequence[FloatArray]], window: int) -> tuple[float, float]:
    """b1 and b2 of healthy flights, each as `TrimMonitor.walked` gives it.

    Means of the ticks about their flight's own, so that no session's offset counts, with `PRIOR` held against them:
    where the nose hardly turned, it stays.
    """
    means = [np.empty((0, 3))]
    for flight in flights:
        runs = [run for segment in flight for run in _unbroken(segment, window)]
        if runs:
            means.append(np.concatenate(runs) - np.concatenate(runs).mean(axis=0))
    yaw, turning = np.concatenate(means)[:, 0], np.concatenate(means)[:, 1:]
    turn, trust = PRIOR, np.diag(PRIOR_SD**-2.0)
    for _ in range(3):  # the noise is what the law before leaves; the ticks of a window count as one
        noise = max(float(np.square(yaw - turning @ turn).sum()) / max(len(yaw), 1), YAW_FLOOR**2) * window
        turn = np.linalg.solve(turning.T @ turning / noise + trust, turning.T @ yaw / noise + trust @ PRIOR)
    return float(turn[0]), float(turn[1])


def _unbroken(segment: FloatArray, least: int) -> list[FloatArray]:
    """Yaw trim, yaw rate and acceleration of runs of usable ticks, (n, 3) each, of at least so many."""
    ticks = segment[TRACE : TRACE + 4, segment[TRACE + 3] > 0].T
    runs = np.split(ticks, np.flatnonzero(ticks[1:, 3] == 1) + 1)
    return [run[:, :3] for run in runs if len(run) >= least]


def windows_of(flight: Sequence[FloatArray]) -> FloatArray:
    """Roll, pitch and yaw trim of all full windows of a flight, (k, 3)."""
    windows = np.concatenate([np.empty((3, 0)), *(segment[TRACE + 4 : TRACE + 7] for segment in flight)], axis=1).T
    return np.asarray(windows[np.isfinite(windows[:, 0])], dtype=np.float64)


def mean_of(flights: Sequence[Sequence[FloatArray]]) -> Three:
    """Mean over flights of their mean trims. Raises IdentificationError if none has a full window."""
    means = [windows.mean(axis=0) for windows in map(windows_of, flights) if len(windows)]
    if not means:
        raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight to average the trim over; fly longer")
    return three(np.mean(means, axis=0))


class TrimMonitor(Monitor[Spec]):
    """A monitor of the trim; its `rotors` are the rises that would explain a shift."""

    needs = frozenset({Signal.ACTUATOR, Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT})
    depends = TRIM_CONDITIONS
    evidence = RotorEvidence(10.0, relative=True, direct=False)  # a lead of 0.12 was right in each of 35 recorded cuts
    needs_layout = True
    unit = "fraction of hover"
    reach = MOST_RISE  # the rise of a rotor that lost a third of its thrust

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[Spec, ...]:
        """What a turn takes, mean over flights of their mean trims, and the spread about it or about the reference."""
        layout, dt_s = context.layout, context.dt_s
        source = source_among(of_each(flights, layout, lambda flight: sources_of(flight, layout)), layout)
        parts = of_each(flights, (layout, source), lambda flight: parts_of(flight, layout, source))
        still = cls(cls.spec_type(layout=layout, source=source, spread=UNKNOWN))
        turn = turn_of([still.walked(flight, dt_s) for flight in parts], window_ticks(WINDOW_S, dt_s))
        turned = cls(replace(still.spec, turn=turn))
        walked = [turned.walked(flight, dt_s) for flight in parts]
        mean = mean_of(walked)
        return (replace(turned.spec, mean=mean, spread=cls.spread_of(walked, mean)),)

    @classmethod
    @abstractmethod
    def spread_of(cls, flights: Sequence[Sequence[FloatArray]], mean: Three) -> Three:
        """Spread of what it judges of healthy flights, each as `walked` gives it. Raises IdentificationError."""

    def walked(self, flight: Sequence[tuple[FloatArray, FloatArray]], dt_s: float) -> list[FloatArray]:
        """What `run` writes of each segment of a flight's parts, with the figures of `trace_tick` and 3 of its own."""
        part_s, found = tick_shape(dt_s)[1] * dt_s, []
        par = self.parameters(part_s)
        par[TORQUES], par[GAIN : GAIN + 3] = 1.0, 1.0
        for x, flags in flight:
            n = x.shape[1]
            out, rotors, at = np.zeros((TRACE + 10, n)), np.empty((n, self.rotors)), np.empty(n, dtype=np.int64)
            count = self.run(par, self.memory(part_s), x, flags, 0, out, rotors, at)
            found.append(out[:, :count].copy())
        return found

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[Spec, float]:
        """With the trim of the new propellers; how much it varies stays."""
        return replace(self.spec, mean=self._mean(flights)), 1.0

    def extended(self, flights: Flights, sessions: int) -> Spec:
        """With the mean over sessions, the new one among them."""
        mean = np.array(self.spec.mean)
        return replace(self.spec, mean=three(mean + (np.array(self._mean(flights)) - mean) / (sessions + 1)))

    def _mean(self, flights: Flights) -> Three:
        dt_s, spec = next((rows.block.dt_s for flight in flights for rows in flight), TICK_S), self.spec
        return mean_of([self.walked(parts_of(flight, spec.layout, spec.source), dt_s) for flight in flights])

    def period_s(self, dt_s: float) -> float:
        """A tick [s]."""
        return tick_rows(dt_s) * dt_s

    def own(self, tick_s: float) -> tuple[float, float, float, float]:
        """What the monitor reads of its own (`OWN`)."""
        return 0.0, 0.0, 0.0, 0.0

    def parameters(self, dt_s: float) -> FloatArray:
        """See `UNMIXING`."""
        spec, layout = self.spec, self.spec.layout
        head = [spec.source == "torque", layout.rotors, *tick_shape(dt_s), dt_s, window_ticks(spec.window_s, dt_s)]
        gain = layout.torque_gain or (0.0, 0.0, 0.0)
        learnt = [*spec.turn, *spec.mean, *spec.spread, *gain, *self.own(self.period_s(dt_s))]
        return np.array([*head, *learnt, *layout.unmixing.ravel()])

    def memory(self, dt_s: float) -> FloatArray:
        """No row yet."""
        parts = tick_shape(dt_s)[0]
        mem = np.zeros(SUMS + 6 * (parts + 2) + 8 * parts + 12 * window_ticks(self.spec.window_s, dt_s))
        mem[SUMS : SUMS + 12] = np.nan
        return mem

    @property
    def signals(self) -> frozenset[Signal]:
        """The outputs, or torque and thrust."""
        return SIGNALS[self.spec.source]

    def columns(self, signal: Signal) -> slice:
        """Of the outputs those that move a rotor."""
        return slice(0, self.spec.layout.rotors) if signal is Signal.ACTUATOR else ALL

    @property
    def memory_s(self) -> float:
        """Its window, and the tick before it [s]."""
        return self.spec.window_s + TICK_S
