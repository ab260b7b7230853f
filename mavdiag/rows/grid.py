"""How often samples come, and whether those of the gyro are uniform enough to be rows themselves."""

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum

import numpy as np

from mavdiag.errors import InputError
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

UNIFORM = 0.25  # of a period: a sample this near to its place counts as uniform (our choice)
NATIVE_SHARE = 0.99  # of the steps that must be uniform for a native grid (our choice)
LEAPT = 9  # samples whose median stamp counts where some go back: up to four in a row may leap (our choice)
LEAST_SAMPLES = 20  # that a rate is measured by (our choice)
PAUSE_NS = NS_PER_S  # a longer step is a pause, as between two flights, and says nothing of the rate (our choice)
BACK_NS, APART_NS = NS_PER_S, 2 * NS_PER_S  # farther back a clock began anew; what follows is put behind (our choices)
SLOW = 3.0  # nor does one of so many medians, in a stream that is slower than that (our choice)
NATIVE_TOLERANCE = 0.02  # of the row period: the poles of a model shift by as much (our choice)
ATTENUATION = 0.01  # change of a gain within the pass band that a fit does not notice (our choice)
WIDEST = 0.2  # of the period; beyond it the noise above the pass band differs, too (our choice)


class Grid(StrEnum):
    """How rows are placed."""

    NATIVE = "native"  # one row a gyro sample
    RESAMPLED = "resampled"  # fixed period, linear interpolation


def distinct(t_ns: IntArray) -> IntArray:
    """Stamps in order of time, each once."""
    if (t_ns[1:] > t_ns[:-1]).all():
        return t_ns
    return np.unique(t_ns, return_index=True)[0]  # without the index it hashes, which is 170 times slower for stamps


def steps_of(t_ns: IntArray) -> FloatArray:
    """The steps between stamps in order of time, each time once [ns]."""
    return ((stamps := distinct(t_ns))[1:] - stamps[:-1]).astype(np.float64)


def median_step(times: Sequence[IntArray]) -> float:
    """Median step of one stream in several pieces [ns]; 0 where there is none."""
    steps = np.concatenate([np.empty(0), *(steps_of(t_ns) for t_ns in times)])
    return float(np.median(steps, overwrite_input=True)) if len(steps) else 0.0


def usual_step(steps: FloatArray) -> float:
    """Mean of the steps within 25 % of their median, so that losses do not stretch it; of all if there are none."""
    ordered = np.sort(steps)  # np.median takes four times as long
    median = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
    first, stop = ordered.searchsorted((1 - UNIFORM) * median), ordered.searchsorted((1 + UNIFORM) * median, "right")
    return float((ordered[first:stop] if first < stop else ordered).mean())


def mean_step(steps: FloatArray) -> float:
    """Mean of the steps but the pauses."""
    return float(np.mean(steps[steps <= max(PAUSE_NS, SLOW * float(np.median(steps)))]))


def measure_grid(telemetry: Telemetry) -> tuple[float, Grid]:
    """Period [s] of the gyro stream, and whether its samples are uniform enough to be rows themselves.

    It is the usual step of a uniform stream, else the mean one. Samples whose stamps leap do not count.
    Raises InputError if there are fewer than 20 gyro samples.
    """
    t = telemetry.need(Signal.BODY_RATE).t_ns
    if np.count_nonzero(t[1:] > t[:-1]) < len(t) - 1:
        t = distinct(t[well_dated(t)])
    if len(t) < LEAST_SAMPLES:
        raise InputError(f"only {len(t)} gyro samples: at least {LEAST_SAMPLES} are needed to measure the rate")
    steps = steps_of(t)
    dt_ns = usual_step(steps)
    places = np.maximum(np.round(steps / dt_ns), 1.0)
    if float(np.mean(np.abs(steps - places * dt_ns) <= UNIFORM * dt_ns)) >= NATIVE_SHARE:
        return dt_ns / NS_PER_S, Grid.NATIVE
    return mean_step(steps) / NS_PER_S, Grid.RESAMPLED


def usual_times(t_ns: IntArray, aside: int = 0) -> IntArray:
    """The median of `LEAPT` stamps about each, and as many `aside` on both sides, as early and late as can be."""
    from scipy.ndimage import median_filter  # a log whose stamps go back is rare

    half = LEAPT // 2
    usual: IntArray = median_filter(np.pad(t_ns, half + aside, constant_values=(-(2**62), 2**62)), LEAPT)
    return usual[half : len(usual) - half]


def well_dated(t_ns: IntArray) -> BoolArray:
    """Stamps, as they came, among the usual ones of two samples before and after, or where those go back for good."""
    usual = usual_times(t_ns, 2)
    early, late = usual[: len(t_ns)], usual[4:]
    return (early > late) | ((t_ns >= early) & (t_ns <= late))


def onward(log: Log) -> Log:
    """The log with what came after the gyro's clock began anew put 2 s behind, as of a live link, and a note of it."""
    gyro = log.telemetry.get(Signal.BODY_RATE)
    if gyro is None or (gyro.t_ns[1:] >= gyro.t_ns[:-1]).all():
        return log
    usual = usual_times(gyro.t_ns)
    places = 1 + np.flatnonzero(usual[:-1] - usual[1:] > BACK_NS)
    back_ns = usual[places - 1] - usual[places]
    if not len(places) or float(usual.max()) + float(np.sum(back_ns, dtype=np.float64)) > 2**62:
        return log
    shifts = np.append(0, np.cumsum(back_ns + APART_NS))

    def placed(series: Series) -> Series:
        t_ns = series.t_ns
        begins = places if series is gyro else 1 + np.flatnonzero(t_ns[:-1] - t_ns[1:] > BACK_NS)[: len(places)]
        t_ns = t_ns + shifts[begins.searchsorted(np.arange(len(t_ns)), side="right")]
        return Series(series.signal, t_ns, t_ns, series.values)

    often, at_s = f"{len(places)} times, first " if len(places) > 1 else "", gyro.t_ns[places[0] - 1] / NS_PER_S
    note = f"the vehicle's clock went back {often}at {at_s:.1f} s; what follows was put behind"
    return replace(log, telemetry=Telemetry(tuple(map(placed, log.telemetry.series))), notes=(*log.notes, note))


def rate_tolerance(grid: Grid, dt_s: float, window_s: float) -> float:
    """Greatest relative difference of mean gyro periods that a model of rows bears.

    dt_s: row period [s]. window_s: length of the Savitzky-Golay filter [s]. Native rows are the samples themselves: at
    (1 + d) dt each pole z = exp(s dt) is at s/(1 + d). Resampled rows have one period; linear interpolation passes
    sinc(f T)^2 of a sine between samples T apart, about 1 - (pi f T)^2/3, of which (1 + d) T changes 2/3 (pi f T)^2 d,
    at the filter's corner f of about 1/window (R. W. Schafer, IEEE Signal Processing Magazine 28(4), 2011, Eq 5).

    >>> [round(rate_tolerance(Grid.RESAMPLED, dt_s, 0.1), 3) for dt_s in (0.02, 0.01, 0.004)]
    [0.038, 0.152, 0.2]
    """
    if grid is Grid.NATIVE:
        return NATIVE_TOLERANCE
    loss = 2.0 / 3.0 * (math.pi * dt_s / max(window_s, dt_s)) ** 2
    return min(WIDEST, max(NATIVE_TOLERANCE, ATTENUATION / loss))
