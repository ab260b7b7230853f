"""The sensor-drift monitor: gyro, accelerometer and estimated attitude contradict each other.

Whatever propellers, wind and payload do, the integral of the gyro is the change of the attitude, and along the vertical
the accelerometer reads g on average.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Begin, FaultKind, Flights, LearnContext, Monitor, parted
from mavdiag.monitors.fitting import of_each, three, traced
from mavdiag.monitors.spec import Period, Positive, spec
from mavdiag.rows.block import ATTITUDE, FORCE, LEVEL, RATE, SOUND, TRACE, VALID, VALUE, Floats, Ints
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import body_rates
from mavdiag.telemetry import FloatArray, Signal, Three
from mavdiag.units import G

TICK_S = 0.1  # our choice
MEAN_S = 2.0  # of the attitude that the gyro does not explain, now and then (our choice)
LAG_S = 15.0  # between the two; less while the flight is young (our choice: twice a usual time constant of estimators)
STEP = 4  # ticks that a reset of the attitude takes where it comes at 4 Hz (our choice)
VERTICAL_S = 4.0  # of each of three means of the vertical acceleration (our choice)
LATE_S = 0.02  # by which an attitude may be older than the gyro: a period of 50 Hz (our choice)
TURN_SHARE = 0.01  # of a turn that a healthy gyro may be wrong by, scale and cross-axis (IIM-42652 data sheet: 1 %)
LEAST_ANGLE = 0.01  # rad: smallest healthy disagreement that is believed (our choice)
# rad/s: change of a gyro's bias between flights that is no fault: 0.005 deg/s a kelvin (IIM-42652 data sheet), and 45 K
# by which electronics warm up (estimate).
USUAL_BIAS = 0.004
LEAST_VERTICAL = 0.08  # m/s^2 (our choice)
STEEP_RAD, FAST_RAD_S = 0.7, 6.0  # beyond it small angles do not hold, and an upset begins (our choice)
LIMIT = 1e6  # a value is cut here
SINE, COSINE = (tuple(1.0 / math.factorial(k) for k in range(first, -1, -2)) for first in (15, 14))
COLUMNS = 5  # of the history: tilt about two axes, heading, vertical acceleration, turned angle
# Places in the parameters; and in the memory: rows of the tick and valid ones, sums of the tick (with what a bias is
# multiplied by from `TURNED` on), angles since the last gap, ticks since then, the history of each column.
DT, TICK, MEAN, LAG, LIFT, VERTICAL, BIAS, SPREADS = *range(7), 9
ROWS, SOUND_ROWS, SUMS, TURNED, ANGLE, TICKS, HISTORY = 0, 1, 2, 10, 14, 18, 19
OF_TICK = ANGLE - SUMS


@spec
class SensorDriftSpec:
    """Healthy agreement."""

    kind: Literal["sensor_drift"] = "sensor_drift"
    dt_s: Period
    bias: Three  # mean of gyro less attitude rate [rad/s]
    vertical: float  # mean of the vertical specific force beyond -g [m/s^2]
    tilt: Positive  # rms of the disagreement over 15 s [rad]
    heading: Positive
    lift: Positive  # rms of the 4 s means of the vertical specific force [m/s^2]


@jit
def _sine_cosine(angle: float) -> tuple[float, float]:
    """Of a small angle, by their series: below 0.7 rad right to 1e-14."""
    sine, cosine, square = 0.0, 0.0, angle * angle
    for k in range(8):
        sine, cosine = SINE[k] - sine * square, COSINE[k] - cosine * square
    return sine * angle, cosine


@jit
def _add_rows(mem: Floats, x: Floats, begin: int, stop: int) -> None:
    """Add rows to their tick: what the gyro turns and what is seen."""
    c, s, phi, theta, psi = math.nan, math.nan, math.nan, math.nan, math.nan
    sin_phi, cos_phi, sin_theta, cos_theta = 0.0, 1.0, 0.0, 1.0
    for i in range(begin, stop):
        p, q, r = x[RATE, i], x[RATE + 1, i], x[RATE + 2, i]
        ax, ay, az = x[FORCE, i], x[FORCE + 1, i], x[FORCE + 2, i]
        good = abs(x[ATTITUDE, i]) < STEEP_RAD and abs(x[ATTITUDE + 1, i]) < STEEP_RAD and x[VALID, i] > 0.5
        good = good and abs(p) < FAST_RAD_S and abs(q) < FAST_RAD_S and abs(r) < FAST_RAD_S
        if not (good and math.isfinite(ax + ay + az + x[ATTITUDE + 2, i])):
            continue
        if x[ATTITUDE, i] != phi or x[ATTITUDE + 1, i] != theta or x[ATTITUDE + 2, i] != psi:  # else it was repeated
            phi, theta, psi = x[ATTITUDE, i], x[ATTITUDE + 1, i], x[ATTITUDE + 2, i]
            (sin_phi, cos_phi), (sin_theta, cos_theta) = _sine_cosine(phi), _sine_cosine(theta)
            c, s = math.cos(psi), math.sin(psi)
        turn = (q * sin_phi + r * cos_phi) / cos_theta
        mem[SUMS] += p * c - q * s
        mem[SUMS + 1] += p * s + q * c
        mem[SUMS + 2], mem[SUMS + 3] = mem[SUMS + 2] + turn, mem[SUMS + 3] + abs(turn)
        mem[SUMS + 4] += phi * c - theta * s
        mem[SUMS + 5] += phi * s + theta * c
        mem[SUMS + 6] += psi
        mem[SUMS + 7] += cos_theta * (sin_phi * ay + cos_phi * az) - sin_theta * ax + G
        mem[TURNED], mem[TURNED + 1] = mem[TURNED] + c, mem[TURNED + 1] + s
        mem[TURNED + 2] += sin_phi / cos_theta
        mem[TURNED + 3] += cos_phi / cos_theta
        mem[SOUND_ROWS] += 1.0


@jit
def _mean(mem: Floats, newest: int, back: int, count: int) -> float:
    """Mean of so many ticks of a column, the last of them so long before the newest."""
    found = 0.0
    for place in range(newest - back - count + 1, newest - back + 1):
        found += mem[place]
    return found / count


@jit
def _drifted(mem: Floats, newest: int, apart: int, mean: int, excused: float) -> float:
    """By how much the mean of a column has changed; beyond what is excused without a step that is most of it."""
    change = _mean(mem, newest, 0, mean) - _mean(mem, newest, apart, mean)
    least, last = abs(change), apart + mean - 1
    for middle in range(last if abs(change) > excused else 0):
        sides = min(middle + 1, mean) - max(middle + 1 - apart, 0)  # ticks of the two means between which it lies
        step = mem[newest - max(middle - STEP // 2, 0)] - mem[newest - min(middle + STEP // 2, last)]
        least = min(least, abs(change - sides / mean * step))
    return least if 2.0 * least < abs(change) else abs(change)


@jit
def _walk(par: Floats, mem: Floats, whole: bool, found: Floats) -> bool:
    """Take a tick, whose means stand at `SUMS`: |dE|, |dY|, |V| and what is excused, e; whether they count."""
    mean, lag, lift, span_s = int(par[MEAN]), int(par[LAG]), int(par[LIFT]), par[TICK] * par[DT]
    length = lag + 2 * mean + 1
    north, lifted, last = HISTORY + length - 1, HISTORY + 4 * length - 1, HISTORY + 5 * length - 1  # newest of a column
    found[:] = 0.0
    if not whole:
        mem[ANGLE:HISTORY] = 0.0
        return False
    c, s, (p, q, r) = mem[TURNED], mem[TURNED + 1], par[BIAS : BIAS + 3]
    mem[ANGLE] += (mem[SUMS] - p * c + q * s) * span_s
    mem[ANGLE + 1] += (mem[SUMS + 1] - p * s - q * c) * span_s
    mem[ANGLE + 2] += (mem[SUMS + 2] - q * mem[TURNED + 2] - r * mem[TURNED + 3]) * span_s
    mem[ANGLE + 3] += mem[SUMS + 3] * span_s
    for place in range(HISTORY, last):
        mem[place] = mem[place + 1]
    for j in range(3):
        mem[north + j * length] = mem[SUMS + 4 + j] - mem[ANGLE + j]
    mem[lifted], mem[last] = mem[SUMS + 7] - par[VERTICAL], mem[ANGLE + 3]
    mem[TICKS] += 1.0
    ticks = int(mem[TICKS])
    if ticks >= 2 * mean:
        apart = min(lag, ticks - mean)  # ticks between the windows
        turned, old = _mean(mem, last, 0, mean) - _mean(mem, last, apart, mean), last - apart
        rates = mem[last] - mem[last - mean + 1] + mem[old] - mem[old - mean + 1]  # of both windows
        found[3] = TURN_SHARE * turned + apart * (USUAL_BIAS * span_s) + LATE_S / MEAN_S * rates
        tilted = _drifted(mem, north, apart, mean, found[3])
        found[0] = math.hypot(tilted, _drifted(mem, north + length, apart, mean, found[3]))
        found[1] = _drifted(mem, north + 2 * length, apart, mean, found[3])
    if ticks >= 3 * lift:
        late, middle = _mean(mem, lifted, 0, lift), _mean(mem, lifted, lift, lift)
        early = _mean(mem, lifted, 2 * lift, lift)
        found[2] = min(abs(late), abs(middle), abs(early)) if min(late * middle, middle * early) > 0.0 else 0.0
    return ticks >= 2 * mean


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The greatest disagreement every 0.1 s, at the time of the newest row that it rests on."""
    k, found, tick, begin, columns = 0, np.empty(4), int(par[TICK]), first, x.shape[1]
    while begin < columns:
        stop = min(begin + tick - int(mem[ROWS]), columns)
        _add_rows(mem, x, begin, stop)
        mem[ROWS] += stop - begin
        begin = stop
        if mem[ROWS] < tick:
            break
        whole = mem[SOUND_ROWS] >= tick
        for j in range(OF_TICK):
            mem[SUMS + j] /= tick
            if out.shape[0] > TRACE:
                out[TRACE + j, k], out[TRACE + OF_TICK, k] = mem[SUMS + j], mem[TICKS] if whole else -1.0
        out[SOUND, k] = _walk(par, mem, whole, found)
        mem[:ANGLE] = 0.0
        angle = max(found[0] / (par[SPREADS] + found[3]), found[1] / (par[SPREADS + 1] + found[3]))
        value = min(max(angle, found[2] / par[SPREADS + 2]), LIMIT)
        out[VALUE, k], out[LEVEL, k], at[k] = value, value, stop - 1 - first
        k += 1
    return k


