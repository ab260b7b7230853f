"""How the outputs change with the commands of roll, pitch and yaw: the regression behind `detect`."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mavdiag.airframe.trim import MIN_OUTPUT
from mavdiag.rows.block import Block
from mavdiag.telemetry import BoolArray, FloatArray

__all__ = ["Fit", "Stretch", "fit_outputs", "moving_outputs", "stretches_of"]

SPAN_S = 0.1  # changes over this time: longer than output periods and motor lag, shorter than trims (our choice)
LAGS_S = (0.0, 0.02, 0.04, 0.06, 0.1, 0.15)  # of the acceleration: motor lag and gyro filter (our choice)
MIN_CHANGES = 40  # spans without overlap (our choice)
DRIVERS = ("torque command", "rate error", "angular acceleration")


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The regression of some outputs, all together.

    driver: what they were explained by.
    effects: (3, outputs) change of the outputs for one standard deviation of each driver's change.
    F: (3,) of roll, pitch and yaw: over all outputs, how far the driver's effect stands out of the noise.
    followed: (outputs,) of each output: how far the effect of all drivers stands out of its noise, an F value too.
    explained: share of the outputs' changes.
    spread: (3, 3) mean products of the drivers' changes, each over its standard deviation.
    """

    driver: str
    effects: FloatArray
    F: FloatArray
    followed: FloatArray
    explained: float
    spread: FloatArray

    @property
    def together(self) -> float:
        """The largest variance inflation factor: how much less is known of a driver for moving with the others."""
        return float(np.diag(np.linalg.pinv(self.spread)).max())

    def lost(self, mixing: FloatArray) -> float:
        """How much of the explained energy a layout cannot explain, 0..1, whatever gains its axes have.

        mixing: (outputs, 3), see `RotorLayout.mixing`.
        """
        # least g >= 0 of  tr (E - diag(g) B')' S (E - diag(g) B'),  E effects, B mixing, S spread: a normal equation
        S, E, B = self.spread, self.effects, mixing
        total = float(np.einsum("kr,kl,lr->", E, S, E))
        M, v = S * (B.T @ B), np.einsum("kl,lr,rk->k", S, E, B)
        root = np.linalg.cholesky(M + 1e-9 * np.trace(M) * np.eye(3))
        g, _ = nnls(root.T, np.linalg.solve(root, v))
        return float((total - 2 * g @ v + g @ M @ g) / total) if total > 0 else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Unbroken rows. outputs: (n, outputs). drivers: (3, n, 3), in the order of `DRIVERS`, nan where unknown."""

    dt_s: float
    outputs: FloatArray
    drivers: FloatArray
    valid: BoolArray


def stretches_of(blocks: Iterable[Block]) -> list[Stretch]:
    """Blocks that follow each other without a gap, put together."""
    runs: list[list[Block]] = []
    for block in blocks:
        if len(block) == 0:
            continue
        last = runs[-1][-1] if runs else None
        limit_ns = 2.5e9 * block.dt_s
        if last is None or block.segment != last.segment or not 0 < block.t_ns[0] - last.t_ns[-1] < limit_ns:
            runs.append([])
        runs[-1].append(block)
    width = max((block.actuator.shape[1] for run in runs for block in run), default=0)
    return [_joined(run, width) for run in runs]


def _joined(run: Sequence[Block], width: int) -> Stretch:
    absent = [np.full((len(block), width - block.actuator.shape[1]), np.nan) for block in run]
    outputs = np.vstack([np.hstack([block.actuator, none]) for block, none in zip(run, absent, strict=True)])
    rate, wanted = np.vstack([block.rate for block in run]), np.vstack([block.rate_setpoint for block in run])
    acceleration = np.diff(rate, axis=0, prepend=np.nan)
    drivers = np.stack([np.vstack([block.torque for block in run]), wanted - rate, acceleration])
    return Stretch(run[0].dt_s, outputs, drivers, np.concatenate([block.valid for block in run]))


def moving_outputs(stretches: Sequence[Stretch]) -> list[int]:
    """Columns of the outputs that change in valid rows and carry: those that stand still or idle are no motors."""
    if not stretches:
        return []
    outputs = np.vstack([one.outputs[one.valid] for one in stretches])
    known = np.isfinite(outputs)
    low = np.where(known, outputs, np.inf).min(axis=0, initial=np.inf)
    high = np.where(known, outputs, -np.inf).max(axis=0, initial=-np.inf)
    mean = np.where(known, outputs, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return [int(i) for i in np.flatnonzero((high > low) & (mean > MIN_OUTPUT))]


def fit_outputs(stretches: Sequence[Stretch], columns: Sequence[int]) -> Fit | None:
    """The fit of these outputs to the first driver that the data carry; None if there is too little of it.

    Of the acceleration the lag that explains most is taken.
    """
    relative = [_relative(one, columns) for one in stretches]
    judged = sum(int(np.isfinite(w[:, 0]).sum()) for w in relative)
    for i in range(len(DRIVERS)):
        known = [
            np.isfinite(w[:, 0]) & np.isfinite(one.drivers[i]).all(axis=1)
            for w, one in zip(relative, stretches, strict=True)
        ]
        if 2 * sum(int(rows.sum()) for rows in known) <= judged:
            continue
        lags_s = LAGS_S if i == len(DRIVERS) - 1 else (0.0,)
        fits = [_regression(relative, stretches, i, lag_s) for lag_s in lags_s]
        return max((fit for fit in fits if fit is not None), key=lambda fit: fit.explained, default=None)
    return None


def _relative(one: Stretch, columns: Sequence[int]) -> FloatArray:
    """w = o/mean(o) - 1, (n, outputs), nan where a row is not judged or the motors do not carry."""
    outputs = np.where(one.valid[:, None], one.outputs[:, columns], np.nan)
    mean = outputs.mean(axis=1, keepdims=True)
    return np.asarray(outputs / np.where(mean > MIN_OUTPUT, mean, np.nan) - 1.0, dtype=np.float64)


def _regression(relative: Sequence[FloatArray], stretches: Sequence[Stretch], i: int, lag_s: float) -> Fit | None:
    """Least squares of the outputs' changes on driver `i`, `lag_s` later; None if there is too little of it."""
    cuts, overlap = [], 1
    for w, one in zip(relative, stretches, strict=True):
        span, lag = max(1, round(SPAN_S / one.dt_s)), round(lag_s / one.dt_s)
        n, overlap, x = len(w) - span - lag, max(overlap, span), one.drivers[i]
        if n > 0:
            cuts.append(np.hstack([w[span : span + n] - w[:n], x[span + lag :] - x[lag : lag + n]]))
    both = np.vstack(cuts) if cuts else np.empty((0, 6))
    both = both[np.isfinite(both).all(axis=1)]
    W, X = both[:, :-3], both[:, -3:]
    scale, total = X.std(axis=0) if len(X) else np.zeros(3), float(np.square(W).sum())
    if len(X) < MIN_CHANGES * overlap or total == 0:
        return None
    X = X / np.where(scale > 0, scale, 1.0)
    effects, *_ = np.linalg.lstsq(X, W, rcond=None)
    left, explained = np.square(W - X @ effects).sum(axis=0), np.square(X @ effects).sum(axis=0)
    noise = overlap * left.sum() / W.size * np.diag(np.linalg.pinv(X.T @ X))  # variance of an effect; spans overlap
    F = np.square(effects).mean(axis=1) / np.maximum(noise, 1e-300)
    followed = explained / 3 / np.maximum(overlap * left / len(W), 1e-300)
    return Fit(
        DRIVERS[i],
        np.asarray(effects, dtype=np.float64),
        np.asarray(F, dtype=np.float64),
        np.asarray(followed, dtype=np.float64),
        1 - float(left.sum()) / total,
        np.asarray(X.T @ X / len(X), dtype=np.float64),
    )
