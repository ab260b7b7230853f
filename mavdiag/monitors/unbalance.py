"""The unbalance monitor: how much unbalance turns with the rotors, and on which of them it sits.

An unbalanced rotor shakes the airframe once per revolution, with a force U Omega^2 that follows from first principles
(T 3.1.1). That is the strong evidence for every fault that takes mass off a blade; a crack hardly does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import (
    Feature,
    Flights,
    LearnContext,
    Monitor,
    RotorEvidence,
    Summaries,
    Summary,
    segments,
)
from mavdiag.monitors.healthy import joined_moments, moments
from mavdiag.monitors.vibration_band import CORNER_HZ, carries_line, corner_of
from mavdiag.rows.block import ALL, Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import highpass, window_all, window_mean
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal
from mavdiag.thresholds.guard import Guard
from mavdiag.units import G_MM_PER_KG_M

__all__ = ["Unbalance", "UnbalanceSpec", "UnbalanceState", "corner_of"]

FILTER_S = 0.06  # length of the high-pass at 60 Hz, longer at a lower one (our choice); its delay is half of it
TICK_S = 0.02  # a value every 20 ms (our choice)
WINDOW_S = 0.5  # our choice: 83 revolutions at hover; 0.25 to 1 s find the same faults
CLEAR = 3.0  # healthy standard deviations at which a shift counts half as evidence for a rotor (our choice)
FULL_TURN = 0.5  # share of the power that the turning part must reach to count as fully turning (our choice)
COLUMNS = 4  # products that are averaged

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnbalanceSpec:
    """Healthy vibration on one link.

    dt_s: row period [s].
    corner_hz: of the high-pass.
    layout: where the rotors are; None if it is not known.
    covariance: healthy mean of gz ax and gz ay [m/s^2 rad/s].
    spread: standard deviation of their window means [m/s^2 rad/s].
    turning: healthy mean of the turning part ax ay' - ay ax' [(m/s^2)^2].
    power: healthy mean of ax^2 + ay^2 [(m/s^2)^2].
    mass_kg, hover_rad_s: mass, and the rotor speed that carries it; with both the statistic is in g mm, else in m/s^2.
    window_s: length of the means [s].
    Raises InputError if they do not describe a vehicle.
    """

    kind: Literal["unbalance"] = "unbalance"
    dt_s: float
    corner_hz: float
    layout: RotorLayout | None
    covariance: Pair
    spread: Pair
    turning: float
    power: float
    mass_kg: float | None = None
    hover_rad_s: float | None = None
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        known = [one for one in (self.mass_kg, self.hover_rad_s) if one is not None]
        positive = (self.dt_s, self.corner_hz, self.window_s, self.power, *self.spread, *known)
        if not all(math.isfinite(x) and x > 0 for x in positive) or len(known) == 1:
            raise InputError("unbalance: period, corner, window, power, spread and mass with rotor speed, are positive")
        if not all(math.isfinite(x) for x in (*self.covariance, self.turning)):
            raise InputError("unbalance: the healthy covariances must be finite numbers")
        if self.corner_hz * self.dt_s >= 0.5:
            raise InputError(f"unbalance: a corner of {self.corner_hz:g} Hz is above half the rate")

    @property
    def scale(self) -> float:
        """Statistic per m/s^2 of vibration: 1e6 m/Omega^2, or 1 where mass and rotor speed are not known."""
        if self.mass_kg is None or self.hover_rad_s is None:
            return 1.0
        return G_MM_PER_KG_M * self.mass_kg / self.hover_rad_s**2

    @property
    def tick(self) -> int:
        """Rows per value."""
        return max(1, round(TICK_S / self.dt_s))

    @property
    def ticks(self) -> int:
        """Values' worth of rows in the window."""
        return max(1, round(self.window_s / (self.tick * self.dt_s)))

    @property
    def taps(self) -> FloatArray:
        """The high-pass."""
        longer = max(1.0, CORNER_HZ / self.corner_hz) if carries_line(1 / self.dt_s) else 1.0
        return highpass(self.corner_hz * self.dt_s, 2 * max(3, round(FILTER_S * longer / self.dt_s / 2)) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class UnbalanceState:
    """What the next rows need.

    rows, t_ns, valid: (3, h) rows that wait for their filter or tick, (h,) their times and validity.
    ticks, whole: (w, COLUMNS) the window's ticks, and (w,) whether they may be judged.
    """

    rows: FloatArray
    t_ns: IntArray
    valid: BoolArray
    ticks: FloatArray
    whole: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Ticks:
    """Mean products over the window that ends with each tick, (n, COLUMNS), and whether all of it may be judged."""

    t_ns: IntArray
    mean: FloatArray
    full: BoolArray


class Unbalance(Monitor[UnbalanceSpec, UnbalanceState]):
    """Statistic: the apparent unbalance of all rotors together over half a second [g mm].

        U_app = 1e6 m sqrt(mean(ax^2 + ay^2)) / Omega^2        ax, ay above 60 Hz; m, Omega: of the hover trim

    The corner is 0.36 of the rotor's frequency where that is known and lower. Several unbalanced rotors add as squares.
    Without mass and rotor speed it is the vibration itself [m/s^2]. `level` is the part above the healthy one,
    sqrt(U_app^2 - U_healthy^2): the fault's own unbalance. `signal` equals the statistic. `rotors` give its place, in
    -1..1. With the angle of rotor j's force turning by s_j (+1 clockwise from above), it makes the airframe yaw in step
    with itself:
        cov(gz, ax) ~ -s_j x_j,  cov(gz, ay) ~ -s_j y_j,  mean(ax(t-1) ay(t) - ay(t-1) ax(t)) ~ s_j sin(Omega dt)
    after subtracting the airframe's own healthy values. In FRD the signs of the two covariances are, for the QDrone 2,
    1 (+,-), 2 (+,+), 3 (-,-), 4 (-,+) (METHOD section 4 has gz of T's frame, whose z is up). The third, the sense of
    turning, separates neighbours even if gyro and accelerometer are filtered differently by a millisecond, which
    turns the first two by 60 degrees. evidence = (cosine to rotor j + s_j turning)/2, less where the shift is small.

    Warm-up: 60 ms of filter, half a second, unbroken and valid. Latency: 30 ms and the share of the window that lifts
    the mean square over the threshold, (threshold^2 - healthy^2)/fault^2 of it. False alarms: see `thresholds`.
    Blind spots: cracks (0.22 g mm is what a healthy rotor may have); streams that are low-passed; below 400 Hz the line
    is folded into the band above a quarter of the rate, or out of it. The estimate is some percent low for what the
    sensor's own filter takes at 167 Hz.

    >>> from mavdiag.testing import example_context, example_rows
    >>> rng, angle = np.random.default_rng(6), 2 * np.pi * 167 * np.arange(2000) * 0.001
    >>> force, gyro = rng.normal(0, 0.3, (2000, 3)), rng.normal(0, 0.003, (2000, 3))
    >>> context = example_context("qdrone2", 0.001, mass_kg=1.504, hover_rad_s=1047.0)
    >>> monitor = Unbalance(*Unbalance.fit([[example_rows(2000, 0.001, force=force, rate=gyro)]], context))
    >>> force[:, :2] += 2.0 * np.column_stack((np.cos(angle), -np.sin(angle)))   # rotor 2 turns counterclockwise
    >>> gyro[:, 2] += 0.01 * (np.cos(angle) - np.sin(angle))
    >>> _, found = monitor.step(monitor.start(), example_rows(2000, 0.001, force=force, rate=gyro))
    >>> float(found.level[-1].round(1)), int(found.rotors[-1].argmax()) + 1   # 1e6 x 1.504 x 2.0/1047^2 g mm
    (2.7, 2)
    """

    name = "unbalance"
    label = "unbalance"
    phrase = "vibrates {times}x"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE})
    depends = frozenset({Condition.THROTTLE, Condition.HEIGHT})
    guard = Guard(few_sessions=0.2)  # an estimate: another session's propellers may have 0.18 g mm each (T Eq 3.6)
    evidence = RotorEvidence(8.0)  # the sense of turning and the place agree (1) or do not (0 and below)
    spec_type = UnbalanceSpec

    def __init__(self, spec: UnbalanceSpec) -> None:
        super().__init__(spec)
        self._filter = _Filter(spec.taps, spec.tick, spec.ticks)
        self._places = None if spec.layout is None else _Places(spec, spec.layout)

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """Whether the flight has an accelerometer, and the moments of its window means."""
        if not any((rows.block.valid & rows.block.known(Signal.SPECIFIC_FORCE, slice(0, 2))).any() for rows in flight):
            return (np.array([False]), *moments(np.empty((0, COLUMNS))))
        return (np.array([True]), *moments(_means(cls._before(context), flight)))

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[UnbalanceSpec, ...]:
        """Healthy vibration, in g mm if the airframe's mass and hover speed are known."""
        if not any(felt[0] for felt, *_ in summaries):
            raise InputError("no flight with an accelerometer along x and y")
        if not any(count[0] for _, count, *_ in summaries):
            raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight; fly longer")
        found = joined_moments([rest for _, *rest in summaries])
        power, x, y, turning = found.mean.tolist()
        spread = np.sqrt(found.squares / found.count).tolist()
        if not (power > 0 and spread[1] > 0 and spread[2] > 0):
            raise IdentificationError("gyro or accelerometer are constant; is it a real sensor?")
        first = cls._before(context)
        return (replace(first, covariance=(x, y), spread=(spread[1], spread[2]), turning=turning, power=power),)

    @staticmethod
    def _before(context: LearnContext) -> UnbalanceSpec:
        """What is known before any flight. Raises InputError if the link does not carry a rotor's vibration."""
        airframe = context.airframe
        both = airframe.mass_kg is not None and airframe.hover_rad_s is not None
        return UnbalanceSpec(
            dt_s=context.dt_s,
            corner_hz=corner_of(1 / context.dt_s, context.imu_corner_hz, airframe.hover_rad_s),
            layout=airframe.layout,
            covariance=(0.0, 0.0),
            spread=(1.0, 1.0),
            turning=0.0,
            power=1.0,
            mass_kg=airframe.mass_kg if both else None,
            hover_rad_s=airframe.hover_rad_s if both else None,
        )

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[UnbalanceSpec, float]:
        """The vibration of the new propellers, by the same high-pass."""
        (new,) = self.fit(flights, context)
        return replace(new, corner_hz=self.spec.corner_hz), (new.power / self.spec.power) ** 0.5

    @property
    def unit(self) -> str:
        """Unit of the statistic: g mm where mass and rotor speed are known."""
        return "m/s^2" if self.spec.mass_kg is None else "g mm"

    @property
    def feature(self) -> str | None:
        """The unbalance, where it is known in g mm."""
        return None if self.spec.mass_kg is None else Feature.UNBALANCE

    def known(self, block: Block, signal: Signal) -> BoolArray:
        """Of the accelerometer its x and y."""
        return block.known(signal, slice(0, 2) if signal is Signal.SPECIFIC_FORCE else ALL)

    @property
    def memory_s(self) -> float:
        """Its window, its filter, and the rows that wait for a value [s]."""
        return self.spec.window_s + (len(self.spec.taps) + self.spec.tick) * self.spec.dt_s

    def start(self) -> UnbalanceState:
        """No row yet."""
        return _fresh()

    def step(self, state: UnbalanceState, rows: Rows) -> tuple[UnbalanceState, Statistic]:
        """The apparent unbalance every 20 ms, at the time of the newest row that it rests on."""
        spec = self.spec
        state, ticks = self._filter.step(state, rows.block)
        power = ticks.mean[:, 0]
        value = spec.scale * np.sqrt(power)
        level = spec.scale * np.sqrt(np.maximum(power - spec.power, 0.0))
        rotors = np.empty((len(power), 0)) if self._places is None else self._places.evidence(ticks.mean)
        return state, Statistic(ticks.t_ns, spec.tick * spec.dt_s, value, ticks.full, level, value, rotors)


