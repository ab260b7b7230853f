"""The rotor-signature monitor's fit: what is gathered of a flight, and how large the residuals of its models are.

`model_residual` judges a stream; here whole flights are at hand, and many models are tried on the same flights. So what
does not depend on the models is gathered once, and the recursions are filters over a whole segment. The equations are
those of `model_residual`; a test compares the two.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.monitors.base import Summary, segments
from mavdiag.monitors.decimated import Decimated, Decimator
from mavdiag.monitors.healthy import MEMORY_S, smoothed, three, variance_law_of
from mavdiag.monitors.model_residual import (
    CORRELATION_S,
    DRIFT_S,
    FOLLOW_S,
    GAIN_RMS,
    SETTLE_S,
    SPEED_S,
    HealthyMotion,
    held,
)
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import forgetting
from mavdiag.telemetry import BoolArray, FloatArray

__all__ = ["gathered", "samples_of", "with_variances"]

COLUMNS = 11  # of a gathered sample: u and y of roll and pitch, heave and thrust, the same less their mean, busy
FLAGS = 3  # valid, the thrust is known, first of its segment


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A segment as the models see it: residuals r, simulated values f, busy (n, 3) each, and (n,) which count."""

    r: FloatArray
    f: FloatArray
    busy: FloatArray
    counts: BoolArray


def gathered(flight: Sequence[Rows], motion: HealthyMotion) -> Summary:
    """The decimated samples of a flight: (n, 11) and their flags (n, 3)."""
    values, flags = [np.empty((0, COLUMNS))], [np.empty((0, FLAGS), dtype=np.bool_)]
    for one in _samples(flight, motion):
        u, heave = np.where(np.isfinite(one.u), one.u, 0.0), held(one.heave, np.zeros(2))
        lift = heave - smoothed(heave, forgetting(DRIFT_S, motion.period_s), heave[0])
        slope = np.diff(heave[:, 1:], axis=0, prepend=heave[:1, 1:]) / motion.period_s
        busy = smoothed(np.square(np.concatenate((u, slope), axis=1)), forgetting(MEMORY_S, motion.period_s))
        values.append(np.concatenate((one.u, one.y, one.heave, lift, busy), axis=1))
        begins = np.arange(len(u)) == 0
        flags.append(np.stack((one.valid, np.isfinite(one.heave[:, 1]), begins), axis=1))
    return np.concatenate(values), np.concatenate(flags)


def samples_of(summary: Summary) -> Iterator[Decimated]:
    """The samples of each segment of a flight that was gathered, without their times."""
    for values, flags in _by_segment(summary):
        none = np.empty(0, dtype=np.int64)
        yield Decimated(none, values[:, :2], values[:, 2:4], values[:, 4:6], flags[:, 0])


def with_variances(flights: Sequence[Summary], motion: HealthyMotion) -> HealthyMotion:
    """The motion with the variances k0 and k1 of its residuals. Raises IdentificationError without a live sensor."""
    tried = [_tried(values, flags, motion) for one in flights for values, flags in _by_segment(one)]
    motion = _with(motion, [(one.r, one) for one in tried])
    # How far the gain is followed depends on the variance at rest.
    return _with(motion, [(one.r - _explained(one, motion), one) for one in tried])


def _by_segment(summary: Summary) -> Iterator[tuple[FloatArray, BoolArray]]:
    values, flags = summary[0], summary[1]
    edges = [*np.flatnonzero(flags[:, 2]).tolist(), len(flags)]
    return ((values[a:b], flags[a:b]) for a, b in itertools.pairwise(edges))


def _samples(flight: Sequence[Rows], motion: HealthyMotion) -> Iterator[Decimated]:
    """The samples of each segment of a flight that has any, in one piece."""
    decimator = Decimator(motion.stride, motion.window)
    for segment in segments(flight):
        state, parts = decimator.start(), []
        for rows in segment:
            state, one = decimator.step(state, rows)
            parts.append((one.t_ns, one.u, one.y, one.heave, one.valid))
        t_ns, u, y, heave, valid = (np.concatenate(column) for column in zip(*parts, strict=True))
        if len(t_ns):
            yield Decimated(t_ns, u, y, heave, valid)


def _tried(values: FloatArray, flags: BoolArray, motion: HealthyMotion) -> _Tried:
    """A segment simulated by the models, as `ModelResidual.step` does until gain and speed are followed."""
    finite = np.where(np.isfinite(values), values, 0.0)
    pairs = ((0, 2), (1, 3), (7, 6))  # columns of command and answer
    r, f = np.empty((len(values), 3)), np.empty((len(values), 3))
    for i, record in enumerate((motion.roll, motion.pitch, motion.heave)):
        model, (command, answer) = record.model(), (finite[:, column] for column in pairs[i])
        at_rest = (np.full(len(model.b), command[0]), np.full(len(model.a), answer[0])) if i < 2 else (None, None)
        f[:, i] = model.simulate(command, *at_rest)
        r[:, i] = answer - f[:, i]
    known = flags[:, 0] & (np.arange(len(values)) >= SETTLE_S / motion.period_s)
    r[~known] = 0.0
    r -= smoothed(r, forgetting(DRIFT_S, motion.period_s))
    return _Tried(r, f, finite[:, 8:11], known & (flags[:, 1] | (not motion.uses_thrust)))


def _explained(one: _Tried, motion: HealthyMotion) -> FloatArray:
    """What the errors of gain and speed explain, (n, 3), as `ModelResidual` follows them."""
    df = np.diff(one.f, axis=0, prepend=np.zeros((1, 3))) * (SPEED_S / motion.period_s)
    both = np.concatenate((one.f, df), axis=1)
    both -= smoothed(both, forgetting(DRIFT_S, motion.period_s))
    f, df, r = both[:, :3], both[:, 3:], one.r
    products = np.concatenate((f * f, f * df, df * df, f * r, df * r), axis=1)
    means = smoothed(products, forgetting(FOLLOW_S, motion.period_s))
    before = np.concatenate((np.zeros((1, 15)), means[:-1]))
    prior = np.array(motion.k0) * (CORRELATION_S / (FOLLOW_S * GAIN_RMS**2))
    ff, fd, dd, fr, dr = (before[:, i : i + 3] for i in range(0, 15, 3))
    ff, dd = ff + prior, dd + prior
    return np.asarray(((dd * fr - fd * dr) * f + (ff * dr - fd * fr) * df) / (ff * dd - fd * fd), dtype=np.float64)


def _with(motion: HealthyMotion, found: Sequence[tuple[FloatArray, _Tried]]) -> HealthyMotion:
    """The motion with k0 and k1 of residuals r, (n, 3) each."""
    sums = np.zeros((5, 3))  # rows, r^2, busy, busy^2, busy r^2
    for r, one in found:
        r2, busy = np.square(r[one.counts]), one.busy[one.counts]
        sums[0] += len(r2)
        sums[1:] += [np.sum(part, axis=0) for part in (r2, busy, busy * busy, busy * r2)]
    if sums[0, 0] == 0 or sums[1].min() == 0:
        raise IdentificationError("no settled flight with a live gyro and accelerometer; fly longer than 3 s")
    k = [variance_law_of(*(sums[1:, axis] / sums[0, axis]).tolist()) for axis in range(3)]
    return replace(motion, k0=three([k0 for k0, _ in k]), k1=three([k1 for _, k1 in k]))
