"""How the emulated autopilots differ on the wire, beyond their link profile: modes, commands, parameters, one row each.

Facts about ArduPilot Copter and PX4 were read in their sources and checked against their simulators (2026); where the
emulator departs from them, so that it is useful without being asked, the row says so. custom_mode of ArduPilot is the
number of a mode (AP_Mode); PX4 packs a main mode into byte 2 and a sub mode into byte 3 (px4_custom_mode.h).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.errors import UsageError
from mavdiag.link.messages import MODES, Autopilot, MavResult, MessageId
from mavdiag.link.parameters import Encoding, Kind, Parameter
from mavdiag.link.profiles import PROFILES, Profile, profile_named
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.vehicle import Rotor, Vehicle, airframe_of

ESC_GROUP = 4  # rotors in one message of their speeds
PX4_KINDS: Mapping[type, Kind] = {int: Kind.INT32, float: Kind.REAL32}
FRAME_CLASSES, FRAME_TYPES = {4: 1, 6: 2, 8: 3}, (0, 1)  # ArduPilot: quad, hexa, octa; plus, X
# Parameters of the emulator's own: the propeller that INJECT_FAILURE damages, and 1 to turn the nose along a line.
FAULT, SEVERITY, NOSE = "SIM_PROP_FAULT", "SIM_PROP_SEV", "SIM_NOSE"


OWN_PARAMETERS = (
    Parameter(FAULT, 0, Kind.INT8, (0, 3)),
    Parameter(SEVERITY, 1, Kind.INT8, (1, 3)),
    Parameter(NOSE, 1, Kind.INT8, (0, 1)),
)


class Mode(StrEnum):
    """What the emulated vehicle does in a mode. There are no sticks: a manual mode holds the position."""

    MANUAL = "manual"
    HOLD = "hold"
    GUIDED = "guided"
    TAKEOFF = "takeoff"
    LAND = "land"
    RTL = "rtl"
    MISSION = "mission"


class ModeCode(NamedTuple):
    """One flight mode. custom_mode: its number in HEARTBEAT."""

    custom_mode: int
    mode: Mode
    name: str


def _codes(meaning: Mapping[str, Mode], autopilot: Autopilot) -> tuple[ModeCode, ...]:
    """The modes of these names, as `MODES` has them, spelled as the autopilot itself spells them."""
    px4 = autopilot is Autopilot.PX4
    numbers = {name: number for number, name in MODES.items() if (number >= 1 << 16) is px4}
    spelled = str.capitalize if px4 else str.upper
    return tuple(ModeCode(numbers[name], mode, spelled(name)) for name, mode in meaning.items())


_COPTER_MODES = _codes(
    {"guided": Mode.GUIDED, "loiter": Mode.HOLD, "poshold": Mode.HOLD, "brake": Mode.HOLD, "stabilize": Mode.MANUAL}
    | {"alt_hold": Mode.MANUAL, "auto": Mode.MISSION, "rtl": Mode.RTL, "land": Mode.LAND},
    Autopilot.ARDUPILOTMEGA,
)
_PX4_MODES = _codes(
    {"hold": Mode.HOLD, "offboard": Mode.GUIDED, "manual": Mode.MANUAL, "altitude": Mode.MANUAL}
    | {"position": Mode.MANUAL, "stabilized": Mode.MANUAL, "takeoff": Mode.TAKEOFF, "mission": Mode.MISSION}
    | {"return": Mode.RTL, "land": Mode.LAND},
    Autopilot.PX4,
)

SPEED_MOST, HEIGHT_MOST = 2.0, 50.0  # m/s that the thesis's cascade flies well; m
_CM = 0.01


@dataclass(frozen=True, slots=True)
class Dialect:
    """What one kind of autopilot sends, and how it takes commands.

    modes: the first with a `Mode` is the one that a command such as NAV_LAND brings.
    amsl: the altitude of a COMMAND_LONG is above the sea, not above home.
    takeoff, reposition: the mode during a take-off by command, and that in which DO_REPOSITION flies.
    refused: the result of a command that the vehicle's state does not allow.
    speed, height, return_height: names of parameters, of the heights of a take-off and of a return; unit: theirs.
    unasked: rates of what the real autopilot sends on a fresh link [Hz].
    streams: which messages REQUEST_DATA_STREAM sets, by MAV_DATA_STREAM; empty for an autopilot that ignores it.
    """

    profile: Profile  # units, filter and stamps
    custom_mode: int  # flight mode in HEARTBEAT
    others: Mapping[int, float]  # rates of the messages besides set-point and IMU [Hz]
    ceiling_hz: float  # the highest rate that is granted
    modes: tuple[ModeCode, ...]
    encoding: Encoding  # of parameters
    amsl: bool
    takeoff: Mode
    needs_guided: bool  # NAV_TAKEOFF is refused in another mode
    reposition: Mode
    refused: MavResult
    speed: str
    height: str
    return_height: str
    unit: float  # in metres (per second)
    parameters: tuple[Parameter, ...]  # besides geometry and the emulator's own
    send_delay_s: float = 0.0  # longest time from the sample to its stamp, if messages are stamped when they are sent
    streams: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    unasked: Mapping[int, float] = field(default_factory=dict)
    whole_ms: bool = False  # intervals are cut to whole milliseconds
    attained_hz: float | None = None  # a rate above this is granted, and comes at this one; None if every rate is met
    esc: bool = False  # each ESC tells its speed in its turn once in a frame; else the speeds are told as they are
    sysid: int = 1  # system id of the vehicle, 1 to 255

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

    def schedule(self, rate_hz: float | None, rotors: int = 4, fresh: bool = False) -> Schedule:
        """The rhythm of a link, which grants rates as the autopilot does. fresh: only what is sent unasked."""
        rates = self.rates_hz(rate_hz, rotors)
        if fresh:
            rates = {msgid: min(self.unasked.get(msgid, 0.0), rate) for msgid, rate in rates.items()}
        return Schedule(rates, self.ceiling_hz, self.whole_ms, self.attained_hz)

    def parameters_of(self, vehicle: Vehicle) -> tuple[Parameter, ...]:
        """The parameters of a vehicle: the dialect's, its geometry as the autopilot has it, the emulator's own."""
        px4 = self.encoding is Encoding.BYTES
        rotors = px4_rotors(vehicle, vehicle.rotors).items() if px4 else ()
        geometry = [Parameter(name, value, PX4_KINDS[type(value)]) for name, value in rotors] or _copter_frame(vehicle)
        own = Parameter("MAV_SYS_ID" if px4 else "SYSID_THISMAV", self.sysid, Kind.INT16)
        return (own, *self.parameters, *geometry, *OWN_PARAMETERS)

    def code(self, custom_mode: int) -> ModeCode | None:
        """The mode of a number; None if there is none."""
        return next((code for code in self.modes if code.custom_mode == custom_mode), None)

    def shown(self, mode: Mode) -> int:
        """The custom_mode of what the vehicle does."""
        return next(code.custom_mode for code in self.modes if code.mode is mode)


def _copter_frame(vehicle: Vehicle) -> tuple[Parameter, ...]:
    """FRAME_CLASS; FRAME_TYPE and SERVOn_FUNCTION only where the rotors have ArduPilot's order."""
    rotors, layout = len(vehicle.rotors), airframe_of(vehicle, "").layout
    frame = FRAME_CLASSES.get(rotors, 0)
    for kind in FRAME_TYPES:
        told = layout_from_parameters({"FRAME_CLASS": frame, "FRAME_TYPE": kind}).layout
        if told is not None and layout is not None and told.alike(layout):
            outputs = [Parameter(f"SERVO{n}_FUNCTION", 32 + n, Kind.INT16) for n in range(1, rotors + 1)]
            return (Parameter("FRAME_CLASS", frame, Kind.INT8), Parameter("FRAME_TYPE", kind, Kind.INT8), *outputs)
    return (Parameter("FRAME_CLASS", frame, Kind.INT8),)


