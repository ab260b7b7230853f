"""The rotor-signature monitor's fit: what is gathered of a flight, and how large the residuals of its models are.

What does not depend on the models is gathered once, for many models are tried on the same flights.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.monitors.base import Summary, segments
from mavdiag.monitors.decimated import SAMPLE, samples_of
from mavdiag.monitors.healthy import three, variance_law_of
from mavdiag.monitors.model_residual import HealthyMotion, Residuals, residuals_of
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray


def gathered(flight: Sequence[Rows], motion: HealthyMotion) -> Summary:
    """The decimated samples of a flight, (n, 7), and how many each of its segments has."""
    found = [samples_of(segment, motion.stride, motion.window) for segment in segments(flight)]
    samples = np.concatenate([np.empty((0, SAMPLE)), *found])
    return samples, np.array([len(samples) for samples in found], dtype=np.int64)


def by_segment(summary: Summary) -> list[FloatArray]:
    """The samples of each segment of a flight that was gathered."""
    edges = np.append(0, np.cumsum(summary[1])).tolist()
    return [summary[0][first:stop] for first, stop in itertools.pairwise(edges) if first < stop]


def with_variances(flights: Sequence[Summary], motion: HealthyMotion) -> HealthyMotion:
    """The motion with the variances k0 and k1 of its residuals. Raises IdentificationError without a live sensor."""
    segments_ = [samples for flight in flights for samples in by_segment(flight)]
    motion = _with(motion, [residuals_of(motion, samples, follows=False) for samples in segments_])
    # How far the gain is followed depends on the variance at rest.
    return _with(motion, [residuals_of(motion, samples) for samples in segments_])


def _with(motion: HealthyMotion, found: Sequence[Residuals]) -> HealthyMotion:
    """The motion with k0 and k1 of residuals."""
    sums = np.zeros((5, 3))  # rows, r^2, busy, busy^2, busy r^2
    for residuals in found:
        r2, busy = np.square(residuals.r[residuals.valid]), residuals.busy[residuals.valid]
        sums[0] += len(r2)
        sums[1:] += [np.sum(part, axis=0) for part in (r2, busy, busy * busy, busy * r2)]
    if sums[0, 0] == 0 or sums[1].min() == 0:
        raise IdentificationError("no settled flight with a live gyro and accelerometer; fly longer than 3 s")
    k = [variance_law_of(*(sums[1:, axis] / sums[0, axis]).tolist()) for axis in range(3)]
    return replace(motion, k0=three([k0 for k0, _ in k]), k1=three([k1 for _, k1 in k]))