@cached
def _again(par: Floats, mem: Floats, ticks: Floats) -> Floats:
    """What `_walk` finds in ticks that `run` has traced, and whether they count, (k, 5)."""
    out = np.empty((len(ticks), 5))
    for k in range(len(ticks)):
        if ticks[k, OF_TICK] == 0.0:  # the first one behind a gap
            _walk(par, mem, False, out[k, :4])
        mem[SUMS:ANGLE] = ticks[k, :OF_TICK]
        out[k, 4] = _walk(par, mem, True, out[k, :4])
    return out


class SensorDrift(Monitor[SensorDriftSpec]):
    """Statistic: the greatest of three disagreements of the inertial sensors [times healthy rms].

        E = (phi + i theta) e^(i psi) - integral (p + i q) e^(i psi) dt           tilt that the gyro does not explain
        Y = psi - integral (q sin phi + r cos phi)/cos theta dt                   the same of the heading
        V = g + specific force along the vertical of the attitude phi, theta, psi
        s = max( |dE|/(tilt + e), |dY|/(heading + e), |V|/lift ),    e = 0.01 R + 0.004 rad/s L + 0.02 s (r + r')

    dE, dY: change of their 2 s means over L = 15 s, or since the last gap, without a step in 0.4 s that is most of it:
    an estimator was reset; R: angle that the gyro turned in it; r, r': mean turning rate of each of the 2 s, for an
    attitude may come late. |V|: the smallest of three 4 s means in a row, 0 if their signs differ: a climb begins.

    Warm-up: 4 s without a gap, 12 s for V. Latency: a gyro bias of 0.05 rad/s takes 6 s, a drift of 0.002 rad/s^2 15 s,
    a vertical bias of 0.5 m/s^2 10 s. False alarms: resets and jumps twice in 15 s. Blind spots: a gyro's
    scale, unless the vehicle turns; a horizontal accelerometer bias below 1 m/s^2; what was there when the flight
    began; attitudes beyond 40 degrees; what a gyro loses in 0.4 s, once in 15 s, for a reset looks alike.
    """

    name = "sensor_drift"
    label = "IMU drift"
    observes = "gyro and attitude that do not agree"
    phrase = "gyro and attitude disagree"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ATTITUDE})
    kind = FaultKind.SENSOR
    least = 2.5
    least_hz = 20.0  # below it turns are not followed from sample to sample (our choice)
    tick_s = TICK_S
    spec_type = SensorDriftSpec
    unit = "x healthy rms"
    reach = LIMIT  # where a value is cut
    run = staticmethod(run)

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[SensorDriftSpec, ...]:
        """Healthy biases and spreads. Raises InputError if the vehicle sends no attitude."""
        still = SensorDriftSpec(dt_s=context.dt_s, bias=(0.0, 0.0, 0.0), vertical=0.0, tilt=1.0, heading=1.0, lift=1.0)
        biases = np.concatenate(of_each(flights, cls.name, _biases))
        if not len(biases):
            raise InputError("no flight with a gyro, an accelerometer and an attitude estimate")
        mean = biases.mean(axis=0)
        unbiased = replace(still, bias=three(mean[:3]), vertical=float(mean[3]))
        count, squares = 0, np.zeros(3)
        for ticks in of_each(flights, (cls.name, "ticks"), lambda flight: _ticks(cls(still), flight)):
            begun = cls(unbiased).begin(context.dt_s)
            found = _again(begun.par, begun.mem, ticks).T
            disagreement = found[:4, found[4] > 0.5]
            disagreement[:2] = np.maximum(disagreement[:2] - disagreement[3], 0.0)  # beyond what is excused
            count, squares = count + disagreement.shape[1], squares + np.square(disagreement[:3]).sum(axis=1)
        if not count:
            raise IdentificationError(f"no unbroken {2 * MEAN_S:g} s of flight; fly longer")
        tilt, heading, lift = np.maximum(np.sqrt(squares / count), (LEAST_ANGLE, LEAST_ANGLE, LEAST_VERTICAL)).tolist()
        return (replace(unbiased, tilt=tilt, heading=heading, lift=lift),)

    def begin(self, dt_s: float) -> Begin:
        """No row yet."""
        spec, tick_s = self.spec, self.period_s(dt_s)
        mean, lag, lift = (max(1, round(span_s / tick_s)) for span_s in (MEAN_S, LAG_S, VERTICAL_S))
        spreads = spec.tilt, spec.heading, spec.lift
        par = np.array([dt_s, self.tick(dt_s), mean, lag, lift, spec.vertical, *spec.bias, *spreads])
        return Begin(par, np.zeros(HISTORY + COLUMNS * (lag + 2 * mean + 1)))


