"""The outputs of a vehicle in the order of its rotors. Done once, on the rows, so that no monitor thinks of outputs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavdiag.rows.block import Block

__all__ = ["in_rotor_order"]


def in_rotor_order(block: Block, outputs: Sequence[int] | None) -> Block:
    """The block whose column j of `actuator` is what drives rotor j.

    outputs: the output, from 1, of each rotor; None if they are in that order already. An output that the vehicle does
    not send is nan; while it has sent none, there is no column.
    """
    width = block.actuator.shape[1]
    if outputs is None or width == 0:
        return block
    columns = [one - 1 for one in outputs]
    if max(columns) < width:
        return replace(block, actuator=block.actuator.T[columns].T)
    absent = np.full((len(block), max(columns) + 1 - width), np.nan)
    return replace(block, actuator=np.hstack((block.actuator, absent)).T[columns].T)
