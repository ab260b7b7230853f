"""The trim-step monitor: within a flight one rotor came to be commanded more than the minute before.

A session's own offset (battery, propellers, payload) is in the trim from the first second, and a battery that empties
moves it slowly. A blade that breaks moves it at once. So the trim is compared with that of the same flight before.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import (
    SOURCES,
    YAW_FLOOR,
    LargeRise,
    Source,
    rises,
    source_among,
    sources_of,
    spread_of,
    tilt_of,
    trim_of,
)
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import LearnContext, Summaries, Summary, segments
from mavdiag.monitors.trim import WINDOW_S, TrimMonitor, TrimSpec
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import row_max, unbroken, window_sums
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Three
from mavdiag.thresholds.guard import Guard

__all__ = ["TrimStep", "TrimStepSpec", "TrimStepState"]

TICK_S = 0.5  # a value twice a second (our choice)
MEMORY_S = 30.0  # of the reference (our choice)
DRIFT_PER_S = 3e-4  # of hover: no faster does the reference follow. A pack empties some 1e-5 a second (our choice)
HOLD = 0.012  # of hover: the reference waits while a shift is larger, so that a fault is not taken in (our choice)
STRAIGHT_RAD_S = 0.15  # mean yaw rate of a tick that is no turn, whatever the healthy flights had (our choice)
TURN_ROOM = 1.5  # as the envelope has it
UNKNOWN = (YAW_FLOOR, YAW_FLOOR, YAW_FLOOR)  # spreads before any were learnt


@dataclass(frozen=True, slots=True, kw_only=True)
class TrimStepSpec(TrimSpec):
    """How much the trim moves within a healthy flight.

    spread: of the 5 s means of roll, pitch and yaw trim about the reference [fraction of hover].
    turn_rad_s: mean yaw rate over half a second, half more than the healthy flights had; a faster turn is left out.
    memory_s: of the reference [s].
    drift_per_s: largest drift that is followed [fraction of hover a second].
    Raises InputError if they do not describe a vehicle.
    """

    kind: Literal["trim_step"] = "trim_step"
    spread: Three
    turn_rad_s: float = STRAIGHT_RAD_S
    memory_s: float = MEMORY_S
    drift_per_s: float = DRIFT_PER_S

    def __post_init__(self) -> None:
        figures = (*self.spread, self.turn_rad_s, self.window_s, self.memory_s, self.drift_per_s)
        if not all(math.isfinite(x) for x in figures) or min(figures) <= 0:
            raise InputError("trim_step: spread, turn, window, memory and drift must be positive numbers")
        self.check()


@dataclass(frozen=True, slots=True, eq=False)
class TrimStepState:
    """What the next rows need.

    t_ns, rows, known: (h,), (6, h) and (h,) rows of an unfinished tick: trim, commanded roll and pitch, yaw rate.
    ticks: (k, 5) means of the last unbroken ticks, fewer than two windows of them.
    reference: (5,) what the present window is compared with; None before there is one.
    """

    t_ns: IntArray
    rows: FloatArray
    known: BoolArray
    ticks: FloatArray
    reference: FloatArray | None


class TrimStep(TrimMonitor[TrimStepSpec, TrimStepState]):
    """Statistic: the rise of ONE rotor's command against the same flight before [fraction of hover].

        m: trim averaged over 5 s,    a_j: rise of rotor j that explains m - m_ref (`trim`),    statistic = max_j a_j
        m_ref <- m_ref + clip((m(t - 5 s) - m_ref) dt/30 s, +-0.0003 dt)    while both are within 0.012

    m_ref begins as the first 5 s of a flight. What was there from the start does not count, and of a rise of r a second
    only 37 r is seen: a session's offset, a battery, wear. `level` equals the statistic, `signal` is the yaw trim's
    shift, `rotors` are the a_j.

    Warm-up: 10 s of unbroken valid flight without a faster turn than the healthy flights had. Latency: up to 5 s.
    False alarms: see `thresholds`; a payload that is picked up shifts roll and pitch, which count little. Blind spots:
    damage that was there at take-off (the rotor-trim monitor sees it) or grows slowly, and hops shorter than 10 s.

    >>> from mavdiag.airframe.layout import layout_named
    >>> from mavdiag.testing import example_rows
    >>> outputs = np.random.default_rng(3).normal(0.5, 0.02, (4000, 4)) + [0.02, 0.0, 0.0, 0.0]
    >>> outputs[2000:, 1] += 0.05   # rotor 2 breaks after 20 s; rotor 1 was weak from the start
    >>> monitor = TrimStep(TrimStepSpec(layout=layout_named("x"), source="actuator", spread=(0.03, 0.03, 0.01)))
    >>> _, found = monitor.step(monitor.start(), example_rows(4000, 0.01, actuator=outputs))
    >>> [float(x.round(2)) for x in (found.value[20:40].max(), found.value[60])], int(found.rotors[60].argmax()) + 1
    ([0.01, 0.1], 2)
    """

    name = "trim_step"
    label = "trim step"
    phrase = "lost {lost}% thrust"
    guard = Guard(least=0.01)  # half of what the rotor-trim monitor must allow for wind and propellers (our choice)
    spec_type = TrimStepSpec

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """Which sources show a trim, the fastest turn, and by each source the ticks of the flight: (2 t, 8)."""
        layout, shown = context.layout, sources_of(flight, context.layout)
        fastest = max((_turn(rows.block) for rows in flight), default=0.0)
        found = [_gathered(flight, layout, one) if shown[i] else np.empty((0, 8)) for i, one in enumerate(SOURCES)]
        return shown, np.array([fastest]), found[0], found[1]

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[TrimStepSpec, ...]:
        """The spread of healthy shifts within flights."""
        layout, source = context.layout, source_among([one[0] for one in summaries], context.layout)
        fastest = max((float(one[1][0]) for one in summaries), default=0.0)
        first = TrimStepSpec(
            layout=layout, source=source, spread=UNKNOWN, turn_rad_s=max(TURN_ROOM * fastest, STRAIGHT_RAD_S)
        )
        at = 2 + SOURCES.index(source)
        tick_s = max(1, round(TICK_S / context.dt_s)) * context.dt_s
        shifts = [_of_ticks(first, one[at], tick_s) for one in summaries]
        found = np.concatenate([np.empty((0, 3)), *shifts])
        if len(found) == 0:
            raise IdentificationError(f"no unbroken {2 * WINDOW_S:g} s of flight to compare trims in; fly longer")
        return (replace(first, spread=spread_of(found)),)

    def start(self) -> TrimStepState:
        """No row yet."""
        return _start()

    def step(self, state: TrimStepState, rows: Rows) -> tuple[TrimStepState, Statistic]:
        """The best single-rotor rise twice a second."""
        spec, block = self.spec, rows.block
        state, t_ns, means, whole = _ticks(spec.layout, spec.source, state, block)
        state, both, valid = _compared(spec, state, means, whole, _tick(block) * block.dt_s)
        shift = both[:, :3]
        if len(t_ns):
            rise = row_max(rises(shift, spec.layout, spec.spread, both[:, 3:]))
            rotors = rises(shift, spec.layout, spec.spread)
        else:
            rise, rotors = np.empty(0), np.empty((0, spec.layout.rotors))
        period_s = _tick(block) * block.dt_s
        return state, Statistic(t_ns, period_s, rise, valid, rise, shift[:, 2], rotors)


def _start() -> TrimStepState:
    waiting, ticks = np.empty((6, 0)), np.empty((0, 5))
    return TrimStepState(np.empty(0, dtype=np.int64), waiting, np.empty(0, dtype=np.bool_), ticks, None)


def _tick(block: Block) -> int:
    """Rows of a tick."""
    return max(1, round(TICK_S / block.dt_s))


def _gathered(flight: Sequence[Rows], layout: RotorLayout, source: Source) -> FloatArray:
    """The ticks of a flight, (t, 8): their means, whether they are whole, and the number of their segment."""
    found = [np.empty((0, 8))]
    for number, segment in enumerate(segments(flight)):
        state = _start()
        for rows in segment:
            state, _, means, whole = _ticks(layout, source, state, rows.block)
            found.append(np.column_stack((means, whole, np.full(len(means), number))))
    return np.concatenate(found)


def _of_ticks(spec: TrimStepSpec, ticks: FloatArray, tick_s: float) -> FloatArray:
    """The valid shifts of a flight whose ticks were gathered, (k, 3)."""
    found = [np.empty((0, 3))]
    for number in np.unique(ticks[:, 7]):
        part = ticks[ticks[:, 7] == number]
        _, shift, valid = _compared(spec, _start(), part[:, :6], part[:, 6] > 0.5, tick_s)
        found.append(shift[valid, :3])
    return np.concatenate(found)


def _ticks(
    layout: RotorLayout, source: Source, state: TrimStepState, block: Block
) -> tuple[TrimStepState, IntArray, FloatArray, BoolArray]:
    """Time, means (k, 6) and wholeness of each tick that is completed."""
    tick = _tick(block)
    trim, flown = trim_of(block, layout, source)
    t_ns, known = np.concatenate((state.t_ns, block.t_ns)), np.concatenate((state.known, flown))
    rows = np.concatenate((state.rows, np.concatenate((trim.T, tilt_of(block).T, block.rate.T[2:]))), axis=1)
    count = len(t_ns) // tick
    used = count * tick
    waiting = TrimStepState(t_ns[used:], rows[:, used:], known[used:], state.ticks, state.reference)
    if count == 0:
        return waiting, t_ns[:0], np.empty((0, 6)), known[:0]
    whole: BoolArray = np.logical_and.reduceat(known[:used], np.arange(count) * tick)
    means = np.add.reduce(rows[:, :used].reshape(6, count, tick), axis=2).T / tick
    return waiting, t_ns[tick - 1 : used : tick], means, whole


def _compared(
    spec: TrimStepSpec, state: TrimStepState, means: FloatArray, whole: BoolArray, tick_s: float
) -> tuple[TrimStepState, FloatArray, BoolArray]:
    """Shift of trim and tilt, (k, 5), and validity of each of the next ticks."""
    count = len(means)
    if count == 0:
        return state, np.empty((0, 5)), whole
    straight = whole & (np.abs(means[:, 5]) <= spec.turn_rad_s)
    window = max(1, round(spec.window_s / tick_s))
    ticks = np.concatenate((state.ticks, means[:, :5]))
    usable = np.concatenate((np.ones(len(state.ticks), dtype=np.bool_), straight))
    valid = unbroken(usable, 2 * window)[-count:]
    shift, reference = _followed(spec, state.reference, ticks, valid, window, tick_s)
    broken = np.flatnonzero(~usable[-(2 * window - 1) :])
    kept = ticks[-(2 * window - 1) :][(int(broken[-1]) + 1 if len(broken) else 0) :]
    return TrimStepState(state.t_ns, state.rows, state.known, kept, reference), shift, valid


def _followed(
    spec: TrimStepSpec,
    reference: FloatArray | None,
    ticks: FloatArray,
    valid: BoolArray,
    window: int,
    tick_s: float,
) -> tuple[FloatArray, FloatArray | None]:
    """The shift at each of the last ticks, (n, 5), zero where it is not valid, (n,); and the reference after them."""
    count = len(valid)
    shift = np.zeros((count, 5))
    if not np.count_nonzero(valid):
        return shift, reference
    means = window_sums(ticks, window) / window  # of the ticks from each on
    now = np.flatnonzero(valid)
    first = len(ticks) - count + now - window + 1
    recent, before = means[first], means[first - window]
    large = LargeRise(spec.layout, spec.spread, HOLD)
    follow, most = tick_s / spec.memory_s, spec.drift_per_s * tick_s
    ref = before[0].tolist() if reference is None else reference.tolist()
    for i, new, old in zip(now.tolist(), recent.tolist(), before.tolist(), strict=True):
        moved, behind = [a - b for a, b in zip(new, ref, strict=True)], [a - b for a, b in zip(old, ref, strict=True)]
        shift[i] = moved
        if large(moved) or large(behind):
            continue
        steps = [one * follow for one in behind]
        steps[:3] = [min(max(one, -most), most) for one in steps[:3]]
        ref = [a + b for a, b in zip(ref, steps, strict=True)]
    return shift, np.array(ref)


def _turn(block: Block) -> float:
    """Largest mean yaw rate of half a second of valid rows [rad/s]."""
    tick = _tick(block)
    yaw = np.where(block.valid, block.rate[:, 2], 0.0)
    count = len(yaw) // tick
    return float(np.abs(yaw[: count * tick].reshape(count, tick).mean(axis=1)).max(initial=0.0))