def _fresh() -> UnbalanceState:
    flags = np.empty(0, dtype=np.bool_)
    return UnbalanceState(np.empty((3, 0)), np.empty(0, dtype=np.int64), flags, np.empty((0, COLUMNS)), flags)


class _Filter:
    """Filters, multiplies and averages rows: a tick every `tick` rows, a window of `window` ticks."""

    def __init__(self, taps: FloatArray, tick: int, window: int) -> None:
        self._taps, self._tick, self._window = taps, tick, window

    def step(self, state: UnbalanceState, block: Block) -> tuple[UnbalanceState, _Ticks]:
        """The windows that the next rows complete."""
        tick, window, reach = self._tick, self._window, len(self._taps)
        fresh = np.concatenate((block.force[:, :2], block.rate[:, 2:]), axis=1)
        rows = np.concatenate((state.rows, fresh.T), axis=1)
        t_ns, valid = np.concatenate((state.t_ns, block.t_ns)), np.concatenate((state.valid, block.valid))
        count = max(0, len(t_ns) - reach) // tick  # the filter looks back taps - 1 rows, the turning part one more
        used = count * tick
        ticks, flags = state.ticks, state.whole
        if count:
            products = self._products(rows[:, : used + reach]).reshape(COLUMNS, count, tick)
            fresh = np.add.reduce(products, axis=2).T / tick
            whole = window_all(valid[: used + reach], tick + reach)[::tick]
            if not math.isfinite(float(np.add.reduce(fresh, axis=None))):
                finite = np.isfinite(fresh)
                whole, fresh = whole & finite.all(axis=1), np.where(finite, fresh, 0.0)
            ticks, flags = np.concatenate((ticks, fresh)), np.concatenate((flags, whole))
        ends = t_ns[reach + tick - 1 : reach + used : tick]
        known = max(0, len(ticks) - window + 1)  # at most `count`: the state holds less than a window
        out = _Ticks(ends[count - known :], window_mean(ticks, window), window_all(flags, window))
        return UnbalanceState(rows[:, used:], t_ns[used:], valid[used:], ticks[known:], flags[known:]), out

    def _products(self, rows: FloatArray) -> FloatArray:
        """ax^2 + ay^2, gz ax, gz ay and the turning part of each filtered row but the first, (COLUMNS, n)."""
        x, y, z = (np.correlate(row, self._taps) for row in rows)
        ax, ay, gz = x[1:], y[1:], z[1:]
        out = np.empty((COLUMNS, len(ax)))
        out[0], out[1], out[2], out[3] = ax * ax + ay * ay, gz * ax, gz * ay, x[:-1] * ay - y[:-1] * ax
        return out


