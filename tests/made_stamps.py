"""Stamps of a vehicle's messages, taken by its time in blocks."""

import numpy as np

from mavdiag.link.clock import NEVER, Counter, VehicleTime
from mavdiag.telemetry import IntArray

Stream = tuple[Counter, IntArray, IntArray]  # counts and times of arrival [ns]


def taken(*streams: Stream, time: VehicleTime | None = None, size: int = 1 << 30) -> tuple[VehicleTime, list[IntArray]]:
    """The time after these streams, a message each, in order of arrival, and the time of each stamp or `NEVER`.

    size: stamps at a time.
    """
    messages = np.array([(number, c.tick_ns, c.turn) for number, (c, _, _) in enumerate(streams)], np.int64)
    columns = [np.stack([np.full(len(raw), number), raw, host]) for number, (_, raw, host) in enumerate(streams)]
    frames = np.concatenate(columns, axis=1)
    order = np.argsort(frames[2], kind="stable")
    time, times, at = time or VehicleTime(), np.empty(len(order), np.int64), 0
    while at < len(order):
        block = np.ascontiguousarray(frames[:, order[at : at + size]])
        time, t_ns, done = time.stamped(messages, *block)
        times[order[at : at + done]] = t_ns
        at += done
    ends = np.cumsum([len(raw) for _, raw, _ in streams])
    return time, np.split(times, ends[:-1])


def in_line(counter: Counter, raw: object, host_ns: object, time: VehicleTime | None = None) -> list[int]:
    """The times of the stamps of one message that are in line [ns]."""
    _, (t_ns,) = taken((counter, np.asarray(raw, np.int64), np.asarray(host_ns, np.int64)), time=time)
    found: list[int] = t_ns[t_ns > NEVER].tolist()
    return found
