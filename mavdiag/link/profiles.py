"""Link profiles: how a kind of vehicle speaks of the same things, as one table.

A baseline is bound to a profile, because its filter, its rate and its stamps shape the identified model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import radians

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.link.codec import Frame, field_index, record_dtype
from mavdiag.link.messages import Autopilot, Component, MessageId

__all__ = ["PROFILES", "Profile", "Stamp", "detect_profile", "profile_named"]

G = 9.80665  # standard gravity [m/s^2]
MILLI = 1e-3
WEIGHT_COUNTS = 1431  # geometric mean of 1000 (mG) and 2048 (IIM-42652)
ARDUPILOT_PERIOD_US = 2500  # Copter's loop period at its usual 400 Hz; RAW_IMU cannot be faster

_AUTOPILOT = field_index(MessageId.HEARTBEAT, "autopilot")
_RAW_IMU = record_dtype(MessageId.RAW_IMU, ("time_usec", 1), ("xacc", 3))


class Stamp(StrEnum):
    """What a message's own time tells."""

    SAMPLE = "sample"  # when the quantity was measured or set
    SEND = "send"  # when the message was sent


@dataclass(frozen=True, slots=True)
class Profile:
    """How one kind of vehicle sends what the diagnosis needs.

    setpoint, imu, actuator, rotor_speed: the messages to use. accel_unit [m/s^2] and gyro_unit [rad/s]: one count of
    the IMU message. rate_hz: nominal rate of the pair of setpoint and IMU message. imu_corner_hz: corner of the
    low-pass filter in the IMU stream, None if vibration passes. vibration: the VIBRATION message carries acceleration
    per axis. actuator_span: the actuator message's values for 0 and for full output. rotors: how many columns count.
    """

    name: str
    imu: MessageId
    accel_unit: float
    gyro_unit: float
    rate_hz: float
    imu_corner_hz: float | None
    stamp: Stamp
    vibration: bool
    actuator: MessageId
    actuator_span: tuple[float, float]
    rotor_speed: MessageId
    autopilot: Autopilot
    setpoint: MessageId = MessageId.ATTITUDE_TARGET
    rotors: int = 4


_ALL = (
    # The QDrone 2 behind its bridge: milli-g and mrad/s as ArduPilot fills RAW_IMU, sampled at 1 kHz (T 5.3).
    Profile(
        name="qdrone2",
        imu=MessageId.RAW_IMU,
        accel_unit=MILLI * G,
        gyro_unit=MILLI,
        rate_hz=1000.0,
        imu_corner_hz=None,
        stamp=Stamp.SAMPLE,
        vibration=False,
        actuator=MessageId.SERVO_OUTPUT_RAW,
        actuator_span=(1000.0, 2000.0),
        rotor_speed=MessageId.ESC_STATUS,
        autopilot=Autopilot.GENERIC,
    ),
    # RAW_IMU as its definition has it, without unit: the counts of the IIM-42652 at its full scale of 16 g and
    # 2000 deg/s (data sheet: 2048 LSB/g and 16.4 LSB/(deg/s)).
    Profile(
        name="spec",
        imu=MessageId.RAW_IMU,
        accel_unit=G / 2048,
        gyro_unit=radians(1) / 16.4,
        rate_hz=1000.0,
        imu_corner_hz=None,
        stamp=Stamp.SAMPLE,
        vibration=False,
        actuator=MessageId.SERVO_OUTPUT_RAW,
        actuator_span=(1000.0, 2000.0),
        rotor_speed=MessageId.ESC_STATUS,
        autopilot=Autopilot.GENERIC,
    ),
    # ArduPilot Copter: RAW_IMU is low-passed at 20 Hz (INS_GYRO_FILTER, INS_ACCEL_FILTER) and stamped when sent; 50 to
    # 200 Hz are met exactly.
    Profile(
        name="ardupilot",
        imu=MessageId.RAW_IMU,
        accel_unit=MILLI * G,
        gyro_unit=MILLI,
        rate_hz=100.0,
        imu_corner_hz=20.0,
        stamp=Stamp.SEND,
        vibration=True,
        actuator=MessageId.SERVO_OUTPUT_RAW,
        actuator_span=(1000.0, 2000.0),
        rotor_speed=MessageId.ESC_TELEMETRY_1_TO_4,
        autopilot=Autopilot.ARDUPILOTMEGA,
    ),
    # PX4: no RAW_IMU; HIGHRES_IMU is in SI and comes from the sensors before the controller's filter; its VIBRATION
    # mixes gyro and accelerometer metrics. Asked for 200 Hz it sends 160 to 170.
    Profile(
        name="px4",
        imu=MessageId.HIGHRES_IMU,
        accel_unit=1.0,
        gyro_unit=1.0,
        rate_hz=160.0,
        imu_corner_hz=None,
        stamp=Stamp.SAMPLE,
        vibration=False,
        actuator=MessageId.ACTUATOR_OUTPUT_STATUS,
        actuator_span=(0.0, 1.0),
        rotor_speed=MessageId.ESC_STATUS,
        autopilot=Autopilot.PX4,
    ),
)

PROFILES: Mapping[str, Profile] = {profile.name: profile for profile in _ALL}


def profile_named(name: str) -> Profile:
    """The profile of that name. Raises UsageError, listing the names, if there is none."""
    if name not in PROFILES:
        raise UsageError(f"no link profile {name}; there are {', '.join(PROFILES)}")
    return PROFILES[name]


def detect_profile(frames: Sequence[Frame]) -> str:
    """The name of the profile that one vehicle's frames follow; `qdrone2` if nothing speaks against it.

    Without RAW_IMU it is PX4's. RAW_IMU in counts shows by its size, for a vehicle feels its own weight: 1000 mG or
    2048 counts. ArduPilot says so in its HEARTBEAT; faster than its loop allows, it is another that borrows the name.
    """
    own = [frame for frame in frames if frame.compid == Component.AUTOPILOT1]
    autopilots = {beat.fields[_AUTOPILOT] for beat in own if beat.msgid == MessageId.HEARTBEAT}
    imu = [frame.payload for frame in own if frame.msgid == MessageId.RAW_IMU]
    if not imu:
        px4 = Autopilot.PX4 in autopilots or any(frame.msgid == MessageId.HIGHRES_IMU for frame in own)
        return "px4" if px4 else "qdrone2"
    record = np.frombuffer(b"".join(imu), _RAW_IMU)
    weight = np.median(np.linalg.norm(record["xacc"].astype(np.float64), axis=1))
    if weight > WEIGHT_COUNTS:
        return "spec"
    slow = len(record) < 2 or np.median(np.diff(record["time_usec"].astype(np.int64))) >= ARDUPILOT_PERIOD_US
    return "ardupilot" if slow and Autopilot.ARDUPILOTMEGA in autopilots else "qdrone2"
