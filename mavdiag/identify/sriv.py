"""SRIV: Young's simplified refined instrumental variable estimator, for noise on the output.

The model is y = (B/A) u + e with e on the output. Least squares regresses on noisy past outputs and is biased; SRIV
replaces them by instruments, the outputs that the last model simulates from u alone, and filters everything by 1/A,
which makes the estimate efficient for white e and consistent for coloured e (P. C. Young, Recursive Estimation and
Time-Series Analysis 2e, ch. 7; the data-based mechanistic school of T 4.1.1).
"""

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Estimate, least_squares, polynomials, regressors, solve
from mavdiag.identify.data import Segment
from mavdiag.identify.model import Order
from mavdiag.quantities import FloatArray

__all__ = ["reflect_poles", "sriv"]

MAX_ITERATIONS = 60  # our choice; good data take 3 to 10
STEP_OVER_ERROR = 1e-3  # converged when no parameter moves more than this share of its standard error ..
STEP_RELATIVE = 1e-9  # .. or, on data without noise, of itself
MAX_RADIUS = 0.99999  # reflected poles stay this far inside the unit circle (our choice)


def reflect_poles(a: FloatArray) -> FloatArray:
    """The polynomial a (na + 1,) with its roots on or outside the unit circle mirrored to the inside."""
    roots = np.roots(a)
    radius = np.abs(roots)
    if np.all(radius < 1.0):
        return a
    outside = radius >= 1.0
    mirrored = np.where(outside, roots / np.maximum(radius, 1.0) ** 2, roots)
    mirrored = np.where(outside & (np.abs(mirrored) > MAX_RADIUS), roots / radius * MAX_RADIUS, mirrored)
    trailing = np.zeros(len(a) - 1 - len(roots))
    return np.concatenate((np.real(np.atleast_1d(np.poly(mirrored))), trailing))


def _filtered_rows(segment: Segment, order: Order, a: FloatArray, y_sim: FloatArray) -> FloatArray:
    """The columns [Z, Phi, y] of one segment, (rows, 2 (na + nb) + 1), filtered by 1/A, initial state removed."""
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    # Phi_f = 1/A [ -y(t-1)     ... -y(t-na)      u(t-nk) ... u(t-nk-nb+1) ]
    # Z_f   = 1/A [ -y_sim(t-1) ... -y_sim(t-na)  u(t-nk) ... u(t-nk-nb+1) ]
    #
    # y(t) = phi(t)' theta + A e(t) holds on every complete row, wherever the segment begins. So rows are formed first
    # and filtered afterwards; what the filter does not know, its state before the first row, adds a free response
    # F x0 with unknown x0 (na,) to the filtered equation. Projecting the columns of F out leaves the error e itself.
    Phi, target = regressors(segment, order)
    Z, _ = regressors(Segment(segment.u, y_sim), order)
    columns = np.column_stack((Z, Phi, target))
    F = lfilter([1.0], a, np.eye(len(target), len(a) - 1), axis=0)
    Q, _ = np.linalg.qr(F)
    filtered = np.asarray(lfilter([1.0], a, columns, axis=0), dtype=np.float64)
    return filtered - Q @ (Q.T @ filtered)


def _iterate(
    segments: tuple[Segment, ...], order: Order, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """One refinement: new theta, its standard errors, and the old model's mean squared simulation error."""
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    simulated = [np.asarray(lfilter(b, a, segment.u), dtype=np.float64) for segment in segments]
    rows = np.concatenate(
        [_filtered_rows(segment, order, a, y_sim) for segment, y_sim in zip(segments, simulated, strict=True)]
    )
    n, d = len(rows), (rows.shape[1] - 1) // 2
    Z, Phi, y = rows[:, :d], rows[:, d : 2 * d], rows[:, -1]
    theta, spread = solve(Z, Phi, y)
    freedom = max(1, n - d - len(segments) * (len(a) - 1))
    variance = float(np.sum((y - Phi @ theta) ** 2)) / freedom
    squares = sum(float(np.sum((one.y - y_sim) ** 2)) for one, y_sim in zip(segments, simulated, strict=True))
    return theta, np.sqrt(spread * variance), squares / sum(len(one) for one in segments)


def sriv(segments: tuple[Segment, ...], order: Order) -> Estimate:
    """SRIV estimate over all segments, started from least squares.

    standard_errors = sqrt(diag (Z_f' Z_f)^-1 var(e)), right for white output noise. Poles outside the unit circle are
    reflected while it iterates. If the loop does not settle, the iterate with the smallest simulation error is
    returned and `converged` is False.
    Raises IdentificationError if the data cannot tell the parameters apart.
    """
    best = Estimate(np.empty(0), np.empty(0), np.inf, 0)
    theta = least_squares(segments, order).theta
    errors = np.full(len(theta), np.nan)
    samples = sum(len(segment) for segment in segments)
    for iteration in range(MAX_ITERATIONS):
        a, b = polynomials(theta, order)
        stable = reflect_poles(a)
        moved, moved_errors, loss = _iterate(segments, order, stable, b)
        if not (np.isfinite(moved).all() and np.isfinite(loss)):
            break
        if stable is a and loss < best.loss and iteration > 0:
            best = Estimate(theta, errors, loss, samples, iteration, converged=False)
        settled = np.abs(moved - theta) <= np.maximum(STEP_OVER_ERROR * moved_errors, STEP_RELATIVE * np.abs(theta))
        if stable is a and np.all(settled):
            return Estimate(theta, moved_errors, loss, samples, iteration + 1)
        theta, errors = moved, moved_errors
    if best.rows == 0:
        raise IdentificationError("SRIV found no stable model; lower the order, or record more excited flight")
    return best
