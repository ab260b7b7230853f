"""`mavdiag export`: a flight for other tools, or a baseline for those who judge without this package."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mavdiag.archive.paths import check_output
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.options import Columns, Vehicle
from mavdiag.errors import UsageError
from mavdiag.judging import judge_in_full
from mavdiag.logs import read_log
from mavdiag.logs.csv_columns import load_column_map
from mavdiag.storage import replacing, write_atomically
from mavdiag.telemetry import frame_of
from mavdiag.units import NS_PER_S

TABLE_KEY = 151  # of the applet's parameters unless told otherwise (our choice)


def export(
    log: Annotated[Path | None, Argument(metavar="LOG", help="Flight log.")] = None,
    *,
    mcap: Annotated[bool, Option("--mcap", help="For Foxglove and PlotJuggler.")] = False,
    csv: Annotated[bool, Option("--csv", help="A table over time.")] = False,
    parquet: Annotated[bool, Option("--parquet", help="The same for data frames.")] = False,
    lua: Annotated[Path | None, Option(metavar="BASELINE", help="A baseline as an ArduPilot Lua applet.")] = None,
    baseline: Annotated[Path | None, Option(help="Baseline made by `mavdiag identify`.")] = None,
    output: Annotated[Path | None, Option("-o", "--output", help="File to write.  [default: LOG.suffix]")] = None,
    vehicle: Vehicle = None,
    columns: Columns = None,
    table_key: Annotated[
        int | None, Option(min=1, max=200, help=f"Of the applet's parameters.  [default: {TABLE_KEY}]")
    ] = None,
) -> None:
    """Write a flight's signals for other tools; with a baseline also residuals, statistics and the decision.

    Or write a baseline as a script that judges on the flight controller itself (docs/flight-controller.md).
    """
    chosen = [kind for kind, asked in (("mcap", mcap), ("csv", csv), ("parquet", parquet)) if asked]
    if lua is not None:
        if chosen or output is None or (log, baseline, vehicle, columns) != (None,) * 4:
            raise UsageError("--lua takes a baseline and -o FILE.lua alone, no log")
        from mavdiag.export.lua import applet, left_out

        loaded = Baseline.load(lua)
        check_output(output, lua)
        write_atomically(output, applet(loaded, TABLE_KEY if table_key is None else table_key))
        for one in left_out(loaded):
            say(f"left out   {one}")
        return say(f"written to {output}; copy it to APM/scripts of the memory card and set SCR_ENABLE to 1")
    if log is None or len(chosen) != 1 or table_key is not None:
        raise UsageError("name one LOG and one of --mcap, --csv, --parquet; or --lua BASELINE -o FILE [--table-key N]")
    output = output or Path(log.name).with_suffix(f".{chosen[0]}")
    check_output(output, log, baseline, columns)
    from mavdiag.export import flight

    found = read_log(log, vehicle, columns=load_column_map(columns) if columns else None)
    judged = judge_in_full(found, Baseline.load(baseline)) if baseline is not None else None
    topics = list(flight.topics_of(found, judged))
    if mcap:
        flight.write_mcap(output, found, topics, judged.verdict.changes if judged else ())
    else:
        table = frame_of([(topic.name, topic.t_ns / NS_PER_S, topic.names, topic.values) for topic in topics])
        with replacing(output) as file:
            table.to_csv(file) if csv else table.to_parquet(file)
    say(str(judged.verdict) if judged else f"{found.name}: signals alone; name a --baseline to judge it")
    return say(f"written to {output}: {', '.join(topic.name for topic in topics)}")
