"""From motor outputs to angular acceleration: the small physical model that the Kalman filter and the observer share.

    w_i = duty_i^2 / mean(duty^2) - 1       share of thrust; the battery cancels
    m   = C w                               roll, pitch and yaw trim, C = pinv(B) of the frame's signs
    domega/dt = k lag_tau(m) + c omega + d0 + d

k and c by least squares on healthy flights for each axis, tau by a grid, d0 the healthy mean; d is what the model does
not explain: for healthy rotors wind, for a damaged one its missing or fluctuating thrust.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, savgol_filter

from mavdiag.airframe.layout import layout_named
from mavdiag.telemetry import FloatArray
from peers.flights import Flown

__all__ = ["TorqueModel", "blame", "drive", "fit_torque", "trims"]

FRAME = "qdrone2"
LAGS_S = (0.005, 0.01, 0.015, 0.02, 0.03, 0.04)  # our choice
STRIDE = 10  # rows skipped: what passed a 0.1 s window needs no 1 kHz


@dataclass(frozen=True, slots=True, eq=False)
class TorqueModel:
    """All (3,), for roll, pitch, yaw. gain k [rad/s^2], damping c [1/s], offset d0 [rad/s^2], lag tau [s]."""

    gain: FloatArray
    damping: FloatArray
    offset: FloatArray
    lag_s: FloatArray


def fit_torque(flights: Sequence[Flown]) -> TorqueModel:
    """Least squares on smoothed healthy rows."""
    dt_s = flights[0].dt_s
    window = round(0.1 / dt_s) | 1
    acceleration = [_thin(savgol_filter(one.gyro, window, 2, deriv=1, delta=dt_s, axis=0)) for one in flights]
    rate = [_thin(one.y) for one in flights]
    shares = [trims(one) for one in flights]
    best: list[tuple[float, FloatArray, float]] = [(np.inf, np.zeros(3), 0.0)] * 3
    for lag_s in LAGS_S:
        smooth = [_thin(savgol_filter(_lagged(m, lag_s, dt_s), window, 2, axis=0)) for m in shares]
        columns = (smooth, rate, acceleration)
        for axis in range(3):
            # [ m  omega ] [k c]' = domega/dt     (n, 2), the rows of all flights, each less its mean: the wind differs
            m, omega, target = (np.concatenate([x[:, axis] - x[:, axis].mean() for x in one]) for one in columns)
            phi = np.column_stack([m, omega])
            theta = np.linalg.lstsq(phi, target, rcond=None)[0]
            loss = float(np.mean((target - phi @ theta) ** 2))
            best[axis] = min(best[axis], (loss, theta, lag_s), key=lambda found: found[0])
    k, c = np.stack([theta for _, theta, _ in best], axis=1)
    c = np.minimum(c, 0.0)
    means = [np.stack([x.mean(axis=0) for x in one]).mean(axis=0) for one in (acceleration, shares, rate)]
    return TorqueModel(k, c, means[0] - k * means[1] - c * means[2], np.array([lag_s for _, _, lag_s in best]))


def drive(model: TorqueModel, one: Flown) -> FloatArray:
    """k lag(m) + d0 of each row, (n, 3) [rad/s^2]."""
    m = trims(one)
    lagged = np.column_stack([_lagged(m[:, axis], float(model.lag_s[axis]), one.dt_s) for axis in range(3)])
    return lagged * model.gain + model.offset


def blame(model: TorqueModel, d: FloatArray, covariance: FloatArray) -> FloatArray:
    """Evidence that one rotor alone makes d, (n, 3) -> (n, 4): |g_j' W d| / sqrt(g_j' W g_j), W the inverse covariance.

    The likelihood ratio of one known direction. g_j = k * c_j is the acceleration that a unit change of rotor j makes,
    with yaw reversed: a damaged blade loses thrust and gains drag, so it rolls and pitches less and yaws more than
    modelled.
    """
    G = model.gain[:, None] * layout_named(FRAME).unmixing * np.array([[1.0], [1.0], [-1.0]])
    W = np.linalg.inv(covariance)
    evidence: FloatArray = np.abs(d @ W @ G) / np.sqrt(np.einsum("kj,kl,lj->j", G, W, G))
    return evidence


def trims(one: Flown) -> FloatArray:
    """Roll, pitch and yaw trim m of the motors, (n, 3) [fraction of hover thrust]."""
    thrust = one.duty**2
    w = thrust / thrust.mean(axis=1, keepdims=True) - 1.0
    m: FloatArray = w @ layout_named(FRAME).unmixing.T
    return m


def _lagged(x: FloatArray, lag_s: float, dt_s: float) -> FloatArray:
    decay = float(np.exp(-dt_s / lag_s))
    start = decay * x[:1]
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], x, axis=0, zi=start)[0], dtype=np.float64)


def _thin(x: FloatArray) -> FloatArray:
    return np.asarray(x, dtype=np.float64)[STRIDE:-STRIDE:STRIDE]
