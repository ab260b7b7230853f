"""What a control engineer looks at beside a model (T 4.1). Nothing is judged with it.

The frequency response that the data show without any model. Recursive least squares with exponential forgetting, which
follows slow change (Ljung, System Identification 2e, Eq 11.12); with lambda = 1 it ends at the batch least squares:

    k = P phi / (lambda + phi' P phi),   theta += k (y - phi' theta),   P <- (P - k phi' P) / lambda

The two models that the thesis prints (T Eq 5.1, 5.2), without a sample time. Each carries an input scale, fitted by us:
with it they explain about 0.55 (roll) and 0.85 (pitch) of the emulated aircraft's output variance.

Poles, damping, bandwidth, margins, DC gain, each with a standard error by the delta method: the change along each
principal direction of the parameters' covariance, summed in squares. And the model drawn (edge: it writes a picture).
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import IdentificationError, UsageError
from mavdiag.identify.arx import (
    ArxModel,
    Method,
    Order,
    Records,
    check_order,
    polynomials,
    reach,
    regressors,
    to_segments,
)
from mavdiag.identify.estimate import ResidualReport
from mavdiag.printable import printable
from mavdiag.storage import replacing
from mavdiag.telemetry import Axis, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

MIN_COHERENCE = 0.6  # the usual floor of flight-test practice (Tischler and Remple, Aircraft and Rotorcraft Sys. Id.)


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """H1 estimate S_uy/S_uu, (f,) each; noise on y does not bias it, noise on u does. coherence: 0..1."""

    frequency_hz: FloatArray
    response: "NDArray[np.complex128]"
    coherence: FloatArray


@dataclass(frozen=True, slots=True)
class ResponseGap:
    """Root mean square gap of gain [dB] and phase [degrees] of a model; lines: frequencies compared, and their span."""

    gain_db: float
    phase_deg: float
    lines: int
    lowest_hz: float
    highest_hz: float


def estimate_response(
    u: Records, y: Records, *, dt: float, segment: int = 1024, most_hz: float = np.inf
) -> FrequencyResponse:
    """Estimate the response from u to y by Welch's averaging: Hann windows, half overlap, means removed.

    u, y: one record each, (n,), or one per flight; flights are averaged, never joined. dt: sample time [s].
    segment: samples per window. most_hz: frequencies from there on are left out.
    """
    from scipy.signal import csd  # 0.8 s to import: only offline work pays it

    records = [one for one in to_segments(u, y, (1, 1, 0)) if len(one) >= 2 * segment]
    if segment < 8 or not records:
        raise IdentificationError(f"no record holds two windows of {segment} samples; use a shorter window")
    counts = [2 * len(one) // segment - 1 for one in records]
    pairs = [[(one.u, one.u), (one.y, one.y), (one.u, one.y)] for one in records]
    windowed = [[csd(*pair, 1 / dt, nperseg=segment)[1] for pair in three] for three in pairs]
    uu, yy, uy = np.einsum("r,rsf->sf", counts, np.array(windowed, dtype=np.complex128))
    if np.any(uu.real <= 0.0) or np.any(yy.real <= 0.0):
        raise IdentificationError("u or y has no power at some frequency; check that the signals are alive")
    coherence = np.clip(np.abs(uy) ** 2 / (uu * yy).real, 1e-12, 1.0)
    frequency = np.fft.rfftfreq(segment, dt).astype(np.float64)
    use = frequency < most_hz
    return FrequencyResponse(frequency[use], (uy / uu.real)[use], coherence[use])


def model_response(model: ArxModel, frequency_hz: FloatArray) -> "NDArray[np.complex128]":
    """B/A at z = exp(2 pi i f dt): (f,) -> (f,) complex."""
    from scipy.signal import freqz

    return np.asarray(freqz(model.b, model.a, frequency_hz, fs=1 / model.dt)[1], dtype=np.complex128)


def compare(measured: FrequencyResponse, model: ArxModel) -> ResponseGap:
    """The gap between model and measurement over the lines above 0 Hz with enough coherence."""
    use = (measured.coherence >= MIN_COHERENCE) & (measured.frequency_hz > 0.0)
    if not use.any():
        raise IdentificationError(f"no frequency reaches a coherence of {MIN_COHERENCE}; fly a richer input")
    frequency = measured.frequency_hz[use]
    ratio = measured.response[use] / model_response(model, frequency)
    gain_db = float(np.sqrt(np.mean((20.0 * np.log10(np.abs(ratio))) ** 2)))
    phase_deg = float(np.sqrt(np.mean(np.degrees(np.angle(ratio)) ** 2)))
    return ResponseGap(gain_db, phase_deg, len(frequency), float(frequency[0]), float(frequency[-1]))


# Of P, for signals of order 0.01 to 100 (our choices): its first diagonal, so large that theta = 0 counts for nothing;
# and the most: a long hover, which says nothing about the model, cannot wind it up.
FIRST_SPREAD, MOST_SPREAD = 1e6, 1e8


def track(
    u: Records, y: Records, order: Order = (2, 2, 1), *, dt: float, forgetting: float, every: int
) -> Iterator[tuple[int, ArxModel]]:
    """Follow a model through one record or several; yield it, and how many samples it has seen, at each so many.

    forgetting: weight lambda of the past per sample, at most 1; the memory is about 1/(1 - lambda) samples, which must
    be more than the parameters. Nothing is yielded before so many were seen.
    The model may be unstable; its covariance is P times the weighted mean of the error before x after each step.
    """
    d = sum(check_order(order)[:2])
    if not 1.0 - 1.0 / d < forgetting <= 1.0:
        raise IdentificationError(
            f"forgetting must be above {1 - 1 / d:g}, for {d} parameters, up to 1, not {forgetting}"
        )
    theta, P, loss, weight, seen = np.zeros(d), np.eye(d) * FIRST_SPREAD, 0.0, 0.0, 0
    for segment in to_segments(u, y, order):
        Phi, target = regressors(segment, order)
        rows = zip(np.ascontiguousarray(Phi.T), target.tolist(), strict=True)
        for row, (phi, measured) in enumerate(rows, start=reach(order) + 1):
            gain, error = P @ phi, measured - float(phi @ theta)
            gain /= forgetting + phi @ gain
            theta = theta + gain * error
            P = P - np.outer(gain, phi @ P)
            P = 0.5 * (P + P.T)  # stays symmetric over millions of steps
            if forgetting < 1.0 and float(np.max(np.diag(P))) < MOST_SPREAD:
                P = P / forgetting
            weight = forgetting * weight + 1.0
            loss += (error * (measured - float(phi @ theta)) - loss) / weight
            if weight > d and (row % every == 0 or row == len(segment)):
                yield seen + row, ArxModel(*polynomials(theta, order), dt, order, Method.RLS, covariance=P * loss)
        seen += len(segment)


ASSUMED_DT_S = 0.001  # the logs were taken at 1 kHz (T 5.3); the models do not say

#: By axis where the thesis prints a model, and the model from a commanded to a measured rate, both in rad/s.
PUBLISHED = {
    axis: (source, ArxModel(np.array(a), np.array(b) * scale, ASSUMED_DT_S, (2, 2, 1), Method.PUBLISHED))
    for axis, source, a, b, scale in (
        # poles 0.9985 and 0.534, gain 194 as printed
        (Axis.ROLL, "T Eq 5.1", (1.0, -1.5326, 0.5333), (0.0, 0.0743, 0.0616), 1 / 75),
        # poles 0.9908 and 0.9455, gain 317 as printed
        (Axis.PITCH, "T Eq 5.2", (1.0, -1.9363, 0.9368), (0.0, 0.1014, 0.0573), 1 / 298),
    )
}


STEP = 0.01  # of a standard deviation: small enough to be linear, large enough for the root finders (our choice)
GRID_LINES = 2000  # frequencies in which the bandwidth is bracketed
DROP = 10 ** (-3 / 20)  # bandwidth: where the gain is 3 dB below the gain at rest
LINES = 300  # frequencies of the Bode diagram
TIME_CONSTANTS, MAX_STEPS = 6.0, 5000  # length of the step response


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure and its standard error, in its unit; None where it does not exist, or is not known."""

    value: float | None
    standard_error: float | None


