"""Free-run simulation of a stream, block by block, without scipy: `step(model, state, u) -> (state, y_sim)`.

The recursion goes on from stretch to stretch of `STRETCH` samples. Within a stretch its answer is known in advance:

    y = H w + F y_past,    H the impulse response of 1/A in a lower triangle, F what each past output rings on with

w is what drives it, b_0 u(t) + b_1 u(t-1) + .. So numpy computes all stretches at once. They are counted from the first
sample on, and the state holds the one that is not full, so that any blocks give the same bits.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from operator import mul

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.model import ArxModel
from mavdiag.telemetry import FloatArray

__all__ = ["FreeRunState", "start", "step"]

STRETCH = 32  # samples (our choice: 16 and 64 take longer)


@dataclass(frozen=True, slots=True)
class FreeRunState:
    """The past that the next sample needs, newest last.

    past_u: (nk + nb - 1 + d,) inputs, d of them of the stretch that is not full.
    past_y: (na,) outputs before that stretch.
    """

    past_u: tuple[float, ...]
    past_y: tuple[float, ...]


def start(model: ArxModel, past_u: FloatArray | None = None, past_y: FloatArray | None = None) -> FreeRunState:
    """State before the first sample: at rest, or after the given past.

    past_u, past_y: (k,) each, oldest first, any length; the last ones count and missing ones are zero.
    """
    return FreeRunState(_last(past_u, len(model.b) - 1), _last(past_y, len(model.a) - 1))


def step(model: ArxModel, state: FreeRunState, u: FloatArray) -> tuple[FreeRunState, FloatArray]:
    """Simulate the next inputs, (n,) -> (n,); equals `ArxModel.simulate` to rounding, and itself for any blocks.

    A NaN in u stays in the state: start anew after a break. Costs 0.03 us a sample in long blocks.
    Raises IdentificationError if the state belongs to a model of another order or u is not one-dimensional.
    """
    before_u = len(model.b) - 1
    known = len(state.past_u) - before_u  # samples of the present stretch that are done
    if not 0 <= known < STRETCH or len(state.past_y) != len(model.a) - 1 or u.ndim != 1:
        raise IdentificationError("the state or the input does not fit the model; begin with start(model)")
    if len(u) == 0:
        return state, np.empty(0)
    inputs = np.concatenate((state.past_u, u))
    driven = np.correlate(inputs, model.b[::-1])  # a convolution, "valid"
    a = tuple(model.a.tolist())
    answer, ring, keep = _responses(a)
    if not (ring.size and math.isfinite(ring[-1, -1] + float(np.add.reduce(driven)))):
        outputs = _one_by_one(driven.tolist(), a, state.past_y)
        past_y, past_u = tuple(outputs[len(outputs) - len(state.past_y) :]), tuple(inputs[len(driven) :].tolist())
        return FreeRunState(past_u, past_y), np.array(outputs[len(state.past_y) + known :])
    full, count = len(driven) // STRETCH, -(-len(driven) // STRETCH)
    rows = np.zeros((count, STRETCH))
    rows.ravel()[: len(driven)] = driven
    # einsum and not @: BLAS rounds by the number of stretches
    parts = np.einsum("nj,jk->nk", rows, answer)
    left = parts[:full, -len(state.past_y) :].tolist() if full else []
    before, after = _carried(left, keep, state.past_y)
    parts += np.einsum("nj,jk->nk", np.array([*before, after][:count]), ring)
    return FreeRunState(tuple(inputs[full * STRETCH :].tolist()), after), parts.ravel()[known : len(driven)]


def _last(values: FloatArray | None, count: int) -> tuple[float, ...]:
    tail = [] if values is None or count == 0 else np.asarray(values, dtype=np.float64)[-count:].tolist()
    return tuple([0.0] * (count - len(tail)) + tail)


def _carried(
    left: list[list[float]], keep: list[list[float]], past: tuple[float, ...]
) -> tuple[list[tuple[float, ...]], tuple[float, ...]]:
    """The outputs before each stretch, and those after the last: past <- left + keep past."""
    before = list[tuple[float, ...]]()
    if len(past) == 2:  # the usual order, and three times as fast
        (k, m), (p, q) = keep
        y2, y1 = past
        for z2, z1 in left:
            before.append((y2, y1))
            y2, y1 = z2 + (k * y2 + m * y1), z1 + (p * y2 + q * y1)
        return before, (y2, y1)
    for ends in left:
        before.append(past)
        past = tuple([y + sum(map(mul, row, past)) for y, row in zip(ends, keep, strict=True)])
    return before, past


@lru_cache(maxsize=64)
def _responses(a: tuple[float, ...]) -> tuple[FloatArray, FloatArray, list[list[float]]]:
    """(STRETCH, STRETCH) and (na, STRETCH): H and F transposed, the past outputs oldest first; and the end of F."""
    na, still = len(a) - 1, [0.0] * STRETCH
    pulse = _one_by_one([1.0, *still[1:]], a, (0.0,) * na)[na:]
    answer = np.zeros((STRETCH, STRETCH))
    for i in range(STRETCH):
        answer[i, i:] = pulse[: STRETCH - i]
    rings = [_one_by_one(still, a, tuple(float(i == j) for i in range(na)))[na:] for j in range(na)]
    ring = np.array(rings).reshape(na, STRETCH)
    return answer, ring, ring[:, STRETCH - na :].T.tolist()


def _one_by_one(driven: list[float], a: tuple[float, ...], past: tuple[float, ...]) -> list[float]:
    """The recursion y(t) = w(t) - a_1 y(t-1) - .. itself: the past outputs, and those that follow."""
    backwards = a[:0:-1]  # a_na .. a_1, to meet y(t-na) .. y(t-1)
    outputs = list(past)
    for t, w in enumerate(driven):
        for factor, y in zip(backwards, outputs[t : t + len(backwards)], strict=True):
            w -= factor * y
        outputs.append(w)
    return outputs
