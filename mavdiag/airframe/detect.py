"""Find the rotor layout, and which outputs are motors, from flights: how outputs change with roll, pitch and yaw.

With w = o/mean(o) - 1 of the outputs o that move, the drivers x of roll, pitch and yaw (the torque command; else the
rate error; else the angular acceleration, some lag later), and changes over 0.1 s, so that trims do not count:

    [ dx_roll  dx_pitch  dx_yaw ] @ B_fit' = [ dw_1 ... dw_n ]      least squares, all three together
    likeness = sum_k e_k cos(B_fit column k, B column k) / sum_k e_k

e_k: the energy that driver k explains, 0 if it is not excited (F < 10). A layout of which an excited column points the
other way gets that column's cosine instead. A layout is named if its likeness reaches 0.85 and lacks half as much to 1
as the next one, and if it loses, with the best gains of its axes, at most half as much of the energy as any other.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.airframe.layout import LAYOUTS, RotorLayout
from mavdiag.airframe.trim import MIN_OUTPUT
from mavdiag.rows.block import Block
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

SPAN_S = 0.1  # changes over this time: longer than output periods and motor lag, shorter than trims (our choice)
ROW_S = SPAN_S / 16  # between rows that are looked at, at least: outputs come at 50 Hz and more (our choice)
LAGS_S = (0.0, 0.02, 0.04, 0.06, 0.1, 0.15)  # of the acceleration: motor lag and gyro filter (our choice)
MIN_CHANGES = 40  # spans without overlap (our choice)
TOGETHER = 4096  # rows of one product: below the size that BLAS threads (our choice)
PIECE_ROWS = 1 << 16  # that are in memory at a time (our choice)
SINGULAR = 1e-12  # of the largest eigenvalue of the drivers' products: below it there is no direction
DRIVERS = ("torque command", "rate error", "angular acceleration")
MIN_EXPLAINED = 0.1  # share of the outputs' changes that the drivers must explain (our choice)
MIN_F = 10.0  # F value above which a driver counts as excited, and an output as a motor (our choice)
CONTRARY = 0.5  # a weak driver, such as yaw in straight flight, may read -0.3 of the right layout (our choice)
MIN_LIKENESS = 0.85  # below it no layout is named; x and plus are 0.71 like each other (our choice)
CLEAR = 0.95  # of both axes: a damaged rotor shows 0.87 of another order at most (emulated hexarotor; our choice)
MAX_MISFIT = 0.5  # and 1 - likeness must be less than this share of the next layout's (our choice)
MAX_TOGETHER = 10.0  # variance inflation factor above which drivers are not told apart (a textbooks' rule of thumb)
MIN_GAP = 4.0  # how many times more the least of the motors must follow than any output left out (our choice)
FEWEST = 3  # rotors that can command roll, pitch and yaw, with the thrust left over
NUMBERED = ("x", "plus", "hexa-x", "hexa-plus", "octo-x", "octo-plus")  # whose order names the rotors of another one
TINY = 1e-300


@dataclass(frozen=True, slots=True)
class LayoutFinding:
    """What flights say: the known layout that fits, None if none does or it stays unclear, and why, in one sentence."""

    layout: RotorLayout | None
    reason: str
    likeness: tuple[tuple[str, float], ...] = ()  # of the known layouts with as many rotors, -1..1, best first
    outputs: tuple[int, ...] = ()  # that move as motors do, from 1, by rotor of the layout; rising if none is named
    idle: tuple[int, ...] = ()  # rotors whose output was named and does not move


def detect_layout(
    blocks: Iterable[Block],
    known: Sequence[RotorLayout] = tuple(LAYOUTS.values()),
    outputs: Sequence[int] | None = None,
) -> LayoutFinding:
    """Find the known layout that healthy flying fits. outputs: those that drive rotor 1, 2, ...; None to find them too.

    All outputs that move are tried first; then the one that follows the drivers least is left out while F < 10. Motors
    must follow four times as much as any output left out. If no layout fits in rising order of the outputs, that order
    is sought in which one of `NUMBERED` fits. Blind spots: servos that follow the drivers; a vehicle that hardly turns.
    """
    blocks = tuple(blocks) if isinstance(blocks, Iterator) else blocks
    moving = moving_outputs(blocks)
    if outputs is not None and any(block.actuator.shape[1] for block in blocks if len(block)):
        columns = [output - 1 for output in outputs]
        if idle := tuple(rotor for rotor, column in enumerate(columns, start=1) if column not in moving):
            return LayoutFinding(None, f"the outputs of the rotors {', '.join(map(str, idle))} do not move", idle=idle)
        return _found(_fit(blocks, columns), columns, known)
    if len(moving) < FEWEST:
        return LayoutFinding(None, "the data carry no rotor outputs that move")
    first, left_out = None, 0.0
    while True:
        fit = _fit(blocks, moving)
        found = _found(fit, moving, known)
        first = first or found
        if found.layout is not None or fit is None or fit.followed.min() >= MIN_F:
            break
        if len(moving) == FEWEST:
            return first
        left_out = max(left_out, float(fit.followed.min()))
        del moving[int(fit.followed.argmin())]
    if fit is not None and fit.followed.min() < MIN_GAP * left_out:
        reason = f"which outputs are motors is not clear, they hardly follow the {fit.driver}; fly turns"
        return LayoutFinding(None, reason, (), first.outputs)
    if found.layout is None and fit is not None and max((one for _, one in found.likeness), default=-1) < MIN_LIKENESS:
        found = _reordered(fit, moving, known) or found
    return found


def wiring(block: Block, layout: RotorLayout, outputs: int) -> FloatArray:
    """(2, outputs) what roll and pitch do to each of the first outputs, of length F; of several blocks it adds up.

    Where none of the rotors' outputs moves it is done to others.
    """
    found, motors, block = np.zeros((2, outputs)), list(range(layout.rotors)), _thinned(block)
    moving = [column for column in moving_outputs([block]) if column < outputs]
    columns = motors if set(moving) & set(motors) or len(moving) < FEWEST else moving
    fit = _fit([block], columns, (0, 2)) if moving else None  # judging may leave out the rates' set-points
    if fit is not None and fit.explained >= MIN_EXPLAINED:
        effects = fit.effects[:2]
        found[:, columns] = effects * (fit.F[:2] / np.maximum(np.linalg.norm(effects, axis=1), TINY))[:, None]
    return found


def wired(effects: FloatArray, layout: RotorLayout) -> FloatArray:
    """(2,) cosines of what roll and pitch do to the outputs, as of `wiring`, with what the layout says.

    NaN where one of them is not excited, and where neither the layout nor another order of the outputs explains both
    clearly (`CLEAR`): beside a damaged rotor the autopilot answers what it feels, whatever it sends out.
    """
    sizes, B = np.linalg.norm(effects, axis=1), layout.mixing[:, :2].T
    if sizes.min() < MIN_F:
        return np.full(2, np.nan)
    effects, B = effects / sizes[:, None], B / np.linalg.norm(B, axis=1)[:, None]
    own = np.einsum("kr,kr->k", effects[:, : layout.rotors], B)
    if own.min() < CLEAR:
        apart = np.linalg.norm(effects[:, :, None] - B[:, None], axis=0)  # (outputs, rotors): a clear order is nearest
        places = list[int]()
        for rotor in range(layout.rotors):
            places.append(int(apart[:, rotor].argmin()))
            apart[places[-1]] = np.inf
        if np.einsum("kr,kr->k", effects[:, places], B).min() < CLEAR:
            return np.full(2, np.nan)
    return np.asarray(own, dtype=np.float64)


def contradicts(finding: LayoutFinding, layout: RotorLayout) -> str:
    """Say in one sentence why flights speak against a layout that was told; empty if they do not."""
    likeness = dict(finding.likeness)
    own = likeness.get(layout.name, 0.0)
    if finding.idle:
        return finding.reason
    if own >= MIN_LIKENESS:
        return ""
    if finding.layout is not None and not finding.layout.alike(layout):
        beside = f" ({layout.name} {own:.2f})" if layout.name in likeness else ""
        return f"the flights look like {finding.layout.name}, not {layout.name}{beside}: {finding.reason}"
    if own < -CONTRARY:
        return f"the outputs do not move as {layout.name} would (likeness {own:.2f})"
    if finding.likeness and layout.name not in likeness and finding.likeness[0][1] >= MIN_LIKENESS:
        return f"{len(finding.outputs)} outputs move as motors do, {layout.name} has {layout.rotors} rotors"
    return ""


def moving_outputs(blocks: Iterable[Block]) -> list[int]:
    """List the columns of the outputs that change in valid rows and carry: what stands still or idles is no motor."""
    width = max((block.actuator.shape[1] for block in blocks if len(block)), default=0)
    low, high, total, count = np.array([[np.inf], [-np.inf], [0.0], [0.0]]) * np.ones(width)
    for block in map(_thinned, blocks):
        outputs = block.actuator.T
        own, known = slice(0, len(outputs)), np.isfinite(outputs) & block.valid
        low[own] = np.minimum(low[own], np.where(known, outputs, np.inf).min(axis=1, initial=np.inf))
        high[own] = np.maximum(high[own], np.where(known, outputs, -np.inf).max(axis=1, initial=-np.inf))
        total[own] += np.where(known, outputs, 0.0).sum(axis=1)
        count[own] += known.sum(axis=1)
    return np.flatnonzero((high > low) & (total / np.maximum(count, 1) > MIN_OUTPUT)).tolist()


def _thinned(block: Block) -> Block:
    step = int(ROW_S / block.dt_s)
    if step < 2 or not len(block):
        return block
    rows = slice(-round(int(block.t_ns[0]) / (NS_PER_S * block.dt_s)) % step, None, step)  # however blocks are cut
    return Block(block.segment, step * block.dt_s, block.t_ns[rows], block.x[:, rows], block.outputs)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Change of the outputs for one standard deviation of the driver's change about each axis."""

    driver: str
    effects: FloatArray  # (3, outputs)
    F: FloatArray  # (3,) how far the effect stands out of the noise over all outputs
    followed: FloatArray  # (outputs,) the same of each
    explained: float  # share of the outputs' changes
    spread: FloatArray  # (3, 3) mean products of the drivers' standardised changes

    def lost(self, mixing: FloatArray) -> float:
        """How much of the explained energy the mixing B of a layout cannot explain, 0..1, whatever gains g it has."""
        from scipy.optimize import nnls  # half a second to import: only a look at a layout pays it

        # least g >= 0 of  tr (E - diag(g) B')' S (E - diag(g) B'),  E effects, S spread: a normal equation
        S, E, B = self.spread, self.effects, mixing
        total = float(np.einsum("kr,kl,lr->", E, S, E))
        M, v = S * (B.T @ B), np.einsum("kl,lr,rk->k", S, E, B)
        root = np.linalg.cholesky(M + 1e-9 * np.trace(M) * np.eye(3))
        g, _ = nnls(root.T, np.linalg.solve(root, v))
        return float((total - 2 * g @ v + g @ M @ g) / total) if total > 0 else 1.0


