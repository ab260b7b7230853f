"""The names of MAVLink that the project uses: message ids, enumerations of the common dialect, and flight modes.

The numbers are those of the message definitions (common.xml, ardupilotmega.xml). Any other message of the dialect can
be sent and received by its number.
"""

from collections.abc import Mapping
from enum import IntEnum, IntFlag

import numpy as np

from mavdiag.telemetry import FloatArray


class MessageId(IntEnum):
    """Messages that the project reads or writes."""

    HEARTBEAT = 0
    SYS_STATUS = 1
    SYSTEM_TIME = 2
    PING = 4
    SET_MODE = 11
    PARAM_REQUEST_READ = 20
    PARAM_REQUEST_LIST = 21
    PARAM_VALUE = 22
    PARAM_SET = 23
    GPS_RAW_INT = 24
    SCALED_IMU = 26
    RAW_IMU = 27
    ATTITUDE = 30
    ATTITUDE_QUATERNION = 31
    LOCAL_POSITION_NED = 32
    GLOBAL_POSITION_INT = 33
    SERVO_OUTPUT_RAW = 36
    MISSION_ITEM = 39
    MISSION_REQUEST = 40
    MISSION_SET_CURRENT = 41
    MISSION_CURRENT = 42
    MISSION_REQUEST_LIST = 43
    MISSION_COUNT = 44
    MISSION_CLEAR_ALL = 45
    MISSION_ITEM_REACHED = 46
    MISSION_ACK = 47
    GPS_GLOBAL_ORIGIN = 49
    MISSION_REQUEST_INT = 51
    RC_CHANNELS = 65
    REQUEST_DATA_STREAM = 66
    MANUAL_CONTROL = 69
    RC_CHANNELS_OVERRIDE = 70
    MISSION_ITEM_INT = 73
    VFR_HUD = 74
    COMMAND_INT = 75
    COMMAND_LONG = 76
    COMMAND_ACK = 77
    ATTITUDE_TARGET = 83
    SET_POSITION_TARGET_LOCAL_NED = 84
    SET_POSITION_TARGET_GLOBAL_INT = 86
    HIL_ACTUATOR_CONTROLS = 93
    HIGHRES_IMU = 105
    HIL_SENSOR = 107
    TIMESYNC = 111
    HIL_GPS = 113
    HIL_STATE_QUATERNION = 115
    SCALED_IMU2 = 116
    SCALED_IMU3 = 129
    BATTERY_STATUS = 147
    AUTOPILOT_VERSION = 148
    VIBRATION = 241
    HOME_POSITION = 242
    MESSAGE_INTERVAL = 244
    EXTENDED_SYS_STATE = 245
    NAMED_VALUE_FLOAT = 251
    STATUSTEXT = 253
    ESC_STATUS = 291
    PROTOCOL_VERSION = 300
    ACTUATOR_OUTPUT_STATUS = 375
    COMPONENT_INFORMATION_BASIC = 396
    AVAILABLE_MODES = 435
    ESC_TELEMETRY_1_TO_4 = 11030
    ESC_TELEMETRY_5_TO_8 = 11031
    ESC_TELEMETRY_9_TO_12 = 11032


