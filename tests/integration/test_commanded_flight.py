"""The plant flies what its autopilot is commanded: arm, take off, go, hold, return, land, missions, failures."""

import math

import numpy as np
import pytest

from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.layout import Argument
from mavdiag.link.messages import MavCmd, MavResult, MessageId
from sitl_plant.autopilot.commands import Autopilot
from sitl_plant.autopilot.dialect import Mode, dialect_named
from sitl_plant.autopilot.stream import to_global
from sitl_plant.autopilot.wire import Action, Reply
from sitl_plant.emulator import obey
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import Plant, PlantConfig, PlantSamples

PLANT = (1, 1)
BLOCK_STEPS = 20


class Vehicle:
    """The emulator without its links: one ground station, 255/190, talks to it on link 0."""

    def __init__(self, profile: str = "px4", seed: int = 3) -> None:
        config = PlantConfig(trajectory="commanded", start="ground", seed=seed)
        self._dialect = dialect_named(profile)
        self.plant = Plant(config)
        self.autopilot = Autopilot([self._dialect.schedule(None)], self._dialect, config)
        self.said: list[Reply] = []
        self.flown: list[PlantSamples] = []
        self._encoder = Encoder(255, 190)
        self.fly(0.1)

    @property
    def now(self) -> PlantSamples:
        """The latest samples."""
        return self.flown[-1]

    @property
    def place(self) -> tuple[float, float, float]:
        """Where it is, world NED."""
        north, east, down = self.now.position[-1].tolist()
        return north, east, down

    @property
    def armed(self) -> bool:
        """Whether the motors are on."""
        return bool(self.now.motors[-1])

    def code(self, mode: Mode) -> int:
        """The custom_mode of a mode."""
        return self._dialect.shown(mode)

    def send(self, msgid: int, *fields: Argument) -> list[Reply]:
        """Give it a message; its answers."""
        frame = Decoder().feed(self._encoder.encode(msgid, *fields), 0)[0]
        return self._note(self.autopilot.step(0, frame, self.plant.t_ns))

    def order(self, command: int, *parameters: float) -> int:
        """The result of a COMMAND_LONG."""
        [ack, *_] = self.send(MessageId.COMMAND_LONG, *PLANT, command, 0, *parameters)
        assert ack.msgid == MessageId.COMMAND_ACK
        result = ack.fields[1]
        assert isinstance(result, int)
        return result

    def fly(self, seconds: float) -> PlantSamples:
        """Fly on; the last block."""
        for _ in range(round(seconds * 1000 / BLOCK_STEPS)):
            samples = self.plant.advance(BLOCK_STEPS)
            self.flown.append(samples)
            actions, orders = self.autopilot.watch(samples)
            self._note(actions)
            for order in orders:
                obey(self.plant, order)
        return self.now

    def _note(self, actions: list[Action]) -> list[Reply]:
        replies = [action for action in actions if isinstance(action, Reply)]
        self.said += replies
        return replies


NAN = float("nan")


def degrees(north: float, east: float) -> tuple[int, int]:
    """Latitude and longitude in 1e-7 degrees."""
    latitude, longitude, _ = to_global(np.array([[north, east, 0.0]]))[0].tolist()
    return round(latitude * 1e7), round(longitude * 1e7)


def in_flight(profile: str = "px4") -> Vehicle:
    """A vehicle at 1.5 m."""
    vehicle = Vehicle(profile)
    if profile == "ardupilot":
        assert vehicle.send(MessageId.SET_MODE, 1, 1, 4)[0].fields[:2] == (11, MavResult.ACCEPTED)
    assert vehicle.order(MavCmd.COMPONENT_ARM_DISARM, 1) == MavResult.ACCEPTED
    height = NAN if profile == "px4" else 1.5
    assert vehicle.order(MavCmd.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, height) == MavResult.ACCEPTED
    vehicle.fly(5.0)
    assert vehicle.place == pytest.approx((0, 0, -1.5), abs=0.15)
    return vehicle


