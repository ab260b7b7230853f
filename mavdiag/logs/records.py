"""What the readers of binary logs share: packed records out of raw bytes, and a series from recorded columns."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavdiag.telemetry import FloatArray, IntArray, Series, Signal

__all__ = ["as_floats", "gather", "recorded"]


def gather(data: bytes, layout: np.dtype[np.void], starts: Sequence[int] | IntArray) -> NDArray[np.void]:
    """The records of one layout that start at these bytes, copied into one structured array of shape (n,).

    Every start must leave room for a whole record.

    >>> gather(b"-\\x01\\x02--\\x03\\x04", np.dtype([("a", "u1"), ("b", "u1")]), [1, 5])["b"].tolist()
    [2, 4]
    """
    if len(starts) == 0:
        return np.empty(0, layout)
    size = layout.itemsize
    anywhere = np.ndarray((len(data) - size + 1,), f"V{size}", data, 0, (1,))  # a record at every byte, none copied
    records: NDArray[np.void] = anywhere[np.asarray(starts)].view(layout)
    return records


def as_floats(stored: NDArray[np.generic]) -> FloatArray:
    """Stored numbers as floats, the same shape. Damage can leave a signalling NaN, which becomes a quiet one."""
    with np.errstate(invalid="ignore"):
        return stored.astype(np.float64)


def recorded(signal: Signal, t_ns: IntArray, values: FloatArray) -> Series:
    """A series of a log that only knows the vehicle's clock: the recorder's clock is taken to be the same.

    t_ns: (n,). values: (n, k), or (n,) for a signal of one column.
    """
    return Series(signal, t_ns, t_ns, values.reshape(len(t_ns), -1) if values.ndim == 1 else values)
