"""The unbalance monitor: an unbalanced rotor shakes the airframe once per revolution, by U Omega^2 (T 3.1.1)."""

import math
from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import ALONG_DISCS, felt_share
from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import allocating, cached, jit
from mavdiag.monitors.base import SLACK, Begin, Feature, Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.fitting import of_each, traced
from mavdiag.monitors.spec import Period, Positive, Span, spec
from mavdiag.rows.block import FORCE, LEVEL, RATE, SOUND, TRACE, VALID, VALUE, Floats, Ints
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import highpass
from mavdiag.telemetry import FloatArray, Signal
from mavdiag.units import G_MM_PER_KG_M

FILTER_S = 0.06  # length of the high-pass at 60 Hz, longer at a lower one (our choice); its delay is half of it
TICK_S = 0.02  # a value every 20 ms (our choice)
WINDOW_S = 0.5  # our choice: 83 revolutions at hover; 0.25 to 1 s find the same faults
CLEAR = 3.0  # healthy standard deviations at which a shift counts half as evidence for a rotor (our choice)
FULL_TURN = 0.5  # share of the power that the turning part must reach to count as fully turning (our choice)
COLUMNS = 4  # products that are averaged
CORNER_HZ = 60.0  # METHOD section 4
CORNER_SHARE = 0.36  # of the rotor's frequency, where that is lower: 60 Hz at the thesis's 167 Hz (our choice)
FOLDED_HZ = 25.0  # corner where the stream is too slow for the line itself: above it no flight moves (our choice)
FULL_RATE_HZ = 400.0  # from here on the line at one per revolution is seen as it is (METHOD section 4)
LEAST_RATE_HZ = 100.0  # below it nothing above the flight's own motion is left (METHOD section 4)
# Places in the parameters: of each rotor the pattern of its covariances and its sense; then the filter. And in the
# memory: rows so far, valid rows in a row, rows of the tick and its sums, the last filtered x and y; the means.
TICK, TICKS, SCALE, POWER, TURNING, COVARIANCE_X, COVARIANCE_Y, NOISE, TURNS, LENGTH, PATTERNS = range(11)
ROW, RUN, OF_TICK, SUMS, LAST_X, LAST_Y, MEAN = 0, 1, 2, 3, 7, 8, 9


def corner_of(rate_hz: float, imu_corner_hz: float | None = None, hover_rad_s: float | None = None) -> float:
    """Corner of the high-pass on a link [Hz]. rate_hz: of the IMU stream; imu_corner_hz: of the low-pass in it, None if
    there is none; hover_rad_s: rotor speed at hover, if known.

    Raises InputError if the link does not carry a rotor's vibration.
    """
    if rate_hz < SLACK * LEAST_RATE_HZ:
        needs = f"vibration needs {LEAST_RATE_HZ:.0f} Hz, better {FULL_RATE_HZ:.0f}"
        raise InputError(f"the IMU comes at {rate_hz:.3g} Hz; {needs}")
    line_hz = math.inf if hover_rad_s is None else hover_rad_s / (2 * math.pi)
    corner_hz = min(CORNER_HZ, CORNER_SHARE * line_hz) if _carries_line(rate_hz) else FOLDED_HZ
    passed_hz = max(corner_hz, min(CORNER_HZ, line_hz))  # what the stream must carry
    if imu_corner_hz is not None and imu_corner_hz < passed_hz:
        raise InputError(f"the IMU stream is low-passed at {imu_corner_hz:g} Hz, which takes the vibration out of it")
    if hover_rad_s is not None:
        folded_hz = abs(line_hz - rate_hz * round(line_hz / rate_hz))
        if folded_hz < corner_hz:
            how = f"{'fold to' if folded_hz < line_hz else 'are'} {folded_hz:.3g} Hz, among the flight itself"
            raise InputError(f"at {rate_hz:.3g} Hz the rotors' {line_hz:.3g} Hz {how}")
    return corner_hz


def _carries_line(rate_hz: float) -> bool:
    """Whether the line at one per revolution is seen as it is, and not folded."""
    return rate_hz >= SLACK * FULL_RATE_HZ


@spec
class UnbalanceSpec:
    """Healthy vibration on one link.

    Raises InputError if there is one of mass and rotor speed alone, or the corner is above half the rate.
    """

    kind: Literal["unbalance"] = "unbalance"
    dt_s: Period
    corner_hz: Positive  # of the high-pass
    layout: RotorLayout | None  # None if it is not known
    covariance: tuple[float, float]  # healthy mean of gz ax and gz ay [m/s^2 rad/s]
    spread: tuple[Positive, Positive]  # standard deviation of its window means
    turning: float  # healthy mean of the turning part ax ay' - ay ax' [(m/s^2)^2]
    power: Positive  # healthy mean of ax^2 + ay^2 [(m/s^2)^2]
    mass_kg: Positive | None = None  # with both the statistic is in g mm, else in m/s^2
    hover_rad_s: Positive | None = None  # rotor speed that carries the mass
    window_s: Span = WINDOW_S

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
    def taps(self) -> FloatArray:
        """The high-pass."""
        longer = max(1.0, CORNER_HZ / self.corner_hz) if _carries_line(1 / self.dt_s) else 1.0
        return highpass(self.corner_hz * self.dt_s, 2 * max(3, round(FILTER_S * longer / self.dt_s / 2)) + 1)


