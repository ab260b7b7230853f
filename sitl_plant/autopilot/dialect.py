"""How the emulated autopilots differ on the wire, beyond their link profile: one row each.

Units, filter and stamps are those of `mavdiag.link.profiles`, so that what is sent is what is understood. Facts about
ArduPilot Copter and PX4 were read in their sources and checked against their simulators (2026). Where the emulator
departs from them, so that it is useful without being asked, the row says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.errors import UsageError
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES, Profile, Stamp, profile_named
from sitl_plant.autopilot.failures import FAULT_PARAMETERS
from sitl_plant.autopilot.firmware import COPTER, GENERIC, PX4, Firmware
from sitl_plant.autopilot.parameters import Kind, Parameter
from sitl_plant.autopilot.pilot import NOSE
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.vehicle import Vehicle, airframe_of

ESC_GROUP = 4  # rotors in one message of their speeds
FRAME_CLASSES, FRAME_TYPES = {4: 1, 6: 2, 8: 3}, (0, 1)  # ArduPilot: quad, hexa, octa; plus, X
OWN_PARAMETERS = (*FAULT_PARAMETERS, Parameter(NOSE, 1, Kind.INT8, (0, 1)))


@dataclass(frozen=True, slots=True)
class Dialect:
    """What one kind of autopilot sends.

    unasked: rates of what the real autopilot sends on a fresh link [Hz].
    streams: which messages REQUEST_DATA_STREAM sets, by MAV_DATA_STREAM; empty for an autopilot that ignores it.
    """

    profile: Profile  # units, filter and stamps
    custom_mode: int  # flight mode in HEARTBEAT
    others: Mapping[int, float]  # rates of the messages besides set-point and IMU [Hz]
    ceiling_hz: float  # the highest rate that is granted
    firmware: Firmware  # how it takes commands
    send_delay_s: float = 0.0  # longest time from the sample to its stamp, if messages are stamped when they are sent
    parameters: tuple[Parameter, ...] = ()  # those of the autopilot besides its firmware's and the emulator's own
    streams: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    unasked: Mapping[int, float] = field(default_factory=dict)
    whole_ms: bool = False  # intervals are cut to whole milliseconds
    attained_hz: float | None = None  # a rate above this is granted, and comes at this one; None if every rate is met
    sysid: int = 1  # system id of the vehicle, 1 to 255

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

    def schedule(self, rate_hz: float | None, rotors: int = 4, fresh: bool = False) -> Schedule:
        """The rhythm of a link, which grants rates as the autopilot does. fresh: only what is sent unasked."""
        rates = self.rates_hz(rate_hz, rotors)
        if fresh:
            rates = {msgid: min(self.unasked.get(msgid, 0.0), rate) for msgid, rate in rates.items()}
        return Schedule(rates, self.ceiling_hz, self.whole_ms, self.attained_hz)

    def parameters_of(self, vehicle: Vehicle) -> tuple[Parameter, ...]:
        """The parameters of a vehicle: the dialect's, its geometry as the autopilot has it, those that can be set."""
        geometry = _px4_rotors(vehicle) if self.firmware is PX4 else _copter_frame(vehicle)
        own = Parameter("MAV_SYS_ID" if self.firmware is PX4 else "SYSID_THISMAV", self.sysid, Kind.INT16)
        return (own, *self.parameters, *geometry, *self.firmware.parameters, *OWN_PARAMETERS)


def _copter_frame(vehicle: Vehicle) -> tuple[Parameter, ...]:
    """FRAME_CLASS; FRAME_TYPE and SERVOn_FUNCTION only where the rotors have ArduPilot's order."""
    rotors, layout = len(vehicle.rotors), airframe_of(vehicle, "").layout
    frame = FRAME_CLASSES.get(rotors, 0)
    for kind in FRAME_TYPES:
        told = layout_from_parameters({"FRAME_CLASS": frame, "FRAME_TYPE": kind}).layout
        if told is not None and layout is not None and told.alike(layout):
            outputs = [Parameter(f"SERVO{n}_FUNCTION", 32 + n, Kind.INT16) for n in range(1, rotors + 1)]
            return (_whole("FRAME_CLASS", frame, Kind.INT8), _whole("FRAME_TYPE", kind, Kind.INT8), *outputs)
    return (_whole("FRAME_CLASS", frame, Kind.INT8),)


