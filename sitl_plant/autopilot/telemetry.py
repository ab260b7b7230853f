"""What a receiver makes of a flight, without the bytes in between: for studies of many flights.

The same messages are due at the same rows, in the same units, rounding and stamps, as `sitl_plant.autopilot.stream` sends and
`mavdiag.link` reads them; a test holds the two ways against each other. Lost messages are simply missing.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import Profile
from mavdiag.link.samples import joined
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from sitl_plant.autopilot.dialect import flavour
from sitl_plant.autopilot.imu_filters import Sensed, Sensing
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.plant import STEP_NS, Plant, PlantConfig, PlantSamples

__all__ = ["LinkSpec", "TelemetryStream", "flight_telemetry", "telemetry_digest", "until_ground"]

BLOCK_STEPS = 1000
MS, US = 1_000_000, 1_000  # ns: the unit of a message's time
RPM = 2.0 * np.pi / 60.0  # rad/s

Values = tuple[tuple[Signal, FloatArray], ...]


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """One link. rate_hz: of set-point and IMU, the profile's own if None. loss: share of messages that is lost.

    Raises UsageError for an unknown profile, a rate that it does not grant, or a loss outside 0 to 0.9.
    """

    profile: str = "qdrone2"
    rate_hz: float | None = None
    loss: float = 0.0

    def __post_init__(self) -> None:
        flavour(self.profile).rates_hz(self.rate_hz)
        if not 0.0 <= self.loss <= 0.9:
            raise UsageError(f"loss must be 0 to 0.9 of the messages, not {self.loss:g}")


def _wire(values: FloatArray) -> FloatArray:
    """As a 32-bit float carries it."""
    return values.astype(np.float32).astype(np.float64)


def _counts(values: FloatArray, unit: float) -> FloatArray:
    """In whole units, within 16 bits, as RAW_IMU carries it."""
    return np.clip(np.rint(values / unit), -32768, 32767) * unit


def _attitude_target(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    samples = sensed.samples
    return (
        (Signal.ATTITUDE_SETPOINT, samples.setpoint[rows]),
        (Signal.RATE_SETPOINT, _wire(samples.rate_setpoint[rows])),
        (Signal.THRUST_SETPOINT, _wire(samples.thrust_setpoint[rows, None])),
    )


def _raw_imu(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return (
        (Signal.BODY_RATE, _counts(sensed.gyro[rows], profile.gyro_unit)),
        (Signal.SPECIFIC_FORCE, _counts(sensed.accel[rows], profile.accel_unit)),
    )


def _highres_imu(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.BODY_RATE, _wire(sensed.gyro[rows])), (Signal.SPECIFIC_FORCE, _wire(sensed.accel[rows])))


def _attitude(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.ATTITUDE, _wire(sensed.samples.attitude[rows, :3])),)


def _local_position(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.HEIGHT, -_wire(sensed.samples.position[rows, 2:3])),)


def _heartbeat(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.ARMED, np.ones((len(rows), 1))),)


def _servo_output(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    low, high = profile.actuator_span
    return ((Signal.ACTUATOR, np.rint((high - low) * sensed.samples.duty[rows]) / (high - low)),)


def _actuator_output(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.ACTUATOR, _wire(sensed.samples.duty[rows])),)


def _rotor_speed(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.ROTOR_SPEED, np.rint(sensed.samples.rotor_speed[rows] / RPM) * RPM),)


def _vibration(sensed: Sensed, rows: IntArray, profile: Profile) -> Values:
    return ((Signal.VIBRATION, _wire(sensed.vibration[rows])),)


@dataclass(frozen=True, slots=True)
class _Source:
    """What a message tells, and the unit of its time [ns]."""

    unit_ns: int
    values: Callable[[Sensed, IntArray, Profile], Values]


_SOURCES: Mapping[int, _Source] = {
    MessageId.ATTITUDE_TARGET: _Source(MS, _attitude_target),
    MessageId.RAW_IMU: _Source(US, _raw_imu),
    MessageId.HIGHRES_IMU: _Source(US, _highres_imu),
    MessageId.ATTITUDE: _Source(MS, _attitude),
    MessageId.LOCAL_POSITION_NED: _Source(MS, _local_position),
    MessageId.HEARTBEAT: _Source(MS, _heartbeat),
    MessageId.SERVO_OUTPUT_RAW: _Source(US, _servo_output),
    MessageId.ACTUATOR_OUTPUT_STATUS: _Source(US, _actuator_output),
    MessageId.ESC_STATUS: _Source(US, _rotor_speed),
    MessageId.ESC_TELEMETRY_1_TO_4: _Source(MS, _rotor_speed),
    MessageId.VIBRATION: _Source(US, _vibration),
}


class TelemetryStream:
    """The fold from samples to telemetry over one link. Equal seeds give equal stamps and losses.

    How a flight is cut into blocks changes nothing.
    """

    def __init__(self, link: LinkSpec, seed: int) -> None:
        spoken = flavour(link.profile)
        self._profile, self._loss = spoken.profile, link.loss
        rates = spoken.rates_hz(link.rate_hz)
        # RAW_IMU is heard where a profile sends both; the second would only be read over it.
        self._heard = {msgid for msgid in _SOURCES if msgid != MessageId.HIGHRES_IMU or msgid == spoken.profile.imu}
        self._schedule = Schedule(rates, spoken.ceiling_hz)
        self._sensing = Sensing(spoken, seed)
        self._losses = {msgid: np.random.default_rng([seed, msgid]) for msgid in self._heard}

    def step(self, samples: PlantSamples) -> Telemetry:
        """The next block (n >= 1)."""
        sensed = self._sensing.step(samples)
        series: list[Series] = []
        for msgid, due in self._schedule.due(samples.t_ns):
            if msgid not in self._heard:
                continue
            rows = due[self._losses[msgid].random(len(due)) >= self._loss] if self._loss else due
            source = _SOURCES[msgid]
            t_ns = sensed.stamp_ns[rows] // source.unit_ns * source.unit_ns
            for signal, values in source.values(sensed, rows, self._profile):
                series.append(Series(signal, t_ns, samples.t_ns[rows], values))
        return Telemetry(tuple(series))


def until_ground(samples: PlantSamples) -> int:
    """How many of the samples are above the ground, z < 0: the plant itself has no ground to fall on."""
    below = np.flatnonzero(samples.position[:, 2] >= 0.0)
    return int(below[0]) if len(below) else len(samples)


def flight_telemetry(config: PlantConfig, duration_s: float, link: LinkSpec = LinkSpec()) -> tuple[Telemetry, float]:
    """A whole flight over one link, and its length [s]: the duration, or less if the vehicle falls to the ground."""
    plant, stream = Plant(config), TelemetryStream(link, config.seed)
    pieces: list[Telemetry] = []
    left = round(duration_s * 1e9 / STEP_NS)
    flown = 0
    while left > 0:
        samples = plant.advance(min(BLOCK_STEPS, left))
        up = until_ground(samples)
        left = left - len(samples) if up == len(samples) else 0
        flown += up
        if up:
            pieces.append(stream.step(samples if up == len(samples) else _first(samples, up)))
    if not pieces:
        raise UsageError(f"a flight must last at least 1 ms, not {duration_s:g} s")
    return joined(pieces), flown * STEP_NS * 1e-9


def _first(samples: PlantSamples, count: int) -> PlantSamples:
    return PlantSamples(*(getattr(samples, name)[:count] for name in PlantSamples.__dataclass_fields__))


def telemetry_digest(telemetry: Telemetry) -> str:
    """SHA-256 (hex) of all times and values: the identity of a flight that never was a file."""
    digest = hashlib.sha256()
    for series in telemetry.series:
        digest.update(series.signal.encode())
        digest.update(np.ascontiguousarray(series.t_ns).tobytes())
        digest.update(np.ascontiguousarray(series.values).tobytes())
    return digest.hexdigest()
