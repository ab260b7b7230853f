"""What the emulated autopilot computes from its samples before it sends them: filtered IMU, vibration level, stamps."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, lfilter_zi

from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import G
from sitl_plant.autopilot.dialect import Dialect
from sitl_plant.physics.sensors import butterworth
from sitl_plant.plant import STEP_NS, PlantSamples

# ArduPilot, AP_InertialSensor.h: ACCEL_VIBE_FLOOR_FILT_HZ, ACCEL_VIBE_FILT_HZ, ACCEL_CLIP_THRESH_MSS
VIBE_FLOOR_HZ, VIBE_HZ, CLIP_M_S2 = 5.0, 2.0, 16.0 * G - 0.5

STEP_S = STEP_NS * 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class FilteredSamples:
    """n steps as the autopilot sends them."""

    samples: PlantSamples  # what the plant gave
    stamp_ns: IntArray  # (n,) time that the messages carry
    gyro: FloatArray  # (n, 3) after the autopilot's filter [rad/s]
    accel: FloatArray  # (n, 3) after the autopilot's filter [m/s^2]
    vibration: FloatArray  # (n, 3) level [m/s^2]; zero where the profile does not send it, and so are the clippings
    clippings: IntArray  # (n,) samples so far at the end of the accelerometer's range


class _Filter:
    """A linear filter over the columns of successive blocks; it starts settled on the first row."""

    def __init__(self, b: FloatArray, a: FloatArray) -> None:
        self._b, self._a = b, a
        self._state: FloatArray | None = None

    def step(self, x: FloatArray) -> FloatArray:
        if self._state is None:
            self._state = lfilter_zi(self._b, self._a)[:, np.newaxis] * x[0]
        y, self._state = lfilter(self._b, self._a, x, axis=0, zi=self._state)
        return np.asarray(y)


def _first_order(corner_hz: float) -> _Filter:
    """y += alpha (x - y), alpha = dt / (dt + 1 / (2 pi f)), as ArduPilot's LowPassFilter."""
    alpha = STEP_S / (STEP_S + 1.0 / (2.0 * np.pi * corner_hz))
    return _Filter(np.array([alpha]), np.array([1.0, alpha - 1.0]))


def _second_order(corner_hz: float) -> _Filter:
    b0, b1, b2, a1, a2 = butterworth(corner_hz, STEP_S)
    return _Filter(np.array([b0, b1, b2]), np.array([1.0, a1, a2]))


class ImuFilters:
    """From samples to what is sent, block by block. Equal seeds give equal stamps; how time is cut does not matter.

    vibration = sqrt( low-pass_2Hz( (accel - low-pass_5Hz(accel))^2 ) )
    (ArduPilot, AP_InertialSensor::calc_vibration_and_clipping)
    """

    def __init__(self, dialect: Dialect, seed: int) -> None:
        self._imu_filter = _second_order(corner_hz) if (corner_hz := dialect.profile.imu_corner_hz) else None
        self._vibration = dialect.profile.vibration
        self._floor, self._level = _first_order(VIBE_FLOOR_HZ), _first_order(VIBE_HZ)
        self._clippings = 0
        self._delay_ns = round(dialect.send_delay_s * 1e9)
        self._delays = np.random.default_rng(seed)

    def step(self, samples: PlantSamples) -> FilteredSamples:
        """The next block (n >= 1)."""
        gyro, accel = samples.gyro, samples.accel
        vibration, clipped = np.zeros(accel.shape), np.zeros(len(samples), dtype=np.int64)
        if self._vibration:
            vibration = np.sqrt(np.maximum(0.0, self._level.step((accel - self._floor.step(accel)) ** 2)))
            clipped = np.cumsum(np.any(np.abs(accel) > CLIP_M_S2, axis=1)) + self._clippings
            self._clippings = int(clipped[-1])
        if self._imu_filter is not None:
            both = self._imu_filter.step(np.hstack([gyro, accel]))
            gyro, accel = both[:, :3], both[:, 3:]
        delay_ns = self._delay_ns * self._delays.random(len(samples))
        return FilteredSamples(samples, samples.t_ns + delay_ns.astype(np.int64), gyro, accel, vibration, clipped)
