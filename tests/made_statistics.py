"""Statistics from plain arrays."""

import numpy as np

from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S


def statistic(
    value: FloatArray, *, first_s: float = 0.0, dt_s: float = 0.02, rotors: tuple[float, ...] = ()
) -> Statistic:
    """A value every `dt_s`; those that are not finite are not valid. rotors: evidence in every row."""
    t_ns = np.round((first_s + dt_s * np.arange(len(value))) * NS_PER_S).astype(np.int64)
    known = np.isfinite(value)
    told = np.where(known, value, 0.0)
    evidence = np.tile(rotors, (len(value), 1)) if rotors else np.empty((0, 0))
    return Statistic(t_ns, dt_s, told, known, told, told, evidence)
