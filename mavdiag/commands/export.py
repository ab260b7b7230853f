"""`mavdiag export`: a baseline for those who judge without this package."""

from pathlib import Path
from typing import Annotated

from typer import Option

from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.storage import write_atomically


def export(
    lua: Annotated[Path, Option(metavar="BASELINE", help="Write it as an ArduPilot Lua applet.")],
    output: Annotated[Path, Option("-o", "--output", metavar="FILE.lua", help="Script to write.")],
    table_key: Annotated[int, Option(min=1, max=200, help="Of its parameters; other scripts have others.")] = 151,
) -> None:
    """Write a script that judges on the flight controller itself, without a companion computer.

    It runs on the vehicle of the baseline alone; docs/flight-controller.md says how it gets there, its parameters and
    its texts. What it cannot judge is told.
    """
    from mavdiag.export.lua import applet, left_out

    baseline = Baseline.load(lua)
    write_atomically(output, applet(baseline, table_key))
    for one in left_out(baseline):
        say(f"left out   {one}")
    say(f"written to {output}; copy it to APM/scripts of the memory card and set SCR_ENABLE to 1")
