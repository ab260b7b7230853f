"""The emulated autopilot: answers what is meant for it, forwards the rest as ArduPilot does, believes no impostor."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.link.codec import Argument, Decoder, Encoder, Frame
from mavdiag.link.messages import Autopilot as Maker
from mavdiag.link.messages import MavCmd, MavResult, MessageId
from mavdiag.link.parameters import Encoding, Kind, Parameter, Parameters, parameters_in
from sitl_plant.autopilot.commands import ORDERS, Autopilot, waypoints
from sitl_plant.autopilot.dialect import Mode, dialect_named
from sitl_plant.autopilot.mission import Mission
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.autopilot.stream import to_global
from sitl_plant.autopilot.wire import Action, Order, Reply
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import airframe_of, shipped_vehicles, vehicle_named

GCS, PLANT = (255, 190), (1, 1)
NOW_NS = 5_000_000_000
SECOND = 1_000_000_000
LAT, LON = 473_977_420, 85_455_940
FAST = 27
ROWS = (Parameter("FIXED", 20.0), Parameter("COUNT", 1, Kind.INT32, (0, 3)), Parameter("SPEED", 1.5, span=(0.5, 2.0)))
BLOCK_STEPS = 20
NAN = float("nan")


def autopilot(n_links: int = 3, profile: str = "qdrone2") -> Autopilot:
    schedules = [Schedule({MessageId.RAW_IMU: 1000.0, MessageId.HIGHRES_IMU: 0.0}, 1000.0) for _ in range(n_links)]
    return Autopilot(schedules, dialect_named(profile), PlantConfig())


def frame(source: tuple[int, int], msgid: int, *fields: Argument) -> Frame:
    return next(iter(Decoder().feed(Encoder(*source).encode(msgid, *fields))))


def command(source: tuple[int, int], target: tuple[int, int], number: int, *parameters: float) -> Frame:
    return frame(source, MessageId.COMMAND_LONG, *target, number, 0, *parameters)


def replies(actions: list[Action], msgid: int) -> list[tuple[Argument, ...]]:
    return [action.fields for action in actions if isinstance(action, Reply) and action.msgid == msgid]


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0)])
@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (MavCmd.SET_MESSAGE_INTERVAL, (27, 10_000), MavResult.ACCEPTED),
        (MavCmd.SET_MESSAGE_INTERVAL, (27, 100), MavResult.DENIED),
        (MavCmd.SET_MESSAGE_INTERVAL, (30_000, 10_000), MavResult.DENIED),
        (MavCmd.REQUEST_MESSAGE, (148,), MavResult.ACCEPTED),
        (MavCmd.REQUEST_MESSAGE, (30_000,), MavResult.DENIED),
        (MavCmd.REQUEST_AUTOPILOT_CAPABILITIES, (1,), MavResult.ACCEPTED),
        (MavCmd.REQUEST_PROTOCOL_VERSION, (1,), MavResult.ACCEPTED),
        (MavCmd.GET_MESSAGE_INTERVAL, (27,), MavResult.ACCEPTED),
        (MavCmd.COMPONENT_ARM_DISARM, (1,), MavResult.ACCEPTED),  # it is armed
        (MavCmd.COMPONENT_ARM_DISARM, (0,), MavResult.DENIED),  # it follows its own path
        (MavCmd.DO_CHANGE_SPEED, (1, 0.5), MavResult.ACCEPTED),
        (MavCmd.DO_CHANGE_SPEED, (2, 0.5), MavResult.DENIED),  # a climb speed
        (MavCmd.NAV_LAND, (), MavResult.DENIED),
        (MavCmd.INJECT_FAILURE, (101, 1, 1), MavResult.ACCEPTED),
        (MavCmd.INJECT_FAILURE, (101, 3, 1), MavResult.UNSUPPORTED),
        (MavCmd.INJECT_FAILURE, (101, 1, 5), MavResult.DENIED),  # it has four motors
        (MavCmd.INJECT_FAILURE, (0, 1, 1), MavResult.UNSUPPORTED),
        (40_000, (1,), MavResult.UNSUPPORTED),
    ],
)
def test_every_command_for_it_is_acknowledged(
    target: tuple[int, int], number: int, parameters: tuple[float, ...], result: MavResult
) -> None:
    actions = autopilot().step(1, command(GCS, target, number, *parameters), NOW_NS)
    [(told, verdict, _, _, *to)] = replies(actions, MessageId.COMMAND_ACK)
    assert (told, verdict, *to) == (number, result, *GCS)
    tells = number == MavCmd.REQUEST_AUTOPILOT_CAPABILITIES or parameters == (148,)
    assert bool(replies(actions, MessageId.AUTOPILOT_VERSION)) == tells


@given(
    source=st.tuples(st.integers(1, 255), st.integers(1, 255)),
    target=st.tuples(st.integers(0, 255), st.integers(0, 255)),
    number=st.sampled_from([*ORDERS, 410, 420, 510, 511, 512, 519, 520, 65_535]),
    parameters=st.lists(st.floats(width=32), min_size=7, max_size=7),
    link=st.integers(0, 2),
)
def test_no_command_raises_and_none_is_forwarded_to_its_own_link(
    source: tuple[int, int], target: tuple[int, int], number: int, parameters: list[float], link: int
) -> None:
    one = autopilot()
    for other in range(3):
        one.step(other, frame((250 - other, 190), MessageId.HEARTBEAT, 18, 8, 0, 0, 4, 3), NOW_NS)
    for action in one.step(link, command(source, target, number, *parameters), NOW_NS):
        assert isinstance(action, Reply) or action.link != link


@given(
    profile=st.sampled_from(["px4", "ardupilot", "qdrone2"]),
    messages=st.lists(
        st.tuples(
            st.sampled_from([4, 11, 20, 23, 39, 41, 44, 45, 51, 66, 73, 75, 76, 84, 86, 111]), st.binary(max_size=60)
        ),
        max_size=20,
    ),
)
def test_no_bytes_for_a_commanded_vehicle_raise(profile: str, messages: list[tuple[int, bytes]]) -> None:
    dialect = dialect_named(profile)
    config = PlantConfig(trajectory="commanded", start="ground")
    one, encoder = Autopilot([dialect.schedule(None)], dialect, config), Encoder(*GCS)
    for msgid, payload in messages:
        (heard,) = Decoder().feed(encoder.encode_payload(msgid, payload))
        for action in one.step(0, heard, NOW_NS):
            assert isinstance(action, Reply)
            encoder.encode(action.msgid, *action.fields)  # can be sent


# The mission protocol of the emulated autopilot, as a ground station speaks it
def sent(msgid: int, *fields: Argument, source: tuple[int, int] = GCS) -> Frame:
    return frame(source, msgid, *PLANT, *fields)


def item(seq: int, number: int = 16, z: float = 2.0) -> Frame:
    return sent(MessageId.MISSION_ITEM_INT, seq, 6, number, 0, 1, 0.0, 0.0, 0.0, 0.0, LAT + seq, LON, z, 0)


def said(actions: list[Action]) -> list[tuple[int, tuple[Argument, ...]]]:
    return [(action.msgid, action.fields) for action in actions if isinstance(action, Reply)]


def test_what_was_uploaded_is_downloaded() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    answer = said(one.step(0, sent(MessageId.MISSION_COUNT, 3, 0), 0))
    for seq in range(3):
        assert answer == [(MessageId.MISSION_REQUEST_INT, (*GCS, seq, 0))]
        answer = said(one.step(0, item(seq), 0))
    assert answer == [(MessageId.MISSION_ACK, (*GCS, 0, 0))]
    assert said(one.step(0, sent(MessageId.MISSION_REQUEST_LIST, 0), 0)) == [(MessageId.MISSION_COUNT, (*GCS, 3, 0))]
    for msgid in (MessageId.MISSION_REQUEST_INT, MessageId.MISSION_REQUEST):
        [(kind, fields)] = said(one.step(0, sent(msgid, 2, 0), 0))
        assert kind == MessageId.MISSION_ITEM_INT
        assert fields == (*GCS, 2, 6, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, LAT + 2, LON, 2.0, 0)
    assert said(one.step(0, sent(MessageId.MISSION_REQUEST_INT, 3, 0), 0)) == [(47, (*GCS, 13, 0))]
    assert said(one.step(0, sent(MessageId.MISSION_CLEAR_ALL, 255), 0)) == [(47, (*GCS, 0, 255))]  # of all types
    assert len(one) == 0


def test_a_lost_item_is_asked_for_again_and_an_upload_that_stops_is_given_up() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    one.step(0, sent(MessageId.MISSION_COUNT, 2, 0), 0)
    one.step(0, item(0), SECOND)
    assert said(one.step(0, item(0), SECOND)) == [(MessageId.MISSION_REQUEST_INT, (*GCS, 1, 0))]  # twice the same
    assert one.tick(SECOND + SECOND // 2) == []
    assert said(one.tick(2 * SECOND)) == [(MessageId.MISSION_REQUEST_INT, (*GCS, 1, 0))]
    assert said(one.tick(10 * SECOND)) == [(MessageId.MISSION_ACK, (*GCS, 15, 0))]
    assert (one.tick(20 * SECOND), len(one)) == ([], 0)


# The rhythm of messages: exact in the mean, never early, changed and denied as an autopilot does
def times(first: int, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.arange(first, first + n, dtype=np.int64) * 1_000_000


@given(rate_hz=st.floats(0.5, 1000.0), blocks=st.lists(st.integers(1, 400), min_size=1, max_size=12))
def test_any_rate_is_met_to_one_message_however_the_time_is_cut(rate_hz: float, blocks: list[int]) -> None:
    one = Schedule({FAST: rate_hz}, ceiling_hz=1000.0)
    rows, first = [], 0
    for n in blocks:
        due = dict(one.due(times(first, n)))
        rows += [first + int(row) for row in due.get(FAST, ())]
        first += n
    assert rows == dict(Schedule({FAST: rate_hz}, ceiling_hz=1000.0).due(times(0, first)))[FAST].tolist()
    assert abs(len(rows) - first * 1e-3 * rate_hz) <= 1.0


@pytest.mark.parametrize(("msgid", "interval_us"), [(FAST, 999 / 1.01), (FAST, 1), (999, 10_000)])
def test_what_cannot_be_sent_is_denied_and_changes_nothing(msgid: int, interval_us: float) -> None:
    one = Schedule({FAST: 1000.0, 0: 1.0, 105: 0.0}, ceiling_hz=1000.0)
    assert one.set_interval(msgid, interval_us) is MavResult.DENIED
    assert (one.interval_us(FAST), one.interval_us(999)) == (1000, 0)


@pytest.mark.parametrize(
    ("profile", "asked_us", "result", "attained_hz"),
    [
        ("qdrone2", 5_000, MavResult.ACCEPTED, 200.0),
        ("px4", 5_000, MavResult.ACCEPTED, 165.0),  # 160 to 170 were measured
        ("px4", 10_000, MavResult.ACCEPTED, 100.0),
        ("px4", 1e20, MavResult.ACCEPTED, 0.05),  # once in 20 s, at first
        ("ardupilot", 6_667, MavResult.ACCEPTED, 1000.0 / 6.0),  # whole milliseconds
        ("ardupilot", 3_000, MavResult.ACCEPTED, 1000.0 / 3.0),
        ("ardupilot", 2_900, MavResult.DENIED, 0.0),  # above 0.8 of its loop rate
    ],
)
def test_a_profile_grants_rates_as_its_autopilot_does(
    profile: str, asked_us: float, result: MavResult, attained_hz: float
) -> None:
    one = dialect_named(profile).schedule(None, fresh=profile != "qdrone2")
    assert one.set_interval(MessageId.ATTITUDE_TARGET, asked_us) == result
    seconds = 20
    rows = [rows for msgid, rows in one.due(times(0, 1000 * seconds)) if msgid == MessageId.ATTITUDE_TARGET]
    if result == MavResult.ACCEPTED:
        assert sum(map(len, rows)) == pytest.approx(attained_hz * seconds, rel=0.01)


def told(one: Parameters, msgid: int, *fields: Argument) -> list[tuple[Argument, ...]]:
    asked = sent(msgid, *fields)
    if msgid == MessageId.PARAM_SET:
        one.change(*one.wanted(asked))
    return one.told(asked)


@pytest.mark.parametrize("encoding", list(Encoding))
def test_all_are_listed_and_each_is_read_by_name_or_index(encoding: Encoding) -> None:
    one = Parameters(ROWS, encoding)
    every, count = told(one, MessageId.PARAM_REQUEST_LIST), 9 if encoding is Encoding.FLOAT else 6
    assert [(row[0], *row[2:]) for row in every] == [("FIXED", 9, 3, 0), ("COUNT", count, 3, 1), ("SPEED", 9, 3, 2)]
    assert told(one, MessageId.PARAM_REQUEST_READ, "COUNT", -1) == every[1:2]
    assert told(one, MessageId.PARAM_REQUEST_READ, "", 2) == every[2:]
    for name, index in (("NO_SUCH", -1), ("", 3)):
        assert told(one, MessageId.PARAM_REQUEST_READ, name, index) == []


@pytest.mark.parametrize("encoding", list(Encoding))
@pytest.mark.parametrize(
    ("name", "value", "kind", "in_force"),
    [
        ("SPEED", 1.75, 9, 1.75),
        ("SPEED", 2.5, 9, 1.5),
        ("SPEED", float("nan"), 9, 1.5),
        ("FIXED", 30.0, 9, 20.0),
        ("COUNT", 3, 6, 3),
        ("COUNT", 4, 6, 1),
    ],
)
def test_a_set_is_checked_and_answered_by_the_value_in_force(
    encoding: Encoding, name: str, value: float, kind: int, in_force: float
) -> None:
    one = Parameters(ROWS, encoding)
    sent = (
        struct.unpack("<f", struct.pack("<i", round(value)))[0] if encoding is Encoding.BYTES and kind == 6 else value
    )
    [answer] = told(one, MessageId.PARAM_SET, name, sent, kind)
    assert one.value(name) == in_force
    assert (answer[0], answer) == (name, told(one, MessageId.PARAM_REQUEST_READ, name, -1)[0])


@pytest.mark.parametrize("profile", ["ardupilot", "px4"])
@pytest.mark.parametrize("name", [name for name in shipped_vehicles() if name != "qdrone2-recorded"])
def test_the_geometry_that_is_told_is_the_vehicles(profile: str, name: str) -> None:
    dialect, vehicle = dialect_named(profile), vehicle_named(name)
    one = Parameters(dialect.parameters_of(vehicle), dialect.encoding)
    sent = [
        Encoder(*PLANT).encode(MessageId.PARAM_VALUE, *fields) for fields in told(one, MessageId.PARAM_REQUEST_LIST)
    ]
    frames = [frame for data in sent for frame in Decoder().feed(data)]
    found = layout_from_parameters(parameters_in(frames, Maker.PX4 if profile == "px4" else Maker.ARDUPILOTMEGA))
    own = airframe_of(vehicle, name).layout
    assert own is not None
    if profile == "ardupilot" and name == "qdrone2":  # the thesis counts its rotors in an order that ArduPilot has not
        assert found.layout is None
    else:
        assert found.layout is not None
        assert found.layout.alike(own)


class Vehicle:
    """The emulator without its links: one ground station, 255/190, talks to it on link 0.

    now: the latest samples. place: where it is, world NED. armed: whether the motors are on.
    """

    def __init__(self, profile: str = "px4", seed: int = 3) -> None:
        config = PlantConfig(trajectory="commanded", start="ground", seed=seed)
        self.dialect, self.plant = dialect_named(profile), Plant(config)
        self.autopilot = Autopilot([self.dialect.schedule(None)], self.dialect, config)
        self.said: list[Reply] = []
        self._encoder = Encoder(255, 190)
        self.fly(0.1)

    def send(self, msgid: int, *fields: Argument) -> list[Reply]:
        """Give it a message; its answers."""
        (frame,) = Decoder().feed(self._encoder.encode(msgid, *fields))
        return self._note(self.autopilot.step(0, frame, self.plant.t_ns))

    def order(self, command: int, *parameters: float) -> int:
        """The result of a COMMAND_LONG."""
        [ack, *_] = self.send(MessageId.COMMAND_LONG, *PLANT, command, 0, *parameters)
        assert ack.msgid == MessageId.COMMAND_ACK
        result = ack.fields[1]
        assert isinstance(result, int)
        return result

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 1000 / BLOCK_STEPS)):
            self.now = self.plant.advance(BLOCK_STEPS)
            actions, orders = self.autopilot.watch(self.now)
            self._note(actions)
            for order in orders:
                order(self.plant)
        self.place, self.armed = tuple(self.now.position[-1].tolist()), bool(self.now.motors[-1])

    def _note(self, actions: list[Action]) -> list[Reply]:
        replies = [action for action in actions if isinstance(action, Reply)]
        self.said += replies
        return replies


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
    goto = (*PLANT, 6, MavCmd.DO_REPOSITION, 0, 0, -1.0, 0.0, 0.0, NAN, *degrees(2.0, -1.0), 2.0)
    assert vehicle.send(MessageId.COMMAND_INT, *goto)[0].fields[1] == MavResult.ACCEPTED
    vehicle.fly(5.0)
    assert vehicle.place == pytest.approx((2.0, -1.0, -2.0), abs=0.15)
    assert vehicle.now.attitude[-1, 2] == pytest.approx(math.atan2(-1.0, 2.0), abs=0.1)  # the nose went along
    assert vehicle.order(MavCmd.NAV_RETURN_TO_LAUNCH) == MavResult.ACCEPTED
    assert vehicle.autopilot.dialect.custom_mode == vehicle.dialect.shown(Mode.RTL)
    vehicle.fly(16.0)
    assert vehicle.place == pytest.approx((0.0, 0.0, 0.0), abs=0.15)
    assert not vehicle.armed
    assert vehicle.autopilot.dialect.custom_mode != vehicle.dialect.shown(Mode.GUIDED)
    texts = [reply.fields[1] for reply in vehicle.said if reply.msgid == MessageId.STATUSTEXT]
    assert texts == ["Armed", "Refused: disarming is denied in flight", "Disarmed"]


@pytest.mark.parametrize(("frame", "north"), [(1, 1.5), (8, 1.5), (12, 0.0)])  # local, body, and body without earth
def test_a_set_point_is_of_its_frame_and_another_frame_is_passed_over(frame: int, north: float) -> None:
    vehicle = in_flight("ardupilot")
    vehicle.send(MessageId.SET_POSITION_TARGET_LOCAL_NED, 0, *PLANT, frame, 0xDC7, *(0.0,) * 3, 0.5, *(0.0,) * 7)
    vehicle.fly(4.0)
    assert vehicle.place == pytest.approx((north, 0.0, -1.5), abs=0.3)
    for yaw, seen in ((1.0, 1.0), (0.0, 1.0)):  # 0 is no turn
        vehicle.send(MessageId.SET_POSITION_TARGET_LOCAL_NED, 0, *PLANT, 9, 0x9F8, *(0.0,) * 9, yaw, 0.0)
        vehicle.fly(3.0)
        assert vehicle.now.attitude[-1, 2] == pytest.approx(seen, abs=0.1)


def test_a_mission_out_of_reach_is_refused() -> None:
    vehicle = Vehicle("px4")
    vehicle.send(MessageId.MISSION_COUNT, *PLANT, 1, 0)
    flat = (0.0, 0.0, 0.0, NAN, *degrees(20_000.0, 0.0), 2.0, 0)
    assert vehicle.send(MessageId.MISSION_ITEM_INT, *PLANT, 0, 6, 16, 0, 1, *flat)[-1].fields[2] != 0


def test_a_missions_climb_speed_leaves_its_ground_speed() -> None:
    orders = [Order(178, None, (*row, 0.0, 0.0), None, None, None) for row in ((1, 0.5), (2, 0.75), (0, -1.0))]
    assert [one.speed for one in waypoints(orders, dialect_named("px4")) or ()] == [0.5, 0.5, None]


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
    assert vehicle.autopilot.dialect.custom_mode == vehicle.dialect.shown(Mode.MISSION)
    assert vehicle.order(MavCmd.DO_PAUSE_CONTINUE, 1) == MavResult.ACCEPTED
    vehicle.fly(8.0)
    assert vehicle.place == pytest.approx((3.0, 1.0, -1.5), abs=0.2)