@pytest.mark.parametrize("profile", ["px4", "ardupilot", "qdrone2"])
def test_a_flight_by_command_from_the_ground_to_the_ground(profile: str) -> None:
    vehicle = in_flight(profile)
    refused = {"px4": MavResult.TEMPORARILY_REJECTED, "ardupilot": MavResult.FAILED, "qdrone2": MavResult.DENIED}
    assert vehicle.order(MavCmd.COMPONENT_ARM_DISARM, 0) == refused[profile]  # not in flight
    there = degrees(2.0, -1.0)
    goto = (*PLANT, 6, MavCmd.DO_REPOSITION, 0, 0, -1.0, 0.0, 0.0, NAN, *there, 2.0)
    assert vehicle.send(MessageId.COMMAND_INT, *goto)[0].fields[1] == MavResult.ACCEPTED
    vehicle.fly(5.0)
    assert vehicle.place == pytest.approx((2.0, -1.0, -2.0), abs=0.15)
    assert vehicle.now.attitude[-1, 2] == pytest.approx(math.atan2(-1.0, 2.0), abs=0.1)  # the nose went along
    assert vehicle.order(MavCmd.NAV_RETURN_TO_LAUNCH) == MavResult.ACCEPTED
    assert vehicle.autopilot.dialect.custom_mode == vehicle.code(Mode.RTL)
    vehicle.fly(16.0)
    assert vehicle.place == pytest.approx((0.0, 0.0, 0.0), abs=0.15)
    assert not vehicle.armed
    assert vehicle.autopilot.dialect.custom_mode != vehicle.code(Mode.GUIDED)
    texts = [reply.fields[1] for reply in vehicle.said if reply.msgid == MessageId.STATUSTEXT]
    assert texts == ["Armed", "Refused: disarming is denied in flight", "Disarmed"]


