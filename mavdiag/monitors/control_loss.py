"""The control-loss monitor: the vehicle turns fast, and nobody commanded it."""

import math
from typing import Literal

import numpy as np

from mavdiag.jit import cached
from mavdiag.monitors.base import Begin, FaultKind, Flights, LearnContext, Monitor
from mavdiag.monitors.fitting import need_commanded
from mavdiag.monitors.spec import Delay, spec
from mavdiag.rows.block import COMMANDED, LEVEL, SOUND, VALUE, Floats, Ints, U, Y
from mavdiag.telemetry import Signal

LEAST_RAD_S = 7.0  # 400 deg/s beyond the command; emulated flights whose position jumps reach 5.7 (our choice)


@spec
class ControlLossSpec:
    """delay_s: half the window of the rate filters [s]."""

    kind: Literal["control_loss"] = "control_loss"
    delay_s: Delay = 0.0


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The rate without a command at each row whose rates became known."""
    for i in range(known, x.shape[1]):
        k, fast, left = i - known, 0.0, 0.0
        for axis in range(3):
            y, apart = x[Y + axis, i], x[Y + axis, i] - x[U + axis, i]
            fast, left = fast + y * y, left + apart * apart
        sound = x[COMMANDED, i] > 0.5 and math.isfinite(fast + left)
        out[VALUE, k] = out[LEVEL, k] = math.sqrt(min(fast, left)) if sound else 0.0
        out[SOUND, k], at[k] = sound, k
    return len(at) - (known - first)


class ControlLoss(Monitor[ControlLossSpec]):
    """Statistic: how fast the body turns without a command [rad/s].

        s = min(|y|, |y - u|)          y: smoothed gyro, u: commanded body rate, as the model relates them

    A set-point that jumps makes |y - u| large, and a commanded flip |y|; only an upset makes both large. Above half its
    threshold no rotor is named any longer: the other monitors are about the upset then, and not about its cause.

    Warm-up: one SG window, and the blanked first second of a segment. Latency: half an SG window (50 ms), plus the
    time to reach the rate: 0.2 s after a quadrotor lost a propeller. False alarms: hard landings and catches that the
    gate does not keep out. Blind spots: a loss of control that is slow, such as a fall without turning.
    """

    name = "control_loss"
    label = "control"
    observes = "a body rate that nobody commanded"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT})
    kind = FaultKind.LOSS_OF_CONTROL
    clear_s = 1.0
    least = LEAST_RAD_S
    by_rates = True
    least_hz = 20.0  # below it an upset is over between two samples (our choice)
    spec_type = ControlLossSpec
    unit = "rad/s"
    run = staticmethod(run)

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[ControlLossSpec, ...]:
        """Nothing is fitted; the healthy flights set the threshold. Raises InputError without gyro or set-point."""
        need_commanded(flights)
        return (ControlLossSpec(delay_s=context.delay_s),)

    def begin(self, dt_s: float) -> Begin:
        """Nothing is remembered."""
        return Begin(np.empty(0), np.empty(0))
