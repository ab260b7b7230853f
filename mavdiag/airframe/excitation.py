"""How the outputs change with the commands of roll, pitch and yaw: the regression behind `detect`."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mavdiag.airframe.trim import MIN_OUTPUT
from mavdiag.rows.block import Block
from mavdiag.telemetry import BoolArray, FloatArray

__all__ = ["Fit", "Stretch", "Stretches", "fit_outputs", "moving_outputs"]

SPAN_S = 0.1  # changes over this time: longer than output periods and motor lag, shorter than trims (our choice)
LAGS_S = (0.0, 0.02, 0.04, 0.06, 0.1, 0.15)  # of the acceleration: motor lag and gyro filter (our choice)
MIN_CHANGES = 40  # spans without overlap (our choice)
SINGULAR = 1e-12  # of the largest eigenvalue of the drivers' products: below it there is no direction
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


class Stretches:
    """The stretches of blocks that are looked at several times: each time one after the other, made anew.

    So of many flights one stretch is in memory at a time, if the blocks come from where they are kept. outputs: columns
    of outputs in all of them.
    """

    def __init__(self, blocks: Iterable[Block]) -> None:
        self._blocks = tuple(blocks) if isinstance(blocks, Iterator) else blocks
        self.outputs = max((block.actuator.shape[1] for block in self._blocks if len(block)), default=0)

    def __iter__(self) -> Iterator[Stretch]:
        run: list[Block] = []
        for block in self._blocks:
            if len(block) == 0:
                continue
            if run and not _follows(block, run[-1]):
                yield _joined(run, self.outputs)
                run = []
            run.append(block)
        if run:
            yield _joined(run, self.outputs)


def _follows(block: Block, last: Block) -> bool:
    """Whether a block follows the last one without a gap."""
    limit_ns = 2.5e9 * block.dt_s
    return block.segment == last.segment and bool(0 < block.t_ns[0] - last.t_ns[-1] < limit_ns)


def _joined(run: Sequence[Block], width: int) -> Stretch:
    absent = [np.full((len(block), width - block.actuator.shape[1]), np.nan) for block in run]
    outputs = np.vstack([np.hstack([block.actuator, none]) for block, none in zip(run, absent, strict=True)])
    rate, wanted = np.vstack([block.rate for block in run]), np.vstack([block.rate_setpoint for block in run])
    acceleration = np.diff(rate, axis=0, prepend=np.nan)
    drivers = np.stack([np.vstack([block.torque for block in run]), wanted - rate, acceleration])
    return Stretch(run[0].dt_s, outputs, drivers, np.concatenate([block.valid for block in run]))


def moving_outputs(stretches: Stretches) -> list[int]:
    """Columns of the outputs that change in valid rows and carry: those that stand still or idle are no motors."""
    low, high = np.full(stretches.outputs, np.inf), np.full(stretches.outputs, -np.inf)
    total, count = np.zeros(stretches.outputs), np.zeros(stretches.outputs)
    for one in stretches:
        outputs = one.outputs[one.valid]
        known = np.isfinite(outputs)
        low = np.minimum(low, np.where(known, outputs, np.inf).min(axis=0, initial=np.inf))
        high = np.maximum(high, np.where(known, outputs, -np.inf).max(axis=0, initial=-np.inf))
        total, count = total + np.where(known, outputs, 0.0).sum(axis=0), count + known.sum(axis=0)
    return [int(i) for i in np.flatnonzero((high > low) & (total / np.maximum(count, 1) > MIN_OUTPUT))]


def fit_outputs(stretches: Stretches, columns: Sequence[int]) -> Fit | None:
    """The fit of these outputs to the first driver that the data carry; None if there is too little of it.

    Of the acceleration the lag that explains most is taken.
    """
    judged, known = 0, np.zeros(len(DRIVERS), dtype=np.int64)
    for one in stretches:
        flown = np.isfinite(_relative(one, columns)[:, 0])
        judged += int(flown.sum())
        known += [int((flown & np.isfinite(driver).all(axis=1)).sum()) for driver in one.drivers]
    for i in np.flatnonzero(2 * known > judged).tolist():
        lags_s = LAGS_S if i == len(DRIVERS) - 1 else (0.0,)
        sums = [_Sums(len(columns)) for _ in lags_s]
        for one in stretches:
            w = _relative(one, columns)
            for lag_s, found in zip(lags_s, sums, strict=True):
                found.add(one, w, i, lag_s)
        fits = [found.fit(DRIVERS[i]) for found in sums]
        return max((fit for fit in fits if fit is not None), key=lambda fit: fit.explained, default=None)
    return None


def _relative(one: Stretch, columns: Sequence[int]) -> FloatArray:
    """w = o/mean(o) - 1, (n, outputs), nan where a row is not judged or the motors do not carry."""
    outputs = np.where(one.valid[:, None], one.outputs[:, columns], np.nan)
    mean = outputs.mean(axis=1, keepdims=True)
    return np.asarray(outputs / np.where(mean > MIN_OUTPUT, mean, np.nan) - 1.0, dtype=np.float64)


class _Sums:
    """Sums over stretches for the least squares of the outputs' changes W on those of a driver X, some lag later.

    rows: how many there are. total: (3,) sum of X. products: of [ W X ] with itself.
    """

    def __init__(self, outputs: int) -> None:
        self._rows, self._overlap = 0, 1
        self._total, self._products = np.zeros(3), np.zeros((outputs + 3, outputs + 3))

    def add(self, one: Stretch, w: FloatArray, driver: int, lag_s: float) -> None:
        """Take a stretch, whose outputs are `_relative`."""
        span, lag = max(1, round(SPAN_S / one.dt_s)), round(lag_s / one.dt_s)
        n, self._overlap, x = len(w) - span - lag, max(self._overlap, span), one.drivers[driver]
        if n > 0:
            both = np.hstack([w[span : span + n] - w[:n], x[span + lag :] - x[lag : lag + n]])
            both = both[np.isfinite(both).all(axis=1)]
            self._rows += len(both)
            self._total += both[:, -3:].sum(axis=0)
            self._products += both.T @ both

    def fit(self, driver: str) -> Fit | None:
        """The fit; None if there is too little of it."""
        n, (ww, wx, xx) = self._rows, (self._products[:-3, :-3], self._products[:-3, -3:], self._products[-3:, -3:])
        total = float(np.trace(ww))
        if n < MIN_CHANGES * self._overlap or total == 0:
            return None
        scale = np.sqrt(np.maximum(np.diag(xx) / n - np.square(self._total / n), 0.0))
        scale = np.where(scale > 0, scale, 1.0)
        wx, xx = wx / scale, xx / scale / scale[:, None]
        # [ X'X ] effects = [ X'W ]; drivers that move together by nature leave the smallest effects
        effects = np.linalg.pinv(xx, rcond=SINGULAR, hermitian=True) @ wx.T
        explained = np.einsum("kr,kl,lr->r", effects, xx, effects)
        left = np.maximum(np.diag(ww) - 2 * np.einsum("kr,rk->r", effects, wx) + explained, 0.0)
        noise = self._overlap * left.sum() / (n * len(ww)) * np.diag(np.linalg.pinv(xx))  # of an effect; spans overlap
        F = np.square(effects).mean(axis=1) / np.maximum(noise, 1e-300)
        followed = explained / 3 / np.maximum(self._overlap * left / n, 1e-300)
        return Fit(
            driver,
            np.asarray(effects, dtype=np.float64),
            np.asarray(F, dtype=np.float64),
            np.asarray(followed, dtype=np.float64),
            1 - float(left.sum()) / total,
            np.asarray(xx / n, dtype=np.float64),
        )
