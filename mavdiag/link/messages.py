"""The names of MAVLink that the project uses: message ids and the enumerations of the common dialect.

The numbers are those of the message definitions (common.xml, ardupilotmega.xml). Any other message of the dialect can
be sent and received by its number.
"""

from enum import IntEnum, IntFlag


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
