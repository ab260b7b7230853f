"""What the two monitors of the trim share: ticks of half a second, what a turn takes of them, and the healthy trim.

    g = b1 r + b2 dr/dt,    tick = median over its parts of m_yaw - g,    weight = 1/(1 + (max |g|/G)^2)

A vehicle whose nose turns has its rotors commanded apart: a steady turn against the drag of its rotation, the start and
the stop of a turn for its inertia. A tick has five parts of 0.1 s, and g is taken off each of them: means of both sides
obey the law however fast the nose turns, medians would not. The median then hides a few wild samples. b1 and b2 are
fitted to the ticks of the healthy flights by least squares (REVIEW H1: 5 s means of a real ArduCopter's healthy yaw
trim 0.131 -> 0.009). The law errs by a share of g, so a window is the mean of its ticks weighted as above, where the
tick before counts too, for rotors lag. Nothing here depends much on when a tick begins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import (
    MOST_LOSS,
    SIGNALS,
    SOURCES,
    YAW_FLOOR,
    Source,
    rise_of,
    sources_of,
    tilt_of,
    trim_of,
)
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Flights, LearnContext, Monitor, RotorEvidence, Summary, segments
from mavdiag.monitors.healthy import three
from mavdiag.rows.block import ALL, Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import window_sums
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal, Three

MOST_RISE = rise_of(MOST_LOSS)
WINDOW_S = 5.0  # our choice; 3.5 s works as well on the recorded flights
TICK_S, PART_S = 0.5, 0.1  # a value twice a second, of parts longer than a rotor's lag (our choices)
# G, of hover: where a turn takes so much its tick counts half. In the loop the law errs by a fifth (ArduCopter) and a
# sixth (PX4, which steps its heading) of what a turn takes: here by 0.004, as a tick scatters anyway (our choice).
TURN_TRIM = 0.02
# What is held of b1 [1/(rad/s)] and b2 [1/(rad/s^2)] before any flight, and its standard deviation. b2 is I_zz over
# weight and drag arm of the rotors, 0.04 for a QDrone 2 and an ArduCopter of 3 kg; b1 is 0.11 for the latter.
PRIOR, PRIOR_SD = np.array([0.0, 0.04]), np.array([0.1, 0.04])
NO_TICKS = np.empty((0, 2, 8))

State = TypeVar("State")
Spec = TypeVar("Spec", bound="TrimSpec")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrimSpec:
    """What every fit of the trim holds.

    layout: where the rotors are.
    source: where the trim comes from: the motors' outputs, or the torque commands over the thrust.
    mean: healthy roll, pitch and yaw trim [fraction of hover].
    turn: b1 and b2, the yaw trim that a yaw rate of 1 rad/s and a yaw acceleration of 1 rad/s^2 take.
    window_s: length of the means [s].
    """

    kind: str
    layout: RotorLayout
    source: Source
    mean: Three = (0.0, 0.0, 0.0)
    turn: tuple[float, float] = (0.0, 0.0)
    window_s: float = WINDOW_S

    def check(self) -> None:
        """Raises InputError if the layout gives no trim of that source, or a figure is no number."""
        if self.source == "torque" and self.layout.torque_gain is None:
            lacking = f"what a torque command does to the motors of {self.layout.name}"
            raise InputError(f"{self.kind}: {lacking} is not known")
        if not np.isfinite([*self.mean, *self.turn]).all():
            raise InputError(f"{self.kind}: the healthy trim and what a turn takes of it must be finite")


@dataclass(frozen=True, slots=True, eq=False)
class TickState:
    """What the next rows need.

    t_ns, rows, known: (h,), (6, h) and (h,) rows of an unfinished tick: trim, commanded roll and pitch, yaw rate.
    parts: (2, 6) their means in the last two parts of the tick before; nan if there is none.
    ticks, usable: (k, 6) and (k,) the last ticks, without what a turn takes (`without_turn`).
    """

    t_ns: IntArray
    rows: FloatArray
    known: BoolArray
    parts: FloatArray
    ticks: FloatArray
    usable: BoolArray


def start_ticks() -> TickState:
    """No row yet."""
    never = np.empty(0, dtype=np.bool_)
    before = np.full((2, 6), np.nan)
    return TickState(np.empty(0, dtype=np.int64), np.empty((6, 0)), never, before, np.empty((0, 6)), never)


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


def next_ticks(
    layout: RotorLayout, source: Source, state: TickState, block: Block
) -> tuple[TickState, IntArray, FloatArray, BoolArray]:
    """Time, parts (k, p, 7) and wholeness of each tick that is completed.

    Of a part: trim, lean, yaw rate and acceleration, means over 0.1 s; zero where the tick is not whole.

    The acceleration is the slope from the part before to the part after, so the parts of a tick end one part before its
    last row. A tick in which no trim changes is not whole: in flight the outputs stand still for no half second, on a
    link that repeats itself they do.
    """
    (count, size), tick = tick_shape(block.dt_s), tick_rows(block.dt_s)
    trim, flown = trim_of(block, layout, source)
    flown = flown & np.isfinite(block.rate[:, 2])
    t_ns, known = np.concatenate((state.t_ns, block.t_ns)), np.concatenate((state.known, flown))
    rows = np.concatenate((state.rows, np.concatenate((trim.T, tilt_of(block).T, block.rate.T[2:]))), axis=1)
    ticks = len(t_ns) // tick
    used = ticks * tick
    waiting = replace(state, t_ns=t_ns[used:], rows=rows[:, used:], known=known[used:])
    if ticks == 0:
        return waiting, t_ns[:0], np.empty((0, count, 7)), known[:0]
    whole: BoolArray = np.logical_and.reduceat(known[:used], np.arange(ticks) * tick)
    values = rows[:, :used].reshape(6, ticks, tick)
    whole &= (values[:3] != values[:3, :, :1]).any(axis=(0, 2))
    means = values.reshape(6, ticks, count, size).mean(axis=3).transpose(1, 2, 0)
    means[~whole] = np.nan
    parts = np.concatenate((np.concatenate((state.parts[None], means[:-1, -2:])), means), axis=1)
    parts = np.where(np.isnan(parts), means[:, :1], parts)  # before the first whole tick there is what it begins with
    slopes = (parts[:, 2:, 5:] - parts[:, :-2, 5:]) / (2 * size * block.dt_s)
    found = np.nan_to_num(np.concatenate((parts[:, 1:-1], slopes), axis=2))
    return replace(waiting, parts=means[-1, -2:]), t_ns[tick - 1 : used : tick], found, whole


def without_turn(parts: FloatArray, turn: tuple[float, float]) -> FloatArray:
    """Trim less what the turn takes, lean, and weight, of ticks as `next_ticks` has it: (k, p, 7) -> (k, 6)."""
    taken = turn[0] * parts[:, :, 5] + turn[1] * parts[:, :, 6]
    straight = np.concatenate((parts[:, :, :2], (parts[:, :, 2] - taken)[:, :, None], parts[:, :, 3:5]), axis=2)
    weight = 1.0 / (1.0 + np.square(np.abs(taken).max(axis=1) / TURN_TRIM))
    return np.column_stack((np.median(straight, axis=1), weight))


def window_means(ticks: FloatArray, window: int) -> FloatArray:
    """Weighted mean of the ticks of each full window, (k, 6) -> (k - window + 1, 5), k at least `window`.

    A tick has the weight of the tick before it, where that is less.
    """
    weight = np.minimum(ticks[:, 5], np.concatenate((ticks[:1, 5], ticks[:-1, 5])))[:, None]
    sums = window_sums(np.concatenate((ticks[:, :5] * weight, weight), axis=1), window)
    means: FloatArray = sums[:, :5] / sums[:, 5:]
    return means


def ticks_of(flight: Sequence[Rows], layout: RotorLayout, source: Source) -> FloatArray:
    """The ticks of a flight, (t, p, 8): parts as `next_ticks` gives them, number of their segment, -1 if not whole."""
    found = [np.empty((0, tick_shape(rows.block.dt_s)[0], 8)) for rows in flight[:1]]
    for number, segment in enumerate(segments(flight)):
        state = start_ticks()
        for rows in segment:
            state, _, parts, whole = next_ticks(layout, source, state, rows.block)
            place = np.where(whole, float(number), -1.0)[:, None, None]
            found.append(np.concatenate((parts, np.broadcast_to(place, (*parts.shape[:2], 1))), axis=2))
    return np.concatenate(found) if found else NO_TICKS


def unbroken_runs(ticks: FloatArray, least: int) -> list[FloatArray]:
    """Runs of whole ticks of one segment, at least so many each: (t, p, 8) -> (n, p, 7) each."""
    if len(ticks) == 0:
        return []
    runs = np.split(ticks, np.flatnonzero(np.diff(ticks[:, 0, 7])) + 1)
    return [run[:, :, :7] for run in runs if len(run) >= least and run[0, 0, 7] >= 0]


def turn_of(flights: Sequence[FloatArray], window: int) -> tuple[float, float]:
    """b1 and b2 of healthy flights, each as `ticks_of` gives it.

    Means of the ticks about their flight's own, so that no session's offset counts, with `PRIOR` held against them:
    where the nose hardly turned, it stays.
    """
    means = [np.empty((0, 3))]
    for ticks in flights:
        runs = [run[:, :, [2, 5, 6]].mean(axis=1) for run in unbroken_runs(ticks, window)]
        if runs:
            means.append(np.concatenate(runs) - np.concatenate(runs).mean(axis=0))
    yaw, turning = np.concatenate(means)[:, 0], np.concatenate(means)[:, 1:]
    turn, trust = PRIOR, np.diag(PRIOR_SD**-2.0)
    for _ in range(3):  # the noise is what the law before leaves; the ticks of a window count as one
        noise = max(float(np.square(yaw - turning @ turn).sum()) / max(len(yaw), 1), YAW_FLOOR**2) * window
        turn = np.linalg.solve(turning.T @ turning / noise + trust, turning.T @ yaw / noise + trust @ PRIOR)
    return float(turn[0]), float(turn[1])


def mean_of(flights: Sequence[FloatArray], turn: tuple[float, float], window: int) -> Three:
    """Mean over flights of their mean trims. Raises IdentificationError if none has a full window."""
    found = [windows_of(ticks, turn, window) for ticks in flights]
    means = [flown[:, :3].mean(axis=0) for flown in found if len(flown)]
    if not means:
        raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight to average the trim over; fly longer")
    return three(np.mean(means, axis=0))


def windows_of(ticks: FloatArray, turn: tuple[float, float], window: int) -> FloatArray:
    """All full windows of a flight's ticks, (k, 5)."""
    found = [window_means(without_turn(run, turn), window) for run in unbroken_runs(ticks, window)]
    return np.concatenate(found) if found else np.empty((0, 5))


