"""The thesis's table on its own flights, DronePropA: what each figure says of nine faults and of three drones.

    python benchmarks/droneprop_table.py FOLDER --baseline d1.json [--speed 1] [--trajectory 2] [--gyro filtered]

FOLDER holds the .mat files as they were unpacked; d1.json was made by `mavdiag identify` from healthy flights of D1,
the drone that flew the faults. Figures are of roll. Free run and one step are two residuals, and are named apart:

    asymmetry    mean of (o2 + o4) - (o1 + o3), front less rear motor commands, less D1's other healthy flights
    FSD, FML     free run (T 5.5): SRIV model of D2 and D3, margin p90 of all healthy flights, FML their longest run
    one step     90th percentile of |y - prediction|, of a least-squares ARX(2,2,1) of D2 and D3
    verdict      of `mavdiag scan` with the baseline; of a flight that taught it, it says nothing

D2 and D3 are other airframes: a verdict on them by the baseline of D1 tells airframes apart, not damage.
"""

import argparse
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from crazypad_thesis import one_step
from rich.console import Console
from rich.table import Table
from thesis_runs import Residual, longest_runs, margin_of, residuals

from mavdiag.baseline import Baseline
from mavdiag.errors import InputError
from mavdiag.identify import Method, fit
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearntFlight, airborne, front_for
from mavdiag.logs import read_log
from mavdiag.logs.dronepropa import FILTERED_PROFILE, PROFILE
from mavdiag.monitors.run_length import training_pieces
from mavdiag.telemetry import Axis, FloatArray

__all__ = ["Line", "Name", "table_of"]

NAME = re.compile(r"F(\d)_SV(\d)_SP(\d)_t(\d)(?:_D(\d))?(?:_R(\d))?\.mat")
WINDOW_S = 0.1
GYROS = {"raw": PROFILE, "filtered": FILTERED_PROFILE}


@dataclass(frozen=True, slots=True, order=True)
class Name:
    """What a file's name says. Faults were flown by D1, once each: their names have neither drone nor repetition."""

    fault: int
    severity: int
    drone: int
    repetition: int
    speed: int
    trajectory: int

    @classmethod
    def of(cls, file: str) -> "Name | None":
        """The parts of a name such as F0_SV0_SP1_t2_D1_R3.mat; None for another one."""
        match = NAME.fullmatch(file)
        if match is None:
            return None
        fault, severity, speed, trajectory, drone, repetition = (int(part or 0) for part in match.groups())
        return cls(fault, severity, drone or 1, repetition, speed, trajectory)

    @property
    def healthy(self) -> bool:
        """Whether no propeller was damaged."""
        return self.fault == 0

    @property
    def label(self) -> str:
        """How the table calls the flight."""
        repeated = f", R{self.repetition}" if self.repetition else ""
        return f"healthy D{self.drone}{repeated}" if self.healthy else f"F{self.fault}/SV{self.severity}"


@dataclass(frozen=True, slots=True)
class Line:
    """One flight of the table. fsd_s: free run. one_step_p90, free_run_rms: [rad/s]."""

    name: Name
    asymmetry: float
    fsd_s: float
    free_run_rms: float
    one_step_p90: float
    verdict: str


@dataclass(frozen=True, slots=True, eq=False)
class _Flight:
    """A flight of the table; taught: the baseline was learnt from it."""

    name: Name
    rows: LearntFlight
    verdict: str

    @property
    def front_less_rear(self) -> float:
        """Mean of (o2 + o4) - (o1 + o3) in judged flight."""
        o = np.concatenate([rows.block.actuator[rows.block.valid] for rows in self.rows.rows])
        return float(np.nanmean(o @ [-1.0, 1.0, -1.0, 1.0]))


