"""The thesis's own monitor: how long the free-run residual stays above the healthy margin (T 4.4.3-4.4.5, 5.5).

Free run means that no measured output enters the simulation, so a fault cannot explain itself away as it does in a
one-step prediction. A segment starts the model from the measured rate at rest in it; what that start gets wrong has
died out by the end of the segment's blanked first second.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import ArxModel, Method, Order, fit
from mavdiag.identify.model import ModelRecord
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Flights, LearnContext, Monitor, segments
from mavdiag.monitors.columns import COMMANDED, LEVEL, SIGNAL, SOUND, VALUE, Floats, Ints, U, Y
from mavdiag.monitors.fitting import cut_to_share
from mavdiag.monitors.spec import Delay, Positive, spec
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray, Signal
from mavdiag.thresholds.rule import Prior

TRAIN_ROWS = 60_000  # one minute at 1 kHz: beyond it a model's standard errors no longer matter (our choice)
SETTLE_S = 1.0  # of each stretch that does not count in the figures of fit: it may begin in motion (our choice)
MIN_PIECE_S = 2.0  # shorter valid stretches do not train a model (our choice)


class MarginRule(StrEnum):
    """How the margin follows from the healthy |r|."""

    PERCENTILE_90 = "p90"  # T text and Fig 4.1
    MAXIMUM = "max"  # T Algorithm 1


@spec
class RunLengthSpec:
    """One axis of the healthy airframe. The FML is the monitor's threshold.

    axis: the modelled body axis.
    model: rate on commanded rate, at the row period.
    margin_rad_s: what healthy |r| stays below, by `margin_rule` [rad/s].
    delay_s: half the window of the rate filters [s].
    """

    kind: Literal["fsd"] = "fsd"
    axis: Axis
    model: ModelRecord
    margin_rad_s: Positive
    margin_rule: MarginRule = MarginRule.PERCENTILE_90
    delay_s: Delay = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """The residual of one segment: t_ns, r [rad/s], valid: (n,)."""

    t_ns: IntArray
    r: FloatArray
    valid: BoolArray
    dt_s: float


@dataclass(frozen=True, slots=True)
class Run:
    """One run: first and last row (vehicle time), FSD [s], highest |r| - margin [rad/s]."""

    start_ns: int
    end_ns: int
    fsd_s: float
    peak: float


# Places in the parameters and in the memory; the coefficients of B and then of A follow, and the past of u and y.
DT, MARGIN, AXIS, INPUTS, OUTPUTS_BACK, TAPS = range(6)
BEGUN, COUNT, PEAK, PAST = range(4)


@jit
def free_run(par: FloatArray, taps: int, inputs: int, back: int, mem: FloatArray, past: int, u: float) -> float:
    """The next output y(t) = b_0 u(t) + b_1 u(t-1) + .. - a_1 y(t-1) - .. of a simulation (T 5.5).

    taps: where b_0 .. b_(inputs-1) and then a_1 .. a_back stand. past: of inputs - 1 inputs and then of `back` outputs,
    the newest first.
    """
    y, outputs = par[taps] * u, past + inputs - 1
    for i in range(1, inputs):
        y += par[taps + i] * mem[past + i - 1]
    for i in range(back):
        y -= par[taps + inputs + i] * mem[outputs + i]
    for i in range(inputs - 2, 0, -1):
        mem[past + i] = mem[past + i - 1]
    if inputs > 1:
        mem[past] = u
    for i in range(back - 1, 0, -1):
        mem[outputs + i] = mem[outputs + i - 1]
    if back:
        mem[outputs] = y
    return float(y)


@jit
def at_rest(mem: FloatArray, past: int, inputs: int, back: int, u: float, y: float) -> None:
    """Begin a simulation as if u and y had been the same for ever."""
    for i in range(inputs - 1):
        mem[past + i] = u
    for i in range(back):
        mem[past + inputs - 1 + i] = y


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """FSD of each row whose rates became known."""
    axis, inputs, back = int(par[AXIS]), int(par[INPUTS]), int(par[OUTPUTS_BACK])
    for i in range(lag, x.shape[1]):
        k, u, y = i - lag, x[U + axis, i], x[Y + axis, i]
        if mem[BEGUN] == 0.0:
            mem[BEGUN] = 1.0
            at_rest(mem, PAST, inputs, back, u, y if math.isfinite(y) else 0.0)
        r = y - free_run(par, TAPS, inputs, back, mem, PAST, u)
        sound = flags[COMMANDED, i] > 0.5 and math.isfinite(r)
        excess = abs(r) - par[MARGIN]
        if sound and excess > 0.0:
            mem[COUNT], mem[PEAK] = mem[COUNT] + 1.0, max(mem[PEAK], excess)
        else:
            mem[COUNT] = mem[PEAK] = 0.0
        out[VALUE, k], out[SOUND, k], out[LEVEL, k], out[SIGNAL, k] = mem[COUNT] * par[DT], sound, mem[PEAK], r
        at[k] = k
    return len(at) - lag


class RunLength(Monitor[RunLengthSpec]):
    """Statistic: the fault signature duration FSD, the time [s] that |r| has been above the margin without a break.

    With r = y - y_sim (free run) of one axis and the margin M from healthy flights,
        FSD(k) = dt * (number of consecutive judged rows up to k with |r| > M),
    compared with the fault minimal latency FML, the longest healthy run. A single outlier cannot raise it, however
    large: it takes a run. `level` is the highest |r| - M of the run so far [rad/s], `signal` is r.

    Warm-up: one SG window, and the blanked first second of a segment. Latency: half an SG window (50 ms), plus FML.
    False alarms: with FML the maximum of n healthy flights, one healthy flight in n + 1 of equal length alarms, by
    construction and whatever the airframe: n = 3 gives 0.25; 5 % with 95 % confidence needs n >= 59 (METHOD section
    4). Wind, payload and trajectories that the healthy flights did not have raise it without any fault, so it decides
    only where it is the only monitor. Blind spots: vibration (the window passes 1.2 % of a 1/rev force at 167 Hz), a
    weak rotor that an integrator trims away, anything with a trace shorter than FML.

    >>> from mavdiag.testing import example_rows
    >>> rate = 0.01 * np.random.default_rng(7).standard_normal((400, 3))
    >>> rate[200:260] += 0.2   # something pushes for 0.6 s
    >>> from mavdiag.identify import Method
    >>> model = ModelRecord(a=(1.0, -0.5), b=(0.0, 0.5), dt_s=0.01, order=(1, 1, 1), method=Method.PUBLISHED)
    >>> monitor = RunLength(RunLengthSpec(axis=Axis.ROLL, model=model, margin_rad_s=0.1))
    >>> _, found = monitor.step(monitor.start(), example_rows(400, rate=rate))
    >>> round(float(found.value.max()), 2), int(found.t_ns[found.value.argmax()] // 1_000_000)
    (0.6, 2590)
    """

    name = "fsd"
    label = "FSD"
    prior = Prior(flight=0.15)  # emulated: 0.13, 0.10, 0.10
    phrase = "attitude unlike the model"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT})
    depends = frozenset(
        {Condition.YAW_RATE, Condition.HEIGHT, Condition.COMMANDED_RATE, Condition.COMMANDED_ACCELERATION}
    )
    decides = False
    clear_s = 0.0
    by_rates = True
    spec_type = RunLengthSpec
    unit = "s"
    memory_s = SETTLE_S  # until the model has answered to it [s]

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[RunLengthSpec, ...]:
        """Model and margin of each axis that can be learnt. Raises with the reasons if none can."""
        found, reasons = [], []
        for axis in context.axes:
            try:
                found.append(_fit_axis(flights, axis, context))
            except (InputError, IdentificationError) as error:
                reasons.append(str(error))
        if not found:
            raise IdentificationError("; ".join(reasons) or "no axis to model")
        return tuple(found)

    @property
    def axis(self) -> Axis:
        """The modelled body axis."""
        return self.spec.axis

    @property
    def reference(self) -> float:
        """The margin [rad/s]."""
        return self.spec.margin_rad_s

    def parameters(self, dt_s: float) -> FloatArray:
        """See `TAPS`."""
        model = self.spec.model
        head = [dt_s, self.spec.margin_rad_s, self.spec.axis.column, len(model.b), len(model.a) - 1]
        return np.array([*head, *model.b, *model.a[1:]])

    def memory(self, dt_s: float) -> FloatArray:
        """No row yet, and no run is open."""
        return np.zeros(PAST + len(self.spec.model.b) + len(self.spec.model.a))

    run = staticmethod(run)


def exceedances(r: FloatArray, valid: BoolArray, margin: float, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """FSD so far [s] and highest |r| - margin so far, (n,), of whole records; 0 outside of runs.

    A run is a stretch of consecutive judged rows with |r| > margin; a row that must not be judged ends it.

    >>> fsd_s, peak = exceedances(np.array([0.0, 2.0, -3.0, 0.5, 4.0]), np.ones(5, dtype=bool), margin=1.0, dt_s=0.1)
    >>> fsd_s.tolist(), peak.tolist()
    ([0.0, 0.1, 0.2, 0.0, 0.1], [0.0, 1.0, 2.0, 0.0, 3.0])
    """
    excess = np.abs(r) - margin
    count, peak = np.zeros(len(r)), np.zeros(len(r))
    for first, stop in spans(valid & (excess > 0)):
        count[first:stop] = np.arange(1, stop - first + 1)
        peak[first:stop] = np.maximum.accumulate(excess[first:stop])
    return count * dt_s, peak


def runs(residual: Residual, margin: float) -> tuple[Run, ...]:
    """The runs above the margin in one segment, in order of time."""
    fsd_s, peak = exceedances(residual.r, residual.valid, margin, residual.dt_s)
    t_ns = residual.t_ns
    return tuple(
        Run(int(t_ns[first]), int(t_ns[stop - 1]), float(fsd_s[stop - 1]), float(peak[stop - 1]))
        for first, stop in spans(fsd_s > 0)
    )


def longest_runs(flights: Sequence[Sequence[Residual]], margin: float) -> FloatArray:
    """Longest run above the margin of each flight [s]; the largest of them is the FML of the thesis."""
    return np.array(
        [max((run.fsd_s for one in flight for run in runs(one, margin)), default=0.0) for flight in flights]
    )


def margin_of(flights: Sequence[Sequence[Residual]], rule: MarginRule = MarginRule.PERCENTILE_90) -> float:
    """Margin [rad/s] over all judged rows of all flights. Raises InputError if there are none.

    The percentile is Hazen's, which MATLAB's prctile uses.
    """
    levels = [np.abs(one.r[one.valid]) for flight in flights for one in flight]
    pooled = np.concatenate(levels) if levels else np.empty(0)
    if len(pooled) == 0:
        raise InputError("the healthy flights have no judged rows: are they long enough and airborne?")
    return float(pooled.max() if rule is MarginRule.MAXIMUM else np.percentile(pooled, 90, method="hazen"))


def residuals(flight: Sequence[Rows], axis: Axis, model: ArxModel) -> list[Residual]:
    """Free-run residual of each segment of a flight."""
    found, column = [], axis.column
    for segment in segments(flight):
        rates = [rows.rates for rows in segment if len(rows.rates)]
        if rates:
            t_ns, valid = np.concatenate([one.t_ns for one in rates]), np.concatenate([one.commanded for one in rates])
            u, y = (
                np.concatenate([one.u[:, column] for one in rates]),
                np.concatenate([one.y[:, column] for one in rates]),
            )
            rest = np.full(len(model.b), u[0]), np.full(len(model.a), np.nan_to_num(y[0]))
            found.append(Residual(t_ns, y - model.simulate(u, *rest), valid, rates[0].dt_s))
    return found


def training_pieces(flight: Sequence[Rows], axis: Axis) -> list[tuple[FloatArray, FloatArray]]:
    """Unbroken valid stretches of u and y of one axis, long enough to train on."""
    return [
        (rows.rates.u[first:stop, axis.column], rows.rates.y[first:stop, axis.column])
        for rows in flight
        for first, stop in spans(rows.rates.commanded)
        if (stop - first) * rows.rates.dt_s >= MIN_PIECE_S
    ]


def train(
    flights: Flights,
    axis: Axis,
    dt_s: float,
    order: Order = (2, 2, 1),
    method: Method = Method.SRIV,
    figures: bool = True,
    near: ArxModel | None = None,
) -> ArxModel:
    """A model of one axis from a like share of every flight (T 5.4). figures, near: as in `identify.fit`.

    Raises IdentificationError, naming the axis.
    """
    pieces = [piece for flight in flights for piece in training_pieces(flight, axis)]
    if not pieces:
        raise IdentificationError(f"{axis}: no unbroken stretch of {MIN_PIECE_S:.0f} s to identify from; fly longer")
    taken = cut_to_share([len(u) for u, _ in pieces], TRAIN_ROWS, round(MIN_PIECE_S / dt_s))
    u, y = ([piece[i][:count] for piece, count in zip(pieces, taken, strict=True)] for i in (0, 1))
    try:
        model = fit(u, y, order, dt=dt_s, method=method, settle_s=SETTLE_S, figures=figures, near=near)
    except IdentificationError as error:
        raise IdentificationError(f"{axis}: {error}") from error
    # The gain of a model with a pole at 1 that a zero cancels says nothing of the sign; the slope of y on u does.
    slope = sum(float(one @ other) for one, other in zip(u, y, strict=True)) / sum(float(one @ one) for one in u)
    gain = min(model.dc_gain, slope)
    if gain < 0:
        raise IdentificationError(
            f"{axis}: the gyro turns against its set-point (gain {gain:.2f}); check the sign conventions"
        )
    return model


def _fit_axis(flights: Flights, axis: Axis, context: LearnContext) -> RunLengthSpec:
    near = next((one.model.model() for one in context.near if one.axis == axis), None)
    model = train(flights, axis, context.dt_s, context.order, context.method, context.figures, near)
    rule = MarginRule(context.margin_rule)
    return RunLengthSpec(
        axis=axis,
        model=ModelRecord.of(model),
        margin_rad_s=margin_of([residuals(flight, axis, model) for flight in flights], rule),
        margin_rule=rule,
        delay_s=context.window // 2 * context.dt_s,
    )
