"""How the commands, modes and parameters of ArduPilot Copter and PX4 differ: one row each.

custom_mode of ArduPilot is the number of a mode (AP_Mode); PX4 packs a main mode into byte 2 and a sub mode into byte 3
(px4_custom_mode.h).
"""

from dataclasses import dataclass
from enum import StrEnum

from mavdiag.link.messages import MavResult
from sitl_plant.autopilot.parameters import Encoding, Kind, Parameter


class Mode(StrEnum):
    """What the emulated vehicle does in a mode. There are no sticks: a manual mode holds the position."""

    MANUAL = "manual"
    HOLD = "hold"
    GUIDED = "guided"
    TAKEOFF = "takeoff"
    LAND = "land"
    RTL = "rtl"
    MISSION = "mission"


@dataclass(frozen=True, slots=True)
class ModeCode:
    """One flight mode. custom_mode: its number in HEARTBEAT."""

    custom_mode: int
    mode: Mode
    name: str


@dataclass(frozen=True, slots=True)
class Firmware:
    """How an autopilot takes commands.

    speed, height, return_height: names of parameters; the unit of each is `unit` metres (per second).
    """

    modes: tuple[ModeCode, ...]  # the modes; the first with a `Mode` is the one that a command such as NAV_LAND brings
    encoding: Encoding  # of parameters
    amsl: bool  # the altitude of a COMMAND_LONG is above the sea, not above home
    takeoff: Mode  # the mode during a take-off by command
    needs_guided: bool  # NAV_TAKEOFF is refused in another mode
    reposition: Mode  # the mode in which DO_REPOSITION flies
    refused: MavResult  # the result of a command that the vehicle's state does not allow
    speed: str
    height: str
    return_height: str
    unit: float
    parameters: tuple[Parameter, ...]  # its own that can be set

    def code(self, custom_mode: int) -> ModeCode | None:
        """The mode of a number; None if there is none."""
        return next((code for code in self.modes if code.custom_mode == custom_mode), None)

    def shown(self, mode: Mode) -> int:
        """The custom_mode of what the vehicle does."""
        return next(code.custom_mode for code in self.modes if code.mode is mode)


def _px4(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


_COPTER_MODES = (
    ModeCode(4, Mode.GUIDED, "GUIDED"),
    ModeCode(5, Mode.HOLD, "LOITER"),
    ModeCode(0, Mode.MANUAL, "STABILIZE"),
    ModeCode(2, Mode.MANUAL, "ALT_HOLD"),
    ModeCode(3, Mode.MISSION, "AUTO"),
    ModeCode(6, Mode.RTL, "RTL"),
    ModeCode(9, Mode.LAND, "LAND"),
    ModeCode(16, Mode.HOLD, "POSHOLD"),
    ModeCode(17, Mode.HOLD, "BRAKE"),
)
_PX4_MODES = (
    ModeCode(_px4(4, 3), Mode.HOLD, "Hold"),
    ModeCode(_px4(6), Mode.GUIDED, "Offboard"),
    ModeCode(_px4(1), Mode.MANUAL, "Manual"),
    ModeCode(_px4(2), Mode.MANUAL, "Altitude"),
    ModeCode(_px4(3), Mode.MANUAL, "Position"),
    ModeCode(_px4(7), Mode.MANUAL, "Stabilized"),
    ModeCode(_px4(4, 2), Mode.TAKEOFF, "Takeoff"),
    ModeCode(_px4(4, 4), Mode.MISSION, "Mission"),
    ModeCode(_px4(4, 5), Mode.RTL, "Return"),
    ModeCode(_px4(4, 6), Mode.LAND, "Land"),
)

SPEED_MOST, HEIGHT_MOST = 2.0, 50.0  # m/s that the thesis's cascade flies well; m
_CM = 0.01

COPTER = Firmware(
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
        Parameter("WPNAV_SPEED", 100.0, Kind.REAL32, (10.0, SPEED_MOST / _CM)),
        Parameter("PILOT_TKOFF_ALT", 150.0, Kind.REAL32, (30.0, HEIGHT_MOST / _CM)),
        Parameter("RTL_ALT", 200.0, Kind.INT32, (30.0, HEIGHT_MOST / _CM)),
    ),
)
PX4 = Firmware(
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
        Parameter("MPC_XY_CRUISE", 1.0, Kind.REAL32, (0.1, SPEED_MOST)),
        Parameter("MIS_TAKEOFF_ALT", 1.5, Kind.REAL32, (0.3, HEIGHT_MOST)),
        Parameter("RTL_RETURN_ALT", 2.0, Kind.REAL32, (0.3, HEIGHT_MOST)),
        Parameter("SYS_FAILURE_EN", 1, Kind.INT32, (0, 1)),
    ),
)
# Whoever does not know an autopilot guesses: mavsdk takes its custom_mode for PX4's, pymavlink for ArduPilot's. The
# numbers do not meet, so both are understood. mavsdk sends it altitudes above home. All its parameters are floats.
GENERIC = Firmware(
    modes=(*_PX4_MODES, *_COPTER_MODES),
    encoding=Encoding.FLOAT,
    amsl=False,
    takeoff=Mode.TAKEOFF,
    needs_guided=False,
    reposition=Mode.HOLD,
    refused=MavResult.DENIED,
    speed=PX4.speed,
    height=PX4.height,
    return_height=PX4.return_height,
    unit=1.0,
    parameters=PX4.parameters[:3],
)
