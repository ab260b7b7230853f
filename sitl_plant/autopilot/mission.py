"""The mission protocol: upload, download, clear, of the flight plan; there are no fence and no rally points.

https://mavlink.io/en/services/mission.html. An interrupted upload is asked for again, and given up after a time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from mavdiag.link.codec import Frame
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.wire import Action, Reply, number, order_of

MISSION = 0  # MAV_MISSION_TYPE of the flight plan; 1 is the fence, 2 are rally points
ACCEPTED, ERROR, UNSUPPORTED, NO_SPACE, INVALID_SEQUENCE, CANCELLED = 0, 1, 3, 4, 13, 15  # MAV_MISSION_RESULT
ITEMS_MAX = 200
ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0


@dataclass(slots=True)
class _Upload:
    link: int
    source: tuple[int, int]
    count: int
    heard_ns: int  # when the last item came, and the last was asked for
    asked_ns: int
    frames: list[Frame] = field(default_factory=list)

    def ask(self) -> Reply:
        return Reply(self.link, MessageId.MISSION_REQUEST_INT, (*self.source, len(self.frames), MISSION))


class Mission:
    """The stored flight plan.

    accept: whether items can be flown; they are stored only then. skip_to: is told the item to go on with.
    """

    def __init__(self, accept: Callable[[tuple[Frame, ...]], bool], skip_to: Callable[[int], None]) -> None:
        self._accept, self._skip_to = accept, skip_to
        self._items: tuple[tuple[float, ...], ...] = ()  # each as MISSION_ITEM_INT has it, from frame to z
        self._upload: _Upload | None = None
        self._handlers: dict[int, Callable[[int, Frame, int], Action | None]] = {
            MessageId.MISSION_REQUEST_LIST: lambda link, frame, now_ns: _count(link, frame, len(self._items)),
            MessageId.MISSION_REQUEST: self._send,
            MessageId.MISSION_REQUEST_INT: self._send,
            MessageId.MISSION_COUNT: self._begin,
            MessageId.MISSION_ITEM: self._take,
            MessageId.MISSION_ITEM_INT: self._take,
            MessageId.MISSION_CLEAR_ALL: self._clear,
            MessageId.MISSION_SET_CURRENT: self._set_current,
            MessageId.MISSION_ACK: lambda link, frame, now_ns: None,
        }

    def __len__(self) -> int:
        return len(self._items)

    @property
    def handled(self) -> frozenset[int]:
        """The messages of the protocol."""
        return frozenset(self._handlers)

    def step(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """Answer one message of the protocol. A type of mission that is not carried is empty, or refused."""
        if int(number(frame, "mission_type")) == MISSION or frame.msgid == MessageId.MISSION_ACK:
            answer = self._handlers[frame.msgid](link, frame, now_ns)
        elif frame.msgid == MessageId.MISSION_REQUEST_LIST:
            answer = _count(link, frame, 0)
        else:
            answer = _ack(link, frame, ACCEPTED if frame.msgid == MessageId.MISSION_CLEAR_ALL else UNSUPPORTED)
        return [] if answer is None else [answer]

    def tick(self, now_ns: int) -> list[Action]:
        """Ask once more for an item that does not come, or give up."""
        upload = self._upload
        if upload is None:
            return []
        if now_ns - upload.heard_ns > GIVE_UP_S * 1e9:
            self._upload = None
            return [Reply(upload.link, MessageId.MISSION_ACK, (*upload.source, CANCELLED, MISSION))]
        if now_ns - upload.asked_ns < ASK_AGAIN_S * 1e9:
            return []
        upload.asked_ns = now_ns
        return [upload.ask()]

    def current(self, link: int, item: int) -> Reply:
        """MISSION_CURRENT. item: the one that is flown, or comes next."""
        return Reply(link, MessageId.MISSION_CURRENT, (item, len(self._items)))

    def _send(self, link: int, frame: Frame, now_ns: int) -> Action:
        seq = int(number(frame, "seq"))
        if seq >= len(self._items):
            return _ack(link, frame, INVALID_SEQUENCE)
        kind, command, *fields = self._items[seq]
        place = (frame.sysid, frame.compid, seq, int(kind), int(command))
        return Reply(link, MessageId.MISSION_ITEM_INT, (*place, *fields, MISSION))

    def _begin(self, link: int, frame: Frame, now_ns: int) -> Action:
        count = int(number(frame, "count"))
        if count > ITEMS_MAX:
            return _ack(link, frame, NO_SPACE)
        if count == 0:
            return self._clear(link, frame, now_ns)
        self._upload = _Upload(link, (frame.sysid, frame.compid), count, now_ns, now_ns)
        return self._upload.ask()

    def _take(self, link: int, frame: Frame, now_ns: int) -> Action:
        upload = self._upload
        if upload is None or (frame.sysid, frame.compid) != upload.source:
            return _ack(link, frame, ERROR)
        if int(number(frame, "seq")) == len(upload.frames):  # else twice, or out of order: the right one is asked for
            upload.frames.append(frame)
            upload.heard_ns = upload.asked_ns = now_ns
        if len(upload.frames) < upload.count:
            return upload.ask()
        self._upload = None
        if not self._accept(tuple(upload.frames)):
            return _ack(link, frame, UNSUPPORTED)
        self._items = tuple(_item(item) for item in upload.frames)
        return _ack(link, frame, ACCEPTED)

    def _clear(self, link: int, frame: Frame, now_ns: int) -> Action:
        self._accept(())
        self._items, self._upload = (), None
        return _ack(link, frame, ACCEPTED)

    def _set_current(self, link: int, frame: Frame, now_ns: int) -> Action:
        seq = int(number(frame, "seq"))
        if seq >= len(self._items):
            return _ack(link, frame, INVALID_SEQUENCE)
        self._skip_to(seq)
        return self.current(link, seq)


def _item(frame: Frame) -> tuple[float, ...]:
    """As it was sent, with degrees as integers."""
    order = order_of(frame)
    flags = (int(number(frame, name)) for name in ("frame", "command", "current", "autocontinue"))
    *params, z = (float("nan") if value is None else value for value in (*order.param, order.z))
    return (*flags, *params, *(round((value or 0.0) * 1e7) for value in (order.x, order.y)), z)


def _count(link: int, frame: Frame, items: int) -> Reply:
    kind = int(number(frame, "mission_type"))
    return Reply(link, MessageId.MISSION_COUNT, (frame.sysid, frame.compid, items, kind))


def _ack(link: int, frame: Frame, result: int) -> Reply:
    return Reply(link, MessageId.MISSION_ACK, (frame.sysid, frame.compid, result, int(number(frame, "mission_type"))))