def px4_rotors(vehicle: Vehicle, rotors: Sequence[Rotor]) -> dict[str, int | float]:
    """PX4's parameters of rotors in the order of its motors; their moment is positive for counter-clockwise."""
    rows: dict[str, int | float] = {"CA_ROTOR_COUNT": len(rotors)}
    for motor, rotor in enumerate(rotors):
        rows |= {f"CA_ROTOR{motor}_P{axis}": place for axis, place in zip("XYZ", rotor.position_m, strict=True)}
        rows[f"CA_ROTOR{motor}_KM"] = round(-rotor.sign / vehicle.propulsion.thrust_per_torque_1_m, 5)
    return rows


_STATE: dict[int, float] = {MessageId.HEARTBEAT: 1.0, MessageId.SYS_STATUS: 2.0, MessageId.EXTENDED_SYS_STATE: 1.0}
_STATE |= {MessageId.ATTITUDE: 50.0, MessageId.ATTITUDE_QUATERNION: 50.0, MessageId.LOCAL_POSITION_NED: 30.0}
_STATE |= {MessageId.GLOBAL_POSITION_INT: 5.0, MessageId.GPS_RAW_INT: 2.0, MessageId.VFR_HUD: 2.0}
_STATE |= {MessageId.HOME_POSITION: 0.5, MessageId.BATTERY_STATUS: 0.5, MessageId.GPS_GLOBAL_ORIGIN: 0.0}


