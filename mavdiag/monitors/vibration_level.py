"""Vibration as the autopilot measures it: the VIBRATION message, where the IMU stream itself is low-passed.

ArduPilot filters RAW_IMU at 20 Hz, so a rotor's unbalance (100-200 Hz) is gone from it. Its VIBRATION message is made
before that filter and passes 30-150 Hz at 95 % (METHOD section 4).
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.jit import cached
from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.monitors.columns import LEVEL, SIGNAL, SOUND, VALID, VALUE, VIBRATION, Floats, Ints
from mavdiag.monitors.fitting import of_each
from mavdiag.monitors.spec import NotNegative, Positive, spec
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import window_rows
from mavdiag.telemetry import FloatArray, Signal
from mavdiag.thresholds.rule import Prior

WINDOW_S = 5.0  # our choice; 3.5 to 6.5 s change no verdict on the recorded flights
LIMIT_M_S2 = 1e4  # a value is cut here: more is damage, not vibration (our choice)


@spec
class VibrationLevelSpec:
    """Healthy vibration.

    healthy: mean level [m/s^2].
    window_s: length of the mean [s].
    """

    kind: Literal["vibration_level"] = "vibration_level"
    healthy: NotNegative
    window_s: Positive = WINDOW_S


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The mean level at each row."""
    window, healthy = int(par[0]), par[1]
    for i in range(x.shape[1]):
        squares, known = 0.0, flags[VALID, i] > 0.5
        for axis in range(3):
            part = x[VIBRATION + axis, i]
            known = known and math.isfinite(part)
            part = min(max(part, -LIMIT_M_S2), LIMIT_M_S2)
            squares += part * part
        size = math.sqrt(squares) if known else 0.0
        mem[FRESH] = size
        full = push(mem, 0, window, 1, known)
        out[VALUE, i] = total(mem, 0, 1, 0) / window
        out[SOUND, i], out[LEVEL, i], out[SIGNAL, i], at[i] = full, out[VALUE, i] - healthy, size, i
    return len(at)


class VibrationLevel(Monitor[VibrationLevelSpec]):
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
    prior = Prior(0.15, 0.1, 0.05, shares=False)  # [m/s^2] (our choice)
    spec_type = VibrationLevelSpec
    unit = "m/s^2"
    reach = LIMIT_M_S2  # where a value is cut [m/s^2]

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[VibrationLevelSpec, ...]:
        """Healthy mean level. Raises InputError if the vehicle sends no VIBRATION in flight.

        A profile whose message means something else (PX4's) gives no such signal.
        """
        count, total_ = np.sum(of_each(flights, cls.name, _levels), axis=0).tolist()
        if not count:
            raise InputError("the vehicle sends no VIBRATION message with acceleration per axis")
        return (VibrationLevelSpec(healthy=total_ / count),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[VibrationLevelSpec, float]:
        """The level of the new propellers."""
        (new,) = self.fit(flights, context)
        return new, new.healthy / self.spec.healthy if self.spec.healthy else 1.0

    @property
    def memory_s(self) -> float:
        """Its window [s]."""
        return self.spec.window_s

    def parameters(self, dt_s: float) -> FloatArray:
        """Rows of the window, healthy level."""
        return np.array([window_rows(self.spec.window_s, dt_s), self.spec.healthy])

    def memory(self, dt_s: float) -> FloatArray:
        """An empty mean."""
        return np.zeros(mean_size(window_rows(self.spec.window_s, dt_s), 1))

    run = staticmethod(run)


def _levels(flight: Sequence[Rows]) -> tuple[float, float]:
    """How many rows have a level, and the sum of their levels."""
    blocks = [rows.block for rows in flight]
    known = [block.valid & block.known(Signal.VIBRATION) for block in blocks]
    sizes = [np.linalg.norm(block.vibration[where], axis=1) for block, where in zip(blocks, known, strict=True)]
    return float(sum(map(len, sizes))), sum(float(size.sum()) for size in sizes)
