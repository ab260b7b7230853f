"""How good is a model: fit figures on other flights, and correlations of its residual (T 4.1.3, Model validation)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import Records, Segment, to_segments
from mavdiag.identify.model import ArxModel
from mavdiag.telemetry import FloatArray

LAGS = 25  # the usual depth of such tests, also MATLAB's resid default
Z99 = NormalDist().inv_cdf(0.995)  # deviations to both sides that hold 99 %


def r_squared(y: FloatArray, y_sim: FloatArray) -> float:
    """R_T^2 = 1 - var(y - y_sim)/var(y), both (n,), blind to a constant offset (T 5.4)."""
    return 1.0 - float(np.var(y - y_sim)) / _some(float(np.var(y)))


def nrmse_percent(y: FloatArray, y_sim: FloatArray) -> float:
    """Fit percentage 100 (1 - |y - y_sim| / |y - mean y|), both (n,) (T 4.1.3). Sees a constant offset."""
    return 100.0 * (1.0 - float(np.linalg.norm(y - y_sim)) / _some(float(np.linalg.norm(y - np.mean(y)))))


def _some(spread: float) -> float:
    if spread == 0.0:
        raise IdentificationError("y is constant; there is nothing to explain")
    return spread


@dataclass(frozen=True, slots=True)
class Validation:
    """Free-run fit of a model on flights: R_T^2, fit percentage, mean squared error [unit of y squared], samples."""

    r2t: float
    nrmse_fit: float
    mse: float
    samples: int


def free_run(model: ArxModel, segments: Sequence[Segment], settle_s: float = 0.0) -> Validation:
    """Simulate each segment from rest; its first `settle_s` [s] do not count. All errors are pooled (T 5.3, 5.4)."""
    if not 0.0 <= settle_s < math.inf:
        raise IdentificationError(f"the settling time must be 0 or more, not {settle_s} s")
    skip = round(settle_s / model.dt)
    y = np.concatenate([segment.y[skip:] for segment in segments])
    if len(y) == 0:
        raise IdentificationError(f"no record is longer than the settling time of {settle_s} s; lower it")
    simulated = np.concatenate([model.simulate(segment.u)[skip:] for segment in segments])
    mse = float(np.mean((y - simulated) ** 2))
    return Validation(r_squared(y, simulated), nrmse_percent(y, simulated), mse, len(y))


def validate(model: ArxModel, u: Records, y: Records, settle_s: float = 0.0) -> Validation:
    """Judge a model on flights it was not trained on, as `free_run`. u, y: one record each, (n,), or one per flight."""
    return free_run(model, to_segments(u, y, model.order), settle_s)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualReport:
    """Correlations of a residual e with itself and with the input u (Ljung, System Identification 2e, sec. 16.6)."""

    acf: FloatArray  # (lags + 1,) of e(t) with e(t - lag), lag = 0..lags
    ccf: FloatArray  # of e(t) with u(t - lag)
    acf_band99: float  # half width that holds 99 % of a true model's values
    ccf_band99: float


def examine_residual(e: FloatArray, u: FloatArray, lags: int = LAGS) -> ResidualReport:
    """Correlate a residual e with itself and with the input u at the same rows, both (n,)."""
    if u.shape != e.shape or e.ndim != 1 or len(e) <= 2 * lags:
        raise IdentificationError(f"the residual tests need e and u of one length above {2 * lags}")
    acf, ccf, input_acf = (_correlations(x, z, lags) for x, z in ((e, e), (e, u), (u, u)))
    # Bartlett: var ccf = sum over k = -lags..lags of r_e(k) r_u(k) / n, for coloured e and u
    widened = math.sqrt(max(1.0, 2 * float(acf @ input_acf) - 1.0))
    return ResidualReport(acf, ccf, Z99 / math.sqrt(len(e)), Z99 * widened / math.sqrt(len(e)))


def _correlations(x: FloatArray, z: FloatArray, lags: int) -> FloatArray:
    """sum_t x(t) z(t - lag) / sqrt(sum x^2 sum z^2) of the mean-removed x and z at lags 0..lags."""
    x, z = x - np.mean(x), z - np.mean(z)
    scale = math.sqrt(float(x @ x) * float(z @ z))
    if scale == 0.0:
        raise IdentificationError("the residual or the input is constant; there is nothing to correlate")
    return np.array([x[lag:] @ z[: len(z) - lag] for lag in range(lags + 1)]) / scale


def one_step_report(model: ArxModel, u: FloatArray, y: FloatArray, lags: int = LAGS) -> ResidualReport:
    """Examine the one-step prediction error, which least squares makes white. u, y: (n,)."""
    return examine_residual(y[model.lag :] - model.predict(u, y), u[model.lag :], lags)
