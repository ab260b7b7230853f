"""Rows with every signal that a condition needs, cut at will, and the conditions computed the slow way."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from mavdiag.kernel import Kernel, Outside, Slot
from mavdiag.monitors.conditions import Conditions, measure
from mavdiag.monitors.control_loss import ControlLoss, ControlLossSpec
from mavdiag.rows.block import Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray
from mavdiag.testing import WINDOW, example_rows
from mavdiag.thresholds.envelope import Covered

BIN_NS = 100_000_000


def made_block(n: int, dt_s: float, seed: int) -> Block:
    """A flight of n rows that moves in every condition; it begins beside the borders of the bins."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 0.1, (n, 6)), axis=0) * math.sqrt(dt_s)
    block = example_rows(
        n,
        dt_s,
        setpoint=walk[:, :3],
        rate=rng.normal(0.0, 0.2, (n, 3)),
        thrust=0.5 + 0.01 * rng.normal(size=n),
    ).block
    t_ns = block.t_ns + 1_000_037_000_000
    return replace(block, t_ns=t_ns, height=1.0 + walk[:, 3])


def spoilt(block: Block, seed: int) -> Block:
    """The same with spans in which the gyro, the set-point and slow signals are not known."""
    rng = np.random.default_rng([seed, 1])
    n = len(block)
    flags, slow = np.ones((2, n), dtype=np.bool_), [block.thrust.copy(), block.height.copy()]
    for part in (*flags, *slow):
        first = int(rng.integers(0, n))
        part[first : first + int(rng.integers(1, n // 5 + 2))] = 0 if part.dtype == np.bool_ else np.nan
    return replace(block, valid=flags[0], setpoint_valid=flags[1], thrust=slow[0], height=slow[1])


def rows_of(block: Block, edges: Sequence[int] = ()) -> list[Rows]:
    """The block in pieces, with the rates that each completes."""
    spec = RateSpec.of(block.dt_s, WINDOW)
    state, out = spec.start(), []
    for low, high in itertools.pairwise(sorted({0, len(block), *edges})):
        piece = block.rows(low, high)
        out.append(Rows(piece, spec.step(state, piece)))
    return out


def measured(rows: Sequence[Rows]) -> Conditions:
    """All bins of the rows."""
    parts = list(measure(rows))
    return Conditions(np.concatenate([b.end_ns for b in parts]), np.concatenate([b.values for b in parts]))


def column(found: Conditions, condition: Condition) -> FloatArray:
    """The values of one condition."""
    return found.values[:, list(Condition).index(condition)]


class Ones(ControlLoss):
    """A monitor whose value is 1 where the body rolls at 1 rad/s without a command, and that depends on conditions."""

    def __init__(self, depends: Iterable[Condition], memory_s: float, unit: str = "rad/s") -> None:
        super().__init__(ControlLossSpec())
        self.depends, self.unit, self.memory_s = frozenset(depends), unit, memory_s  # type: ignore[misc]


def ones_judged(
    covered: Sequence[Covered], rows: Sequence[Rows], monitor: Ones
) -> tuple[Statistic, dict[Condition, Outside]]:
    """What the envelope makes of the ones, and what it does not let judge."""
    kernel = Kernel((Slot(monitor, 9.0, True),), tuple(covered), rows[0].block.dt_s, 2 * rows[0].block.dt_s)
    memory, parts = kernel.start(), list[Statistic]()
    for one in rows:
        parts.append(kernel.step(memory, one)[1].found[0])
    names = ("t_ns", "value", "valid", "level", "signal", "rotors")
    joined = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return Statistic(period_s=parts[0].period_s, **joined), kernel.accounts(memory)[0].outside


def slowly(block: Block) -> tuple[list[int], dict[Condition, list[float]]]:
    """Ends of the bins and the conditions in them, one bin after the other, from their definitions."""
    (rows,) = rows_of(block)
    rates = rows.rates
    bins = sorted({int(t) // BIN_NS for t in rates.t_ns.tolist()})
    bins = [k for k in bins if (k + 1) * BIN_NS <= int(rates.t_ns[-1]) // BIN_NS * BIN_NS]
    out: dict[Condition, list[float]] = {condition: [] for condition in Condition}
    tilts: list[tuple[float, float]] = []
    slopes: list[float] = []
    before: dict[str, float] = {}
    for k in bins:
        inside = [i for i, t in enumerate(block.t_ns.tolist()) if t // BIN_NS == k and block.valid[i]]
        aimed = [i for i in inside if block.setpoint_valid[i]]
        turned = [i for i, t in enumerate(rates.t_ns.tolist()) if t // BIN_NS == k]
        known = [i for i in turned if rates.commanded[i]]
        tilts.append((_mean([block.setpoint[i, 0] for i in aimed]), _mean([block.setpoint[i, 1] for i in aimed])))
        out[Condition.TILT].append(
            math.hypot(*(sum(one[axis] for one in tilts[-50:]) / 50 for axis in (0, 1)))
            if len(tilts) >= 50
            else math.nan
        )
        out[Condition.THROTTLE].append(_mean([block.thrust[i] for i in inside]))
        out[Condition.COMMANDED_RATE].append(
            max((max(abs(rates.u[i, 0]), abs(rates.u[i, 1])) for i in known), default=math.nan)
        )
        heights = [block.height[i] for i in inside if math.isfinite(block.height[i])]
        out[Condition.HEIGHT].append(min(heights, default=math.nan))
        last, end = turned[-1], max(i for i, t in enumerate(block.t_ns.tolist()) if t // BIN_NS == k)
        now = {
            "roll": rates.u[last, 0] if rates.commanded[last] else math.nan,
            "pitch": rates.u[last, 1] if rates.commanded[last] else math.nan,
            "yaw": block.setpoint[end, 2] if block.valid[end] and block.setpoint_valid[end] else math.nan,
        }
        step = {name: abs(now[name] - before.get(name, math.nan)) / 0.1 for name in now}
        accelerations = [one for one in (step["roll"], step["pitch"]) if math.isfinite(one)]
        out[Condition.COMMANDED_ACCELERATION].append(max(accelerations, default=math.nan))
        slopes.append(step["yaw"])
        commanded = max((one for one in slopes[-20:] if math.isfinite(one)), default=math.inf)
        turn = abs(_mean([block.rate[i, 2] for i in inside]))
        out[Condition.YAW_RATE].append(min(turn, commanded))
        before = now
    return [(k + 1) * BIN_NS for k in bins], out


def _mean(values: Sequence[float]) -> float:
    finite = [float(x) for x in values if math.isfinite(x)]
    return math.fsum(finite) / len(finite) if finite else math.nan
