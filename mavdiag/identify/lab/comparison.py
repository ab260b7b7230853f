"""What stands beside a model for comparison (T 4.1). Nothing is judged with it.

The frequency response that the data show without any model. Recursive least squares with exponential forgetting, which
follows slow change (Ljung, System Identification 2e, Eq 11.12); with lambda = 1 it ends at the batch least squares:

    k = P phi / (lambda + phi' P phi),   theta += k (y - phi' theta),   P <- (P - k phi' P) / lambda

The two models that the thesis prints (T Eq 5.1, 5.2), without a sample time. Each carries an input scale, fitted by us:
with it they explain about 0.55 (roll) and 0.85 (pitch) of the emulated aircraft's output variance.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records, polynomials, reach, regressors, to_segments
from mavdiag.identify.model import ArxModel, Method, Order, check_order
from mavdiag.telemetry import Axis, FloatArray

if TYPE_CHECKING:
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


def compare(measured: FrequencyResponse, model: ArxModel, min_coherence: float = MIN_COHERENCE) -> ResponseGap:
    """The gap between model and measurement over the lines above 0 Hz with enough coherence."""
    use = (measured.coherence >= min_coherence) & (measured.frequency_hz > 0.0)
    if not use.any():
        raise IdentificationError(f"no frequency reaches a coherence of {min_coherence}; fly a richer input")
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

    forgetting: weight lambda of the past per sample, 0 < lambda <= 1; the memory is about 1/(1 - lambda) samples.
    The model may be unstable; its covariance is P times the weighted mean of the squared prediction error.
    """
    d = sum(check_order(order)[:2])
    if not 0.0 < forgetting <= 1.0:
        raise IdentificationError(f"forgetting must be above 0 and at most 1, not {forgetting}")
    theta, P, loss, weight, seen = np.zeros(d), np.eye(d) * FIRST_SPREAD, 0.0, 0.0, 0
    for segment in to_segments(u, y, order):
        Phi, target = regressors(segment, order)
        begin, lag = seen, reach(order)
        for first in range(0, len(segment), every):
            rows = slice(max(0, first - lag), max(0, first + every - lag))
            for phi, measured in zip(np.ascontiguousarray(Phi[:, rows].T), target[rows].tolist(), strict=True):
                gain = P @ phi
                gain /= forgetting + phi @ gain
                theta = theta + gain * (measured - float(phi @ theta))
                P = P - np.outer(gain, phi @ P)
                P = 0.5 * (P + P.T)  # stays symmetric over millions of steps
                if forgetting < 1.0 and float(np.max(np.diag(P))) < MOST_SPREAD:
                    P = P / forgetting
                weight = forgetting * weight + 1.0
                loss += ((measured - float(phi @ theta)) ** 2 - loss) / weight
            seen = begin + min(first + every, len(segment))
            if weight <= d:
                raise IdentificationError("the recursive estimate has seen too few samples; keep feeding it")
            yield seen, ArxModel(*polynomials(theta, order), dt, order, Method.RLS, covariance=P * loss)


ASSUMED_DT_S = 0.001  # the logs were taken at 1 kHz (T 5.3); the models do not say


@dataclass(frozen=True, slots=True)
class ReferenceModel:
    """A published model, as printed, with the factor on an input in rad/s that gives an output in rad/s (estimated)."""

    axis: Axis
    model: ArxModel
    input_scale: float
    source: str

    @property
    def scaled(self) -> ArxModel:
        """The model from a commanded to a measured rate, both in rad/s."""
        return replace(self.model, b=self.model.b * self.input_scale)


def _printed(*coefficients: list[float]) -> ArxModel:
    a, b = map(np.array, coefficients)
    return ArxModel(a, b, ASSUMED_DT_S, (2, 2, 1), Method.PUBLISHED)


#: Poles 0.9985 and 0.534, gain 194.
THESIS_ROLL = ReferenceModel(Axis.ROLL, _printed([1.0, -1.5326, 0.5333], [0.0, 0.0743, 0.0616]), 1 / 75, "T Eq 5.1")

#: Poles 0.9908 and 0.9455, gain 317.
THESIS_PITCH = ReferenceModel(Axis.PITCH, _printed([1.0, -1.9363, 0.9368], [0.0, 0.1014, 0.0573]), 1 / 298, "T Eq 5.2")
