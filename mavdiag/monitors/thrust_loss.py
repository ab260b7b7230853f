"""The thrust-loss monitor: thrust that was there a moment ago is gone, and the vehicle falls to one side.

A propeller that leaves takes its share of the lift with it at once. The accelerometer feels less than what the
collective command gave until now, and the airframe turns towards the empty arm before any controller can answer.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.jit import cached
from mavdiag.monitors.base import FaultKind, Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.columns import FORCE, LEVEL, RATE, SIGNAL, SOUND, THRUST, VALID, VALUE, Floats, Ints
from mavdiag.monitors.fitting import of_each
from mavdiag.monitors.spec import Positive, spec
from mavdiag.rows.block import ALL
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, follow, mean_size, push, total
from mavdiag.rows.windows import forgetting, window_rows
from mavdiag.telemetry import FloatArray, Signal
from mavdiag.thresholds.guard import Guard

WINDOW_S = 0.1  # our choice: four time constants of a motor
MEMORY_S = 3.0  # of what the command gives: battery and payload change it more slowly (our choice)
MIN_THRUST = 0.05  # collective command below which nothing flies (our choice)
PER_RAD_S = 0.1  # share of thrust that a rate of 1 rad/s lets count: at 3 rad/s a loss of 0.3 (our choice)
LEAST_SHARE = 0.3  # of the thrust: a quarter, and more as the controller gives up the opposite rotor (our choice)
# Beyond it the accelerometer feels the rotation, and propellers the air from the side (our choice).
TUMBLING_RAD_S = 8.0
CUT = 10.0  # times the healthy specific force per command; more is no flight (our choice)
COLUMNS = 5  # specific force, command, gyro x and y, rate
ONLY_Z = slice(2, 3)  # of the accelerometer
MIN_RATE_HZ = 20.0  # below it an upset is over between two samples (our choice)


@spec
class ThrustLossSpec:
    """Healthy thrust.

    layout: where the rotors are; None if it is not known.
    per_command: healthy mean of the upward specific force per collective command [m/s^2].
    """

    kind: Literal["thrust_loss"] = "thrust_loss"
    layout: RotorLayout | None
    per_command: Positive


# Places in the parameters and in the memory.
WINDOW, PER_COMMAND, ALPHA, LOST = range(4)
USUAL, MEAN = 0, 1


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The missing share at each row."""
    window, per_command, count = int(par[WINDOW]), par[PER_COMMAND], rotors.shape[1]
    for i in range(x.shape[1]):
        up, thrust, turning = -x[FORCE + 2, i], x[THRUST, i], 0.0
        for axis in range(3):
            turning += x[RATE + axis, i] * x[RATE + axis, i]
        known = flags[VALID, i] > 0.5 and math.isfinite(turning) and math.isfinite(up) and thrust > MIN_THRUST
        up, thrust = up if known else per_command, thrust if known else 1.0
        usual = follow(mem, USUAL, min(max(up / (per_command * thrust), 0.0), CUT), par[ALPHA])
        row = MEAN + FRESH
        mem[row], mem[row + 1], mem[row + 2], mem[row + 3] = up, thrust, x[RATE, i], x[RATE + 1, i]
        mem[row + 4] = math.sqrt(turning)
        full = push(mem, MEAN, window, COLUMNS, known)
        mean_up, mean_thrust = total(mem, MEAN, COLUMNS, 0) / window, total(mem, MEAN, COLUMNS, 1) / window
        p, q = total(mem, MEAN, COLUMNS, 2) / window, total(mem, MEAN, COLUMNS, 3) / window
        rate = total(mem, MEAN, COLUMNS, 4) / window
        loss = 1.0 - mean_up / (max(mean_thrust, MIN_THRUST) * per_command * max(usual, 1.0 / CUT))
        value = max(min(loss, PER_RAD_S * rate), 0.0) if rate < TUMBLING_RAD_S else 0.0
        size = math.hypot(p, q)
        for rotor in range(count):
            towards = par[LOST + 2 * rotor] * p + par[LOST + 2 * rotor + 1] * q
            rotors[i, rotor] = towards / size if size > 0.0 else 0.0
        out[VALUE, i], out[SOUND, i], out[LEVEL, i], out[SIGNAL, i], at[i] = value, full, loss, up, i
    return len(at)


