"""Power spectra by Welch's method and what monitors take from them: band power and log band vectors. numpy only.

Welch, IEEE Trans. Audio Electroacoust. 15 (1967): the mean of periodograms over half-overlapping segments, each with
its mean removed and under a Hann window. One-sided density: its sum times the bin width is the variance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mavdiag.errors import InputError, UsageError
from mavdiag.telemetry import FloatArray

__all__ = ["Band", "Spectrum", "band_power", "log_band_vector", "welch"]

Band: TypeAlias = tuple[float, float]  # from, below [Hz]


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A one-sided power spectral density.

    frequency_hz: (f,) from 0 to half the sample rate. density: (f,) or (f, k) [unit of x squared per Hz].
    averages: periodograms that were averaged; the relative standard deviation of a bin is about sqrt(11/(9 averages)).
    """

    frequency_hz: FloatArray
    density: FloatArray
    averages: int


def welch(x: FloatArray, dt_s: float, segment: int = 128) -> Spectrum:
    """Welch spectrum of x, (n,) or (n, k), sampled every `dt_s` [s], in segments of `segment` samples.

    >>> t = np.arange(4096) * 0.01
    >>> spectrum = welch(3.0 * np.sin(2 * np.pi * 12.5 * t), 0.01)
    >>> round(band_power(spectrum, (10.0, 15.0)), 2)       # amplitude^2 / 2
    4.5

    Raises InputError if x is shorter than one segment, UsageError on an impossible segment or sample time.
    """
    if segment < 2 or not (math.isfinite(dt_s) and dt_s > 0):
        raise UsageError(f"a spectrum needs a segment of 2 samples or more and a positive dt, not {segment}, {dt_s}")
    if len(x) < segment:
        raise InputError(f"{len(x)} samples are too few for a spectrum in segments of {segment}")
    hop = segment - segment // 2
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)  # Hann, periodic
    pieces = np.lib.stride_tricks.sliding_window_view(x, segment, axis=0)[::hop]  # (pieces, .., segment)
    centred = pieces - pieces.mean(axis=-1, keepdims=True)
    power = np.abs(np.fft.rfft(centred * window, axis=-1)) ** 2
    density: FloatArray = np.moveaxis(power.mean(axis=0), -1, 0) * (dt_s / np.sum(window**2))
    last = -1 if segment % 2 == 0 else None
    density[1:last] *= 2.0  # the negative frequencies, folded; 0 and Nyquist have none
    frequency = np.fft.rfftfreq(segment, dt_s).astype(np.float64)
    return Spectrum(frequency, density, len(pieces))


def _bins(spectrum: Spectrum, band: Band) -> FloatArray:
    inside = (spectrum.frequency_hz >= band[0]) & (spectrum.frequency_hz < band[1])
    if not inside.any():
        raise UsageError(f"no spectral line between {band[0]} and {band[1]} Hz; use a longer segment or another band")
    return spectrum.density[inside]


def band_power(spectrum: Spectrum, band: Band) -> float:
    """Variance [unit of x squared] of a single-column spectrum's lines with band[0] <= f < band[1].

    Raises UsageError if the band holds no line.
    """
    return float(np.sum(_bins(spectrum, band)) * (spectrum.frequency_hz[1] - spectrum.frequency_hz[0]))


def log_band_vector(spectrum: Spectrum, bands: Sequence[Band]) -> FloatArray:
    """Natural log of the mean density in each band, (bands,) or (bands, k): METHOD section 5, innovation band vector.

    Raises UsageError if a band holds no line, InputError if a band has no power (its log would be infinite).
    """
    means: FloatArray = np.array([_bins(spectrum, band).mean(axis=0) for band in bands])
    if np.any(means <= 0.0):
        raise InputError("a frequency band has no power at all; the signal is constant or dead")
    logs: FloatArray = np.log(means)
    return logs