def _messages(profile: Profile, *more: MessageId) -> dict[int, float]:
    vibration: dict[int, float] = {MessageId.VIBRATION: 10.0} if profile.vibration else {}
    return {**_STATE, **vibration, **dict.fromkeys((profile.actuator, profile.rotor_speed, *more), 50.0)}


# ArduPilot Copter 4.5, GCS_Mavlink.cpp, STREAM_..._msgs: which message belongs to which SRn parameter. ATTITUDE_TARGET,
# EXTENDED_SYS_STATE and ATTITUDE_QUATERNION belong to none: no ground station resets them.
_STREAMS: Mapping[int, tuple[int, ...]] = {
    1: (MessageId.RAW_IMU, MessageId.SCALED_IMU2, MessageId.SCALED_IMU3),  # RAW_SENSORS
    2: (MessageId.SYS_STATUS, MessageId.GPS_RAW_INT),  # EXTENDED_STATUS
    3: (MessageId.SERVO_OUTPUT_RAW,),  # RC_CHANNELS
    6: (MessageId.LOCAL_POSITION_NED, MessageId.GLOBAL_POSITION_INT),  # POSITION
    10: (MessageId.ATTITUDE,),  # EXTRA1
    11: (MessageId.VFR_HUD,),  # EXTRA2
    12: (  # EXTRA3
        MessageId.VIBRATION,
        MessageId.BATTERY_STATUS,
        MessageId.ESC_TELEMETRY_1_TO_4,
        MessageId.ESC_TELEMETRY_5_TO_8,
        MessageId.ESC_TELEMETRY_9_TO_12,
    ),
}

# PX4, mavlink_main.cpp, MAVLINK_MODE_NORMAL; as far as carried here
_PX4_UNASKED: dict[int, float] = {MessageId.HEARTBEAT: 1.0, MessageId.ATTITUDE: 15.0, MessageId.ATTITUDE_TARGET: 2.0}
_PX4_UNASKED |= {MessageId.ATTITUDE_QUATERNION: 10.0, MessageId.SYS_STATUS: 1.0, MessageId.EXTENDED_SYS_STATE: 1.0}
_PX4_UNASKED |= {MessageId.LOCAL_POSITION_NED: 1.0, MessageId.GLOBAL_POSITION_INT: 5.0, MessageId.GPS_RAW_INT: 1.0}
_PX4_UNASKED |= {MessageId.VFR_HUD: 4.0, MessageId.HOME_POSITION: 0.5, MessageId.BATTERY_STATUS: 0.5}
_PX4_UNASKED |= {MessageId.ESC_STATUS: 1.0}

_QDRONE2, _SPEC, _ARDUPILOT, _PX4 = (PROFILES[name] for name in ("qdrone2", "spec", "ardupilot", "px4"))

