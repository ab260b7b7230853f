"""Options that several commands share, and how they become values."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from mavdiag.errors import UsageError
from mavdiag.identify import Order
from mavdiag.logs.part import between, read_part
from mavdiag.telemetry import Axis

__all__ = [
    "Accept",
    "AsJson",
    "AxisChoice",
    "Columns",
    "FromS",
    "Layout",
    "MethodChoice",
    "ToS",
    "Vehicle",
    "between",
    "is_endpoint",
    "parse_order",
    "read_part",
]

_SCHEME = re.compile(r"[a-z]{2,}:")

Accept: TypeAlias = Annotated[
    bool,
    typer.Option("--accept", help="Write a baseline of grade D, too: its flights speak against it, or it is blind."),
]
AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON, one object a line.")]
Layout: TypeAlias = Annotated[
    str | None, typer.Option("--layout", "--frame", metavar="NAME", help="Rotor layout.  [default: what is found]")
]
Vehicle: TypeAlias = Annotated[
    int | None, typer.Option(metavar="SYSID", help="System id, where a .tlog or a link carries several.")
]
FromS: TypeAlias = Annotated[
    float | None, typer.Option("--from", metavar="S", help="Start at this time of the vehicle's clock.")
]
ToS: TypeAlias = Annotated[
    float | None, typer.Option("--to", metavar="S", help="Stop at this time of the vehicle's clock.")
]

Columns: TypeAlias = Annotated[
    Path | None,
    typer.Option(metavar="MAP.toml", help="The logs are CSV recordings; the file says which column is what."),
]


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
    """How a model is fitted; values of `mavdiag.identify.Method`."""

    SRIV = "sriv"
    LS = "ls"


def parse_order(text: str) -> Order:
    """Three whole numbers. Raises UsageError, showing the notation.

    >>> parse_order("2,2,1")
    (2, 2, 1)
    """
    parts = text.split(",")
    if len(parts) != 3 or not all(part.strip().isdecimal() for part in parts):
        raise UsageError(f"order {text!r}: write three whole numbers like 2,2,1 (na,nb,nk)")
    return int(parts[0]), int(parts[1]), int(parts[2])


def is_endpoint(source: str) -> bool:
    """Whether a source is meant as the address of a link, be it well written or not, and no file.

    >>> is_endpoint("udp:127.0.0.1:14550"), is_endpoint("/dev/ttyUSB0,921600"), is_endpoint("flight.tlog")
    (True, True, False)
    """
    return (source.startswith("/dev/") or _SCHEME.match(source) is not None) and not Path(source).is_file()
