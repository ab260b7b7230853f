"""The checksum of many frames at once: one column of bytes after the other, eight frames in a word of 64 bits.

CRC-16/MCRF4XX, as MAVLink has it: reflected polynomial 0x1021, begun with 0xFFFF. A byte b changes the state (low,
high) to (high ^ t << 3 ^ t >> 4, t ^ t >> 5) with t = s ^ s << 4 and s = b ^ low, all in eight bits: `crc_accumulate`
of MAVLink's own checksum.h. It has no table and no branch, so that a word of 64 bits takes a byte of eight frames.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.telemetry import BoolArray, IntArray

__all__ = ["Bytes", "rows_at", "sound_frames"]

Bytes: TypeAlias = NDArray[np.uint8]
_Words: TypeAlias = NDArray[np.uint64]

CHUNK = 1 << 17  # frames at a time (our choice: 10 MB of columns)
TILE = 1 << 11  # rows that are turned into columns at a time, for the same reason
_LANES = 8
_HIGH_4, _LOW_4, _HIGH_5, _LOW_3 = (np.uint64(byte * 0x0101010101010101) for byte in (0xF0, 0x0F, 0xF8, 0x07))
_3, _4, _5 = (np.uint64(shift) for shift in (3, 4, 5))


def rows_at(data: Bytes, starts: IntArray, width: int) -> Bytes:
    """(n, width): the bytes from each start on. Every start must leave room for a whole row.

    >>> rows_at(np.arange(9, dtype=np.uint8), np.array([1, 5]), 2).tolist()
    [[1, 2], [5, 6]]
    """
    windows = np.ndarray((len(data) - width + 1,), f"V{width}", data, strides=(1,))
    return windows[starts].view(np.uint8).reshape(len(starts), width)


def sound_frames(data: Bytes, starts: IntArray, lengths: IntArray, seeds: Bytes) -> BoolArray:
    """(n,) whether each frame's checksum is right.

    starts: first byte that is summed, the one behind the marker. lengths: how many are; the checksum stands behind
    them. seeds: the byte that each message's definition adds. The data must go on for the greatest length and two bytes
    behind every start.
    """
    sent = np.ndarray((len(data) - 1,), "<u2", data, strides=(1,))  # what stands at every byte
    order = np.argsort(lengths.astype(np.uint16), kind="stable")
    sound = np.empty(len(starts), np.bool_)
    for begin in range(0, len(order), CHUNK):
        chunk = order[begin : begin + CHUNK]
        first, length = starts[chunk], lengths[chunk]
        sound[chunk] = _checksums(data, first, length, seeds[chunk]) == sent[first + length]
    return sound


def _checksums(data: Bytes, starts: IntArray, lengths: IntArray, seeds: Bytes) -> NDArray[np.uint16]:
    """(n,) checksums, with the seeds. lengths: ascending, so that the frames that go on are always the last ones."""
    ended = np.searchsorted(lengths, np.arange(int(lengths[-1]) + 1), side="right").tolist()  # by each length
    columns = _columns(data, starts, lengths)
    state, done = np.full((2, columns.shape[1]), 0xFF, np.uint8), np.zeros((3, columns.shape[1]), np.uint8)
    words, spare = state.view(np.uint64), np.empty((2, columns.shape[1] // _LANES), np.uint64)
    for column, before, now in zip(columns.view(np.uint64), ended, ended[1:], strict=False):
        goes_on = slice(before // _LANES, None)
        _sum(words[:, goes_on], column[goes_on], spare[:, goes_on])
        if before < now:
            done[:2, before:now] = state[:, before:now]
    low, high, seed = done
    seed[: len(seeds)] = seeds
    _sum(done[:2].view(np.uint64), seed.view(np.uint64), spare)
    return (low | high.astype(np.uint16) << np.uint16(8))[: len(seeds)]


def _columns(data: Bytes, starts: IntArray, lengths: IntArray) -> Bytes:
    """(width, m) the frames as columns, as far as each goes; m is n raised to whole words."""
    columns = np.empty((int(lengths[-1]), -(-len(starts) // _LANES) * _LANES), np.uint8)
    for begin in range(0, len(starts), TILE):
        tile = slice(begin, begin + TILE)
        width = int(lengths[tile][-1])
        columns[:width, begin : begin + len(starts[tile])] = rows_at(data, starts[tile], width).T
    return columns


def _sum(state: _Words, column: _Words, spare: _Words) -> None:
    """Bring the state, (2, k) low and high bytes, on by one more byte of each frame."""
    low, high = state
    t, part = spare
    np.bitwise_xor(column, low, out=t)
    np.bitwise_and(np.left_shift(t, _4, out=part), _HIGH_4, out=part)
    np.bitwise_xor(t, part, out=t)
    np.bitwise_and(np.left_shift(t, _3, out=part), _HIGH_5, out=part)
    np.bitwise_xor(high, part, out=low)
    np.bitwise_and(np.right_shift(t, _4, out=part), _LOW_4, out=part)
    np.bitwise_xor(low, part, out=low)
    np.bitwise_and(np.right_shift(t, _5, out=part), _LOW_3, out=part)
    np.bitwise_xor(t, part, out=high)
