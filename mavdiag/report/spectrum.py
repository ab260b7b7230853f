"""The spectrum of the accelerometer with the rotors' line and its harmonics: T Fig 3.14.

Welch's averages of windowed spectra (IEEE Trans. Audio Electroacoust. 15 (1967)), of the flight's unbroken stretches.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.report.style import LINES, Picture, drawn, legend_above, plain_log
from mavdiag.rows.block import Block
from mavdiag.rows.windows import spans
from mavdiag.telemetry import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["RotorLine", "Spectrum", "folded", "spectrum_of", "spectrum_picture"]

SEGMENT_S = 1.0  # lines 1 Hz apart, as narrow as a rotor's speed is steady (our choice)
HARMONICS = 3
LEAST_ROWS = 8  # of a stretch: fewer show no line
NAMED_AT = ("data", "axes fraction")
LEAST_HZ = 2.0  # below it is the flight itself
EMPTY = Picture(
    "spectrum",
    "Spectrum of the accelerometer",
    "An unbalanced rotor shakes the airframe once a turn, so damage that takes mass off a blade raises the peak at the "
    "rotors' line, and its harmonics little.",
    "3.14",
)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """frequency_hz: (n,). density: (n, 2) of x and y [m/s^2/sqrt(Hz)]. averaged: number of stretches of `SEGMENT_S`."""

    frequency_hz: FloatArray
    density: FloatArray
    averaged: int


@dataclass(frozen=True, slots=True)
class RotorLine:
    """One per revolution [Hz]. source: where it is known from, for a caption."""

    hz: float
    source: str


def spectrum_of(blocks: Sequence[Block]) -> Spectrum | None:
    """Of all judged rows that carry x and y of the accelerometer; None if no stretch of `SEGMENT_S` does."""
    powers: FloatArray = np.empty(0)
    frequency: FloatArray = np.empty(0)
    total = 0
    for _, group in groupby(blocks, key=lambda one: one.segment):
        segment = list(group)
        dt_s = segment[0].dt_s
        rows = round(SEGMENT_S / dt_s)
        if rows < LEAST_ROWS:
            continue
        force = np.concatenate([one.force[:, :2] for one in segment])
        use = np.concatenate([one.valid for one in segment]) & np.isfinite(force).all(axis=1)
        for first, stop in spans(use):
            for start in range(first, stop - rows + 1, rows // 2):
                found = _power(force[start : start + rows], dt_s)
                if total == 0:
                    powers, frequency = np.zeros(found.shape), np.arange(len(found)) / (rows * dt_s)
                powers += found
                total += 1
    return Spectrum(frequency, np.sqrt(powers / total), total) if total else None


def _power(piece: FloatArray, dt_s: float) -> FloatArray:
    """One-sided density of power of a stretch, (n, 2) -> (n // 2 + 1, 2), under Hann's window."""
    window = np.hanning(len(piece))[:, None]
    found = np.fft.rfft((piece - piece.mean(axis=0)) * window, axis=0)
    power = np.square(np.abs(found)) * (2.0 * dt_s / float(np.square(window).sum()))
    power[0] /= 2.0  # zero and half of the rate have no twin at a negative frequency
    if len(piece) % 2 == 0:
        power[-1] /= 2.0
    return np.asarray(power, dtype=np.float64)


def folded(hz: float, rate_hz: float) -> float:
    """Where a line is seen in a stream that is sampled at this rate.

    >>> folded(167.0, 1000.0), folded(167.0, 200.0)
    (167.0, 33.0)
    """
    return abs(hz - rate_hz * round(hz / rate_hz))


def spectrum_picture(blocks: Sequence[Block], line: RotorLine | None, corner_hz: float | None) -> Picture:
    """The spectrum of the judged flight. corner_hz: of the low-pass in the stream; None if there is none."""
    spectrum = spectrum_of(blocks)
    if spectrum is None:
        return replace(
            EMPTY, not_drawn=f"no {SEGMENT_S:g} s of flight without a break carries the accelerometer's x and y"
        )
    rate_hz = 1.0 / blocks[0].dt_s
    lines = [] if line is None else [(k, folded(k * line.hz, rate_hz)) for k in range(1, HARMONICS + 1)]
    use = spectrum.frequency_hz >= LEAST_HZ

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        for stroke, column, name in ((LINES[0], 0, "x, forward"), (LINES[1], 1, "y, right")):
            stroke.draw(axes, spectrum.frequency_hz[use], spectrum.density[use, column], name)
        for number, hz in lines:
            axes.axvline(hz, color="#000000", linestyle="--" if number == 1 else ":", linewidth=0.9, zorder=0)
            name = "rotors' line" if number == 1 else f"x{number}"
            axes.annotate(name, (hz, 1.0), (-3, -9), xycoords=NAMED_AT, textcoords="offset points", ha="right")
        axes.set(xlabel="frequency [Hz]", ylabel="acceleration\n[m/s²/√Hz]", xlim=(0, rate_hz / 2))
        plain_log(axes)
        legend_above(axes)

    caption = f"{EMPTY.caption} {_of_line(line, rate_hz)}{_of_corner(corner_hz)}"
    highest = float(spectrum.frequency_hz[use][spectrum.density[use].max(axis=1).argmax()])
    words = f"Highest peak at {highest:.0f} Hz. {spectrum.averaged} stretches of {SEGMENT_S:g} s averaged."
    return replace(EMPTY, caption=caption.strip(), svg=drawn(EMPTY.title, words, plot, 2.7))


def _of_line(line: RotorLine | None, rate_hz: float) -> str:
    if line is None:
        return "The rotors' speed is not known: neither log nor airframe tells it, and no line stands out."
    seen_hz = folded(line.hz, rate_hz)
    fold = "" if math.isclose(seen_hz, line.hz) else f", which {rate_hz:.0f} samples a second fold to {seen_hz:.0f} Hz"
    return f"The line (dashed) is at {line.hz:.0f} Hz by {line.source}{fold}."


def _of_corner(corner_hz: float | None) -> str:
    return "" if corner_hz is None else f" This stream is low-passed at {corner_hz:g} Hz: above it little is left."
