"""Vibration as the autopilot measures it: the VIBRATION message, where the IMU stream itself is low-passed.

ArduPilot filters RAW_IMU at 20 Hz, so a rotor's unbalance (100-200 Hz) is gone from it. Its VIBRATION message is made
before that filter and passes 30-150 Hz at 95 % (METHOD section 4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.monitors.base import Flights, LearnContext, Monitor, Summaries, Summary
from mavdiag.rows.block import Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import MeanState, sliding_mean, start_mean, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, Signal
from mavdiag.thresholds.guard import Guard

__all__ = ["VibrationLevel", "VibrationLevelSpec"]

WINDOW_S = 5.0  # our choice; 3.5 to 6.5 s change no verdict on the recorded flights
LIMIT_M_S2 = 1e4  # a value is cut here: more is damage, not vibration (our choice)


@dataclass(frozen=True, slots=True, kw_only=True)
class VibrationLevelSpec:
    """Healthy vibration.

    healthy: mean level [m/s^2].
    window_s: length of the mean [s].
    Raises InputError if they are not finite or negative.
    """

    kind: Literal["vibration_level"] = "vibration_level"
    healthy: float
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        if not (math.isfinite(self.healthy) and self.healthy >= 0 and self.window_s > 0):
            raise InputError("vibration_level: the healthy level and the window must be finite and not negative")


class VibrationLevel(Monitor[VibrationLevelSpec, MeanState]):
    """Statistic: the 5 s mean of |VIBRATION|, the norm of its x, y and z [m/s^2].

    The message comes a few times a second; its last value holds between, and no longer than the rows allow it.
    `level` is the rise over the healthy mean, `signal` the latest value. It knows nothing of rotors.

    Warm-up: 5 s of unbroken valid flight. Latency: up to 5 s. False alarms: see `thresholds`; the threshold is never
    less than 0.5 m/s^2 above the mean healthy maximum. Blind spots: a propeller that lost thrust but kept its balance;
    clipped accelerometers. Wind, landing gear contact and loose mounts raise it.

    >>> from mavdiag.testing import example_rows
    >>> shaking = np.abs(np.random.default_rng(1).normal(0.0, [0.6, 0.6, 2.0], (1000, 3)))
    >>> monitor = VibrationLevel(VibrationLevelSpec(healthy=0.4))
    >>> _, found = monitor.step(monitor.start(), example_rows(1000, 0.01, vibration=shaking))
    >>> float(found.value[-1].round(1)), found.valid[[498, 499]].tolist()
    (1.9, [False, True])
    """

    name = "vibration_level"
    label = "vibration"
    phrase = "vibrates {times}x"
    needs = frozenset({Signal.VIBRATION})
    depends = frozenset({Condition.THROTTLE, Condition.HEIGHT})
    # An estimate: a vehicle in a simulator or on a calm day hardly vibrates, so 0.5 m/s^2 more is asked for at least.
    guard = Guard(above_mean=0.5)
    spec_type = VibrationLevelSpec
    unit = "m/s^2"

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """How many rows have a level, and the sum of their levels."""
        sizes = [np.linalg.norm(rows.block.vibration[_known(rows.block)], axis=1) for rows in flight]
        return (np.array([sum(map(len, sizes)), sum(float(one.sum()) for one in sizes)]),)

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[VibrationLevelSpec, ...]:
        """Healthy mean level. Raises InputError if the vehicle sends no VIBRATION in flight.

        A profile whose message means something else (PX4's) gives no such signal.
        """
        count, total = np.sum([found for (found,) in summaries], axis=0).tolist()
        if not count:
            raise InputError("the vehicle sends no VIBRATION message with acceleration per axis")
        return (VibrationLevelSpec(healthy=total / count),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[VibrationLevelSpec, float]:
        """The level of the new propellers."""
        (new,) = self.fit(flights, context)
        return new, new.healthy / self.spec.healthy if self.spec.healthy else 1.0

    @property
    def memory_s(self) -> float:
        """Its window [s]."""
        return self.spec.window_s

    @property
    def reach(self) -> float:
        """Where a value is cut [m/s^2]."""
        return LIMIT_M_S2

    def start(self) -> MeanState:
        """An empty mean."""
        return start_mean(1)

    def step(self, state: MeanState, rows: Rows) -> tuple[MeanState, Statistic]:
        """The mean level at each of the next rows."""
        block = rows.block
        known = _known(block)
        shaking = block.vibration if np.count_nonzero(known) == len(known) else _zeroed(block.vibration, known)
        shaking = np.minimum(np.maximum(shaking, -LIMIT_M_S2), LIMIT_M_S2)
        size = np.sqrt(np.einsum("nk,nk->n", shaking, shaking))
        state, mean, full = sliding_mean(state, size[:, None], known, window_rows(self.spec.window_s, block.dt_s))
        value = mean[:, 0]
        return state, Statistic(block.t_ns, block.dt_s, value, full, value - self.spec.healthy, size)


def _zeroed(values: FloatArray, known: BoolArray) -> FloatArray:
    return np.where(known, values.T, 0.0).T


def _known(block: Block) -> BoolArray:
    return block.known(Signal.BODY_RATE) & block.known(Signal.VIBRATION)
