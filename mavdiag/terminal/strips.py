"""Curves as text, in dots of Braille characters, so that a line moves smoothly.

A column of dots stands for a span of time and shows all values in it, from the lowest to the highest: a spike of one
sample is not lost.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from mavdiag.braille import ACROSS, DOWN, cells, character
from mavdiag.telemetry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line. t_s, values: (n,), in order of time; NaN breaks it. style: of rich. dotted: every other column."""

    t_s: FloatArray
    values: FloatArray
    style: str
    dotted: bool = False


@dataclass(frozen=True, slots=True)
class Frame:
    """What a strip shows: the times from, to [s], the values from low to high, and its size in characters."""

    from_s: float
    to_s: float
    low: float
    high: float
    width: int
    height: int


def strip(curves: Sequence[Curve], frame: Frame) -> list[Text]:
    """The lines of a strip, from the highest values to the lowest. Of several curves in a character the last has its
    colour; values beyond the frame stand at its edge.

    >>> flat = Curve(np.array([0.0, 1.0]), np.array([0.0, 0.0]), "")
    >>> [line.plain for line in strip([flat], Frame(0.0, 2.0, -1.0, 1.0, 2, 1))]
    ['⠤⠄']
    """
    bits = np.zeros((frame.height, frame.width), dtype=np.int64)
    styles = np.full(bits.shape, -1)
    for number, curve in enumerate(curves):
        own = cells(_dots(curve, frame))
        bits |= own
        styles[own > 0] = number
    return [
        Text.assemble(*((character(b), curves[s].style if b else "") for b, s in zip(row, style, strict=True)))
        for row, style in zip(bits.tolist(), styles.tolist(), strict=True)
    ]


def _dots(curve: Curve, frame: Frame) -> BoolArray:
    """Which dots a curve sets, (height * 4, width * 2), from the top."""
    columns, rows = frame.width * ACROSS, frame.height * DOWN
    at = np.floor((curve.t_s - frame.from_s) / (frame.to_s - frame.from_s) * columns)
    inside, known = (at >= 0) & (at < columns), np.isfinite(curve.values)
    keep = inside & known
    share = (frame.high - curve.values[keep]) / (frame.high - frame.low)
    row, column = np.clip(np.round(share * (rows - 1)), 0, rows - 1).astype(np.int64), at[keep].astype(np.int64)
    top, bottom = np.full(columns, rows), np.full(columns, -1)
    np.minimum.at(top, column, row)
    np.maximum.at(bottom, column, row)
    _connect(top, bottom, np.unique(at[inside & ~known]))
    if curve.dotted:
        top[1::2], bottom[1::2] = rows, -1
    every = np.arange(rows)[:, None]
    shown: BoolArray = (every >= top) & (every <= bottom)
    return shown


def _connect(top: NDArray[Any], bottom: NDArray[Any], breaks: NDArray[Any]) -> None:
    """Fill the columns that no sample fell into, unless one of `breaks` is among them, and let neighbours meet."""
    for before, after in itertools.pairwise(np.flatnonzero(bottom >= 0)):
        if after - before > 1 and not ((breaks > before) & (breaks < after)).any():
            between = np.arange(before + 1, after)
            line = np.interp(between, (before, after), (bottom[before], top[after]))
            top[between] = bottom[between] = np.round(line)
    for before, after in itertools.pairwise(np.flatnonzero(bottom >= 0)):
        if after == before + 1:
            top[after] = min(top[after], bottom[before] + 1)
            bottom[after] = max(bottom[after], top[before] - 1)
