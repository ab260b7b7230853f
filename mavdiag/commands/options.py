"""Options that several commands share, and how they become values."""

import re
import sys
from collections.abc import Iterable
from pathlib import Path
from shutil import get_terminal_size
from typing import Annotated, Literal, TypeAlias

from typer import Argument, Option

from mavdiag.archive.paths import Found, logs_named
from mavdiag.commandline import say
from mavdiag.errors import UsageError
from mavdiag.identify import Order
from mavdiag.logs import is_log
from mavdiag.logs.csv_columns import ColumnMap, is_csv, load_column_map
from mavdiag.printable import counted
from mavdiag.telemetry import Axis

Accept: TypeAlias = Annotated[
    bool, Option("--accept", help="Write a baseline of grade D, too: its flights speak against it, or it is blind.")
]
AsJson: TypeAlias = Annotated[bool, Option("--json", help="Print JSON, one object a line.")]
AxisChoice: TypeAlias = Literal["roll", "pitch", "both"]
BaselineFile: TypeAlias = Annotated[Path, Option(help="Baseline made by `mavdiag identify`.")]
BaselineOutput: TypeAlias = Annotated[Path, Option("-o", "--output", help="Baseline file to write.")]
CacheFolder: TypeAlias = Annotated[
    Path | None, Option(metavar="DIR", help="Keep answers there.  [default: ~/.cache/mavdiag]")
]
Columns: TypeAlias = Annotated[
    Path | None, Option(metavar="MAP.toml", help="The logs are CSV recordings; the file says which column is what.")
]
FromS: TypeAlias = Annotated[
    float | None, Option("--from", metavar="S", help="Start at this time of the vehicle's clock.")
]
Jobs: TypeAlias = Annotated[
    int | None, Option(min=1, metavar="N", help="Worker processes.  [default: as many as processors]")
]
Layout: TypeAlias = Annotated[
    str | None, Option("--layout", "--frame", metavar="NAME", help="Rotor layout.  [default: what is found]")
]
Logs: TypeAlias = Annotated[list[Path], Argument(metavar="LOG|DIR", help="Logs of any kind, folders, quoted patterns.")]
MethodChoice: TypeAlias = Literal["sriv", "ls"]  # values of `identify.Method`
NoCache: TypeAlias = Annotated[bool, Option("--no-cache", help="Judge all anew, and keep nothing.")]
Orders: TypeAlias = Annotated[str, Option("--order", metavar="NA,NB,NK", help="Model order.")]
Scheduler: TypeAlias = Annotated[
    str | None, Option(metavar="ADDRESS", help="Judge on the workers of this Dask scheduler instead.")
]
SigningKey: TypeAlias = Annotated[
    Path | None, Option(metavar="FILE", help="Hear only what is signed with this key (MAVLink 2 signing).")
]
ToS: TypeAlias = Annotated[float | None, Option("--to", metavar="S", help="Stop at this time of the vehicle's clock.")]
Vehicle: TypeAlias = Annotated[
    int | None, Option(metavar="SYSID", help="System id, where a .tlog or a link carries several.")
]
WindowS: TypeAlias = Annotated[float, Option("--window", metavar="S", help="Savitzky-Golay window.")]

TABLE_WIDTH = 80  # characters (our choice)
_SCHEME = re.compile(r"[a-z]{2,}:")


def axes_of(choice: AxisChoice) -> tuple[Axis, ...]:
    """The axes that a command is about."""
    return (Axis.ROLL, Axis.PITCH) if choice == "both" else (Axis(choice),)


def parse_order(text: str) -> Order:
    """Three whole numbers. Raises UsageError, showing the notation."""
    if not re.fullmatch(r"\s*1?\d\s*,\s*1?\d\s*,\s*1?\d\s*", text):
        raise UsageError(f"order {text!r}: write three whole numbers like 2,2,1 (na,nb,nk), each below 20")
    na, nb, nk = map(int, text.split(","))
    return na, nb, nk


def table_fits() -> bool:
    """Whether the output is a terminal with room for a table."""
    return sys.stdout.isatty() and get_terminal_size().columns >= TABLE_WIDTH


def is_endpoint(source: str) -> bool:
    """Whether a source is meant as the address of a link, be it well written or not, and no file.

    >>> is_endpoint("udp:127.0.0.1:14550"), is_endpoint("/dev/ttyUSB0,921600"), is_endpoint("flight.tlog")
    (True, True, False)
    """
    return (source.startswith("/dev/") or _SCHEME.match(source) is not None) and not Path(source).is_file()


def find_logs(arguments: Iterable[str | Path], columns: Path | None = None) -> tuple[Found, ColumnMap | None]:
    """The logs that arguments name, and the column map of CSV recordings; stderr gets how many were skipped."""
    mapped = None if columns is None else load_column_map(columns)
    found = logs_named(arguments, is_log if mapped is None else is_csv)
    if found.skipped:
        say(f"skipped {counted(found.skipped, 'file')} without a flight log", err=True)
    return found, mapped
