"""The mission protocol of the emulated autopilot, as a ground station speaks it."""

from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.layout import Argument
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.mission import Mission
from sitl_plant.autopilot.wire import Action, Reply

GCS, PLANT, SECOND = (255, 190), (1, 1), 1_000_000_000
LAT, LON = 473_977_420, 85_455_940


def frame(msgid: int, *fields: Argument, source: tuple[int, int] = GCS) -> Frame:
    return Decoder().feed(Encoder(*source).encode(msgid, *PLANT, *fields), 0)[0]


def item(seq: int, number: int = 16, z: float = 2.0) -> Frame:
    return frame(MessageId.MISSION_ITEM_INT, seq, 6, number, 0, 1, 0.0, 0.0, 0.0, 0.0, LAT + seq, LON, z, 0)


def said(actions: list[Action]) -> list[tuple[int, tuple[Argument, ...]]]:
    return [(action.msgid, action.fields) for action in actions if isinstance(action, Reply)]


def upload(one: Mission, count: int) -> list[tuple[int, tuple[Argument, ...]]]:
    answer = said(one.step(0, frame(MessageId.MISSION_COUNT, count, 0), 0))
    for seq in range(count):
        assert answer == [(MessageId.MISSION_REQUEST_INT, (*GCS, seq, 0))]
        answer = said(one.step(0, item(seq), 0))
    return answer


def test_what_was_uploaded_is_downloaded() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    assert upload(one, 3) == [(MessageId.MISSION_ACK, (*GCS, 0, 0))]
    assert said(one.step(0, frame(MessageId.MISSION_REQUEST_LIST, 0), 0)) == [(MessageId.MISSION_COUNT, (*GCS, 3, 0))]
    for msgid in (MessageId.MISSION_REQUEST_INT, MessageId.MISSION_REQUEST):
        [(kind, fields)] = said(one.step(0, frame(msgid, 2, 0), 0))
        assert kind == MessageId.MISSION_ITEM_INT
        assert fields == (*GCS, 2, 6, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, LAT + 2, LON, 2.0, 0)
    assert said(one.step(0, frame(MessageId.MISSION_REQUEST_INT, 3, 0), 0)) == [(47, (*GCS, 13, 0))]


def test_an_item_in_floats_is_stored_as_well() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    one.step(0, frame(MessageId.MISSION_COUNT, 1, 0), 0)
    floats = frame(MessageId.MISSION_ITEM, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 47.5, 8.5, 2.0, 0)
    assert said(one.step(0, floats, 0)) == [(MessageId.MISSION_ACK, (*GCS, 0, 0))]
    [(_, fields)] = said(one.step(0, frame(MessageId.MISSION_REQUEST_INT, 0, 0), 0))
    assert fields[11:13] == (475_000_000, 85_000_000)


def test_a_lost_item_is_asked_for_again_and_an_upload_that_stops_is_given_up() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    one.step(0, frame(MessageId.MISSION_COUNT, 2, 0), 0)
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
    assert said(one.step(0, frame(MessageId.MISSION_COUNT, 10_000, 0), 0)) == [(MessageId.MISSION_ACK, (*GCS, 4, 0))]


def test_fence_and_rally_points_are_empty_and_their_type_comes_back() -> None:
    one = Mission(lambda frames: True, lambda seq: None)
    for kind in (1, 2):
        asked = said(one.step(0, frame(MessageId.MISSION_REQUEST_LIST, kind), 0))
        assert asked == [(MessageId.MISSION_COUNT, (*GCS, 0, kind))]
        assert said(one.step(0, frame(MessageId.MISSION_COUNT, 2, kind), 0)) == [(47, (*GCS, 3, kind))]
        assert said(one.step(0, frame(MessageId.MISSION_CLEAR_ALL, kind), 0)) == [(47, (*GCS, 0, kind))]


def test_the_item_to_go_on_with_is_set_and_confirmed() -> None:
    skipped: list[int] = []
    one = Mission(lambda frames: True, skipped.append)
    upload(one, 3)
    assert said(one.step(0, frame(MessageId.MISSION_SET_CURRENT, 2), 0)) == [(MessageId.MISSION_CURRENT, (2, 3))]
    assert said(one.step(0, frame(MessageId.MISSION_SET_CURRENT, 3), 0)) == [(MessageId.MISSION_ACK, (*GCS, 13, 0))]
    assert skipped == [2]
