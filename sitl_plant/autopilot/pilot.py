"""The pilot of a commanded flight: arm, take off, go, hold, land, return, fly a mission, disarm.

Sans-I/O: commands and samples in, a `Leg` for the plant out. Figures are our choice; ArduPilot's and PX4's say so.
"""

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mavdiag.link.messages import MavResult
from mavdiag.link.parameters import Parameters
from sitl_plant.autopilot.dialect import NOSE, SPEED_MOST, Dialect, Mode
from sitl_plant.physics import trajectory
from sitl_plant.physics.dynamics import wrapped
from sitl_plant.physics.trajectory import CLIMB_M_S, DISARMED, FLYING, IDLE, Leg
from sitl_plant.plant import STEP_NS, PlantSamples

ACCEPT_M, SETTLE_S, LATE_S = 0.3, 0.5, 10.0  # a waypoint is reached: so near, so long after the line ends; or so late
REACH_M, LOWEST_M = 500.0, 0.3  # from home to a waypoint, and above the ground
TURN_RAD_S = 1.0
NOSE_FROM_M = 0.5  # the nose is turned along a line at least so long
VELOCITY_S = 3.0  # a velocity set-point is obeyed so long (ArduPilot: GUID_TIMEOUT)
LANDED_S = 2.0  # on the ground after a landing, before the motors disarm
IDLE_S = 10.0  # armed on the ground without a take-off (ArduPilot: DISARM_DELAY)

Place = tuple[float, float, float]


class Waypoint(NamedTuple):
    """Something to do in flight."""

    place: Place | None = None  # where to go, world NED [m]; None stays
    yaw: float | None = None  # of the nose; None leaves it to `NOSE`
    speed: float | None = None  # on the way [m/s]; None for the parameter's
    wait_s: float = 0.0  # at its end
    lands: bool = False  # goes down there until the motors stop
    item: int | None = None  # of the mission, to report it; None for another order

    @property
    def passes(self) -> bool:
        """Whether it is an item of a mission in which nothing is flown."""
        return self.item is not None and self.place is None and not self.wait_s and not self.lands


def far(place: Place) -> bool:
    """Whether a place, world NED [m], is farther from home or lower than the vehicle flies."""
    return max(abs(place[0]), abs(place[1]), -place[2]) > REACH_M or place[2] > -LOWEST_M


