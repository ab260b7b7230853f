"""How well the log or link carried the signals: rate, jitter, gaps, losses."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mavdiag.report.style import MEASURED, Picture, drawn, plain_log
from mavdiag.report.thinned import columns_of
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Quality", "qualities_of", "quality_of", "quality_picture"]

GAP = 3.0  # a step of more than so many usual ones is a gap, and no jitter (our choice, as `mavdiag inspect` has it)
LINK = Picture(
    "link",
    "Steps between samples of the gyro",
    "A level line is a steady stream; a peak far above it is a gap, across which nothing is judged.",
)


@dataclass(frozen=True, slots=True)
class Quality:
    """One signal as it came.

    samples: how many.
    rate_hz: of the usual step; None with fewer than two samples.
    jitter_ms: standard deviation of the steps that are no gaps.
    gaps: steps of more than three usual ones. longest_s: the longest step.
    missing: share of the samples that the usual step would have brought, 0..1.
    repeated: samples with the time of another one.
    """

    signal: Signal
    samples: int
    rate_hz: float | None
    jitter_ms: float | None
    gaps: int
    longest_s: float | None
    missing: float
    repeated: int


def quality_of(series: Series) -> Quality:
    """Figures of one signal."""
    t_ns = np.unique(series.t_ns)
    steps = np.diff(t_ns) / NS_PER_S
    repeated = len(series) - len(t_ns)
    if not len(steps):
        return Quality(series.signal, len(series), None, None, 0, None, 0.0, repeated)
    usual = float(np.median(steps))
    gap = steps > GAP * usual
    wanted = float(t_ns[-1] - t_ns[0]) / NS_PER_S / usual + 1.0
    return Quality(
        series.signal,
        len(series),
        1.0 / usual,
        1e3 * float(steps[~gap].std()),
        int(np.count_nonzero(gap)),
        float(steps.max()),
        max(0.0, 1.0 - len(t_ns) / wanted),
        repeated,
    )


def qualities_of(telemetry: Telemetry) -> tuple[Quality, ...]:
    """Of every signal that has samples."""
    return tuple(quality_of(one) for one in telemetry.series if len(one))


def quality_picture(telemetry: Telemetry, columns: int) -> Picture:
    """The longest step of the gyro in each column of the flight."""
    gyro = telemetry.get(Signal.BODY_RATE)
    if gyro is None or len(gyro) < 3:
        return replace(LINK, not_drawn="the log carries no gyro")
    t_ns = np.unique(gyro.t_ns)
    if len(t_ns) < 3:
        return replace(LINK, not_drawn="the gyro's samples have one time")
    longest_ms, at_s = _longest(t_ns, columns)
    most_ms, usual_ms = float(longest_ms.max()), float(np.median(np.diff(t_ns))) / NS_PER_MS

    def plot(figure: "Figure") -> None:
        axes = figure.subplots()
        MEASURED.draw(axes, at_s, longest_ms)
        axes.set(xlabel="vehicle time [s]", ylabel="longest step [ms]")
        if most_ms > GAP * usual_ms:
            plain_log(axes)
        else:
            axes.set_ylim(0.0, GAP * usual_ms)

    words = f"Longest step {most_ms:.1f} ms, usual {usual_ms:.2f} ms."
    return replace(LINK, svg=drawn(LINK.title, words, plot, 1.9))


def _longest(t_ns: IntArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """The longest step of each column [ms], and when it ended [s]."""
    steps, ends = np.diff(t_ns) / NS_PER_MS, t_ns[1:] / NS_PER_S
    _, first = columns_of(ends, columns)
    return np.maximum.reduceat(steps, first), ends[first]
