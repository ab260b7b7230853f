"""Recursive least squares with exponential forgetting: an ARX model that follows slow change (T 4.1).

    k = P phi / (lambda + phi' P phi),   theta += k (y - phi' theta),   P <- (P - k phi' P) / lambda

(Ljung, System Identification 2e, Eq 11.12.) With lambda = 1 it ends at the batch least squares, whose bias under output
noise it shares: it is for watching parameters move, not for residuals.
"""

from collections.abc import Iterator

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records, polynomials, reach, regressors, to_segments
from mavdiag.identify.model import ArxModel, Method, Order, check_order

# Of P, for signals of order 0.01 to 100 (our choices): its first diagonal, so large that theta = 0 counts for nothing;
# and the most: a long hover, which says nothing about the model, cannot wind it up.
FIRST_SPREAD, MOST_SPREAD = 1e6, 1e8


def track(
    u: Records, y: Records, order: Order = (2, 2, 1), *, dt: float, forgetting: float, every: int
) -> Iterator[tuple[int, ArxModel]]:
    """Follow a model through one record or several; yield it, and how many samples it has seen, at each so many.

    forgetting: weight lambda of the past per sample, 0 < lambda <= 1; the memory is about 1/(1 - lambda) samples.
    The model may be unstable; its covariance is P times the weighted mean of the squared prediction error.
    Raises IdentificationError on data that `fit` would refuse, and if it is asked before it has seen enough.
    """
    d = sum(check_order(order)[:2])
    if not 0.0 < forgetting <= 1.0:
        raise IdentificationError(f"forgetting must be above 0 and at most 1, not {forgetting}")
    theta, P, loss, weight, seen = np.zeros(d), np.eye(d) * FIRST_SPREAD, 0.0, 0.0, 0
    for segment in to_segments(u, y, order):
        Phi, target = regressors(segment, order)
        begin, lag = seen, reach(order)
        for first in range(0, len(segment), every):
            rows = slice(max(0, first - lag), max(0, first + every - lag))
            for phi, measured in zip(np.ascontiguousarray(Phi[:, rows].T), target[rows].tolist(), strict=True):
                gain = P @ phi
                gain /= forgetting + phi @ gain
                theta = theta + gain * (measured - float(phi @ theta))
                P = P - np.outer(gain, phi @ P)
                P = 0.5 * (P + P.T)  # stays symmetric over millions of steps
                if forgetting < 1.0 and float(np.max(np.diag(P))) < MOST_SPREAD:
                    P = P / forgetting
                weight = forgetting * weight + 1.0
                loss += ((measured - float(phi @ theta)) ** 2 - loss) / weight
            seen = begin + min(first + every, len(segment))
            if weight <= d:
                raise IdentificationError("the recursive estimate has seen too few samples; keep feeding it")
            yield seen, ArxModel(*polynomials(theta, order), dt, order, Method.RLS, covariance=P * loss)
