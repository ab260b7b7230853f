"""The unbalance monitor: how much unbalance turns with the rotors, and on which of them it sits.

An unbalanced rotor shakes the airframe once per revolution, with a force U Omega^2 that follows from first principles
(T 3.1.1). That is the strong evidence for every fault that takes mass off a blade; a crack hardly does.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import allocating, cached, jit, summing
from mavdiag.monitors.base import Feature, Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.columns import FORCE, LEVEL, RATE, SIGNAL, SOUND, TRACE, VALID, VALUE, Floats, Ints
from mavdiag.monitors.fitting import of_each, traced
from mavdiag.monitors.spec import Positive, spec
from mavdiag.monitors.vibration_band import CORNER_HZ, carries_line, corner_of
from mavdiag.rows.block import ALL
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import highpass
from mavdiag.telemetry import FloatArray, Signal
from mavdiag.thresholds.rule import Prior
from mavdiag.units import G_MM_PER_KG_M

FILTER_S = 0.06  # length of the high-pass at 60 Hz, longer at a lower one (our choice); its delay is half of it
TICK_S = 0.02  # a value every 20 ms (our choice)
WINDOW_S = 0.5  # our choice: 83 revolutions at hover; 0.25 to 1 s find the same faults
CLEAR = 3.0  # healthy standard deviations at which a shift counts half as evidence for a rotor (our choice)
FULL_TURN = 0.5  # share of the power that the turning part must reach to count as fully turning (our choice)
COLUMNS = 4  # products that are averaged


@spec
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
    Raises InputError if there is one of mass and rotor speed alone, or the corner is above half the rate.
    """

    kind: Literal["unbalance"] = "unbalance"
    dt_s: Positive
    corner_hz: Positive
    layout: RotorLayout | None
    covariance: tuple[float, float]
    spread: tuple[Positive, Positive]
    turning: float
    power: Positive
    mass_kg: Positive | None = None
    hover_rad_s: Positive | None = None
    window_s: Positive = WINDOW_S

    def __post_init__(self) -> None:
        if (self.mass_kg is None) != (self.hover_rad_s is None):
            raise InputError("unbalance: mass and rotor speed are known together, or neither is")
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


# Places in the parameters: of each rotor the pattern of its covariances and its sense; then the filter.
TICK, TICKS, SCALE, POWER, TURNING, COVARIANCE_X, COVARIANCE_Y, NOISE, TURNS, ROTORS, LENGTH, PATTERNS = range(12)
# and in the memory: rows so far, valid rows in a row, rows of the tick and its sums, the last filtered x and y; the
# means, and behind them of ax, ay and gz the rows that the filter looks back.
ROW, RUN, OF_TICK, SUMS, LAST_X, LAST_Y, MEAN = 0, 1, 2, 3, 7, 8, 9


@summing
def _convolve(taps: Floats, rows: Floats, out: Floats) -> None:
    """Scalar products of the taps with as many rows, from each row on."""
    for i in range(out.shape[0]):
        found = 0.0
        for k in range(taps.shape[0]):
            found += taps[k] * rows[i + k]
        out[i] = found


@allocating
def _filtered(par: Floats, mem: Floats, x: Floats) -> Floats:
    """ax, ay and gz after the high-pass, (3, n)."""
    n, length, back = x.shape[1], int(par[LENGTH]), int(par[LENGTH]) - 1
    at = MEAN + FRESH + 2 * COLUMNS + int(par[TICKS]) * COLUMNS
    first = PATTERNS + 3 * int(par[ROTORS])
    taps, rows, out = par[first : first + length], np.empty(back + n), np.empty((3, n))
    for signal in range(3):
        rows[:back] = mem[at + signal * back : at + (signal + 1) * back]
        rows[back:] = x[RATE + 2 if signal == 2 else FORCE + signal]
        mem[at + signal * back : at + (signal + 1) * back] = rows[n:]
        _convolve(taps, rows, out[signal])
    return out


@jit
def _advance(par: Floats, mem: Floats, ax: float, ay: float, gz: float, valid: bool) -> bool:
    """Take a filtered row; True where a tick is complete. Its products are then in the means."""
    tick, length = int(par[TICK]), int(par[LENGTH])
    mem[ROW], mem[RUN] = mem[ROW] + 1.0, mem[RUN] + 1.0 if valid else 0.0
    if mem[ROW] < length:
        return False
    last_x, last_y = mem[LAST_X], mem[LAST_Y]
    mem[LAST_X], mem[LAST_Y] = ax, ay
    if mem[ROW] == length:  # the turning part needs the row before
        return False
    mem[SUMS] += ax * ax + ay * ay
    mem[SUMS + 1] += gz * ax
    mem[SUMS + 2] += gz * ay
    mem[SUMS + 3] += last_x * ay - last_y * ax
    mem[OF_TICK] += 1.0
    if mem[OF_TICK] < tick:
        return False
    finite = True
    for column in range(COLUMNS):
        mem[MEAN + FRESH + column] = mem[SUMS + column] / tick
        finite = finite and math.isfinite(mem[SUMS + column])
        mem[SUMS + column] = 0.0
    mem[OF_TICK] = 0.0
    push(mem, MEAN, int(par[TICKS]), COLUMNS, finite and mem[RUN] >= tick + length)
    return True