def _ticks(monitor: SensorDrift, flight: Sequence[Rows]) -> FloatArray:
    """The means of the whole ticks of a flight, and how many came before since a gap, (k, OF_TICK + 1)."""
    ticks = traced(monitor, flight, OF_TICK + 1)[TRACE:]
    return np.compress(ticks[OF_TICK] >= 0.0, ticks, axis=1).T


def _biases(flight: Sequence[Rows]) -> FloatArray:
    """(n, 4) of whole ticks: gyro less the rate of the attitude, and vertical specific force beyond -g."""
    found, rest = [np.empty((0, 4))], np.empty((10, 0))
    for begins, block in ((begins, rows.block) for begins, rows in parted(flight)):
        tick = SensorDrift.tick(block.dt_s)
        fresh = np.vstack((block.rate.T, block.force.T, block.attitude.T, block.valid))
        rows = np.asarray(fresh if begins else np.concatenate((rest, fresh), axis=1), dtype=np.float64)
        rows, rest = np.split(rows, [rows.shape[1] // tick * tick], axis=1)
        known = (rows[9] > 0) & np.isfinite(rows).all(axis=0)
        known &= (np.abs(rows[6:8]) < STEEP_RAD).all(axis=0) & (np.abs(rows[:3]) < FAST_RAD_S).all(axis=0)
        ticks = np.compress(known.reshape(-1, tick).all(axis=1), rows[:9].reshape(9, -1, tick), axis=1)
        mean, (x, y, z, phi, theta, _) = ticks.mean(axis=2), ticks[3:]
        slopes = (ticks[6:, :, -1] - ticks[6:, :, 0]) / (max(1, tick - 1) * block.dt_s)
        down = np.cos(theta) * (np.sin(phi) * y + np.cos(phi) * z) - np.sin(theta) * x
        errors = (mean[:3] - body_rates(mean[6], mean[7], *slopes)).T
        found.append(np.column_stack((errors, (down + G).mean(axis=1))))
    return np.concatenate(found)
