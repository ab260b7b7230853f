"""COMMAND_LONG, COMMAND_INT, mission items and set-points: where they lead, and what the pilot is to do."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from mavdiag.link.codec import Frame
from mavdiag.link.messages import MavCmd, MavResult, MessageId
from sitl_plant.autopilot.firmware import Firmware, Mode
from sitl_plant.autopilot.geo import HOME_ALT_M, to_local
from sitl_plant.autopilot.pilot import Pilot, Waypoint
from sitl_plant.autopilot.wire import number, optional

ABOVE_SEA, ABOVE_HOME = (0, 5), (3, 6, 10, 11)  # MAV_FRAME: GLOBAL, GLOBAL_RELATIVE_ALT, terrain as relative; _INT
LOCAL_NED, OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9  # MAV_FRAME
NOT_SET = 0x7FFFFFFF  # of the integers x and y
FORCE = 21196  # COMPONENT_ARM_DISARM.param2: whatever the state is
NO_POSITION, NO_VELOCITY, NO_YAW = 0b111, 0b111_000, 1 << 10  # POSITION_TARGET_TYPEMASK
_DEGREES = 1e-7
_INTEGERS = (MessageId.COMMAND_INT, MessageId.MISSION_ITEM_INT, MessageId.SET_POSITION_TARGET_GLOBAL_INT)


@dataclass(frozen=True, slots=True)
class Order:
    """A MAV_CMD with its parameters; None for one that is not given.

    x, y: degrees. z: metres.
    """

    command: int
    frame: int | None  # MAV_FRAME; None for COMMAND_LONG, which has none
    param: tuple[float | None, float | None, float | None, float | None]  # the first four
    x: float | None
    y: float | None
    z: float | None

    def whole(self, index: int) -> int:
        """Parameter 1 to 4 as an integer; 0 if it is not given."""
        return int(self.param[index - 1] or 0)


def order_of(frame: Frame) -> Order:
    """The order in COMMAND_LONG, COMMAND_INT, MISSION_ITEM or MISSION_ITEM_INT."""
    given = [optional(frame, f"param{n}") for n in range(1, 5)]
    kind = optional(frame, "frame")
    if frame.msgid == MessageId.COMMAND_LONG:
        x, y, z = (optional(frame, f"param{n}") for n in (5, 6, 7))
    else:
        x, y, z = (optional(frame, name) for name in ("x", "y", "z"))
    if frame.msgid in _INTEGERS:
        x, y = (None if value in (None, NOT_SET) else value * _DEGREES for value in (x, y))
    one, two, three, four = given
    return Order(int(number(frame, "command")), None if kind is None else int(kind), (one, two, three, four), x, y, z)


def _height(order: Order, amsl: bool) -> float | None:
    """Above home; None if it is not given."""
    if order.z is None:
        return None
    above_sea = amsl if order.frame is None else order.frame in ABOVE_SEA
    return order.z - HOME_ALT_M if above_sea else order.z


def _place(order: Order, firmware: Firmware, here: tuple[float, float, float]) -> tuple[float, float, float] | None:
    """Where an order leads, world NED; the present place for what is not given. None for a frame not known here."""
    if order.frame is not None and order.frame not in ABOVE_SEA + ABOVE_HOME:
        return None
    there = here[:2] if not order.x or not order.y else to_local(order.x, order.y)
    # the altitude of DO_REPOSITION is above the sea wherever no frame says otherwise
    height = _height(order, firmware.amsl or order.command == MavCmd.DO_REPOSITION)
    return there[0], there[1], here[2] if height is None else -height


def _arm(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    return pilot.arm(order.whole(1) == 1, order.whole(2) == FORCE)


def _take_off(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    height = _height(order, firmware.amsl)
    return pilot.take_off(height if height is None or height > 0.0 else None)


def _reposition(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    place = _place(order, firmware, pilot.position)
    speed = order.param[0] if (order.param[0] or -1.0) > 0.0 else None
    return MavResult.DENIED if place is None else pilot.go(place, order.param[3], speed)


def _set_mode(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    main, sub = order.whole(2), order.whole(3)
    packed = main << 16 | sub << 24
    return pilot.set_mode(packed if firmware.code(packed) or sub else main)


def _terminate(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    return pilot.arm(False, force=True) if order.whole(1) else MavResult.DENIED


def _set_speed(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    return pilot.set_speed(order.param[1] or 0.0)


def _accept(pilot: Pilot, firmware: Firmware, order: Order) -> MavResult:
    return MavResult.ACCEPTED


ORDERS: Mapping[int, Callable[[Pilot, Firmware, Order], MavResult]] = {
    MavCmd.COMPONENT_ARM_DISARM: _arm,
    MavCmd.NAV_TAKEOFF: _take_off,
    MavCmd.DO_REPOSITION: _reposition,
    MavCmd.NAV_LAND: lambda pilot, firmware, order: pilot.do(Mode.LAND),
    MavCmd.NAV_RETURN_TO_LAUNCH: lambda pilot, firmware, order: pilot.do(Mode.RTL),
    MavCmd.NAV_LOITER_UNLIM: lambda pilot, firmware, order: pilot.do(Mode.HOLD),
    MavCmd.MISSION_START: lambda pilot, firmware, order: pilot.do(Mode.MISSION),
    MavCmd.DO_SET_MODE: _set_mode,
    MavCmd.DO_CHANGE_SPEED: _set_speed,
    MavCmd.DO_FLIGHTTERMINATION: _terminate,
    MavCmd.RUN_PREARM_CHECKS: _accept,
}
"""What the pilot does for each MAV_CMD."""

_GOES = (MavCmd.NAV_WAYPOINT, MavCmd.NAV_TAKEOFF, MavCmd.NAV_LOITER_TIME, MavCmd.NAV_LOITER_UNLIM)


def waypoints(orders: Sequence[Order], firmware: Firmware) -> tuple[Waypoint, ...] | None:
    """What the items of a mission mean; None if one of them cannot be flown."""
    plan: list[Waypoint] = []
    here, speed = (0.0, 0.0, -1.0), None
    for seq, order in enumerate(orders):
        speed = (order.param[1] or None) if order.command == MavCmd.DO_CHANGE_SPEED else speed
        # ArduPilot's item 0 is home, and is not flown
        meant = (Waypoint(item=0),) if seq == 0 and firmware.needs_guided else _waypoint(seq, order, here, firmware)
        if meant is None:
            return None
        plan += (replace(one, speed=speed) for one in meant)
        here = next((one.place for one in reversed(meant) if one.place is not None), here)
    return tuple(plan)


def _waypoint(
    seq: int, order: Order, here: tuple[float, float, float], firmware: Firmware
) -> tuple[Waypoint, ...] | None:
    """What a mission item means after a place; None for one that cannot be flown."""
    if order.command in _GOES:
        place = _place(order, firmware, here)
        waits = order.param[0] or 0.0 if order.command != MavCmd.NAV_TAKEOFF else 0.0
        yaw = None if order.param[3] is None or order.command == MavCmd.NAV_TAKEOFF else math.radians(order.param[3])
        return None if place is None else (Waypoint(place, yaw, wait_s=waits, item=seq),)
    if order.command == MavCmd.NAV_DELAY:
        return (Waypoint(wait_s=max(order.param[0] or 0.0, 0.0), item=seq),)
    if order.command == MavCmd.NAV_LAND:
        place = _place(order, firmware, here)
        above = () if place is None else (Waypoint((place[0], place[1], here[2]), item=seq),)
        return (*above, Waypoint(lands=True, item=seq))
    if order.command == MavCmd.NAV_RETURN_TO_LAUNCH:
        return (Waypoint((0.0, 0.0, here[2]), item=seq), Waypoint(lands=True, item=seq))
    return (Waypoint(item=seq),) if order.command > MavCmd.NAV_DELAY else None  # conditions and actions are passed over


def follow_set_point(pilot: Pilot, frame: Frame, yaw_now: float) -> None:
    """Obey SET_POSITION_TARGET_LOCAL_NED or _GLOBAL_INT: its position, else its velocity."""
    mask, kind = int(number(frame, "type_mask")), int(number(frame, "coordinate_frame"))
    yaw = None if mask & NO_YAW else number(frame, "yaw")
    turn = yaw_now if kind in (BODY_NED, BODY_OFFSET_NED) else 0.0
    if not mask & NO_POSITION:
        place = _set_place(pilot, frame, kind, turn)
        if place is not None:
            pilot.set_point(place, yaw)
    elif not mask & NO_VELOCITY:
        v_x, v_y, v_z = (number(frame, name) for name in ("vx", "vy", "vz"))
        pilot.set_velocity((*_turned(v_x, v_y, turn), v_z), yaw)


def _set_place(pilot: Pilot, frame: Frame, kind: int, turn: float) -> tuple[float, float, float] | None:
    here = pilot.position
    if frame.msgid == MessageId.SET_POSITION_TARGET_GLOBAL_INT:
        north, east = to_local(number(frame, "lat_int") * _DEGREES, number(frame, "lon_int") * _DEGREES)
        return north, east, -(number(frame, "alt") - HOME_ALT_M * (kind in ABOVE_SEA))
    x, y, z = (number(frame, name) for name in ("x", "y", "z"))
    if kind == LOCAL_NED:
        return x, y, z
    if kind in (OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
        ahead, right = _turned(x, y, turn)
        return here[0] + ahead, here[1] + right, here[2] + z
    return None


def _turned(x: float, y: float, angle: float) -> tuple[float, float]:
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y
