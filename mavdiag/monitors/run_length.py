"""The thesis's own monitor: how long the free-run residual stays above the healthy margin (T 4.4.3-4.4.5, 5.5).

    y(t) = b_0 u(t) + b_1 u(t-1) + .. - a_1 y(t-1) - ..          no measured output enters the simulation

A segment starts the model from the measured rate at rest in it; what that gets wrong dies out in the blanked first
second.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Literal

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import ArxModel, fit
from mavdiag.identify.arx import ModelRecord, without_rounding
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Begin, Flights, LearnContext, Monitor, parted, walk
from mavdiag.monitors.fitting import cut_to_share, of_each
from mavdiag.monitors.spec import Delay, Positive, spec
from mavdiag.rows.block import COMMANDED, LEVEL, RESIDUAL, SOUND, VALUE, Floats, Ints, U, Y
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import spans
from mavdiag.telemetry import Axis, BoolArray, FloatArray, Signal

TRAIN_ROWS = 60_000  # one minute at 1 kHz: beyond it a model's standard errors no longer matter (our choice)
SETTLE_S = 1.0  # of each stretch that does not count in the figures of fit: it may begin in motion (our choice)
MIN_PIECE_S = 2.0  # shorter valid stretches do not train a model (our choice)
LEAST_MARGIN = 0.02  # rad/s, which RotorPy's gusts of 1 m/s make of a vehicle of 30 g (rms; our choice)
# A rate that is followed for so long trains beside the flights: in a calm hover the command follows the vehicle, which
# alone tells a gain of 0.1 or 1.6. It is about a hundredth of what one minute of squares tells (our choice).
STEADY_RAD_S, STEADY_S = 0.2, 5.0
# Places in the parameters, where the coefficients of B and A follow; and in the memory, where those of the model do.
DT, MARGIN, AXIS, ORDER, TAPS = range(5)
BEGUN, COUNT, PEAK, PAST = range(4)


class MarginRule(StrEnum):
    """How the margin follows from the healthy |r|."""

    PERCENTILE_90 = "p90"  # T text and Fig 4.1
    MAXIMUM = "max"  # T Algorithm 1


@spec
class RunLengthSpec:
    """One axis of the healthy airframe. The FML is the monitor's threshold."""

    kind: Literal["fsd"] = "fsd"
    axis: Axis
    model: ModelRecord  # rate on commanded rate, at the row period
    margin_rad_s: Positive  # what healthy |r| stays below, by the rule
    margin_rule: MarginRule = MarginRule.PERCENTILE_90
    delay_s: Delay = 0.0  # half the window of the rate filters


def taps_of(model: ModelRecord) -> list[float]:
    """b_0 .. b_m and a_1 .. a_m, as `free_run` reads them; m is at least 1."""
    order = max(len(model.b), len(model.a), 2) - 1
    b, a = np.zeros(order + 1), np.zeros(order + 1)
    b[: len(model.b)], a[: len(model.a)] = model.b, model.a
    return [*b.tolist(), *a[1:].tolist()]


@jit
def free_run(par: FloatArray, taps: int, order: int, mem: FloatArray, past: int, u: float) -> float:
    """The next output of a simulation (T 5.5), in the transposed direct form: s_k <- b_k u - a_k y + s_(k+1).

    taps: where b_0 .. b_order and a_1 .. a_order stand. past: where s_1 .. s_order do.
    """
    y, after = par[taps] * u + mem[past], 0.0
    for k in range(order, 0, -1):
        after, mem[past + k - 1] = mem[past + k - 1], par[taps + k] * u - par[taps + order + k] * y + after
    return float(y)


