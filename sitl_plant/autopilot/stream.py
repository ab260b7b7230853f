"""From what the autopilot knows to MAVLink messages: each one of the schedule, made from the sample it is due at.

A block of samples becomes columns in the units of each message, whole arrays at a time. A message gets its sequence
number only when it is sent, because an answer may overtake it.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import repeat
from operator import itemgetter
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.link.codec import FieldValue, wire_fields
from mavdiag.link.messages import MavType, MessageId, ModeFlag
from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.autopilot.dialect import Flavour
from sitl_plant.autopilot.imu_filters import Sensed
from sitl_plant.autopilot.schedule import Schedule

__all__ = ["Message", "Streamer"]

Column: TypeAlias = FloatArray | IntArray | int | float  # (n,), or (n, k) for k fields side by side, or a constant
Columns: TypeAlias = Mapping[str, Column]

ACTIVE = 4  # MAV_STATE_ACTIVE
IN_AIR = 2  # MAV_LANDED_STATE_IN_AIR
RPM = 2.0 * np.pi / 60.0  # rad/s
HIGHRES_FIELDS = 0b111111  # HIGHRES_IMU.fields_updated: accelerometer and gyro
# MAV_SYS_STATUS_SENSOR: gyro, accelerometer, motor outputs, geofence, AHRS, battery, pre-arm check, propulsion
HEALTH = 0x1 | 0x2 | 0x8000 | 0x100000 | 0x200000 | 0x2000000 | 0x10000000 | 0x40000000
FULL_V, EMPTY_V = 16.8, 14.0  # of a 4S battery: what "100 %" and "0 %" mean (estimate)


class Message(NamedTuple):
    """A message to be sent at flight time t_ns. fields: as `Encoder.encode_wire` takes them."""

    t_ns: int
    msgid: int
    fields: tuple[FieldValue, ...]


class Streamer:
    """The sending half of the emulated autopilot, for one link."""

    def __init__(self, flavour: Flavour, schedule: Schedule) -> None:
        self._flavour, self._schedule = flavour, schedule

    def step(self, sensed: Sensed) -> list[Message]:
        """The messages of a block in order of time."""
        messages: list[Message] = []
        for msgid, rows in self._schedule.due(sensed.samples.t_ns):
            columns = _BUILDERS[msgid](sensed, rows, self._flavour)
            fields = _wire_rows(msgid, len(rows), columns)
            messages += map(Message, sensed.samples.t_ns[rows].tolist(), repeat(msgid), fields)
        messages.sort(key=itemgetter(0))  # stable: messages of one instant keep the schedule's order
        return messages


def _wire_rows(msgid: int, n: int, columns: Columns) -> list[tuple[FieldValue, ...]]:
    """n messages as tuples in the order of the wire; fields without a column are zero."""
    places: list[list[FieldValue]] = []
    for name, size in wire_fields(msgid):
        column = columns.get(name, 0)
        if not isinstance(column, np.ndarray):
            places += [[column] * n] * size
        elif column.ndim == 1:
            places.append(column.tolist())
        else:
            places += column.T.tolist()
            places += [[0] * n] * (size - column.shape[1])
    return list(zip(*places, strict=True))


def _integers(values: FloatArray, bits: int) -> IntArray:
    """Rounded and held in a signed field of so many bits."""
    top = (1 << bits - 1) - 1
    return np.clip(np.rint(values), -top - 1, top).astype(np.int64)


def _boot_ms(sensed: Sensed, rows: IntArray) -> IntArray:
    return sensed.stamp_ns[rows] // 1_000_000 % (1 << 32)


def _boot_us(sensed: Sensed, rows: IntArray) -> IntArray:
    return sensed.stamp_ns[rows] // 1_000


def _quaternion(angles: FloatArray) -> FloatArray:
    """(n, 4) w, x, y, z, body to world, from (n, 3) roll, pitch, yaw in the order z-y-x."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def _spread(name: str, parts: Sequence[str], values: FloatArray | IntArray) -> dict[str, Column]:
    """The columns of a vector as fields of their own: `_spread("{}acc", "xyz", ...)` gives xacc, yacc, zacc."""
    return {name.format(part): values[:, i] for i, part in enumerate(parts)}


