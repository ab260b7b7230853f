"""The thesis's own monitor: how long the free-run residual stays above the healthy margin (T 5.5.1)."""

from dataclasses import dataclass
from typing import Literal

from mavdiag.decision.events import Reading
from mavdiag.errors import InputError
from mavdiag.identify import ArxModel
from mavdiag.monitors import exceedance as runs
from mavdiag.monitors.base import Rows
from mavdiag.monitors.exceedance import ExceedState
from mavdiag.monitors.margin import MarginRule
from mavdiag.monitors.residual import ResidualState, residual
from mavdiag.monitors.residual import start as residual_start
from mavdiag.telemetry import Axis

__all__ = ["RunLength", "RunLengthSpec", "RunLengthState"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunLengthSpec:
    """Healthy margin of one axis. longest_run_s: the longest healthy run of each flight.

    The FML is the monitor's threshold. Raises InputError if the margin is not positive.
    """

    kind: Literal["latency"] = "latency"
    axis: Axis
    margin_rad_s: float
    margin_rule: MarginRule
    longest_run_s: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.margin_rad_s > 0:
            raise InputError(f"latency: the margin must be positive, not {self.margin_rad_s:g} rad/s")


@dataclass(frozen=True, slots=True)
class RunLengthState:
    """Memory of the free-run simulation and of the open run."""

    residual: ResidualState
    run: ExceedState


@dataclass(frozen=True, slots=True, eq=False)
class RunLength:
    """Statistic: the fault signature duration FSD, the time [s] that |r| has been above the margin without a break.

    With r = y - y_sim (free run) of one axis and the margin M from healthy flights,
        FSD(k) = dt * (number of consecutive judged rows up to k with |r| > M),
    held against the fault minimal latency FML, the longest healthy run. A single outlier cannot raise it, however
    large: it takes a run. `level` is the highest |r| - M of the run so far [rad/s].

    Warm-up: one SG window, and the blanked first second of a segment. RunLength: half an SG window (50 ms), plus FML.
    Price: with FML the maximum of n healthy flights, one healthy flight in n + 1 of equal length alarms, by
    construction. Blind spots: vibration (the window passes 1.2 % of a 1/rev force at 167 Hz), a weak rotor that an
    integrator trims away, anything with a trace shorter than FML. Wind, payload and trajectories that the healthy
    flights did not have raise it without any fault.

    >>> import numpy as np
    >>> from mavdiag.monitors.base import Rows
    >>> from mavdiag.identify import ArxModel, Method
    >>> from mavdiag.rows.rates import RateBlock
    >>> model = ArxModel(np.array([1.0, -0.5]), np.array([0.0, 0.5]), 0.01, (1, 1, 1), Method.PUBLISHED)
    >>> rng, n = np.random.default_rng(7), 400
    >>> u = rng.standard_normal((n, 3))
    >>> y = np.stack([model.simulate(u[:, j]) for j in range(3)], axis=1) + 0.01 * rng.standard_normal((n, 3))
    >>> y[200:260] += 0.2   # something pushes for 0.6 s
    >>> rates = RateBlock(0, 0.01, np.arange(n) * 10_000_000, u, y, np.ones(n, dtype=bool))
    >>> monitor = RunLength(model, Axis.ROLL, margin=0.1)
    >>> _, reading = monitor.step(monitor.start(), Rows(None, rates))
    >>> round(float(reading.statistic.max()), 2), int(reading.statistic.argmax())
    (0.6, 259)
    """

    model: ArxModel
    axis: Axis
    margin: float

    @property
    def name(self) -> str:
        """Key in the baseline, the journal and the scan report."""
        return "latency"

    @property
    def unit(self) -> str:
        """Unit of the statistic."""
        return "s"

    def start(self) -> RunLengthState:
        """Nothing seen yet."""
        return RunLengthState(residual_start(), runs.start())

    def step(self, state: RunLengthState, rows: Rows) -> tuple[RunLengthState, Reading]:
        """FSD of each of the next rows."""
        rates = rows.rates
        fresh = rates.segment != state.residual.segment
        tracked, r = residual(self.model, self.axis, state.residual, rates)
        run, trace = runs.exceedance(
            runs.start() if fresh else state.run, r, rates.valid, margin=self.margin, dt_s=rates.dt_s
        )
        return RunLengthState(tracked, run), Reading(rates.t_ns, trace.fsd_s, trace.peak, r, rates.valid)
