"""The sensor-noise monitor: one axis of gyro or accelerometer turned noisy, and no other noticed.

Whatever shakes an airframe is felt by several axes at once: a rotor's unbalance turns, so x and y feel it alike, and
it reaches the gyro through the arms. Noise that only one axis of one sensor has comes from that axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import FaultKind, Flights, LearnContext, Monitor, Summaries, Summary, segments
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import MeanState, sliding_mean, start_mean, window_all, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, Signal
from mavdiag.thresholds.guard import Guard

__all__ = ["SensorNoise", "SensorNoiseSpec", "SensorNoiseState"]

WINDOW_S = 0.5  # our choice: that of the unbalance monitor, so that the two are equally quick
ORDER = 4  # of the difference: it leaves 0.0006 of a motion at 5 Hz at 200 Hz (our choice)
AXES = 6  # gyro x, y, z and accelerometer x, y, z
LEAST_RATE_HZ = 98.0  # below it the difference is the flight's own motion (our choice)
LOWPASS_SHARE = 0.2  # of the rate: a stream that is low-passed below it has lost its noise (our choice)
LIMIT = 6.0  # healthy rms; a difference is cut here, so that one knock is no noise (our choice)
LEAST_POWER = 1e-12  # of the healthy power; keeps a logarithm finite
MIN_ROWS = 500  # our choice

Six: TypeAlias = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoiseSpec:
    """Healthy noise.

    rms: of the fourth difference of gyro x, y, z [rad/s] and accelerometer x, y, z [m/s^2].
    window_s: length of the means [s].
    Raises InputError if one is not positive.
    """

    kind: Literal["sensor_noise"] = "sensor_noise"
    rms: Six
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        if not all(math.isfinite(x) and x > 0 for x in (*self.rms, self.window_s)):
            raise InputError("sensor_noise: the healthy noise and the window must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoiseState:
    """The last 4 rows, (4, 6), whether they may be used, (4,), and the mean of the squares."""

    rows: FloatArray
    valid: BoolArray
    mean: MeanState


class SensorNoise(Monitor[SensorNoiseSpec, SensorNoiseState]):
    """Statistic: by how much the noise of one sensor axis rose while the others did not [ln of power].

        d = fourth difference of the axis,    L_i = ln(mean_0.5s d_i^2 / healthy),    i = gyro x, y, z, accel x, y, z
        s = max(0, L_1st - 2 max(0, L_2nd))

    L_1st and L_2nd are the highest and the second highest of the six: nothing is left where a second axis rises by
    more than the root of the highest one's power, as all do with an unbalanced rotor. The fourth difference passes what
    is above a quarter of the rate and hardly any motion. `level` equals the statistic, `signal` is L_1st.

    Warm-up: 4 rows and 0.5 s. Latency: the share of the window that lifts the mean, 0.2 s for noise of 6 times the
    healthy rms and more. False alarms: see `thresholds`; the threshold is never less than 2.4, 11 times the power. An
    airframe that resonates along one axis only could raise it without a sensor at fault; knocks are cut. Blind spots:
    noise below the vibration of the rotors; two axes at once; streams that are low-passed or slower than 100 Hz.

    >>> from mavdiag.testing import example_context, example_rows
    >>> rng = np.random.default_rng(8)
    >>> rate, force = rng.normal(0, 0.01, (1000, 3)), rng.normal(0, 0.1, (1000, 3))
    >>> monitor = SensorNoise(*SensorNoise.fit([[example_rows(1000, rate=rate, force=force)]], example_context()))
    >>> rate[:, 1] += rng.normal(0, 0.1, 1000)
    >>> _, alone = monitor.step(monitor.start(), example_rows(1000, rate=rate, force=force))
    >>> _, shaken = monitor.step(monitor.start(), example_rows(1000, rate=rate, force=10 * force))
    >>> bool(alone.value[-1] > 1.5), float(shaken.value[-1])
    (True, 0.0)
    """

    name = "sensor_noise"
    label = "IMU noise"
    phrase = "IMU noise {times}x"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE})
    kind = FaultKind.SENSOR
    # Estimates: a simulated ArduCopter at 100 Hz, where the differences hold motion, reached 2.2 in healthy flight; and
    # new propellers of another session may shake one axis of the gyro five times as much as those that were learnt.
    guard = Guard(least=2.4, few_sessions=2.0)
    spec_type = SensorNoiseSpec
    unit = "ln of power"

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """How many rows have a fourth difference, and the sum of their squares, (6,)."""
        count, squares = 0, np.zeros(AXES)
        for segment in segments(flight):
            state = _fresh()
            for rows in segment:
                state, d, valid = _differences(state, rows.block)
                count += int(np.count_nonzero(valid))
                squares += np.einsum("nk,nk->k", d[valid], d[valid])
        return np.array([count]), squares

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[SensorNoiseSpec, ...]:
        """Healthy noise of the six axes. Raises InputError if the stream does not carry it."""
        rate_hz, corner_hz = 1 / context.dt_s, context.imu_corner_hz
        if rate_hz < LEAST_RATE_HZ:
            raise InputError(f"the IMU comes at {rate_hz:.3g} Hz; its noise shows from 100 Hz on")
        if corner_hz is not None and corner_hz < LOWPASS_SHARE * rate_hz:
            raise InputError(f"the IMU stream is low-passed at {corner_hz:g} Hz, which takes its noise out of it")
        count = sum(int(rows[0]) for rows, _ in summaries)
        if count < MIN_ROWS:
            raise InputError("no flight with a gyro and an accelerometer along x, y and z")
        rms = np.sqrt(np.sum([squares for _, squares in summaries], axis=0) / count).tolist()
        if min(rms) <= 0.0:
            raise IdentificationError("gyro or accelerometer are constant; is it a real sensor?")
        return (SensorNoiseSpec(rms=(rms[0], rms[1], rms[2], rms[3], rms[4], rms[5])),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[SensorNoiseSpec, float]:
        """The noise with the new propellers; the statistic is relative to it, so old scores hold as they are."""
        (new,) = self.fit(flights, context)
        return new, 1.0

    @property
    def reach(self) -> float:
        """The logarithm of the power at which differences are cut: 3.58."""
        return 2.0 * math.log(LIMIT)

    def start(self) -> SensorNoiseState:
        """No row yet."""
        return _fresh()

    def step(self, state: SensorNoiseState, rows: Rows) -> tuple[SensorNoiseState, Statistic]:
        """The lead of the noisiest axis at each of the next rows."""
        spec, block = self.spec, rows.block
        before = state.mean
        state, d, valid = _differences(state, block)
        z = np.minimum(np.abs(d / spec.rms), LIMIT)
        mean_state, mean, full = sliding_mean(before, z * z, valid, window_rows(spec.window_s, block.dt_s))
        first, second = (np.log(np.maximum(one, LEAST_POWER)) for one in _highest(mean))
        value = np.maximum(first - 2.0 * np.maximum(second, 0.0), 0.0)
        state = SensorNoiseState(state.rows, state.valid, mean_state)
        return state, Statistic(block.t_ns, block.dt_s, value, full, value, first)


def _highest(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The highest and the second highest value of each row, (n, k) -> (n,) each, k at least 2."""
    first, second = np.maximum(x[:, 0], x[:, 1]), np.minimum(x[:, 0], x[:, 1])
    for column in x.T[2:]:
        second = np.maximum(second, np.minimum(first, column))
        first = np.maximum(first, column)
    return first, second


def _fresh() -> SensorNoiseState:
    return SensorNoiseState(np.zeros((ORDER, AXES)), np.zeros(ORDER, dtype=np.bool_), start_mean(AXES))


def _differences(state: SensorNoiseState, block: Block) -> tuple[SensorNoiseState, FloatArray, BoolArray]:
    """Fourth differences of each row, (n, 6), zero where a row behind them is unknown, and (n,) whether all are."""
    fresh = np.concatenate((block.rate, block.force), axis=1)
    known = block.valid & block.known(Signal.SPECIFIC_FORCE) & block.finite_rate()
    if np.count_nonzero(known) < len(known):
        fresh = np.where(known[:, None], fresh, 0.0)
    both, flags = np.concatenate((state.rows, fresh)), np.concatenate((state.valid, known))
    whole = window_all(flags, ORDER + 1)
    d = both
    for _ in range(ORDER):
        d = d[1:] - d[:-1]
    if np.count_nonzero(whole) < len(whole):
        d[~whole] = 0.0
    return SensorNoiseState(both[-ORDER:], flags[-ORDER:], state.mean), d, whole
