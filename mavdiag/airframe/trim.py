"""Trim: by how much the motors must differ for the vehicle to stay where it is, and which rotor's rise explains it.

    w_i = o_i/mean(o) - 1,    m = C (w + 0.4 w^2),    C = pinv(B), B the layout's signs
    a_j = c_j' W m / (c_j' W c_j),    W = diag(1/sd^2)
    x = e (1 + 4 x/n),    a = x/(1 + x/n),    so e = a/(1 + 3 a/n)

o: motor outputs 0..1; or m itself from torque commands over thrust (a Crazyflie logs no outputs). Thrust goes as w +
0.4 w^2 (`curve_of`), but for its scale: without the square a load that hangs off both axes shows as yaw. a_j: least-
squares rise of rotor j alone that explains a shift m, c_j its column of C. e: share of its thrust and drag that a rotor
lost which is commanded the share a more: autopilots linearise. The mixer adds thrust, roll, pitch and yaw only, so it
makes up for x by x P e_j, P the projection onto these, P_jj = 4/n of n equal rotors. Losses of 5, 10 and 20 % in
ArduCopter's simulator come out within 0.01. Where outputs go with the speed, the loss is nearly twice as much.
"""

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.telemetry import BoolArray, FloatArray, Signal, Three
from mavdiag.units import G

YAW_FLOOR = 0.002  # of the hover command: smallest yaw spread that is believed (our choice)
LEVEL_RATIO = 3.0  # least spread of roll and pitch over yaw's: payload and wind move them; METHOD 5 has .07 to .012
BESIDE = 0.3  # how far beside the centre what is taken up in flight hangs, over the rotors' distance (sd, our choice)
TILT_TRIM = 0.5  # 1/rad: roll and pitch trim that a steady tilt in wind may bring (sd; emulated: 0.50 and 0.63)
ALONG_DISCS, ALONG_Z = slice(0, 2), slice(2, 3)  # of the accelerometer
FELT_SHARE = 0.99  # of the rows that must have them (our choice)
CURVE = 0.4  # (n - 1)/2 of thrust ~ o^n: 0.5 of outputs that go with the speed, 0.3 of MOT_THST_EXPO 0.65 (our choice)
MIN_OUTPUT = 0.05  # mean output or thrust below which nothing flies (our choice)

Source: TypeAlias = Literal["actuator", "torque"]
SOURCES: tuple[Source, ...] = ("actuator", "torque")
SIGNALS: dict[Source, frozenset[Signal]] = {
    "actuator": frozenset({Signal.ACTUATOR}),
    "torque": frozenset({Signal.TORQUE_COMMAND, Signal.THRUST_SETPOINT}),
}


def loss_of(rise: float, rotors: int = 4) -> float:
    """The share of its thrust that a rotor lost which is commanded so much more [fraction of hover]."""
    return rise / (1.0 + 3.0 * rise / rotors)


def sources_of(flight: Sequence[Rows], layout: RotorLayout) -> BoolArray:
    """(2,) whether a flight shows a trim by each of `SOURCES`: outputs that stand still show none."""

    def moves(block: Block, source: Source) -> bool:
        trim, known = trim_of(block, layout, source)
        shown = np.compress(known, trim.T, axis=1)
        return bool((shown != shown[:, :1]).any())

    return np.array([any(moves(rows.block, source) for rows in flight) for source in SOURCES])


def source_among(shown: Sequence[BoolArray], layout: RotorLayout) -> Source:
    """The outputs where they are sent, else the torques. shown: `sources_of` each flight. Raises InputError."""
    for number, source in enumerate(SOURCES):
        if any(one[number] for one in shown):
            return source
    raise InputError(
        f"it needs the outputs of {layout.rotors} motors that move above idle, or torque commands whose mixing is known"
    )


def trim_of(block: Block, layout: RotorLayout, source: Source) -> tuple[FloatArray, BoolArray]:
    """Roll, pitch and yaw trim of each row, (n, 3) [fraction of hover], and where it may be used; zero elsewhere."""
    own, level = slice(0, layout.rotors), level_of(block, layout, source)
    if source == "actuator" and block.actuator.shape[1] >= layout.rotors:
        beyond, known = block.actuator.T[own] - level, block.known(Signal.ACTUATOR, own)  # others move no rotor
    elif source == "torque" and layout.torque_gain is not None:
        beyond, known = block.torque.T * np.array(layout.torque_gain)[:, None], block.known(Signal.TORQUE_COMMAND)
    else:
        return np.zeros((len(block), 3)), np.zeros(len(block), dtype=np.bool_)
    known = known & block.valid & (level > MIN_OUTPUT)
    w = np.divide(beyond, level, out=np.zeros(beyond.shape), where=known)
    return (w if source == "torque" else np.einsum("kr,rn->kn", layout.unmixing, w + curve_of(layout) * w * w)).T, known


def curve_of(layout: RotorLayout) -> float:
    """Of thrust by output; 0 of a Crazyflie, whose torque commands are known: its firmware makes outputs of thrusts."""
    return CURVE if layout.torque_gain is None else 0.0


def level_of(block: Block, layout: RotorLayout, source: Source) -> FloatArray:
    """Mean output of each row, or its thrust command, (n,)."""
    return block.actuator[:, : layout.rotors].sum(axis=1) / layout.rotors if source == "actuator" else block.thrust


def shown_trim(block: Block, layout: RotorLayout) -> tuple[FloatArray, BoolArray]:
    """As `trim_of`, from the motors' outputs where any may be used, else from torque commands over the thrust."""
    trim, known = trim_of(block, layout, "actuator")
    return (trim, known) if known.any() else trim_of(block, layout, "torque")


def felt_share(flight: Sequence[Rows]) -> float:
    """The share of the valid rows of a flight whose accelerometer is known along the discs."""
    felt = [rows.block.known(Signal.SPECIFIC_FORCE, ALONG_DISCS)[rows.block.valid] for rows in flight]
    return float(np.concatenate(felt).mean()) if any(map(len, felt)) else 0.0


def pull_of(block: Block, felt: bool) -> FloatArray:
    """What pulls along the discs, as roll and pitch, (n, 2) [9.81 m/s^2]: felt, or the commanded lean, 0 if unknown."""
    if felt:
        return np.asarray(block.force[:, 1::-1] / (-G, G), dtype=np.float64)
    return np.where(block.setpoint_valid[:, None], block.setpoint[:, :2], 0.0)


def spread_of(shifts: FloatArray, ratio: float = LEVEL_RATIO) -> Three:
    """Root mean squares of healthy shifts, (n, 3); yaw's is widened, the others' are at least so many times it."""
    roll, pitch, yaw = np.sqrt(np.mean(np.square(shifts), axis=0)).tolist()
    yaw = float(np.hypot(yaw, YAW_FLOOR))
    return max(roll, ratio * yaw), max(pitch, ratio * yaw), yaw


def rises(shift: FloatArray, layout: RotorLayout, spread: Three | FloatArray) -> FloatArray:
    """a_j of each shift, (n, 3) -> (n, rotors)."""
    C, W = layout.unmixing, 1.0 / np.square(spread)
    return np.asarray((W * shift) @ C / (W @ (C * C)), dtype=np.float64)
