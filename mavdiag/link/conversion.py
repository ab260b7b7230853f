"""Messages to SI, a block at a time: one converter for each message, in one table.

A converter sees the payloads of one message as a record array with the columns that it asked for, and returns one part
for each signal in them. Everything is in the body frame FRD already: MAVLink has it so.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from math import pi
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.clock import MS_32, US_32, US_64, Counter
from mavdiag.link.codec import record_dtype
from mavdiag.link.messages import MavType, MessageId, ModeFlag, TargetMask
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import BoolArray, FloatArray, Signal

__all__ = ["Part", "Source", "euler_angles", "is_vehicle", "sources"]

Record: TypeAlias = NDArray[Any]

UNKNOWN_MV = 0xFFFF  # SYS_STATUS.voltage_battery: not sent
RADS_PER_RPM = 2 * pi / 60
BODY_RATE_BITS = TargetMask.BODY_ROLL_RATE | TargetMask.BODY_PITCH_RATE | TargetMask.BODY_YAW_RATE


class Part(NamedTuple):
    """One signal of a block.

    values: (n, k), in the signal's unit. meant: (n,) which rows carry it, None for all. finite: surely without NaN.
    """

    signal: Signal
    values: FloatArray
    meant: BoolArray | None = None
    finite: bool = False


Converter: TypeAlias = Callable[[Profile, Record], tuple[Part, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One message that a profile listens to, and the signals in it.

    counter: how it counts time in the column `time`, None for no time. dtype: the columns that `convert` reads.
    """

    message: MessageId
    signals: frozenset[Signal]
    counter: Counter | None
    time: str
    dtype: np.dtype[np.void]
    convert: Converter


def _angle_terms() -> FloatArray:
    """(16, 7): from the products q q^T, row by row, to three numerators, three denominators and |q|^2.

    They are of the tangents of roll, pitch and yaw (body to world, order z-y-x). Pitch's denominator is left open: it
    is the hypotenuse of roll's pair, so that nothing is divided or clipped and the length of q does not matter.
    """
    terms = np.zeros((4, 4, 7))
    terms[0, 1, 0] = terms[2, 3, 0] = 2.0  # 2 (w x + y z)
    terms[0, 2, 1], terms[1, 3, 1] = 2.0, -2.0  # 2 (w y - x z)
    terms[0, 3, 2] = terms[1, 2, 2] = 2.0  # 2 (w z + x y)
    for i, squares in enumerate(((1, 0, 1, 1), (-1, 0, 1, 1), (-1, 0, -1, 1), (1, 0, -1, 1))):
        terms[i, i, 3:] = squares
    return terms.reshape(16, 7)


_ANGLE_TERMS = _angle_terms()


def euler_angles(q: FloatArray) -> FloatArray:
    """Roll, pitch, yaw [rad], (n, 3), of quaternions w, x, y, z (n, 4) of any length but zero; NaN for zero."""
    return _euler_angles(q)[0]


def _euler_angles(q: FloatArray) -> tuple[FloatArray, bool]:
    """The same, and whether no quaternion is zero."""
    terms = (q[:, :, None] * q[:, None, :]).reshape(-1, 16) @ _ANGLE_TERMS
    terms[:, 4] = np.hypot(terms[:, 0], terms[:, 3])
    angles: FloatArray = np.arctan2(terms[:, :3], terms[:, 3:6])
    if terms[:, 6].all():
        return angles, True
    angles[terms[:, 6] == 0.0] = np.nan
    return angles, False


def _has(record: Record, column: str) -> bool:
    return column in (record.dtype.names or ())


def _attitude_target(profile: Profile, record: Record) -> tuple[Part, ...]:
    target = record["q"].astype(np.float64)  # q, body rates and thrust lie side by side
    finite = bool(np.isfinite(target).all())
    angles, whole = _euler_angles(target[:, :4])
    mask = record["type_mask"]
    attitude = rate = throttle = None
    if mask.any():
        attitude, rate = mask & TargetMask.ATTITUDE == 0, mask & BODY_RATE_BITS == 0
        throttle = mask & TargetMask.THROTTLE == 0
    return (
        Part(Signal.ATTITUDE_SETPOINT, angles, attitude, finite and whole),
        Part(Signal.RATE_SETPOINT, target[:, 4:7], rate, finite),
        Part(Signal.THRUST_SETPOINT, target[:, 7:], throttle, finite),
    )


def _imu(profile: Profile, record: Record) -> tuple[Part, ...]:
    rate, force = record["xgyro"] * profile.gyro_unit, record["xacc"] * profile.accel_unit
    first = record["id"] == 0 if _has(record, "id") and record["id"].any() else None
    finite = record["xacc"].dtype.kind == "i"
    return Part(Signal.BODY_RATE, rate, first, finite), Part(Signal.SPECIFIC_FORCE, force, first, finite)


def _attitude(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.ATTITUDE, record["roll"].astype(np.float64)),)


def _local_position(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.HEIGHT, -record["z"].astype(np.float64)[:, None]),)


def _sys_status(profile: Profile, record: Record) -> tuple[Part, ...]:
    millivolts = record["voltage_battery"]
    return (Part(Signal.VOLTAGE, 1e-3 * millivolts[:, None], millivolts != UNKNOWN_MV, finite=True),)


