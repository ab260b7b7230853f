"""The streams that a diagnosis needs: which messages carry them, how fast, and which parameter gives them.

Messages are asked for by MAV_CMD_SET_MESSAGE_INTERVAL; a request changes no parameter. What gives a message without a
request is `remedy`, from the stream groups of ArduPilot (GCS_MAVLink_Copter.cpp, `STREAM_...`), the MAVLink modes of
PX4 (mavlink_main.cpp, `configure_streams_to_default`) and the logging masks of both (LOG_BITMASK, SDLOG_PROFILE).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from mavdiag.link.messages import Autopilot, MessageId
from mavdiag.link.profiles import LAST_RESORT, Profile
from mavdiag.telemetry import Signal

# Rates of the slow streams [Hz]: what is asked for, and the least that will do (METHOD section 4; our choices).
_SLOW: Mapping[Signal, tuple[float, float]] = {
    Signal.ACTUATOR: (25.0, 10.0),
    Signal.ROTOR_SPEED: (5.0, 1.0),
    Signal.VIBRATION: (5.0, 2.0),
    Signal.ATTITUDE: (25.0, 10.0),
}

# Asked for in this order where the profile's own IMU message is refused or does not come.
_GYROS = (MessageId.HIGHRES_IMU, MessageId.SCALED_IMU, LAST_RESORT)

#: What a signal that does not come is called in a text for an operator.
LABELS: Mapping[Signal, str] = {
    Signal.BODY_RATE: "gyro",
    Signal.SPECIFIC_FORCE: "accelerometer",
    Signal.ATTITUDE_SETPOINT: "set-points",
    Signal.THRUST_SETPOINT: "thrust set-point",
    Signal.ACTUATOR: "actuator outputs",
    Signal.VIBRATION: "VIBRATION",
    Signal.ROTOR_SPEED: "rotor speeds",
    Signal.ATTITUDE: "attitude",
}


@dataclass(frozen=True, slots=True)
class Want:
    """One stream.

    signal: what it carries.
    msgid: its message.
    ask_hz: rate to ask for.
    least_hz, most_hz: measured rates that will do.
    mandatory: whether nothing is judged without it; the lack of another one is told and hinders nothing.
    others: messages that carry it too, in order of preference, for an autopilot that does not send `msgid`.
    """

    signal: Signal
    msgid: int
    ask_hz: float
    least_hz: float
    most_hz: float = float("inf")
    mandatory: bool = False
    others: tuple[int, ...] = ()


def wants_of(
    profile: Profile,
    needs: Collection[Signal],
    imu_hz: tuple[float, float, float],
    setpoint_hz: float,
    setpoints: bool = True,
) -> tuple[Want, ...]:
    """The streams to ask for, by the signals that are needed.

    imu_hz: rate to ask for, least and most that will do. setpoint_hz: least rate of the set-points.
    setpoints: whether the set-points are mandatory, as the gyro is.
    """
    others = tuple(one for one in _GYROS if one != profile.imu)
    messages = messages_of(profile)
    wants = [Want(Signal.BODY_RATE, profile.imu, *imu_hz, mandatory=True, others=others)]
    if Signal.ATTITUDE_SETPOINT in needs:
        target = Want(Signal.ATTITUDE_SETPOINT, profile.setpoint, imu_hz[0], setpoint_hz, mandatory=setpoints)
        wants.insert(0, target)
    slow = (signal for signal in _SLOW if signal in messages and signal in needs)
    wants += [Want(signal, messages[signal], *_SLOW[signal]) for signal in slow]
    return tuple(wants)


def messages_of(profile: Profile) -> dict[Signal, MessageId]:
    """The message that each signal comes by; a signal that the link does not carry is absent."""
    messages = {
        Signal.BODY_RATE: profile.imu,
        Signal.ATTITUDE_SETPOINT: profile.setpoint,
        Signal.THRUST_SETPOINT: profile.setpoint,
        Signal.RATE_SETPOINT: profile.setpoint,
        Signal.ACTUATOR: profile.actuator,
        Signal.ROTOR_SPEED: profile.rotor_speed,
        Signal.ATTITUDE: MessageId.ATTITUDE,
    }
    if profile.vibration:
        messages[Signal.VIBRATION] = MessageId.VIBRATION
    return messages if profile.imu == LAST_RESORT else messages | {Signal.SPECIFIC_FORCE: profile.imu}


_RAW_SENS, _RC_CHAN, _EXTRA1, _EXTRA3 = (f"SRn_{group}" for group in ("RAW_SENS", "RC_CHAN", "EXTRA1", "EXTRA3"))
_ON_REQUEST = "a request only: mavdiag-detector asks, and so does `mavdiag inspect --ask`"
_PX4_ONBOARD = "MAV_0_MODE 2 (Onboard) with enough MAV_0_RATE, or a request"

#: What makes an autopilot send a message without being asked; SRn is of the serial port n, 0 for USB.
_GIVES: Mapping[Autopilot, Mapping[int, str]] = {
    Autopilot.ARDUPILOTMEGA: {
        MessageId.ATTITUDE_TARGET: _ON_REQUEST,
        MessageId.HIGHRES_IMU: _ON_REQUEST,
        MessageId.RAW_IMU: _RAW_SENS,
        MessageId.SCALED_IMU: _ON_REQUEST,
        MessageId.SCALED_IMU2: _RAW_SENS,
        MessageId.SCALED_IMU3: _RAW_SENS,
        MessageId.SERVO_OUTPUT_RAW: _RC_CHAN,
        MessageId.ATTITUDE: _EXTRA1,
        MessageId.VIBRATION: _EXTRA3,
        MessageId.ESC_TELEMETRY_1_TO_4: f"{_EXTRA3}, and ESCs with telemetry (SERVO_BLH_AUTO, SERVO_DSHOT_ESC)",
    },
    Autopilot.PX4: {
        MessageId.ATTITUDE_TARGET: _PX4_ONBOARD,
        MessageId.HIGHRES_IMU: _PX4_ONBOARD,
        MessageId.ATTITUDE: _PX4_ONBOARD,
        MessageId.ACTUATOR_OUTPUT_STATUS: _PX4_ONBOARD,
        MessageId.ESC_STATUS: f"{_PX4_ONBOARD}, and ESCs with telemetry",
    },
}

#: What makes an autopilot log a signal, by the profile of its log.
_LOGS: Mapping[str, Mapping[Signal, str]] = {
    "ardupilot-log": {
        Signal.BODY_RATE: "LOG_BITMASK bit 7 (IMU), better 18 (fast IMU)",
        Signal.SPECIFIC_FORCE: "LOG_BITMASK bit 7 (IMU), better 18 (fast IMU)",
        Signal.ATTITUDE_SETPOINT: "LOG_BITMASK bit 0 (fast attitude)",
        Signal.ATTITUDE: "LOG_BITMASK bit 0 (fast attitude)",
        Signal.THRUST_SETPOINT: "LOG_BITMASK bit 4 (control tuning)",
        Signal.ACTUATOR: "LOG_BITMASK bit 10 (RC output)",
        Signal.VIBRATION: "LOG_BITMASK bit 7 (IMU)",
    },
    "px4-log": dict.fromkeys(
        (Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ATTITUDE_SETPOINT, Signal.THRUST_SETPOINT, Signal.ACTUATOR),
        "SDLOG_PROFILE bit 4 (high rate)",
    ),
}


def remedy(autopilot: int, msgid: int) -> str:
    """Which parameter makes an autopilot send a message; empty where none is known.

    >>> remedy(Autopilot.ARDUPILOTMEGA, MessageId.VIBRATION)
    'SRn_EXTRA3'
    """
    rows = next((rows for known, rows in _GIVES.items() if known == autopilot), None)
    return "" if rows is None else rows.get(msgid, "")


def log_remedy(profile: str, signal: Signal) -> str:
    """Which parameter makes an autopilot log a signal, by the profile of the log; empty where none is known."""
    return _LOGS.get(profile, {}).get(signal, "")