class TrimMonitor(Monitor[Spec]):
    """A monitor of the trim; its `rotors` are the rises that would explain a shift."""

    needs = frozenset({Signal.ACTUATOR, Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT})
    depends = frozenset({Condition.TILT, Condition.THROTTLE, Condition.YAW_RATE, Condition.HEIGHT})
    evidence = RotorEvidence(10.0, relative=True, direct=False)  # a lead of 0.12 was right in each of 35 recorded cuts
    needs_layout = True
    unit = "fraction of hover"

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """Which sources show a trim, and by each of them the ticks of the flight."""
        layout, shown = context.layout, sources_of(flight, context.layout)
        found = [ticks_of(flight, layout, one) if shown[i] else NO_TICKS for i, one in enumerate(SOURCES)]
        return shown, found[0], found[1]

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[Spec, float]:
        """With the trim of the new propellers; how much it varies stays."""
        return replace(self.spec, mean=self._mean(flights)), 1.0

    def extended(self, flights: Flights, sessions: int) -> Spec:
        """With the mean over sessions, the new one among them."""
        mean = np.array(self.spec.mean)
        return replace(self.spec, mean=three(mean + (np.array(self._mean(flights)) - mean) / (sessions + 1)))

    def _mean(self, flights: Flights) -> Three:
        dt_s = next((rows.block.dt_s for flight in flights for rows in flight), TICK_S)
        ticks = [ticks_of(flight, self.spec.layout, self.spec.source) for flight in flights]
        return mean_of(ticks, self.spec.turn, window_ticks(self.spec.window_s, dt_s))

    def taken(self, state: TickState, rows: Rows, windows: int) -> tuple[TickState, IntArray, FloatArray, BoolArray]:
        """The state, and the ticks that the next so many windows rest on, and the one before them.

        Time of each fresh tick (n,); all ticks (k, 6), the fresh ones last; which of them may be used, (k,): they are
        whole, and flown as the envelope covers.
        """
        spec, block = self.spec, rows.block
        state, t_ns, fresh, whole = next_ticks(spec.layout, spec.source, state, block)
        ticks = np.concatenate((state.ticks, without_turn(fresh, spec.turn)))
        usable = np.concatenate((state.usable, whole & rows.covered(self.depends, 2 * TICK_S, t_ns)))
        first = max(0, len(ticks) - windows * window_ticks(spec.window_s, block.dt_s))
        return replace(state, ticks=ticks[first:], usable=usable[first:]), t_ns, ticks, usable

    @property
    def signals(self) -> frozenset[Signal]:
        """The outputs, or torque and thrust."""
        return SIGNALS[self.spec.source]

    def known(self, block: Block, signal: Signal) -> BoolArray:
        """Of the outputs those that move a rotor."""
        return block.known(signal, slice(0, self.spec.layout.rotors) if signal is Signal.ACTUATOR else ALL)

    @property
    def reach(self) -> float:
        """The rise of a rotor that lost a third of its thrust."""
        return MOST_RISE

    @property
    def memory_s(self) -> float:
        """Its window, and the tick before it [s]."""
        return self.spec.window_s + TICK_S
