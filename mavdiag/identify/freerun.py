"""Free-run simulation of a stream, block by block, without scipy: `step(model, state, u) -> (state, y_sim)`.

The state is the recent past itself, inputs and simulated outputs. So a hot start is plain: put measured values there.
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

STRETCH = 64  # samples (our choice)
LONG = 8 * STRETCH  # samples from which on stretches are quicker


@dataclass(frozen=True, slots=True)
class FreeRunState:
    """The past that the next sample needs, newest last. past_u: (nk + nb - 1,) inputs; past_y: (na,) outputs."""

    past_u: tuple[float, ...]
    past_y: tuple[float, ...]


def start(model: ArxModel, past_u: FloatArray | None = None, past_y: FloatArray | None = None) -> FreeRunState:
    """State before the first sample: at rest, or after the given past.

    past_u, past_y: (k,) each, oldest first, any length; the last ones count and missing ones are zero.
    """
    return FreeRunState(_last(past_u, len(model.b) - 1), _last(past_y, len(model.a) - 1))


def step(model: ArxModel, state: FreeRunState, u: FloatArray) -> tuple[FreeRunState, FloatArray]:
    """Simulate the next inputs, (n,) -> (n,); equals `ArxModel.simulate` to rounding, and itself for any short blocks.

    A NaN in u stays in the state: start anew after a break. Costs some 0.1 us a sample at na <= 3.
    Raises IdentificationError if the state belongs to a model of another order or u is not one-dimensional.
    """
    if len(state.past_u) != len(model.b) - 1 or len(state.past_y) != len(model.a) - 1 or u.ndim != 1:
        raise IdentificationError("the state or the input does not fit the model; begin with start(model)")
    if len(u) == 0:
        return state, np.empty(0)
    inputs = np.concatenate((state.past_u, u))
    # y(t) = [ b_0 u(t) + b_1 u(t-1) + .. ] - a_1 y(t-1) - a_2 y(t-2) - ..
    driven = np.correlate(inputs, model.b[::-1])  # a convolution, "valid"
    past = state.past_y
    long = len(u) >= LONG and len(past) > 0 and math.isfinite(float(np.add.reduce(driven)))
    outputs = _in_stretches(driven, model, past) if long else _one_by_one(driven, model, past)
    recent_y = (*past, *outputs[len(u) - min(len(u), len(past)) :].tolist())[-len(past) :]
    recent_u = tuple(inputs[len(u) :].tolist())
    return FreeRunState(recent_u, recent_y), outputs


def _last(values: FloatArray | None, count: int) -> tuple[float, ...]:
    tail = [] if values is None or count == 0 else np.asarray(values, dtype=np.float64)[-count:].tolist()
    return tuple([0.0] * (count - len(tail)) + tail)


def _in_stretches(driven: FloatArray, model: ArxModel, past: tuple[float, ...]) -> FloatArray:
    """The recursion in stretches of `STRETCH` samples, each at once: equal to rounding, and some ten times as fast.

    What drives a stretch and what the stretch before left add up:
        y = H w + F y_past,    H the impulse response of 1/A in a lower triangle, F what each past output rings on with
    """
    answer, ring = _responses(tuple(model.a.tolist()))
    count = len(driven) // STRETCH
    outputs = np.empty(len(driven))
    rows = driven[: count * STRETCH].reshape(count, STRETCH)
    parts = outputs[: count * STRETCH].reshape(count, STRETCH)
    for first in range(0, count, STRETCH):  # a larger product would be spread over threads, which gains nothing here
        np.matmul(rows[first : first + STRETCH], answer, out=parts[first : first + STRETCH])
    before, past = _carried(parts[:, -len(past) :].tolist(), ring[-len(past) :].tolist(), past)
    parts += np.array(before) @ ring.T
    outputs[count * STRETCH :] = _one_by_one(driven[count * STRETCH :], model, past)
    return outputs


def _carried(
    left: list[list[float]], keep: list[list[float]], past: tuple[float, ...]
) -> tuple[list[tuple[float, ...]], tuple[float, ...]]:
    """The outputs before each stretch, and those after the last: past <- left + keep past."""
    before = list[tuple[float, ...]]()
    if len(past) == 2:
        (k, m), (p, q) = keep
        y2, y1 = past
        for z2, z1 in left:
            before.append((y2, y1))
            y2, y1 = z2 + k * y2 + m * y1, z1 + p * y2 + q * y1
        return before, (y2, y1)
    for ends in left:
        before.append(past)
        past = tuple([y + sum(map(mul, row, past)) for y, row in zip(ends, keep, strict=True)])
    return before, past


@lru_cache(maxsize=64)
def _responses(a: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """(STRETCH, STRETCH), H transposed, and (STRETCH, na): F, of past outputs oldest first."""
    na, still = len(a) - 1, [0.0] * STRETCH
    ring = [_any_order(still, a, tuple(float(i == j) for i in range(na))) for j in range(na)]
    pulse = _any_order([1.0, *still[1:]], a, (0.0,) * na)
    answer = np.zeros((STRETCH, STRETCH))
    for i in range(STRETCH):
        answer[i, i:] = pulse[: STRETCH - i]
    return answer, np.array(ring).T.copy()


def _one_by_one(driven: FloatArray, model: ArxModel, past: tuple[float, ...]) -> FloatArray:
    """The recursion sample by sample."""
    a = tuple(model.a.tolist())
    return np.array((_second_order, _third_order, _any_order)[min(max(len(past) - 2, 0), 2)](driven.tolist(), a, past))


def _second_order(driven: list[float], a: tuple[float, ...], past: tuple[float, ...]) -> list[float]:
    """The recursion at na <= 2 with everything in local names: the detector runs it for every sample."""
    a1, a2 = (*a[1:], 0.0)[:2]
    y2, y1 = (0.0, *past)[-2:]
    outputs = []
    for w in driven:
        y = w - a1 * y1 - a2 * y2
        y2 = y1
        y1 = y
        outputs.append(y)
    return outputs


def _third_order(driven: list[float], a: tuple[float, ...], past: tuple[float, ...]) -> list[float]:
    """The same at na = 3."""
    _, a1, a2, a3 = a
    y3, y2, y1 = past
    outputs = []
    for w in driven:
        y = w - a3 * y3 - a2 * y2 - a1 * y1
        y3 = y2
        y2 = y1
        y1 = y
        outputs.append(y)
    return outputs


def _any_order(driven: list[float], a: tuple[float, ...], past: tuple[float, ...]) -> list[float]:
    backwards = a[:0:-1]  # a_na .. a_1, to meet y(t-na) .. y(t-1)
    outputs = list(past)
    for t, w in enumerate(driven):
        for factor, y in zip(backwards, outputs[t : t + len(backwards)], strict=True):
            w -= factor * y
        outputs.append(w)
    return outputs[len(past) :]
