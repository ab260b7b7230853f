"""Options that several commands share."""

import dataclasses
from enum import StrEnum
from pathlib import Path

from mavdiag.errors import InputError, UsageError
from mavdiag.identify import Method, Order
from mavdiag.judging import between
from mavdiag.logs import Log, read_log
from mavdiag.telemetry import Axis

__all__ = ["AxisChoice", "MethodChoice", "parse_order", "read_part"]


class AxisChoice(StrEnum):
    """Which axes a command is about."""

    ROLL = "roll"
    PITCH = "pitch"
    BOTH = "both"

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes themselves."""
        return (Axis.ROLL, Axis.PITCH) if self is AxisChoice.BOTH else (Axis(self.value),)


class MethodChoice(StrEnum):
    """How a model is fitted."""

    SRIV = "sriv"
    LS = "ls"

    @property
    def method(self) -> Method:
        """The method itself."""
        return Method(self.value)


def parse_order(text: str) -> Order:
    """Three whole numbers. Raises UsageError, showing the notation.

    >>> parse_order("2,2,1")
    (2, 2, 1)
    """
    parts = text.split(",")
    if len(parts) != 3 or not all(part.strip().isdecimal() for part in parts):
        raise UsageError(f"order {text!r}: write three whole numbers like 2,2,1 (na,nb,nk)")
    return int(parts[0]), int(parts[1]), int(parts[2])


def read_part(path: Path, vehicle: int | None, from_s: float | None, to_s: float | None) -> Log:
    """A log, or the part of it between two times [s]. Raises InputError naming the log."""
    log = read_log(path, vehicle)
    try:
        return dataclasses.replace(log, telemetry=between(log.telemetry, from_s, to_s))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
