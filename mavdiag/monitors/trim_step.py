"""The trim-step monitor: within a flight one rotor came to be commanded more than the minute before.

A session's own offset (battery, propellers, payload) is in the trim from the first second, and a battery that empties
moves it slowly. A blade that breaks moves it at once. So the trim is compared with that of the same flight before.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from mavdiag.airframe.trim import SOURCES, YAW_FLOOR, LargeRise, rises, source_among, spread_of
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import LearnContext, Summaries
from mavdiag.monitors.trim import (
    WINDOW_S,
    TickState,
    TrimMonitor,
    TrimSpec,
    mean_of,
    start_ticks,
    tick_rows,
    turn_of,
    unbroken_runs,
    window_means,
    window_ticks,
    without_turn,
)
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import row_max, unbroken
from mavdiag.telemetry import BoolArray, FloatArray, Three
from mavdiag.thresholds.guard import Guard

MEMORY_S = 30.0  # of the reference (our choice)
DRIFT_PER_S = 3e-4  # of hover: no faster does the reference follow. A pack empties some 1e-5 a second (our choice)
HOLD = 0.012  # of hover: the reference waits while a shift is larger, so that a fault is not taken in (our choice)
HOLD_S = (
    120.0  # of judged flight: no longer does it wait, for what a vehicle has carried so long is its own (our choice)
)
SESSION = 0.06  # of hover: a rise against the healthy trim that a session explains, as rotor_trim's guard has it
UNKNOWN = (YAW_FLOOR, YAW_FLOOR, YAW_FLOOR)  # spreads before any were learnt


@dataclass(frozen=True, slots=True, kw_only=True)
class TrimStepSpec(TrimSpec):
    """How much the trim moves within a healthy flight.

    spread: of the 5 s means of roll, pitch and yaw trim about the reference [fraction of hover].
    memory_s: of the reference [s].
    drift_per_s: largest drift that is followed [fraction of hover a second].
    Raises InputError if they do not describe a vehicle.
    """

    kind: Literal["trim_step"] = "trim_step"
    spread: Three
    memory_s: float = MEMORY_S
    drift_per_s: float = DRIFT_PER_S

    def __post_init__(self) -> None:
        figures = (*self.spread, self.window_s, self.memory_s, self.drift_per_s)
        if not all(math.isfinite(x) for x in figures) or min(figures) <= 0:
            raise InputError("trim_step: spread, window, memory and drift must be positive numbers")
        self.check()


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What the present window is compared with.

    trim: (5,) roll, pitch and yaw trim, commanded roll and pitch [rad].
    back: (3,) from it to where the trim was healthy; zero while that is the reference itself.
    held_s: judged flight since the reference waits [s].
    """

    trim: FloatArray
    back: FloatArray
    held_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TrimStepState:
    """What the next rows need. reference: None before there is one."""

    ticks: TickState
    reference: Reference | None = None


