"""From what the autopilot knows to MAVLink messages: each one of the schedule, made from the sample it is due at.

A block of samples becomes one record array for each message, whole columns at a time: its bytes are the payloads on the
wire, and the converters of `mavdiag.link` read the same records. The emulated vehicle flies by motion capture; what it
knows of its place is told as an autopilot with a GPS tells it, on a plane that touches the earth at its home.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from itertools import repeat
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached_loop
from mavdiag.link.codec import layout_of
from mavdiag.link.messages import MavType, MessageId, ModeFlag
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_US, RPM, G
from sitl_plant.autopilot.dialect import ESC_GROUP, Dialect
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.sensors import butterworth
from sitl_plant.physics.trajectory import FLYING
from sitl_plant.plant import PlantSamples

Column: TypeAlias = FloatArray | IntArray | int  # (n,), or (n, k) for k fields side by side, or a constant
Columns: TypeAlias = Mapping[str, Column]
Record: TypeAlias = NDArray[Any]

STANDBY, ACTIVE = 3, 4  # MAV_STATE
ON_GROUND, IN_AIR = 1, 2  # MAV_LANDED_STATE
HIGHRES_FIELDS = 0b111111  # HIGHRES_IMU.fields_updated: accelerometer and gyro
# MAV_SYS_STATUS_SENSOR: gyro, accelerometer, magnetometer, GPS and vision (motion capture is all three), motor outputs,
# geofence, AHRS, battery, pre-arm check, propulsion
HEALTH = 0x1 | 0x2 | 0x4 | 0x20 | 0x80 | 0x8000 | 0x100000 | 0x200000 | 0x2000000 | 0x10000000 | 0x40000000
TYPES = {4: MavType.QUADROTOR, 6: MavType.HEXAROTOR, 8: MavType.OCTOROTOR}
SERVOS = 8  # outputs of SERVO_OUTPUT_RAW beside each other; the other eight are extensions
CAPACITY_AH = 3.7  # of the QDrone 2's battery: 4S, 3700 mAh (Quanser, QDrone 2 data sheet)
CELLS = 4
ESC_TEMPERATURE_C = 40  # always, for heat is not modelled (our choice)
FIX_3D, SATELLITES = 3, 12  # GPS_RAW_INT: what ground stations ask for before they call a vehicle ready
EPH_CM = 100
# PX4's home in simulation, near Zurich: the emulated vehicle flies indoors and could be anywhere.
HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M = 47.397742, 8.545594, 488.0
EARTH_M = 6_371_000.0
_NORTH_M = EARTH_M * math.pi / 180  # of one degree
_EAST_M = _NORTH_M * math.cos(math.radians(HOME_LAT_DEG))
_HOME = (round(HOME_LAT_DEG * 1e7), round(HOME_LON_DEG * 1e7), round(HOME_ALT_M * 1e3))
# ArduPilot, AP_InertialSensor.h: ACCEL_VIBE_FLOOR_FILT_HZ, ACCEL_VIBE_FILT_HZ, ACCEL_CLIP_THRESH_MSS
VIBE_FLOOR_HZ, VIBE_HZ, CLIP_M_S2 = 5.0, 2.0, 15.5 * G
# How ESCs tell their speed: SERVO_BLH_TRATE, eRPM/100 of motors with 14 poles (BLHeli, KISS), and the share of frames
# that are lost: the last value is told again (estimates).
ESC_FRAME_NS, ESC_STEP, ESC_LOST = 100 * NS_PER_MS, 100.0 / 7.0 * RPM, 0.02


def to_global(position: FloatArray) -> FloatArray:
    """Latitude, longitude [deg] and altitude above the sea [m] of positions (n, 3) in world NED."""
    home = np.array([HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M])
    return np.asarray(home + position / np.array([_NORTH_M, _EAST_M, -1.0]))


def to_local(latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """North and east of home [m]."""
    return (latitude_deg - HOME_LAT_DEG) * _NORTH_M, (longitude_deg - HOME_LON_DEG) * _EAST_M


def integers(values: FloatArray, bits: int) -> IntArray:
    """Rounded and held in a signed field of so many bits."""
    top = (1 << bits - 1) - 1
    return np.asarray(np.minimum(np.maximum(np.rint(values), -top - 1), top), np.int64)  # np.clip is slow


class FilteredSamples(NamedTuple):
    """n steps as the autopilot sends them."""

    samples: PlantSamples  # what the plant gave
    stamp_ns: IntArray  # (n,) time that the messages carry
    gyro: FloatArray  # (n, 3) after the autopilot's filter [rad/s]
    accel: FloatArray  # (n, 3) after the autopilot's filter [m/s^2]
    vibration: FloatArray  # (n, 3) level [m/s^2]; zero where the profile does not send it, and so are the clippings
    clippings: IntArray  # (n,) samples so far at the end of the accelerometer's range
    esc: FloatArray  # (n, r) speeds that the ESCs told last [rad/s]; NaN before their first frame


@cached_loop
def _filter(b: FloatArray, a: FloatArray, x: FloatArray, state: FloatArray, y: FloatArray) -> None:
    """y (n, m) of A y = B x in the transposed direct form. a[0] = 1; state: (k, m), the last row 0, goes on."""
    for t in range(len(x)):
        for column in range(x.shape[1]):
            now = x[t, column]
            y[t, column] = out = state[0, column] + b[0] * now
            for k in range(1, len(b)):
                state[k - 1, column] = state[k, column] + now * b[k] - out * a[k]


class _Filter:
    """A linear filter over the columns of successive blocks; it starts settled on the first row."""

    def __init__(self, b: FloatArray, a: FloatArray) -> None:
        self._b, self._a = b, a
        self._state: FloatArray | None = None
        _filter(b, a, *[np.empty((0, 1))] * 3)  # loads it: the first block would be late

    def step(self, x: FloatArray) -> FloatArray:
        if self._state is None:
            rest = self._b - self._a * (self._b.sum() / self._a.sum())
            self._state = np.append(np.cumsum(rest[:0:-1])[::-1], 0.0)[:, np.newaxis] * x[0]
        y = np.empty(x.shape)
        _filter(self._b, self._a, np.ascontiguousarray(x), self._state, y)
        return y


def _first_order(corner_hz: float) -> _Filter:
    """y += alpha (x - y), alpha = dt / (dt + 1 / (2 pi f)), as ArduPilot's LowPassFilter."""
    alpha = STEP_S / (STEP_S + 1.0 / (2.0 * np.pi * corner_hz))
    return _Filter(np.array([alpha, 0.0]), np.array([1.0, alpha - 1.0]))


