"""From what the autopilot knows to MAVLink messages: each one of the schedule, made from the sample it is due at.

A block of samples becomes one record array for each message, whole columns at a time: its bytes are the payloads on the
wire, and the converters of `mavdiag.link` read the same records. A message gets its sequence number only when it is
sent, because an answer may overtake it.
"""

from collections.abc import Callable, Mapping
from functools import cache, partial
from itertools import repeat
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.codec import record_dtype
from mavdiag.link.messages import MavType, MessageId, ModeFlag
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_US, RPM
from sitl_plant.autopilot.dialect import ESC_GROUP, Dialect
from sitl_plant.autopilot.imu_filters import FilteredSamples
from sitl_plant.autopilot.positions import POSITIONS, integers, remaining
from sitl_plant.autopilot.schedule import Schedule

Column: TypeAlias = FloatArray | IntArray | int  # (n,), or (n, k) for k fields side by side, or a constant
Columns: TypeAlias = Mapping[str, Column]
Record: TypeAlias = NDArray[Any]
_Builder: TypeAlias = Callable[[FilteredSamples, IntArray, Dialect], Columns]

STANDBY, ACTIVE = 3, 4  # MAV_STATE
ON_GROUND, IN_AIR = 1, 2  # MAV_LANDED_STATE
FLYING = 2  # `PlantSamples.motors`
HIGHRES_FIELDS = 0b111111  # HIGHRES_IMU.fields_updated: accelerometer and gyro
# MAV_SYS_STATUS_SENSOR: gyro, accelerometer, magnetometer, GPS and vision (motion capture is all three), motor outputs,
# geofence, AHRS, battery, pre-arm check, propulsion
HEALTH = 0x1 | 0x2 | 0x4 | 0x20 | 0x80 | 0x8000 | 0x100000 | 0x200000 | 0x2000000 | 0x10000000 | 0x40000000
TYPES = {4: MavType.QUADROTOR, 6: MavType.HEXAROTOR, 8: MavType.OCTOROTOR}
SERVOS = 8  # outputs of SERVO_OUTPUT_RAW beside each other; the other eight are extensions


class Message(NamedTuple):
    """A message to be sent."""

    t_ns: int  # flight time
    msgid: int
    payload: bytes  # with all its zeros, as `Encoder.encode_payload` takes it


class Streamer:
    """The sending half of the emulated autopilot, for one link."""

    def __init__(self, dialect: Dialect, schedule: Schedule) -> None:
        self._dialect, self._schedule = dialect, schedule

    def step(self, filtered: FilteredSamples, dialect: Dialect | None = None) -> list[Message]:
        """The messages of a block in order of time. dialect: that of now, if the flight mode has changed."""
        self._dialect = dialect or self._dialect
        messages: list[Message] = []
        for msgid, due in self._schedule.due(filtered.samples.t_ns):
            rows, record = records(msgid, filtered, due, self._dialect)
            payloads, size = record.tobytes(), record.dtype.itemsize
            cuts = (payloads[at : at + size] for at in range(0, len(payloads), size))
            messages += map(Message, filtered.samples.t_ns[rows].tolist(), repeat(msgid), cuts)
        messages.sort(key=itemgetter(0))  # stable: messages of one instant keep the schedule's order
        return messages


