"""Options that several commands share, and how they become values."""

import dataclasses
import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import typer

from mavdiag.errors import InputError, UsageError
from mavdiag.identify import Order
from mavdiag.logs import Log, read_log
from mavdiag.telemetry import Axis, Series, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["AsJson", "AxisChoice", "FromS", "MethodChoice", "ToS", "Vehicle", "between", "parse_order", "read_part"]

AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON, one object a line.")]
Vehicle: TypeAlias = Annotated[
    int | None, typer.Option(metavar="SYSID", help="System id, where a .tlog or a link carries several.")
]
FromS: TypeAlias = Annotated[
    float | None, typer.Option("--from", metavar="S", help="Start at this time of the vehicle's clock.")
]
ToS: TypeAlias = Annotated[
    float | None, typer.Option("--to", metavar="S", help="Stop at this time of the vehicle's clock.")
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


def read_part(path: Path, vehicle: int | None, from_s: float | None, to_s: float | None) -> Log:
    """A log, or the part of it between two times [s], under the path as given. Raises InputError or UsageError."""
    log = read_log(path, vehicle)
    try:
        return dataclasses.replace(log, name=str(path), telemetry=between(log.telemetry, from_s, to_s))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def between(telemetry: Telemetry, from_s: float | None, to_s: float | None) -> Telemetry:
    """The part of a log between two times of the vehicle's clock [s].

    Raises UsageError if a time is not a number, and InputError if the part is empty.
    """
    for name, value in (("--from", from_s), ("--to", to_s)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name} {value}: give a time in seconds of the vehicle's clock")
    if from_s is None and to_s is None:
        return telemetry
    low = -math.inf if from_s is None else from_s * NS_PER_S
    high = math.inf if to_s is None else to_s * NS_PER_S
    kept = tuple(_cut(series, low, high) for series in telemetry.series)
    if not any(len(series) for series in kept):
        times = np.concatenate([np.empty(0), *(series.t_ns / NS_PER_S for series in telemetry.series)])
        span = f"it goes from {times.min():.1f} to {times.max():.1f} s" if len(times) else "it is empty"
        wanted = " ".join(f"{word} {t:g} s" for word, t in (("from", from_s), ("to", to_s)) if t is not None)
        raise InputError(f"no data {wanted} of the vehicle's clock; {span}")
    return Telemetry(kept)


def _cut(series: Series, low_ns: float, high_ns: float) -> Series:
    keep = (series.t_ns >= low_ns) & (series.t_ns < high_ns)
    return Series(series.signal, series.t_ns[keep], series.host_ns[keep], series.values[keep])