class _EscFrames:
    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._told, self._frames = np.empty(0), np.empty((1, 0), dtype=np.int64)
        self._losses = list[np.random.Generator]()

    def step(self, t_ns: IntArray, speed: FloatArray) -> FloatArray:
        rotors = speed.shape[1]
        frames = (t_ns[:, None] - ESC_FRAME_NS * np.arange(rotors) // rotors) // ESC_FRAME_NS
        if not self._losses:
            self._losses = [np.random.default_rng([self._seed, rotor]) for rotor in range(rotors)]
            self._told, self._frames = np.full(rotors, np.nan), frames[:1] - 1
        fresh = frames > np.concatenate([self._frames, frames[:-1]])
        told = np.empty(speed.shape)
        told[:] = self._told
        for row, rotor in np.argwhere(fresh).tolist():
            if self._losses[rotor].random() >= ESC_LOST:
                told[row:, rotor] = ESC_STEP * np.rint(speed[row, rotor] / ESC_STEP)
        self._told, self._frames = told[-1], frames[-1:]
        return told


class ImuFilters:
    """From samples to what is sent, block by block. Equal seeds give equal stamps; how time is cut does not matter.

    vibration = sqrt( low-pass_2Hz( (accel - low-pass_5Hz(accel))^2 ) )
    (ArduPilot, AP_InertialSensor::calc_vibration_and_clipping)
    """

    def __init__(self, dialect: Dialect, seed: int) -> None:
        corner_hz, self._imu_filter = dialect.profile.imu_corner_hz, None
        if corner_hz:
            b0, b1, b2, a1, a2 = butterworth(corner_hz, STEP_S)
            self._imu_filter = _Filter(np.array([b0, b1, b2]), np.array([1.0, a1, a2]))
        self._vibration = dialect.profile.vibration
        self._floor, self._level = _first_order(VIBE_FLOOR_HZ), _first_order(VIBE_HZ)
        self._clippings = 0
        self._delay_ns = round(dialect.send_delay_s * 1e9)
        self._delays = np.random.default_rng(seed)
        self._escs = _EscFrames(seed) if dialect.esc else None

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
        esc = samples.esc_speed if self._escs is None else self._escs.step(samples.t_ns, samples.esc_speed)
        return FilteredSamples(samples, samples.t_ns + delay_ns.astype(np.int64), gyro, accel, vibration, clipped, esc)


class Message(NamedTuple):
    """A message to be sent."""

    t_ns: int  # flight time
    msgid: int
    payload: bytes  # with all its zeros, as `Encoder.encode_payload` takes it


def messages_due(filtered: FilteredSamples, schedule: Schedule, dialect: Dialect) -> list[Message]:
    """The messages of a block on one link, in order of time."""
    messages: list[Message] = []
    for msgid, due in schedule.due(filtered.samples.t_ns):
        rows, record = records(msgid, filtered, due, dialect)
        payloads, size = record.tobytes(), record.dtype.itemsize
        cuts = (payloads[at : at + size] for at in range(0, len(payloads), size))
        messages += map(Message, filtered.samples.t_ns[rows].tolist(), repeat(msgid), cuts)
    messages.sort(key=itemgetter(0))  # stable: messages of one instant keep the schedule's order
    return messages


def records(msgid: int, filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> tuple[IntArray, Record]:
    """The payloads of one message that is due at some rows of a block, and the row of each payload.

    They are more than the rows where one message does not carry all rotors. Fields without a column but time are zero.
    """
    due = _Due(filtered, rows, dialect)
    stamps = (name for name in ("time_boot_ms", "time_usec") if name in layout_of(msgid).names)
    told: Columns = {**{name: getattr(due, name) for name in stamps}, **_BUILDERS[msgid](due)}
    columns = {name: np.asarray(column) for name, column in told.items()}
    dtype = _dtype(msgid, tuple((name, one.shape[1] if one.ndim == 2 else 1) for name, one in columns.items()))
    record = np.zeros(next(len(one) for one in columns.values() if one.ndim), dtype)
    for name, one in columns.items():
        record[name] = one[:, 0] if one.shape[1:] == (1,) else one
    return (rows if len(record) == len(rows) else np.repeat(rows, len(record) // len(rows))), record


@cache
def _dtype(msgid: int, columns: tuple[tuple[str, int], ...]) -> np.dtype[np.void]:
    return layout_of(msgid).record_dtype(*columns)


class _Due:
    """The samples that are due, each column by its name: what is sent where the autopilot filters it."""

    time_boot_ms = property(lambda due: due.stamp_ns // NS_PER_MS % (1 << 32))
    time_usec = property(lambda due: due.stamp_ns // NS_PER_US)
    angles = property(lambda due: due.attitude[:, :3])
    heading = property(lambda due: np.degrees(due.angles[:, 2]) % 360.0)
    speed = property(lambda due: np.hypot(due.velocity[:, 0], due.velocity[:, 1]))
    remaining = property(lambda due: integers(100.0 * np.clip(1.0 - due.charge_ah / CAPACITY_AH, 0.0, 1.0), 8))
    rpm = property(lambda due: np.where(np.isnan(due.esc), 0.0, due.esc / RPM))  # zero before the first frame

    def __init__(self, filtered: FilteredSamples, rows: IntArray, dialect: Dialect) -> None:
        self.filtered, self.rows, self.dialect, self.profile = filtered, rows, dialect, dialect.profile

    def __getattr__(self, name: str) -> Any:
        sent = self.filtered if name in FilteredSamples._fields else self.filtered.samples
        return getattr(sent, name)[self.rows]

    @property
    def place(self) -> dict[str, IntArray]:
        """(n, 2) latitude and longitude [1e-7 deg], (n,) altitude above the sea [mm]."""
        where = to_global(self.position)
        return {"lat": integers(where[:, :2] * 1e7, 32), "alt": integers(where[:, 2] * 1e3, 32)}

    @property
    def outputs(self) -> FloatArray:
        low, high = self.profile.actuator_span
        return np.asarray(low + (high - low) * self.duty)


def _quaternion(angles: FloatArray) -> FloatArray:
    """(n, 4) w, x, y, z, body to world, from (n, 3) roll, pitch, yaw in the order z-y-x."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    cc, cs, sc, ss = cr * cp, cr * sp, sr * cp, sr * sp
    return np.array([cc * cy + ss * sy, sc * cy - cs * sy, cs * cy + sc * sy, cc * sy - ss * cy]).T


def _groups(values: FloatArray | IntArray) -> Any:
    """(n, r) as (n g, 4): the rotors four by four, zeros where there is none."""
    if lacking := -values.shape[1] % ESC_GROUP:
        values = np.hstack([values, np.zeros((len(values), lacking), values.dtype)])
    return values.reshape(-1, ESC_GROUP)


def _home(due: _Due) -> Columns:
    latitude, longitude, altitude = _HOME
    return {"latitude": latitude, "longitude": longitude, "altitude": altitude}


def _servo_output(due: _Due) -> Columns:
    servos = integers(due.outputs, 17)
    more = {"servo9_raw": servos[:, SERVOS:]} if servos.shape[1] > SERVOS else {}
    return {"time_usec": due.time_usec % (1 << 32), "servo1_raw": servos[:, :SERVOS], **more}


def _battery(due: _Due) -> Columns:
    voltages = np.full((len(due.rows), 10), 0xFFFF)
    voltages[:, :CELLS] = integers(1e3 * due.battery_v / CELLS, 17)[:, None]
    return {
        "battery_function": 1,  # MAV_BATTERY_FUNCTION_ALL
        "type": 1,  # MAV_BATTERY_TYPE_LIPO
        "temperature": 0x7FFF,  # not measured, as the current
        "voltages": voltages,
        "current_battery": -1,
        "current_consumed": integers(1e3 * due.charge_ah, 32),
        "energy_consumed": -1,
        "battery_remaining": due.remaining,
    }


def _esc_status(due: _Due) -> Columns:
    rpm, n = _groups(integers(due.rpm, 32)), len(due.rows)
    groups = len(rpm) // n
    index = np.tile(ESC_GROUP * np.arange(groups), n)
    volts = np.repeat(due.battery_v[:, None], due.duty.shape[1], axis=1)
    return {"time_usec": np.repeat(due.time_usec, groups), "index": index, "rpm": rpm, "voltage": _groups(volts)}


def _esc_telemetry(first: int) -> Callable[[_Due], Columns]:
    def build(due: _Due) -> Columns:
        rpm = integers(due.rpm[:, first : first + ESC_GROUP], 17)
        volts = np.repeat(integers(100.0 * due.battery_v, 17)[:, None], rpm.shape[1], axis=1)
        warm = np.full(rpm.shape, ESC_TEMPERATURE_C)
        return {"rpm": _groups(rpm), "voltage": _groups(volts), "temperature": _groups(warm)}

    return build


_BUILDERS: Mapping[int, Callable[[_Due], Columns]] = {
    MessageId.HEARTBEAT: lambda due: {
        "type": TYPES.get(due.duty.shape[1], MavType.GENERIC),
        "autopilot": due.profile.autopilot,
        "base_mode": ModeFlag.CUSTOM_MODE_ENABLED + ModeFlag.SAFETY_ARMED * (due.motors > 0),
        "custom_mode": due.dialect.custom_mode,
        "system_status": np.where(due.motors > 0, ACTIVE, STANDBY),
        "mavlink_version": 3,
    },
    MessageId.SYS_STATUS: lambda due: {
        **{f"onboard_control_sensors_{state}": HEALTH for state in ("present", "enabled", "health")},
        "voltage_battery": integers(1e3 * due.battery_v, 17),
        "current_battery": -1,  # not measured
        "battery_remaining": due.remaining,
    },
    MessageId.EXTENDED_SYS_STATE: lambda due: {"landed_state": np.where(due.motors == FLYING, IN_AIR, ON_GROUND)},
    MessageId.RAW_IMU: lambda due: {
        "xacc": integers(due.accel / due.profile.accel_unit, 16),
        "xgyro": integers(due.gyro / due.profile.gyro_unit, 16),
    },
    MessageId.HIGHRES_IMU: lambda due: {"xacc": due.accel, "xgyro": due.gyro, "fields_updated": HIGHRES_FIELDS},
    MessageId.ATTITUDE: lambda due: {"roll": due.angles, "rollspeed": due.gyro},
    MessageId.ATTITUDE_QUATERNION: lambda due: {"q1": _quaternion(due.angles), "rollspeed": due.gyro},
    MessageId.ATTITUDE_TARGET: lambda due: {
        "q": _quaternion(due.setpoint),
        "body_roll_rate": due.rate_setpoint,
        "thrust": due.thrust_setpoint,
    },
    # the true position: motion capture gives it to a fraction of a millimetre
    MessageId.LOCAL_POSITION_NED: lambda due: {"x": due.position, "vx": due.velocity},
    MessageId.GLOBAL_POSITION_INT: lambda due: {
        **(place := due.place),
        "relative_alt": place["alt"] - _HOME[2],
        "vx": integers(100.0 * due.velocity, 16),
        "hdg": integers(100.0 * due.heading, 17) % 36_000,
    },
    MessageId.GPS_RAW_INT: lambda due: {
        **due.place,
        "vel": integers(100.0 * due.speed, 17),
        "cog": integers(100.0 * (np.degrees(np.arctan2(*due.velocity.T[1::-1])) % 360.0), 17) % 36_000,
        "fix_type": FIX_3D,
        "eph": EPH_CM,
        "epv": EPH_CM,
        "satellites_visible": SATELLITES,
    },
    MessageId.VFR_HUD: lambda due: {
        "airspeed": due.speed,
        "groundspeed": due.speed,
        "heading": integers(due.heading, 16) % 360,
        "throttle": integers(100.0 * np.nan_to_num(due.thrust_setpoint), 17),
        "alt": to_global(due.position)[:, 2],
        "climb": -due.velocity[:, 2],
    },
    MessageId.HOME_POSITION: lambda due: {**_home(due), "q": np.tile([1.0, 0.0, 0.0, 0.0], (len(due.rows), 1))},
    MessageId.GPS_GLOBAL_ORIGIN: _home,
    MessageId.BATTERY_STATUS: _battery,
    MessageId.SERVO_OUTPUT_RAW: _servo_output,
    MessageId.ACTUATOR_OUTPUT_STATUS: lambda due: {"active": due.duty.shape[1], "actuator": due.outputs},
    MessageId.VIBRATION: lambda due: {"vibration_x": due.vibration, "clipping_0": due.clippings},
    MessageId.ESC_STATUS: _esc_status,
    **{MessageId.ESC_TELEMETRY_1_TO_4 + k: _esc_telemetry(ESC_GROUP * k) for k in range(3)},
}
