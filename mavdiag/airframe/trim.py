"""Trim: by how much the motors must differ for the vehicle to stay where it is, and which rotor's rise explains it.

    w_i = o_i/mean(o) - 1,    m = C w,    C = pinv(B), B the layout's signs
    a_j = c_j' W m / (c_j' W c_j),    W = diag(1/sd^2)

o: motor outputs 0..1; or m itself from torque commands over thrust (a Crazyflie logs no outputs). a_j is the least-
squares rise of rotor j alone that explains a shift m, c_j its column of C.

A rotor that lost the share e of its thrust carries as much when it is commanded the share a more. Thrust goes with the
command, for autopilots linearise it:

    (1 - e)(1 + a) = 1

A recorded ArduCopter's motors at 0.95, 0.90 and 0.80 rise by 0.054, 0.110 and 0.237, by this law 0.053, 0.111 and
0.250. Where outputs go with the speed of the rotor, T ~ w^2, the same rise is a loss of nearly twice as much.
"""

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.telemetry import BoolArray, FloatArray, Signal, Three

__all__ = [
    "LEVEL_RATIO",
    "MIN_OUTPUT",
    "MOST_LOSS",
    "SIGNALS",
    "SOURCES",
    "YAW_FLOOR",
    "Source",
    "loss_of",
    "rise_of",
    "rises",
    "shown_trim",
    "source_among",
    "source_of",
    "sources_of",
    "spread_from",
    "spread_of",
    "tilt_of",
    "trim_of",
]

YAW_FLOOR = 0.002  # of the hover command: smallest yaw spread that is believed (our choice)
LEVEL_RATIO = 3.0  # least spread of roll and pitch over yaw's: payload and wind move them; METHOD 5 has .07 to .012
TILT_TRIM = 0.3  # 1/rad: roll and pitch trim that a steady tilt in wind may bring (estimate; emulated: 0.28)
NO_TILT = np.zeros((1, 2))
MOST_LOSS = 1 / 3  # of a rotor's thrust; with less left no output can answer (our choice)
MIN_OUTPUT = 0.05  # mean output or thrust below which nothing flies (our choice)

Source: TypeAlias = Literal["actuator", "torque"]
SOURCES: tuple[Source, ...] = ("actuator", "torque")
SIGNALS: dict[Source, frozenset[Signal]] = {
    "actuator": frozenset({Signal.ACTUATOR}),
    "torque": frozenset({Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT}),
}


def rise_of(loss: float) -> float:
    """By how much a rotor is commanded more [fraction of hover] that lost this share of its thrust, below 1.

    >>> rise_of(0.2), loss_of(0.25)
    (0.25, 0.2)
    """
    return loss / (1.0 - loss)


def loss_of(rise: float) -> float:
    """The share of its thrust that a rotor lost which is commanded so much more [fraction of hover]."""
    return rise / (1.0 + rise)


def sources_of(flight: Sequence[Rows], layout: RotorLayout) -> BoolArray:
    """(2,) whether a flight shows a trim by each of `SOURCES`: outputs that stand still show none."""
    return np.array([any(_moves(rows.block, layout, one) for rows in flight) for one in SOURCES])


def _moves(block: Block, layout: RotorLayout, source: Source) -> bool:
    trim, known = trim_of(block, layout, source)
    used = trim[known]
    return bool((used != used[:1]).any())


def source_of(flights: Sequence[Sequence[Rows]], layout: RotorLayout) -> Source:
    """The outputs where they are sent, for they are what the rotors really got.

    Raises InputError if there is neither.
    """
    return source_among([sources_of(flight, layout) for flight in flights], layout)


def source_among(shown: Sequence[BoolArray], layout: RotorLayout) -> Source:
    """As `source_of`, from what `sources_of` says of each flight."""
    for number, source in enumerate(SOURCES):
        if any(one[number] for one in shown):
            return source
    raise InputError(
        f"it needs the outputs of {layout.rotors} motors that move above idle, or torque commands whose mixing is known"
    )


def trim_of(block: Block, layout: RotorLayout, source: Source) -> tuple[FloatArray, BoolArray]:
    """Roll, pitch and yaw trim of each row, (n, 3) [fraction of hover], and where it may be used; zero elsewhere.

    The same arrays for the same question; do not write to them.
    """
    return block.once((source, layout), lambda: _trim_of(block, layout, source))


