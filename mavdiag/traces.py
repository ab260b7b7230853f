"""What the chain showed while it judged, as arrays over time: for figures, strips and displays.

Nothing is judged here. `ChainOutput.pieces` holds the rows and the monitors' statistics of each step; these functions
put them together, in order of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Chain
from mavdiag.kernel import Piece, Slot
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RateTrace:
    """The rates of one axis beside the model's (T Fig 5.6 to 5.8), in order of time; segments follow each other.

    segment: (n,) which stretch without a break a row is of.
    t_ns: (n,) vehicle time.
    commanded, measured, simulated: (n,) body rate [rad/s]; commanded is 0 where no set-point is known.
    fsd_s: (n,) time above the margin without a break, so far [s].
    judged: (n,) False where nothing may be concluded.
    margin_rad_s, fml_s: of the baseline.
    """

    axis: Axis
    segment: IntArray
    t_ns: IntArray
    commanded: FloatArray
    measured: FloatArray
    simulated: FloatArray
    fsd_s: FloatArray
    judged: BoolArray
    margin_rad_s: float
    fml_s: float

    @property
    def residual(self) -> FloatArray:
        """(n,) measured less simulated rate [rad/s]."""
        return self.measured - self.simulated


@dataclass(frozen=True, slots=True, eq=False)
class SlotTrace:
    """The statistic of one slot over time; `slot` has its name, axis, unit and threshold, the rest as `Statistic`."""

    slot: Slot
    found: Statistic


def rate_traces(chain: Chain, pieces: Sequence[Piece]) -> tuple[RateTrace, ...]:
    """One for each axis that the chain has a model of. pieces: of the chain's outputs, in order."""
    traces = []
    rates = [piece.rows.rates for piece in pieces]
    for number, slot in enumerate(chain.slots):
        monitor, found = slot.monitor, [piece.found[number] for piece in pieces]
        if not isinstance(monitor, RunLength):
            continue
        column = monitor.axis.column
        measured = _column([block.y[:, column] for block in rates])
        trace = RateTrace(
            axis=monitor.axis,
            segment=_column([np.full(len(block), block.segment) for block in rates]).astype(np.int64),
            t_ns=_column([block.t_ns for block in rates]).astype(np.int64),
            commanded=_column([block.u[:, column] for block in rates]),
            measured=measured,
            simulated=measured - _column([statistic.signal for statistic in found]),
            fsd_s=_column([statistic.value for statistic in found]),
            judged=_column([statistic.valid for statistic in found]).astype(np.bool_),
            margin_rad_s=monitor.reference,
            fml_s=slot.threshold,
        )
        traces.append(trace)
    return tuple(traces)


def slot_traces(chain: Chain, pieces: Sequence[Piece]) -> tuple[SlotTrace, ...]:
    """One for each slot, in the order of the chain."""
    return tuple(
        SlotTrace(slot, _joined([piece.found[number] for piece in pieces])) for number, slot in enumerate(chain.slots)
    )


def _joined(found: Sequence[Statistic]) -> Statistic:
    """Statistics that follow each other as one."""
    some = [statistic for statistic in found if len(statistic)]
    width = max((statistic.rotors.shape[1] for statistic in some), default=0)
    shapes = ((statistic, (len(statistic), width)) for statistic in some)
    rotors = [one.rotors if one.rotors.shape == shape else np.full(shape, np.nan) for one, shape in shapes]
    value, level, signal, valid, t_ns = (
        _column([getattr(statistic, name) for statistic in some])
        for name in ("value", "level", "signal", "valid", "t_ns")
    )
    return Statistic(
        t_ns=t_ns.astype(np.int64),
        period_s=some[0].period_s if some else 0.0,
        value=value,
        valid=valid.astype(np.bool_),
        level=level,
        signal=signal,
        rotors=np.concatenate(rotors) if rotors else np.empty((0, 0)),
    )


def _column(parts: Sequence[FloatArray | IntArray | BoolArray]) -> FloatArray:
    joined: FloatArray = np.concatenate(parts) if parts else np.empty(0)
    return joined
