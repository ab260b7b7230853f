"""The residual r = y - y_sim of one axis, with y_sim the free-run output of the healthy model (T 5.5).

Free run means that no measured output enters the simulation, so a fault cannot explain itself away as it does in a
one-step prediction. A new segment starts the model from the measured rate at rest in it; what that start gets wrong
has died out by the end of the segment's blanked first second.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.identify import ArxModel, freerun
from mavdiag.identify.freerun import FreeRunState
from mavdiag.rows.rates import RateBlock
from mavdiag.telemetry import Axis, FloatArray

__all__ = ["ResidualState", "residual", "start"]


@dataclass(frozen=True, slots=True)
class ResidualState:
    """Segment of the last rows and the model's memory, None before the first row."""

    segment: int
    run: FreeRunState | None


def start() -> ResidualState:
    """No row seen yet."""
    return ResidualState(-1, None)


def residual(model: ArxModel, axis: Axis, state: ResidualState, rates: RateBlock) -> tuple[ResidualState, FloatArray]:
    """Residual of the next rows, (n,) [rad/s]."""
    u, y = rates.u[:, axis.column], rates.y[:, axis.column]
    run = state.run if rates.segment == state.segment else None
    if len(y) == 0:
        return ResidualState(rates.segment, run), np.empty(0)
    if run is None:
        run = freerun.start(model, np.full(len(model.b), u[0]), np.full(len(model.a), y[0]))
    run, y_sim = freerun.step(model, run, u)
    return ResidualState(rates.segment, run), y - y_sim
