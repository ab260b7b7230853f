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
