"""Rows as monitors take them, and flights of them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from mavdiag.rows.block import Block
from mavdiag.rows.rates import RateBlock

__all__ = ["Flights", "Rows", "segments"]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The next aligned rows of one segment, and the filtered rates that they complete (half a window later)."""

    block: Block
    rates: RateBlock


Flights: TypeAlias = Sequence[Sequence[Rows]]
"""Flights as monitors are fitted to them: for each flight its rows of flying, in order."""


def segments(flight: Sequence[Rows]) -> list[list[Rows]]:
    """The rows of each segment of a flight, in order."""
    return [list(rows) for _, rows in itertools.groupby(flight, key=lambda one: one.block.segment)]
