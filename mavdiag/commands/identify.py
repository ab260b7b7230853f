"""`mavdiag identify`: healthy flights to a baseline; `mavdiag baseline show|check|extend`: what one says."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mavdiag.airframe.airframe import UNNAMED
from mavdiag.airframe.layout import LAYOUTS
from mavdiag.airframe.load import BUILTIN
from mavdiag.archive.paths import AS_BASELINE, check_output
from mavdiag.baseline import Baseline
from mavdiag.commandline import application, say
from mavdiag.commands import options as opt
from mavdiag.commands.progress import each, working
from mavdiag.errors import UsageError
from mavdiag.face import now, with_airframe
from mavdiag.identify import Method
from mavdiag.learning import ALL_MONITORS, LearnOptions, learn
from mavdiag.learning.learn import extend as extended
from mavdiag.learning.suspicions import accepted
from mavdiag.logs import read_part
from mavdiag.monitors.run_length import MarginRule, RunLength
from mavdiag.printable import counted, printable
from mavdiag.telemetry import Log
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, FLIGHTS_PER_SUSPICION, ThresholdRule


def identify(
    logs: opt.Logs,
    output: opt.BaselineOutput,
    method: Annotated[opt.MethodChoice, Option(help="sriv is unbiased under noise.")] = "sriv",
    order: opt.Orders = "2,2,1",
    axis: Annotated[opt.AxisChoice, Option(help="Axes to model and to watch.")] = "both",
    window: opt.WindowS = 0.1,
    margin: Annotated[MarginRule, Option(help="Margin on |r|.")] = MarginRule.PERCENTILE_90,
    monitors: Annotated[str, Option(metavar="NAMES", help=f"{', '.join(ALL_MONITORS)}; or all, or thesis.")] = "all",
    alarms_per_hour: Annotated[
        float, Option(metavar="X", help="False-alarm budget of all together.")
    ] = BUDGET_PER_HOUR,
    flights_per_suspicion: Annotated[
        float, Option(metavar="N", help="Healthy flights of which one may be suspected.")
    ] = FLIGHTS_PER_SUSPICION,
    rule: Annotated[ThresholdRule, Option(help="By the budget, or the healthy maximum.")] = ThresholdRule.GUMBEL,
    airframe: Annotated[
        str | None, Option(metavar="NAME|FILE.toml", help=f"One of {', '.join(BUILTIN)}, or a file.")
    ] = None,
    layout: Annotated[str | None, Option(metavar="NAME", help=f"Rotor layout: {', '.join(LAYOUTS)}.")] = None,
    name: Annotated[str | None, Option(metavar="LABEL", help="Of the airframe.  [default: as the output]")] = None,
    fleet: Annotated[bool, Option("--fleet", help="The logs are of several vehicles of one type.")] = False,
    sessions: Annotated[
        int | None, Option(min=1, metavar="N", help="Sessions of the logs.  [default: by time]")
    ] = None,
    robust: Annotated[bool, Option("--robust", help="Leave out falls, copies and the like.")] = False,
    accept: opt.Accept = False,
    vehicle: opt.Vehicle = None,
    from_s: opt.FromS = None,
    to_s: opt.ToS = None,
    columns: opt.Columns = None,
    details: Annotated[bool, Option("--details", help="Tell all that it holds, as `mavdiag baseline show`.")] = False,
) -> None:
    """Fit a baseline to healthy flights; say how good it is, what it would notice, and what would make it better."""
    check_output(output, *logs, columns, kind=AS_BASELINE)
    thesis = monitors == "thesis"
    options = LearnOptions(
        axes=opt.axes_of(axis),
        method=Method(method),
        order=opt.parse_order(order),
        window_s=window,
        margin_rule=margin,
        monitors=(RunLength.name,) if thesis else ALL_MONITORS if monitors == "all" else tuple(monitors.split(",")),
        rule=ThresholdRule.MAXIMUM if thesis else rule,  # thesis: the monitor of T 5.5, alone
        alarms_per_hour=alarms_per_hour,
        flights_per_suspicion=flights_per_suspicion,
        sessions=sessions,
        robust=robust,
    )
    options = with_airframe(options, airframe, name, layout)
    if fleet:
        options = replace(options, airframe=replace(options.airframe, scope="type"))
    baseline = make_baseline(
        logs, options, called=output.stem, vehicle=vehicle, from_s=from_s, to_s=to_s, columns=columns
    )
    if not accept:
        accepted(baseline, "--accept")
    baseline.save(output)
    if details:
        return say(*str(baseline).split("\n"), f"written to {output}")
    if baseline.layout_doubt:
        say(baseline.layout_doubt, err=True)
    count, hours = counted(len(baseline.provenance.logs), "flight"), baseline.healthy_hours
    written = f"written to {output}, from {count} of {60 * hours:.1f} min in all"
    return say(written, *baseline.conclusion.split("\n"))


def make_baseline(
    logs: Sequence[Path],
    options: LearnOptions,
    *,
    called: str = UNNAMED,
    vehicle: int | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    columns: Path | None = None,
) -> Baseline:
    """A baseline from logs as named, stamped now. called: where nothing names the airframe. columns: map of CSV."""
    with _taken("learning from", logs, vehicle, (from_s, to_s), columns) as (count, flights):
        if (options.sessions or 0) > count:
            raise UsageError(f"--sessions {options.sessions}: at most {count}, one for each log")
        found = learn(flights, options, created=now())
    named = replace(found.airframe, name=printable(called)) if found.airframe.name == UNNAMED else found.airframe
    return found.model_copy(update={"airframe": named})


@contextmanager
def _taken(
    what: str, logs: Sequence[Path], vehicle: int | None, cut: tuple[float | None, float | None], columns: Path | None
) -> Iterator[tuple[int, Iterator[Log]]]:
    """How many logs are named, and these, each read as it is taken; a spinner from the last one on.

    what: is done with them. cut: first and last time of the vehicle's clock that count [s], None for no limit.
    """
    found, mapped = opt.find_logs(logs, columns)
    count = len(found.paths())
    with ExitStack() as stack:

        def taken() -> Iterator[Log]:
            for log in each(found.logs, "read"):
                yield read_part(log.path, vehicle, *cut, mapped)
            stack.enter_context(working(f"{what} {counted(count, 'flight')} ..."))

        yield count, taken()


app = application("Look into a baseline file, or add healthy flights to it.")

File = Annotated[Path, Argument(help="Baseline made by `mavdiag identify`.")]


@app.command()
def show(file: File) -> None:
    """Print what a baseline says: whose it is, its thresholds with what supports them, and what cannot be judged."""
    say(*str(Baseline.load(file)).split("\n"))


@app.command()
def check(file: File) -> None:
    """Validate a baseline: schema, every field, digest. Exit code 0 if it is sound, else 2."""
    baseline = Baseline.load(file)
    say(f"{file}: sound, {baseline.digest}", baseline.promises)


@app.command()
def extend(
    file: File,
    logs: opt.Logs,
    output: opt.BaselineOutput,
    new_propellers: Annotated[bool, Option("--new-propellers", help="With new ones; 15 s of hover do.")] = False,
    accept: opt.Accept = False,
    vehicle: opt.Vehicle = None,
    from_s: opt.FromS = None,
    to_s: opt.ToS = None,
    columns: opt.Columns = None,
) -> None:
    """Add healthy flights of another session, or tell that the propellers are new."""
    check_output(output, *logs, columns, kind=AS_BASELINE)
    baseline = Baseline.load(file)
    with _taken("adding", logs, vehicle, (from_s, to_s), columns) as (_, flights):
        longer = extended(baseline, flights, new_propellers=new_propellers, created=now())
    if not accept:
        accepted(longer, "--accept")
    longer.save(output)
    say(*str(longer).split("\n"), f"written to {output}")
