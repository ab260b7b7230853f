"""The uniform rows that everything after the alignment works on."""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np

from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal

__all__ = ["ALL", "COLUMNS", "Block"]

ALL = slice(None)  # columns
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive rows of one segment, on a uniform grid of period `dt_s`.

    A signal is nan in a row where it is unknown: never sent, or its last sample is too old (see `rows.align`). Only the
    set-point stays finite; `setpoint_valid` says where it may be used. Arrays of several columns lie column by column
    in memory, so that numpy's loops run over the rows.

    segment: number of the unbroken span of flight; it changes after every break and landing.
    dt_s: row period [s].
    t_ns: (n,) vehicle time.
    setpoint: (n, 3) commanded roll, pitch, yaw [rad], without jumps of 2 pi; 0 before the first, held in an outage.
    rate: (n, 3) gyro [rad/s].
    force: (n, 3) accelerometer [m/s^2].
    torque: (n, 3) torque command, -1..1.
    rate_setpoint: (n, 3) commanded body rates [rad/s].
    thrust: (n,) collective set-point, 0..1.
    attitude: (n, 3) estimated roll, pitch, yaw [rad], without jumps of 2 pi.
    height: (n,) above take-off [m].
    voltage: (n,) of the battery [V].
    armed: (n,) 0 or 1.
    vibration: (n, 3) VIBRATION message [m/s^2].
    actuator: (n, outputs) 0..1; (n, 0) while the vehicle has sent none.
    valid: (n,) the gyro may be judged: it is there, settled and airborne.
    setpoint_valid: (n,) the set-point may be used: it is there and settled.
    doubt: (n,) why the gyro, though it is there, must not be judged: a place in `rows.quality.DOUBTS`, 0 for none.
    settled_ns: rows before it are of a take-off, or of the start of the data, which nobody judges.
    answers: what was found in the rows so far (`once`), so that each monitor need not look again.
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
    voltage: FloatArray
    armed: FloatArray
    vibration: FloatArray
    actuator: FloatArray
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
        columns, cut = [getattr(self, name) for name in COLUMNS], slice(first, stop)
        if stop - first < len(self):
            columns = [column[cut] for column in columns]
        return Block(segment, self.dt_s, *columns, settled_ns=settled_ns)

    def known(self, signal: Signal, columns: slice = ALL) -> BoolArray:
        """(n,) where the row carries this signal; nowhere if rows have no column for it.

        BODY_RATE: `valid`. ATTITUDE_SETPOINT: `setpoint_valid`. Others: where these of their columns are finite: some
        vehicles log the z axis of the accelerometer only. The same array for the same question; do not write to it.
        """
        if signal is Signal.BODY_RATE:
            return self.valid
        if signal is Signal.ATTITUDE_SETPOINT:
            return self.setpoint_valid
        return self.once((signal, columns.start, columns.stop), lambda: self._finite(signal, columns))

    def once(self, key: Hashable, find: Callable[[], Found]) -> Found:
        """What `find` gives, and the same for the same key later on; do not write to it."""
        if key not in self.answers:
            self.answers[key] = find()
        found: Found = self.answers[key]
        return found

    def finite_rate(self) -> BoolArray:
        """(n,) where the gyro gives numbers, whether it may be judged or not; do not write to it."""
        return self.once(Signal.BODY_RATE, lambda: self._finite(Signal.BODY_RATE, ALL))

    def _finite(self, signal: Signal, columns: slice) -> BoolArray:
        name = _SIGNALS.get(signal)
        values: FloatArray = np.empty((len(self), 0)) if name is None else getattr(self, name)
        if values.ndim == 1:
            return np.isfinite(values)
        values = values[:, columns]
        if values.shape[1] == 0:
            return np.zeros(len(self), dtype=np.bool_)
        if math.isfinite(float(np.add.reduce(values, axis=None))):
            return np.ones(len(self), dtype=np.bool_)
        return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


COLUMNS = tuple(column.name for column in fields(Block))[2:-2]  # arrays of rows, in the order of the fields
_SIGNALS = {
    Signal.BODY_RATE: "rate",
    Signal.SPECIFIC_FORCE: "force",
    Signal.TORQUE_COMMAND: "torque",
    Signal.RATE_SETPOINT: "rate_setpoint",
    Signal.THRUST_SETPOINT: "thrust",
    Signal.ATTITUDE: "attitude",
    Signal.HEIGHT: "height",
    Signal.VOLTAGE: "voltage",
    Signal.ARMED: "armed",
    Signal.VIBRATION: "vibration",
    Signal.ACTUATOR: "actuator",
}