def _drivers(block: Block) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(3, n) each, in the order of `DRIVERS`; the gyro in place of its differences."""
    return block.torque.T, block.rate_setpoint.T - block.rate.T, block.rate.T


def _shares(block: Block, columns: Sequence[int]) -> FloatArray:
    """w, (outputs, n): nan where a row is not judged or the motors do not carry."""
    outputs = np.full((len(columns), len(block)), np.nan)
    there = [i for i, column in enumerate(columns) if column < block.actuator.shape[1]]
    outputs[there] = np.where(block.valid, block.actuator.T[[columns[i] for i in there]], np.nan)
    mean = outputs.mean(axis=0)
    return np.asarray(outputs / np.where(mean > MIN_OUTPUT, mean, np.nan) - 1.0)


def _pieces(
    blocks: Iterable[Block], columns: Sequence[int], driver: int, reach_s: float
) -> Iterator[tuple[float, FloatArray]]:
    """Period and [ w x ]' of unbroken rows, `PIECE_ROWS` at a time; what a change reaches over comes twice."""
    rows, last = list[FloatArray](), None
    for block in map(_thinned, blocks):
        if not len(block):
            continue
        if last is not None and not (
            block.segment == last.segment and 0 < block.t_ns[0] - last.t_ns[-1] < 2.5e9 * block.dt_s
        ):
            yield last.dt_s, np.concatenate(rows, axis=1)
            rows, last = [], None
        x = _drivers(block)[driver]
        if driver == len(DRIVERS) - 1:
            x = np.diff(x, prepend=np.full((3, 1), np.nan) if last is None else last.rate.T[:, -1:])
        rows.append(np.vstack([_shares(block, columns), x]))
        last = block
        while sum(one.shape[1] for one in rows) >= PIECE_ROWS:
            table = np.concatenate(rows, axis=1)
            yield block.dt_s, table[:, :PIECE_ROWS]
            rows = [table[:, PIECE_ROWS - round(SPAN_S / block.dt_s) - round(reach_s / block.dt_s) :]]
    if last is not None:
        yield last.dt_s, np.concatenate(rows, axis=1)