def _px4_rotors(vehicle: Vehicle) -> tuple[Parameter, ...]:
    rows = [_whole("CA_ROTOR_COUNT", len(vehicle.rotors), Kind.INT32)]
    moment = 1.0 / vehicle.propulsion.thrust_per_torque_1_m
    for n, rotor in enumerate(vehicle.rotors):
        values = {"PX": rotor.position_m[0], "PY": rotor.position_m[1], "KM": -rotor.sign * moment}
        rows += [Parameter(f"CA_ROTOR{n}_{part}", value) for part, value in values.items()]
    return tuple(rows)


def _whole(name: str, value: int, kind: Kind) -> Parameter:
    return Parameter(name, value, kind)


_STATE: dict[int, float] = {
    MessageId.HEARTBEAT: 1.0,
    MessageId.SYS_STATUS: 2.0,
    MessageId.EXTENDED_SYS_STATE: 1.0,
    MessageId.ATTITUDE: 50.0,
    MessageId.ATTITUDE_QUATERNION: 50.0,
    MessageId.LOCAL_POSITION_NED: 30.0,
    MessageId.GLOBAL_POSITION_INT: 5.0,
    MessageId.GPS_RAW_INT: 2.0,
    MessageId.VFR_HUD: 2.0,
    MessageId.HOME_POSITION: 0.5,
    MessageId.BATTERY_STATUS: 0.5,
    MessageId.GPS_GLOBAL_ORIGIN: 0.0,
}


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

_PX4_UNASKED: Mapping[int, float] = {  # PX4, mavlink_main.cpp, MAVLINK_MODE_NORMAL; as far as carried here
    MessageId.HEARTBEAT: 1.0,
    MessageId.ATTITUDE: 15.0,
    MessageId.ATTITUDE_QUATERNION: 10.0,
    MessageId.ATTITUDE_TARGET: 2.0,
    MessageId.SYS_STATUS: 1.0,
    MessageId.EXTENDED_SYS_STATE: 1.0,
    MessageId.LOCAL_POSITION_NED: 1.0,
    MessageId.GLOBAL_POSITION_INT: 5.0,
    MessageId.GPS_RAW_INT: 1.0,
    MessageId.VFR_HUD: 4.0,
    MessageId.HOME_POSITION: 0.5,
    MessageId.BATTERY_STATUS: 0.5,
    MessageId.ESC_STATUS: 1.0,
}

_QDRONE2, _SPEC, _ARDUPILOT, _PX4 = (PROFILES[name] for name in ("qdrone2", "spec", "ardupilot", "px4"))

_ALL = (
    *(
        Dialect(
            profile,
            custom_mode=0,
            others=_messages(profile, MessageId.HIGHRES_IMU),
            ceiling_hz=1000.0,
            firmware=GENERIC,
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
        firmware=COPTER,
        send_delay_s=0.0025,  # one loop
        parameters=(
            Parameter("INS_GYRO_FILTER", 20, Kind.INT16),
            Parameter("INS_ACCEL_FILTER", 20, Kind.INT16),
            Parameter("SCHED_LOOP_RATE", 400, Kind.INT16),
        ),
        streams=_STREAMS,
        unasked={MessageId.HEARTBEAT: 1.0},  # SRn_... are 0 on a fresh link
        whole_ms=True,
    ),
    # PX4 sends ATTITUDE_TARGET at 2 to 10 Hz and HIGHRES_IMU at 50 Hz unless asked; the emulator at the link rate.
    Dialect(
        _PX4,
        custom_mode=6 << 16,  # main mode offboard
        others=_messages(_PX4),
        ceiling_hz=250.0,  # estimate
        firmware=PX4,
        parameters=(
            Parameter("IMU_GYRO_CUTOFF", 40.0),
            Parameter("IMU_ACCEL_CUTOFF", 30.0),
            *(Parameter(f"CAL_{sensor}0_ID", 1, Kind.INT32) for sensor in ("GYRO", "ACC", "MAG")),
        ),
        unasked=_PX4_UNASKED,
        attained_hz=165.0,  # 200 Hz asked gave 160 to 170
    ),
)

DIALECTS: Mapping[str, Dialect] = {row.profile.name: row for row in _ALL}
"""The dialects by the name of their link profile."""


def dialect_named(name: str) -> Dialect:
    """The dialect of a link profile. Raises UsageError for an unknown one."""
    return DIALECTS[profile_named(name).name]
