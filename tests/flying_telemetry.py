"""A made flight with every signal a monitor may want: 100 Hz, losses, a break, and rotors that answer the commands."""

import numpy as np
from made_telemetry import series, setpoints
from scipy.signal import lfilter

from mavdiag.airframe.layout import layout_named
from mavdiag.chain import Front
from mavdiag.monitors.base import Rows
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import Series, Signal, Telemetry

DT_S = 0.01
DT_NS = 10_000_000
START_NS = 1_000_000_000


def flying_front(trim_end_s: float = 0.0) -> Front:
    """A front for these flights."""
    return Front(AlignSpec(DT_S, Grid.NATIVE), GateSpec(trim_end_s=trim_end_s), RateSpec.of(DT_S, 11))


def flying(n: int, seed: int, *, weak_rotor: int = 0, rise: float = 0.0, shake: float = 0.3) -> Telemetry:
    """n samples at 100 Hz of an X frame; rotor `weak_rotor` (from 1) is commanded `rise` more of the hover output."""
    rng = np.random.default_rng(seed)
    t_ns = START_NS + DT_NS * np.arange(n, dtype=np.int64)
    setpoint = setpoints(n, seed)
    wanted = np.gradient(setpoint, DT_S, axis=0)
    rate = np.asarray(lfilter([0.3], [1, -0.7], wanted, axis=0)) + 0.02 * rng.standard_normal((n, 3))
    torque = 0.05 * (wanted - rate) + 0.002 * rng.standard_normal((n, 3))
    outputs = 0.5 * (1.0 + torque @ layout_named("x").mixing.T)
    if weak_rotor:
        outputs[:, weak_rotor - 1] += 0.5 * rise
    force = rng.normal([0.0, 0.0, -9.81], 0.3, (n, 3))
    vibration = np.abs(rng.normal(shake, 0.05, (n, 3)))
    ones = np.ones((n, 1))
    return Telemetry(
        (
            series(Signal.ATTITUDE_SETPOINT, t_ns, setpoint),
            series(Signal.BODY_RATE, t_ns, rate),
            series(Signal.SPECIFIC_FORCE, t_ns, force),
            series(Signal.TORQUE_COMMAND, t_ns, torque),
            series(Signal.THRUST_SETPOINT, t_ns, 0.5 * ones),
            series(Signal.ACTUATOR, t_ns[::2], outputs[::2]),
            series(Signal.VIBRATION, t_ns[::20], vibration[::20]),
            series(Signal.ARMED, t_ns[::100], ones[::100]),
        )
    )


def flying_rows(telemetry: Telemetry) -> list[Rows]:
    """All rows of a whole flight."""
    front = flying_front()
    state, rows = front.step(front.start(), telemetry)
    return [*rows, *front.finish(state)[1]]


def without(telemetry: Telemetry, *spans_s: tuple[float, float]) -> Telemetry:
    """The same telemetry with nothing heard in these spans [s] since its start."""
    parts = []
    for one in telemetry.series:
        at_s = (one.t_ns - START_NS) / 1e9
        keep = np.ones(len(one), dtype=bool)
        for low, high in spans_s:
            keep &= ~((at_s >= low) & (at_s < high))
        parts.append(Series(one.signal, one.t_ns[keep], one.host_ns[keep], one.values[keep]))
    return Telemetry(tuple(parts))