def _heartbeat(profile: Profile, record: Record) -> tuple[Part, ...]:
    armed = (record["base_mode"] & ModeFlag.SAFETY_ARMED != 0).astype(np.float64)
    return (Part(Signal.ARMED, armed[:, None], is_vehicle(record["type"]), finite=True),)


def is_vehicle(mav_type: NDArray[np.integer[Any]]) -> BoolArray:
    """Which HEARTBEAT.type are of a vehicle, not of a ground station or an on-board computer."""
    vehicle: BoolArray = (mav_type != MavType.GCS) & (mav_type != MavType.ONBOARD_CONTROLLER)
    return vehicle


def _servo_outputs(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.ACTUATOR, _span(profile, record["servo1_raw"]), record["port"] == 0, finite=True),)


def _actuator_outputs(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.ACTUATOR, _span(profile, record["actuator"])),)


def _span(profile: Profile, raw: Record) -> FloatArray:
    low, high = profile.actuator_span
    share: FloatArray = (raw[:, : profile.rotors] - low) * (1.0 / (high - low))
    return np.minimum(np.maximum(share, 0.0), 1.0)


def _vibration(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.VIBRATION, record["vibration_x"].astype(np.float64)),)


def _rotor_speed(profile: Profile, record: Record) -> tuple[Part, ...]:
    first = record["index"] == 0 if _has(record, "index") else None
    return (Part(Signal.ROTOR_SPEED, RADS_PER_RPM * np.abs(record["rpm"], dtype=np.float64), first, finite=True),)


def _source(
    message: MessageId,
    convert: Converter,
    signals: tuple[Signal, ...],
    columns: tuple[tuple[str, int], ...],
    time: tuple[str, Counter] | None = None,
) -> Source:
    name, counter = time or ("", None)
    dtype = record_dtype(message, *((name, 1),) if counter else (), *columns)
    return Source(message, frozenset(signals), counter, name, dtype, convert)


_BOOT_MS, _USEC, _USEC_32 = ("time_boot_ms", MS_32), ("time_usec", US_64), ("time_usec", US_32)
_TARGET = (Signal.ATTITUDE_SETPOINT, Signal.RATE_SETPOINT, Signal.THRUST_SETPOINT)
_MOTION = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE)
_VECTORS = (("xacc", 3), ("xgyro", 3))
_VECTORS_ID = (*_VECTORS, ("id", 1))
_SERVOS = (("servo1_raw", 8), ("port", 1))
_SOURCES = {
    source.message: source
    for source in (
        _source(MessageId.ATTITUDE_TARGET, _attitude_target, _TARGET, (("q", 8), ("type_mask", 1)), _BOOT_MS),
        _source(MessageId.RAW_IMU, _imu, _MOTION, _VECTORS_ID, _USEC),
        _source(MessageId.SCALED_IMU, _imu, _MOTION, _VECTORS, _BOOT_MS),
        _source(MessageId.SCALED_IMU2, _imu, _MOTION, _VECTORS, _BOOT_MS),
        _source(MessageId.SCALED_IMU3, _imu, _MOTION, _VECTORS, _BOOT_MS),
        _source(MessageId.HIGHRES_IMU, _imu, _MOTION, _VECTORS_ID, _USEC),
        _source(MessageId.ATTITUDE, _attitude, (Signal.ATTITUDE,), (("roll", 3),), _BOOT_MS),
        _source(MessageId.LOCAL_POSITION_NED, _local_position, (Signal.HEIGHT,), (("z", 1),), _BOOT_MS),
        _source(MessageId.SYS_STATUS, _sys_status, (Signal.VOLTAGE,), (("voltage_battery", 1),)),
        _source(MessageId.HEARTBEAT, _heartbeat, (Signal.ARMED,), (("type", 1), ("base_mode", 1))),
        _source(MessageId.SERVO_OUTPUT_RAW, _servo_outputs, (Signal.ACTUATOR,), _SERVOS, _USEC_32),
        _source(MessageId.ACTUATOR_OUTPUT_STATUS, _actuator_outputs, (Signal.ACTUATOR,), (("actuator", 32),), _USEC),
        _source(MessageId.VIBRATION, _vibration, (Signal.VIBRATION,), (("vibration_x", 3),), _USEC),
        _source(MessageId.ESC_STATUS, _rotor_speed, (Signal.ROTOR_SPEED,), (("rpm", 4), ("index", 1)), _USEC),
        _source(MessageId.ESC_TELEMETRY_1_TO_4, _rotor_speed, (Signal.ROTOR_SPEED,), (("rpm", 4),)),
    )
}


def sources(profile: Profile, signals: Collection[Signal] = tuple(Signal)) -> tuple[Source, ...]:
    """The messages that a profile listens to for these signals, each once."""
    chosen = [
        profile.setpoint,
        profile.imu,
        MessageId.ATTITUDE,
        MessageId.LOCAL_POSITION_NED,
        MessageId.SYS_STATUS,
        MessageId.HEARTBEAT,
        profile.actuator,
        profile.rotor_speed,
    ]
    if profile.vibration:
        chosen.append(MessageId.VIBRATION)
    return tuple(_SOURCES[message] for message in chosen if not _SOURCES[message].signals.isdisjoint(signals))
