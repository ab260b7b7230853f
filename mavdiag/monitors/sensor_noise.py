"""The sensor-noise monitor: one axis of gyro or accelerometer turned noisy, and no other noticed."""

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.jit import allocating, cached
from mavdiag.monitors.base import SLACK, Begin, FaultKind, Flights, LearnContext, Monitor, walk
from mavdiag.monitors.fitting import of_each
from mavdiag.monitors.spec import Positive, Span, spec
from mavdiag.rows.block import LEVEL, RATE, SOUND, TRACE, VALID, VALUE, Floats, Ints
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import window_rows
from mavdiag.telemetry import FloatArray, Signal

WINDOW_S = 0.5  # our choice: that of the unbalance monitor, so that the two are equally quick
ORDER = 4  # of the difference: it leaves 0.0006 of a motion at 5 Hz at 200 Hz (our choice)
AXES = 6  # gyro x, y, z and accelerometer x, y, z
LOWPASS_SHARE = 0.2  # of the rate: a stream that is low-passed below it has lost its noise (our choice)
LIMIT = 6.0  # healthy rms; a difference is cut here, so that one knock is no noise (our choice)
MIN_ROWS = 500  # our choice
RUN, MEAN = 0, 1  # places in the memory: how many rows in a row are known, and the mean of the squares

Six: TypeAlias = tuple[Positive, Positive, Positive, Positive, Positive, Positive]


@spec
class SensorNoiseSpec:
    """Healthy noise."""

    kind: Literal["sensor_noise"] = "sensor_noise"
    rms: Six  # of the fourth difference of gyro x, y, z [rad/s] and accelerometer x, y, z [m/s^2]
    window_s: Span = WINDOW_S


@allocating
def _differences(x: Floats, first: int) -> Floats:
    """The fourth differences of the six axes, (6, n)."""
    out = np.empty((AXES, x.shape[1] - first))
    for axis in range(AXES):
        row, to = x[RATE + axis, first - ORDER :], out[axis]
        for k in range(len(to)):
            to[k] = row[k + 4] - 4.0 * row[k + 3] + 6.0 * row[k + 2] - 4.0 * row[k + 1] + row[k]
    return out


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The lead of the noisiest axis at each row. par: rows of the window, and one over the healthy rms."""
    window, d = int(par[0]), _differences(x, first)
    for k in range(len(at)):
        sum_ = 0.0
        for axis in range(AXES):
            sum_ += x[RATE + axis, first + k]
            z = min(abs(d[axis, k]) * par[1 + axis], LIMIT)
            mem[MEAN + FRESH + axis] = z * z
        mem[RUN] = mem[RUN] + 1.0 if x[VALID, first + k] > 0.5 and math.isfinite(sum_) else 0.0
        whole = mem[RUN] > ORDER
        for axis in range(AXES if out.shape[0] > TRACE else 0):
            out[TRACE + axis, k] = d[axis, k] if whole else math.nan
        out[SOUND, k], at[k] = push(mem, MEAN, window, AXES, whole), k
        highest, second = 0.0, 0.0
        for axis in range(AXES):
            power = total(mem, MEAN, AXES, axis)
            second = max(second, min(highest, power))
            highest = max(highest, power)
        others = max(second / window, 1.0)
        lead = highest / (window * others * others)
        out[VALUE, k] = out[LEVEL, k] = math.log(lead) if lead > 1.0 else 0.0
    return len(at)


class SensorNoise(Monitor[SensorNoiseSpec]):
    """Statistic: by how much the noise of one sensor axis rose while the others did not [ln of power].

        d = fourth difference of the axis,    L_i = ln(mean_0.5s d_i^2 / healthy),    i = gyro x, y, z, accel x, y, z
        s = max(0, L_1st - 2 max(0, L_2nd))           the highest and the second highest of the six

    Whatever shakes an airframe is felt by several axes at once: nothing is left where a second axis rises by more than
    the root of the highest one's power. The difference passes what is above a quarter of the rate, and hardly motion.

    Warm-up: 4 rows and 0.5 s. Latency: 0.2 s for noise of 6 times the healthy rms. False alarms: an airframe that
    resonates along one axis only; knocks are cut. Blind spots: noise below the vibration of the rotors; two axes at
    once; streams that are low-passed or slower than 100 Hz.
    """

    name = "sensor_noise"
    label = "IMU noise"
    observes = "noise of one sensor axis alone"
    phrase = "IMU noise {times}x"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE})
    kind = FaultKind.SENSOR
    # Estimates: a simulated ArduCopter at 100 Hz, where the differences hold motion, reached 2.2 in healthy flight; and
    # new propellers of another session may shake one axis of the gyro five times as much as those that were learnt.
    least = 2.4
    least_hz = 100.0  # below it the difference is the flight's own motion (our choice)
    spec_type = SensorNoiseSpec
    unit = "ln of power"
    reach = 2.0 * math.log(LIMIT)  # the logarithm of the power at which differences are cut: 3.58
    run = staticmethod(run)

    @classmethod
    def need_stream(cls, rate_hz: float, imu_corner_hz: float | None = None, hover_rad_s: float | None = None) -> None:
        """The noise shows in a fast stream that is not low-passed."""
        if rate_hz < SLACK * cls.least_hz:
            raise InputError(f"the IMU comes at {rate_hz:.3g} Hz; its noise shows from {cls.least_hz:.0f} Hz on")
        if imu_corner_hz is not None and imu_corner_hz < LOWPASS_SHARE * rate_hz:
            raise InputError(f"the IMU stream is low-passed at {imu_corner_hz:g} Hz, which takes its noise out of it")

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[SensorNoiseSpec, ...]:
        """Healthy noise of the six axes."""
        found = of_each(flights, cls.name, _squares)
        count = sum(rows for rows, _ in found)
        if count < MIN_ROWS:
            raise InputError("no flight with a gyro and an accelerometer along x, y and z")
        rms = np.sqrt(np.sum([squares for _, squares in found], axis=0) / count).tolist()
        if min(rms) <= 0.0:
            raise IdentificationError("gyro or accelerometer are constant; is it a real sensor?")
        return (SensorNoiseSpec(rms=(rms[0], rms[1], rms[2], rms[3], rms[4], rms[5])),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[SensorNoiseSpec, float]:
        """The noise with the new propellers; the statistic is relative to it, so old scores hold as they are."""
        (new,) = self.fit(flights, context)
        return new, 1.0

    def begin(self, dt_s: float) -> Begin:
        """No row yet."""
        window = window_rows(self.spec.window_s, dt_s)
        par = np.array([window, *(1.0 / rms for rms in self.spec.rms)])
        return Begin(par, np.zeros(MEAN + mean_size(window, AXES)), ORDER)


def _squares(flight: Sequence[Rows]) -> tuple[int, FloatArray]:
    count, squares = 0, np.zeros(AXES)
    for ((_, found),) in walk([SensorNoise(SensorNoiseSpec(rms=(1.0,) * 6))], flight, AXES):
        d = found[TRACE:, np.isfinite(found[TRACE])]
        count, squares = count + d.shape[1], squares + np.einsum("kn,kn->k", d, d)
    return count, squares