def _heartbeat(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "type": MavType.QUADROTOR,
        "autopilot": flavour.profile.autopilot,
        "base_mode": ModeFlag.CUSTOM_MODE_ENABLED | ModeFlag.SAFETY_ARMED,
        "custom_mode": flavour.custom_mode,
        "system_status": ACTIVE,
        "mavlink_version": 3,
    }


def _sys_status(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    volts = sensed.samples.battery_v[rows]
    return {
        "onboard_control_sensors_present": HEALTH,
        "onboard_control_sensors_enabled": HEALTH,
        "onboard_control_sensors_health": HEALTH,
        "voltage_battery": _integers(1e3 * volts, 16),
        "current_battery": -1,  # not measured
        "battery_remaining": _integers(100.0 * np.clip((volts - EMPTY_V) / (FULL_V - EMPTY_V), 0.0, 1.0), 8),
    }


def _extended_state(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {"landed_state": IN_AIR}


def _attitude_target(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    samples = sensed.samples
    return {
        "time_boot_ms": _boot_ms(sensed, rows),
        "q": _quaternion(samples.setpoint[rows]),
        **_spread("body_{}_rate", ("roll", "pitch", "yaw"), samples.rate_setpoint[rows]),
        "thrust": samples.thrust_setpoint[rows],
    }


def _raw_imu(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "time_usec": _boot_us(sensed, rows),
        **_spread("{}acc", "xyz", _integers(sensed.accel[rows] / flavour.profile.accel_unit, 16)),
        **_spread("{}gyro", "xyz", _integers(sensed.gyro[rows] / flavour.profile.gyro_unit, 16)),
    }


def _highres_imu(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "time_usec": _boot_us(sensed, rows),
        **_spread("{}acc", "xyz", sensed.accel[rows]),
        **_spread("{}gyro", "xyz", sensed.gyro[rows]),
        "fields_updated": HIGHRES_FIELDS,
    }


def _attitude(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "time_boot_ms": _boot_ms(sensed, rows),
        **_spread("{}", ("roll", "pitch", "yaw"), sensed.samples.attitude[rows]),
        **_spread("{}speed", ("roll", "pitch", "yaw"), sensed.gyro[rows]),
    }


def _attitude_quaternion(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "time_boot_ms": _boot_ms(sensed, rows),
        **_spread("q{}", "1234", _quaternion(sensed.samples.attitude[rows, :3])),
        **_spread("{}speed", ("roll", "pitch", "yaw"), sensed.gyro[rows]),
    }


def _local_position(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    """The true position: motion capture gives it to a fraction of a millimetre."""
    return {
        "time_boot_ms": _boot_ms(sensed, rows),
        **_spread("{}", "xyz", sensed.samples.position[rows]),
        **_spread("v{}", "xyz", sensed.samples.velocity[rows]),
    }


def _servo_output(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    low, high = flavour.profile.actuator_span
    names = tuple(str(i + 1) for i in range(flavour.profile.rotors))
    return {
        "time_usec": _boot_us(sensed, rows) % (1 << 32),
        **_spread("servo{}_raw", names, _integers(low + (high - low) * sensed.samples.duty[rows], 17)),
    }


def _actuator_output(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    low, high = flavour.profile.actuator_span
    return {
        "time_usec": _boot_us(sensed, rows),
        "active": flavour.profile.rotors,
        "actuator": low + (high - low) * sensed.samples.duty[rows],
    }


def _esc_status(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "time_usec": _boot_us(sensed, rows),
        "rpm": _integers(sensed.samples.rotor_speed[rows] / RPM, 32),
        "voltage": np.repeat(sensed.samples.battery_v[rows, np.newaxis], flavour.profile.rotors, axis=1),
    }


def _esc_telemetry(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    volts = _integers(100.0 * sensed.samples.battery_v[rows], 17)
    return {
        "rpm": _integers(sensed.samples.rotor_speed[rows] / RPM, 17),
        "voltage": np.repeat(volts[:, np.newaxis], flavour.profile.rotors, axis=1),
    }


def _vibration(sensed: Sensed, rows: IntArray, flavour: Flavour) -> Columns:
    return {
        "time_usec": _boot_us(sensed, rows),
        **_spread("vibration_{}", "xyz", sensed.vibration[rows]),
        "clipping_0": sensed.clippings[rows],
    }


_BUILDERS: Mapping[int, Callable[[Sensed, IntArray, Flavour], Columns]] = {
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
    MessageId.ESC_TELEMETRY_1_TO_4: _esc_telemetry,
}
