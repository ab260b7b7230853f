"""Find the rotor layout from flights: how the outputs change with the commands of roll, pitch and yaw."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.airframe.layout import LAYOUTS, RotorLayout
from mavdiag.rows.block import Block
from mavdiag.telemetry import BoolArray, FloatArray

__all__ = ["LayoutFinding", "detect_layout"]

SPAN_S = 0.1  # changes over this time: longer than output periods and motor lag, shorter than trims (our choice)
LAGS_S = (0.0, 0.02, 0.04, 0.06, 0.1, 0.15)  # of the acceleration: motor lag and gyro filter (our choice)
MIN_CHANGES = 40  # spans without overlap (our choice)
MIN_OUTPUT = 0.05  # mean output below which the motors do not carry (our choice)
MIN_EXPLAINED = 0.1  # share of the outputs' changes that the drivers must explain (our choice)
MIN_F = 10.0  # F value above which a driver counts as excited (our choice)
MIN_LIKENESS = 0.85  # below it no layout is named; x and plus are 0.71 like each other (our choice)
MAX_MISFIT = 0.5  # and 1 - likeness must be less than this share of the next layout's (our choice)
DRIVERS = ("torque command", "rate error", "angular acceleration")


@dataclass(frozen=True, slots=True)
class LayoutFinding:
    """What flights say about the layout.

    layout: the known layout that fits; None if none does, or it stays unclear.
    reason: why, in one sentence.
    likeness: (name, likeness in -1..1) of the known layouts with as many rotors, best first; empty without a fit.
    """

    layout: RotorLayout | None
    reason: str
    likeness: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """effects: (3, rotors) change of the outputs for one standard deviation of each driver's change. F: (3,)."""

    effects: FloatArray
    F: FloatArray
    explained: float


def detect_layout(blocks: Iterable[Block], known: Sequence[RotorLayout] = tuple(LAYOUTS.values())) -> LayoutFinding:
    """The known layout that healthy flying fits, from the rows of one or more flights.

    The drivers x of roll, pitch and yaw are the first of these that the vehicle sends: its torque command; its rate
    error (set-point minus gyro, to which the rate controller answers); the angular acceleration that the outputs make
    some lag later. With w = o/mean(o) - 1 of the outputs o that move at all, and changes over 0.1 s, so that trims and
    drifts do not count:

        [ dx_roll  dx_pitch  dx_yaw ] @ B_fit' = [ dw_1 ... dw_n ]      least squares, all three together
        likeness = sum_k e_k cos(B_fit column k, B column k) / sum_k e_k

    e_k: the energy that driver k explains, 0 if it is not excited (F < 10). A layout of which an excited column
    points the other way gets that column's cosine instead. The lag is the one that explains most. A layout is named if
    its likeness reaches 0.85 and lacks half as much to 1 as the next one. Any cut of the rows into blocks gives the
    same answer. Blind spots: outputs that move but are no motors; a vehicle that hardly turns.
    """
    stretches = _stretches(blocks)
    moving = _moving(stretches)
    if len(moving) < 3:
        return LayoutFinding(None, "the data carry no rotor outputs that move; name the layout")
    if moving != list(range(len(moving))):
        listed = ", ".join(str(one + 1) for one in moving)
        return LayoutFinding(None, f"the outputs that move are {listed}; a layout begins at output 1: name the layout")
    candidates = [one for one in known if one.rotors == len(moving)]
    if not candidates:
        return LayoutFinding(
            None, f"{len(moving)} outputs move and no known layout has so many rotors; name the airframe"
        )
    driver, fit = _fit(stretches, len(moving))
    if fit is None:
        return LayoutFinding(None, "the flight is too short to find the rotor layout; name the layout")
    if fit.explained < MIN_EXPLAINED or fit.F[:2].min() < MIN_F:
        return LayoutFinding(None, f"the outputs hardly follow the {driver}; fly turns, or name the layout")
    return _named(candidates, driver, fit)


def _named(candidates: Sequence[RotorLayout], driver: str, fit: _Fit) -> LayoutFinding:
    ranked = sorted(((one.name, _likeness(fit, one)) for one in candidates), key=lambda row: -row[1])
    name, best = ranked[0]
    second = ranked[1] if len(ranked) > 1 else None
    scores = f"{name} {best:.2f}" + (f", next {second[0]} {second[1]:.2f}" if second else "")
    if best < MIN_LIKENESS or (second is not None and 1 - best > MAX_MISFIT * (1 - second[1])):
        return LayoutFinding(None, f"no known layout fits clearly ({scores}); name the layout", tuple(ranked))
    layout = next(one for one in candidates if one.name == name)
    return LayoutFinding(layout, f"found from outputs and {driver} ({scores})", tuple(ranked))


