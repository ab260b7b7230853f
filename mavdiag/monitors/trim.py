"""What the two monitors of the trim share: ticks of half a second, what a turn takes of them, and the healthy trim.

    m_yaw = b0 + b1 r + b2 dr/dt

A vehicle whose nose turns has its rotors commanded apart: a steady turn against the drag of its rotation, the start and
the stop of a turn for its inertia. b1 and b2 are fitted to the healthy flights by least squares on means of 5 s, and
what they explain is taken off (REVIEW H1: 5 s means of a real ArduCopter's healthy yaw trim 0.131 -> 0.009).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import SIGNALS, SOURCES, YAW_FLOOR, Source, sources_of, tilt_of, trim_of
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Flights, LearnContext, Monitor, RotorEvidence, Summary, segments
from mavdiag.monitors.healthy import three
from mavdiag.rows.block import ALL, Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import window_sums
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal, Three

MOST_RISE = 0.5  # of hover: a rotor that lost a third of its thrust; with less no output can answer (our choice)
WINDOW_S = 5.0  # our choice; 3.5 s works as well on the recorded flights
TICK_S = 0.5  # a value twice a second (our choice)
# rad/s^2: a tick in which the yaw rate changes faster is left out of its window, and the one after it: a median hides
# the peak that turned the vehicle, and rotors lag (our choice: PX4 steps its heading with 5; the largest 5 s mean in
# health 0.014 -> 0.001). Of a window so large a share must remain (our choice).
STEADY, LEAST_SHARE = 0.8, 0.4
# What is held of b1 [1/(rad/s)] and b2 [1/(rad/s^2)] before any flight, and its standard deviation. b2 is I_zz over
# weight and drag arm of the rotors, 0.04 for a QDrone 2 and an ArduCopter of 3 kg; b1 is 0.11 for the latter.
PRIOR, PRIOR_SD = np.array([0.0, 0.04]), np.array([0.1, 0.04])

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
    end_rate: yaw rate at the end of the tick before [rad/s]; nan if there is none.
    steady: whether that tick was.
    ticks, usable: (k, 6) and (k,) the last ticks, without what a turn takes (`without_turn`).
    """

    t_ns: IntArray
    rows: FloatArray
    known: BoolArray
    end_rate: float
    steady: bool
    ticks: FloatArray
    usable: BoolArray


def start_ticks() -> TickState:
    """No row yet."""
    never = np.empty(0, dtype=np.bool_)
    return TickState(np.empty(0, dtype=np.int64), np.empty((6, 0)), never, np.nan, True, np.empty((0, 6)), never)


def tick_rows(dt_s: float) -> int:
    """Rows of a tick."""
    return max(1, round(TICK_S / dt_s))


def window_ticks(window_s: float, dt_s: float) -> int:
    """Ticks of a window."""
    return max(1, round(window_s / (tick_rows(dt_s) * dt_s)))


