"""What a diagnosis asks of a vehicle: streams and parameters, by which messages, how fast, and what gives them unasked.

Messages are asked for by MAV_CMD_SET_MESSAGE_INTERVAL, which changes no parameter; parameters are read, never set. What
gives a message without a request is from ArduPilot's stream groups (GCS_MAVLink_Copter.cpp, `STREAM_...`), PX4's
MAVLink modes (mavlink_main.cpp) and the logging masks of both. Sans-I/O: what came and `now` in, frames to send out.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId
from mavdiag.link.profiles import LAST_RESORT, Profile
from mavdiag.link.samples import sources
from mavdiag.link.signing import Signing
from mavdiag.telemetry import Instant, Signal

# Rates of the slow streams [Hz]: what is asked for, and the least that will do (METHOD section 4; our choices).
_SLOW: Mapping[Signal, tuple[float, float]] = {
    Signal.ACTUATOR: (25.0, 10.0),
    Signal.ROTOR_SPEED: (10.0, 1.0),
    Signal.VIBRATION: (5.0, 2.0),
    Signal.ATTITUDE: (25.0, 10.0),
}

_M = MessageId
# Asked for in this order where the profile's own IMU message is refused or does not come.
_GYROS = (MessageId.HIGHRES_IMU, MessageId.SCALED_IMU, LAST_RESORT)

#: What a signal that does not come is called in a text for an operator.
LABELS: Mapping[Signal, str] = {
    Signal.BODY_RATE: "gyro",
    Signal.SPECIFIC_FORCE: "accelerometer",
    Signal.ATTITUDE_SETPOINT: "set-points",
    Signal.THRUST_SETPOINT: "thrust set-point",
    Signal.RATE_SETPOINT: "rate set-points",
    Signal.ACTUATOR: "actuator outputs",
    Signal.VIBRATION: "VIBRATION",
    Signal.ROTOR_SPEED: "rotor speeds",
    Signal.ATTITUDE: "attitude",
}

# The slowest gyro and set-points that are learnt from live, where faster ones can be asked for: 50 Hz nominally (METHOD
# section 4: 100 for F1, below 50 it degrades). A log is learnt from at any rate that a monitor's own `least_hz` allows,
# and a baseline is judged by at its own rate, live as in a log.
LEAST_HZ = 45.0


@dataclass(frozen=True, slots=True)
class Want:
    """One stream."""

    signal: Signal
    msgid: int
    ask_hz: float
    least_hz: float  # measured rates that will do
    most_hz: float = float("inf")
    mandatory: bool = False  # nothing is judged without it; the lack of another one is told and hinders nothing
    others: tuple[int, ...] = ()  # messages that carry it too, in order of preference


def wants_of(
    profile: Profile,
    needs: Collection[Signal],
    imu_hz: tuple[float, float, float],
    setpoint_hz: float,
    setpoints: bool = True,
) -> tuple[Want, ...]:
    """The streams to ask for, by the signals that are needed.

    imu_hz: rate to ask for, least and most that will do. setpoint_hz: least rate of the set-points, mandatory or not.
    """
    others = tuple(message for message in _GYROS if message != profile.imu)
    messages = messages_of(profile)
    target = Want(Signal.ATTITUDE_SETPOINT, profile.setpoint, imu_hz[0], setpoint_hz, mandatory=setpoints)
    gyro = Want(Signal.BODY_RATE, profile.imu, *imu_hz, mandatory=True, others=others)
    slow = (signal for signal in _SLOW if signal in messages and signal in needs)
    targets = (target,) if Signal.ATTITUDE_SETPOINT in needs else ()
    return (*targets, gyro, *(Want(signal, messages[signal], *_SLOW[signal]) for signal in slow))


def messages_of(profile: Profile) -> dict[Signal, int]:
    """The message that each signal in `LABELS` comes by, of several the first; one that comes by none is absent."""
    found = dict[Signal, int]()
    for source in sources(profile):
        for part in source.parts:
            if part.signal in LABELS:
                found.setdefault(part.signal, source.message)
    return found


_ON_REQUEST = "a request of mavdiag-detector or `mavdiag inspect --ask`, which must reach the vehicle"
_PX4_ONBOARD = "MAV_0_MODE 2 (Onboard) with enough MAV_0_RATE, or a request"
_PX4_MESSAGES = (_M.ATTITUDE_TARGET, _M.HIGHRES_IMU, _M.ATTITUDE, _M.ACTUATOR_OUTPUT_STATUS)

#: What makes an autopilot send a message without being asked; SRn is of the serial port n, 0 for USB.
_GIVES: Mapping[int, Mapping[int, str]] = {
    Autopilot.ARDUPILOTMEGA: {
        **dict.fromkeys((_M.ATTITUDE_TARGET, _M.HIGHRES_IMU, _M.SCALED_IMU), _ON_REQUEST),
        **dict.fromkeys((_M.RAW_IMU, _M.SCALED_IMU2, _M.SCALED_IMU3), "SRn_RAW_SENS"),
        _M.SERVO_OUTPUT_RAW: "SRn_RC_CHAN",
        _M.ATTITUDE: "SRn_EXTRA1",
        _M.VIBRATION: "SRn_EXTRA3",
        _M.ESC_TELEMETRY_1_TO_4: "SRn_EXTRA3, and ESCs with telemetry (SERVO_BLH_AUTO, SERVO_DSHOT_ESC)",
    },
    Autopilot.PX4: {
        **dict.fromkeys(_PX4_MESSAGES, _PX4_ONBOARD),
        _M.ESC_STATUS: f"{_PX4_ONBOARD}, and ESCs with telemetry",
    },
}

_S = Signal
#: What makes an autopilot log a signal, by the profile of its log.
_LOGS: Mapping[str, Mapping[Signal, str]] = {
    "ardupilot-log": {
        **dict.fromkeys((_S.BODY_RATE, _S.SPECIFIC_FORCE), "LOG_BITMASK bit 7 (IMU), better 18 (fast IMU)"),
        **dict.fromkeys((_S.ATTITUDE_SETPOINT, _S.ATTITUDE), "LOG_BITMASK bit 0 (fast attitude)"),
        _S.THRUST_SETPOINT: "LOG_BITMASK bit 4 (control tuning)",
        _S.ACTUATOR: "LOG_BITMASK bit 10 (RC output)",
        _S.VIBRATION: "LOG_BITMASK bit 7 (IMU)",
        _S.ROTOR_SPEED: "ESCs with telemetry (SERVO_BLH_AUTO, SERVO_DSHOT_ESC)",
    },
    "px4-log": dict.fromkeys(
        (_S.BODY_RATE, _S.SPECIFIC_FORCE, _S.ATTITUDE_SETPOINT, _S.THRUST_SETPOINT, _S.ACTUATOR),
        "SDLOG_PROFILE bit 4 (high rate)",
    ),
}


def remedy(autopilot: int, msgid: int) -> str:
    """Which parameter makes an autopilot send a message; empty where none is known.

    >>> remedy(Autopilot.ARDUPILOTMEGA, MessageId.VIBRATION)
    'SRn_EXTRA3'
    """
    return _GIVES.get(autopilot, {}).get(msgid, "")


def log_remedy(profile: str, signal: Signal) -> str:
    """Which parameter makes an autopilot log a signal, by the profile of the log; empty where none is known."""
    return _LOGS.get(profile, {}).get(signal, "")


BEAT_S = 1.0
STANDBY, MAVLINK_VERSION = 3, 3  # MAV_STATE; of a heartbeat
_BATCH, _PAUSE_S, _NAME_TRIES = 4, 0.2, 3  # parameters at a time, how far apart, and tries of each (our choices)
_ROTORS_MAX = 12
_OUTPUTS = tuple(f"SERVO{n}_FUNCTION" for n in range(1, 15))
_PX4_PARTS = ("TIM0", "TIM1", "TIM2", *(f"FUNC{n}" for n in range(1, 9)))  # until the first are known, it may be PWM
_PX4_OUTPUTS = tuple(f"PWM_{group}_{part}" for part in _PX4_PARTS for group in ("MAIN", "AUX"))


def telling(autopilot: int, known: Mapping[str, float], *, learns: bool = True) -> tuple[str, ...]:
    """The parameters that tell how outputs are driven, and, for who `learns`, rotors and gyro filter, by MAV_AUTOPILOT.

    known: what is known already.

    >>> telling(Autopilot.GENERIC, {})
    ('FRAME_CLASS', 'FRAME_TYPE')
    """
    if autopilot == Autopilot.PX4:
        rotors = range(min(_ROTORS_MAX, int(known.get("CA_ROTOR_COUNT", 0.0))))
        places = (f"CA_ROTOR{n}_{part}" for part in ("PX", "PY", "KM", "AX", "AY", "AZ", "CT") for n in rotors)
        return (*_PX4_OUTPUTS, *(("CA_AIRFRAME", "CA_ROTOR_COUNT", *places) if learns else ()))
    more = ("INS_GYRO_FILTER", *_OUTPUTS) if autopilot == Autopilot.ARDUPILOTMEGA else ()
    return ("FRAME_CLASS", "FRAME_TYPE", *more) if learns else ()


class Reading:
    """Which parameters were asked for so far: how often each name, and when some were last."""

    def __init__(self) -> None:
        self._tries, self._at = Counter[str](), Instant(0)

    def step(self, names: Iterable[str], known: Collection[str], now: Instant) -> tuple[str, ...]:
        """Which of these to ask for now, those with the fewest tries first. known: the parameters that came so far."""
        if self._tries and now - self._at < _PAUSE_S:
            return ()
        left = (name for name in names if name not in known and self._tries[name] < _NAME_TRIES)
        due = sorted(left, key=lambda name: self._tries[name])[:_BATCH]
        self._tries.update(due)
        self._at = now if due else self._at
        return tuple(due)


class Companion(Encoder):
    """Encodes as the on-board computer of one vehicle, by its system id. signing: signs what is sent."""

    def __init__(self, vehicle: int, signing: Signing | None = None) -> None:
        super().__init__(vehicle, Component.ONBOARD_COMPUTER, signing)
        self._autopilot = (vehicle, Component.AUTOPILOT1)
        self._beat: Instant | None = None

    def heartbeat(self, status: int = STANDBY) -> bytes:
        """HEARTBEAT. status: MAV_STATE."""
        kinds = (MavType.ONBOARD_CONTROLLER, Autopilot.INVALID)
        return self.encode(MessageId.HEARTBEAT, *kinds, 0, 0, status, MAVLINK_VERSION)

    def beat(self, now: Instant) -> list[bytes]:
        """A heartbeat each second."""
        if self._beat is not None and now - self._beat < BEAT_S:
            return []
        self._beat = now
        return [self.heartbeat()]

    def command(self, number: int, *parameters: float, confirmation: int = 0) -> bytes:
        """A command (MAV_CMD) to the autopilot. confirmation: how often it was sent before."""
        return self.encode(MessageId.COMMAND_LONG, *self._autopilot, number, confirmation, *parameters)

    def read(self, name: str) -> bytes:
        """PARAM_REQUEST_READ of one of the autopilot's parameters."""
        return self.encode(MessageId.PARAM_REQUEST_READ, *self._autopilot, name, -1)