class ThrustLoss(Monitor[ThrustLossSpec]):
    """Statistic: share of the thrust that is missing while the vehicle turns [1].

        k = (-f_z)/(per_command T),    loss = 1 - mean_0.1s(-f_z)/(mean_0.1s(T) per_command EMA_3s(k))
        s = max(0, min(loss, 0.1 s |omega|))          T: collective command, omega: gyro, mean of its size over 0.1 s

    A battery, a payload or another pilot change k slowly; a motor that lags a step of the command has the loss for a
    moment but does not turn the vehicle. `level` is the loss, `signal` the specific force upwards [m/s^2]. `rotors`:
    cosine between the mean of p, q and what a loss of rotor j alone turns, -(its roll and pitch effects).

    Warm-up: 0.1 s. Latency: 0.2 s. False alarms: see `thresholds`; the threshold is never less than 0.3. Blind spots:
    a vehicle that tumbles, above 8 rad/s; one of six or more rotors that flies on without one; a weak propeller (see
    rotor_trim); links without collective command or accelerometer.

    >>> from mavdiag.airframe.layout import layout_named
    >>> from mavdiag.testing import example_rows
    >>> force, rate = np.tile([0.0, 0.0, -9.81], (300, 1)), np.zeros((300, 3))
    >>> force[200:, 2], rate[200:, :2] = -5.0, (4.0, 4.0)   # down on the right and up at the nose: rear right
    >>> monitor = ThrustLoss(ThrustLossSpec(layout=layout_named("qdrone2"), per_command=19.62))
    >>> rows = example_rows(300, rate=rate, force=force, thrust=np.full(300, 0.5))
    >>> _, found = monitor.step(monitor.start(), rows)
    >>> float(found.value[150].round(2)), float(found.value[215].round(1)), int(found.rotors[215].argmax()) + 1
    (0.0, 0.5, 1)
    """

    name = "thrust_loss"
    label = "thrust"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.THRUST_SETPOINT})
    kind = FaultKind.GROSS_LOSS
    clear_s = 1.0
    guard = Guard(least=LEAST_SHARE)
    evidence = RotorEvidence(8.0)  # neighbours differ by a cosine of 0.7 and more
    spec_type = ThrustLossSpec
    unit = "share of thrust"
    reach = 1.0  # all of the thrust

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[ThrustLossSpec, ...]:
        """Healthy specific force per command. Raises InputError without accelerometer or collective command."""
        context.need_rate(MIN_RATE_HZ)
        count, total_ = np.sum(of_each(flights, cls.name, _per_command), axis=0).tolist()
        if not total_ > 0:
            raise InputError("no flight with an accelerometer along z and a collective thrust command")
        return (ThrustLossSpec(layout=context.airframe.layout, per_command=total_ / count),)

    def columns(self, signal: Signal) -> slice:
        """Of the accelerometer its z."""
        return ONLY_Z if signal is Signal.SPECIFIC_FORCE else ALL

    def parameters(self, dt_s: float) -> FloatArray:
        """See `LOST`: of each rotor the unit vector of roll and pitch rate that its loss begins."""
        spec = self.spec
        lost = np.empty((0, 2)) if spec.layout is None else -spec.layout.mixing[:, :2]
        sizes = np.linalg.norm(lost, axis=1)
        lost = lost / np.where(sizes > 0, sizes, np.inf)[:, None]
        return np.array([window_rows(WINDOW_S, dt_s), spec.per_command, forgetting(MEMORY_S, dt_s), *lost.ravel()])

    def memory(self, dt_s: float) -> FloatArray:
        """The command gives what it gave in health."""
        mem = np.zeros(MEAN + mean_size(window_rows(WINDOW_S, dt_s), COLUMNS))
        mem[USUAL] = 1.0
        return mem

    run = staticmethod(run)


def _per_command(flight: Sequence[Rows]) -> tuple[float, float]:
    """How many rows tell the specific force per command, and its sum."""
    count, total_ = 0, 0.0
    for block in (rows.block for rows in flight):
        known = block.valid & np.isfinite(block.rate).all(axis=1) & block.known(Signal.SPECIFIC_FORCE, ONLY_Z)
        known = known & (block.thrust > MIN_THRUST)
        count += int(np.count_nonzero(known))
        total_ -= float(np.sum(block.force[known, 2] / block.thrust[known]))
    return float(count), total_