@dataclass(frozen=True, slots=True)
class PoleFigures:
    """One pole z of the discrete model, or a conjugate pair, of which imaginary is positive."""

    real: Figure
    imaginary: Figure
    natural_hz: Figure  # |ln z| / (2 pi dt)
    damping: Figure  # ratio -Re(ln z) / |ln z|; 1 for a real pole between 0 and 1


@dataclass(frozen=True, slots=True)
class ModelFigures:
    """The figures of a model T from commanded to measured rate."""

    poles: tuple[PoleFigures, ...]
    dc_gain: Figure  # B(1)/A(1)
    bandwidth_hz: Figure  # lowest frequency at which |T| is 3 dB below the DC gain
    gain_margin_db: Figure  # of the loop L = T / (1 - T), which unit feedback closes to T
    phase_margin_deg: Figure  # likewise
    modulus_margin: Figure  # least distance of L from -1, 1 / max |1 - T|; 0.5 and more is a robust loop
    errors_from: str  # what the standard errors rest on


def model_figures(model: ArxModel) -> ModelFigures:
    """All figures of a model.

    >>> from mavdiag.identify.arx import Method
    >>> found = model_figures(ArxModel(np.array([1, -0.9]), np.array([0, 0.1]), 0.01, (1, 1, 1), Method.PUBLISHED))
    >>> round(found.poles[0].natural_hz.value, 3), round(found.dc_gain.value, 6), found.dc_gain.standard_error
    (1.677, 1.0, None)
    """
    upper = model.poles[model.poles.imag >= 0.0]

    def values(one: ArxModel) -> FloatArray:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a pole at z = 0, which has no frequency; of the way control takes
            import control

            natural, damping, poles = control.damp(one.to_control(), doprint=False)
            nearest = [int(np.argmin(np.abs(poles - pole))) for pole in upper]
            of_poles = np.column_stack((poles.real, np.abs(poles.imag), natural / (2.0 * np.pi), damping))[nearest]
            loop = control.feedback(one.to_control(), 1, sign=1)  # T / (1 - T)
            gain, phase, modulus = control.stability_margins(loop)[:3]
            at_nyquist = float(np.real(loop(-1.0)))
            if not np.isfinite(gain) and at_nyquist < 0.0:  # control does not look for a crossing there
                gain = -1.0 / at_nyquist
            return np.array([*of_poles.ravel(), one.dc_gain, _bandwidth_hz(one), 20.0 * np.log10(gain), phase, modulus])

    found = [
        Figure(value if np.isfinite(value) else None, error if np.isfinite((value, error)).all() else None)
        for value, error in np.stack((values(model), deviations(model, values))).T.tolist()
    ]
    poles = tuple(PoleFigures(*found[4 * i : 4 * i + 4]) for i in range(len(upper)))
    known = bool(np.isfinite(model.covariance).all())
    rests_on = "the covariance of the parameters" if known else "nothing: the model carries none"
    dc_gain, bandwidth, gain, phase, modulus = found[4 * len(upper) :]
    return ModelFigures(poles, dc_gain, bandwidth, gain, phase, modulus, rests_on)


