"""The names of MAVLink that the project uses: message ids and the enumerations of the common dialect.

The numbers are those of the message definitions (common.xml, ardupilotmega.xml). Any other message of the dialect can
be sent and received by its number.
"""

from enum import IntEnum, IntFlag

__all__ = [
    "Autopilot",
    "Component",
    "MavCmd",
    "MavResult",
    "MavType",
    "MessageId",
    "ModeFlag",
    "Severity",
    "TargetMask",
]


class MessageId(IntEnum):
    """Messages that the project reads or writes."""

    HEARTBEAT = 0
    SYS_STATUS = 1
    SYSTEM_TIME = 2
    PARAM_REQUEST_READ = 20
    PARAM_REQUEST_LIST = 21
    PARAM_VALUE = 22
    PARAM_SET = 23
    SCALED_IMU = 26
    RAW_IMU = 27
    ATTITUDE = 30
    ATTITUDE_QUATERNION = 31
    LOCAL_POSITION_NED = 32
    SERVO_OUTPUT_RAW = 36
    MISSION_REQUEST_LIST = 43
    MISSION_COUNT = 44
    REQUEST_DATA_STREAM = 66
    COMMAND_INT = 75
    COMMAND_LONG = 76
    COMMAND_ACK = 77
    ATTITUDE_TARGET = 83
    HIGHRES_IMU = 105
    TIMESYNC = 111
    SCALED_IMU2 = 116
    SCALED_IMU3 = 129
    AUTOPILOT_VERSION = 148
    VIBRATION = 241
    EXTENDED_SYS_STATE = 245
    NAMED_VALUE_FLOAT = 251
    STATUSTEXT = 253
    ESC_INFO = 290
    ESC_STATUS = 291
    ACTUATOR_OUTPUT_STATUS = 375
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

    INJECT_FAILURE = 420
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512


class MavResult(IntEnum):
    """MAV_RESULT of COMMAND_ACK."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6
