"""The uniform rows that everything after the alignment works on."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields, replace
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal

ALL = slice(None)  # columns
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive rows of one segment, on a uniform grid of period `dt_s`.

    A signal is nan in a row where it is unknown (see `rows.align`). Only the set-point stays finite; `setpoint_valid`
    says where it may be used. Arrays of several columns lie column by column in memory.

    segment: number of the unbroken span of flight. t_ns: vehicle time. Columns and units of signals are those of
    `Signal`; angles have no jumps of 2 pi. setpoint: of the attitude; 0 before the first, held in an outage.
    actuator, rotor_speed: (n, outputs), (n, ESCs); (n, 0) while the vehicle has sent none.
    valid: the gyro may be judged: it is there, settled and airborne. setpoint_valid: it is there and settled.
    doubt: why the gyro, though it is there, must not be judged: a place in `rows.quality.DOUBTS`, 0 for none.
    settled_ns: rows before it are of a take-off, or of the start of the data. answers: what was found (`once`).
    """

    segment: int
    dt_s: float
    t_ns: IntArray
    setpoint: FloatArray
    rate: FloatArray
    force: FloatArray
    torque: FloatArray
    rate_setpoint: FloatArray
    thrust: FloatArray
    attitude: FloatArray
    height: FloatArray
    armed: FloatArray
    vibration: FloatArray
    actuator: FloatArray
    rotor_speed: FloatArray
    valid: BoolArray
    setpoint_valid: BoolArray
    doubt: FloatArray
    settled_ns: int = field(default=0, kw_only=True)
    answers: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.t_ns)

    def rows(self, first: int, stop: int, segment: int | None = None, settled_ns: int | None = None) -> "Block":
        """Rows [first, stop) as a block of their own, of another segment, or settled at another time, if asked."""
        segment = self.segment if segment is None else segment
        settled_ns = self.settled_ns if settled_ns is None else settled_ns
        columns = ARRAYS(self)
        if stop - first < len(self.t_ns):
            columns = tuple(column[first:stop] for column in columns)
        elif segment == self.segment and settled_ns == self.settled_ns:
            return self
        return Block(segment, self.dt_s, *columns, settled_ns=settled_ns)

    def known(self, signal: Signal, columns: slice = ALL) -> BoolArray:
        """(n,) where the row carries these columns of a signal; nowhere if rows have none for it.

        BODY_RATE: `valid`. ATTITUDE_SETPOINT: `setpoint_valid`.
        """
        if signal is Signal.BODY_RATE:
            return self.valid
        if signal is Signal.ATTITUDE_SETPOINT:
            return self.setpoint_valid
        values = getattr(self, _NAMES[signal]) if signal in _NAMES else np.empty((len(self), 0))
        values = values[:, None] if values.ndim == 1 else values[:, columns]
        return np.asarray(np.isfinite(values).all(axis=1) & (values.shape[1] > 0), dtype=np.bool_)

    def once(self, key: Hashable, find: Callable[[], Found]) -> Found:
        """What `find` gives, and the same for the same key later on; do not write to it."""
        if key not in self.answers:
            self.answers[key] = find()
        found: Found = self.answers[key]
        return found


COLUMNS = tuple(column.name for column in fields(Block))[2:-2]  # arrays of rows, in the order of the fields
ARRAYS: Callable[[Block], tuple[Any, ...]] = attrgetter(*COLUMNS)
_NAMES = {
    Signal.SPECIFIC_FORCE: "force",
    Signal.TORQUE_COMMAND: "torque",
    Signal.THRUST_SETPOINT: "thrust",
} | {signal: signal.value for signal in Signal if signal.value in COLUMNS}


def in_rotor_order(block: Block, outputs: Sequence[int] | None) -> Block:
    """The block whose column j of `actuator` is what drives rotor j, and of `rotor_speed` what its ESC tells.

    An output or ESC that is not sent is nan. An autopilot numbers ESCs as the outputs that they are on.
    outputs: the output, from 1, of each rotor; None if they are in that order already.
    """
    if outputs is None:
        return block

    def by_rotor(columns: FloatArray) -> FloatArray:
        sent, absent = columns.T, np.full(len(block), np.nan)
        if not len(sent):
            return columns
        return np.array([sent[one - 1] if one <= len(sent) else absent for one in outputs]).T

    return replace(block, actuator=by_rotor(block.actuator), rotor_speed=by_rotor(block.rotor_speed))
