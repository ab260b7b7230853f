"""Free-run simulation of a stream, block by block, without scipy: `step(model, state, u) -> (state, y_sim)`.

The state is the recent past itself, inputs and simulated outputs. So a hot start is plain: put measured values there.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.model import ArxModel
from mavdiag.telemetry import FloatArray

__all__ = ["FreeRunState", "start", "step"]


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

    A NaN in u stays in the state: start anew after a break. Costs some 0.1 us a sample at na <= 3.
    Raises IdentificationError if the state belongs to a model of another order or u is not one-dimensional.
    """
    if len(state.past_u) != len(model.b) - 1 or len(state.past_y) != len(model.a) - 1 or u.ndim != 1:
        raise IdentificationError("the state or the input does not fit the model; begin with start(model)")
    if len(u) == 0:
        return state, np.empty(0)
    inputs = np.concatenate((state.past_u, u))
    # y(t) = [ b_0 u(t) + b_1 u(t-1) + .. ] - a_1 y(t-1) - a_2 y(t-2) - ..
    driven = np.correlate(inputs, model.b[::-1]).tolist()  # a convolution, "valid"
    past = state.past_y
    outputs = (_second_order, _third_order, _any_order)[min(max(len(past) - 2, 0), 2)](driven, model, past)
    recent_y = (*past, *outputs[-len(past) :])[-len(past) :]
    recent_u = tuple(inputs[len(u) :].tolist())
    return FreeRunState(recent_u, recent_y), np.array(outputs)


def _last(values: FloatArray | None, count: int) -> tuple[float, ...]:
    tail = [] if values is None or count == 0 else np.asarray(values, dtype=np.float64)[-count:].tolist()
    return tuple([0.0] * (count - len(tail)) + tail)


def _second_order(driven: list[float], model: ArxModel, past: tuple[float, ...]) -> list[float]:
    """The recursion at na <= 2 with everything in local names: the detector runs it for every sample."""
    a1, a2 = (*model.a[1:].tolist(), 0.0)[:2]
    y2, y1 = (0.0, *past)[-2:]
    outputs = []
    for w in driven:
        y = w - a1 * y1 - a2 * y2
        y2 = y1
        y1 = y
        outputs.append(y)
    return outputs


def _third_order(driven: list[float], model: ArxModel, past: tuple[float, ...]) -> list[float]:
    """The same at na = 3."""
    a1, a2, a3 = model.a[1:].tolist()
    y3, y2, y1 = past
    outputs = []
    for w in driven:
        y = w - a3 * y3 - a2 * y2 - a1 * y1
        y3 = y2
        y2 = y1
        y1 = y
        outputs.append(y)
    return outputs


def _any_order(driven: list[float], model: ArxModel, past: tuple[float, ...]) -> list[float]:
    backwards = model.a[:0:-1].tolist()  # a_na .. a_1, to meet y(t-na) .. y(t-1)
    outputs = list(past)
    for t, w in enumerate(driven):
        for a, y in zip(backwards, outputs[t : t + len(backwards)], strict=True):
            w -= a * y
        outputs.append(w)
    return outputs[len(past) :]