@jit
def at_rest(par: FloatArray, taps: int, order: int, mem: FloatArray, past: int, u: float, y: float) -> None:
    """Begin a simulation as if u and y had been the same for ever."""
    rest = 0.0
    for k in range(order, 0, -1):
        rest += par[taps + k] * u - par[taps + order + k] * y
        mem[past + k - 1] = rest


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """FSD of each row whose rates became known."""
    axis, order, margin, dt_s = int(par[AXIS]), int(par[ORDER]), par[MARGIN], par[DT]
    count, peak = mem[COUNT], mem[PEAK]
    for i in range(known, x.shape[1]):
        k, u, y = i - known, x[U + axis, i], x[Y + axis, i]
        if mem[BEGUN] == 0.0:
            mem[BEGUN] = 1.0
            at_rest(par, TAPS, order, mem, PAST, u, y if math.isfinite(y) else 0.0)
        r = y - free_run(par, TAPS, order, mem, PAST, u)
        sound = x[COMMANDED, i] > 0.5 and math.isfinite(r)
        excess = abs(r) - margin
        if sound and excess > 0.0:
            count, peak = count + 1.0, max(peak, excess)
        else:
            count = peak = 0.0
        out[VALUE, k], out[SOUND, k], out[LEVEL, k], out[RESIDUAL, k], at[k] = count * dt_s, sound, peak, r, k
    mem[COUNT], mem[PEAK] = count, peak
    return len(at) - (known - first)


class RunLength(Monitor[RunLengthSpec]):
    """Statistic: the fault signature duration FSD, the time [s] that |r| has been above the margin without a break.

        FSD(k) = dt * (number of consecutive judged rows up to k with |r| > M),    r = y - y_sim

    M: margin of healthy flights; the threshold is the fault minimal latency FML, the longest healthy run. `level` is
    the highest |r| - M of the run so far [rad/s], `signal` is r.

    Warm-up: one SG window, and the blanked first second of a segment. Latency: half an SG window (50 ms), plus FML.
    False alarms: with FML the maximum of n healthy flights, one healthy flight in n + 1 of equal length alarms (METHOD
    section 4), and more in wind or on other trajectories, so it decides only where it is the only monitor. Blind spots:
    vibration (the window passes 1.2 % of a 1/rev force at 167 Hz), a weak rotor that an integrator trims away.
    """

    name = "fsd"
    label = "FSD"
    observes = "how long the body rate differs from the model's (the thesis's rule)"
    phrase = "attitude unlike the model"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT})
    depends = frozenset(
        {Condition.YAW_RATE, Condition.HEIGHT, Condition.COMMANDED_RATE, Condition.COMMANDED_ACCELERATION}
    )
    decides = False
    clear_s = 0.0
    least = 0.05  # half an SG window: a glitch of the gyro is seen twice as long (our choice)
    least_hz = 20.0  # below it the loop has answered between two samples (our choice)
    by_rates = True
    shown = RESIDUAL
    spec_type = RunLengthSpec
    unit = "s"
    memory_s = 2 * SETTLE_S  # until the model has answered to it, and what was off then has ended [s]
    run = staticmethod(run)

    def __init__(self, spec: RunLengthSpec) -> None:
        super().__init__(spec)
        self.axis, self.reference = spec.axis, spec.margin_rad_s

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[RunLengthSpec, ...]:
        """Model and margin of each axis that can be learnt. Raises with the reasons if none can."""
        found, reasons, rule = list[RunLengthSpec](), [], MarginRule(context.margin_rule)
        for axis in context.axes:
            try:
                delay_s, model = context.delay_s, ModelRecord.of(_train(flights, axis, context))
                found.append(RunLengthSpec(axis=axis, model=model, margin_rad_s=1.0, margin_rule=rule, delay_s=delay_s))
            except (InputError, IdentificationError) as error:
                reasons.append(str(error))
        if not found:
            raise IdentificationError("; ".join(reasons) or "no axis to model")
        return tuple(
            replace(one, margin_rad_s=margin) for one, margin in zip(found, _margins(found, flights), strict=True)
        )

    def begin(self, dt_s: float) -> Begin:
        """No row yet, and no run is open."""
        taps = taps_of(self.spec.model)
        order = len(taps) // 2
        par = np.array([dt_s, self.spec.margin_rad_s, self.spec.axis.column, order, *taps])
        return Begin(par, np.zeros(PAST + order))


