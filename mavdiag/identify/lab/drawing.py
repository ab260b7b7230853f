"""A model drawn: Bode diagram, step response, poles, correlations of its residual (edge: it writes a picture)."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.identify.lab.comparison import MIN_COHERENCE, FrequencyResponse, model_response
from mavdiag.identify.lab.figures import deviations
from mavdiag.identify.model import ArxModel
from mavdiag.identify.validate import ResidualReport
from mavdiag.telemetry import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

LINES = 300  # frequencies of the Bode diagram
TIME_CONSTANTS, MAX_STEPS = 6.0, 5000  # length of the step response


def draw_model(
    path: Path,
    model: ArxModel,
    title: str,
    *,
    residual: ResidualReport | None = None,
    measured: FrequencyResponse | None = None,
) -> None:
    """Write the picture. Bands and bars are one standard error; dashed lines hold 99 % of a true model's values."""
    from matplotlib.figure import Figure

    rows = 2 if residual is None else 3
    picture = Figure(figsize=(9, 3 * rows), layout="constrained")
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
