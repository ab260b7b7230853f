"""How the filter window changes the fit of the model on this flight: T Fig 5.5."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify import Method, Order
from mavdiag.identify.lab.sweep import SweepRow, window_sweep
from mavdiag.monitors.training import MIN_PIECE_S
from mavdiag.report.style import COMMANDED, LINES, Picture, drawn, legend_above
from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Sweep", "sweep_of", "windows_picture"]

WINDOWS_S = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
LEAST = 5  # samples: the shortest window of a parabola that smooths
MOST_ROWS = 20_000  # of the flight that are fitted: seven fits of an axis take about a second (our choice)
EMPTY = Picture(
    "windows",
    "Fit of the model against the length of the filter window",
    "A short window leaves noise that no model explains and a long one smooths the motion away: the baseline's own "
    "window (dotted) should lie where the curve is high and flat.",
    "5.5",
)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One axis. rows: a candidate for each window, in order."""

    axis: Axis
    dt_s: float
    rows: tuple[SweepRow, ...]

    @property
    def known(self) -> tuple[tuple[float, float], ...]:
        """Window [s] and R_T^2 of those that could be fitted."""
        return tuple((row.window * self.dt_s, row.model.r2t) for row in self.rows if row.model is not None)


def sweep_of(blocks: Sequence[Block], axis: Axis, order: Order, method: Method, polynomial: int) -> Sweep:
    """Fit a model of one axis to the beginning of the flight at each window. polynomial: order of the filter."""
    dt_s = blocks[0].dt_s
    blocks = _beginning(blocks)
    counts = sorted({max(round(span / dt_s) | 1, LEAST, polynomial + 1 | 1) for span in WINDOWS_S})
    rows: list[SweepRow] = []
    for count in counts:
        spec = RateSpec.of(dt_s, count, polynomial)
        try:
            rows += window_sweep(partial(_pieces, blocks, axis, spec), [count], dt=dt_s, order=order, method=method)
        except IdentificationError as error:
            rows.append(SweepRow(order, count, None, math.nan, str(error)))
    return Sweep(axis, dt_s, tuple(rows))


def windows_picture(sweeps: Sequence[Sweep], window_s: float) -> Picture:
    """R_T^2 against the window. window_s: the baseline's."""
    known = [one for one in sweeps if one.known]
    if not known:
        reasons = {row.refused for one in sweeps for row in one.rows if row.refused}
        why = min(reasons, default="it takes attitude set-points and a model in the baseline")
        return replace(EMPTY, not_drawn=f"no model could be fitted to this flight: {why}")

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for line, one in zip(LINES, known, strict=False):
            x, y = zip(*one.known, strict=True)
            axes.plot(x, y, "o", color=line.color, linestyle=line.stroke, label=one.axis.value)
        axes.axvline(
            window_s, color=COMMANDED.color, linestyle=COMMANDED.stroke, label=f"baseline's window, {window_s:.3g} s"
        )
        axes.set(xlabel="window [s]", ylabel="fit R_T² of the simulated rate", xscale="log", ylim=(None, 1.02))
        axes.set_xticks(WINDOWS_S, [f"{one:g}" for one in WINDOWS_S], minor=False)
        axes.minorticks_off()
        legend_above(axes)

    best = "; ".join(f"{one.axis}: best {max(y for _, y in one.known):.3f}" for one in known)
    return replace(EMPTY, svg=drawn(EMPTY.title, f"{best}.", plot, 2.6))


def _beginning(blocks: Sequence[Block]) -> list[Block]:
    """The first `MOST_ROWS` rows."""
    out, left = [], MOST_ROWS
    for block in blocks:
        out.append(block.rows(0, min(left, len(block))))
        left -= len(out[-1])
        if left <= 0:
            break
    return out


def _pieces(blocks: Sequence[Block], axis: Axis, spec: RateSpec, _: int) -> tuple[list[FloatArray], list[FloatArray]]:
    """u and y of each stretch that can train a model, filtered by this window."""
    state, out = spec.start(), []
    for _, segment in groupby(blocks, key=lambda one: one.segment):
        parts = []
        for block in segment:
            state, rates = spec.step(state, block)
            parts.append(rates)
        u, y = (np.concatenate([getattr(one, name)[:, axis.column] for one in parts]) for name in ("u", "y"))
        for first, stop in spans(np.concatenate([one.commanded for one in parts])):
            if (stop - first) * parts[0].dt_s >= MIN_PIECE_S:
                out.append((u[first:stop], y[first:stop]))
    return [u for u, _ in out], [y for _, y in out]
