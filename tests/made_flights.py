"""A flight at 100 Hz with all that may go wrong."""

import numpy as np
from flying_telemetry import DT_NS, flying, without
from made_telemetry import START_NS

from mavdiag.telemetry import Series, Signal, Telemetry

N = 4600


def hard_flight(seed: int) -> Telemetry:
    """Losses, swapped samples, a short gap, a break, signals that stop for a while, and faults.

    Rotor 2 is weak from 8 to 16 s, the gyro shakes from 18 to 20 s, a landing is at 22 s, vibration is up from 30 to
    38 s, rotor 3 is weak from 38 s on.
    """
    rng = np.random.default_rng(seed)
    healthy = flying(N, seed)
    s = DT_NS * np.arange(N) / 1e9
    parts = []
    for one in healthy.series:
        values, at_s = one.values.copy(), (one.t_ns - START_NS) / 1e9
        if one.signal is Signal.ACTUATOR:
            values[(at_s >= 8) & (at_s < 16), 1] += 0.1
            values[at_s >= 38, 2] += 0.1
        if one.signal is Signal.VIBRATION:
            values[(at_s >= 30) & (at_s < 38)] *= 1.75
        if one.signal is Signal.BODY_RATE:
            values[(s >= 18) & (s < 20)] += rng.normal(0, 0.3, (200, 3))
        if one.signal is Signal.ARMED:
            values[(at_s >= 22) & (at_s < 24)] = 0
        keep = (rng.random(len(one)) > 0.02) | (one.signal is Signal.ARMED)
        at = np.flatnonzero(keep)
        for i in rng.integers(0, len(at) - 1, 5):
            if len(one) == N:
                at[[i, i + 1]] = at[[i + 1, i]]
        parts.append(Series(one.signal, one.t_ns[at], np.sort(one.host_ns[at]), values[at]))
    rough = without(Telemetry(tuple(parts)), (5.0, 5.08), (29.0, 30.6))
    rough = without(rough, (12.0, 15.0), signals=(Signal.VIBRATION, Signal.SPECIFIC_FORCE))
    rough = without(rough, (13.0, 15.5), (44.0, 60.0), signals=(Signal.ACTUATOR,))
    return without(rough, (19.0, 19.5), (26.0, 28.5), signals=(Signal.ATTITUDE_SETPOINT,))
