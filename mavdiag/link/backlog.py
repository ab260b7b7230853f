"""Frames of many vehicles that wait until they are asked for: each is copied in once and out once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached, cached_loop, jit
from mavdiag.link.codec import Frames
from mavdiag.link.datagrams import Bytes
from mavdiag.link.sequence import FRAME
from mavdiag.telemetry import IntArray

ROOM = 1024  # frames that there is room for at first
SHARE = 64  # bytes of a payload, with which the room for bytes is reckoned
# Of each system id: the place of its first and of its last frame that waits, how many do, and their bytes.
_FIRST, _LAST, _COUNT, _BYTES = range(4)


class Backlog:
    """A list of frames for each system id, all in two common arrays."""

    def __init__(self) -> None:
        self._lists, self._used = np.zeros((256, 4), np.int64), np.zeros(2, np.int64)
        self._rows, self._after, self._data = _room(0, 0)
        self.make_room()

    def put(self, frames: Frames) -> None:
        """Take these frames."""
        rows, size = len(frames), int((frames.rows["stop"] - frames.rows["body"]).sum())
        if self._used[0] + rows > len(self._rows) or self._used[1] + size > len(self._data):
            self.make_room(rows, size)
        _put(frames.data, frames.rows, self._lists, self._used, (self._rows, self._after, self._data))

    def make_room(self, rows: int = 0, size: int = 0) -> None:
        """Make room for twice what waits and these more rows and bytes; a flood leaves no large arrays behind."""
        count, filled = self._lists[:, _COUNT:].sum(axis=0).tolist()
        new = _room(max(ROOM, 2 * (count + rows)), max(SHARE * ROOM, 2 * (filled + size)))
        _move(self._lists, self._used, (self._rows, self._after, self._data), new)
        self._rows, self._after, self._data = new

    def take(self, sysid: int) -> Frames:
        """What waits of a system id; it does so no longer."""
        _, _, count, size = self._lists[sysid].tolist()
        rows, data = np.empty(count, FRAME), np.empty(size, np.uint8)
        _take(self._lists[sysid], (self._rows, self._after, self._data), rows, data)
        data.flags.writeable = False
        return Frames(data, rows)

    @property
    def sysids(self) -> list[int]:
        """Of which something waits."""
        found: list[int] = np.flatnonzero(self._lists[:, _COUNT]).tolist()
        return found


Room = tuple[NDArray[Any], IntArray, Bytes]  # frames, the place of the one that follows each, and their bytes


def _room(rows: int, size: int) -> Room:
    return np.empty(rows, FRAME), np.empty(rows, np.int64), np.empty(size, np.uint8)


@jit
def _append(data: Bytes, row: Any, sysid: int, lists: IntArray, used: IntArray, room: Any) -> None:
    (rows, after, payloads), place, to, size = room, used[0], used[1], row.stop - row.body
    for k in range(size):
        payloads[to + k] = data[row.body + k]
    rows[place] = row
    rows[place].body, rows[place].stop = to, to + size
    if lists[sysid, _COUNT]:
        after[lists[sysid, _LAST]] = place
    else:
        lists[sysid, _FIRST] = place
    lists[sysid, _LAST] = place
    lists[sysid, _COUNT] += 1
    lists[sysid, _BYTES] += size
    used[0], used[1] = place + 1, to + size


@cached_loop
def _put(data: Bytes, rows: Any, lists: IntArray, used: IntArray, room: Any) -> None:
    for k in range(len(rows)):
        _append(data, rows[k], rows[k].sender >> 8, lists, used, room)


@cached
def _move(lists: IntArray, used: IntArray, room: Any, new: Any) -> None:
    rows, after, data = room
    used[:] = 0
    for sysid in range(len(lists)):
        place, count = lists[sysid, _FIRST], lists[sysid, _COUNT]
        lists[sysid] = 0
        for _ in range(count):
            _append(data, rows[place], sysid, lists, used, new)
            place = after[place]


@cached_loop
def _take(waiting: IntArray, room: Any, found: Any, payloads: Bytes) -> None:
    (rows, after, data), place, to = room, waiting[_FIRST], 0
    waiting[:] = 0
    for k in range(len(found)):
        row = rows[place]
        size = row.stop - row.body
        for j in range(size):
            payloads[to + j] = data[row.body + j]
        found[k] = row
        found[k].body, found[k].stop = to, to + size
        to, place = to + size, after[place]