def records(msgid: int, filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> tuple[IntArray, Record]:
    """The payloads of one message that is due at some rows of a block, and the row of each payload.

    There are more payloads than rows where one message does not carry all rotors. Fields without a column are zero.
    """
    columns = _BUILDERS[msgid](filtered, rows, dialect)
    shapes = {name: np.shape(column) for name, column in columns.items()}
    dtype = _dtype(msgid, tuple((name, shape[1] if len(shape) == 2 else 1) for name, shape in shapes.items()))
    record = np.zeros(next(shape[0] for shape in shapes.values() if shape), dtype)
    for name, column in columns.items():
        record[name] = np.reshape(column, record[name].shape) if np.ndim(column) else column
    return np.repeat(rows, len(record) // len(rows)), record


@cache
def _dtype(msgid: int, columns: tuple[tuple[str, int], ...]) -> np.dtype[np.void]:
    return record_dtype(msgid, *columns)


def _boot_ms(filtered: FilteredSamples, rows: IntArray) -> IntArray:
    return filtered.stamp_ns[rows] // NS_PER_MS % (1 << 32)


def _boot_us(filtered: FilteredSamples, rows: IntArray) -> IntArray:
    return filtered.stamp_ns[rows] // NS_PER_US


def _quaternion(angles: FloatArray) -> FloatArray:
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def _groups(values: FloatArray | IntArray) -> Any:
    n, rotors = values.shape
    groups = -(-rotors // ESC_GROUP)
    padded = np.zeros((n, groups * ESC_GROUP), dtype=values.dtype)
    padded[:, :rotors] = values
    return padded.reshape(n * groups, ESC_GROUP)


def _heartbeat(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    motors = filtered.samples.motors[rows]
    return {
        "type": TYPES.get(filtered.samples.duty.shape[1], MavType.GENERIC),
        "autopilot": dialect.profile.autopilot,
        "base_mode": ModeFlag.CUSTOM_MODE_ENABLED + ModeFlag.SAFETY_ARMED * (motors > 0),
        "custom_mode": dialect.custom_mode,
        "system_status": np.where(motors > 0, ACTIVE, STANDBY),
        "mavlink_version": 3,
    }


def _sys_status(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    volts = filtered.samples.battery_v[rows]
    return {
        "onboard_control_sensors_present": HEALTH,
        "onboard_control_sensors_enabled": HEALTH,
        "onboard_control_sensors_health": HEALTH,
        "voltage_battery": integers(1e3 * volts, 16),
        "current_battery": -1,  # not measured
        "battery_remaining": remaining(filtered, rows),
    }


def _extended_state(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {"landed_state": np.where(filtered.samples.motors[rows] == FLYING, IN_AIR, ON_GROUND)}


def _attitude_target(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    samples = filtered.samples
    return {
        "time_boot_ms": _boot_ms(filtered, rows),
        "q": _quaternion(samples.setpoint[rows]),
        "body_roll_rate": samples.rate_setpoint[rows],
        "thrust": samples.thrust_setpoint[rows],
    }


def _raw_imu(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {
        "time_usec": _boot_us(filtered, rows),
        "xacc": integers(filtered.accel[rows] / dialect.profile.accel_unit, 16),
        "xgyro": integers(filtered.gyro[rows] / dialect.profile.gyro_unit, 16),
    }


def _highres_imu(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {
        "time_usec": _boot_us(filtered, rows),
        "xacc": filtered.accel[rows],
        "xgyro": filtered.gyro[rows],
        "fields_updated": HIGHRES_FIELDS,
    }


def _attitude(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {
        "time_boot_ms": _boot_ms(filtered, rows),
        "roll": filtered.samples.attitude[rows, :3],
        "rollspeed": filtered.gyro[rows],
    }


def _attitude_quaternion(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {
        "time_boot_ms": _boot_ms(filtered, rows),
        "q1": _quaternion(filtered.samples.attitude[rows, :3]),
        "rollspeed": filtered.gyro[rows],
    }


def _local_position(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {
        "time_boot_ms": _boot_ms(filtered, rows),
        "x": filtered.samples.position[rows],
        "vx": filtered.samples.velocity[rows],
    }


def _servo_output(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    low, high = dialect.profile.actuator_span
    servos = integers(low + (high - low) * filtered.samples.duty[rows], 17)
    columns = {"time_usec": _boot_us(filtered, rows) % (1 << 32), "servo1_raw": servos[:, :SERVOS]}
    return columns | ({"servo9_raw": servos[:, SERVOS:]} if servos.shape[1] > SERVOS else {})


def _actuator_output(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    low, high = dialect.profile.actuator_span
    duty = filtered.samples.duty[rows]
    return {
        "time_usec": _boot_us(filtered, rows),
        "active": duty.shape[1],
        "actuator": low + (high - low) * duty,
    }


def _reported(filtered: FilteredSamples, rows: IntArray) -> FloatArray:
    return np.nan_to_num(filtered.samples.esc_speed[rows], nan=0.0)


def _esc_status(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    rpm = _groups(integers(_reported(filtered, rows) / RPM, 32))
    groups = len(rpm) // len(rows)
    return {
        "time_usec": np.repeat(_boot_us(filtered, rows), groups),
        "index": np.tile(ESC_GROUP * np.arange(groups), len(rows)),
        "rpm": rpm,
        "voltage": _groups(np.repeat(filtered.samples.battery_v[rows, None], filtered.samples.duty.shape[1], axis=1)),
    }


def _esc_telemetry(first: int, filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    rpm = integers(_reported(filtered, rows)[:, first : first + ESC_GROUP] / RPM, 17)
    volts = integers(100.0 * filtered.samples.battery_v[rows], 17)
    return {"rpm": _groups(rpm), "voltage": _groups(np.repeat(volts[:, None], rpm.shape[1], axis=1))}


def _vibration(filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> Columns:
    return {
        "time_usec": _boot_us(filtered, rows),
        "vibration_x": filtered.vibration[rows],
        "clipping_0": filtered.clippings[rows],
    }


def _without_dialect(build: Callable[[FilteredSamples, IntArray], Columns]) -> _Builder:
    return lambda filtered, rows, dialect: build(filtered, rows)


_BUILDERS: Mapping[int, _Builder] = {
    MessageId.HEARTBEAT: _heartbeat,
    MessageId.SYS_STATUS: _sys_status,
    MessageId.EXTENDED_SYS_STATE: _extended_state,
    MessageId.RAW_IMU: _raw_imu,
    MessageId.ATTITUDE: _attitude,
    MessageId.ATTITUDE_QUATERNION: _attitude_quaternion,
    MessageId.LOCAL_POSITION_NED: _local_position,
    MessageId.SERVO_OUTPUT_RAW: _servo_output,
    MessageId.ATTITUDE_TARGET: _attitude_target,
    MessageId.HIGHRES_IMU: _highres_imu,
    MessageId.VIBRATION: _vibration,
    MessageId.ESC_STATUS: _esc_status,
    MessageId.ACTUATOR_OUTPUT_STATUS: _actuator_output,
    **{msgid: _without_dialect(build) for msgid, build in POSITIONS.items()},
    **{MessageId.ESC_TELEMETRY_1_TO_4 + k: partial(_esc_telemetry, ESC_GROUP * k) for k in range(3)},
}
