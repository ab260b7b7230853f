"""Find the rotor layout from flights: how the outputs change with the commands of roll, pitch and yaw.

Which outputs are motors is found as well. The regression itself is in `excitation`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from mavdiag.airframe.excitation import Fit, Stretches, fit_outputs, moving_outputs
from mavdiag.airframe.layout import LAYOUTS, RotorLayout
from mavdiag.rows.block import Block
from mavdiag.telemetry import FloatArray

__all__ = ["MIN_LIKENESS", "LayoutFinding", "contradicts", "detect_layout"]

MIN_EXPLAINED = 0.1  # share of the outputs' changes that the drivers must explain (our choice)
MIN_F = 10.0  # F value above which a driver counts as excited, and an output as a motor (our choice)
CONTRARY = 0.5  # a weak driver, such as yaw in straight flight, may read -0.3 of the right layout (our choice)
MIN_LIKENESS = 0.85  # below it no layout is named; x and plus are 0.71 like each other (our choice)
MAX_MISFIT = 0.5  # and 1 - likeness must be less than this share of the next layout's (our choice)
MAX_TOGETHER = 10.0  # variance inflation factor above which drivers are not told apart (a textbooks' rule of thumb)
MIN_GAP = 4.0  # how many times more the least of the motors must follow than any output left out (our choice)
FEWEST = 3  # rotors that can command roll, pitch and yaw, with the thrust left over
NUMBERED = ("x", "plus", "hexa-x", "hexa-plus", "octo-x", "octo-plus")  # whose order names the rotors of another one


@dataclass(frozen=True, slots=True)
class LayoutFinding:
    """What flights say about the layout.

    layout: the known layout that fits; None if none does, or it stays unclear.
    reason: why, in one sentence.
    likeness: (name, likeness in -1..1) of the known layouts with as many rotors, best first; empty without a fit.
    outputs: the outputs that move as motors do, from 1, by rotor of the layout; rising if none is named.
    idle: rotors whose output was named and does not move.
    """

    layout: RotorLayout | None
    reason: str
    likeness: tuple[tuple[str, float], ...] = ()
    outputs: tuple[int, ...] = ()
    idle: tuple[int, ...] = ()


def detect_layout(
    blocks: Iterable[Block],
    known: Sequence[RotorLayout] = tuple(LAYOUTS.values()),
    outputs: Sequence[int] | None = None,
) -> LayoutFinding:
    """The known layout that healthy flying fits, from the rows of one or more flights.

    outputs: those that drive rotor 1, 2, ... where it is known; None to find them as well.

    The drivers x of roll, pitch and yaw are the first of these that the vehicle sends: its torque command; its rate
    error (set-point minus gyro, to which the rate controller answers); the angular acceleration that the outputs make
    some lag later. With w = o/mean(o) - 1 of the outputs o that move, and changes over 0.1 s, so that trims and drifts
    do not count:

        [ dx_roll  dx_pitch  dx_yaw ] @ B_fit' = [ dw_1 ... dw_n ]      least squares, all three together
        likeness = sum_k e_k cos(B_fit column k, B column k) / sum_k e_k

    e_k: the energy that driver k explains, 0 if it is not excited (F < 10). A layout of which an excited column
    points the other way gets that column's cosine instead. The lag is the one that explains most. A layout is named if
    its likeness reaches 0.85 and lacks half as much to 1 as the next one. Drivers that move together leave B_fit open
    in one direction. So a layout must besides, with the best gains of its axes, lose at most half as much of the
    explained energy as any other.

    An output is a motor if its mean in flight is above 0.05, it moves, and the drivers move it (F >= 10). All that move
    are tried first; then the one that follows the drivers least is left out, again and again, while it does not follow
    them. The motors must follow four times as much (F) as any output left out; they are the rotors in rising order of
    their outputs. If no layout reaches 0.85 so, yaw is excited too and the drivers do not move together, that order is
    sought in which one of `NUMBERED` fits best; it must meet the same limits.

    The blocks are gone through several times, one stretch in memory at a time. Any cut of the rows into blocks gives
    the same answer. Blind spots: servos that follow the drivers as motors do; a vehicle that hardly turns.
    """
    stretches = Stretches(blocks)
    moving = moving_outputs(stretches)
    if outputs is not None and stretches.outputs:
        return _on_outputs(stretches, moving, [one - 1 for one in outputs], known)
    if len(moving) < FEWEST:
        return LayoutFinding(None, "the data carry no rotor outputs that move")
    fit = fit_outputs(stretches, moving)
    found = first = _found(fit, moving, known)
    left_out = 0.0
    while found.layout is None and fit is not None and fit.followed.min() < MIN_F:
        if len(moving) == FEWEST:
            return first
        worst = int(fit.followed.argmin())
        left_out = max(left_out, float(fit.followed[worst]))
        moving = [one for i, one in enumerate(moving) if i != worst]
        fit = fit_outputs(stretches, moving)
        found = _found(fit, moving, known)
    if fit is not None and fit.followed.min() < MIN_GAP * left_out:
        reason = f"which outputs are motors is not clear, they hardly follow the {fit.driver}; fly turns"
        return LayoutFinding(None, reason, (), first.outputs)
    if found.layout is None and fit is not None and max((one for _, one in found.likeness), default=-1) < MIN_LIKENESS:
        found = _reordered(fit, moving, known) or found
    return found


def contradicts(finding: LayoutFinding, layout: RotorLayout) -> str:
    """Why flights speak against a layout that was told, in one sentence; empty if they do not.

    finding: of `detect_layout`, with that layout among the known ones. They do if its likeness is below -0.5, if it is
    below 0.85 and another layout is named, or if not as many outputs as it has rotors move as motors do.
    """
    likeness = dict(finding.likeness)
    if finding.idle:
        return finding.reason
    if likeness.get(layout.name, 0.0) >= MIN_LIKENESS:
        return ""
    if finding.layout is not None and not finding.layout.alike(layout):
        own = f" ({layout.name} {likeness[layout.name]:.2f})" if layout.name in likeness else ""
        return f"the flights look like {finding.layout.name}, not {layout.name}{own}: {finding.reason}"
    if likeness.get(layout.name, 0.0) < -CONTRARY:
        return f"the outputs do not move as {layout.name} would (likeness {likeness[layout.name]:.2f})"
    if finding.likeness and layout.name not in likeness and finding.likeness[0][1] >= MIN_LIKENESS:
        return f"{len(finding.outputs)} outputs move as motors do, {layout.name} has {layout.rotors} rotors"
    return ""


def _on_outputs(
    stretches: Stretches, moving: Sequence[int], columns: Sequence[int], known: Sequence[RotorLayout]
) -> LayoutFinding:
    """What the outputs say that are known to drive the rotors, if all of them move."""
    if idle := tuple(rotor for rotor, one in enumerate(columns, start=1) if one not in moving):
        return LayoutFinding(None, f"the outputs of the rotors {', '.join(map(str, idle))} do not move", idle=idle)
    return _found(fit_outputs(stretches, columns), columns, known)


def _found(fit: Fit | None, columns: Sequence[int], known: Sequence[RotorLayout]) -> LayoutFinding:
    """What the fit of these outputs says, the rotors in their order."""
    outputs = tuple(one + 1 for one in columns)
    candidates = [one for one in known if one.rotors == len(columns)]
    if fit is None:
        return LayoutFinding(None, "the flight is too short to find the rotor layout", (), outputs)
    if fit.explained < MIN_EXPLAINED or fit.F[:2].min() < MIN_F:
        reason = f"the outputs hardly follow the {fit.driver}; fly turns"
        return LayoutFinding(None, reason, (), outputs)
    if not candidates:
        listed = ", ".join(map(str, outputs))
        reason = f"{len(columns)} outputs move ({listed}) and no known layout has so many rotors"
        return LayoutFinding(None, reason, (), outputs)
    return replace(_named(candidates, fit), outputs=outputs)


def _named(candidates: Sequence[RotorLayout], fit: Fit) -> LayoutFinding:
    ranked = sorted(((one.name, _likeness(fit.effects, fit.F, one)) for one in candidates), key=lambda row: -row[1])
    name, best = ranked[0]
    second = ranked[1] if len(ranked) > 1 else None
    scores = f"{name} {best:.2f}" + (f", next {second[0]} {second[1]:.2f}" if second else "")
    if best < MIN_LIKENESS or (second is not None and 1 - best > MAX_MISFIT * (1 - second[1])):
        return LayoutFinding(None, f"no known layout fits clearly ({scores})", tuple(ranked))
    layout = next(one for one in candidates if one.name == name)
    rivals = [fit.lost(one.mixing) for one in candidates if one.name != name]
    if fit.lost(layout.mixing) > MAX_MISFIT * min(rivals, default=1.0):
        reason = f"roll, pitch and yaw moved together, so that several layouts fit ({scores}); fly them apart"
        return LayoutFinding(None, reason, tuple(ranked))
    unseen = "" if fit.F[2] >= MIN_F else "; the senses of rotation were not seen, for the flights hardly yaw"
    return LayoutFinding(layout, f"found from outputs and {fit.driver} ({scores}){unseen}", tuple(ranked))


def _reordered(fit: Fit, columns: Sequence[int], known: Sequence[RotorLayout]) -> LayoutFinding | None:
    """The layout that fits in another order of the outputs; None if none does, or an axis is not excited."""
    candidates = [one for one in known if one.name in NUMBERED and one.rotors == len(columns)]
    if not candidates or fit.explained < MIN_EXPLAINED or fit.F.min() < MIN_F or fit.together > MAX_TOGETHER:
        return None
    orders = {one.name: _order(fit.effects, one) for one in candidates}
    turned = [RotorLayout(one.name, tuple(one.signs[i] for i in orders[one.name])) for one in candidates]
    found = _named(turned, fit)
    if found.layout is None:
        return None
    layout, order = next(one for one in candidates if one.name == found.layout.name), orders[found.layout.name]
    outputs = tuple(columns[order.index(rotor)] + 1 for rotor in range(layout.rotors))
    reason = f"{found.reason}, its rotors on outputs {', '.join(map(str, outputs))}"
    return LayoutFinding(layout, reason, found.likeness, outputs)


def _order(effects: FloatArray, layout: RotorLayout) -> list[int]:
    """The rotor of each output, by which the effects agree best with the layout (an assignment, solved exactly)."""
    size = np.linalg.norm(effects, axis=1)
    weighted = effects * size[:, None] / np.linalg.norm(layout.mixing, axis=0)[:, None]
    _, rotors = linear_sum_assignment(-(weighted.T @ layout.mixing.T))  # (outputs, rotors)
    return [int(one) for one in rotors]


def _likeness(effects: FloatArray, F: FloatArray, layout: RotorLayout) -> float:
    size = np.linalg.norm(effects, axis=1)
    B = layout.mixing
    cosines = np.einsum("kr,rk->k", effects, B) / np.maximum(size * np.linalg.norm(B, axis=0), 1e-300)
    excited = F >= MIN_F
    lowest = float(cosines[excited].min())
    return lowest if lowest < 0 else float(np.average(cosines[excited], weights=np.square(size[excited])))
