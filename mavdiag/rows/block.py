"""The uniform rows that everything after the alignment works on: one array x for signals, flags and rates.

A row of x is a signal, a column is a row of flight. Rates are known half a filter window later than what they are
about (`rows.rates`); in x they stand in the column of the newest row of their window, so that a column holds what is
known when it has come.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal

# Flags among the rows of x: the gyro may be judged: it is there, settled and airborne; the set-point is there and
# settled; why the gyro, though it is there, must not be judged (a place in `rows.quality.DOUBTS`, 0 for none); the
# flight is one that trims were learnt in, which the pass says; the gyro was valid in the whole window of a rate; so
# was the set-point.
VALID, SETPOINT, DOUBT, COVERED, WHOLE, COMMANDED = range(6)
MADE_UP = 0.75  # in VALID where the gyro may be judged, but its own sample is missing or one of two: it is made up
# Signals: three rows each, but for thrust, height and armed. LEAN: the commanded roll and pitch, before the commanded
# HEADING. Y: the gyro, smoothed; GYRO: as it was measured; U: the commanded body rate. Outputs and, behind `MOST` of
# them, the speeds of rotors are the last rows, where there are any.
RATE, FORCE, LEAN, HEADING, TORQUE, RATE_SETPOINT, ATTITUDE, THRUST = 6, 9, 12, 14, 15, 18, 21, 24
HEIGHT, ARMED, VIBRATION, U, Y, GYRO, OUTPUTS, MOST = 25, 26, 27, 30, 33, 36, 39, 16
SPEEDS = OUTPUTS + MOST
# Rows of what a monitor writes for each of its values: value, 1 where it is sound, level; then the residual of the fsd
# monitor, and inner figures for a fit, where there is room for them (`monitors.base.walk`).
VALUE, SOUND, LEVEL, RESIDUAL, TRACE = range(5)
#: Where the columns of a signal begin and end in x.
PLACES = {
    Signal.BODY_RATE: (RATE, FORCE),
    Signal.SPECIFIC_FORCE: (FORCE, LEAN),
    Signal.ATTITUDE_SETPOINT: (LEAN, TORQUE),
    Signal.TORQUE_COMMAND: (TORQUE, RATE_SETPOINT),
    Signal.RATE_SETPOINT: (RATE_SETPOINT, ATTITUDE),
    Signal.ATTITUDE: (ATTITUDE, THRUST),
    Signal.THRUST_SETPOINT: (THRUST, HEIGHT),
    Signal.HEIGHT: (HEIGHT, ARMED),
    Signal.ARMED: (ARMED, VIBRATION),
    Signal.VIBRATION: (VIBRATION, U),
    Signal.ACTUATOR: (OUTPUTS, SPEEDS),
    Signal.ROTOR_SPEED: (SPEEDS, 1 << 20),
}

Floats: TypeAlias = FloatArray
Ints: TypeAlias = IntArray
Kind = TypeVar("Kind", bound=np.generic)


class Part(Generic[Kind]):
    """Some rows of x as an attribute: (n,) of one row, (n, k) of several; a flag as truth values."""

    def __init__(self, at: int | slice, find: Callable[[FloatArray], NDArray[Kind]]) -> None:
        self.at, self.find = at, find

    def __get__(self, block: Any, owner: object) -> NDArray[Kind]:
        return self.find((np.empty((SPEEDS, 0)) if block is None else block.x)[self.at])


def rows_of(first: int, stop: int) -> Part[np.float64]:
    """The rows of a vector, or of a number."""
    return Part(first if stop == first + 1 else slice(first, stop), lambda x: x.T)


def signal(signal: Signal) -> Part[np.float64]:
    """The rows of a signal."""
    return rows_of(*PLACES[signal])


def flag(at: int) -> Part[np.bool_]:
    """A row of x that is 1 where something is so."""
    return Part(at, lambda x: x > 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive rows of one segment, on a uniform grid of period `dt_s`.

    A signal is nan in a row where it is unknown (see `rows.align`); `setpoint_valid` says where the set-point may be
    used. Columns and units of signals are those of `Signal`; angles have no jumps of 2 pi.

    segment: number of the unbroken span of flight. t_ns: (n,) vehicle time. whole: (rows, ..) memory, in which its own
    columns x, (rows, n), see `VALID`, begin with `first`; what is in front is room for those of before (`columns_of`).
    outputs: how many outputs the vehicle has sent; actuator is (n, outputs), rotor_speed (n, ESCs).
    u: (n, 3) commanded body rates p, q, r [rad/s], 0 where no set-point is known. y: (n, 3) measured ones, smoothed.
    gyro: as they were measured. rated: the gyro was valid in the whole window. commanded: so was the set-point: u and y
    may be compared.
    settled_ns: rows before it are of a take-off, or of the start of the data.
    """

    segment: int
    dt_s: float
    t_ns: IntArray
    whole: FloatArray
    outputs: int = 0
    settled_ns: int = 0
    first: int = 0

    rate = signal(Signal.BODY_RATE)
    setpoint = signal(Signal.ATTITUDE_SETPOINT)  # nan before the first, in an outage; lean 0 once rates are made
    force = signal(Signal.SPECIFIC_FORCE)
    torque = signal(Signal.TORQUE_COMMAND)
    rate_setpoint = signal(Signal.RATE_SETPOINT)
    attitude = signal(Signal.ATTITUDE)
    thrust = signal(Signal.THRUST_SETPOINT)
    height = signal(Signal.HEIGHT)
    armed = signal(Signal.ARMED)
    vibration = signal(Signal.VIBRATION)
    rotor_speed = signal(Signal.ROTOR_SPEED)
    u, y, gyro = rows_of(U, Y), rows_of(Y, GYRO), rows_of(GYRO, OUTPUTS)
    valid, setpoint_valid, rated, commanded = flag(VALID), flag(SETPOINT), flag(WHOLE), flag(COMMANDED)
    doubt = Part[np.float64](DOUBT, lambda x: x)

    @property
    def x(self) -> FloatArray:
        """(rows, n), see `VALID`."""
        return self.whole[:, self.first : self.first + len(self.t_ns)]

    @property
    def actuator(self) -> FloatArray:
        """(n, outputs)."""
        return self.x[OUTPUTS : OUTPUTS + self.outputs].T

    def __len__(self) -> int:
        return len(self.t_ns)

    def rows(self, first: int, stop: int, segment: int | None = None, settled_ns: int | None = None) -> "Block":
        """Rows [first, stop) as a block of their own, of another segment, or settled at another time, if asked."""
        segment = self.segment if segment is None else segment
        settled_ns = self.settled_ns if settled_ns is None else settled_ns
        if stop - first == len(self.t_ns) and segment == self.segment and settled_ns == self.settled_ns:
            return self
        t_ns = self.t_ns[first:stop]
        return Block(segment, self.dt_s, t_ns, self.whole, self.outputs, settled_ns, self.first + first)

    def known(self, signal: Signal, columns: slice = slice(None)) -> BoolArray:
        """(n,) where the row carries these columns of a signal; nowhere if rows have none for it.

        BODY_RATE: `valid`. ATTITUDE_SETPOINT: `setpoint_valid`.
        """
        if signal is Signal.BODY_RATE:
            return self.valid
        if signal is Signal.ATTITUDE_SETPOINT:
            return self.setpoint_valid
        values = self.x[slice(*PLACES[signal])] if signal in PLACES else self.x[:0]
        values = (values[: self.outputs] if signal is Signal.ACTUATOR else values)[columns]
        return np.asarray(np.isfinite(values).all(axis=0) & (len(values) > 0), dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The next aligned rows of one segment, and the filtered rates that they complete (half a window later).

    rates_ns: (k,) times of the rates, which stand in the last k columns.
    """

    block: Block
    rates_ns: IntArray

    @property
    def rates(self) -> Block:
        """The columns with rates alone, at the times of these."""
        block, lag = self.block, len(self.block) - len(self.rates_ns)
        return replace(block, t_ns=self.rates_ns, first=block.first + lag)

    def part(self, first: int, stop: int, segment: int | None = None, from_ns: int | None = None) -> "Rows":
        """Rows [first, stop), of another segment if asked, with the rates that they complete from a time on."""
        lag = len(self.block) - len(self.rates_ns)
        begin = 0 if from_ns is None else int(self.rates_ns.searchsorted(from_ns))
        kept = self.rates_ns[max(first - lag, begin, 0) : max(stop - lag, 0)]
        return Rows(self.block.rows(first, stop, segment), kept)


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """What a compiled monitor reads. x: (rows, first + n). first: columns of before. known: from here on are rates."""

    x: FloatArray
    first: int
    known: int

    @property
    def past(self) -> FloatArray:
        """The latest columns, for the front of the next ones."""
        return self.x[:OUTPUTS, self.x.shape[1] - self.first :]


def no_past(back: int) -> FloatArray:
    """So many columns before the first row of a segment."""
    return np.full((OUTPUTS, back), np.nan)


def columns_of(rows: Rows, past: FloatArray) -> Columns:
    """The columns of some rows behind `past`; rates of another segment are none.

    They stay where they are if there is just the room in front of them.
    """
    (block, x), first, lag = (rows.block, rows.block.whole), past.shape[1], len(rows.block) - len(rows.rates_ns)
    if not block.first == first == x.shape[1] - len(block) > 0:
        x = np.empty((len(x), first + len(block)))
        x[:, first:] = block.x
    x[:OUTPUTS, :first], x[OUTPUTS:, :first] = past, np.nan
    if lag:
        x[COMMANDED, first : first + lag], x[U:OUTPUTS, first : first + lag] = 0.0, np.nan
    return Columns(x, first, first + lag)


def in_rotor_order(block: Block, outputs: Sequence[int] | None) -> Block:
    """The block whose column j of `actuator` is what drives rotor j, and of `rotor_speed` what its ESC tells.

    An output or ESC that is not sent is nan. An autopilot numbers ESCs as the outputs that they are on.
    outputs: the output, from 1, of each rotor; None if they are in that order already.
    """
    if outputs is None:
        return block

    def by_rotor(sent: FloatArray) -> FloatArray:
        with_absent = np.vstack((sent, np.full(len(block), np.nan)))
        return with_absent[np.minimum(outputs, len(sent) + 1) - 1] if len(sent) else sent

    return with_outputs(block, by_rotor(block.actuator.T), by_rotor(block.rotor_speed.T), block.first)


def with_outputs(block: Block, sent: FloatArray, speeds: FloatArray, room: int = 0) -> Block:
    """The block with other outputs and speeds, (outputs, n) and (ESCs, n), behind so many columns of room."""
    x = np.empty((SPEEDS + len(speeds) if len(speeds) else OUTPUTS + len(sent), room + len(block)))
    x[:, :room], x[:OUTPUTS, room:], x[OUTPUTS:, room:][: len(sent)] = np.nan, block.x[:OUTPUTS], sent
    x[OUTPUTS + len(sent) : SPEEDS, room:], x[SPEEDS:, room:] = np.nan, speeds
    return replace(block, whole=x, first=room, outputs=len(sent))
