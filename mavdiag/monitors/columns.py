"""What compiled monitors read: one array with a row for each signal and a column for each row of flight.

Rates are known half a filter window later than the rows that they are about. Here they stand in the column of the
newest row of their window, so that a column holds what is known when its row has come; columns before `lag` have none.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, IntArray, Signal

# Rows of x: three each, but for thrust, heading (commanded) and height; the outputs are the last ones. GYRO is the raw
# gyro that Y is smoothed of.
LEAN, RATE, FORCE, TORQUE, THRUST, ATTITUDE, VIBRATION, U, Y, GYRO = 0, 2, 5, 8, 11, 12, 15, 18, 21, 24
HEADING, HEIGHT, OUTPUTS = 27, 28, 29
# Rows of the flags: the gyro may be judged; the rates may be compared; the flight is one that trims were learnt in; the
# set-point may be used; why the gyro must not be judged though it is there (`rows.quality.DOUBTS`).
VALID, COMMANDED, COVERED, SETPOINT, DOUBT = range(5)
FLAGS = 5
TRIM_CONDITIONS = frozenset({Condition.TILT, Condition.THROTTLE, Condition.YAW_RATE, Condition.HEIGHT})
TRIM_MEMORY_S = 1.0  # of these conditions
# Rows of what a monitor writes for each of its values.
VALUE, SOUND, LEVEL, SIGNAL = 0, 1, 2, 3
TRACE = 4  # inner figures for a fit, where there are rows for them (`monitors.fitting.traced`)

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
    Signal.ACTUATOR: (OUTPUTS, 1 << 20),
}


class Kernel(Protocol):
    """A compiled monitor: columns in, values out; returns how many.

    par: what its fit says. mem: what it remembers, changed in place. x, flags, lag: as in `Columns`. out: (4, n) value,
    1 where it is sound, level, signal. rotors: (n, R). at: (n,) number of the row, or of the rates, that each value is
    about.
    """

    def __call__(
        self,
        par: FloatArray,
        mem: FloatArray,
        x: FloatArray,
        flags: FloatArray,
        lag: int,
        out: FloatArray,
        rotors: FloatArray,
        at: IntArray,
        /,
    ) -> int:
        """Take the next columns."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """x: (OUTPUTS + outputs, n). flags: (FLAGS, n). lag: columns before it have no rates."""

    x: FloatArray
    flags: FloatArray
    lag: int


def columns_of(rows: Rows) -> Columns:
    """The columns of some rows. All of them count as covered: nothing is known here of what was learnt."""
    block, rates = rows.block, rows.rates
    n, lag = len(block), len(block) - len(rows.rates)
    x, flags = np.empty((OUTPUTS + block.actuator.shape[1], n)), np.zeros((FLAGS, n))
    x[LEAN:RATE] = block.setpoint.T[:2]
    if np.count_nonzero(block.setpoint_valid) < n:
        x[LEAN:RATE, ~block.setpoint_valid] = 0.0
    x[RATE:FORCE], x[FORCE:TORQUE], x[TORQUE:THRUST] = block.rate.T, block.force.T, block.torque.T
    x[THRUST], x[ATTITUDE:VIBRATION], x[VIBRATION:U] = block.thrust, block.attitude.T, block.vibration.T
    x[U:HEADING, :lag] = np.nan
    x[U:Y, lag:], x[Y:GYRO, lag:], x[GYRO:HEADING, lag:] = rates.u.T, rates.y.T, rates.gyro.T
    x[HEADING], x[HEIGHT], x[OUTPUTS:] = block.setpoint[:, 2], block.height, block.actuator.T
    flags[VALID], flags[COMMANDED, lag:] = block.valid, rates.commanded
    flags[COVERED], flags[SETPOINT], flags[DOUBT] = 1.0, block.setpoint_valid, block.doubt
    return Columns(x, flags, lag)