class TrimStep(TrimMonitor[TrimStepSpec]):
    """Statistic: the rise of ONE rotor's command against the same flight before [fraction of hover].

        m: trim averaged over 5 s as rotor_trim has it,    a_j: rise of rotor j that explains m - m_ref (`trim`)
        statistic = max_j a_j
        m_ref <- m_ref + clip((m(t - 5 s) - m_ref) dt/30 s, +-0.0003 dt)    while both are within 0.012

    m_ref begins as the first 5 s of a flight that the envelope covers: ground effect is no reference. What was there
    from the start does not count, and of a rise of r a second only 37 r is seen: a session's offset, a battery, wear.
    A shift that stays for two minutes of judged flight becomes the reference. From then on, and where a flight begins
    with more than a session explains, what leads back to where the trim was healthy does not count: m - m_ref is taken
    from the nearest point of the way there, so that a repair in flight is no fault of the other rotors. `level` equals
    the statistic, `signal` is the yaw trim's shift, `rotors` are the a_j.

    Warm-up: 10 s of unbroken valid flight as the envelope covers it. Latency: up to 5 s.
    False alarms: see `thresholds`; a payload that is picked up shifts roll and pitch, which count little. Blind spots:
    damage that was there at take-off (the rotor-trim monitor sees it) or grows slowly, and hops shorter than 10 s.

    >>> from mavdiag.airframe.layout import layout_named
    >>> from mavdiag.testing import example_rows
    >>> outputs = np.random.default_rng(3).normal(0.5, 0.02, (4000, 4)) + [0.02, 0.0, 0.0, 0.0]
    >>> outputs[2000:, 1] += 0.05   # rotor 2 breaks after 20 s; rotor 1 was weak from the start
    >>> monitor = TrimStep(TrimStepSpec(layout=layout_named("x"), source="actuator", spread=(0.03, 0.03, 0.01)))
    >>> _, found = monitor.step(monitor.start(), example_rows(4000, 0.01, actuator=outputs))
    >>> [float(x.round(2)) for x in (found.value[20:40].max(), found.value[60])], int(found.rotors[60].argmax()) + 1
    ([0.0, 0.1], 2)
    """

    name = "trim_step"
    label = "trim step"
    phrase = "lost {lost}% thrust"
    guard = Guard(least=0.01)  # half of what the rotor-trim monitor must allow for wind and propellers (our choice)
    spec_type = TrimStepSpec

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[TrimStepSpec, ...]:
        """The healthy trim, what a turn takes of it, and the spread of healthy shifts within flights."""
        layout, source = context.layout, source_among([one[0] for one in summaries], context.layout)
        flights, tick_s = [one[1 + SOURCES.index(source)] for one in summaries], tick_rows(context.dt_s) * context.dt_s
        window = window_ticks(WINDOW_S, context.dt_s)
        turn, found = turn_of(flights, window), [np.empty((0, 3))]
        first = TrimStepSpec(layout=layout, source=source, turn=turn, spread=UNKNOWN)
        for run in (run for ticks in flights for run in unbroken_runs(ticks, 2 * window)):
            straight, usable = without_turn(run, turn), np.ones(len(run), dtype=np.bool_)
            shift, valid, _ = _followed(first, None, straight, usable, len(run), tick_s)
            found.append(shift[valid, :3])
        shifts = np.concatenate(found)
        if len(shifts) == 0:
            raise IdentificationError(f"no unbroken {2 * WINDOW_S:g} s of flight to compare trims in; fly longer")
        return (replace(first, mean=mean_of(flights, turn, window), spread=spread_of(shifts)),)

    def parameters(self, dt_s: float) -> FloatArray:
        return np.empty(0)

    def memory(self, dt_s: float) -> FloatArray:
        return np.empty(0)

    def start(self) -> TrimStepState:
        """No row yet."""
        return TrimStepState(start_ticks())

    def judge(self, state: TrimStepState, rows: Rows, columns: Any) -> tuple[TrimStepState, Statistic]:
        """The best single-rotor rise twice a second."""
        spec, dt_s = self.spec, rows.block.dt_s
        tick_s = tick_rows(dt_s) * dt_s
        after, t_ns, ticks, usable = self.taken(state.ticks, rows, 2)
        both, valid, reference = _followed(spec, state.reference, ticks, usable, len(t_ns), tick_s)
        rise = row_max(rises(both[:, :3], spec.layout, spec.spread, both[:, 3:]))
        rotors = rises(both[:, :3], spec.layout, spec.spread)
        found = Statistic(t_ns, tick_s, rise, valid, rise, both[:, 2], rotors)
        return TrimStepState(after, reference), found


def _followed(
    spec: TrimStepSpec, reference: Reference | None, ticks: FloatArray, usable: BoolArray, count: int, tick_s: float
) -> tuple[FloatArray, BoolArray, Reference | None]:
    """The shift at each of the last `count` ticks, (n, 5), zero where not valid, (n,); and the reference after them."""
    window, shift = max(1, round(spec.window_s / tick_s)), np.zeros((count, 5))
    valid = unbroken(usable, 2 * window)[len(ticks) - count :]
    if not np.count_nonzero(valid):
        return shift, valid, reference
    means = window_means(ticks, window)  # of the ticks from each on
    now = np.flatnonzero(valid)
    first = len(ticks) - count + now - window + 1
    large = LargeRise(spec.layout, spec.spread, HOLD)
    follow, most = tick_s / spec.memory_s, spec.drift_per_s * tick_s
    for i, new, old in zip(now.tolist(), means[first], means[first - window], strict=True):
        if reference is None:
            reference = Reference(old, _way_back(spec, old))
        shift[i] = moved = _moved(spec, reference, new)
        behind = old - reference.trim
        if not large(moved.tolist()) and not large(behind.tolist()):
            step = behind * follow
            step[:3] = np.clip(step[:3], -most, most)
            reference = Reference(reference.trim + step, reference.back)
        elif reference.held_s < HOLD_S:
            reference = replace(reference, held_s=reference.held_s + tick_s)
        else:
            reference = Reference(old, reference.back - behind[:3])
    return shift, valid, reference


def _way_back(spec: TrimStepSpec, trim: FloatArray) -> FloatArray:
    """From the first reference of a flight to the healthy trim, (3,): zero where a session explains what is between."""
    beyond = trim[:3] - spec.mean
    return -beyond if rises(beyond[None], spec.layout, spec.spread).max() > SESSION else np.zeros(3)


def _moved(spec: TrimStepSpec, reference: Reference, trim: FloatArray) -> FloatArray:
    """The shift from the nearest point of the way from the reference back to health, (5,)."""
    moved, weighed = trim - reference.trim, reference.back / np.square(spec.spread)
    length = float(weighed @ reference.back)
    if length > 0:
        moved[:3] -= min(max(float(weighed @ moved[:3]) / length, 0.0), 1.0) * reference.back
    return moved
