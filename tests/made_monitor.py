"""A monitor that the project does not have: what a new one must bring, and no more."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.monitors.base import LearnContext, Monitor, Summaries, Summary
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import MeanState, sliding_mean, start_mean
from mavdiag.telemetry import Signal


@dataclasses.dataclass(frozen=True, slots=True)
class HeightSpec:
    """Healthy mean acceleration."""

    kind: Literal["made_up"] = "made_up"
    mean: float = 0.0


class MadeUp(Monitor[HeightSpec, MeanState]):
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

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """How many rows there are, and their sum."""
        down = [rows.block.force[rows.block.known(Signal.SPECIFIC_FORCE), 2] for rows in flight]
        return (np.array([sum(map(len, down)), sum(float(one.sum()) for one in down)]),)

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[HeightSpec, ...]:
        """The mean of all rows."""
        count, total = np.sum([found for (found,) in summaries], axis=0).tolist()
        if not count:
            raise InputError("no accelerometer")
        return (HeightSpec(mean=total / count),)

    def start(self) -> MeanState:
        """An empty mean."""
        return start_mean(1)

    def step(self, state: MeanState, rows: Rows) -> tuple[MeanState, Statistic]:
        """The mean's distance from the healthy one."""
        block = rows.block
        known = block.valid & block.known(Signal.SPECIFIC_FORCE)
        state, mean, full = sliding_mean(state, block.force[:, 2:], known, 100)
        value = np.abs(mean[:, 0] - self.spec.mean)
        return state, Statistic(block.t_ns, block.dt_s, value, full, value, value)