def deviations(model: ArxModel, values: Callable[[ArxModel], FloatArray]) -> FloatArray:
    """Standard errors of any figures `values` of a model, (k,); nan where the parameters' own are not known."""
    if not np.isfinite(model.covariance).all():
        return np.full_like(values(model), np.nan)
    variances, directions = np.linalg.eigh(model.covariance)
    squares = np.zeros_like(values(model))
    for move in STEP * (directions * np.sqrt(np.maximum(variances, 0.0))).T:
        ahead, behind = (
            values(ArxModel(*polynomials(theta, model.order), model.dt, model.order, model.method))
            for theta in (model.theta + move, model.theta - move)
        )
        with np.errstate(invalid="ignore"):  # infinity less infinity is no figure
            squares += ((ahead - behind) / (2.0 * STEP)) ** 2
    return np.asarray(np.sqrt(squares), dtype=np.float64)


def _bandwidth_hz(model: ArxModel) -> float:
    """By a bracket on a grid; `control.bandwidth` evaluates discrete models at s = j omega."""
    from scipy.optimize import brentq

    def above(frequency_hz: FloatArray) -> FloatArray:
        return np.abs(model_response(model, frequency_hz)) - DROP * abs(model.dc_gain)

    grid = np.geomspace(1e-5, 0.5, GRID_LINES) / model.dt
    below = np.flatnonzero(above(grid) < 0.0)
    if not np.isfinite(model.dc_gain) or len(below) == 0 or below[0] == 0:
        return float("nan")
    return float(brentq(lambda f: float(above(np.array([f]))[0]), grid[below[0] - 1], grid[below[0]]))


