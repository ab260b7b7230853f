"""A monitor that the project does not have: what a new one must bring, and no more."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.jit import cached, source_digest
from mavdiag.monitors.base import LearnContext, Monitor, Summaries, Summary
from mavdiag.monitors.columns import FORCE, LEVEL, SIGNAL, SOUND, VALID, VALUE, Kernel
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.telemetry import FloatArray, IntArray, Signal

WINDOW = 100


@dataclasses.dataclass(frozen=True, slots=True)
class HeightSpec:
    """Healthy mean acceleration."""

    kind: Literal["made_up"] = "made_up"
    mean: float = 0.0


def _compiled(digest: int) -> Kernel:
    @cached
    def run(
        par: FloatArray,
        mem: FloatArray,
        x: FloatArray,
        flags: FloatArray,
        lag: int,
        out: FloatArray,
        rotors: FloatArray,
        at: IntArray,
    ) -> int:
        """The mean's distance from the healthy one at each row."""
        for i in range(x.shape[1] if digest else 0):
            known = flags[VALID, i] > 0.5
            for axis in range(3):
                known = known and math.isfinite(x[FORCE + axis, i])
            mem[FRESH] = x[FORCE + 2, i]
            out[SOUND, i] = push(mem, 0, WINDOW, 1, known)
            out[VALUE, i] = out[LEVEL, i] = out[SIGNAL, i] = abs(total(mem, 0, 1, 0) / WINDOW - par[0])
            at[i] = i
        return len(at)

    return run


class MadeUp(Monitor[HeightSpec]):
    """Mean vertical acceleration over 1 s, to show that a new monitor is one class.

    Warm-up: 1 s. Latency: 1 s. False alarms: many. Blind spots: all.

    >>> MadeUp(HeightSpec()).unit
    'm/s^2'
    """

    name = "made_up"
    label = "made up"
    needs = frozenset({Signal.SPECIFIC_FORCE})
    spec_type = HeightSpec
    unit = "m/s^2"
    run = staticmethod(_compiled(source_digest()))

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """How many rows there are, and their sum."""
        down = [rows.block.force[rows.block.known(Signal.SPECIFIC_FORCE), 2] for rows in flight]
        return (np.array([sum(map(len, down)), sum(float(one.sum()) for one in down)]),)

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[HeightSpec, ...]:
        """The mean of all rows."""
        count, total_ = np.sum([found for (found,) in summaries], axis=0).tolist()
        if not count:
            raise InputError("no accelerometer")
        return (HeightSpec(mean=total_ / count),)

    def parameters(self, dt_s: float) -> FloatArray:
        """The healthy mean."""
        return np.array([self.spec.mean])

    def memory(self, dt_s: float) -> FloatArray:
        """An empty mean."""
        return np.zeros(mean_size(WINDOW, 1))
