"""Dots as text: a character of the Braille block (Unicode 2800) holds 2 by 4 of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

ACROSS, DOWN = 2, 4  # dots of one character
_FIRST = 0x2800
_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # of each dot, by column and row


def cells(dots: NDArray[np.bool_]) -> NDArray[Any]:
    """The dots of each character as bits, (h, w). dots: (4 h, 2 w), from the top."""
    bits = np.zeros((dots.shape[0] // DOWN, dots.shape[1] // ACROSS), dtype=np.int64)
    for across in range(ACROSS):
        for down in range(DOWN):
            bits += dots[down::DOWN, across::ACROSS] * _BITS[across][down]
    return bits


def character(bits: int, empty: str = " ") -> str:
    """The character of these bits. empty: what stands where no dot is set."""
    return chr(_FIRST + int(bits)) if bits else empty
