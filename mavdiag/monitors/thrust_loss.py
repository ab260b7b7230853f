"""The thrust-loss monitor: thrust that was there a moment ago is gone, and the vehicle falls to one side."""

import math
from collections.abc import Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import ALONG_Z
from mavdiag.errors import InputError
from mavdiag.jit import cached
from mavdiag.monitors.base import Begin, FaultKind, Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.fitting import of_each
from mavdiag.monitors.spec import Positive, spec
from mavdiag.rows.block import FORCE, LEVEL, RATE, SOUND, THRUST, VALID, VALUE, Floats, Ints
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, follow, mean_size, push, total
from mavdiag.rows.windows import forgetting, window_rows
from mavdiag.telemetry import Signal

WINDOW_S = 0.1  # our choice: four time constants of a motor
MEMORY_S = 3.0  # of what the command gives: battery and payload change it more slowly (our choice)
MIN_THRUST = 0.05  # collective command below which nothing flies (our choice)
PER_RAD_S = 0.1  # share of thrust that a rate of 1 rad/s lets count: at 3 rad/s a loss of 0.3 (our choice)
LEAST_SHARE = 0.3  # of the thrust: a quarter, and more as the controller gives up the opposite rotor (our choice)
# Beyond it the accelerometer feels the rotation, and propellers the air from the side (our choice).
TUMBLING_RAD_S = 8.0
CUT = 10.0  # times the healthy specific force per command; more is no flight (our choice)
COLUMNS = 5  # specific force, command, gyro x and y, rate
# Places in the parameters, where of each rotor the unit vector of roll and pitch rate follows that its loss begins; and
# in the memory.
WINDOW, PER_COMMAND, ALPHA, LOST = range(4)
USUAL, MEAN = 0, 1


@spec
class ThrustLossSpec:
    """Healthy thrust."""

    kind: Literal["thrust_loss"] = "thrust_loss"
    layout: RotorLayout | None  # None if it is not known
    per_command: Positive  # mean of the upward specific force per collective command [m/s^2]


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The missing share at each row."""
    window, per_command, row = int(par[WINDOW]), par[PER_COMMAND], MEAN + FRESH
    share = 1.0 / window
    for i in range(first, x.shape[1]):
        k, up, thrust, p, q, r = i - first, -x[FORCE + 2, i], x[THRUST, i], x[RATE, i], x[RATE + 1, i], x[RATE + 2, i]
        turning = p * p + q * q + r * r
        good = x[VALID, i] > 0.5 and math.isfinite(turning) and math.isfinite(up) and thrust > MIN_THRUST
        up, thrust = up if good else per_command, thrust if good else 1.0
        usual = follow(mem, USUAL, min(max(up / (per_command * thrust), 0.0), CUT), par[ALPHA])
        mem[row], mem[row + 1], mem[row + 2], mem[row + 3], mem[row + 4] = up, thrust, p, q, math.sqrt(turning)
        out[SOUND, k], at[k] = push(mem, MEAN, window, COLUMNS, good), k
        mean_up, mean_thrust = share * total(mem, MEAN, COLUMNS, 0), share * total(mem, MEAN, COLUMNS, 1)
        p, q, rate = total(mem, MEAN, COLUMNS, 2), total(mem, MEAN, COLUMNS, 3), share * total(mem, MEAN, COLUMNS, 4)
        loss = 1.0 - mean_up / (max(mean_thrust, MIN_THRUST) * per_command * max(usual, 1.0 / CUT))
        value = max(min(loss, PER_RAD_S * rate), 0.0) if rate < TUMBLING_RAD_S else 0.0
        size = math.sqrt(p * p + q * q)
        p, q = (p / size, q / size) if size > 0.0 else (0.0, 0.0)
        for rotor in range(rotors.shape[1]):
            rotors[k, rotor] = par[LOST + 2 * rotor] * p + par[LOST + 2 * rotor + 1] * q
        out[VALUE, k], out[LEVEL, k] = value, loss
    return len(at)


class ThrustLoss(Monitor[ThrustLossSpec]):
    """Statistic: share of the thrust that is missing while the vehicle turns [1].

        k = (-f_z)/(per_command T),    loss = 1 - mean_0.1s(-f_z)/(mean_0.1s(T) per_command EMA_3s(k))
        s = max(0, min(loss, 0.1 s |omega|))          T: collective command, omega: gyro, mean of its size over 0.1 s

    A battery, a payload or another pilot change k slowly; a motor that lags a step of the command does not turn the
    vehicle. `level` is the loss. `rotors`: cosine between the mean of p, q and what a loss of rotor j alone turns.

    Warm-up: 0.1 s. Latency: 0.2 s. False alarms: a loss of less than 0.3 is never one. Blind spots: a vehicle that
    tumbles, above 8 rad/s; one of six or more rotors that flies on without one; a weak propeller (see rotor_trim).
    """

    name = "thrust_loss"
    label = "thrust"
    observes = "thrust that is missing while the vehicle turns"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.THRUST_SETPOINT})
    kind = FaultKind.GROSS_LOSS
    clear_s = 1.0
    least = LEAST_SHARE
    evidence = RotorEvidence(8.0)  # neighbours differ by a cosine of 0.7 and more
    least_hz = 20.0  # below it an upset is over between two samples (our choice)
    spec_type = ThrustLossSpec
    unit = "share of thrust"
    reach = 1.0  # all of the thrust
    takes = MappingProxyType({Signal.SPECIFIC_FORCE: ALONG_Z})
    run = staticmethod(run)

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[ThrustLossSpec, ...]:
        """Healthy specific force per command. Raises InputError without accelerometer or collective command."""
        count, total_ = np.sum(of_each(flights, cls.name, _per_command), axis=0).tolist()
        if not total_ > 0:
            raise InputError("no flight with an accelerometer along z and a collective thrust command")
        return (ThrustLossSpec(layout=context.airframe.layout, per_command=total_ / count),)

    def begin(self, dt_s: float) -> Begin:
        """The command gives what it gave in health."""
        spec, window = self.spec, window_rows(WINDOW_S, dt_s)
        lost = np.empty((0, 2)) if spec.layout is None else -spec.layout.mixing[:, :2]
        sizes = np.linalg.norm(lost, axis=1)
        lost = lost / np.where(sizes > 0, sizes, np.inf)[:, None]
        par = np.array([window, spec.per_command, forgetting(MEMORY_S, dt_s), *lost.ravel()])
        return Begin(par, np.array([1.0, *np.zeros(mean_size(window, COLUMNS))]))


def _per_command(flight: Sequence[Rows]) -> tuple[float, float]:
    count, total_ = 0, 0.0
    for block in (rows.block for rows in flight):
        known = block.valid & np.isfinite(block.rate).all(axis=1) & block.known(Signal.SPECIFIC_FORCE, ALONG_Z)
        known = known & (block.thrust > MIN_THRUST)
        count += int(np.count_nonzero(known))
        total_ -= float(np.sum(block.force[known, 2] / block.thrust[known]))
    return float(count), total_
