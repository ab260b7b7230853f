"""The diagnosis on recorded flights, by the public API and its defaults: what `identify` and `scan` would say.

    python benchmarks/recorded_flights.py FOLDER      (with crazypad, ardupilot_real, arducopter_sitl, px4_real in it)

Thresholds come from the healthy flights of the judged airframe alone. CrazyPAD: every choice of five, four and
three of its five healthy flights teaches, and all other flights are judged.
"""

import argparse
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

from mavdiag.baseline import Baseline
from mavdiag.judging import LogVerdict, Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import between, read_log
from mavdiag.telemetry import Log

PROPELLER_MM = 47.0
BINS = ((0.0, 1.5), (1.5, 3.0), (3.0, 5.0), (5.0, 99.0))
CUT_ROTOR = 3
STAMP = "1970-01-01T00:00:00+00:00"


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """A log and what its folder says of it. cut_mm: total cut, None if it is none."""

    label: str
    cut_mm: float | None
    log: Log


def total_cut_mm(folder: str) -> float | None:
    """Total length cut off both blades, from a name such as cut_propeller_M3_4mm_3.5mm_39.5mm."""
    if not folder.startswith("cut_propeller"):
        return None
    lengths = [float(part.removesuffix("mm")) for part in folder.split("_") if part.endswith("mm")]
    return PROPELLER_MM - lengths[-1] if lengths[-1] > PROPELLER_MM / 2 else lengths[-1]


def taught(logs: Sequence[Log]) -> Baseline:
    """A baseline by the defaults."""
    return learn(logs, LearnOptions(), created=STAMP)


def part(log: Log, from_s: float | None, to_s: float | None) -> Log:
    """The log between two times of the vehicle's clock."""
    return replace(log, telemetry=between(log.telemetry, from_s, to_s))


def layout_of(baseline: Baseline) -> str:
    """Name of the rotor layout that its flights show."""
    return "none" if baseline.airframe.layout is None else baseline.airframe.layout.name


def rotor_of(verdict: LogVerdict) -> int | None:
    """The rotor that was named last."""
    return next((one.rotor for one in reversed(verdict.changes) if one.rotor is not None), None)


def flagged(judged: Sequence[tuple[Labelled, LogVerdict]], holds: Callable[[Labelled], bool]) -> str:
    """Declared + only suspected, of all logs of which something holds."""
    found = [verdict.verdict for one, verdict in judged if holds(one)]
    return f"{found.count(Verdict.FAULT)}+{found.count(Verdict.SUSPECTED)}/{len(found)}" if found else ""


def columns(judged: Sequence[tuple[Labelled, LogVerdict]]) -> list[str]:
    """Flagged by bins of total cut, and of the other kinds of logs."""

    def cut(low: float, high: float) -> Callable[[Labelled], bool]:
        return lambda one: one.cut_mm is not None and low < one.cut_mm <= high

    def named(prefix: str) -> Callable[[Labelled], bool]:
        return lambda one: one.label.startswith(prefix)

    holds = [*(cut(low, high) for low, high in BINS), named("tape"), named("add_weight"), named("normal")]
    return [flagged(judged, each) for each in holds]


def crazypad(console: Console, folder: Path) -> None:
    """Cuts found by size, healthy flights flagged, rotor named, severity ranked."""
    logs = [
        Labelled(path.parent.name, total_cut_mm(path.parent.name), read_log(path))
        for path in sorted(folder.glob("*/E8_log*"))
    ]
    healthy = [one for one in logs if one.label == "normal_flight"]
    table = Table(title="CrazyPAD E8: logs with a fault + only a suspicion, of all; every choice of teaching flights")
    for heading in ("taught by", "cut <=1.5 mm", "2-3", "3.5-5", ">5", "tape", "weight", "left-out healthy"):
        table.add_column(heading, justify="right")
    for flights in (5, 4, 3):
        judged = []
        for teaching in itertools.combinations(healthy, flights):
            base = taught([one.log for one in teaching])
            judged += [(one, judge(one.log, base)) for one in logs if one not in teaching]
        table.add_row(str(flights), *columns(judged))
        large = [v for one, v in judged if (one.cut_mm or 0) > 2 and v.verdict is Verdict.FAULT]
        right, unnamed = (sum(rotor_of(v) == rotor for v in large) for rotor in (CUT_ROTOR, None))
        console.print(
            f"{flights} flights: M3 named in {right} of {len(large)} declared cuts above 2 mm, none in {unnamed}"
        )
        if flights == len(healthy):
            rises = ((one.cut_mm, next(m.maximum for m in v.monitors if m.name == "rotor_trim")) for one, v in judged)
            ranked = [(mm, rise) for mm, rise in rises if mm is not None and rise is not None]
            rank = spearmanr([mm for mm, _ in ranked], [rise for _, rise in ranked]).statistic
            console.print(f"severity: rank correlation of the trim shift with the total cut {rank:.3f}")
    console.print(table)


def line(name: str, verdict: LogVerdict) -> str:
    """One judged log: verdict and reason."""
    return f"  {name}: {verdict.verdict}, {verdict.reason}"


def ardupilot(console: Console, folder: Path) -> None:
    """A real quadcopter: its own loiter teaches, the rest of it and the upset are judged."""
    log = read_log(folder / "log171.bin")
    base = taught([part(log, 75, 146)])
    console.print("log171.bin, taught by its loiter from 75 to 146 s")
    console.print(line("146 to 217 s, loiter", judge(part(log, 146, 217), base)))
    console.print(line("146 to 239.6 s, with the upset", judge(part(log, 146, 239.6), base)))


def arducopter(console: Console, folder: Path) -> None:
    """A real autopilot in simulation: one healthy log teaches, all others are judged."""
    logs = {path.stem: read_log(path) for path in sorted(folder.glob("*quad3kg*.tlog"))}
    for name in (name for name in logs if name.startswith("healthy")):
        base = taught([logs[name]])
        console.print(f"ArduCopter 3 kg, taught by {name}, rotor layout found: {layout_of(base)}")
        for other in (other for other in logs if other != name):
            console.print(line(other, judge(logs[other], base)))
    healthy = read_log(folder / "healthy_jsonplant2_sq1.tlog")
    middle_s = float(healthy.telemetry.series[0].t_ns.min()) / 1e9 + 60
    base = taught([part(healthy, None, middle_s)])
    console.print(f"ArduCopter, external physics, taught by its first minute, rotor layout found: {layout_of(base)}")
    console.print(line("second minute", judge(part(healthy, middle_s, None), base)))
    damaged = read_log(folder / "fault_jsonplant2_m1_eff090_imb_sq1.tlog")
    console.print(line("efficiency 0.90 and unbalance", judge(damaged, base)))


def px4(console: Console, folder: Path) -> None:
    """A bench log without thrust can teach nothing and be judged by nothing."""
    log = read_log(folder / "pyulog_sample.ulg")
    own = replace(log, profile="ardupilot-log")
    base = taught([part(read_log(folder.parent / "ardupilot_real" / "log171.bin"), 75, 146)])
    console.print(line("px4 bench log", judge(log, base)))
    console.print(line("px4 bench log, taken for one of the same link", judge(own, base)))


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    console = Console(width=150, highlight=False)
    crazypad(console, folder / "crazypad")
    ardupilot(console, folder / "ardupilot_real")
    arducopter(console, folder / "arducopter_sitl")
    px4(console, folder / "px4_real")


if __name__ == "__main__":
    main()