def _fit(blocks: Iterable[Block], columns: Sequence[int], drivers: Sequence[int] = range(3)) -> _Fit | None:
    """By the first of the drivers that is known most of the time."""
    judged, known = 0, np.zeros(len(DRIVERS), dtype=np.int64)
    for block in map(_thinned, blocks):
        flown = np.isfinite(_shares(block, columns)[0])
        judged += int(np.count_nonzero(flown))
        known += [np.count_nonzero(flown & np.isfinite(x).all(axis=0)) for x in _drivers(block)]
    carried = [number for number in drivers if 2 * known[number] > judged]
    if not carried:
        return None
    lags_s = LAGS_S if carried[0] == len(DRIVERS) - 1 else LAGS_S[:1]
    outputs, overlap = len(columns), 1
    products = np.zeros((len(lags_s), outputs + 4, outputs + 4))
    for dt_s, table in _pieces(blocks, columns, carried[0], lags_s[-1]):
        span = max(1, round(SPAN_S / dt_s))
        n, overlap = table.shape[1] - span - round(lags_s[-1] / dt_s), max(overlap, span)
        for sums, lag in zip(products, (round(lag_s / dt_s) for lag_s in lags_s if n > 0), strict=False):
            w, x = table[:outputs, : span + n], table[outputs:, lag : lag + span + n]
            changes = np.vstack([w[:, span:] - w[:, :n], x[:, span:] - x[:, :n], np.ones((1, n))])
            changes = changes[:, np.isfinite(changes).all(axis=0)]
            for first in range(0, changes.shape[1], TOGETHER):
                part = changes[:, first : first + TOGETHER]
                sums += part @ part.T
    return _solved(products, overlap, DRIVERS[carried[0]])


