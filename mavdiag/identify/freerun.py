"""Free-run simulation of a stream, block by block, without scipy: `step(model, state, u) -> (state, y_sim)`.

The state is the recent past itself, inputs and simulated outputs. So a hot start is plain: put measured values there.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.model import ArxModel
from mavdiag.telemetry import FloatArray

__all__ = ["FreeRunState", "start", "step"]

STRETCH = 128  # samples that one matrix product simulates (our choice)
GROWN = 1e6  # an impulse response above it is summed sample by sample (our choice)


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
    """Simulate the next inputs, (n,) -> (n,); equals `ArxModel.simulate` to rounding, and itself for any blocks.

    A NaN in u stays in the state: start anew after a break. Costs about 0.1 us a sample in blocks of 100.
    Raises IdentificationError if the state belongs to a model of another order or u is not one-dimensional.
    """
    if len(state.past_u) != len(model.b) - 1 or len(state.past_y) != len(model.a) - 1 or u.ndim != 1:
        raise IdentificationError("the state or the input does not fit the model; begin with start(model)")
    if len(u) == 0:
        return state, np.empty(0)
    inputs = np.concatenate((state.past_u, u))
    # y(t) = [ b_0 u(t) + b_1 u(t-1) + .. ] - a_1 y(t-1) - a_2 y(t-2) - ..
    driven = np.correlate(inputs, model.b[::-1])  # mode "valid"
    past = state.past_y
    after = None if not past else _response(tuple(model.a.tolist()))
    if not past:
        outputs = driven
    elif after is None or not math.isfinite(float(np.add.reduce(driven))):
        outputs = np.array(_recursion(driven.tolist(), model, past))
    else:
        outputs = _responded(driven, *after, np.array(past))
    kept = len(past)
    recent = outputs[max(0, len(outputs) - kept) :].tolist()
    return FreeRunState(tuple(inputs[len(u) :].tolist()), (*past, *recent)[len(recent) :]), outputs


def _responded(driven: FloatArray, response: FloatArray, ringing: FloatArray, past: FloatArray) -> FloatArray:
    """The recursion as sums over the impulse response h, a stretch of samples at a time."""
    # [ y(1) ]   [ h(0)             ] [ w(1) ]   [ what 1/A goes on ]
    # [ y(2) ] = [ h(1)  h(0)       ] [ w(2) ] + [ with after y(0), ]
    # [ ..   ]   [ ..               ] [ ..   ]   [ y(-1) ..         ]
    if len(driven) <= STRETCH:
        n = len(driven)
        return np.asarray(response[:n, :n] @ driven + ringing[:n] @ past, dtype=np.float64)
    parts, before = [], past
    for first in range(0, len(driven), STRETCH):
        parts.append(_responded(driven[first : first + STRETCH], response, ringing, before))
        before = np.concatenate((before, parts[-1]))[-len(past) :]
    return np.concatenate(parts)


@lru_cache(maxsize=64)
def _response(a: tuple[float, ...]) -> tuple[FloatArray, FloatArray] | None:
    """The response of 1/A to an impulse at each sample, (STRETCH, STRETCH), and to each past output, oldest first,
    (STRETCH, na); None if it grows."""
    h = [1.0]
    for t in range(1, STRETCH):
        h.append(-sum(a[i] * h[t - i] for i in range(1, min(len(a), t + 1))))
    if not max(map(abs, h)) < GROWN:
        return None
    ages = np.subtract.outer(np.arange(STRETCH), np.arange(STRETCH))
    response = np.where(ages >= 0, np.array(h)[np.maximum(ages, 0)], 0.0)
    # y(1) has - a_na y(1-na) .. - a_1 y(0) in it, y(2) has - a_na y(2-na) .. - a_2 y(0), and so on
    na = len(a) - 1
    driven = np.zeros((STRETCH, na))
    for t in range(min(na, STRETCH)):
        driven[t, t:] = -np.array(a[:t:-1][: na - t])
    return response, response @ driven


def _last(values: FloatArray | None, count: int) -> tuple[float, ...]:
    tail = [] if values is None or count == 0 else np.asarray(values, dtype=np.float64)[-count:].tolist()
    return tuple([0.0] * (count - len(tail)) + tail)


def _recursion(driven: list[float], model: ArxModel, past: tuple[float, ...]) -> list[float]:
    backwards = model.a[:0:-1].tolist()  # a_na .. a_1, to meet y(t-na) .. y(t-1)
    outputs = list(past)
    for t, w in enumerate(driven):
        for a, y in zip(backwards, outputs[t : t + len(backwards)], strict=True):
            w -= a * y
        outputs.append(w)
    return outputs[len(past) :]
