"""The frequency response that the data show without any model, to hold a model against (T 4.1, frequency domain)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records, to_segments
from mavdiag.identify.model import ArxModel
from mavdiag.telemetry import FloatArray

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_COHERENCE = 0.6  # the usual floor of flight-test practice (Tischler and Remple, Aircraft and Rotorcraft Sys. Id.)


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """H1 estimate S_uy/S_uu over frequency; noise on y does not bias it, noise on u does.

    frequency_hz: (f,). response: (f,) complex, unit of y per unit of u. coherence: (f,) 0..1.
    """

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
    segment: samples per window. most_hz: frequencies from there on are left out. Raises IdentificationError if no
    record holds two windows, or as `fit` does for data that do not pair up.
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
    """The gap between model and measurement over the lines above 0 Hz with enough coherence.

    Raises IdentificationError if no line has.
    """
    use = (measured.coherence >= min_coherence) & (measured.frequency_hz > 0.0)
    if not use.any():
        raise IdentificationError(f"no frequency reaches a coherence of {min_coherence}; fly a richer input")
    frequency = measured.frequency_hz[use]
    ratio = measured.response[use] / model_response(model, frequency)
    gain_db = float(np.sqrt(np.mean((20.0 * np.log10(np.abs(ratio))) ** 2)))
    phase_deg = float(np.sqrt(np.mean(np.degrees(np.angle(ratio)) ** 2)))
    return ResponseGap(gain_db, phase_deg, len(frequency), float(frequency[0]), float(frequency[-1]))
