"""The mission protocol: upload, download, clear, of the flight plan; there are no fence and no rally points.

https://mavlink.io/en/services/mission.html. An interrupted upload is asked for again, and given up after a time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from mavdiag.link.codec import Frame
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.wire import Action, Reply, number, order_of

MISSION = 0  # MAV_MISSION_TYPE of the flight plan; 1 is the fence, 2 are rally points
ACCEPTED, ERROR, UNSUPPORTED, NO_SPACE, INVALID_SEQUENCE, CANCELLED = 0, 1, 3, 4, 13, 15  # MAV_MISSION_RESULT
ITEMS_MAX = 200
ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0


@dataclass(frozen=True, slots=True)
class Item:
    """One item as MISSION_ITEM_INT has it. fields: after target and seq, before mission_type."""

    frame: int
    command: int
    fields: tuple[float, ...]

    def reply(self, link: int, to: tuple[int, int], seq: int) -> Reply:
        """The item as an answer."""
        return Reply(link, MessageId.MISSION_ITEM_INT, (*to, seq, self.frame, self.command, *self.fields, MISSION))


@dataclass(frozen=True, slots=True)
class _Upload:
    """An upload under way: from whom, how many items, which came, when the last one came and the last was asked for."""

    link: int
    source: tuple[int, int]
    count: int
    frames: tuple[Frame, ...]
    heard_ns: int
    asked_ns: int


class Mission:
    """The stored flight plan.

    accept: whether items can be flown; they are stored only then. skip_to: is told the item to go on with.
    """

    def __init__(self, accept: Callable[[tuple[Frame, ...]], bool], skip_to: Callable[[int], None]) -> None:
        self._accept, self._skip_to = accept, skip_to
        self._items: tuple[Item, ...] = ()
        self._upload: _Upload | None = None
        self._handlers: dict[int, Callable[[int, Frame, int], list[Action]]] = {
            MessageId.MISSION_REQUEST_LIST: self._count,
            MessageId.MISSION_REQUEST: self._send,
            MessageId.MISSION_REQUEST_INT: self._send,
            MessageId.MISSION_COUNT: self._begin,
            MessageId.MISSION_ITEM: self._take,
            MessageId.MISSION_ITEM_INT: self._take,
            MessageId.MISSION_CLEAR_ALL: self._clear,
            MessageId.MISSION_SET_CURRENT: self._set_current,
            MessageId.MISSION_ACK: lambda link, frame, now_ns: [],
        }

    def __len__(self) -> int:
        return len(self._items)

    @property
    def handled(self) -> frozenset[int]:
        """The messages of the protocol."""
        return frozenset(self._handlers)

    def step(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """Answer one message of the protocol. A type of mission that is not carried is empty, or refused."""
        kind = int(number(frame, "mission_type"))
        if kind == MISSION:
            return self._handlers[frame.msgid](link, frame, now_ns)
        if frame.msgid == MessageId.MISSION_REQUEST_LIST:
            return [Reply(link, MessageId.MISSION_COUNT, (frame.sysid, frame.compid, 0, kind))]
        if frame.msgid == MessageId.MISSION_CLEAR_ALL:
            return [_ack(link, frame, ACCEPTED)]
        return [] if frame.msgid == MessageId.MISSION_ACK else [_ack(link, frame, UNSUPPORTED)]

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
        self._upload = replace(upload, asked_ns=now_ns)
        return [self._ask(upload)]

    def current(self, link: int, item: int) -> Reply:
        """MISSION_CURRENT. item: the one that is flown, or comes next."""
        return Reply(link, MessageId.MISSION_CURRENT, (item, len(self._items)))

    def _count(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        return [Reply(link, MessageId.MISSION_COUNT, (frame.sysid, frame.compid, len(self._items), MISSION))]

    def _send(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        seq = int(number(frame, "seq"))
        if seq >= len(self._items):
            return [_ack(link, frame, INVALID_SEQUENCE)]
        return [self._items[seq].reply(link, (frame.sysid, frame.compid), seq)]

    def _begin(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        count = int(number(frame, "count"))
        if count > ITEMS_MAX:
            return [_ack(link, frame, NO_SPACE)]
        if count == 0:
            return self._clear(link, frame, now_ns)
        self._upload = _Upload(link, (frame.sysid, frame.compid), count, (), now_ns, now_ns)
        return [self._ask(self._upload)]

    def _take(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        upload = self._upload
        if upload is None or (frame.sysid, frame.compid) != upload.source:
            return [_ack(link, frame, ERROR)]
        if int(number(frame, "seq")) != len(upload.frames):  # twice, or out of order: the right one is asked for
            return [self._ask(upload)]
        upload = replace(upload, frames=(*upload.frames, frame), heard_ns=now_ns, asked_ns=now_ns)
        self._upload = upload
        if len(upload.frames) < upload.count:
            return [self._ask(upload)]
        self._upload = None
        if not self._accept(upload.frames):
            return [_ack(link, frame, UNSUPPORTED)]
        self._items = tuple(_item(one) for one in upload.frames)
        return [_ack(link, frame, ACCEPTED)]

    def _ask(self, upload: _Upload) -> Reply:
        return Reply(upload.link, MessageId.MISSION_REQUEST_INT, (*upload.source, len(upload.frames), MISSION))

    def _clear(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        self._accept(())
        self._items, self._upload = (), None
        return [_ack(link, frame, ACCEPTED)]

    def _set_current(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        seq = int(number(frame, "seq"))
        if seq >= len(self._items):
            return [_ack(link, frame, INVALID_SEQUENCE)]
        self._skip_to(seq)
        return [self.current(link, seq)]


def _item(frame: Frame) -> Item:
    order = order_of(frame)
    x, y = (round((value or 0.0) * 1e7) for value in (order.x, order.y))
    flags = int(number(frame, "current")), int(number(frame, "autocontinue"))
    params = tuple(float("nan") if value is None else value for value in order.param)
    z = float("nan") if order.z is None else order.z
    return Item(int(number(frame, "frame")), order.command, (*flags, *params, x, y, z))


def _ack(link: int, frame: Frame, result: int) -> Reply:
    return Reply(link, MessageId.MISSION_ACK, (frame.sysid, frame.compid, result, int(number(frame, "mission_type"))))
