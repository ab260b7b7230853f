"""How the emulated autopilots differ on the wire, beyond what their link profile says: one row each.

Units, filter and stamps are those of `mavdiag.link.profiles`, so that what is sent is what is understood. Facts about
ArduPilot Copter and PX4 were read in their sources and checked against their simulators (2026). Where the emulator
departs from them, so that it is useful without being asked, the row says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from mavdiag.errors import UsageError
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES, Profile, Stamp, profile_named

__all__ = ["FLAVOURS", "Flavour", "flavour"]


@dataclass(frozen=True, slots=True)
class Flavour:
    """One way to speak.

    custom_mode: flight mode as HEARTBEAT tells it. others: rates [Hz] of the messages besides setpoint and IMU.
    ceiling_hz: the highest rate that is granted. send_delay_s: if messages are stamped when sent, how long after the
    sample that is, at most. parameters: what PARAM_REQUEST_LIST tells.
    """

    profile: Profile
    custom_mode: int
    others: Mapping[int, float]
    ceiling_hz: float
    send_delay_s: float = 0.0
    parameters: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if (self.send_delay_s > 0.0) != (self.profile.stamp is Stamp.SEND):
            raise UsageError(f"flavour {self.profile.name}: a sending delay belongs to stamps of the sending time")

    def rates_hz(self, rate_hz: float | None) -> dict[int, float]:
        """The rate of every message, setpoint and IMU at `rate_hz` (None: the profile's). UsageError if denied."""
        rate = self.profile.rate_hz if rate_hz is None else rate_hz
        if not 1.0 <= rate <= self.ceiling_hz:
            name = self.profile.name
            raise UsageError(f"rate must be 1 to {self.ceiling_hz:g} Hz with the profile {name}, not {rate:g}")
        return {**self.others, self.profile.setpoint: rate, self.profile.imu: rate}


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


_COPTER = (("SYSID_THISMAV", 1.0), ("FRAME_CLASS", 1.0))

_QDRONE2, _SPEC, _ARDUPILOT, _PX4 = (PROFILES[name] for name in ("qdrone2", "spec", "ardupilot", "px4"))

_ALL = (
    Flavour(_QDRONE2, 0, _messages(_QDRONE2, MessageId.HIGHRES_IMU), ceiling_hz=1000.0, parameters=_COPTER),
    Flavour(_SPEC, 0, _messages(_SPEC, MessageId.HIGHRES_IMU), ceiling_hz=1000.0, parameters=_COPTER),
    # ArduPilot sends ATTITUDE_TARGET and RAW_IMU only on request; the emulator sends them at once, and takes requests.
    Flavour(
        _ARDUPILOT,
        custom_mode=4,  # Copter: guided
        others=_messages(_ARDUPILOT),
        ceiling_hz=1000.0 / 3.0,  # 0.8 x loop rate (400 Hz) in whole milliseconds
        send_delay_s=0.0025,  # one loop
        parameters=(*_COPTER, ("INS_GYRO_FILTER", 20.0), ("INS_ACCEL_FILTER", 20.0), ("SCHED_LOOP_RATE", 400.0)),
    ),
    # PX4 sends ATTITUDE_TARGET at 2 to 10 Hz and HIGHRES_IMU at 50 Hz unless asked; the emulator at the link rate.
    Flavour(
        _PX4,
        custom_mode=6 << 16,  # main mode offboard
        others=_messages(_PX4),
        ceiling_hz=250.0,  # estimate
        parameters=(("MAV_SYS_ID", 1.0), ("IMU_GYRO_CUTOFF", 40.0), ("IMU_ACCEL_CUTOFF", 30.0)),
    ),
)

FLAVOURS: Mapping[str, Flavour] = {row.profile.name: row for row in _ALL}
"""The flavours by the name of the link profile that they speak."""


def flavour(name: str) -> Flavour:
    """The flavour of a link profile. Raises UsageError for an unknown one."""
    return FLAVOURS[profile_named(name).name]
