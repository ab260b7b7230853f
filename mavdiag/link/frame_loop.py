"""The walk of `frame_walk` as one compiled loop, where numba is installed (the extra `plant`).

To import and load numba takes a second or so: it pays for large recordings, or where numba is there already. Checksums
are taken eight bytes at a time by tables ("slicing by eight", Kounavis and Berry 2005).
"""

import importlib
import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdiag.link.crc_columns import Bytes
from mavdiag.link.frame_walk import LATEST_US, STAMP_BYTES, V1, V2, Dialect, Finder, Piece, by_arrays
from mavdiag.link.signing import SEAL_BYTES
from mavdiag.telemetry import IntArray

__all__ = ["PAYS_BYTES", "by_loop", "finder_for"]

PAYS_BYTES = 512 << 20  # of a recording, behind which numba is imported for the rest (our choice)
_SLICES = 8
_REFLECTED = 0x8408  # 0x1021, bits in reverse


def finder_for(done: int) -> Finder:
    """The quickest way to find frames, after so many bytes of a recording. All ways find the same."""
    there = sys.modules.get("numba") is not None
    return by_loop if there or (done >= PAYS_BYTES and _installed()) else by_arrays


def _installed() -> bool:
    return "numba" not in sys.modules and importlib.util.find_spec("numba") is not None


def by_loop(piece: Piece, known: Dialect) -> IntArray:
    """Where the sound frames of a piece begin. Raises ImportError without numba."""
    begin = np.empty(piece.size // (STAMP_BYTES + 8) + 1, np.int64)
    count = _compiled()(piece.data, piece.size, piece.limit, piece.last, known.seeds, _tables(), begin)
    return begin[:count].copy()


@cache
def _tables() -> NDArray[np.uint16]:
    """(8, 256): what a byte makes of the checksum that stands 0 to 7 bytes behind it."""
    tables = np.zeros((_SLICES, 256), np.uint16)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (_REFLECTED if crc & 1 else 0)
        tables[0, byte] = crc
    for k in range(1, _SLICES):
        tables[k] = tables[k - 1] >> np.uint16(8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


@cache
def _compiled() -> Callable[..., int]:
    """The loop, from numba's cache on disk if there is one."""
    numba: Any = importlib.import_module("numba")
    try:
        loop = numba.njit(cache=True)(_loop)
    except RuntimeError:  # nowhere to keep the machine code
        loop = numba.njit(_loop)
    return loop  # type: ignore[no-any-return]  # numba has no types for what it compiles


def _loop(
    data: Bytes,
    size: int,
    limit: int,
    last: bool,
    seeds: NDArray[np.int16],
    tables: NDArray[np.uint16],
    found: IntArray,
) -> int:
    """Write where sound frames begin; returns how many. Steps of `codec.Decoder.take`, whose words are there."""
    zero = np.int64(0)  # `zero +` makes a byte a signed number for numba
    count, at, beyond = 0, STAMP_BYTES, len(seeds) - 1
    while at < limit:
        marker, begin = data[at], at
        at += 1
        if (marker != V2 and marker != V1) or data[begin - 8] != 0 or data[begin - 7] >= LATEST_US >> 48:
            continue
        stop, flags, msgid = begin + 6 + data[begin + 1], zero, zero + data[begin + 5]
        if marker == V2:
            stop, flags = stop + 4, zero + data[begin + 2]
            msgid = (zero + data[begin + 7]) | (zero + data[begin + 8]) << 8 | (zero + data[begin + 9]) << 16
        after = stop + 2 + SEAL_BYTES * flags
        following = after + STAMP_BYTES
        if flags > 1 or after > size:
            continue
        seed = zero + seeds[min(msgid, beyond)]
        if seed < 0:
            goes_on = following < size and (data[following] == V1 or data[following] == V2)
            if not goes_on and not (last and after == size):
                continue
        else:
            crc, k = zero + 0xFFFF, begin + 1
            while k + 8 <= stop:
                before, crc = crc, zero
                for j in range(8):
                    byte = zero + data[k + j]
                    if j < 2:
                        byte ^= before >> 8 * j & 0xFF
                    crc ^= tables[7 - j, byte]
                k += 8
            while k < stop:
                crc = crc >> 8 ^ tables[0, (crc ^ data[k]) & 0xFF]
                k += 1
            crc = crc >> 8 ^ tables[0, (crc ^ seed) & 0xFF]
            if crc != (zero + data[stop]) | (zero + data[stop + 1]) << 8:
                continue
        found[count] = begin
        count, at = count + 1, following
    return count