@jit
def _convolve(taps: Floats, rows: Floats, out: Floats) -> None:
    """Scalar products of the taps with as many rows, from each row on; four taps at a time, for all rows together."""
    out[:] = 0.0
    for k in range(0, len(taps) // 4 * 4, 4):
        a, b, c, d, one = taps[k], taps[k + 1], taps[k + 2], taps[k + 3], rows[k:]
        for i in range(len(out)):
            out[i] += (a * one[i] + b * one[i + 1]) + (c * one[i + 2] + d * one[i + 3])
    for k in range(len(taps) // 4 * 4, len(taps)):
        one = rows[k:]
        for i in range(len(out)):
            out[i] += taps[k] * one[i]


@allocating
def _filtered(taps: Floats, x: Floats, first: int) -> Floats:
    """ax, ay and gz after the high-pass, (3, n)."""
    out, begin = np.empty((3, x.shape[1] - first)), first - len(taps) + 1
    _convolve(taps, x[FORCE, begin:], out[0])
    _convolve(taps, x[FORCE + 1, begin:], out[1])
    _convolve(taps, x[RATE + 2, begin:], out[2])
    return out


@jit
def _take_tick(par: Floats, mem: Floats, length: int) -> None:
    """Put the products of a whole tick into the means."""
    tick, finite = int(par[TICK]), True
    for column in range(COLUMNS):
        mem[MEAN + FRESH + column] = mem[SUMS + column] / tick
        finite = finite and math.isfinite(mem[SUMS + column])
        mem[SUMS + column] = 0.0
    mem[OF_TICK] = 0.0
    push(mem, MEAN, int(par[TICKS]), COLUMNS, finite and mem[RUN] >= tick + length)


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
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The apparent unbalance at the end of each tick, once there is a window of them."""
    window, tick, length, k, means = int(par[TICKS]), par[TICK], int(par[LENGTH]), 0, np.empty(COLUMNS)
    rows = _filtered(par[len(par) - length :], x, first)
    last_x, last_y, number, valid = mem[LAST_X], mem[LAST_Y], int(mem[ROW]), mem[RUN]
    for i in range(x.shape[1] - first):
        number, valid = number + 1, valid + 1.0 if x[VALID, first + i] > 0.5 else 0.0
        ax, ay, gz = rows[0, i], rows[1, i], rows[2, i]
        if number > length:  # the turning part needs the row before
            mem[SUMS] += ax * ax + ay * ay
            mem[SUMS + 1] += gz * ax
            mem[SUMS + 2] += gz * ay
            mem[SUMS + 3] += last_x * ay - last_y * ax
            mem[OF_TICK] += 1.0
        last_x, last_y = ax, ay
        if mem[OF_TICK] < tick:
            continue
        mem[RUN] = valid
        _take_tick(par, mem, length)
        if number < length + window * tick:
            continue
        for column in range(COLUMNS):
            means[column] = total(mem, MEAN, COLUMNS, column) / window
            if out.shape[0] > TRACE:
                out[TRACE + column, k] = means[column]
        power = max(means[0], 0.0)
        _evidence(par, means, rotors, k)
        out[VALUE, k] = par[SCALE] * math.sqrt(power)
        out[LEVEL, k] = par[SCALE] * math.sqrt(max(power - par[POWER], 0.0))
        out[SOUND, k], at[k] = mem[MEAN + 1] >= window, i
        k += 1
    mem[LAST_X], mem[LAST_Y], mem[ROW], mem[RUN] = last_x, last_y, number, valid
    return k


class Unbalance(Monitor[UnbalanceSpec]):
    """Statistic: the apparent unbalance of all rotors together over half a second [g mm].

        U_app = 1e6 m sqrt(mean(ax^2 + ay^2)) / Omega^2        ax, ay above 60 Hz; m, Omega: of the hover trim

    The corner is 0.36 of the rotor's frequency where that is lower, 25 Hz in a stream below 400 Hz. Without mass and
    rotor speed it is the vibration itself [m/s^2]. `level`: the fault's own unbalance, sqrt(U_app^2 - U_healthy^2).
    `rotors` give its place, in -1..1. With the angle of rotor j's force turning by s_j (+1 clockwise from above):
        cov(gz, ax) ~ -s_j x_j,  cov(gz, ay) ~ -s_j y_j,  mean(ax(t-1) ay(t) - ay(t-1) ax(t)) ~ s_j sin(Omega dt)
    after subtracting the airframe's own healthy values. The third, the sense of turning, separates neighbours even if
    gyro and accelerometer are filtered differently, by a millisecond.

    Warm-up: 60 ms of filter, half a second, unbroken and valid. Latency: 30 ms and (threshold^2 - healthy^2)/fault^2 of
    the window. False alarms: another session's propellers. Blind spots: cracks (0.22 g mm is what a healthy rotor may
    have); streams that are low-passed; below 400 Hz the line is folded into the band, or out of it.
    """

    name = "unbalance"
    label = "unbalance"
    observes = "vibration that turns with a rotor"
    phrase = "vibrates {times}x"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE})
    depends = frozenset({Condition.THROTTLE, Condition.HEIGHT})
    evidence = RotorEvidence(8.0)  # the sense of turning and the place agree (1) or do not (0 and below)
    least_hz = LEAST_RATE_HZ
    tick_s = TICK_S
    spec_type = UnbalanceSpec
    takes = MappingProxyType({Signal.SPECIFIC_FORCE: ALONG_DISCS})
    run = staticmethod(run)

    def __init__(self, spec: UnbalanceSpec) -> None:
        super().__init__(spec)
        self.unit = "m/s^2" if spec.mass_kg is None else "g mm"
        self.feature = None if spec.mass_kg is None else Feature.UNBALANCE
        self.memory_s = spec.window_s + (len(spec.taps) + self.tick(spec.dt_s)) * spec.dt_s

    @classmethod
    def need_stream(cls, rate_hz: float, imu_corner_hz: float | None = None, hover_rad_s: float | None = None) -> None:
        """It must carry a rotor's vibration (`corner_of`)."""
        corner_of(rate_hz, imu_corner_hz, hover_rad_s)

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[UnbalanceSpec, ...]:
        """Healthy vibration, in g mm if the airframe's mass and hover speed are known.

        Raises InputError if the link does not carry a rotor's vibration.
        """
        airframe = context.airframe
        both = airframe.mass_kg is not None and airframe.hover_rad_s is not None
        before = UnbalanceSpec(
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
        return (_learnt(before, flights),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[UnbalanceSpec, float]:
        """The vibration of the new propellers, by the same high-pass."""
        new = _learnt(replace(self.spec, covariance=(0.0, 0.0), spread=(1.0, 1.0), turning=0.0, power=1.0), flights)
        return new, (new.power / self.spec.power) ** 0.5

    def begin(self, dt_s: float) -> Begin:
        """No row yet."""
        spec, taps = self.spec, self.spec.taps
        noise = (CLEAR * math.hypot(*spec.spread)) ** 2
        ticks = max(1, round(spec.window_s / self.period_s(dt_s)))
        head = [self.tick(dt_s), ticks, spec.scale, spec.power, spec.turning, *spec.covariance, noise]
        par = np.array([*head, _carries_line(1 / dt_s), len(taps), *_patterns(spec.layout).ravel(), *taps])
        return Begin(par, np.zeros(MEAN + mean_size(ticks, COLUMNS)), len(taps) - 1)


def _patterns(layout: RotorLayout | None) -> FloatArray:
    """Of each rotor the unit vector of its covariances, and its sense of rotation, (rotors, 3)."""
    if layout is None:
        return np.empty((0, 3))
    roll, pitch, yaw = layout.mixing.T  # of thrust: roll ~ -y, pitch ~ x, yaw ~ -s
    # [ cov(gz, ax) ]        [ x_j ]         [  pitch_j ]
    # [ cov(gz, ay) ]  ~ -s_j [ y_j ]  ~ yaw_j [ -roll_j  ]
    pattern = yaw * np.stack((pitch, -roll))
    sizes = np.linalg.norm(pattern, axis=0)
    return np.column_stack(((pattern / np.where(sizes > 0, sizes, 1.0)).T, -np.sign(yaw)))  # 0 of a rotor in the middle


def _learnt(before: UnbalanceSpec, flights: Flights) -> UnbalanceSpec:
    if not any(of_each(flights, "share of rows with x and y", felt_share)):
        raise InputError("no flight with an accelerometer along x and y")
    means = np.concatenate(of_each(flights, before, lambda flight: _means(before, flight)))
    if not len(means):
        raise IdentificationError(f"no unbroken {WINDOW_S:g} s of flight; fly longer")
    (power, x, y, turning), spread = means.mean(axis=0).tolist(), means.std(axis=0).tolist()
    if not (power > 0 and spread[1] > 0 and spread[2] > 0):
        raise IdentificationError("gyro or accelerometer are constant; is it a real sensor?")
    return replace(before, covariance=(x, y), spread=(spread[1], spread[2]), turning=turning, power=power)


def _means(spec: UnbalanceSpec, flight: Sequence[Rows]) -> FloatArray:
    """The full window means of a flight, (k, COLUMNS)."""
    out = traced(Unbalance(spec), flight, COLUMNS)
    return np.compress(out[SOUND] > 0.5, out[TRACE:], axis=1).T