# ArduPilot sends ATTITUDE_TARGET and RAW_IMU only on request; the emulator sends them at once, and takes requests.
COPTER = Dialect(
    _ARDUPILOT,
    custom_mode=4,  # Copter: guided
    others=_messages(_ARDUPILOT) | {MessageId.ESC_TELEMETRY_1_TO_4: 10.0},
    ceiling_hz=1000.0 / 3.0,  # 0.8 x loop rate (400 Hz) in whole milliseconds
    modes=_COPTER_MODES,
    encoding=Encoding.CAST,
    amsl=False,
    takeoff=Mode.GUIDED,
    needs_guided=True,
    reposition=Mode.GUIDED,
    refused=MavResult.FAILED,
    speed="WPNAV_SPEED",
    height="PILOT_TKOFF_ALT",
    return_height="RTL_ALT",
    unit=_CM,
    parameters=(
        Parameter("INS_GYRO_FILTER", 20, Kind.INT16),
        Parameter("INS_ACCEL_FILTER", 20, Kind.INT16),
        Parameter("SCHED_LOOP_RATE", 400, Kind.INT16),
        Parameter("WPNAV_SPEED", 100.0, Kind.REAL32, (10.0, SPEED_MOST / _CM)),
        Parameter("PILOT_TKOFF_ALT", 150.0, Kind.REAL32, (30.0, HEIGHT_MOST / _CM)),
        Parameter("RTL_ALT", 200.0, Kind.INT32, (30.0, HEIGHT_MOST / _CM)),
    ),
    send_delay_s=0.0025,  # one loop
    streams=_STREAMS,
    unasked={MessageId.HEARTBEAT: 1.0},  # SRn_... are 0 on a fresh link
    whole_ms=True,
    esc=True,
)
_PX4_PARAMETERS = (
    Parameter("MPC_XY_CRUISE", 1.0, Kind.REAL32, (0.1, SPEED_MOST)),
    Parameter("MIS_TAKEOFF_ALT", 1.5, Kind.REAL32, (0.3, HEIGHT_MOST)),
    Parameter("RTL_RETURN_ALT", 2.0, Kind.REAL32, (0.3, HEIGHT_MOST)),
)
# PX4 sends ATTITUDE_TARGET at 2 to 10 Hz and HIGHRES_IMU at 50 Hz unless asked; the emulator at the link rate.
PX4 = Dialect(
    _PX4,
    custom_mode=6 << 16,  # main mode offboard
    others=_messages(_PX4) | {MessageId.ESC_STATUS: 10.0},
    ceiling_hz=250.0,  # estimate
    modes=_PX4_MODES,
    encoding=Encoding.BYTES,
    amsl=True,
    takeoff=Mode.TAKEOFF,
    needs_guided=False,
    reposition=Mode.HOLD,
    refused=MavResult.TEMPORARILY_REJECTED,
    speed="MPC_XY_CRUISE",
    height="MIS_TAKEOFF_ALT",
    return_height="RTL_RETURN_ALT",
    unit=1.0,
    parameters=(
        Parameter("IMU_GYRO_CUTOFF", 40.0),
        Parameter("IMU_ACCEL_CUTOFF", 30.0),
        *(Parameter(f"CAL_{sensor}0_ID", 1, Kind.INT32) for sensor in ("GYRO", "ACC", "MAG")),
        *_PX4_PARAMETERS,
        Parameter("SYS_FAILURE_EN", 1, Kind.INT32, (0, 1)),
    ),
    unasked=_PX4_UNASKED,
    attained_hz=165.0,  # 200 Hz asked gave 160 to 170
    esc=True,
)
# Whoever does not know an autopilot guesses: mavsdk takes its custom_mode for PX4's, pymavlink for ArduPilot's. The
# numbers do not meet, so both are understood. mavsdk sends it altitudes above home. All its parameters are floats.
GENERIC = replace(
    PX4,
    profile=_QDRONE2,
    custom_mode=0,
    others=_messages(_QDRONE2, MessageId.HIGHRES_IMU),
    ceiling_hz=1000.0,
    modes=(*_PX4_MODES, *_COPTER_MODES),
    encoding=Encoding.FLOAT,
    amsl=False,
    refused=MavResult.DENIED,
    parameters=_PX4_PARAMETERS,
    streams=_STREAMS,
    unasked={},
    attained_hz=None,
)
_COUNTS = replace(GENERIC, profile=_SPEC, others=_messages(_SPEC, MessageId.HIGHRES_IMU))

DIALECTS: Mapping[str, Dialect] = {row.profile.name: row for row in (GENERIC, _COUNTS, COPTER, PX4)}
"""The dialects by the name of their link profile."""


def dialect_named(name: str) -> Dialect:
    """The dialect of a link profile. Raises UsageError for an unknown one."""
    return DIALECTS[profile_named(name).name]
