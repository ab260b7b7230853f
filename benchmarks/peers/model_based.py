"""Model-based contenders (T 1.3.1): Kalman innovation, sliding-mode observer, bank of models; and a fixed threshold."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter

from mavdiag.identify import ArxModel, fit
from mavdiag.jit import allocating
from mavdiag.telemetry import FloatArray
from peers.contender import Learner, Scored, Scorer
from peers.flights import Flown
from peers.torque import TorqueModel, blame, drive, fit_torque
from peers.windows import mean_over

__all__ = ["bank_of_models", "fixed_threshold", "kalman", "sliding_mode"]

SETTLE_S = 2.0  # of every filter, not scored
TUNING_ROWS = 60_000  # of healthy flight, to choose the Kalman filter's one ratio on

NIS_WINDOW_S = 0.5
DISTURBANCE_HZ = 2.0  # corner of the Kalman filter's disturbance state (our choice)
RATIOS = tuple(10.0**e for e in range(-2, 7))  # variance of that state over the gyro's [1/s^2]

SLIDING_FACTOR = 4.0  # the switching gain over the healthy 99.9th percentile of |d| (our choice)
INJECTION_HZ = 0.5  # low-pass that recovers the equivalent injection (our choice)

BANK_STRIDE = 10  # rows: behind the 0.1 s window nothing is lost at 100 Hz
BANK_WINDOW_S = 1.0
BANK_ORDER = (2, 2, 1)
AXES = (0, 1)  # roll and pitch, as in T


def fixed_threshold(_others: Sequence[Flown]) -> Learner:
    """|rate error| > constant: score = max over roll and pitch of |y - u| [rad/s], no model at all.

    T 1.3.2 (threshold-based); limit checking in Isermann, Fault-Diagnosis Systems, 2006, ch. 7.
    """

    def learn(_healthy: Sequence[Flown]) -> Scorer:
        return lambda one: Scored.anonymous(one.t_s + one.delay_s, np.abs(one.y - one.u)[:, :2].max(axis=1))

    return learn


@dataclass(frozen=True, slots=True, eq=False)
class _Filter:
    """A steady-state Kalman predictor of one axis as e = y - H_f f - H_y y. S: variance of e."""

    forced: FloatArray
    measured: FloatArray
    poles: FloatArray
    S: float

    def innovation(self, f: FloatArray, y: FloatArray) -> FloatArray:
        """(n,), (n,) -> (n,)."""
        predicted = lfilter(self.forced, self.poles, f) + lfilter(self.measured, self.poles, y)
        return np.asarray(y - predicted, dtype=np.float64)


def kalman(_others: Sequence[Flown]) -> Learner:
    """Normalised innovation squared of a Kalman filter on the raw gyro, three axes, mean of 0.5 s.

    x = [omega, d], domega/dt = c omega + d + k lag(m) + d0 (see `torque`), d a first-order noise of 2 Hz. The one free
    figure, the ratio of process to gyro noise, maximises the healthy likelihood. Score: sqrt(mean e^2/S), 1 in healthy
    flight; its square times the degrees of freedom is the chi-square statistic.
    T 1.3.1 (Kalman-based); Mehra & Peschon, Automatica 7 (1971) 637-640.
    """

    def learn(healthy: Sequence[Flown]) -> Scorer:
        model = fit_torque(healthy)
        filters = [_tuned(model, axis, healthy) for axis in range(3)]

        def score(one: Flown) -> Scored:
            f = drive(model, one)
            squares = [each.innovation(f[:, i], one.gyro[:, i]) ** 2 / each.S for i, each in enumerate(filters)]
            rows, settled = round(NIS_WINDOW_S / one.dt_s), round(SETTLE_S / one.dt_s)
            mean = mean_over(np.mean(squares, axis=0)[settled:], rows)
            return Scored.anonymous(one.t_s[settled + rows - 1 :], np.sqrt(np.maximum(mean, 0.0)))

        return score

    return learn


def _tuned(model: TorqueModel, axis: int, healthy: Sequence[Flown]) -> _Filter:
    flights: list[tuple[FloatArray, FloatArray]] = []
    for one in healthy:
        if sum(len(y) for _, y in flights) < TUNING_ROWS:
            flights.append((drive(model, one)[:, axis], one.gyro[:, axis]))
    dt_s = healthy[0].dt_s
    settled = round(SETTLE_S / dt_s)
    found = []
    for ratio in RATIOS:
        one_filter = _filter(float(model.damping[axis]), ratio, dt_s)
        e = np.concatenate([one_filter.innovation(f, y)[settled:] for f, y in flights])
        found.append(_Filter(one_filter.forced, one_filter.measured, one_filter.poles, float(np.mean(e**2))))
    return min(found, key=lambda each: each.S)


def _filter(damping: float, ratio: float, dt_s: float) -> _Filter:
    """The predictor x+ = (A - K C) x + B f + K y, e = y - C x, as transfer functions."""
    decay = math.exp(-2.0 * math.pi * DISTURBANCE_HZ * dt_s)
    A = np.array([[1.0 + damping * dt_s, dt_s], [0.0, decay]])
    C = np.array([[1.0, 0.0]])
    Q = np.diag([0.0, ratio * (1.0 - decay**2)])
    P = solve_discrete_are(A.T, C.T, Q, np.eye(1))
    K = A @ P @ C.T / (C @ P @ C.T + 1.0)
    F = A - K @ C
    poles = np.array([1.0, -np.trace(F), np.linalg.det(F)])
    return _Filter(_numerator(F, np.array([dt_s, 0.0])), _numerator(F, K[:, 0]), poles, 1.0)


def _numerator(F: FloatArray, b: FloatArray) -> FloatArray:
    """Of C (zI - F)^-1 b with C = [1 0]: z^-1 b_1 + z^-2 (F_12 b_2 - F_22 b_1)."""
    return np.array([0.0, b[0], F[0, 1] * b[1] - F[1, 1] * b[0]])


def sliding_mode(_others: Sequence[Flown]) -> Learner:
    """Disturbance torque from a sliding-mode observer's equivalent injection, against its healthy scatter.

        domega^/dt = k lag(m) + d0 + c omega^ + L sign(omega - omega^),    d^ = low-pass_0.5Hz( L sign(omega - omega^) )

    Score: sqrt((d^ - mean)' inv(cov) (d^ - mean)); the rotor is the one whose direction explains d^ best (`blame`).
    T 1.3.1 (observer-based); Edwards, Spurgeon & Patton, Automatica 36 (2000) 541-553.
    """

    def learn(healthy: Sequence[Flown]) -> Scorer:
        model = fit_torque(healthy)
        gain = SLIDING_FACTOR * _unexplained(model, healthy)
        seen = np.concatenate([_injection(model, gain, one)[:: round(0.05 / one.dt_s)] for one in healthy])
        mean, covariance = seen.mean(axis=0), np.cov(seen.T)
        root = np.linalg.inv(np.linalg.cholesky(covariance))

        def score(one: Flown) -> Scored:
            d = _injection(model, gain, one) - mean
            distance = np.linalg.norm(d @ root.T, axis=1)
            rotor = blame(model, d, covariance).argmax(axis=1) + 1
            return Scored(one.t_s[-len(d) :], distance, rotor)

        return score

    return learn


def _unexplained(model: TorqueModel, healthy: Sequence[Flown]) -> FloatArray:
    """99.9th percentile of |domega/dt - model|, smoothed over 50 ms, (3,) [rad/s^2]."""
    found = []
    for one in healthy:
        rows = round(0.05 / one.dt_s)
        slope = (one.gyro[rows:] - one.gyro[:-rows]) / (rows * one.dt_s)
        explained = mean_over(drive(model, one) + model.damping * one.gyro, rows)[: len(slope)]
        found.append(np.abs(slope - explained))
    return np.asarray(np.percentile(np.concatenate(found), 99.9, axis=0), dtype=np.float64)


def _injection(model: TorqueModel, gain: FloatArray, one: Flown) -> FloatArray:
    switched = _switch(drive(model, one), np.ascontiguousarray(one.gyro), model.damping, gain, one.dt_s)
    decay = math.exp(-2.0 * math.pi * INJECTION_HZ * one.dt_s)
    low = lfilter([1.0 - decay], [1.0, -decay], switched, axis=0)
    return np.asarray(low[round(SETTLE_S / one.dt_s) :], dtype=np.float64)


@allocating
def _switch(f: FloatArray, omega: FloatArray, damping: FloatArray, gain: FloatArray, dt_s: float) -> FloatArray:
    """The discontinuous term of each row, (n, 3): Euler's method, as it would run on board."""
    out = np.empty_like(omega)
    estimate = omega[0].copy()
    for row in range(len(omega)):
        for axis in range(3):
            v = gain[axis] if omega[row, axis] > estimate[axis] else -gain[axis]
            out[row, axis] = v
            estimate[axis] += dt_s * (f[row, axis] + damping[axis] * estimate[axis] + v)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """Output-error models of roll and pitch and the log-variance of their residuals, (2,)."""

    models: tuple[ArxModel, ...]
    log_variance: FloatArray

    def cost(self, one: Flown) -> FloatArray:
        """-2 log-likelihood of each thinned row, but for a constant, (n,)."""
        e = np.column_stack(_free_run(self.models, one))
        return np.asarray((e**2 * np.exp(-self.log_variance) + self.log_variance).sum(axis=1), dtype=np.float64)


def bank_of_models(others: Sequence[Flown]) -> Learner:
    """A bank of output-error models: one per fault type, from faulty flights of other airframes, against the own one.

    Each hypothesis is a (2, 2, 1) model from commanded to measured rate for roll and pitch, by SRIV, and the variance
    of its free-run residual. Score: largest mean log-likelihood ratio of a fault to healthy over 1 s. Residuals are
    taken as white, which they are not, so it is a score and no probability. It names the type, not the rotor.
    T 1.3.1 (multiple models); Magill, IEEE Trans. Automatic Control 10 (1965) 434-439.
    """
    kinds = sorted({one.truth.fault[:2] for one in others if one.truth is not None})
    faults = [_hypothesis([one for one in others if one.truth and one.truth.fault[:2] == kind]) for kind in kinds]

    def learn(healthy: Sequence[Flown]) -> Scorer:
        own = _hypothesis(healthy)

        def score(one: Flown) -> Scored:
            base = own.cost(one)
            rows = round(BANK_WINDOW_S / (BANK_STRIDE * one.dt_s))
            ratios = [mean_over(0.5 * (base - fault.cost(one)), rows) for fault in faults]
            t_s = one.t_s[::BANK_STRIDE][-len(base) :][rows - 1 :] + one.delay_s
            return Scored.anonymous(t_s, np.max(ratios, axis=0))

        return score

    return learn


def _hypothesis(flights: Sequence[Flown]) -> _Hypothesis:
    dt_s = flights[0].dt_s * BANK_STRIDE
    models = tuple(
        fit(
            [one.u[::BANK_STRIDE, axis] for one in flights],
            [one.y[::BANK_STRIDE, axis] for one in flights],
            BANK_ORDER,
            dt=dt_s,
        )
        for axis in AXES
    )
    residuals = [np.column_stack(_free_run(models, one)) for one in flights]
    return _Hypothesis(models, np.log(np.mean(np.concatenate(residuals) ** 2, axis=0)))


def _free_run(models: Sequence[ArxModel], one: Flown) -> list[FloatArray]:
    settled = round(SETTLE_S / (BANK_STRIDE * one.dt_s))
    u, y = one.u[::BANK_STRIDE], one.y[::BANK_STRIDE]
    return [(y[:, i] - model.simulate(u[:, i]))[settled:] for i, model in zip(AXES, models, strict=True)]
