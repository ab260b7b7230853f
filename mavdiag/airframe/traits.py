"""What one flight shows of its vehicle: a figure for each trait, whatever was flown.

The trim of the rotors, the noise floors of the sensors, how far the vehicle follows its commanded rates, how strongly
it turns for a command, and what it takes to hover. Each is a plain number; a trait that the flight does not show is
NaN. `mavdiag.airframe.fingerprint` compares flights by them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.rates import RateBlock
from mavdiag.telemetry import BoolArray, FloatArray, Signal

__all__ = ["joined", "joined_rates", "trim_of"]

MIN_OUTPUT = 0.05  # mean output or thrust below which nothing flies (our choice)


def joined(flight: Sequence[Rows]) -> list[Block]:
    """The rows of a flight, one block a segment."""
    out = []
    for segment, rows in itertools.groupby(flight, key=lambda one: one.block.segment):
        blocks = [one.block for one in rows]
        out.append(blocks[0] if len(blocks) == 1 else _together(segment, blocks))
    return out


def _together(segment: int, blocks: Sequence[Block]) -> Block:
    outputs = max(one.actuator.shape[1] for one in blocks)  # rows before the first message have no column
    same = [replace(one, actuator=_widened(one.actuator, outputs)) for one in blocks]
    columns = (np.concatenate([getattr(one, field.name) for one in same]) for field in fields(Block)[2:])
    return Block(segment, blocks[0].dt_s, *columns)


def _widened(x: FloatArray, columns: int) -> FloatArray:
    return np.pad(x, ((0, 0), (0, columns - x.shape[1])), constant_values=np.nan)


def joined_rates(flight: Sequence[Rows]) -> list[RateBlock]:
    """The rates of a flight, one block a segment."""
    out = []
    for segment, rows in itertools.groupby(flight, key=lambda one: one.block.segment):
        blocks = [one.rates for one in rows]
        columns = (np.concatenate([getattr(one, field.name) for one in blocks]) for field in fields(RateBlock)[2:])
        out.append(RateBlock(segment, blocks[0].dt_s, *columns))
    return out


def trim_of(block: Block, layout: RotorLayout) -> tuple[FloatArray, BoolArray]:
    """Roll, pitch and yaw trim of each row, (n, 3) [fraction of hover], and where it is known, (n,); zero elsewhere.

    From the motors' outputs where they are sent, else from torque commands over the thrust, as in the rotor-trim
    monitor.
    """
    outputs = block.actuator[:, : layout.rotors]
    if outputs.shape[1] == layout.rotors:
        level = outputs.mean(axis=1)
        known = block.valid & np.isfinite(outputs).all(axis=1) & (level > MIN_OUTPUT)
        if known.any():
            share = np.divide(outputs, level[:, None], out=np.ones(outputs.shape), where=known[:, None]) - 1.0
            return np.einsum("nr,kr->nk", share, layout.unmixing), known
    if layout.torque_gain is None:
        return np.zeros((len(block), 3)), np.zeros(len(block), dtype=np.bool_)
    known = block.valid & block.known(Signal.TORQUE_COMMAND) & (block.thrust > MIN_OUTPUT)
    command = block.torque * np.array(layout.torque_gain)
    return np.divide(command, block.thrust[:, None], out=np.zeros((len(block), 3)), where=known[:, None]), known
