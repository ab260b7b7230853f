"""A made flight with every signal a monitor may want: 100 Hz, losses, a break, and rotors that answer the commands."""

from collections.abc import Collection

import numpy as np
from made_telemetry import START_NS, body_rates, series, setpoints
from scipy.signal import lfilter

from mavdiag.airframe.layout import layout_named
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.telemetry import FloatArray, Signal, Telemetry
from mavdiag.units import RPM

DT_S = 0.01
DT_NS = 10_000_000


def flying_front(trim_end_s: float = 0.0) -> Front:
    return Front(AlignSpec(DT_S, Grid.NATIVE), GateSpec(trim_end_s=trim_end_s), RateSpec.of(DT_S, 11))


def flying(
    n: int,
    seed: int,
    *,
    weak_rotor: int = 0,
    rise: float = 0.0,
    shake: float = 0.3,
    turn: FloatArray | None = None,
    layout: str = "x",
    fast_rotor: int = 0,
    faster: float = 0.0,
) -> Telemetry:
    """n samples at 100 Hz of a frame; rotor `weak_rotor` (from 1) is commanded `rise` more of the hover output.

    fast_rotor: turns `faster`, as a share, for its command.
    turn: (n,) yaw rate that the nose turns with besides [rad/s]; drag asks for a yaw trim of 0.02 for each rad/s.
    """
    rng = np.random.default_rng(seed)
    t_ns = START_NS + DT_NS * np.arange(n, dtype=np.int64)
    setpoint = setpoints(n, seed)
    turn = np.zeros(n) if turn is None else turn
    setpoint[:, 2] += DT_S * np.cumsum(turn)
    wanted = body_rates(setpoint)
    rate = np.asarray(lfilter([0.3], [1, -0.7], wanted, axis=0)) + 0.02 * rng.standard_normal((n, 3))
    attitude = np.asarray(lfilter([0.3], [1, -0.7], setpoint, axis=0))
    torque = 0.05 * (wanted - rate) + 0.002 * rng.standard_normal((n, 3))
    torque[:, 2] += 0.02 * turn
    outputs = 0.5 * (1.0 + torque @ layout_named(layout).mixing.T)
    if weak_rotor:
        outputs[:, weak_rotor - 1] += 0.5 * rise
    speeds = np.rint(2e4 * outputs**0.85 * (1.0 + 1e-3 * rng.standard_normal(outputs.shape))) * RPM
    if fast_rotor:
        speeds[:, fast_rotor - 1] *= 1.0 + faster
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
            series(Signal.ROTOR_SPEED, t_ns[::10], speeds[::10]),
            series(Signal.ATTITUDE, t_ns[::2], attitude[::2]),
            series(Signal.VIBRATION, t_ns[::20], vibration[::20]),
            series(Signal.ARMED, t_ns[::100], ones[::100]),
        )
    )


def flying_rows(telemetry: Telemetry) -> list[Rows]:
    front = flying_front()
    state = front.start()
    return [one for one in (*front.step(state, telemetry), *front.finish(state)) if isinstance(one, Rows)]


def without(
    telemetry: Telemetry, *spans_s: tuple[float, float], signals: Collection[Signal] = tuple(Signal)
) -> Telemetry:
    """The same telemetry without these signals in these spans [s] since its start."""
    parts = []
    for one in telemetry.series:
        if one.signal not in signals:
            parts.append(one)
            continue
        at_s = (one.t_ns - START_NS) / 1e9
        keep = np.ones(len(one), dtype=bool)
        for low, high in spans_s:
            keep &= ~((at_s >= low) & (at_s < high))
        parts.append(one.where(keep))
    return Telemetry(tuple(parts))