def next_ticks(
    layout: RotorLayout, source: Source, state: TickState, block: Block
) -> tuple[TickState, IntArray, FloatArray, BoolArray]:
    """Time, values (k, 8) and wholeness of each tick that is completed.

    Values: trim, lean, yaw rate and acceleration, 1 or 0 whether it and the tick before are steady.

    Values are medians, so that a few wild samples move nothing. A tick in which no trim changes is not whole: in flight
    the outputs stand still for no half second, on a link that repeats itself they do. The acceleration is the
    median of the yaw rate's slopes over 0.2 s, for the median of what follows a slope follows the median of the slopes.
    Steady is a tick that ends with about the yaw rate of the tick before: its second half's median.
    """
    tick = tick_rows(block.dt_s)
    trim, flown = trim_of(block, layout, source)
    flown = flown & np.isfinite(block.rate[:, 2])
    t_ns, known = np.concatenate((state.t_ns, block.t_ns)), np.concatenate((state.known, flown))
    rows = np.concatenate((state.rows, np.concatenate((trim.T, tilt_of(block).T, block.rate.T[2:]))), axis=1)
    count = len(t_ns) // tick
    used = count * tick
    waiting = replace(state, t_ns=t_ns[used:], rows=rows[:, used:], known=known[used:])
    if count == 0:
        return waiting, t_ns[:0], np.empty((0, 8)), known[:0]
    whole: BoolArray = np.logical_and.reduceat(known[:used], np.arange(count) * tick)
    values = rows[:, :used].reshape(6, count, tick)
    whole &= (values[:3] != values[:3, :, :1]).any(axis=(0, 2))
    slopes = np.median(_slopes(values[5], block.dt_s), axis=1)
    ends = np.where(whole, np.median(values[5, :, tick // 2 :], axis=1), np.nan)
    steps = np.nan_to_num(np.diff(ends, prepend=state.end_rate) / (tick * block.dt_s))
    steady = np.concatenate(([state.steady], np.abs(steps) <= STEADY))
    found: FloatArray = np.column_stack((np.median(values, axis=2).T, slopes, steady[1:] & steady[:-1]))
    waiting = replace(waiting, end_rate=float(ends[-1]), steady=bool(steady[-1]))
    return waiting, t_ns[tick - 1 : used : tick], found, whole


def _slopes(rates: FloatArray, dt_s: float) -> FloatArray:
    """Slopes of the yaw rate within each tick, (k, tick) -> (k, m): between means over 0.1 s that lie 0.2 s apart."""
    mean = max(1, round(0.1 / dt_s))
    apart = max(1, min(2 * mean, rates.shape[1] - mean))
    sums = np.cumsum(np.concatenate((np.zeros((len(rates), 1)), rates), axis=1), axis=1)
    means = (sums[:, mean:] - sums[:, :-mean]) / mean
    slopes: FloatArray = (means[:, apart:] - means[:, :-apart]) / (apart * dt_s)
    return slopes


def without_turn(ticks: FloatArray, turn: tuple[float, float]) -> FloatArray:
    """Trim less what the turn takes, lean, and whether they are steady, of ticks as `next_ticks` has them: (k, 6)."""
    yaw = ticks[:, 2] - turn[0] * ticks[:, 5] - turn[1] * ticks[:, 6]
    return np.column_stack((ticks[:, :2], yaw, ticks[:, 3:5], ticks[:, 7]))


def window_means(ticks: FloatArray, window: int) -> tuple[FloatArray, BoolArray]:
    """Mean of the steady ticks of each full window, (k, c + 1) -> (k - window + 1, c), k at least `window`.

    ticks: the last column 1 or 0. And where enough of a window's ticks are steady.
    """
    sums = window_sums(np.column_stack((ticks[:, :-1] * ticks[:, -1:], ticks[:, -1])), window)
    return sums[:, :-1] / np.maximum(sums[:, -1:], 1.0), sums[:, -1] >= LEAST_SHARE * window


def ticks_of(flight: Sequence[Rows], layout: RotorLayout, source: Source) -> FloatArray:
    """The ticks of a flight, (t, 10): as `next_ticks` gives them, whether they are whole, number of their segment."""
    found = [np.empty((0, 10))]
    for number, segment in enumerate(segments(flight)):
        state = start_ticks()
        for rows in segment:
            state, _, ticks, whole = next_ticks(layout, source, state, rows.block)
            found.append(np.column_stack((ticks, whole, np.full(len(ticks), number))))
    return np.concatenate(found)


def unbroken_parts(ticks: FloatArray, least: int) -> list[FloatArray]:
    """Runs of whole ticks of one segment, at least so many each: (t, 10) -> (n, 8) each."""
    whole = ticks[:, 8] > 0.5
    borders = np.flatnonzero((np.diff(ticks[:, 9]) != 0) | (np.diff(whole) != 0)) + 1
    parts = np.split(ticks, borders) if len(ticks) else []
    return [part[:, :8] for part in parts if len(part) >= least and part[0, 8] > 0.5]


def turn_of(flights: Sequence[FloatArray], window: int) -> tuple[float, float]:
    """b1 and b2 of healthy flights, each as `ticks_of` gives it.

    Means of `window` ticks about their flight's own, so that no session's offset counts, with `PRIOR` held against
    them: where the nose hardly turned, it stays.
    """
    means = [np.empty((0, 3))]
    for ticks in flights:
        flown = _windows([part[:, [2, 5, 6, 7]] for part in unbroken_parts(ticks, window)], window)
        if len(flown):
            means.append(flown - flown.mean(axis=0))
    yaw, turning = np.concatenate(means)[:, 0], np.concatenate(means)[:, 1:]
    turn, trust = PRIOR, np.diag(PRIOR_SD**-2.0)
    for _ in range(3):  # the noise is what the law before leaves; overlapping windows count once
        noise = max(float(np.square(yaw - turning @ turn).sum()) / max(len(yaw), 1), YAW_FLOOR**2) * window
        turn = np.linalg.solve(turning.T @ turning / noise + trust, turning.T @ yaw / noise + trust @ PRIOR)
    return float(turn[0]), float(turn[1])


def mean_of(flights: Sequence[FloatArray], turn: tuple[float, float], window: int) -> Three:
    """Mean over flights of their mean trims. Raises IdentificationError if none has a full window."""
    found = [windows_of(ticks, turn, window) for ticks in flights]
    means = [one[:, :3].mean(axis=0) for one in found if len(one)]
    if not means:
        raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight to average the trim over; fly longer")
    return three(np.mean(means, axis=0))


def windows_of(ticks: FloatArray, turn: tuple[float, float], window: int) -> FloatArray:
    """All full windows of a flight's ticks, (k, 5)."""
    return _windows([without_turn(part, turn) for part in unbroken_parts(ticks, window)], window)


def _windows(parts: Sequence[FloatArray], window: int) -> FloatArray:
    """The windows of all parts that may be used."""
    found = [means[enough] for means, enough in (window_means(part, window) for part in parts)]
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
        found = [ticks_of(flight, layout, one) if shown[i] else np.empty((0, 10)) for i, one in enumerate(SOURCES)]
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
        """The state, and the ticks that the next so many windows rest on.

        Time of each fresh tick (n,); all ticks (k, 6), the fresh ones last; which of them may be used, (k,): they are
        whole, and flown as the envelope covers.
        """
        spec, block = self.spec, rows.block
        state, t_ns, fresh, whole = next_ticks(spec.layout, spec.source, state, block)
        ticks = np.concatenate((state.ticks, without_turn(fresh, spec.turn)))
        usable = np.concatenate((state.usable, whole & rows.covered(self.depends, 2 * TICK_S, t_ns)))
        first = max(0, len(ticks) - windows * window_ticks(spec.window_s, block.dt_s) + 1)
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
