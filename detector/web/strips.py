"""The residual and its run lengths for moving strips: few points a second, and no peak is lost. Values in and out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Chain
from mavdiag.kernel import Piece
from mavdiag.monitors.run_length import RunLength
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, FloatArray, IntArray
from mavdiag.units import NS_PER_S

__all__ = ["BIN_NS", "Strip", "strips_of"]

BIN_NS = NS_PER_S // 20  # of vehicle time that one point stands for (our choice)
DIGITS = 5
_FIRST: IntArray = np.zeros(1, dtype=np.int64)
MOST = 1e6  # that a point may show: what is not finite, or beyond it, is no figure for a strip


@dataclass(frozen=True, slots=True)
class Strip:
    """The next points of one axis; a point stands for `BIN_NS`.

    axis: of the model. bins: number of the bin of each point, vehicle time over `BIN_NS`; the last bin may be
    continued by the next strip, and is then to be put together with it.
    low, high: least and greatest residual in it [rad/s]. fsd_s: longest run above the margin. judged: whether any row
    of it was.
    """

    axis: Axis
    bins: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    fsd_s: tuple[float, ...]
    judged: tuple[bool, ...]


def strips_of(chain: Chain, pieces: Sequence[Piece]) -> tuple[Strip, ...]:
    """One for each modelled axis; without rows, without points. pieces: of the chain's outputs, in order."""
    found = []
    for number, slot in enumerate(chain.slots):
        if isinstance(slot.monitor, RunLength):
            found.append(_strip(slot.monitor.axis, [one.found[number] for one in pieces if len(one.found[number])]))
    return tuple(found)


def _strip(axis: Axis, found: Sequence[Statistic]) -> Strip:
    if not found:
        return Strip(axis, (), (), (), (), ())
    bins: IntArray = np.concatenate([one.t_ns for one in found]) // BIN_NS
    starts = np.concatenate((_FIRST, (bins[1:] != bins[:-1]).nonzero()[0] + 1))
    signal = np.concatenate([one.signal for one in found])
    fsd_s = np.concatenate([one.value for one in found])
    valid = np.concatenate([one.valid for one in found])
    return Strip(
        axis,
        tuple(bins[starts].tolist()),
        _shown(np.minimum.reduceat(signal, starts)),
        _shown(np.maximum.reduceat(signal, starts)),
        _shown(np.maximum.reduceat(fsd_s, starts)),
        tuple(np.logical_or.reduceat(valid, starts).tolist()),
    )


def _shown(values: FloatArray) -> tuple[float, ...]:
    return tuple(round(max(-MOST, min(MOST, one)), DIGITS) if one == one else 0.0 for one in values.tolist())
