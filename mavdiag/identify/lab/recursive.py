"""Recursive least squares with exponential forgetting: an ARX model that follows slow change (T 4.1).

Step by step over a stream: `step(spec, state, u, y) -> state`. With forgetting 1 it ends at the batch least squares,
and it shares its bias under output noise: it is for watching parameters move, not for residuals.
"""

from dataclasses import dataclass, replace

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Segment, polynomials, reach, regressors
from mavdiag.identify.model import ArxModel, Method, Order, check_order
from mavdiag.telemetry import FloatArray

# Of the covariance factor P, for signals of order 0.01 to 100 (our choices): its first diagonal, so large that theta
# = 0 counts for nothing; and the most: a long hover, which says nothing about the model, cannot wind it up.
FIRST_SPREAD, MOST_SPREAD = 1e6, 1e8


@dataclass(frozen=True, slots=True)
class RecursiveSpec:
    """What stays fixed. order: (na, nb, nk).

    forgetting: weight lambda of the past per sample, 0 < lambda <= 1; the memory is about 1/(1 - lambda) samples.
    Raises IdentificationError on impossible values.
    """

    order: Order = (2, 2, 1)
    forgetting: float = 0.9995

    def __post_init__(self) -> None:
        check_order(self.order)
        if not 0.0 < self.forgetting <= 1.0:
            raise IdentificationError(f"forgetting must be above 0 and at most 1, not {self.forgetting}")


@dataclass(frozen=True, slots=True, eq=False)
class RecursiveState:
    """What moves. theta: (d,) with d = na + nb. P: (d, d) covariance factor. past: last samples of this segment.

    loss: exponentially weighted mean of the squared prediction error. weight: sum of the weights behind it.
    """

    theta: FloatArray
    P: FloatArray
    past: Segment
    loss: float = 0.0
    weight: float = 0.0


_NOTHING = Segment(np.empty(0), np.empty(0))


def start(spec: RecursiveSpec) -> RecursiveState:
    """State before the first sample: nothing known."""
    d = spec.order[0] + spec.order[1]
    return RecursiveState(np.zeros(d), np.eye(d) * FIRST_SPREAD, _NOTHING)


def new_segment(state: RecursiveState) -> RecursiveState:
    """The same knowledge, to go on after a break: the samples before it are not neighbours of those after it."""
    return replace(state, past=_NOTHING)


def step(spec: RecursiveSpec, state: RecursiveState, u: FloatArray, y: FloatArray) -> RecursiveState:
    """Learn from the next samples u, y, (n,) each; about 10 us a sample. The result does not depend on the blocks.

    The first max(na, nb + nk - 1) samples of a segment only fill the past. Raises IdentificationError if the lengths
    differ or a sample is NaN or infinite: leave such samples out and call `new_segment`.
    """
    if u.shape != y.shape or u.ndim != 1:
        raise IdentificationError(f"u and y must be two rows of one length, not {u.shape} and {y.shape}")
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise IdentificationError("NaN or infinite samples; leave them out and begin a new segment")
    seen, lag = Segment(np.append(state.past.u, u), np.append(state.past.y, y)), reach(spec.order)
    theta, P, loss, weight = state.theta, state.P, state.loss, state.weight
    if len(seen) > lag:
        Phi, target = regressors(seen, spec.order)
        for phi, measured in zip(np.ascontiguousarray(Phi.T), target.tolist(), strict=True):
            # one measurement (Ljung, System Identification 2e, Eq 11.12)
            gain = P @ phi
            gain /= spec.forgetting + phi @ gain
            theta = theta + gain * (measured - float(phi @ theta))
            P = P - np.outer(gain, phi @ P)
            P = 0.5 * (P + P.T)  # stays symmetric over millions of steps
            if spec.forgetting < 1.0 and float(np.max(np.diag(P))) < MOST_SPREAD:
                P = P / spec.forgetting
            error = measured - float(phi @ theta)
            weight = spec.forgetting * weight + 1.0
            loss += (error * error - loss) / weight
    kept = slice(max(0, len(seen) - lag), None)
    return RecursiveState(theta, P, Segment(seen.u[kept], seen.y[kept]), loss, weight)


def snapshot(spec: RecursiveSpec, state: RecursiveState, dt: float) -> ArxModel:
    """The tracked model at this moment, with the covariance P x loss. dt: sample time [s].

    It may be unstable: look at `stable`. Raises IdentificationError before there are more samples than parameters.
    """
    if state.weight <= len(state.theta):
        raise IdentificationError("the recursive estimate has seen too few samples; keep feeding it")
    a, b = polynomials(state.theta, spec.order)
    return ArxModel(a, b, dt, spec.order, Method.RLS, covariance=state.P * state.loss)
