"""What the emulated autopilot reads from a frame, and what it answers with."""

import math
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

from mavdiag.errors import UsageError
from mavdiag.link.codec import Frame, field_index
from mavdiag.link.layout import Argument


@dataclass(frozen=True, slots=True)
class Reply:
    """A message of the autopilot's own, for one link; fields as declared."""

    link: int
    msgid: int
    fields: tuple[Argument, ...]


@dataclass(frozen=True, slots=True)
class Forward:
    """A frame that goes on to another link as its sender's."""

    link: int
    frame: Frame


Action: TypeAlias = Reply | Forward


@cache
def _place(msgid: int, name: str) -> int | None:
    """Where a field lies in `Frame.fields`; None if the message has none of that name."""
    try:
        return field_index(msgid, name)
    except UsageError:
        return None


def optional(frame: Frame, name: str) -> float | None:
    """A number from a frame; None for a field that its message has not, and for what is no finite number."""
    place = _place(frame.msgid, name)
    value = frame.fields[place] if place is not None else None
    return value if isinstance(value, int | float) and math.isfinite(value) else None


def number(frame: Frame, name: str) -> float:
    """As `optional`, with 0 for None."""
    return optional(frame, name) or 0


def text(frame: Frame, name: str) -> str:
    """A text from a frame, up to its first NUL; empty if there is none of that name."""
    place = _place(frame.msgid, name)
    value = frame.fields[place] if place is not None else b""
    return value.partition(b"\0")[0].decode(errors="replace") if isinstance(value, bytes) else ""


def target(frame: Frame) -> tuple[int, int]:
    """System and component that a frame is meant for; 0 is everyone."""
    return int(number(frame, "target_system")), int(number(frame, "target_component"))