@jit
def _evidence(par: FloatArray, means: FloatArray, rotors: FloatArray, k: int) -> None:
    """Which rotor a shift of the mean products from healthy belongs to, in -1..1."""
    dx, dy = means[1] - par[COVARIANCE_X], means[2] - par[COVARIANCE_Y]
    square = dx * dx + dy * dy
    clear = math.sqrt(square) / (square + par[NOISE])  # strength size^2/(size^2 + noise) over the size
    grown = max(means[0] - par[POWER], 1e-3 * par[POWER])
    turning = min(max((means[3] - par[TURNING]) / (FULL_TURN * grown), -1.0), 1.0)
    for rotor in range(rotors.shape[1]):
        of = PATTERNS + 3 * rotor
        found = clear * (dx * par[of] + dy * par[of + 1])
        if par[TURNS] > 0.5:
            found = (found + clear * math.sqrt(square) * turning * par[of + 2]) / 2
        rotors[k, rotor] = found


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The apparent unbalance at the end of each tick, once there is a window of them."""
    window, k, means, rows = int(par[TICKS]), 0, np.empty(COLUMNS), _filtered(par, mem, x)
    for i in range(x.shape[1]):
        if not _advance(par, mem, rows[0, i], rows[1, i], rows[2, i], flags[VALID, i] > 0.5):
            continue
        if mem[ROW] < par[LENGTH] + window * par[TICK]:
            continue
        for column in range(COLUMNS):
            means[column] = total(mem, MEAN, COLUMNS, column) / window
            if out.shape[0] > TRACE:
                out[TRACE + column, k] = means[column]
        power = max(means[0], 0.0)
        _evidence(par, means, rotors, k)
        out[VALUE, k] = out[SIGNAL, k] = par[SCALE] * math.sqrt(power)
        out[LEVEL, k] = par[SCALE] * math.sqrt(max(power - par[POWER], 0.0))
        out[SOUND, k], at[k] = mem[MEAN + 1] >= window, i
        k += 1
    return k


class Unbalance(Monitor[UnbalanceSpec]):
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
    prior = Prior(session=0.25, flight=0.05, block=0.05)  # another session's propellers: emulated 0.03 to 0.3
    evidence = RotorEvidence(8.0)  # the sense of turning and the place agree (1) or do not (0 and below)
    spec_type = UnbalanceSpec

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[UnbalanceSpec, ...]:
        """Healthy vibration, in g mm if the airframe's mass and hover speed are known."""
        if not any(of_each(flights, "felt x and y", _felt)):
            raise InputError("no flight with an accelerometer along x and y")
        before = cls._before(context)
        means = np.concatenate(of_each(flights, before, lambda flight: _means(before, flight)))
        if not len(means):
            raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight; fly longer")
        power, x, y, turning = means.mean(axis=0).tolist()
        spread = means.std(axis=0).tolist()
        if not (power > 0 and spread[1] > 0 and spread[2] > 0):
            raise IdentificationError("gyro or accelerometer are constant; is it a real sensor?")
        return (replace(before, covariance=(x, y), spread=(spread[1], spread[2]), turning=turning, power=power),)

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

    def columns(self, signal: Signal) -> slice:
        """Of the accelerometer its x and y."""
        return slice(0, 2) if signal is Signal.SPECIFIC_FORCE else ALL

    @property
    def memory_s(self) -> float:
        """Its window, its filter, and the rows that wait for a value [s]."""
        return self.spec.window_s + (len(self.spec.taps) + self.spec.tick) * self.spec.dt_s

    def period_s(self, dt_s: float) -> float:
        """A tick [s]."""
        return self.spec.tick * self.spec.dt_s

    def parameters(self, dt_s: float) -> FloatArray:
        """See `PATTERNS`."""
        spec, taps = self.spec, self.spec.taps
        noise = (CLEAR * math.hypot(*spec.spread)) ** 2
        head = [spec.tick, spec.ticks, spec.scale, spec.power, spec.turning, *spec.covariance, noise]
        turns = carries_line(1 / spec.dt_s)
        return np.array([*head, turns, self.rotors, len(taps), *_patterns(spec.layout).ravel(), *taps])

    def memory(self, dt_s: float) -> FloatArray:
        """No row yet."""
        return np.zeros(MEAN + mean_size(self.spec.ticks, COLUMNS) + 3 * (len(self.spec.taps) - 1))

    run = staticmethod(run)


def _patterns(layout: RotorLayout | None) -> FloatArray:
    """Of each rotor the unit vector of its covariances, and its sense of rotation, (rotors, 3)."""
    if layout is None:
        return np.empty((0, 3))
    roll, pitch, yaw = layout.mixing.T  # of thrust: roll ~ -y, pitch ~ x, yaw ~ -s
    # [ cov(gz, ax) ]        [ x_j ]         [  pitch_j ]
    # [ cov(gz, ay) ]  ~ -s_j [ y_j ]  ~ yaw_j [ -roll_j  ]
    pattern = yaw * np.stack((pitch, -roll))
    return np.column_stack(((pattern / np.linalg.norm(pattern, axis=0)).T, -np.sign(yaw)))


def _felt(flight: Sequence[Rows]) -> bool:
    """Whether a flight has an accelerometer along x and y."""
    return any((rows.block.valid & rows.block.known(Signal.SPECIFIC_FORCE, slice(0, 2))).any() for rows in flight)


def _means(spec: UnbalanceSpec, flight: Sequence[Rows]) -> FloatArray:
    """The full window means of a flight, (k, COLUMNS)."""
    found = [one[TRACE:, one[SOUND] > 0.5] for one in traced(Unbalance(spec), flight, COLUMNS)]
    return np.concatenate([np.empty((COLUMNS, 0)), *found], axis=1).T