def test_copter_takes_off_in_guided_only() -> None:
    vehicle = Vehicle("ardupilot")
    assert vehicle.order(MavCmd.DO_SET_MODE, 1, 5) == MavResult.ACCEPTED
    assert vehicle.order(MavCmd.COMPONENT_ARM_DISARM, 1) == MavResult.ACCEPTED
    assert vehicle.order(MavCmd.NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == MavResult.FAILED
    assert vehicle.order(MavCmd.DO_SET_MODE, 1, 4) == MavResult.ACCEPTED
    assert vehicle.order(MavCmd.NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == MavResult.ACCEPTED
    assert vehicle.order(MavCmd.DO_SET_MODE, 1, 99) == MavResult.DENIED


def test_set_points_are_followed_in_guided_flight_only() -> None:
    vehicle = in_flight()
    position = (0, *PLANT, 1, 0b110111111000, 1.0, 1.0, -2.0)
    vehicle.send(MessageId.SET_POSITION_TARGET_LOCAL_NED, *position)
    vehicle.fly(3.0)
    assert vehicle.place == pytest.approx((0.0, 0.0, -1.5), abs=0.15)
    assert vehicle.order(MavCmd.DO_SET_MODE, 1, 6) == MavResult.ACCEPTED  # offboard
    for _ in range(30):
        vehicle.send(MessageId.SET_POSITION_TARGET_LOCAL_NED, *position)
        vehicle.fly(0.1)
    assert vehicle.place == pytest.approx((1.0, 1.0, -2.0), abs=0.2)
    velocity = (0, *PLANT, 1, 0b110111000111, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0)
    for _ in range(20):
        vehicle.send(MessageId.SET_POSITION_TARGET_LOCAL_NED, *velocity)
        vehicle.fly(0.1)
    assert vehicle.now.velocity[-1] == pytest.approx((0.5, 0.0, 0.0), abs=0.2)
    vehicle.fly(5.0)  # forgotten, it stops
    assert vehicle.now.velocity[-1] == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_mission_is_flown_item_by_item(profile: str) -> None:
    vehicle = Vehicle(profile)
    plan = [(22, 0.0, 0.0, 1.5), (16, 2.0, 0.0, 1.5), (16, 2.0, 1.0, 2.0), (21, 2.0, 1.0, 0.0)]
    if profile == "ardupilot":
        plan.insert(0, (16, 0.0, 0.0, 0.0))  # its item 0 is home
    vehicle.send(MessageId.MISSION_COUNT, *PLANT, len(plan), 0)
    for seq, (number, north, east, height) in enumerate(plan):
        item = (*PLANT, seq, 6, number, 0, 1, 0.0, 0.0, 0.0, NAN, *degrees(north, east), height, 0)
        answer = vehicle.send(MessageId.MISSION_ITEM_INT, *item)
    assert [(reply.msgid, reply.fields[2]) for reply in answer] == [(MessageId.MISSION_ACK, 0)]
    assert vehicle.order(MavCmd.COMPONENT_ARM_DISARM, 1) == MavResult.ACCEPTED
    assert vehicle.order(MavCmd.MISSION_START) == MavResult.ACCEPTED
    vehicle.fly(25.0)
    assert vehicle.place == pytest.approx((2.0, 1.0, 0.0), abs=0.15)
    assert not vehicle.armed
    reached = [reply.fields[0] for reply in vehicle.said if reply.msgid == MessageId.MISSION_ITEM_REACHED]
    assert reached == list(range(len(plan)))
    highest = min(samples.position[:, 2].min() for samples in vehicle.flown)
    assert highest == pytest.approx(-2.0, abs=0.15)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_mission_is_paused_and_goes_on_where_the_autopilot_can(profile: str) -> None:
    vehicle = Vehicle(profile)
    plan = [(22, 0.0, 0.0, 1.5), (16, 3.0, 0.0, 1.5), (16, 3.0, 1.0, 1.5)]
    if profile == "ardupilot":
        plan.insert(0, (16, 0.0, 0.0, 0.0))
    vehicle.send(MessageId.MISSION_COUNT, *PLANT, len(plan), 0)
    for seq, (number, north, east, height) in enumerate(plan):
        flat = (0.0, 0.0, 0.0, NAN, *degrees(north, east), height, 0)
        vehicle.send(MessageId.MISSION_ITEM_INT, *PLANT, seq, 6, number, 0, 1, *flat)
    assert vehicle.order(MavCmd.DO_PAUSE_CONTINUE, 0) != MavResult.ACCEPTED  # on the ground
    assert vehicle.order(MavCmd.COMPONENT_ARM_DISARM, 1) == MavResult.ACCEPTED
    assert vehicle.order(MavCmd.MISSION_START) == MavResult.ACCEPTED
    vehicle.fly(6.5)
    assert 0.5 < vehicle.place[0] < 2.5
    if profile == "px4":
        assert vehicle.order(MavCmd.DO_PAUSE_CONTINUE, 0) == MavResult.UNSUPPORTED
        return
    assert vehicle.order(MavCmd.DO_PAUSE_CONTINUE, 7) == MavResult.DENIED
    assert vehicle.order(MavCmd.DO_PAUSE_CONTINUE, 0) == MavResult.ACCEPTED
    paused = vehicle.place
    vehicle.fly(8.0)
    assert vehicle.place == pytest.approx(paused, abs=0.3)
    assert vehicle.autopilot.dialect.custom_mode == vehicle.code(Mode.MISSION)
    assert vehicle.order(MavCmd.DO_PAUSE_CONTINUE, 1) == MavResult.ACCEPTED
    vehicle.fly(8.0)
    assert vehicle.place == pytest.approx((3.0, 1.0, -1.5), abs=0.2)


def test_a_failure_names_a_motor_or_a_fault_of_the_thesis() -> None:
    vehicle = in_flight()
    inject = (MavCmd.INJECT_FAILURE, 101)
    assert vehicle.order(*inject, 5, 2) == MavResult.ACCEPTED
    vehicle.fly(0.1)
    for name, value in (("SIM_PROP_FAULT", 2.0), ("SIM_PROP_SEV", 3.0)):
        integer = np.array([round(value)], dtype="<i4").view("<f4")[0]
        vehicle.send(MessageId.PARAM_SET, *PLANT, name, float(integer), 6)
    assert vehicle.order(*inject, 1, 3) == MavResult.ACCEPTED
    vehicle.fly(0.1)
    assert vehicle.order(*inject, 0, 2) == MavResult.ACCEPTED
    vehicle.fly(0.1)
    changes = [change.what for change in vehicle.plant.take_changes()]
    named = [(what.name, what.rotor) if isinstance(what, Injection) else str(what) for what in changes]
    slow, broken = ("motor slow", 2), ("F2/SV3", 3)
    assert named == ["clear", slow, "clear", slow, broken, "clear", broken]
    assert vehicle.order(*inject, 0, 0) == MavResult.ACCEPTED
    vehicle.fly(0.1)
    assert [str(change.what) for change in vehicle.plant.take_changes()] == ["clear"]
