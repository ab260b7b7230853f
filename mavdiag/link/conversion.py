"""Messages to SI, a block at a time: one conversion for each message, in one table.

A conversion sees the payloads of one message as a record array with the columns that it asked for, and returns one part
for each signal in them. Everything is in the body frame FRD already: MAVLink has it so. A new message is a row of
`SOURCES`, and its number in `mavdiag.link.messages.MessageId`.
"""

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.jit import cached
from mavdiag.link.batch import Record
from mavdiag.link.clock import MS_32, US_32, US_64, Counter
from mavdiag.link.codec import record_dtype
from mavdiag.link.messages import MavType, MessageId, ModeFlag, TargetMask
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import BoolArray, FloatArray, Signal
from mavdiag.units import RPM

UNKNOWN_MV = 0xFFFF  # SYS_STATUS.voltage_battery: not sent
ACTUATORS = 16  # columns of ACTUATOR, always: outputs that are not in use are 0; the rotor layout says which count
ROTORS = 16  # columns of ROTOR_SPEED, always: rotors that were never reported are NaN
PULSE_US = 1000.0, 2000.0  # PWM for 0 and full output
PULSE_LEAST_US = 800.0  # no pulse is shorter (our choice: the shortest disarmed one of PX4 is 900)
DSHOT_FULL = 2047.0  # the largest of its 11 bits
BODY_RATE_BITS = TargetMask.BODY_ROLL_RATE | TargetMask.BODY_PITCH_RATE | TargetMask.BODY_YAW_RATE


class Part(NamedTuple):
    """One signal of a block.

    signal: what it measures.
    values: (n, k), in the signal's unit.
    meant: (n,) which rows carry it, None for all.
    finite: surely without NaN.
    held: a NaN stands for "not in this message": the column keeps its last value.
    """

    signal: Signal
    values: FloatArray
    meant: BoolArray | None = None
    finite: bool = False
    held: bool = False


