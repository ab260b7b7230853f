"""A model drawn: Bode diagram, step response, and the correlations of its residual (edge: it writes a picture).

By matplotlib, which python-control brings, without a window: the file's suffix chooses the format.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.identify.lab.figures import deviations
from mavdiag.identify.lab.frequency import FrequencyResponse, model_response
from mavdiag.identify.model import ArxModel
from mavdiag.identify.validate import ResidualReport
from mavdiag.telemetry import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_model"]

LINES = 300  # frequencies of the Bode diagram
TIME_CONSTANTS, MAX_STEPS = 6.0, 5000  # length of the step response
MIN_COHERENCE = 0.6  # measured lines below it are not drawn (Tischler and Remple)


def draw_model(
    path: Path,
    model: ArxModel,
    title: str,
    *,
    residual: ResidualReport | None = None,
    measured: FrequencyResponse | None = None,
) -> None:
    """Write the picture. Bands and bars are one standard error; dashed lines hold 99 % of a true model's values.

    residual: tests of y - y_sim, else its two panels are left out. measured: response of the data, drawn as dots.
    Raises UsageError if the file's suffix is none that matplotlib writes, or the file cannot be written.
    """
    from matplotlib.figure import Figure

    rows = 2 if residual is None else 3
    picture = Figure(figsize=(9, 3 * rows), layout="constrained")
    picture.suptitle(title)
    axes = picture.subplots(rows, 2, squeeze=False)
    _bode(axes[0][0], axes[1][0], model, measured)
    _step_response(axes[0][1], model)
    _poles(axes[1][1], model)
    if residual is not None:
        _correlation(axes[2][0], residual.acf, residual.acf_band99, "residual with itself")
        _correlation(axes[2][1], residual.ccf, residual.ccf_band99, "residual with the input")
    try:
        picture.savefig(path)
    except ValueError as error:
        raise UsageError(f"{path}: name a file that ends in .svg, .png or .pdf") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror or error}); name another file") from error


def _bode(gain: "Axes", phase: "Axes", model: ArxModel, measured: FrequencyResponse | None) -> None:
    frequency = np.geomspace(1e-4, 0.5, LINES) / model.dt

    def both(one: ArxModel) -> FloatArray:
        response = model_response(one, frequency)
        return np.concatenate((20 * np.log10(np.abs(response)), np.degrees(np.unwrap(np.angle(response)))))

    values, errors = np.split(both(model), 2), np.split(deviations(model, both), 2)
    for axes, value, error, label in zip((gain, phase), values, errors, ("gain [dB]", "phase [°]"), strict=True):
        axes.semilogx(frequency, value)
        axes.fill_between(frequency, value - error, value + error, alpha=0.3)
        axes.set(xlabel="frequency [Hz]", ylabel=label)
        axes.grid(visible=True, which="both", alpha=0.3)
    if measured is not None:
        use = (measured.coherence >= MIN_COHERENCE) & (measured.frequency_hz > 0)
        lines, response = measured.frequency_hz[use], measured.response[use]
        gain.plot(lines, 20 * np.log10(np.abs(response)), ".", markersize=3)
        phase.plot(lines, np.degrees(np.unwrap(np.angle(response))), ".", markersize=3)


def _step_response(axes: "Axes", model: ArxModel) -> None:
    import control

    slowest = min(float(np.abs(model.poles[0])), 1 - 1e-6)
    count = int(np.clip(-TIME_CONSTANTS / np.log(max(slowest, 1e-3)), 20, MAX_STEPS))
    t_s = np.asarray(np.arange(count) * model.dt, dtype=np.float64)
    axes.plot(t_s, control.step_response(model.to_control(), t_s).outputs)
    axes.axhline(1.0, linestyle=":", color="grey")
    axes.set(xlabel="time [s]", ylabel="answer to a unit step")
    axes.grid(visible=True, alpha=0.3)


def _poles(axes: "Axes", model: ArxModel) -> None:
    turn = np.exp(2j * np.pi * np.linspace(0, 1, 200))
    axes.plot(turn.real, turn.imag, ":", color="grey")
    axes.plot(model.poles.real, model.poles.imag, "x")
    axes.set(xlabel="Re z", ylabel="Im z", aspect="equal", title="poles")


def _correlation(axes: "Axes", values: FloatArray, band: float, label: str) -> None:
    axes.stem(np.arange(len(values)), values, basefmt=" ")
    for limit in (-band, band):
        axes.axhline(limit, linestyle="--", color="grey")
    axes.set(xlabel="lag [samples]", title=label)