def _margins(specs: Sequence[RunLengthSpec], flights: Flights) -> list[float]:
    """Margin [rad/s] of each axis over all judged rows of all flights, whose rates are looked at once; the percentile
    is Hazen's, which MATLAB's prctile uses. Calm flights do not show weather: no margin is below LEAST_MARGIN.
    Raises InputError if there are no such rows.
    """
    levels, monitors = [[np.empty(0)] for _ in specs], list(map(RunLength, specs))
    for judged in (piece for flight in flights for piece in walk(monitors, flight)):
        for found, (statistic, out) in zip(levels, judged, strict=True):
            found.append(np.abs(out[RESIDUAL, statistic.valid]))
    if sum(map(len, levels[0])) == 0:
        raise InputError("the healthy flights have no judged rows: are they long enough and airborne?")
    most = specs[0].margin_rule is MarginRule.MAXIMUM
    joined = (np.concatenate(found) for found in levels)
    shown = (float(one.max() if most else np.percentile(one, 90, method="hazen")) for one in joined)
    return [max(margin, LEAST_MARGIN) for margin in shown]


def training_spans(flight: Sequence[Rows]) -> list[tuple[int, int]]:
    """Valid stretches [first, stop) of all rates of a flight, long enough to train on, of at most `TRAIN_ROWS`."""
    segments, dt_s = list[list[BoolArray]](), 1.0
    for begins, rows in parted(flight):
        segments += [[]] if begins else []
        segments[-1].append(rows.rates.commanded)
        dt_s = rows.rates.dt_s
    found, at = list[tuple[int, int]](), 0
    for commanded in map(np.concatenate, segments):
        for first, stop in spans(commanded):
            found += [(at + k, at + min(k + TRAIN_ROWS, stop)) for k in range(first, stop, TRAIN_ROWS)]
        at += len(commanded)
    return [(first, stop) for first, stop in found if stop - first >= MIN_PIECE_S / dt_s]


def _rates_of(
    flight: Sequence[Rows], stretches: Sequence[tuple[int, int]], axis: Axis
) -> list[tuple[FloatArray, FloatArray]]:
    """u and y of one axis in stretches; copies, so that of what is mapped no more stays in memory."""
    parts, at = [list[FloatArray]() for _ in stretches], 0
    for rates in (rows.rates for rows in flight):
        for found, (first, stop) in zip(parts, stretches, strict=True):
            own = slice(max(first - at, 0), max(stop - at, 0))
            found.append(np.stack((rates.u[own, axis.column], rates.y[own, axis.column])))
        at += len(rates)
    pairs = [np.concatenate(found, axis=1) for found in parts]
    return [(without_rounding([u], [y])[0], y) for u, y in pairs]


def training_pieces(flight: Sequence[Rows], axis: Axis) -> list[tuple[FloatArray, FloatArray]]:
    """u and y of one axis in each of the stretches to train on."""
    return _rates_of(flight, training_spans(flight), axis)


def _train(flights: Flights, axis: Axis, context: LearnContext) -> ArxModel:
    """A model of one axis from a like share of every flight (T 5.4). Raises IdentificationError, naming the axis."""
    places = of_each(flights, "training spans", training_spans)
    lengths = [stop - first for stretches in places for first, stop in stretches]
    if not lengths:
        raise IdentificationError(f"{axis}: no unbroken stretch of {MIN_PIECE_S:.0f} s to identify from; fly longer")
    dt_s, near = context.dt_s, next((one.model.model() for one in context.near if one.axis == axis), None)
    taken = iter(cut_to_share(lengths, TRAIN_ROWS, round(MIN_PIECE_S / dt_s)))
    shares = [[(first, first + next(taken)) for first, _ in stretches] for stretches in places]
    pairs = [pair for found in map(_rates_of, flights, shares, itertools.repeat(axis)) for pair in found]
    u, y = [one for one, _ in pairs], [one for _, one in pairs]
    figures, method, steady = context.figures, context.method, np.full(round(STEADY_S / dt_s), STEADY_RAD_S)
    try:
        model = fit(
            u, y, context.order, dt=dt_s, method=method, settle_s=SETTLE_S, figures=figures, near=near, followed=steady
        )
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
