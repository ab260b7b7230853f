"""Judge only what flies: `GateSpec.start`, `.step`, `.finish` cut the flying spans out of the aligned rows.

Take-off, touch-down and the ground are no healthy reference: a landing gives gyro spikes many times the size of a
fault's trace (8-11 rad/s, METHOD section 5). Every flying span becomes a segment of its own, and a `Border` follows it.
Its first `trim_start_s` are marked invalid; its last `trim_end_s` are dropped, which needs the rows to be held back by
that long, so it is zero where the alert must not wait.
"""

from dataclasses import dataclass, replace

import numpy as np

from mavdiag.rows.block import Block
from mavdiag.telemetry import BoolArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["Border", "GateSpec", "GateState", "idle_rows"]

IDLE_OUTPUT = 0.15  # ArduPilot's MOT_SPIN_MIN by default: a motor that carries is above it


@dataclass(frozen=True, slots=True)
class Border:
    """A flying span has ended, by a landing or a break; the next rows have another segment.

    t_ns: vehicle time of the last row that flew.
    """

    t_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class GateState:
    """The rows held back, and the present flying span."""

    held: tuple[Block, ...] = ()
    source: int = -1  # segment of the rows before the gate
    airborne: bool = False
    span: int = -1  # number of the flying span
    begun_ns: int = 0
    last_ns: int = 0  # time of the last row that flew


@dataclass(frozen=True, slots=True)
class GateSpec:
    """What counts as flying. A limit of None is not asked for.

    A signal that is unknown passes, be it never sent or too old: its lack must not stop the judging of a flight. In
    place of an unknown thrust the outputs are asked: while all of them idle, nothing flies.

    min_height_m: above take-off.
    min_thrust: collective set-point, 0..1.
    need_armed: HEARTBEAT says armed.
    trim_start_s: start of a span that is marked invalid.
    trim_end_s: end of a span that is dropped.
    """

    min_height_m: float | None = None
    min_thrust: float | None = None
    need_armed: bool = True
    trim_start_s: float = 0.0
    trim_end_s: float = 0.0

    def start(self) -> GateState:
        """A fresh state: nothing flies yet."""
        return GateState()

    def step(self, state: GateState, blocks: tuple[Block, ...]) -> tuple[GateState, tuple[Block | Border, ...]]:
        """The rows of `blocks` that fly, renumbered by flying span, held back by `trim_end_s`."""
        out: list[Block | Border] = []
        for block in blocks:
            if block.segment != state.source:
                state, done = _land(self, state)
                out += done
                state = replace(state, source=block.segment)
            up = self.flying(block)
            for first, stop in _runs(up):
                if up[first]:
                    state = _fly(self, state, block, first, stop)
                else:
                    state, done = _land(self, state)
                    out += done
            state, released = _release(self, state)
            out += released
        return state, tuple(out)

    def finish(self, state: GateState) -> tuple[GateState, tuple[Block, ...]]:
        """The end of a log. What is held back was still flying, so it is judged."""
        return replace(state, held=(), airborne=False), state.held

    def flying(self, block: Block) -> BoolArray:
        """(n,) True for the rows that count as flying."""
        up = np.ones(len(block), dtype=np.bool_)
        if self.min_height_m is not None:
            up &= ~(block.height < self.min_height_m)
        if self.min_thrust is not None:
            up &= ~(block.thrust < self.min_thrust) & ~idle_rows(block)
        if self.need_armed:
            up &= ~(block.armed < 0.5)
        return up


def idle_rows(block: Block) -> BoolArray:
    """(n,) where no thrust set-point is known and all outputs idle: a vehicle on the ground that sends none."""
    if block.actuator.shape[1] == 0 or np.isfinite(block.thrust).all():
        return np.zeros(len(block), dtype=np.bool_)
    return np.asarray(np.isnan(block.thrust) & (block.actuator.max(axis=1) <= IDLE_OUTPUT), dtype=np.bool_)


def _runs(up: BoolArray) -> list[tuple[int, int]]:
    """Spans [first, stop) of equal values."""
    if np.count_nonzero(up) == len(up):
        return [(0, len(up))]
    edges: IntArray = np.flatnonzero(np.diff(up)) + 1
    starts = [0, *edges.tolist()]
    return list(zip(starts, [*edges.tolist(), len(up)], strict=True))


def _fly(spec: GateSpec, state: GateState, block: Block, first: int, stop: int) -> GateState:
    if not state.airborne:
        state = replace(state, airborne=True, span=state.span + 1, begun_ns=int(block.t_ns[first]))
    whole = first == 0 and stop == len(block) and block.segment == state.span
    rows = block if whole else block.rows(first, stop, state.span)
    settled_ns = state.begun_ns + round(spec.trim_start_s * NS_PER_S)
    if rows.t_ns[0] < settled_ns:
        rows = replace(rows, valid=rows.valid & (rows.t_ns >= settled_ns))
    held = (*state.held, rows)
    return GateState(held, state.source, state.airborne, state.span, state.begun_ns, int(rows.t_ns[-1]))


def _land(spec: GateSpec, state: GateState) -> tuple[GateState, list[Block | Border]]:
    """The span is over: its last `trim_end_s` are dropped."""
    if not state.airborne:
        return state, []
    state, done = _release(spec, state)
    return replace(state, held=(), airborne=False), [*done, Border(state.last_ns)]


def _release(spec: GateSpec, state: GateState) -> tuple[GateState, list[Block]]:
    """Let go of the rows that are `trim_end_s` older than the newest."""
    if not state.held or spec.trim_end_s == 0:
        flown = GateState((), state.source, state.airborne, state.span, state.begun_ns, state.last_ns)
        return flown, list(state.held)
    safe_ns = int(state.held[-1].t_ns[-1]) - round(spec.trim_end_s * NS_PER_S)
    done: list[Block] = []
    kept: list[Block] = []
    for block in state.held:
        stop = int(np.searchsorted(block.t_ns, safe_ns, side="right"))
        done += [block.rows(0, stop)] if stop else []
        kept += [block.rows(stop, len(block))] if stop < len(block) else []
    return replace(state, held=tuple(kept)), done
