"""What the chain showed while it judged, as arrays over time: for figures, strips and displays.

Nothing is judged here. `ChainOutput.pieces` holds the rows and the monitors' statistics of each step; these functions
put them together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Chain, Piece, Slot
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray

__all__ = ["RateTrace", "SlotTrace", "Traces", "rate_traces", "slot_traces", "traces_of"]


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


@dataclass(frozen=True, slots=True, eq=False)
class Traces:
    """All of a flight: an entry for each modelled axis, and one for each slot. pieces: what they were made of."""

    rates: tuple[RateTrace, ...]
    slots: tuple[SlotTrace, ...]
    pieces: tuple[Piece, ...]


def traces_of(chain: Chain, pieces: Sequence[Piece]) -> Traces:
    """The traces of what a chain judged. pieces: of its outputs, in order."""
    return Traces(rate_traces(chain, pieces), slot_traces(chain, pieces), tuple(pieces))


def rate_traces(chain: Chain, pieces: Sequence[Piece]) -> tuple[RateTrace, ...]:
    """One for each axis that the chain has a model of."""
    found = []
    for number, slot in enumerate(chain.slots):
        monitor = slot.monitor
        if not isinstance(monitor, RunLength):
            continue
        column = monitor.axis.column
        rates = [piece.rows.rates for piece in pieces]
        statistics = [piece.found[number] for piece in pieces]
        measured = _one([one.y[:, column] for one in rates])
        found.append(
            RateTrace(
                axis=monitor.axis,
                segment=_one([np.full(len(one), one.segment) for one in rates]).astype(np.int64),
                t_ns=_one([one.t_ns for one in rates]).astype(np.int64),
                commanded=_one([one.u[:, column] for one in rates]),
                measured=measured,
                simulated=measured - _one([one.signal for one in statistics]),
                fsd_s=_one([one.value for one in statistics]),
                judged=_one([one.valid for one in statistics]).astype(np.bool_),
                margin_rad_s=monitor.reference,
                fml_s=slot.threshold,
            )
        )
    return tuple(found)


def slot_traces(chain: Chain, pieces: Sequence[Piece]) -> tuple[SlotTrace, ...]:
    """One for each slot, in the order of the chain."""
    return tuple(
        SlotTrace(slot, _joined([piece.found[number] for piece in pieces])) for number, slot in enumerate(chain.slots)
    )


def _joined(found: Sequence[Statistic]) -> Statistic:
    """Statistics that follow each other as one."""
    some = [one for one in found if len(one)]
    width = max((one.rotors.shape[1] for one in some), default=0)
    known = [one.rotors if one.rotors.shape[1] == width else np.full((len(one), width), np.nan) for one in some]
    return Statistic(
        t_ns=_one([one.t_ns for one in some]).astype(np.int64),
        period_s=some[0].period_s if some else 0.0,
        value=_one([one.value for one in some]),
        valid=_one([one.valid for one in some]).astype(np.bool_),
        level=_one([one.level for one in some]),
        signal=_one([one.signal for one in some]),
        rotors=np.concatenate(known) if known else np.empty((0, 0)),
    )


def _one(parts: Sequence[FloatArray | IntArray | BoolArray]) -> FloatArray:
    joined: FloatArray = np.concatenate(parts) if parts else np.empty(0)
    return joined
