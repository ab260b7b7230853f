"""Covariance of SRIV when the output noise is coloured, as it always is behind a smoothing filter."""

import numpy as np

from mavdiag.identify.arx import polynomials, regressors
from mavdiag.identify.data import Segment, triangle
from mavdiag.identify.model import Order
from mavdiag.telemetry import FloatArray

__all__ = ["coloured_covariance"]


def coloured_covariance(segments: tuple[Segment, ...], order: Order, theta: FloatArray) -> FloatArray:
    """Covariance of an SRIV estimate theta, (na + nb, na + nb), whatever the spectrum of its output error.

    cov theta = M S M with M = (Z_f' Z_f)^-1 and S = sum_k r_e(k) sum_t z_f(t) z_f(t + k)': the first-order covariance
    of an instrumental variable estimate (Soderstrom and Stoica, System Identification, ch. 8), which is M var(e) for
    white e. r_e is the autocovariance of the residual under a Bartlett window of sqrt(n) lags, n samples in all (our
    choice; the window must reach over the smoothing filter).
    """
    rows = [_projected(segment, order, theta) for segment in segments]
    n, d = sum(len(one) for one in rows), len(theta)
    lags = int(np.sqrt(n))
    weights = np.sum([_autocorrelation(one[:, d], lags) for one in rows], axis=0) / n * (1.0 - np.arange(lags) / lags)
    R = triangle(np.concatenate([one[:, :d] for one in rows]))
    M = np.linalg.inv(R) @ np.linalg.inv(R).T
    S = np.sum([_weighted_products(one[:, :d], weights) for one in rows], axis=0)
    covariance: FloatArray = M @ (0.5 * (S + S.T)) @ M
    return covariance


def _projected(segment: Segment, order: Order, theta: FloatArray) -> FloatArray:
    """Columns [Z_f e] of a segment, (rows, na + nb + 1), with the filter's free response projected out as in `sriv`."""
    from scipy.signal import lfilter  # 0.8 s to import: only offline work pays it

    a, b = polynomials(theta, order)
    Z, _ = regressors(Segment(segment.u, np.asarray(lfilter(b, a, segment.u), dtype=np.float64)), order)
    Phi, y = regressors(segment, order)
    filtered = np.asarray(lfilter([1.0], a, np.vstack((Z.T, y - Phi @ theta))), dtype=np.float64).T
    F = np.asarray(lfilter([1.0], a, np.eye(order[0], len(y))), dtype=np.float64).T
    Q, _ = np.linalg.qr(F)
    return filtered - Q @ (Q.T @ filtered)


def _autocorrelation(e: FloatArray, lags: int) -> FloatArray:
    """sum_t e(t) e(t + k) for k = 0..lags - 1."""
    size = 2 * max(len(e), lags)
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(e, size)) ** 2, size)[:lags], dtype=np.float64)


def _weighted_products(Z: FloatArray, weights: FloatArray) -> FloatArray:
    """sum_k w(|k|) sum_t z(t) z(t + k)', (d, d), by one product of spectra; w ends at len(weights) - 1."""
    size = 2 * max(len(Z), len(weights))
    both_sides = np.zeros(size)
    both_sides[: len(weights)] = weights
    both_sides[size - len(weights) + 1 :] = weights[:0:-1]
    spectrum = np.fft.fft(Z, size, axis=0)
    power = np.real(np.fft.fft(both_sides))[:, None]
    return np.asarray(np.real(spectrum.conj().T @ (spectrum * power)) / size, dtype=np.float64)
