"""What a control engineer reads off a model: poles, damping, bandwidth, margins, DC gain, each with a standard error.

By the delta method: the change along each principal direction of the parameters' covariance, summed in squares.
And the model drawn (edge: it writes a picture).
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.identify.arx import polynomials
from mavdiag.identify.lab.comparison import MIN_COHERENCE, FrequencyResponse, model_response
from mavdiag.identify.model import ArxModel
from mavdiag.identify.validate import ResidualReport
from mavdiag.telemetry import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

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

    >>> from mavdiag.identify.model import Method
    >>> found = model_figures(ArxModel(np.array([1, -0.9]), np.array([0, 0.1]), 0.01, (1, 1, 1), Method.PUBLISHED))
    >>> round(found.poles[0].natural_hz.value, 3), round(found.dc_gain.value, 6), found.dc_gain.standard_error
    (1.677, 1.0, None)
    """
    upper = model.poles[model.poles.imag >= 0.0]

    def values(one: ArxModel) -> FloatArray:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a pole at z = 0, which has no frequency; of the way control takes
            return _values(one, upper)

    found = [
        Figure(value if np.isfinite(value) else None, error if np.isfinite((value, error)).all() else None)
        for value, error in np.stack((values(model), deviations(model, values))).T.tolist()
    ]
    poles = tuple(PoleFigures(*found[4 * i : 4 * i + 4]) for i in range(len(upper)))
    rests_on = "nothing: the model carries no standard errors"
    if np.isfinite(model.covariance).all():
        rests_on = "the covariance of the parameters"
    elif np.isfinite(model.standard_errors).all():
        rests_on = "the standard errors of the parameters; their correlations are not known, so these are rough"
    dc_gain, bandwidth, gain, phase, modulus = found[4 * len(upper) :]
    return ModelFigures(poles, dc_gain, bandwidth, gain, phase, modulus, rests_on)


def deviations(model: ArxModel, values: Callable[[ArxModel], FloatArray]) -> FloatArray:
    """Standard errors of any figures `values` of a model, (k,); nan where the parameters' own are not known."""
    known = np.isfinite(model.covariance).all()
    covariance = model.covariance if known else np.diag(model.standard_errors**2)
    if not np.isfinite(covariance).all():
        return np.full_like(values(model), np.nan)
    variances, directions = np.linalg.eigh(covariance)
    squares = np.zeros_like(values(model))
    for move in STEP * (directions * np.sqrt(np.maximum(variances, 0.0))).T:
        ahead, behind = (
            values(ArxModel(*polynomials(theta, model.order), model.dt, model.order, model.method))
            for theta in (model.theta + move, model.theta - move)
        )
        squares += ((ahead - behind) / (2.0 * STEP)) ** 2
    return np.asarray(np.sqrt(squares), dtype=np.float64)


def _values(model: ArxModel, upper: "NDArray[np.complex128]") -> FloatArray:
    """In the order of `PoleFigures`, of the poles next to these, and `ModelFigures`; nan where there is none."""
    import control

    natural, damping, poles = control.damp(model.to_control(), doprint=False)
    nearest = [int(np.argmin(np.abs(poles - pole))) for pole in upper]
    of_poles = np.column_stack((poles.real, np.abs(poles.imag), natural / (2.0 * np.pi), damping))[nearest]
    size = model.lag + 1
    B, A = (np.pad(values, (0, size - len(values))) for values in (model.b, model.a))
    loop = control.TransferFunction(B, A - B, model.dt)
    gain, phase, modulus = control.stability_margins(loop)[:3]
    at_nyquist = float(np.real(loop(-1.0)))
    if not np.isfinite(gain) and at_nyquist < 0.0:  # control does not look for a crossing there
        gain = -1.0 / at_nyquist
    return np.array([*of_poles.ravel(), model.dc_gain, _bandwidth_hz(model), 20.0 * np.log10(gain), phase, modulus])


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
    picture.suptitle(title)
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
        picture.savefig(path)
    except ValueError as error:
        raise UsageError(f"{path}: name a file that ends in .svg, .png or .pdf") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror or error}); name another file") from error


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
