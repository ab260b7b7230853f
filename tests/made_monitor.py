"""A monitor that the project does not have: what a new one must bring, and no more."""

import math
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.jit import cached
from mavdiag.monitors.base import Begin, Flights, LearnContext, Monitor
from mavdiag.monitors.spec import spec
from mavdiag.rows.block import FORCE, LEVEL, SOUND, VALID, VALUE, Floats, Ints
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.telemetry import Signal

WINDOW = 100


@spec
class HeightSpec:
    kind: Literal["made_up"] = "made_up"
    mean: float = 0.0


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The mean's distance from the healthy one at each row."""
    for k in range(x.shape[1] - first):
        i, good = first + k, x[VALID, first + k] > 0.5
        for axis in range(3):
            good = good and math.isfinite(x[FORCE + axis, i])
        mem[FRESH] = x[FORCE + 2, i]
        out[SOUND, k] = push(mem, 0, WINDOW, 1, good)
        out[VALUE, k] = out[LEVEL, k] = abs(total(mem, 0, 1, 0) / WINDOW - par[0])
        at[k] = k
    return len(at)


class MadeUp(Monitor[HeightSpec]):
    """Mean vertical acceleration. Warm-up: 1 s. Latency: 1 s. False alarms: many. Blind spots: all."""

    name = "made_up"
    label = "made up"
    needs = frozenset({Signal.SPECIFIC_FORCE})
    spec_type = HeightSpec
    unit = "m/s^2"
    run = staticmethod(run)

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[HeightSpec, ...]:
        """The mean of all rows."""
        blocks = [rows.block for flight in flights for rows in flight]
        down = np.concatenate([block.force[block.known(Signal.SPECIFIC_FORCE), 2] for block in blocks])
        if not len(down):
            raise InputError("no accelerometer")
        return (HeightSpec(mean=float(down.mean())),)

    def begin(self, dt_s: float) -> Begin:
        return Begin(np.array([self.spec.mean]), np.zeros(mean_size(WINDOW, 1)))
