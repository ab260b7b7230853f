"""What compiled monitors read: x, a row for each signal and a column for each row of flight, the latest ones in front.

Rates are known half a filter window later than the rows that they are about. Here they stand in the column of the
newest row of their window, so that a column holds what is known when its row has come.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, IntArray, Signal

# Flags among the rows of x: the gyro may be judged; the rates may be compared; the flight is one that trims were learnt
# in; the set-point may be used; why the gyro must not be judged though it is there (`rows.quality.DOUBTS`).
VALID, COMMANDED, COVERED, SETPOINT, DOUBT = range(5)
# Signals: three rows each, but for lean (roll and pitch set-point), thrust, heading (commanded) and height; the outputs
# and, behind so many rows, the speeds of rotors are the last ones, where there are any. GYRO is the raw gyro that Y is
# smoothed of; U is the commanded rate.
LEAN, RATE, FORCE, TORQUE, THRUST, ATTITUDE, VIBRATION, U, Y, GYRO = 5, 7, 10, 13, 16, 17, 20, 23, 26, 29
HEADING, HEIGHT, OUTPUTS, SPEEDS = 32, 33, 34, 50
# Rows of what a monitor writes for each of its values: value, 1 where it is sound, level; then the residual of the fsd
# monitor, and inner figures for a fit, where there is room for them (`monitors.base.walk`).
VALUE, SOUND, LEVEL, RESIDUAL, TRACE = range(5)
TRIM_CONDITIONS = frozenset({Condition.TILT, Condition.THROTTLE, Condition.YAW_RATE, Condition.HEIGHT})
TRIM_MEMORY_S = 1.0  # of these conditions

Floats: TypeAlias = FloatArray
Ints: TypeAlias = IntArray
#: Where the columns of a signal begin and end in x.
PLACES = {
    Signal.SPECIFIC_FORCE: (FORCE, TORQUE),
    Signal.TORQUE_COMMAND: (TORQUE, THRUST),
    Signal.THRUST_SETPOINT: (THRUST, ATTITUDE),
    Signal.ATTITUDE: (ATTITUDE, VIBRATION),
    Signal.VIBRATION: (VIBRATION, U),
    Signal.HEIGHT: (HEIGHT, OUTPUTS),
    Signal.ACTUATOR: (OUTPUTS, SPEEDS),
    Signal.ROTOR_SPEED: (SPEEDS, 1 << 20),
}


class Loop(Protocol):
    """A compiled monitor: columns from `first` on in, values out; returns how many.

    par: what its fit says. mem: what it remembers, changed in place. x: with `first` columns of before in front; from
    `known` on rates are there. out: (4, n), see `VALUE`. rotors: (n, R). at: (n,) number of the row, or of the rates,
    that each value is about.
    """

    def __call__(
        self, par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints, /
    ) -> int:
        """Take the next columns."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """x: (rows, first + n), see `SPEEDS`. first: columns of before. known: from here on there are rates."""

    x: FloatArray
    first: int
    known: int

    @property
    def past(self) -> FloatArray:
        """The latest columns, for the front of the next ones."""
        return self.x[:OUTPUTS, self.x.shape[1] - self.first :].copy()


def no_past(back: int) -> FloatArray:
    """So many columns before the first row of a segment."""
    return np.full((OUTPUTS, back), np.nan)


def columns_of(rows: Rows, past: FloatArray) -> Columns:
    """The columns of some rows behind `past`. All count as covered: nothing is known here of what was learnt."""
    block, rates = rows.block, rows.rates
    first, n = past.shape[1], len(block)
    outputs, speeds = OUTPUTS + min(block.actuator.shape[1], SPEEDS - OUTPUTS), block.rotor_speed.shape[1]
    x, lag = np.empty((SPEEDS + speeds if speeds else outputs, first + n)), n - len(rates)
    x[:OUTPUTS, :first], x[OUTPUTS:, :first] = past, np.nan
    new, known = x[:, first:], x[:, first + lag :]
    new[VALID], new[COVERED], new[SETPOINT], new[DOUBT] = block.valid, 1.0, block.setpoint_valid, block.doubt
    if lag:
        new[COMMANDED, :lag], new[U:HEADING, :lag] = 0.0, np.nan
    known[COMMANDED] = rates.commanded
    new[LEAN:RATE] = block.setpoint.T[:2]
    if np.count_nonzero(block.setpoint_valid) < n:
        new[LEAN:RATE, ~block.setpoint_valid] = 0.0
    new[RATE:FORCE], new[FORCE:TORQUE], new[TORQUE:THRUST] = block.rate.T, block.force.T, block.torque.T
    new[THRUST], new[ATTITUDE:VIBRATION], new[VIBRATION:U] = block.thrust, block.attitude.T, block.vibration.T
    known[U:Y], known[Y:GYRO], known[GYRO:HEADING] = rates.u.T, rates.y.T, rates.gyro.T
    new[HEADING], new[HEIGHT] = block.setpoint[:, 2], block.height
    new[OUTPUTS:outputs], new[outputs:SPEEDS] = block.actuator.T[: outputs - OUTPUTS], np.nan
    new[SPEEDS:] = block.rotor_speed.T
    return Columns(x, first, first + lag)