class Pilot:
    """Flies one vehicle. commanded: it stands on the ground and waits; else it follows its own path and takes no order.

    custom_mode: as HEARTBEAT says it. first: the mission's item that is flown, or with which it begins. position: where
    the vehicle is, world NED [m].
    """

    def __init__(self, dialect: Dialect, parameters: Parameters, commanded: bool) -> None:
        self._dialect, self._parameters, self._commanded = dialect, parameters, commanded
        self.custom_mode = dialect.shown(Mode.HOLD) if commanded else dialect.custom_mode
        self.position: Place = (0.0, 0.0, 0.0)
        self._now_s, self._flies, self.armed = 0.0, not commanded, not commanded
        self._leg, self._turned = Leg(), False
        self._plan: deque[Waypoint] = deque()
        self._paused: tuple[Waypoint, ...] | None = None  # what is left of a plan that was paused
        self._doing: Waypoint | None = None
        self._ends_s, self._idle_since_s = math.inf, 0.0  # when the present line is over
        self._mission: tuple[Waypoint, ...] = ()
        self.first = 0
        self._texts: list[str] = []
        self._reached: list[int] = []

    def take_news(self) -> tuple[list[str], list[int]]:
        """What the pilot has to say since the last call, and which items of the mission were reached."""
        news, self._texts, self._reached = (self._texts, self._reached), [], []
        return news

    def plan_mission(self, waypoints: Iterable[Waypoint]) -> None:
        """Set what the mission is; it is flown once the mode says so and the vehicle is armed."""
        self._mission, self.first = tuple(waypoints), 0

    def skip_to(self, item: int) -> None:
        """Go on with another item of the mission, or begin with it."""
        self.first = item
        if self._mode is Mode.MISSION and self.armed:
            self._fly_mission()

    def arm(self, on: bool, force: bool = False) -> MavResult:
        """Start or stop the motors on the ground; in flight stop them only by force."""
        if on == self.armed:
            return MavResult.ACCEPTED
        if not self._commanded:
            return self._refuse("it follows its own path")
        if not on and self._flies and not force:
            return self._refuse("disarming is denied in flight")
        self.armed, self._paused = on, None
        self._plan.clear()
        self._doing, self._idle_since_s, self._ends_s = None, self._now_s, math.inf
        north, east, down = self.position
        self._lead((north, east, down if self._flies else 0.0), motors=IDLE if on else DISARMED)
        self._texts.append("Armed" if on else "Disarmed")
        if on and self._mode is Mode.MISSION:
            self._fly_mission()
        return MavResult.ACCEPTED

    def take_off(self, height_m: float | None) -> MavResult:
        """Climb. height_m: above home; None for the parameter's."""
        wrong_mode = self._dialect.needs_guided and self._mode is not Mode.GUIDED
        if not self._commanded or not self.armed or self._flies or wrong_mode:
            return self._refuse("a take-off needs an armed vehicle on the ground" + " in GUIDED" * wrong_mode)
        height = self._unit(self._dialect.height) if height_m is None else height_m
        place = (self.position[0], self.position[1], -height)
        if far(place):
            return MavResult.DENIED
        self.custom_mode = self._dialect.shown(self._dialect.takeoff)
        self._start([Waypoint(place)])
        return MavResult.ACCEPTED

    def go(self, place: Place, yaw: float | None = None, speed: float | None = None) -> MavResult:
        """Fly to a place and hold there."""
        if not self._in_flight():
            return self._refuse("it is not in flight")
        if far(place):
            return MavResult.DENIED
        self.custom_mode = self._dialect.shown(self._dialect.reposition)
        self._start([Waypoint(place, yaw, speed)])
        return MavResult.ACCEPTED

    def set_point(self, place: Place, yaw: float | None, speed: float | None = None) -> None:
        """Follow a position set-point, which is obeyed in guided flight only and not answered."""
        if self._in_flight() and self._mode is Mode.GUIDED and not far(place):
            same = self._doing is not None and self._doing.place is not None and self._doing.yaw == yaw
            if not (same and math.dist(self._leg.end, place) < 0.01):
                self._start([Waypoint(place, yaw, speed)])

    def set_velocity(self, velocity: Place, yaw: float | None) -> None:
        """Follow a velocity set-point [m/s]; it is obeyed for 3 s."""
        here, _ = self._led()
        north, east, down = (at + VELOCITY_S * rate for at, rate in zip(here, velocity, strict=True))
        self.set_point((north, east, min(down, -LOWEST_M)), yaw, math.hypot(*velocity))

    def set_mode(self, custom_mode: int) -> MavResult:
        """Change the flight mode, and do what it means."""
        code = self._dialect.code(custom_mode)
        if custom_mode == self.custom_mode:
            return MavResult.ACCEPTED
        if code is None:
            return MavResult.DENIED
        if not self._commanded or (code.mode is Mode.MISSION and not self._mission):
            return self._refuse("there is no mission" if self._commanded else "it follows its own path")
        if code.mode is Mode.TAKEOFF:
            return self.take_off(None)
        self.custom_mode = custom_mode
        if self.armed and code.mode is Mode.MISSION:
            self._fly_mission()
        elif self._flies:
            self._start(self._way_of(code.mode))
        return MavResult.ACCEPTED

    def do(self, mode: Mode) -> MavResult:
        """As `set_mode`, for what the mode is to do."""
        return self.set_mode(self._dialect.shown(mode))

    def pause(self, on: bool) -> MavResult:
        """Stop on the way, or go on; the mode stays (ArduPilot's AUTO and GUIDED)."""
        if not self._in_flight() or self._mode not in (Mode.MISSION, Mode.GUIDED):
            return self._refuse("there is nothing to pause")
        if on and self._paused is None:
            self._paused = (*((self._doing,) if self._doing else ()), *self._plan)
            self._plan.clear()
            self._doing = None
            self._lead(self.position)
        elif not on and self._paused is not None:
            self._start(self._paused)
        return MavResult.ACCEPTED

    def set_speed(self, speed: float) -> MavResult:
        """Change the speed of lines to come [m/s]."""
        taken = self._parameters.change(self._dialect.speed, speed / self._dialect.unit)
        return MavResult.ACCEPTED if taken else MavResult.DENIED

    def step(self, samples: PlantSamples) -> Leg | None:
        """See what happened in a block (n >= 1); what to be led along from now on, None to go on as before."""
        self._now_s = (int(samples.t_ns[-1]) + STEP_NS) * 1e-9
        north, east, down = samples.position[-1].tolist()
        self.position, self._flies = (north, east, down), bool(samples.motors[-1] == FLYING)
        if not self._commanded:
            return None
        if self._flies:
            self._idle_since_s = self._now_s
        doing, idle_s, late_s = self._doing, self._now_s - self._idle_since_s, self._now_s - self._ends_s
        if doing is None or doing.lands:
            if self.armed and idle_s > (IDLE_S if doing is None else LANDED_S):
                if doing is not None:
                    self._finish(doing)
                self.arm(False)
        elif late_s > LATE_S or (late_s > SETTLE_S and math.dist(self.position, self._leg.end) < ACCEPT_M):
            self._finish(doing)
            self._next()
        turned, self._turned = self._turned, False
        return self._leg if turned else None

    @property
    def _mode(self) -> Mode | None:
        code = self._dialect.code(self.custom_mode)
        return code.mode if code else None

    def _in_flight(self) -> bool:
        return self._commanded and self.armed and self._flies

    def _refuse(self, why: str) -> MavResult:
        self._texts.append(f"Refused: {why}")
        return self._dialect.refused

    def _unit(self, name: str) -> float:
        return self._parameters.value(name) * self._dialect.unit

    def _way_of(self, mode: Mode) -> list[Waypoint]:
        if mode is Mode.LAND:
            return [Waypoint(lands=True)]
        if mode is Mode.RTL:
            (north, east, down), _ = self._led()
            down = min(down, -self._unit(self._dialect.return_height))
            return [Waypoint((north, east, down)), Waypoint((0.0, 0.0, down)), Waypoint(lands=True)]
        return [Waypoint()]

    def _fly_mission(self) -> None:
        self._start(waypoint for waypoint in self._mission if (waypoint.item or 0) >= self.first)

    def _start(self, plan: Iterable[Waypoint]) -> None:
        self._plan, self._paused = deque(plan), None
        place = next((waypoint.place for waypoint in self._plan if waypoint.place is not None), None)
        if not self._flies and place is not None:  # straight up to its height
            self._plan.appendleft(Waypoint((self.position[0], self.position[1], place[2])))
        self._next()

    def _finish(self, done: Waypoint) -> None:
        self._doing = None
        if done.item is not None and not (self._plan and self._plan[0].item == done.item):
            self._reached.append(done.item)

    def _next(self) -> None:
        while self._plan and self._plan[0].passes:
            self._finish(self._plan.popleft())
        if not self._plan:
            if self._mode in (Mode.TAKEOFF, Mode.MISSION):
                self.custom_mode = self._dialect.shown(Mode.HOLD)
            self._doing = None
            return
        doing = self._doing = self._plan.popleft()
        self.first = doing.item if doing.item is not None else self.first
        here, _ = self._led()
        if doing.lands:
            self._lead((here[0], here[1], trajectory.BELOW_M), trajectory.DESCENT_M_S, then=trajectory.LANDING)
        else:
            self._lead(doing.place or here, doing.speed or self._unit(self._dialect.speed), doing.yaw)
        turn_s = abs(self._leg.turn) / self._leg.turn_speed
        self._ends_s = self._now_s + max(math.dist(here, self._leg.end) / self._leg.speed, turn_s) + doing.wait_s

    def _led(self) -> tuple[Place, float]:
        out = np.zeros(trajectory.REFERENCE)
        trajectory.follow(self._leg, self._now_s, out)
        north, east, down, *_, yaw, _, _ = out.tolist()
        return (north, east, down), yaw

    def _lead(
        self, end: Place, speed: float = CLIMB_M_S, yaw: float | None = None, motors: float = FLYING, then: float = -1.0
    ) -> None:
        start, heading = self._led()
        ahead, up = math.hypot(end[0] - start[0], end[1] - start[1]), abs(end[2] - start[2])
        if yaw is None and motors == FLYING and ahead > NOSE_FROM_M and self._parameters.value(NOSE):
            yaw = math.atan2(end[1] - start[1], end[0] - start[0])
        turn = 0.0 if yaw is None else float(wrapped(yaw - heading))
        if up:  # neither climbs nor descends faster than take-off
            speed = min(speed, CLIMB_M_S * math.hypot(ahead, up) / up)
        speed = min(max(speed, 0.01), SPEED_MOST)
        start, then = start if motors == FLYING else end, motors if then < 0.0 else then
        self._leg = Leg(self._now_s, start, end, speed, heading, turn, TURN_RAD_S, float(motors), float(then))
        self._turned = True