class Severity(IntEnum):
    """MAV_SEVERITY. Ground stations pop up 0 to 3."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


class MavType(IntEnum):
    """MAV_TYPE, as far as used."""

    GENERIC = 0
    QUADROTOR = 2
    GCS = 6
    HEXAROTOR = 13
    OCTOROTOR = 14
    ONBOARD_CONTROLLER = 18


class Autopilot(IntEnum):
    """MAV_AUTOPILOT, as far as used."""

    GENERIC = 0
    ARDUPILOTMEGA = 3
    INVALID = 8
    PX4 = 12


class Component(IntEnum):
    """MAV_COMPONENT, as far as used."""

    ALL = 0
    AUTOPILOT1 = 1
    MISSIONPLANNER = 190
    ONBOARD_COMPUTER = 191


class ModeFlag(IntFlag):
    """MAV_MODE_FLAG of HEARTBEAT.base_mode, as far as used."""

    CUSTOM_MODE_ENABLED = 1
    HIL_ENABLED = 32
    SAFETY_ARMED = 128


class TargetMask(IntFlag):
    """ATTITUDE_TARGET_TYPEMASK: what the receiver shall ignore."""

    BODY_ROLL_RATE = 1
    BODY_PITCH_RATE = 2
    BODY_YAW_RATE = 4
    THROTTLE = 64
    ATTITUDE = 128


class MavCmd(IntEnum):
    """MAV_CMD, as far as used."""

    NAV_WAYPOINT = 16
    NAV_LOITER_UNLIM = 17
    NAV_LOITER_TIME = 19
    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    NAV_DELAY = 93
    DO_SET_MODE = 176
    DO_CHANGE_SPEED = 178
    DO_FLIGHTTERMINATION = 185
    DO_REPOSITION = 192
    DO_PAUSE_CONTINUE = 193
    MISSION_START = 300
    COMPONENT_ARM_DISARM = 400
    RUN_PREARM_CHECKS = 401
    GET_HOME_POSITION = 410
    INJECT_FAILURE = 420
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_PROTOCOL_VERSION = 519
    REQUEST_AUTOPILOT_CAPABILITIES = 520
    USER_1 = 31010  # to the detector: the inspection of its vehicle is acknowledged


class MavResult(IntEnum):
    """MAV_RESULT of COMMAND_ACK."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6


# Flight modes by the custom_mode of HEARTBEAT, where ArduPilot Copter's numbers and PX4's do not meet. ArduPilot: the
# number of a mode (AP_Mode, ArduCopter/mode.h). PX4: a main mode in byte 2, a sub mode in byte 3 (px4_custom_mode.h),
# named as ground stations do; its logs tell the navigation state instead (VehicleStatus.msg).
_COPTER = (
    "stabilize acro alt_hold auto guided loiter rtl circle - land - drift - sport flip autotune poshold brake throw"
)
_COPTER += " avoid_adsb guided_nogps smart_rtl flowhold follow zigzag systemid autorotate auto_rtl turtle"
# Main mode, sub mode, navigation state.
_PX4 = {"manual": (1, 0, 0), "altitude": (2, 0, 1), "position": (3, 0, 2), "orbit": (3, 1, 21)}
_PX4 |= {"position_slow": (3, 2, 6), "acro": (5, 0, 10), "offboard": (6, 0, 14), "stabilized": (7, 0, 15)}
_PX4 |= {"takeoff": (4, 2, 17), "hold": (4, 3, 4), "mission": (4, 4, 3), "return": (4, 5, 5), "land": (4, 6, 18)}
_PX4 |= {"follow": (4, 8, 19), "precision_land": (4, 9, 20)}

MODES: Mapping[int, str] = {
    **{number: name for number, name in enumerate(_COPTER.split()) if name != "-"},
    **{main << 16 | sub << 24: name for name, (main, sub, _) in _PX4.items()},
}


def mode_name(custom_mode: int | None) -> str:
    """The name of a mode, its number where it has none here, "unknown" for None.

    >>> mode_name(5), mode_name(4 << 16 | 4 << 24), mode_name(99), mode_name(None)
    ('loiter', 'mission', '99', 'unknown')
    """
    return "unknown" if custom_mode is None else MODES.get(custom_mode, str(custom_mode))


def px4_custom_mode(nav_state: FloatArray) -> FloatArray:
    """The custom_mode that PX4 sends in each navigation state, (n, 1); NaN for one without a name here.

    >>> [mode_name(int(mode)) for mode in px4_custom_mode(np.array([[3.0], [15.0]]))[:, 0]]
    ['mission', 'stabilized']
    """
    found = np.full(nav_state.shape, np.nan)
    for main, sub, state in _PX4.values():
        found[nav_state == state] = main << 16 | sub << 24
    return found