class _Places:
    """Which rotor a shift of the products from healthy belongs to."""

    def __init__(self, spec: UnbalanceSpec, layout: RotorLayout) -> None:
        roll, pitch, yaw = layout.mixing.T  # of thrust: roll ~ -y, pitch ~ x, yaw ~ -s
        # [ cov(gz, ax) ]        [ x_j ]         [  pitch_j ]
        # [ cov(gz, ay) ]  ~ -s_j [ y_j ]  ~ yaw_j [ -roll_j  ]
        pattern = yaw * np.stack((pitch, -roll))
        self._pattern = pattern / np.linalg.norm(pattern, axis=0)
        self._sense = -np.sign(yaw)
        self._covariance, self._noise = np.array(spec.covariance), (CLEAR * math.hypot(*spec.spread)) ** 2
        self._power, self._turning = spec.power, spec.turning
        self._turns = carries_line(1 / spec.dt_s)

    def evidence(self, mean: FloatArray) -> FloatArray:
        """(n, COLUMNS) -> (n, rotors), in -1..1."""
        shift = mean[:, 1:3] - self._covariance
        square = np.einsum("nk,nk->n", shift, shift)
        clear = (np.sqrt(square) / (square + self._noise))[:, None]  # strength size^2/(size^2 + noise) over the size
        found: FloatArray = clear * (shift @ self._pattern)
        if not self._turns:
            return found
        grown = np.maximum(mean[:, 0] - self._power, 1e-3 * self._power)
        turning = np.clip((mean[:, 3] - self._turning) / (FULL_TURN * grown), -1.0, 1.0)
        strength = clear * np.sqrt(square)[:, None]
        return np.asarray((found + strength * turning[:, None] * self._sense) / 2, dtype=np.float64)


def _means(spec: UnbalanceSpec, flight: Sequence[Rows]) -> FloatArray:
    """The full window means of a flight, (k, COLUMNS)."""
    found, each = [np.empty((0, COLUMNS))], _Filter(spec.taps, spec.tick, spec.ticks)
    for segment in segments(flight):
        state = _fresh()
        for rows in segment:
            state, ticks = each.step(state, rows.block)
            found.append(ticks.mean[ticks.full])
    return np.concatenate(found)
