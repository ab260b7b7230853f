"""The emulated autopilot: answers what is meant for it, forwards the rest as ArduPilot does, believes no impostor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.layout import Argument
from mavdiag.link.messages import MavCmd, MavResult, MessageId, Severity
from sitl_plant.autopilot.commands import ORDERS, Autopilot
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.mission import Mission
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.autopilot.wire import Action, Forward, Reply
from sitl_plant.plant import PlantConfig

GCS, DETECTOR, PLANT = (255, 190), (1, 191), (1, 1)
NOW_NS = 5_000_000_000


def autopilot(n_links: int = 3, profile: str = "qdrone2") -> Autopilot:
    schedules = [Schedule({MessageId.RAW_IMU: 1000.0, MessageId.HIGHRES_IMU: 0.0}, 1000.0) for _ in range(n_links)]
    return Autopilot(schedules, dialect_named(profile), PlantConfig())


def frame(source: tuple[int, int], msgid: int, *fields: Argument) -> Frame:
    return Decoder().feed(Encoder(*source).encode(msgid, *fields), 0)[0]


def heartbeat(source: tuple[int, int]) -> Frame:
    return frame(source, MessageId.HEARTBEAT, 18, 8, 0, 0, 4, 3)


def command(source: tuple[int, int], target: tuple[int, int], number: int, *parameters: float) -> Frame:
    return frame(source, MessageId.COMMAND_LONG, *target, number, 0, *parameters)


def acknowledged(actions: list[Action]) -> list[tuple[Argument, Argument]]:
    return [a.fields[:2] for a in actions if isinstance(a, Reply) and a.msgid == MessageId.COMMAND_ACK]  # type: ignore[misc]  # a slice of a tuple has no fixed length for mypy


def replies(actions: list[Action], msgid: int) -> list[tuple[Argument, ...]]:
    return [action.fields for action in actions if isinstance(action, Reply) and action.msgid == msgid]


def test_a_status_text_reaches_the_other_links_that_were_heard_and_not_its_own() -> None:
    one = autopilot()
    text = frame(DETECTOR, MessageId.STATUSTEXT, Severity.CRITICAL, "PROP FAULT r1")
    assert one.step(0, text, NOW_NS) == []
    one.step(1, heartbeat(GCS), NOW_NS)
    assert one.step(0, text, NOW_NS) == [Forward(1, text)]
    one.step(2, heartbeat((254, 190)), NOW_NS)
    assert one.step(0, text, NOW_NS) == [Forward(1, text), Forward(2, text)]


def test_a_message_with_an_address_goes_to_where_its_addressee_was_heard() -> None:
    one = autopilot()
    one.step(0, heartbeat(DETECTOR), NOW_NS)
    one.step(1, heartbeat(GCS), NOW_NS)
    one.step(2, heartbeat((254, 190)), NOW_NS)
    asked = frame(GCS, MessageId.PARAM_REQUEST_LIST, *DETECTOR)
    assert one.step(1, asked, NOW_NS) == [Forward(0, asked)]


def test_commands_for_somebody_else_are_not_answered() -> None:
    one = autopilot()
    for target in (DETECTOR, (2, 1), (2, 0)):
        assert one.step(1, command(GCS, target, MavCmd.SET_MESSAGE_INTERVAL, 27, 1e6), NOW_NS) == []


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0)])
@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (MavCmd.SET_MESSAGE_INTERVAL, (27, 10_000), MavResult.ACCEPTED),
        (MavCmd.SET_MESSAGE_INTERVAL, (27, 100), MavResult.DENIED),
        (MavCmd.SET_MESSAGE_INTERVAL, (30_000, 10_000), MavResult.DENIED),
        (MavCmd.REQUEST_MESSAGE, (148,), MavResult.ACCEPTED),
        (MavCmd.REQUEST_MESSAGE, (105,), MavResult.ACCEPTED),
        (MavCmd.REQUEST_MESSAGE, (30_000,), MavResult.DENIED),
        (MavCmd.REQUEST_AUTOPILOT_CAPABILITIES, (1,), MavResult.ACCEPTED),
        (MavCmd.REQUEST_PROTOCOL_VERSION, (1,), MavResult.ACCEPTED),
        (MavCmd.GET_MESSAGE_INTERVAL, (27,), MavResult.ACCEPTED),
        (MavCmd.COMPONENT_ARM_DISARM, (1,), MavResult.ACCEPTED),  # it is armed
        (MavCmd.COMPONENT_ARM_DISARM, (0,), MavResult.DENIED),  # it follows its own path
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
    assert acknowledged(actions) == [(number, result)]
    assert replies(actions, MessageId.COMMAND_ACK)[0][4:] == GCS
    tells = number == MavCmd.REQUEST_AUTOPILOT_CAPABILITIES or parameters == (148,)
    assert bool(replies(actions, MessageId.AUTOPILOT_VERSION)) == tells


def test_an_interval_is_changed_on_the_link_that_asked_only() -> None:
    one = autopilot()
    one.step(1, command(GCS, PLANT, MavCmd.SET_MESSAGE_INTERVAL, MessageId.RAW_IMU, 20_000), NOW_NS)
    for link, interval_us in ((0, 1000), (1, 20_000)):
        told = one.step(link, command(GCS, PLANT, MavCmd.REQUEST_MESSAGE, 244, MessageId.RAW_IMU), NOW_NS)
        assert replies(told, 244) == [(27, interval_us)]


def test_the_time_is_told_once_and_an_answer_is_not_answered() -> None:
    one = autopilot()
    assert replies(one.step(0, frame(GCS, MessageId.TIMESYNC, 0, 77), NOW_NS), MessageId.TIMESYNC) == [(NOW_NS, 77)]
    assert one.step(0, frame(GCS, MessageId.TIMESYNC, NOW_NS, 77), NOW_NS) == []


@pytest.mark.parametrize(
    ("stream", "rate_hz", "start", "raw_imu_us", "attitude_us"),
    [(1, 4, 1, 250_000, 100_000), (0, 4, 1, 250_000, 250_000), (0, 4, 0, -1, -1), (10, 60_000, 1, 10_000, 1000)],
)
def test_a_ground_station_sets_the_rates_of_a_stream_on_its_link(
    stream: int, rate_hz: int, start: int, raw_imu_us: int, attitude_us: int
) -> None:
    rates: dict[int, float] = {MessageId.RAW_IMU: 100.0, MessageId.ATTITUDE: 10.0, 83: 100.0}
    schedules = [Schedule(rates, 1000.0) for _ in range(2)]
    one = Autopilot(schedules, dialect_named("ardupilot"), PlantConfig())
    asked = frame(GCS, MessageId.REQUEST_DATA_STREAM, *PLANT, stream, rate_hz, start)
    assert one.step(1, asked, NOW_NS) == []
    told = [[schedule.interval_us(msgid) for msgid in rates] for schedule in schedules]
    assert told == [[10_000, 100_000, 10_000], [raw_imu_us, attitude_us, 10_000]]


def test_a_ping_comes_back_to_its_sender_and_an_answer_is_not_answered() -> None:
    one = autopilot()
    assert replies(one.step(0, frame(GCS, MessageId.PING, 1234, 7, 0, 0), NOW_NS), MessageId.PING) == [(1234, 7, *GCS)]
    assert one.step(0, frame(GCS, MessageId.PING, 1234, 7, *PLANT), NOW_NS) == []


@pytest.mark.parametrize(("profile", "first"), [("ardupilot", (4, b"GUIDED")), ("px4", (4 << 16 | 3 << 24, b"Hold"))])
def test_the_modes_are_told_one_by_one_or_all(profile: str, first: tuple[int, bytes]) -> None:
    one = autopilot(profile=profile)
    every = replies(one.step(0, command(GCS, PLANT, 512, MessageId.AVAILABLE_MODES, 0), NOW_NS), 435)
    assert [mode[1] for mode in every] == list(range(1, len(every) + 1))
    assert {mode[0] for mode in every} == {len(every)}
    one_by_one = replies(one.step(0, command(GCS, PLANT, 512, MessageId.AVAILABLE_MODES, 1), NOW_NS), 435)
    assert one_by_one == every[:1]
    assert (every[0][3], str(every[0][5]).encode()) == first
    beyond = one.step(0, command(GCS, PLANT, 512, MessageId.AVAILABLE_MODES, len(every) + 1), NOW_NS)
    assert acknowledged(beyond) == [(512, MavResult.DENIED)]


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
        one.step(other, heartbeat((250 - other, 190)), NOW_NS)
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
        heard = Decoder().feed(encoder.encode_payload(msgid, payload), 0)[0]
        for action in one.step(0, heard, NOW_NS):
            assert isinstance(action, Reply)
            encoder.encode(action.msgid, *action.fields)  # can be sent


# The mission protocol of the emulated autopilot, as a ground station speaks it

SECOND = 1_000_000_000
LAT, LON = 473_977_420, 85_455_940


def sent(msgid: int, *fields: Argument, source: tuple[int, int] = GCS) -> Frame:
    return Decoder().feed(Encoder(*source).encode(msgid, *PLANT, *fields), 0)[0]


def item(seq: int, number: int = 16, z: float = 2.0) -> Frame:
    return sent(MessageId.MISSION_ITEM_INT, seq, 6, number, 0, 1, 0.0, 0.0, 0.0, 0.0, LAT + seq, LON, z, 0)


def said(actions: list[Action]) -> list[tuple[int, tuple[Argument, ...]]]:
    return [(action.msgid, action.fields) for action in actions if isinstance(action, Reply)]


def upload(one: Mission, count: int) -> list[tuple[int, tuple[Argument, ...]]]:
    answer = said(one.step(0, sent(MessageId.MISSION_COUNT, count, 0), 0))
    for seq in range(count):
        assert answer == [(MessageId.MISSION_REQUEST_INT, (*GCS, seq, 0))]
        answer = said(one.step(0, item(seq), 0))
    return answer


def test_what_was_uploaded_is_downloaded() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    assert upload(one, 3) == [(MessageId.MISSION_ACK, (*GCS, 0, 0))]
    assert said(one.step(0, sent(MessageId.MISSION_REQUEST_LIST, 0), 0)) == [(MessageId.MISSION_COUNT, (*GCS, 3, 0))]
    for msgid in (MessageId.MISSION_REQUEST_INT, MessageId.MISSION_REQUEST):
        [(kind, fields)] = said(one.step(0, sent(msgid, 2, 0), 0))
        assert kind == MessageId.MISSION_ITEM_INT
        assert fields == (*GCS, 2, 6, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, LAT + 2, LON, 2.0, 0)
    assert said(one.step(0, sent(MessageId.MISSION_REQUEST_INT, 3, 0), 0)) == [(47, (*GCS, 13, 0))]


def test_an_item_in_floats_is_stored_as_well() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    one.step(0, sent(MessageId.MISSION_COUNT, 1, 0), 0)
    floats = sent(MessageId.MISSION_ITEM, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 47.5, 8.5, 2.0, 0)
    assert said(one.step(0, floats, 0)) == [(MessageId.MISSION_ACK, (*GCS, 0, 0))]
    [(_, fields)] = said(one.step(0, sent(MessageId.MISSION_REQUEST_INT, 0, 0), 0))
    assert fields[11:13] == (475_000_000, 85_000_000)


def test_a_lost_item_is_asked_for_again_and_an_upload_that_stops_is_given_up() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    one.step(0, sent(MessageId.MISSION_COUNT, 2, 0), 0)
    one.step(0, item(0), SECOND)
    assert said(one.step(0, item(0), SECOND)) == [(MessageId.MISSION_REQUEST_INT, (*GCS, 1, 0))]  # twice the same
    assert one.tick(SECOND + SECOND // 2) == []
    assert said(one.tick(2 * SECOND)) == [(MessageId.MISSION_REQUEST_INT, (*GCS, 1, 0))]
    assert said(one.tick(10 * SECOND)) == [(MessageId.MISSION_ACK, (*GCS, 15, 0))]
    assert one.tick(20 * SECOND) == []
    assert len(one) == 0


def test_what_cannot_be_flown_is_refused_and_the_old_plan_stays() -> None:
    takes = [True, False]
    one = Mission(lambda frames: takes.pop(0), lambda seq: None)
    upload(one, 2)
    assert upload(one, 1) == [(MessageId.MISSION_ACK, (*GCS, 3, 0))]
    assert len(one) == 2
    assert said(one.step(0, sent(MessageId.MISSION_COUNT, 10_000, 0), 0)) == [(MessageId.MISSION_ACK, (*GCS, 4, 0))]


def test_fence_and_rally_points_are_empty_and_their_type_comes_back() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    for kind in (1, 2):
        asked = said(one.step(0, sent(MessageId.MISSION_REQUEST_LIST, kind), 0))
        assert asked == [(MessageId.MISSION_COUNT, (*GCS, 0, kind))]
        assert said(one.step(0, sent(MessageId.MISSION_COUNT, 2, kind), 0)) == [(47, (*GCS, 3, kind))]
        assert said(one.step(0, sent(MessageId.MISSION_CLEAR_ALL, kind), 0)) == [(47, (*GCS, 0, kind))]


def test_the_item_to_go_on_with_is_set_and_confirmed() -> None:
    skipped: list[int] = []
    one = Mission(lambda frames: True, skipped.append)
    upload(one, 3)
    assert said(one.step(0, sent(MessageId.MISSION_SET_CURRENT, 2), 0)) == [(MessageId.MISSION_CURRENT, (2, 3))]
    assert said(one.step(0, sent(MessageId.MISSION_SET_CURRENT, 3), 0)) == [(MessageId.MISSION_ACK, (*GCS, 13, 0))]
    assert skipped == [2]


# The rhythm of messages: exact in the mean, never early, changed and denied as an autopilot does

FAST, SLOW, QUIET = 27, 0, 105
STEP_NS = 1_000_000


def times(first: int, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.arange(first, first + n, dtype=np.int64) * STEP_NS


def schedule() -> Schedule:
    return Schedule({FAST: 1000.0, SLOW: 1.0, QUIET: 0.0}, ceiling_hz=1000.0)


@given(rate_hz=st.floats(0.5, 1000.0), blocks=st.lists(st.integers(1, 400), min_size=1, max_size=12))
def test_any_rate_is_met_to_one_message_however_the_time_is_cut(rate_hz: float, blocks: list[int]) -> None:
    one = Schedule({FAST: rate_hz}, ceiling_hz=1000.0)
    rows, first = [], 0
    for n in blocks:
        due = dict(one.due(times(first, n)))
        rows += [first + int(row) for row in due.get(FAST, ())]
        first += n
    whole = Schedule({FAST: rate_hz}, ceiling_hz=1000.0).due(times(0, first))
    assert rows == dict(whole)[FAST].tolist()
    assert abs(len(rows) - first * 1e-3 * rate_hz) <= 1.0


@pytest.mark.parametrize(("msgid", "interval_us"), [(FAST, 999 / 1.01), (FAST, 1), (999, 10_000)])
def test_what_cannot_be_sent_is_denied_and_changes_nothing(msgid: int, interval_us: float) -> None:
    one = schedule()
    assert one.set_interval(msgid, interval_us) is MavResult.DENIED
    assert one.interval_us(FAST) == 1000
    assert one.interval_us(999) == 0


@pytest.mark.parametrize(
    ("profile", "asked_us", "result", "attained_hz"),
    [
        ("qdrone2", 5_000, MavResult.ACCEPTED, 200.0),
        ("px4", 5_000, MavResult.ACCEPTED, 165.0),  # 160 to 170 were measured
        ("px4", 10_000, MavResult.ACCEPTED, 100.0),
        ("ardupilot", 6_667, MavResult.ACCEPTED, 1000.0 / 6.0),  # whole milliseconds
        ("ardupilot", 3_000, MavResult.ACCEPTED, 1000.0 / 3.0),
        ("ardupilot", 2_900, MavResult.DENIED, 0.0),  # above 0.8 of its loop rate
    ],
)
def test_a_profile_grants_rates_as_its_autopilot_does(
    profile: str, asked_us: int, result: MavResult, attained_hz: float
) -> None:
    one = dialect_named(profile).schedule(None, fresh=profile != "qdrone2")
    assert one.set_interval(MessageId.ATTITUDE_TARGET, asked_us) == result
    seconds = 20
    rows = [rows for msgid, rows in one.due(times(0, 1000 * seconds)) if msgid == MessageId.ATTITUDE_TARGET]
    if result == MavResult.ACCEPTED:
        assert len(rows[0]) == pytest.approx(attained_hz * seconds, rel=0.01)
