"""The thesis rule on recorded flights with cut propellers (CrazyPAD, airframe E8), thresholds from its healthy flights.

    python benchmarks/crazypad_thesis.py FOLDER      (the data set's folder, with normal_flight/ and the others in it)

For roll and pitch, and for the free-run and the one-step residual: FML and margin from the five healthy flights (each
healthy flight itself judged by the other four), the logs flagged by total cut, and the area under the ROC curve of the
longest run and of the 90th percentile of |r|, all cuts against the healthy flights left out one at a time. The brackets
are 95 % bootstrap intervals over logs; logs of one propeller are not independent, so the true ones are wider.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from recorded_flights import BINS, total_cut_mm
from rich.console import Console
from rich.table import Table
from thesis_runs import Residual, longest_runs, margin_of, residuals

from mavdiag.identify import ArxModel, fit
from mavdiag.learning import LearntFlight, airborne, front_for
from mavdiag.logs import read_log
from mavdiag.monitors.run_length import training_pieces
from mavdiag.rows.front import Rows
from mavdiag.telemetry import Axis, FloatArray

Residuals = Callable[[Sequence[Rows], Axis, ArxModel], list[Residual]]


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """A flight and its label. cut_mm: total of both blades, None for tape and weights."""

    label: str
    cut_mm: float | None
    flight: LearntFlight


@dataclass(frozen=True, slots=True)
class Score:
    """Longest run above the margin [s] and 90th percentile of |r| [rad/s] of one flight."""

    fsd_s: float
    p90: float


def one_step(flight: Sequence[Rows], axis: Axis, model: ArxModel) -> list[Residual]:
    """One-step prediction residual of each piece of a flight."""
    pieces = []
    for rows in flight:
        rates = rows.rates
        if len(rates) > model.lag:
            u, y = rates.u[:, axis.column], rates.y[:, axis.column]
            r = y[model.lag :] - model.predict(u, y)
            pieces.append(Residual(rates.t_ns[model.lag :], r, rates.commanded[model.lag :], rates.dt_s))
    return pieces


def load(root: Path) -> tuple[list[Labelled], list[Labelled]]:
    """Healthy flights, and all others, airborne parts only."""
    flights = [(path.parent.name, read_log(path)) for path in sorted(root.glob("*/E8_log*"))]
    front = front_for([flight for label, flight in flights if label == "normal_flight"], 0.1)
    labelled = [Labelled(label, total_cut_mm(label), airborne(front, flight)) for label, flight in flights]
    healthy = [one for one in labelled if one.label == "normal_flight"]
    return healthy, [one for one in labelled if one.label != "normal_flight"]


def train(flights: Sequence[Labelled], axis: Axis) -> ArxModel:
    """SRIV model of the healthy flights."""
    pieces = [piece for one in flights for piece in training_pieces(one.flight.rows, axis)]
    return fit([u for u, _ in pieces], [y for _, y in pieces], dt=flights[0].flight.rows[0].rates.dt_s)


def scores(
    healthy: Sequence[Labelled], judged: Sequence[Labelled], axis: Axis, residual: Residuals
) -> tuple[float, list[Score]]:
    """FML of the healthy flights, and the score of each judged one by them."""
    model = train(healthy, axis)
    pieces = [residual(one.flight.rows, axis, model) for one in healthy]
    margin = margin_of(pieces)
    fml = float(longest_runs(pieces, margin).max())
    found = []
    for one in judged:
        own = residual(one.flight.rows, axis, model)
        size = np.concatenate([np.abs(piece.r[piece.valid]) for piece in own])
        found.append(Score(float(longest_runs([own], margin)[0]), float(np.percentile(size, 90, method="hazen"))))
    return fml, found


def auc(faulty: FloatArray, healthy: FloatArray) -> float:
    """Probability that a faulty flight scores above a healthy one (ties count half)."""
    return float(np.mean((faulty[:, None] > healthy) + 0.5 * (faulty[:, None] == healthy)))


def interval(faulty: FloatArray, healthy: FloatArray, seed: int) -> str:
    """AUC with its 95 % bootstrap interval over logs."""
    rng = np.random.default_rng(seed)
    again = [auc(rng.choice(faulty, len(faulty)), rng.choice(healthy, len(healthy))) for _ in range(1000)]
    low, high = np.percentile(again, [2.5, 97.5])
    return f"{auc(faulty, healthy):.2f} [{low:.2f}, {high:.2f}]"


def row(table: Table, axis: Axis, kind: str, healthy: Sequence[Labelled], others: Sequence[Labelled]) -> None:
    """One line of the table."""
    residual = residuals if kind == "free-run" else one_step
    fml, found = scores(healthy, others, axis, residual)
    flagged, left_out = 0, []
    for i, one in enumerate(healthy):
        limit, (own,) = scores([*healthy[:i], *healthy[i + 1 :]], [one], axis, residual)
        flagged += own.fsd_s > limit
        left_out.append(own)
    cuts = [(one.cut_mm, score) for one, score in zip(others, found, strict=True) if one.cut_mm is not None]
    cells = []
    for low, high in BINS:
        inside = [score.fsd_s > fml for mm, score in cuts if low < mm <= high]
        cells.append(f"{sum(inside)}/{len(inside)}")
    rest = [score.fsd_s > fml for one, score in zip(others, found, strict=True) if one.cut_mm is None]
    by_fsd = interval(np.array([s.fsd_s for _, s in cuts]), np.array([s.fsd_s for s in left_out]), seed=1)
    by_p90 = interval(np.array([s.p90 for _, s in cuts]), np.array([s.p90 for s in left_out]), seed=1)
    table.add_row(
        axis, kind, f"{fml:.3f}", *cells, f"{sum(rest)}/{len(rest)}", f"{flagged}/{len(healthy)}", by_fsd, by_p90
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    healthy, others = load(parser.parse_args().folder)
    table = Table(title=f"thesis rule on {len(healthy) + len(others)} recorded flights: logs with FSD > FML")
    for heading in ("axis", "residual", "FML s", "cut <=1.5 mm", "2-3", "3.5-5", ">5", "tape, weight", "healthy", "AUC, longest run", "AUC, p90 of |r|"):  # fmt: skip  # noqa: E501
        table.add_column(heading, justify="right")
    for axis in (Axis.ROLL, Axis.PITCH):
        for kind in ("free-run", "one-step"):
            row(table, axis, kind, healthy, others)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
