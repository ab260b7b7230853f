"""How often the gyro of a vehicle comes, and whether its samples are uniform enough to be rows themselves."""

from enum import StrEnum

import numpy as np

from mavdiag.errors import InputError
from mavdiag.telemetry import FloatArray, Signal, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["NATIVE_TOLERANCE", "Grid", "measure_grid", "unbroken"]

NATIVE_TOLERANCE = 0.25  # of a period: a sample this near to its place counts as uniform (our choice)
NATIVE_SHARE = 0.99  # of the steps that must be uniform for a native grid (our choice)
LEAST_SAMPLES = 20  # that a rate is measured by (our choice)
PAUSE_NS = NS_PER_S  # a longer step is a pause, as between two flights, and says nothing of the rate (our choice)
SLOW = 3.0  # nor does one of so many medians, in a stream that is slower than that (our choice)


class Grid(StrEnum):
    """How rows are placed."""

    NATIVE = "native"  # one row a gyro sample
    RESAMPLED = "resampled"  # fixed period, linear interpolation


def unbroken(steps_ns: FloatArray) -> FloatArray:
    """The steps between samples [ns] without the pauses: what a rate is measured by."""
    return steps_ns[steps_ns <= max(PAUSE_NS, SLOW * float(np.median(steps_ns)))]


def measure_grid(telemetry: Telemetry) -> tuple[float, Grid]:
    """Period [s] of the gyro stream, and whether its samples are uniform enough to be rows themselves.

    The period of a uniform stream is the mean of the steps within 25 % of their median, so losses do not stretch it; of
    any other the mean of all steps but pauses above 1 s. Raises InputError if there are fewer than 20 gyro samples.
    """
    t = telemetry.need(Signal.BODY_RATE).t_ns
    if np.count_nonzero(t[1:] > t[:-1]) < len(t) - 1:
        t = np.unique(t)
    if len(t) < LEAST_SAMPLES:
        raise InputError(f"only {len(t)} gyro samples: at least {LEAST_SAMPLES} are needed to measure the rate")
    steps = np.diff(t).astype(np.float64)
    median = float(np.median(steps))
    usual = steps[np.abs(steps - median) <= NATIVE_TOLERANCE * median]
    dt_ns = float(np.mean(usual if len(usual) else steps))
    places = np.maximum(np.round(steps / dt_ns), 1.0)
    uniform = np.abs(steps - places * dt_ns) <= NATIVE_TOLERANCE * dt_ns
    if float(np.mean(uniform)) >= NATIVE_SHARE:
        return dt_ns / NS_PER_S, Grid.NATIVE
    return float(np.mean(unbroken(steps))) / NS_PER_S, Grid.RESAMPLED
