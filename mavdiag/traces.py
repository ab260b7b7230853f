"""What the chain showed while it judged, as arrays over time: for figures, strips and displays.

Nothing is judged here. `ChainOutput.pieces` holds the rows and the monitors' statistics of each step; these functions
put them together, in order of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mavdiag.chain import Chain
from mavdiag.kernel import Piece, Slot
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RateTrace:
    """The rates of one axis beside the model's (T Fig 5.6 to 5.8), (n,) each in order of time."""

    axis: Axis
    segment: IntArray  # which stretch without a break a row is of
    t_ns: IntArray
    commanded: FloatArray  # body rates [rad/s]; commanded is 0 where no set-point is known
    measured: FloatArray
    simulated: FloatArray
    fsd_s: FloatArray  # time above the margin without a break, so far
    judged: BoolArray  # False where nothing may be concluded
    margin_rad_s: float  # of the baseline
    fml_s: float

    @property
    def residual(self) -> FloatArray:
        """(n,) measured less simulated rate [rad/s]."""
        return self.measured - self.simulated


class SlotTrace(NamedTuple):
    """The statistic of one slot over time; `slot` has its name, axis, unit and threshold, the rest as `Statistic`."""

    slot: Slot
    found: Statistic


def rate_traces(chain: Chain, pieces: Sequence[Piece]) -> tuple[RateTrace, ...]:
    """One for each axis that the chain has a model of. pieces: of the chain's outputs, in order."""
    traces, rates = [], [piece.rows.rates for piece in pieces]
    for number, slot in enumerate(chain.slots):
        if not isinstance(slot.monitor, RunLength):
            continue
        axis, found = slot.monitor.spec.axis, joined([piece.statistic(number) for piece in pieces])
        segment = _column([np.full(len(block), block.segment) for block in rates], np.int64)
        u, y = (_column([getattr(block, name)[:, axis.column] for block in rates]) for name in ("u", "y"))
        rows = (segment, found.t_ns, u, y, y - found.signal, found.value, found.valid)
        traces.append(RateTrace(axis, *rows, slot.monitor.reference, slot.threshold))
    return tuple(traces)


def slot_traces(chain: Chain, pieces: Sequence[Piece]) -> tuple[SlotTrace, ...]:
    """One for each slot, in the order of the chain."""
    found = (joined([piece.statistic(number) for piece in pieces]) for number in range(len(chain.slots)))
    return tuple(map(SlotTrace, chain.slots, found))


def joined(found: Sequence[Statistic]) -> Statistic:
    """Statistics that follow each other as one."""
    some = [statistic for statistic in found if len(statistic)]
    if not some:
        nothing, never = np.empty(0), np.empty(0, dtype=np.int64)
        return Statistic(never, 0.0, nothing, nothing > 0, nothing, nothing)
    names = ("value", "valid", "level", "signal", "rotors")
    columns = (np.concatenate([getattr(statistic, name) for statistic in some]) for name in names)
    return Statistic(np.concatenate([statistic.t_ns for statistic in some]), some[0].period_s, *columns)


def _column(parts: Sequence[Any], kind: Any = np.float64) -> Any:
    return np.concatenate(parts) if parts else np.empty(0, dtype=kind)