def _trim_of(block: Block, layout: RotorLayout, source: Source) -> tuple[FloatArray, BoolArray]:
    if source == "actuator":
        outputs = block.actuator[:, : layout.rotors]  # further outputs move no rotor, and may be unknown
        if outputs.shape[1] < layout.rotors:
            return np.zeros((len(block), 3)), np.zeros(len(block), dtype=np.bool_)
        rows = np.ascontiguousarray(outputs.T)  # (rotors, n)
        level = np.add.reduce(rows, axis=0) / layout.rotors
        known = block.valid & block.known(Signal.ACTUATOR, slice(0, layout.rotors)) & (level > MIN_OUTPUT)
        if np.count_nonzero(known) < len(known):
            rows, level = np.where(known, rows, 1.0), np.where(known, level, 1.0)
        return np.einsum("kr,rn->kn", layout.unmixing, rows / level - 1.0).T, known
    if layout.torque_gain is None:
        return np.zeros((len(block), 3)), np.zeros(len(block), dtype=np.bool_)
    # B m = w is what the mixer adds to the thrust, so m is the command itself, over the thrust.
    known = block.valid & block.known(Signal.TORQUE_COMMAND) & (block.thrust > MIN_OUTPUT)
    command = block.torque.T * np.array(layout.torque_gain)[:, None]
    return np.divide(command, block.thrust, out=np.zeros((3, len(block))), where=known).T, known


def shown_trim(block: Block, layout: RotorLayout) -> tuple[FloatArray, BoolArray]:
    """As `trim_of`, from the motors' outputs where any may be used, else from torque commands over the thrust."""
    trim, known = trim_of(block, layout, "actuator")
    return (trim, known) if known.any() else trim_of(block, layout, "torque")


def tilt_of(block: Block) -> FloatArray:
    """Commanded roll and pitch of each row, (n, 2) [rad]; zero where unknown."""
    if np.count_nonzero(block.setpoint_valid) == len(block):
        return block.setpoint[:, :2]
    return np.where(block.setpoint_valid, block.setpoint.T[:2], 0.0).T


def spread_of(shifts: FloatArray) -> Three:
    """Root mean squares of healthy shifts, (n, 3); yaw's is widened, the others' are at least three times it."""
    return spread_from(np.mean(np.square(shifts), axis=0))


def spread_from(squares: FloatArray) -> Three:
    """As `spread_of`, from the mean squares of the shifts, (3,)."""
    roll, pitch, yaw = np.sqrt(squares).tolist()
    yaw = float(np.hypot(yaw, YAW_FLOOR))
    return max(roll, LEVEL_RATIO * yaw), max(pitch, LEVEL_RATIO * yaw), yaw


def rises(shift: FloatArray, layout: RotorLayout, spread: Three | FloatArray, tilt: FloatArray = NO_TILT) -> FloatArray:
    """The rise of each rotor that explains a shift of the trim alone, (n, 3) -> (n, rotors) [fraction of hover].

    tilt: (n, 2) by how much the commanded tilt differs [rad]: wind that holds a vehicle tilted tips the rotor discs
    too, so 0.3 times the tilt is added in squares to the spread of roll and pitch. Without it roll and pitch count in
    full, which tells rotors of one sense of rotation apart.
    """
    C, shifts = layout.unmixing, shift.T
    weights = 1.0 / np.array([[one * one] for one in spread])
    # einsum and not @: BLAS rounds by the number of rows, and a cut must not change a value
    if tilt is NO_TILT:
        share = weights * C / np.einsum("kn,kr->r", weights, C * C)
        return np.asarray(np.einsum("kr,kn->rn", share, shifts).T, dtype=np.float64)
    level = 1.0 / (TILT_TRIM**2 * np.einsum("nk,nk->n", tilt, tilt) + np.array([[spread[0] ** 2], [spread[1] ** 2]]))
    found = np.einsum("kr,kn->rn", C[:2], shifts[:2] * level) + (weights[2] * C[2])[:, None] * shifts[2]
    found /= np.einsum("kr,kn->rn", C[:2] ** 2, level) + (weights[2] * C[2] ** 2)[:, None]
    return np.asarray(found.T, dtype=np.float64)
