"""How the emulated autopilots differ on the wire, beyond their link profile: one row each.

Units, filter and stamps are those of `mavdiag.link.profiles`, so that what is sent is what is understood. Facts about
ArduPilot Copter and PX4 were read in their sources and checked against their simulators (2026). Where the emulator
departs from them, so that it is useful without being asked, the row says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavdiag.errors import UsageError
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES, Profile, Stamp, profile_named

__all__ = ["DIALECTS", "ESC_GROUP", "Dialect", "dialect_named"]

ESC_GROUP = 4  # rotors in one message of their speeds
FRAME_CLASSES = {4: 1.0, 6: 2.0, 8: 3.0}  # ArduPilot: quad, hexa, octa


@dataclass(frozen=True, slots=True)
class Dialect:
    """What one kind of autopilot sends.

    profile: units, filter and stamps.
    custom_mode: flight mode in HEARTBEAT.
    others: rates of the messages besides set-point and IMU [Hz].
    ceiling_hz: the highest rate that is granted.
    send_delay_s: longest time from the sample to its stamp, if messages are stamped when they are sent.
    parameters: the answer to PARAM_REQUEST_LIST.
    streams: which messages REQUEST_DATA_STREAM sets, by MAV_DATA_STREAM; empty for an autopilot that ignores it.
    """

    profile: Profile
    custom_mode: int
    others: Mapping[int, float]
    ceiling_hz: float
    send_delay_s: float = 0.0
    parameters: tuple[tuple[str, float], ...] = ()
    streams: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.send_delay_s > 0.0) != (self.profile.stamp is Stamp.SEND):
            raise UsageError(f"dialect {self.profile.name}: a sending delay belongs to stamps of the sending time")

    def rates_hz(self, rate_hz: float | None, rotors: int = 4) -> dict[int, float]:
        """The rate of every message [Hz]. Raises UsageError for a rate that is not granted.

        rate_hz: of set-point and IMU; None for the profile's.
        rotors: of the vehicle; ESC_TELEMETRY is a message of its own for each four of them.
        """
        rate = self.profile.rate_hz if rate_hz is None else rate_hz
        if not 1.0 <= rate <= self.ceiling_hz:
            name = self.profile.name
            raise UsageError(f"rate must be 1 to {self.ceiling_hz:g} Hz with the profile {name}, not {rate:g}")
        rates = {**self.others, self.profile.setpoint: rate, self.profile.imu: rate}
        if self.profile.rotor_speed is MessageId.ESC_TELEMETRY_1_TO_4:
            more = range(1, -(-rotors // ESC_GROUP))
            rates |= {self.profile.rotor_speed + k: self.others[self.profile.rotor_speed] for k in more}
        return rates

    def parameters_of(self, rotors: int) -> tuple[tuple[str, float], ...]:
        """The parameters of a vehicle with so many rotors."""
        return tuple(
            (name, FRAME_CLASSES.get(rotors, 0.0) if name == "FRAME_CLASS" else value)
            for name, value in self.parameters
        )


_STATE: dict[int, float] = {
    MessageId.HEARTBEAT: 1.0,
    MessageId.SYS_STATUS: 2.0,
    MessageId.EXTENDED_SYS_STATE: 1.0,
    MessageId.ATTITUDE: 50.0,
    MessageId.ATTITUDE_QUATERNION: 50.0,
    MessageId.LOCAL_POSITION_NED: 30.0,
}


def _messages(profile: Profile, *more: MessageId) -> dict[int, float]:
    """What a profile needs besides setpoint and IMU, and more at 50 Hz."""
    vibration: dict[int, float] = {MessageId.VIBRATION: 10.0} if profile.vibration else {}
    return {**_STATE, **vibration, **dict.fromkeys((profile.actuator, profile.rotor_speed, *more), 50.0)}


# ArduPilot Copter 4.5, GCS_Mavlink.cpp, STREAM_..._msgs: which message belongs to which SRn parameter. ATTITUDE_TARGET,
# EXTENDED_SYS_STATE and ATTITUDE_QUATERNION belong to none: no ground station resets them.
_STREAMS: Mapping[int, tuple[int, ...]] = {
    1: (MessageId.RAW_IMU, MessageId.SCALED_IMU2, MessageId.SCALED_IMU3),  # RAW_SENSORS
    2: (MessageId.SYS_STATUS,),  # EXTENDED_STATUS
    3: (MessageId.SERVO_OUTPUT_RAW,),  # RC_CHANNELS
    6: (MessageId.LOCAL_POSITION_NED,),  # POSITION
    10: (MessageId.ATTITUDE,),  # EXTRA1
    12: (  # EXTRA3
        MessageId.VIBRATION,
        MessageId.SYSTEM_TIME,
        MessageId.ESC_TELEMETRY_1_TO_4,
        MessageId.ESC_TELEMETRY_5_TO_8,
        MessageId.ESC_TELEMETRY_9_TO_12,
    ),
}

_COPTER = (("SYSID_THISMAV", 1.0), ("FRAME_CLASS", 1.0))

_QDRONE2, _SPEC, _ARDUPILOT, _PX4 = (PROFILES[name] for name in ("qdrone2", "spec", "ardupilot", "px4"))

_ALL = (
    *(
        Dialect(
            profile,
            custom_mode=0,
            others=_messages(profile, MessageId.HIGHRES_IMU),
            ceiling_hz=1000.0,
            parameters=_COPTER,
            streams=_STREAMS,
        )
        for profile in (_QDRONE2, _SPEC)
    ),
    # ArduPilot sends ATTITUDE_TARGET and RAW_IMU only on request; the emulator sends them at once, and takes requests.
    Dialect(
        _ARDUPILOT,
        custom_mode=4,  # Copter: guided
        others=_messages(_ARDUPILOT),
        ceiling_hz=1000.0 / 3.0,  # 0.8 x loop rate (400 Hz) in whole milliseconds
        send_delay_s=0.0025,  # one loop
        parameters=(*_COPTER, ("INS_GYRO_FILTER", 20.0), ("INS_ACCEL_FILTER", 20.0), ("SCHED_LOOP_RATE", 400.0)),
        streams=_STREAMS,
    ),
    # PX4 sends ATTITUDE_TARGET at 2 to 10 Hz and HIGHRES_IMU at 50 Hz unless asked; the emulator at the link rate.
    Dialect(
        _PX4,
        custom_mode=6 << 16,  # main mode offboard
        others=_messages(_PX4),
        ceiling_hz=250.0,  # estimate
        parameters=(("MAV_SYS_ID", 1.0), ("IMU_GYRO_CUTOFF", 40.0), ("IMU_ACCEL_CUTOFF", 30.0)),
    ),
)

DIALECTS: Mapping[str, Dialect] = {row.profile.name: row for row in _ALL}
"""The dialects by the name of their link profile."""


def dialect_named(name: str) -> Dialect:
    """The dialect of a link profile. Raises UsageError for an unknown one."""
    return DIALECTS[profile_named(name).name]
