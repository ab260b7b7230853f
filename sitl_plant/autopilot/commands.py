"""What the emulated autopilot does with the frames it receives: answer and obey what is meant for it, pass on the rest.

Sans-I/O. Routing follows ArduPilot's rules (developer documentation, "MAVLink Routing in ArduPilot"): a broadcast goes
to every other link that is in use; a message with an address goes to the link over which that component sends; nothing
goes back where it came from, and nothing that claims to come from the autopilot itself is believed.

MAV_CMD_INJECT_FAILURE damages motors. While the parameter `SIM_PROP_FAULT` is 1 to 3, every failure but OK is a damaged
propeller of the thesis: F1 to F3, with the severity `SIM_PROP_SEV`. At 0, OFF stops the motor and SLOW slows it down.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeAlias

from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId, Severity
from mavdiag.link.parameters import Encoding, Parameters
from sitl_plant.autopilot.dialect import FAULT, SEVERITY, Dialect, Mode
from sitl_plant.autopilot.mission import HANDLED, Mission
from sitl_plant.autopilot.pilot import Pilot, Place, Waypoint, far
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.autopilot.stream import HOME_ALT_M, to_local
from sitl_plant.autopilot.wire import DEGREES, Action, Forward, Order, Reply, integer, number, optional, order_of
from sitl_plant.physics.faults import Injection, RotorDamage, fault_injection
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

ROUTES_MAX = 64  # components remembered; further ones are answered but nothing is routed to them
ALL_STREAMS = 0  # MAV_DATA_STREAM_ALL
VERSION = 4 << 24 | 255  # AUTOPILOT_VERSION.flight_sw_version: 4.0.0, FIRMWARE_VERSION_TYPE_OFFICIAL
PROTOCOL = 200  # PROTOCOL_VERSION: MAVLink 2.0
UID = 0x51D205E  # of the emulated boards; the system id follows
STATUS_NS = 1_000_000_000  # MISSION_CURRENT goes out so often
ABOVE_SEA, ABOVE_HOME = (0, 5), (3, 6, 10, 11)  # MAV_FRAME: GLOBAL, GLOBAL_RELATIVE_ALT, terrain as relative; _INT
LOCAL_NED, OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9  # MAV_FRAME
FORCE = 21196  # COMPONENT_ARM_DISARM.param2: whatever the state is
NO_POSITION, NO_VELOCITY, NO_YAW = 0b111, 0b111_000, 1 << 10  # POSITION_TARGET_TYPEMASK
SYSTEM_MOTOR = 101  # FAILURE_UNIT
OK, OFF, SLOW = 0, 1, 5  # FAILURE_TYPE
GROUND_SPEED = (0, 1)  # SPEED_TYPE: airspeed is ground speed, as with both autopilots; climb and descent are fixed here
SLOW_SHARE = 0.9  # of the commanded speed (our choice)
MOTORS = {OFF: ("motor off", RotorDamage(speed_factor=0.0)), SLOW: ("motor slow", RotorDamage(speed_factor=SLOW_SHARE))}
# MAV_PROTOCOL_CAPABILITY: MAVLINK2, PARAM_FLOAT, MISSION_INT, COMMAND_INT; SET_POSITION_TARGET_LOCAL_NED, _GLOBAL_INT,
# FLIGHT_TERMINATION; PARAM_ENCODE_BYTEWISE, PARAM_ENCODE_C_CAST
ALWAYS, IN_COMMAND, BYTEWISE, C_CAST = 1 << 13 | 1 << 1 | 1 << 2 | 1 << 3, 1 << 7 | 1 << 8 | 1 << 11, 1 << 4, 1 << 17

_Answer: TypeAlias = tuple[MavResult, list[Action]]


class Autopilot:
    """The receiving half of the emulated autopilot, for all its links. schedules: one for each link."""

    def __init__(self, schedules: Sequence[Schedule], dialect: Dialect, config: PlantConfig) -> None:
        self._identity = (dialect.sysid, int(Component.AUTOPILOT1))
        self._schedules, self._dialect, self._config = schedules, dialect, config
        vehicle = config.flown_vehicle
        self._rotors, self._failures = len(vehicle.rotors), dict[int, Injection]()
        self._parameters = Parameters(dialect.parameters_of(vehicle), dialect.encoding)
        self._pilot = Pilot(dialect, self._parameters, config.commanded)
        self._mission = Mission(self._plan, self._pilot.skip_to)
        self._orders = list[Callable[[Plant], None]]()
        self._routes: dict[tuple[int, int], int] = {}
        self._told_ns, self._yaw = 0, 0.0

    @property
    def dialect(self) -> Dialect:
        """What is sent at present: the dialect with the flight mode of now."""
        if self._dialect.custom_mode != self._pilot.custom_mode:
            self._dialect = replace(self._dialect, custom_mode=self._pilot.custom_mode)
        return self._dialect

    def step(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """Answer and route one frame that came in on `link` at vehicle time `now_ns`."""
        source = (frame.sysid, frame.compid)
        if source == self._identity:
            return []
        if source in self._routes or len(self._routes) < ROUTES_MAX:
            self._routes[source] = link
        system, component = integer(frame, "target_system"), integer(frame, "target_component")  # 0: everyone
        actions: list[Action] = []
        if (system, component) != self._identity:
            ways = ((to, s, c) for (s, c), to in self._routes.items() if to != link)
            meant = {to for to, s, c in ways if system in (0, s) and component in (Component.ALL, c)}
            actions += [Forward(to, frame) for to in sorted(meant)]
        if system in (0, self._identity[0]) and component in (Component.ALL, self._identity[1]):
            actions += self._handle(link, frame, now_ns)
        return actions

    def watch(self, samples: PlantSamples) -> tuple[list[Action], list[Callable[[Plant], None]]]:
        """See what the vehicle did in a block (n >= 1): what is to be said, and what the plant is to do from now on."""
        now_ns, self._yaw = int(samples.t_ns[-1]), float(samples.attitude[-1, 2])
        orders, self._orders = self._orders, []
        if (leg := self._pilot.step(samples)) is not None:
            orders.append(partial(Plant.lead, leg=leg))
        actions = self._mission.tick(now_ns)
        texts, reached = self._pilot.take_news()
        tells = now_ns - self._told_ns >= STATUS_NS and len(self._mission) > 0
        for link in sorted(set(self._routes.values())):
            actions += [Reply(link, MessageId.STATUSTEXT, (Severity.INFO, text)) for text in texts]
            actions += [Reply(link, MessageId.MISSION_ITEM_REACHED, (item,)) for item in reached]
            actions += [self._mission.current(link, self._pilot.first)] if tells or reached else []
        self._told_ns = now_ns if tells else self._told_ns
        return actions, orders

    def _handle(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        match frame.msgid:
            case MessageId.COMMAND_LONG | MessageId.COMMAND_INT:
                order = order_of(frame)
                result, replies = self._command(link, order)
                return [_ack(link, frame, order.command, result), *replies]
            case MessageId.SET_MODE:  # acknowledged as ArduPilot does: the message has no command
                return [_ack(link, frame, frame.msgid, self._pilot.set_mode(integer(frame, "custom_mode")))]
            case MessageId.SET_POSITION_TARGET_LOCAL_NED | MessageId.SET_POSITION_TARGET_GLOBAL_INT:
                follow_set_point(self._pilot, frame, self._yaw)
            case MessageId.PARAM_REQUEST_LIST | MessageId.PARAM_REQUEST_READ | MessageId.PARAM_SET:
                if frame.msgid == MessageId.PARAM_SET:
                    self._parameters.change(*self._parameters.wanted(frame))
                return [Reply(link, MessageId.PARAM_VALUE, fields) for fields in self._parameters.told(frame)]
            case MessageId.TIMESYNC if not number(frame, "tc1"):  # a request gets its ts1 back, with our time
                return [Reply(link, MessageId.TIMESYNC, (now_ns, integer(frame, "ts1")))]
            case MessageId.PING if not optional(frame, "target_system"):
                brought = integer(frame, "time_usec"), integer(frame, "seq")
                return [Reply(link, MessageId.PING, (*brought, frame.sysid, frame.compid))]
            case MessageId.REQUEST_DATA_STREAM:
                names = ("req_stream_id", "req_message_rate", "start_stop")
                stream, rate_hz, start = (integer(frame, name) for name in names)
                streams = self._dialect.streams
                messages = sum(streams.values(), ()) if stream == ALL_STREAMS else streams.get(stream, ())
                if start in (0, 1):
                    self._schedules[link].set_stream(messages, rate_hz * start)
            case msgid if msgid in HANDLED:
                return self._mission.step(link, frame, now_ns)
        return []

    def _command(self, link: int, order: Order) -> _Answer:
        schedule = self._schedules[link]
        match order.command:
            case MavCmd.SET_MESSAGE_INTERVAL:
                return schedule.set_interval(order.whole(1), order.param[1] or 0.0), []
            case MavCmd.GET_MESSAGE_INTERVAL:
                return self._tell(link, MessageId.MESSAGE_INTERVAL, order.whole(1))
            case MavCmd.REQUEST_MESSAGE:
                return self._tell(link, order.whole(1), order.whole(2))
            case MavCmd.REQUEST_PROTOCOL_VERSION:
                return self._tell(link, MessageId.PROTOCOL_VERSION)
            case MavCmd.REQUEST_AUTOPILOT_CAPABILITIES:
                return self._tell(link, MessageId.AUTOPILOT_VERSION)
            case MavCmd.GET_HOME_POSITION:
                return self._tell(link, MessageId.HOME_POSITION)
            case MavCmd.INJECT_FAILURE:
                return self._inject(order), []
        obeyed = ORDERS.get(order.command)
        return (obeyed(self._pilot, self._dialect, order) if obeyed else MavResult.UNSUPPORTED), []

    def _tell(self, link: int, msgid: int, wanted: int = 0) -> _Answer:
        told: list[tuple[int | str | tuple[int, ...], ...]]
        match msgid:
            case MessageId.AUTOPILOT_VERSION:
                can = ALWAYS | (BYTEWISE if self._dialect.encoding is Encoding.BYTES else C_CAST)
                can |= IN_COMMAND if self._config.commanded else 0
                told = [(can, VERSION, VERSION, 0, 0, (0,) * 8, (0,) * 8, (0,) * 8, 0, 0, UID << 8 | self._identity[0])]
            case MessageId.PROTOCOL_VERSION:
                told = [(PROTOCOL, PROTOCOL, PROTOCOL)]
            case MessageId.MESSAGE_INTERVAL:  # 0 means that the message is not carried
                told = [(wanted, self._schedules[link].interval_us(wanted))]
            case MessageId.AVAILABLE_MODES:
                modes = list(enumerate(self._dialect.modes, start=1))
                told = [(len(modes), n, 0, code.custom_mode, 0, code.name) for n, code in modes if wanted in (0, n)]
            case MessageId.MISSION_CURRENT:
                return MavResult.ACCEPTED, [self._mission.current(link, self._pilot.first)]
            case _:
                return self._schedules[link].ask_once(msgid), []
        replies: list[Action] = [Reply(link, msgid, fields) for fields in told]
        return (MavResult.ACCEPTED if told else MavResult.DENIED), replies

    def _inject(self, order: Order) -> MavResult:
        """INJECT_FAILURE: unit, type, instance (0 is every motor; without one, those of the mask)."""
        kind, mask, every = order.whole(2), order.whole(4), set(range(1, self._rotors + 1))
        fault, severity = (round(self._parameters.value(name)) for name in (FAULT, SEVERITY))
        if order.param[2] is None:
            motors = {motor for motor in every if mask >> (motor - 1) & 1}
        else:
            motors = {order.whole(3)} if order.whole(3) else every
        if not self._parameters.value("SYS_FAILURE_EN", 1):
            return MavResult.DENIED
        if order.whole(1) != SYSTEM_MOTOR or (kind != OK and not fault and kind not in MOTORS):
            return MavResult.UNSUPPORTED
        if not motors or not motors <= every:
            return MavResult.DENIED
        for motor in sorted(motors):
            self._failures.pop(motor, None)
            if kind != OK and fault:
                scale = self._config.phenomenology
                self._failures[motor] = fault_injection(f"F{fault}/SV{severity}", motor, phenomenology=scale)
            elif kind != OK:
                name, damage = MOTORS[kind]
                self._failures[motor] = Injection(damage, motor, name=name)
        self._orders += [Plant.clear, *(partial(Plant.inject, injection=cause) for cause in self._failures.values())]
        return MavResult.ACCEPTED

    def _plan(self, frames: tuple[Frame, ...]) -> bool:
        plan = waypoints([order_of(frame) for frame in frames], self._dialect)
        if plan is not None:
            self._pilot.plan_mission(plan)
        return plan is not None


def _ack(link: int, frame: Frame, command: int, result: MavResult) -> Reply:
    return Reply(link, MessageId.COMMAND_ACK, (command, result, 0, 0, frame.sysid, frame.compid))


def _height(order: Order, amsl: bool) -> float | None:
    """Above home; None if it is not given. amsl: it is above the sea wherever no frame says otherwise."""
    above_sea = amsl if order.frame is None else order.frame in ABOVE_SEA
    return None if order.z is None else order.z - HOME_ALT_M * above_sea


def _place(order: Order, dialect: Dialect, here: Place) -> Place | None:
    """Where an order leads, world NED; the present place for what is not given. None for a frame not known here."""
    if order.frame is not None and order.frame not in ABOVE_SEA + ABOVE_HOME:
        return None
    there = here[:2] if not order.x or not order.y else to_local(order.x, order.y)
    height = _height(order, dialect.amsl or order.command == MavCmd.DO_REPOSITION)
    return there[0], there[1], here[2] if height is None else -height


def _reposition(pilot: Pilot, dialect: Dialect, order: Order) -> MavResult:
    place = _place(order, dialect, pilot.position)
    speed = order.param[0] if (order.param[0] or -1.0) > 0.0 else None
    return MavResult.DENIED if place is None else pilot.go(place, order.param[3], speed)


def _take_off(pilot: Pilot, dialect: Dialect, order: Order) -> MavResult:
    height = _height(order, dialect.amsl)
    return pilot.take_off(height if height is None or height > 0.0 else None)


def _set_mode(pilot: Pilot, dialect: Dialect, order: Order) -> MavResult:
    main, sub = order.whole(2), order.whole(3)
    packed = main << 16 | sub << 24
    return pilot.set_mode(packed if dialect.code(packed) or sub else main)


def _pause(pilot: Pilot, dialect: Dialect, order: Order) -> MavResult:
    if not dialect.needs_guided:  # PX4 does not implement it
        return MavResult.UNSUPPORTED
    return pilot.pause(order.whole(1) == 0) if order.whole(1) in (0, 1) else MavResult.DENIED


ORDERS: Mapping[int, Callable[[Pilot, Dialect, Order], MavResult]] = {
    MavCmd.COMPONENT_ARM_DISARM: lambda pilot, _, order: pilot.arm(order.whole(1) == 1, order.whole(2) == FORCE),
    MavCmd.NAV_TAKEOFF: _take_off,
    MavCmd.DO_REPOSITION: _reposition,
    MavCmd.NAV_LAND: lambda pilot, dialect, order: pilot.do(Mode.LAND),
    MavCmd.NAV_RETURN_TO_LAUNCH: lambda pilot, dialect, order: pilot.do(Mode.RTL),
    MavCmd.NAV_LOITER_UNLIM: lambda pilot, dialect, order: pilot.do(Mode.HOLD),
    MavCmd.MISSION_START: lambda pilot, dialect, order: pilot.do(Mode.MISSION),
    MavCmd.DO_SET_MODE: _set_mode,
    MavCmd.DO_PAUSE_CONTINUE: _pause,
    MavCmd.DO_CHANGE_SPEED: lambda pilot, _, order: (
        pilot.set_speed(order.param[1] or 0.0) if order.whole(1) in GROUND_SPEED else MavResult.DENIED
    ),
    MavCmd.DO_FLIGHTTERMINATION: lambda pilot, _, order: pilot.arm(False, True) if order.whole(1) else MavResult.DENIED,
    MavCmd.RUN_PREARM_CHECKS: lambda pilot, dialect, order: MavResult.ACCEPTED,
}
"""What the pilot does for each MAV_CMD."""

_GOES = (MavCmd.NAV_WAYPOINT, MavCmd.NAV_TAKEOFF, MavCmd.NAV_LOITER_TIME, MavCmd.NAV_LOITER_UNLIM)


def waypoints(orders: Sequence[Order], dialect: Dialect) -> tuple[Waypoint, ...] | None:
    """What the items of a mission mean; None if one of them cannot be flown."""
    plan: list[Waypoint] = []
    here, speed = (0.0, 0.0, -1.0), None
    for seq, order in enumerate(orders):
        if order.command == MavCmd.DO_CHANGE_SPEED and order.whole(1) in GROUND_SPEED:
            speed = max(order.param[1] or 0.0, 0.0) or None
        # ArduPilot's item 0 is home, and is not flown
        meant = (Waypoint(item=0),) if seq == 0 and dialect.needs_guided else _waypoint(seq, order, here, dialect)
        if meant is None or any(way.place is not None and far(way.place) for way in meant):
            return None
        plan += (waypoint._replace(speed=speed) for waypoint in meant)
        here = next((waypoint.place for waypoint in reversed(meant) if waypoint.place is not None), here)
    return tuple(plan)


def _waypoint(seq: int, order: Order, here: Place, dialect: Dialect) -> tuple[Waypoint, ...] | None:
    place, wait_s, down = _place(order, dialect, here), order.param[0] or 0.0, Waypoint(lands=True, item=seq)
    if order.command in _GOES:
        climbs = order.command == MavCmd.NAV_TAKEOFF
        yaw = None if order.param[3] is None or climbs else math.radians(order.param[3])
        return None if place is None else (Waypoint(place, yaw, wait_s=0.0 if climbs else wait_s, item=seq),)
    if order.command == MavCmd.NAV_DELAY:
        return (Waypoint(wait_s=max(wait_s, 0.0), item=seq),)
    if order.command == MavCmd.NAV_LAND:
        return (down,) if place is None else (Waypoint((place[0], place[1], here[2]), item=seq), down)
    if order.command == MavCmd.NAV_RETURN_TO_LAUNCH:
        return Waypoint((0.0, 0.0, here[2]), item=seq), down
    return (Waypoint(item=seq),) if order.command > MavCmd.NAV_DELAY else None  # conditions and actions are passed over


def follow_set_point(pilot: Pilot, frame: Frame, yaw_now: float) -> None:
    """Obey SET_POSITION_TARGET_LOCAL_NED or _GLOBAL_INT: its position, else its velocity."""
    mask, kind = integer(frame, "type_mask"), integer(frame, "coordinate_frame")
    turn = yaw_now if kind in (BODY_NED, BODY_OFFSET_NED) else 0.0
    yaw = None if mask & NO_YAW else turn + number(frame, "yaw")
    c, s = math.cos(turn), math.sin(turn)

    def turned(*names: str) -> Place:
        x, y, z = (number(frame, name) for name in names)
        return c * x - s * y, s * x + c * y, z

    world = frame.msgid == MessageId.SET_POSITION_TARGET_GLOBAL_INT
    if not world and kind not in (LOCAL_NED, OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
        return  # as ArduPilot does with other frames
    if mask & NO_POSITION:
        if not mask & NO_VELOCITY:
            pilot.set_velocity(turned("vx", "vy", "vz"), yaw)
    elif world:
        north, east = to_local(number(frame, "lat_int") * DEGREES, number(frame, "lon_int") * DEGREES)
        pilot.set_point((north, east, -(number(frame, "alt") - HOME_ALT_M * (kind in ABOVE_SEA))), yaw)
    else:
        here = (0.0, 0.0, 0.0) if kind == LOCAL_NED else pilot.position
        north, east, down = (at + way for at, way in zip(here, turned("x", "y", "z"), strict=True))
        pilot.set_point((north, east, down), yaw)