def _likeness(fit: _Fit, layout: RotorLayout) -> float:
    size = np.linalg.norm(fit.effects, axis=1)
    B = layout.mixing
    cosines = np.einsum("kr,rk->k", fit.effects, B) / np.maximum(size * np.linalg.norm(B, axis=0), 1e-300)
    excited = fit.F >= MIN_F
    lowest = float(cosines[excited].min())
    return lowest if lowest < 0 else float(np.average(cosines[excited], weights=np.square(size[excited])))


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """Unbroken rows. outputs: (n, outputs). drivers: (3, n, 3), in the order of `DRIVERS`, nan where unknown."""

    dt_s: float
    outputs: FloatArray
    drivers: FloatArray
    valid: BoolArray


def _stretches(blocks: Iterable[Block]) -> list[_Stretch]:
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


def _joined(run: Sequence[Block], width: int) -> _Stretch:
    absent = [np.full((len(block), width - block.actuator.shape[1]), np.nan) for block in run]
    outputs = np.vstack([np.hstack([block.actuator, none]) for block, none in zip(run, absent, strict=True)])
    rate, wanted = np.vstack([block.rate for block in run]), np.vstack([block.rate_setpoint for block in run])
    acceleration = np.diff(rate, axis=0, prepend=np.nan)
    drivers = np.stack([np.vstack([block.torque for block in run]), wanted - rate, acceleration])
    return _Stretch(run[0].dt_s, outputs, drivers, np.concatenate([block.valid for block in run]))


def _moving(stretches: Sequence[_Stretch]) -> list[int]:
    """Columns of the outputs that change in valid rows."""
    if not stretches:
        return []
    outputs = np.vstack([one.outputs[one.valid] for one in stretches])
    known = np.isfinite(outputs)
    low = np.where(known, outputs, np.inf).min(axis=0, initial=np.inf)
    high = np.where(known, outputs, -np.inf).max(axis=0, initial=-np.inf)
    return [int(i) for i in np.flatnonzero(high > low)]


def _fit(stretches: Sequence[_Stretch], rotors: int) -> tuple[str, _Fit | None]:
    """The fit to the first driver that the data carry; for the acceleration to the lag that explains most."""
    relative = [_relative(one, rotors) for one in stretches]
    judged = sum(int(np.isfinite(w[:, 0]).sum()) for w in relative)
    for i, driver in enumerate(DRIVERS):
        known = [
            np.isfinite(w[:, 0]) & np.isfinite(one.drivers[i]).all(axis=1)
            for w, one in zip(relative, stretches, strict=True)
        ]
        if 2 * sum(int(rows.sum()) for rows in known) <= judged:
            continue
        lags_s = LAGS_S if i == len(DRIVERS) - 1 else (0.0,)
        fits = [_regression(relative, stretches, i, lag_s) for lag_s in lags_s]
        return driver, max((fit for fit in fits if fit is not None), key=lambda fit: fit.explained, default=None)
    return DRIVERS[-1], None


def _relative(one: _Stretch, rotors: int) -> FloatArray:
    """w = o/mean(o) - 1, (n, rotors), nan where a row is not judged or the motors do not carry."""
    outputs = np.where(one.valid[:, None], one.outputs[:, :rotors], np.nan)
    mean = outputs.mean(axis=1, keepdims=True)
    return np.asarray(outputs / np.where(mean > MIN_OUTPUT, mean, np.nan) - 1.0, dtype=np.float64)


def _regression(relative: Sequence[FloatArray], stretches: Sequence[_Stretch], i: int, lag_s: float) -> _Fit | None:
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
    left = float(np.square(W - X @ effects).sum())
    noise = overlap * left / W.size * np.diag(np.linalg.pinv(X.T @ X))  # variance of an effect; spans overlap
    F = np.square(effects).mean(axis=1) / np.maximum(noise, 1e-300)
    return _Fit(np.asarray(effects, dtype=np.float64), np.asarray(F, dtype=np.float64), 1 - left / total)