def table_of(
    folder: Path, baseline: Baseline, speed: int = 1, trajectory: int = 2, gyro: str = "raw"
) -> tuple[list[Line], float, float]:
    """The lines, the margin [rad/s] and the FML [s].

    gyro: of the residuals; the verdict needs the gyro that the baseline was learnt from.
    Raises InputError if there are no such flights, or no healthy flight of D1 or of the other drones among them.
    """
    names = {path: name for path in sorted(folder.glob("*.mat")) if (name := Name.of(path.name)) is not None}
    wanted = {path: n for path, n in names.items() if (n.speed, n.trajectory) == (speed, trajectory)}
    flights = _flights(wanted, baseline, GYROS[gyro])
    own = [one for one in flights if one.name.healthy and one.name.drone == 1]
    others = [one for one in flights if one.name.healthy and one.name.drone != 1]
    if len(own) < 2 or not others:
        raise InputError(
            f"{folder}: it needs F0_SV0_SP{speed}_t{trajectory} of D1 (two or more) and of D2 or D3; unpack them there"
        )
    pieces = [piece for one in others for piece in training_pieces(one.rows.rows, Axis.ROLL)]
    u, y, dt_s = [u for u, _ in pieces], [y for _, y in pieces], own[0].rows.rows[0].rates.dt_s
    free, single = fit(u, y, dt=dt_s), fit(u, y, dt=dt_s, method=Method.LS)
    simulated = [residuals(one.rows.rows, Axis.ROLL, free) for one in flights]
    healthy = [found for one, found in zip(flights, simulated, strict=True) if one.name.healthy]
    margin = margin_of(healthy)
    lines = [
        Line(
            one.name,
            one.front_less_rear - float(np.mean([other.front_less_rear for other in own if other is not one])),
            float(longest_runs([found], margin)[0]),
            float(np.sqrt(np.mean(_judged(found) ** 2))),
            float(np.percentile(np.abs(_judged(one_step(one.rows.rows, Axis.ROLL, single))), 90)),
            one.verdict,
        )
        for one, found in zip(flights, simulated, strict=True)
    ]
    return lines, margin, float(longest_runs(healthy, margin).max())


def _flights(files: dict[Path, Name], baseline: Baseline, profile: str) -> list[_Flight]:
    """The flights in the order of the table, one in memory at a time but for its rows."""
    taught = {source.sha256 for source in baseline.provenance.logs}
    found = []
    for path, name in sorted(files.items(), key=lambda item: item[1]):
        log = read_log(path, profile=profile)
        same = read_log(path, profile=baseline.link.profile) if profile != baseline.link.profile else log
        verdict = judge(same, baseline)
        plain = verdict.verdict is Verdict.HEALTHY and not log.notes
        reason = verdict.reason.partition(";")[0] if plain else verdict.reason
        said = "(taught the baseline)" if log.sha256 in taught else f"{verdict.verdict}: {reason}"
        found.append(_Flight(name, airborne(front_for([log], WINDOW_S), log), said))
    return found


def _judged(found: Sequence[Residual]) -> FloatArray:
    """The residual wherever it may be judged."""
    return np.concatenate([one.r[one.valid & np.isfinite(one.r)] for one in found])


def main() -> int:
    """Print the table; 2 if it cannot be made."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--baseline", type=Path, required=True)
    parser.add_argument("--speed", type=int, choices=(1, 2), default=1)
    parser.add_argument("--trajectory", type=int, choices=range(1, 6), default=2)
    parser.add_argument("--gyro", choices=tuple(GYROS), default="raw")
    told = parser.parse_args()
    try:
        lines, margin, fml_s = table_of(
            told.folder, Baseline.load(told.baseline), told.speed, told.trajectory, told.gyro
        )
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    table = Table(title=f"DronePropA SP{told.speed}, t{told.trajectory}, roll, {told.gyro} gyro")
    for heading in ("flight", "asymmetry\nx 1e-3", "FSD s\nfree run", "rms mrad/s\nfree run", "p90 mrad/s\none step"):
        table.add_column(heading, justify="left" if heading == "flight" else "right")
    table.add_column("verdict", overflow="fold")
    for one in lines:
        table.add_row(
            one.name.label, f"{1e3 * one.asymmetry:.1f}", f"{one.fsd_s:.3f}", f"{1e3 * one.free_run_rms:.2f}",
            f"{1e3 * one.one_step_p90:.2f}", one.verdict,
        )  # fmt: skip
    console = Console(width=150, highlight=False)
    console.print(table)
    console.print(f"free run: margin {1e3 * margin:.2f} mrad/s, FML {fml_s:.3f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