def draw_model(
    path: Path,
    model: ArxModel,
    title: str,
    *,
    residual: ResidualReport | None = None,
    measured: FrequencyResponse | None = None,
) -> None:
    """Write the picture. Bands and bars are one standard error; dashed lines hold 99 % of a true model's values."""
    from matplotlib import figure

    rows = 2 if residual is None else 3
    picture = figure.Figure(figsize=(9, 3 * rows), layout="constrained")
    picture.suptitle(printable(title), parse_math=False)
    axes = picture.subplots(rows, 2, squeeze=False)
    _bode((axes[0][0], axes[1][0]), model, measured)
    slowest = min(float(np.abs(model.poles[0])), 1 - 1e-6)
    count = int(np.clip(-TIME_CONSTANTS / np.log(max(slowest, 1e-3)), 20, MAX_STEPS))
    axes[0][1].plot(model.dt * np.arange(count), model.simulate(np.ones(count)))
    axes[0][1].axhline(1.0, linestyle=":", color="grey")
    axes[0][1].set(xlabel="time [s]", ylabel="answer to a unit step")
    axes[0][1].grid(visible=True, alpha=0.3)
    turn = np.exp(2j * np.pi * np.linspace(0, 1, 200))
    axes[1][1].plot(turn.real, turn.imag, ":", color="grey")
    axes[1][1].plot(model.poles.real, model.poles.imag, "x")
    axes[1][1].set(xlabel="Re z", ylabel="Im z", aspect="equal", title="poles")
    if residual is not None:
        for panel, values, band, label in (
            (axes[2][0], residual.acf, residual.acf_band99, "residual with itself"),
            (axes[2][1], residual.ccf, residual.ccf_band99, "residual with the input"),
        ):
            panel.stem(np.arange(len(values)), values, basefmt=" ")
            panel.hlines((-band, band), 0, len(values) - 1, linestyles="--", color="grey")
            panel.set(xlabel="lag [samples]", title=label)
    try:
        with replacing(path) as file:
            picture.savefig(file, format=path.suffix.removeprefix("."))
    except ValueError as error:
        raise UsageError(f"{path}: name a file that ends in .svg, .png or .pdf") from error


def _bode(panels: "tuple[Axes, Axes]", model: ArxModel, measured: FrequencyResponse | None) -> None:
    frequency = np.geomspace(1e-4, 0.5, LINES) / model.dt

    def values_of(one: ArxModel) -> FloatArray:
        return _gain_and_phase(model_response(one, frequency)).ravel()

    values, errors = (both.reshape(2, -1) for both in (values_of(model), deviations(model, values_of)))
    for axes, value, error, label in zip(panels, values, errors, ("gain [dB]", "phase [°]"), strict=True):
        axes.semilogx(frequency, value)
        axes.fill_between(frequency, value - error, value + error, alpha=0.3)
        axes.set(xlabel="frequency [Hz]", ylabel=label)
        axes.grid(visible=True, which="both", alpha=0.3)
    if measured is not None:
        use = (measured.coherence >= MIN_COHERENCE) & (measured.frequency_hz > 0)
        for axes, value in zip(panels, _gain_and_phase(measured.response[use]), strict=True):
            axes.plot(measured.frequency_hz[use], value, ".", markersize=3)


def _gain_and_phase(response: "NDArray[np.complex128]") -> FloatArray:
    """[dB] and [degrees], (2, f)."""
    return np.stack((20 * np.log10(np.abs(response)), np.degrees(np.unwrap(np.angle(response)))))