def _solved(products: FloatArray, overlap: int, driver: str) -> _Fit | None:
    """The least squares of the lag that explains most; None if there is too little. overlap: rows of a change.

    products: (lags, .., ..) of the changes of outputs, driver and one.
    """
    moved = np.trace(products[:, :-4, :-4], axis1=1, axis2=2)
    enough = (products[:, -1, -1] >= MIN_CHANGES * overlap) & (moved > 0)
    if not enough.any():
        return None
    products, moved = products[enough], moved[enough]
    ww, wx, xx = products[:, :-4, :-4], products[:, :-4, -4:-1], products[:, -4:-1, -4:-1]
    total, n = products[:, -4:-1, -1], products[:, -1:, -1]
    scale = np.sqrt(np.maximum(np.einsum("lii->li", xx) / n - np.square(total / n), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    wx, xx = wx / scale[:, None], xx / scale[:, None] / scale[:, :, None]
    # [ X'X ] effects = [ X'W ]; drivers that move together by nature leave the smallest effects
    inverse = np.linalg.pinv(xx, rcond=SINGULAR, hermitian=True)
    effects = inverse @ wx.mT
    explained = (effects * (xx @ effects)).sum(axis=1)
    left = np.maximum(np.einsum("lii->li", ww) - 2 * (effects * wx.mT).sum(axis=1) + explained, 0.0)
    shares = 1 - left.sum(axis=1) / moved
    best = int(shares.argmax())
    effects, explained, left, rows = effects[best], explained[best], left[best], float(n[best, 0])
    noise = overlap * left.sum() / (rows * len(left)) * np.diag(inverse[best])  # of an effect; spans overlap
    F = np.asarray(np.square(effects).mean(axis=1) / np.maximum(noise, TINY), dtype=np.float64)
    followed = np.asarray(explained / 3 / np.maximum(overlap * left / rows, TINY), dtype=np.float64)
    return _Fit(driver, effects, F, followed, float(shares[best]), np.asarray(xx[best] / rows))


def _found(fit: _Fit | None, columns: Sequence[int], known: Sequence[RotorLayout]) -> LayoutFinding:
    outputs = tuple(column + 1 for column in columns)
    candidates = [layout for layout in known if layout.rotors == len(columns)]
    if fit is None:
        return LayoutFinding(None, "the flight is too short to find the rotor layout", (), outputs)
    if fit.explained < MIN_EXPLAINED or fit.F[:2].min() < MIN_F:
        return LayoutFinding(None, f"the outputs hardly follow the {fit.driver}; fly turns", (), outputs)
    if not candidates:
        listed = ", ".join(map(str, outputs))
        reason = f"{len(columns)} outputs move ({listed}) and no known layout has so many rotors"
        return LayoutFinding(None, reason, (), outputs)
    return replace(_named(candidates, fit), outputs=outputs)


def _named(candidates: Sequence[RotorLayout], fit: _Fit) -> LayoutFinding:
    ranked = sorted(((_likeness(fit, layout), layout) for layout in candidates), key=lambda row: -row[0])
    likeness = tuple((layout.name, share) for share, layout in ranked)
    (name, best), second = likeness[0], likeness[1:2]
    scores = f"{name} {best:.2f}" + "".join(f", next {other} {share:.2f}" for other, share in second)
    if best < MIN_LIKENESS or any(1 - best > MAX_MISFIT * (1 - share) for _, share in second):
        return LayoutFinding(None, f"no known layout fits clearly ({scores})", likeness)
    lost = [fit.lost(layout.mixing) for _, layout in ranked]
    if lost[0] > MAX_MISFIT * min(lost[1:], default=1.0):
        reason = f"roll, pitch and yaw moved together, so that several layouts fit ({scores}); fly them apart"
        return LayoutFinding(None, reason, likeness)
    unseen = "" if fit.F[2] >= MIN_F else "; the senses of rotation were not seen, for the flights hardly yaw"
    return LayoutFinding(ranked[0][1], f"found from outputs and {fit.driver} ({scores}){unseen}", likeness)


def _likeness(fit: _Fit, layout: RotorLayout) -> float:
    size, B = np.linalg.norm(fit.effects, axis=1), layout.mixing
    cosines = np.einsum("kr,rk->k", fit.effects, B) / np.maximum(size * np.linalg.norm(B, axis=0), TINY)
    excited = fit.F >= MIN_F
    lowest = float(cosines[excited].min())
    return lowest if lowest < 0 else float(np.average(cosines[excited], weights=np.square(size[excited])))


def _reordered(fit: _Fit, columns: Sequence[int], known: Sequence[RotorLayout]) -> LayoutFinding | None:
    """The layout that fits in another order of the outputs; None if none does, or an axis is not excited."""
    from scipy.optimize import linear_sum_assignment

    candidates = {one.name: one for one in known if one.name in NUMBERED and one.rotors == len(columns)}
    inflation = float(np.diag(np.linalg.pinv(fit.spread)).max())  # of the variance, for drivers that move together
    if not candidates or fit.explained < MIN_EXPLAINED or fit.F.min() < MIN_F or inflation > MAX_TOGETHER:
        return None
    orders, turned = {}, []
    for name, layout in candidates.items():
        # the rotor of each output, by which the effects agree best with the layout: an assignment, solved exactly
        size = np.linalg.norm(fit.effects, axis=1)
        weighted = fit.effects * size[:, None] / np.linalg.norm(layout.mixing, axis=0)[:, None]
        orders[name] = linear_sum_assignment(-(weighted.T @ layout.mixing.T))[1].tolist()  # (outputs, rotors)
        turned.append(RotorLayout(name, tuple(layout.signs[rotor] for rotor in orders[name])))
    found = _named(turned, fit)
    if found.layout is None:
        return None
    layout, order = candidates[found.layout.name], orders[found.layout.name]
    outputs = tuple(columns[order.index(rotor)] + 1 for rotor in range(layout.rotors))
    reason = f"{found.reason}, its rotors on outputs {', '.join(map(str, outputs))}"
    return LayoutFinding(layout, reason, found.likeness, outputs)
