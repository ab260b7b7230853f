"""Vibration as the autopilot measures it: the VIBRATION message, where the IMU stream itself is low-passed.

ArduPilot makes it before the 20 Hz filter of RAW_IMU; it passes 30-150 Hz at 95 % (METHOD section 4).
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mavdiag.errors import InputError
from mavdiag.jit import cached
from mavdiag.monitors.base import Begin, Flights, LearnContext, Monitor
from mavdiag.monitors.fitting import of_each
from mavdiag.monitors.spec import NotNegative, Span, spec
from mavdiag.rows.block import LEVEL, SOUND, VALID, VALUE, VIBRATION, Floats, Ints
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import window_rows
from mavdiag.telemetry import Signal

WINDOW_S = 5.0  # our choice; 3.5 to 6.5 s change no verdict on the recorded flights
LIMIT_M_S2 = 1e4  # a value is cut here: more is damage, not vibration (our choice)


@spec
class VibrationLevelSpec:
    """Healthy vibration. healthy: mean level [m/s^2]. window_s: length of the mean [s]."""

    kind: Literal["vibration_level"] = "vibration_level"
    healthy: NotNegative
    window_s: Span = WINDOW_S


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The mean level at each row. par: rows of the window, healthy level."""
    window, healthy = int(par[0]), par[1]
    for i in range(first, x.shape[1]):
        k, squares, good = i - first, 0.0, x[VALID, i] > 0.5
        for axis in range(3):
            part = x[VIBRATION + axis, i]
            good = good and math.isfinite(part)
            part = min(max(part, -LIMIT_M_S2), LIMIT_M_S2)
            squares += part * part
        mem[FRESH] = math.sqrt(squares)
        full = push(mem, 0, window, 1, good)
        mean = total(mem, 0, 1, 0) / window
        out[VALUE, k], out[SOUND, k], out[LEVEL, k], at[k] = mean, full, mean - healthy, k
    return len(at)


class VibrationLevel(Monitor[VibrationLevelSpec]):
    """Statistic: the 5 s mean of |VIBRATION|, of its x, y and z [m/s^2]; `level` is the rise over the healthy one.

    Warm-up: 5 s of unbroken valid flight. Latency: up to 5 s. False alarms: wind, landing gear contact and loose
    mounts. Blind spots: a propeller that lost thrust but kept its balance; clipped accelerometers.
    """

    name = "vibration_level"
    label = "vibration"
    observes = "the autopilot's own vibration level"
    phrase = "vibrates {times}x"
    needs = frozenset({Signal.VIBRATION})
    depends = frozenset({Condition.THROTTLE, Condition.HEIGHT})
    spec_type = VibrationLevelSpec
    unit = "m/s^2"
    reach = LIMIT_M_S2
    run = staticmethod(run)

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[VibrationLevelSpec, ...]:
        """Healthy mean level. Raises InputError if the vehicle sends no VIBRATION, or one of another meaning (PX4)."""
        count, total_ = np.sum(of_each(flights, cls.name, _levels), axis=0).tolist()
        if not count:
            raise InputError("the vehicle sends no VIBRATION message with acceleration per axis")
        return (VibrationLevelSpec(healthy=total_ / count),)

    def renewed(self, flights: Flights, context: LearnContext) -> tuple[VibrationLevelSpec, float]:
        """The level of the new propellers."""
        (new,) = self.fit(flights, context)
        return new, new.healthy / self.spec.healthy if self.spec.healthy else 1.0

    def begin(self, dt_s: float) -> Begin:
        """An empty mean."""
        window = window_rows(self.spec.window_s, dt_s)
        return Begin(np.array([window, self.spec.healthy]), np.zeros(mean_size(window, 1)))


def _levels(flight: Sequence[Rows]) -> tuple[float, float]:
    count, total = 0, 0.0
    for block in (rows.block for rows in flight):
        sizes = np.linalg.norm(block.vibration[block.valid & block.known(Signal.VIBRATION)], axis=1)
        count, total = count + len(sizes), total + float(sizes.sum())
    return float(count), total