Conversion: TypeAlias = Callable[[Profile, Record], tuple[Part, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One message that is read, and the signals in it.

    message: its number.
    signals: what it carries.
    counter: how it counts time in the column `time`, None for no time.
    time: name of that column.
    dtype: the columns that `convert` reads.
    convert: from a profile and a block of records to the parts.
    chosen_by: it is read by the profiles that use this message; None for all profiles.
    """

    message: int
    signals: frozenset[Signal]
    counter: Counter | None
    time: str
    dtype: np.dtype[np.void]
    convert: Conversion
    chosen_by: int | None


SQUARED = (1e-2, 1e2)  # length of a quaternion, squared: beyond it is none, but a damaged frame with a right checksum


def euler_angles(q: FloatArray) -> FloatArray:
    """Roll, pitch, yaw [rad], (n, 3), of quaternions w, x, y, z (n, 4); NaN for a length outside of 0.1 to 10.

    Body to world, order z-y-x. Pitch's denominator is the hypotenuse of roll's pair, so that nothing is divided or
    clipped and the length of q does not matter.
    """
    angles = np.empty((len(q), 3))
    _fill_angles(q, angles)
    return angles


@cached
def _fill_angles(q: FloatArray, angles: FloatArray) -> bool:
    """Write the angles; returns whether every quaternion has a length that one may have."""
    whole = True
    for k in range(len(q)):
        w, x, y, z = q[k, 0], q[k, 1], q[k, 2], q[k, 3]
        ww, xx, yy, zz = w * w, x * x, y * y, z * z
        squared = ww + xx + yy + zz
        if not (squared > SQUARED[0] and squared < SQUARED[1]):
            angles[k, 0] = angles[k, 1] = angles[k, 2] = np.nan
            whole = False
            continue
        sine, cosine = 2.0 * (w * x + y * z), ww - xx - yy + zz
        angles[k, 0] = math.atan2(sine, cosine)
        angles[k, 1] = math.atan2(2.0 * (w * y - x * z), math.hypot(sine, cosine))
        angles[k, 2] = math.atan2(2.0 * (w * z + x * y), ww + xx - yy - zz)
    return whole


def _attitude_target(profile: Profile, record: Record) -> tuple[Part, ...]:
    target = record["q"].astype(np.float64)  # q, body rates and thrust lie side by side
    finite = bool(np.isfinite(target).all())
    angles = np.empty((len(target), 3))
    whole = _fill_angles(target, angles)
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
    first = record["id"] == 0 if record.dtype.names and "id" in record.dtype.names else None
    first = None if first is None or first.all() else first
    finite = record["xacc"].dtype.kind == "i"
    return Part(Signal.BODY_RATE, rate, first, finite), Part(Signal.SPECIFIC_FORCE, force, first, finite)


def _attitude(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.ATTITUDE, record["roll"].astype(np.float64)),)


def _attitude_and_rates(profile: Profile, record: Record) -> tuple[Part, ...]:
    return *_attitude(profile, record), Part(Signal.BODY_RATE, record["rollspeed"].astype(np.float64))


def _local_position(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.HEIGHT, -record["z"].astype(np.float64)[:, None]),)


def _sys_status(profile: Profile, record: Record) -> tuple[Part, ...]:
    millivolts = record["voltage_battery"]
    return (Part(Signal.VOLTAGE, 1e-3 * millivolts[:, None], millivolts != UNKNOWN_MV, finite=True),)


def _heartbeat(profile: Profile, record: Record) -> tuple[Part, ...]:
    vehicle = (record["type"] != MavType.GCS) & (record["type"] != MavType.ONBOARD_CONTROLLER)
    armed = (record["base_mode"] & ModeFlag.SAFETY_ARMED != 0).astype(np.float64)
    return (Part(Signal.ARMED, armed[:, None], vehicle, finite=True),)


def _servo_outputs(profile: Profile, record: Record) -> tuple[Part, ...]:
    raw = np.concatenate((record["servo1_raw"], record["servo9_raw"]), axis=1)
    return (Part(Signal.ACTUATOR, _share(profile, raw), record["port"] == 0, finite=True),)


def _actuator_outputs(profile: Profile, record: Record) -> tuple[Part, ...]:
    """PX4 sends what its driver gets, and no unit: told by the values of each message (REVIEW H2).

    Nothing above 1: shares, as in simulation. No output below 800: microseconds; an unused one rests at 900 or 1000.
    Else DShot, where unused ones are 0. PX4 fills `active` with the number of outputs; what is behind them are zeros.
    """
    raw, number = record["actuator"][:, :ACTUATORS].astype(np.float64), record["active"][:, None]
    used = np.isfinite(raw) & ((np.arange(ACTUATORS) < number) | (number < 1))
    raw = np.where(np.isfinite(raw), raw, 0.0)
    share = raw.max(axis=1) <= 1.0
    pulses = ~share & (np.where(used, raw, PULSE_LEAST_US).min(axis=1) >= PULSE_LEAST_US)
    low = np.where(pulses, PULSE_US[0], 0.0)
    span = np.where(share, 1.0, np.where(pulses, PULSE_US[1] - PULSE_US[0], DSHOT_FULL))
    return (Part(Signal.ACTUATOR, np.clip((raw - low[:, None]) / span[:, None], 0.0, 1.0), finite=True),)


def _share(profile: Profile, raw: Record) -> FloatArray:
    """Pulses as shares of the full output, 0..1; an output that is not in use (0 us) becomes 0."""
    low, high = profile.actuator_span
    share: FloatArray = (raw - low) * (1.0 / (high - low))
    return np.minimum(np.maximum(share, 0.0), 1.0)


def _vibration(profile: Profile, record: Record) -> tuple[Part, ...]:
    return (Part(Signal.VIBRATION, record["vibration_x"].astype(np.float64)),)


def _esc_status(profile: Profile, record: Record) -> tuple[Part, ...]:
    """Four rotors from `index` on. What the message leaves out keeps its last value."""
    speed = np.full((len(record), ROTORS + 4), np.nan)
    columns = np.minimum(record["index"].astype(np.intp), ROTORS)[:, None] + np.arange(4)
    np.put_along_axis(speed, columns, RPM * np.abs(record["rpm"], dtype=np.float64), axis=1)
    return (Part(Signal.ROTOR_SPEED, speed[:, :ROTORS], record["index"] < ROTORS, finite=True, held=True),)


def _esc_telemetry(first: int) -> Conversion:
    """Four rotors from `first` on."""

    def convert(profile: Profile, record: Record) -> tuple[Part, ...]:
        speed = np.full((len(record), ROTORS), np.nan)
        speed[:, first : first + 4] = RPM * record["rpm"]
        return (Part(Signal.ROTOR_SPEED, speed, finite=True, held=True),)

    return convert


def source(
    message: int,
    convert: Conversion,
    signals: tuple[Signal, ...],
    columns: tuple[tuple[str, int], ...],
    time: tuple[str, Counter] | None = None,
    chosen_by: int | None = None,
) -> Source:
    """One row of the table.

    columns: (field, count) that `convert` reads, see `codec.record_dtype`.
    time: the field that counts time, and how; None for no time.
    chosen_by: see `Source`.
    Raises UsageError if the message has no such fields.
    """
    name, counter = time or ("", None)
    dtype = record_dtype(message, *((name, 1),) if counter else (), *columns)
    return Source(message, frozenset(signals), counter, name, dtype, convert, chosen_by)


_BOOT_MS, _USEC, _USEC_32 = ("time_boot_ms", MS_32), ("time_usec", US_64), ("time_usec", US_32)
_TARGET = (Signal.ATTITUDE_SETPOINT, Signal.RATE_SETPOINT, Signal.THRUST_SETPOINT)
_MOTION = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE)
_TARGET_COLUMNS = (("q", 8), ("type_mask", 1))
_VECTORS = (("xacc", 3), ("xgyro", 3))
_SERVOS = (("servo1_raw", 8), ("servo9_raw", 8), ("port", 1))
_RPM = (("rpm", 4),)
_ACTUATOR, _SPEED, _ESCS = (Signal.ACTUATOR,), (Signal.ROTOR_SPEED,), MessageId.ESC_TELEMETRY_1_TO_4
_M = MessageId

#: Every message that is read, in any profile.
SOURCES: tuple[Source, ...] = (
    source(_M.ATTITUDE_TARGET, _attitude_target, _TARGET, _TARGET_COLUMNS, _BOOT_MS, _M.ATTITUDE_TARGET),
    source(_M.RAW_IMU, _imu, _MOTION, (*_VECTORS, ("id", 1)), _USEC, _M.RAW_IMU),
    source(_M.SCALED_IMU, _imu, _MOTION, _VECTORS, _BOOT_MS, _M.SCALED_IMU),
    source(_M.SCALED_IMU2, _imu, _MOTION, _VECTORS, _BOOT_MS, _M.SCALED_IMU2),
    source(_M.SCALED_IMU3, _imu, _MOTION, _VECTORS, _BOOT_MS, _M.SCALED_IMU3),
    source(_M.HIGHRES_IMU, _imu, _MOTION, (*_VECTORS, ("id", 1)), _USEC, _M.HIGHRES_IMU),
    source(_M.ATTITUDE, _attitude, (Signal.ATTITUDE,), (("roll", 3),), _BOOT_MS),
    # In place of the row above, where the gyro is read from it too.
    source(
        _M.ATTITUDE,
        _attitude_and_rates,
        (Signal.ATTITUDE, Signal.BODY_RATE),
        (("roll", 3), ("rollspeed", 3)),
        _BOOT_MS,
        _M.ATTITUDE,
    ),
    source(_M.LOCAL_POSITION_NED, _local_position, (Signal.HEIGHT,), (("z", 1),), _BOOT_MS),
    source(_M.SYS_STATUS, _sys_status, (Signal.VOLTAGE,), (("voltage_battery", 1),)),
    source(_M.HEARTBEAT, _heartbeat, (Signal.ARMED,), (("type", 1), ("base_mode", 1))),
    source(_M.SERVO_OUTPUT_RAW, _servo_outputs, _ACTUATOR, _SERVOS, _USEC_32, _M.SERVO_OUTPUT_RAW),
    source(
        _M.ACTUATOR_OUTPUT_STATUS,
        _actuator_outputs,
        _ACTUATOR,
        (("active", 1), ("actuator", 32)),
        _USEC,
        _M.ACTUATOR_OUTPUT_STATUS,
    ),
    source(_M.VIBRATION, _vibration, (Signal.VIBRATION,), (("vibration_x", 3),), _USEC, _M.VIBRATION),
    source(_M.ESC_STATUS, _esc_status, _SPEED, (*_RPM, ("index", 1)), _USEC, _M.ESC_STATUS),
    source(_ESCS, _esc_telemetry(0), _SPEED, _RPM, None, _ESCS),
    source(_M.ESC_TELEMETRY_5_TO_8, _esc_telemetry(4), _SPEED, _RPM, None, _ESCS),
    source(_M.ESC_TELEMETRY_9_TO_12, _esc_telemetry(8), _SPEED, _RPM, None, _ESCS),
)


def sources(
    profile: Profile, signals: Collection[Signal] = tuple(Signal), table: Iterable[Source] = SOURCES
) -> tuple[Source, ...]:
    """The rows of the table that a profile reads for these signals; of two for one message the later one counts."""
    messages = profile.messages
    return tuple(
        row
        for row in table
        if (row.chosen_by is None or row.chosen_by in messages) and not row.signals.isdisjoint(signals)
    )
