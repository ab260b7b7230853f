"""What the emulated autopilot reads from a frame, a command among them, and what it answers with."""

import math
from typing import NamedTuple, TypeAlias

from mavdiag.link.codec import Argument, Frame, layout_of
from mavdiag.link.messages import MessageId

NOT_SET = 0x7FFFFFFF  # of the integers x and y
DEGREES = 1e-7
_INTEGERS = (MessageId.COMMAND_INT, MessageId.MISSION_ITEM_INT, MessageId.SET_POSITION_TARGET_GLOBAL_INT)


class Reply(NamedTuple):
    """A message of the autopilot's own, for one link; fields as declared."""

    link: int
    msgid: int
    fields: tuple[Argument, ...]


class Forward(NamedTuple):
    """A frame that goes on to another link as its sender's."""

    link: int
    frame: Frame


Action: TypeAlias = Reply | Forward


def optional(frame: Frame, name: str) -> float | None:
    """A number from a frame; None for a field that its message has not, and for what is no finite number."""
    value = frame.value(name) if name in layout_of(frame.msgid).names else None
    return value if isinstance(value, int | float) and math.isfinite(value) else None


def number(frame: Frame, name: str) -> float:
    """As `optional`, with 0 for None."""
    return optional(frame, name) or 0


def integer(frame: Frame, name: str) -> int:
    """As `number`, cut to an integer."""
    return int(number(frame, name))


class Order(NamedTuple):
    """A MAV_CMD with its parameters; None for one that is not given. x, y: degrees. z: metres."""

    command: int
    frame: int | None  # MAV_FRAME; None for COMMAND_LONG, which has none
    param: tuple[float | None, ...]  # the first four
    x: float | None
    y: float | None
    z: float | None

    def whole(self, index: int) -> int:
        """Parameter 1 to 4 as an integer; 0 if it is not given."""
        return int(self.param[index - 1] or 0)


def order_of(frame: Frame) -> Order:
    """The order in COMMAND_LONG, COMMAND_INT, MISSION_ITEM or MISSION_ITEM_INT."""
    long = frame.msgid == MessageId.COMMAND_LONG
    kind = optional(frame, "frame")
    x, y, z = (optional(frame, name) for name in (("param5", "param6", "param7") if long else ("x", "y", "z")))
    if frame.msgid in _INTEGERS:
        x, y = (None if value in (None, NOT_SET) else value * DEGREES for value in (x, y))
    given = tuple(optional(frame, f"param{n}") for n in range(1, 5))
    return Order(integer(frame, "command"), None if kind is None else int(kind), given, x, y, z)
