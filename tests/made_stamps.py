"""Stamps of a vehicle's messages, taken by its time in blocks."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mavdiag.link.clock import REBOOT, Counter, VehicleTime, stamp
from mavdiag.telemetry import IntArray

Stream = tuple[Counter, IntArray, IntArray]  # counts and times of arrival [ns]


@numba.njit
def _stamped(time: tuple[Any, Any, Any, Any], counters: IntArray, frames: IntArray, t_ns: IntArray) -> None:
    for k in range(frames.shape[1]):
        number, count, host_ns = frames[0, k], frames[1, k], frames[2, k]
        t_ns[k] = REBOOT
        while t_ns[k] == REBOOT:
            tick, turn = counters[number, 0], counters[number, 1]
            t_ns[k] = stamp(time, number, tick, turn, count, host_ns)


def taken(*streams: Stream, time: VehicleTime | None = None, size: int = 1 << 30) -> tuple[VehicleTime, list[IntArray]]:
    """The time after these streams, a message each, in order of arrival, and the time of each stamp or `NEVER`.

    size: stamps at a time.
    """
    counters = np.array([(c.tick_ns, c.turn) for c, _, _ in streams], np.int64)
    columns = [np.stack([np.full(len(raw), number), raw, host]) for number, (_, raw, host) in enumerate(streams)]
    frames: NDArray[Any] = np.concatenate(columns, axis=1)
    order = np.argsort(frames[2], kind="stable")
    time, times = time or VehicleTime(), np.empty(len(order), np.int64)
    for at in range(0, len(order), size):
        some = order[at : at + size]
        time, found = VehicleTime(time.words.copy()), np.empty(len(some), np.int64)
        _stamped(time.records, counters, np.ascontiguousarray(frames[:, some]), found)
        times[some] = found
    ends = np.cumsum([len(raw) for _, raw, _ in streams])
    return time, np.split(times, ends[:-1])
