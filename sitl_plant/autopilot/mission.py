"""The mission protocol: upload, download, clear, of the flight plan; there are no fence and no rally points.

https://mavlink.io/en/services/mission.html. An interrupted upload is asked for again, and given up after a time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from mavdiag.link.codec import Frame
from mavdiag.link.messages import MessageId
from sitl_plant.autopilot.wire import Action, Reply, integer, order_of

MISSION, EVERY = 0, 255  # MAV_MISSION_TYPE of the flight plan, and of all; 1 is the fence, 2 are rally points
ACCEPTED, ERROR, UNSUPPORTED, NO_SPACE, INVALID_SEQUENCE, CANCELLED = 0, 1, 3, 4, 13, 15  # MAV_MISSION_RESULT
ITEMS_MAX = 200
ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0
REQUESTS = (MessageId.MISSION_REQUEST, MessageId.MISSION_REQUEST_INT)
ITEMS = (MessageId.MISSION_ITEM, MessageId.MISSION_ITEM_INT)
HANDLED = (
    *(*REQUESTS, *ITEMS, MessageId.MISSION_REQUEST_LIST, MessageId.MISSION_COUNT, MessageId.MISSION_CLEAR_ALL),
    MessageId.MISSION_SET_CURRENT,
)


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

    def __len__(self) -> int:
        return len(self._items)

    def step(self, link: int, frame: Frame, now_ns: int) -> list[Action]:
        """Answer one message of the protocol. A type of mission that is not carried is empty, or refused."""
        kind, source = integer(frame, "mission_type"), (frame.sysid, frame.compid)
        if frame.msgid == MessageId.MISSION_REQUEST_LIST:
            count = len(self) if kind == MISSION else 0
            return [Reply(link, MessageId.MISSION_COUNT, (*source, count, kind))]
        if kind != MISSION and (kind, frame.msgid) != (EVERY, MessageId.MISSION_CLEAR_ALL):
            answer: Reply | int = ACCEPTED if frame.msgid == MessageId.MISSION_CLEAR_ALL else UNSUPPORTED
        elif frame.msgid in ITEMS:
            answer = self._take(source, frame, now_ns)
        elif frame.msgid == MessageId.MISSION_COUNT:
            answer = self._begin(link, source, integer(frame, "count"), now_ns)
        elif frame.msgid == MessageId.MISSION_CLEAR_ALL:
            answer = self._clear()
        else:
            answer = self._at(link, frame, integer(frame, "seq"))
        return [answer if isinstance(answer, Reply) else Reply(link, MessageId.MISSION_ACK, (*source, answer, kind))]

    def tick(self, now_ns: int) -> list[Action]:
        """Ask once more for an item that does not come, or give up."""
        upload = self._upload
        if upload is not None and now_ns - upload.heard_ns > GIVE_UP_S * 1e9:
            self._upload = None
            return [Reply(upload.link, MessageId.MISSION_ACK, (*upload.source, CANCELLED, MISSION))]
        if upload is None or now_ns - upload.asked_ns < ASK_AGAIN_S * 1e9:
            return []
        upload.asked_ns = now_ns
        return [upload.ask()]

    def current(self, link: int, item: int) -> Reply:
        """MISSION_CURRENT. item: the one that is flown, or comes next."""
        return Reply(link, MessageId.MISSION_CURRENT, (item, len(self)))

    def _at(self, link: int, frame: Frame, seq: int) -> Reply | int:
        if seq >= len(self):
            return INVALID_SEQUENCE
        if frame.msgid == MessageId.MISSION_SET_CURRENT:
            self._skip_to(seq)
            return self.current(link, seq)
        kind, command, *fields = self._items[seq]
        place = (frame.sysid, frame.compid, seq, int(kind), int(command))
        return Reply(link, MessageId.MISSION_ITEM_INT, (*place, *fields, MISSION))

    def _begin(self, link: int, source: tuple[int, int], count: int, now_ns: int) -> Reply | int:
        if count > ITEMS_MAX:
            return NO_SPACE
        if count == 0:
            return self._clear()
        self._upload = _Upload(link, source, count, now_ns, now_ns)
        return self._upload.ask()

    def _take(self, source: tuple[int, int], frame: Frame, now_ns: int) -> Reply | int:
        upload = self._upload
        if upload is None or source != upload.source:
            return ERROR
        if integer(frame, "seq") == len(upload.frames):  # else twice, or out of order: the right one is asked for
            upload.frames.append(frame)
            upload.heard_ns = upload.asked_ns = now_ns
        if len(upload.frames) < upload.count:
            return upload.ask()
        self._upload = None
        if not self._accept(tuple(upload.frames)):
            return UNSUPPORTED
        self._items = tuple(_item(item) for item in upload.frames)
        return ACCEPTED

    def _clear(self) -> int:
        self._accept(())
        self._items, self._upload = (), None
        return ACCEPTED


def _item(frame: Frame) -> tuple[float, ...]:
    order = order_of(frame)
    flags = (integer(frame, name) for name in ("frame", "command", "current", "autocontinue"))
    *params, z = (float("nan") if value is None else value for value in (*order.param, order.z))
    return (*flags, *params, *(round((value or 0.0) * 1e7) for value in (order.x, order.y)), z)
