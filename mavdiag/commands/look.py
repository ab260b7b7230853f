"""`mavdiag look`: what a log shows by itself, without a baseline."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_from, with_layout
from mavdiag.archive.paths import logs_named
from mavdiag.commandline import ERROR, say
from mavdiag.commands.options import AsJson, Columns, FromS, Layout, ToS, Vehicle, read_part
from mavdiag.commands.progress import each
from mavdiag.errors import InputError
from mavdiag.logs.csv_columns import is_csv, load_column_map
from mavdiag.look.first_look import first_look
from mavdiag.look.words import CLOSING, in_full, in_one_line

__all__ = ["look"]


def look(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG|DIR", help="Logs, folders of logs, or patterns.")],
    columns: Columns = None,
    airframe: Annotated[
        str | None, typer.Option(metavar="NAME|FILE.toml", help="The vehicle.  [default: what the log itself shows]")
    ] = None,
    layout: Layout = None,
    vehicle: Vehicle = None,
    from_s: FromS = None,
    to_s: ToS = None,
    as_json: AsJson = False,
) -> None:
    """Say what logs show without a baseline: trim by rotor, vibration, saturation, rotor line, link, and what is
    missing for a verdict.

    It is no verdict. Exit code: 0, or 2 if a log cannot be read; the others are told all the same.
    """
    told = Airframe() if airframe is None else airframe_from(airframe)
    told = told if layout is None else with_layout(told, layout)
    mapped = None if columns is None else load_column_map(columns)
    named = logs_named(logs) if mapped is None else logs_named(logs, is_csv)
    failed = False
    for one in each(named.logs, "looking"):
        try:
            if one.trouble:
                raise InputError(one.trouble)
            found = first_look(read_part(one.path, vehicle, from_s, to_s, mapped), told)
        except InputError as error:
            failed = True
            said = str(error).removeprefix(f"{one.path}: ")
            say(json.dumps({"log": str(one.path), "error": said}) if as_json else f"{one.path}: error, {said}")
            continue
        if as_json:
            say(json.dumps(_known(asdict(found)), allow_nan=False))
        else:
            say("\n".join(in_full(found)) if len(named.logs) == 1 else in_one_line(found))
    if len(named.logs) > 1 and not as_json:
        say(CLOSING)
    if named.skipped_sentence:
        say(named.skipped_sentence, err=True)
    raise typer.Exit(ERROR if failed else 0)


def _known(value: Any) -> Any:
    """The same value with null for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _known(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_known(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
