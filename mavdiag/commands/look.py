"""`mavdiag look`: what a log shows by itself, without a baseline."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from mavdiag.airframe.airframe import Airframe
from mavdiag.commandline import ERROR, say
from mavdiag.commands.options import AsJson, CsvMap, FromS, ToS, Vehicle, read_part
from mavdiag.commands.progress import each
from mavdiag.errors import InputError
from mavdiag.face import log_paths
from mavdiag.learning import LearnOptions
from mavdiag.logs.csv_columns import load_column_map
from mavdiag.look.first_look import FirstLook, first_look
from mavdiag.look.words import CLOSING, in_full, in_one_line

__all__ = ["look"]


def look(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG|DIR", help="Logs, folders of logs, or patterns.")],
    csv: CsvMap = None,
    airframe: Annotated[
        str | None, typer.Option(metavar="NAME|FILE.toml", help="The vehicle.  [default: what the log itself shows]")
    ] = None,
    vehicle: Vehicle = None,
    from_s: FromS = None,
    to_s: ToS = None,
    as_json: AsJson = False,
) -> None:
    """Say what logs show without a baseline: trim by rotor, vibration, saturation, rotor line, link, and what is
    missing for a verdict.

    It is no verdict. Exit code: 0, or 2 if a log cannot be read; the others are told all the same.
    """
    told = with_told(airframe)
    columns = None if csv is None else load_column_map(csv)
    paths = log_paths(logs)
    failed = False
    for path in each(paths, "looking"):
        try:
            found = first_look(read_part(path, vehicle, from_s, to_s, columns), told)
        except InputError as error:
            failed = True
            said = str(error).removeprefix(f"{path}: ")
            say(json.dumps({"log": str(path), "error": said}) if as_json else f"{path}: error, {said}")
            continue
        say(json.dumps(_as_json(found)) if as_json else _as_text(found, paths))
    if len(paths) > 1 and not as_json:
        say(CLOSING)
    raise typer.Exit(ERROR if failed else 0)
