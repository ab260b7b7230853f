"""Healthy flights before anything is learnt: the link they came over, and their airborne rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavdiag.chain import Front
from mavdiag.errors import InputError
from mavdiag.monitors.base import Rows
from mavdiag.rows.align import AlignSpec, Grid, measure_grid
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import window_samples
from mavdiag.telemetry import NS_PER_S, Signal, Telemetry

__all__ = ["Flight", "LearntFlight", "airborne", "check_signals", "front_for", "gate_for", "rows_of"]

MIN_FLIGHT_S = 2.0  # less airborne flight than this teaches nothing (our choice)
MAX_GAP_S = 0.035  # METHOD section 4: gaps up to 35 ms may be interpolated
SLOW_SETPOINT_PERIODS = 2.5  # a set-point stream slower than the gyro has gaps by nature (our choice)

# Airborne limits by log profile. A Crazyflie's log has no arming state; its limits are those that its recordings were
# found to need (height 0.38 m, thrust 25000 of 65535, 0.5 s and 0.6 s off the ends). Logs of the big autopilots have
# both ends of a flight in them; a live link must not wait for the end, so its gate has no trim there. Our choices.
_RECORDED = GateSpec(min_thrust=0.1, need_armed=True, trim_start_s=1.0, trim_end_s=0.6)
_GATES = {
    "crazyflie": GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    "ardupilot-log": _RECORDED,
    "px4-log": _RECORDED,
}
_MAVLINK_GATE = GateSpec(min_thrust=0.1, need_armed=True)  # our choice: armed, and more than idle thrust


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """One healthy flight. sha256: of the file it came from, or of its bytes on the wire."""

    name: str
    sha256: str
    profile: str
    telemetry: Telemetry


@dataclass(frozen=True, slots=True, eq=False)
class LearntFlight:
    """A flight's rows of healthy flying, in order, and how long of them may be judged [s]."""

    flight: Flight
    rows: tuple[Rows, ...]
    judged_s: float


def gate_for(profile: str) -> GateSpec:
    """What counts as flying on a link of this profile."""
    return _GATES.get(profile, _MAVLINK_GATE)


def front_for(flights: Sequence[Flight], window_s: float) -> Front:
    """The front that suits all the flights. Raises InputError if they do not belong to one kind of link."""
    profiles = sorted({flight.profile for flight in flights})
    if len(profiles) != 1:
        raise InputError(f"the flights come over different links ({', '.join(profiles)}); learn from one kind")
    measured = [measure_grid(flight.telemetry) for flight in flights]
    periods = np.array([dt_s for dt_s, _ in measured])
    dt_s = float(np.median(periods))
    if np.any(np.abs(periods / dt_s - 1) > 0.02):
        slow, fast = 1 / periods.max(), 1 / periods.min()
        raise InputError(f"the flights have different gyro rates ({slow:.1f} to {fast:.1f} Hz); learn from one rate")
    grid = Grid.NATIVE if all(grid is Grid.NATIVE for _, grid in measured) else Grid.RESAMPLED
    align = AlignSpec(dt_s, grid, max_gap_s=_gap_limit(flights))
    return Front(align, gate_for(profiles[0]), RateSpec.of(dt_s, window_samples(dt_s, window_s)))


def rows_of(front: Front, telemetry: Telemetry) -> tuple[Rows, ...]:
    """All rows of a whole flight."""
    state, rows = front.step(front.start(), telemetry)
    _, rest = front.finish(state)
    return (*rows, *rest)


def check_signals(flight: Flight) -> None:
    """Raise InputError, naming the flight, if it lacks a signal that nothing can be done without."""
    for signal in (Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT):
        try:
            flight.telemetry.need(signal)
        except InputError as error:
            raise InputError(f"{flight.name}: {error}") from error


def _gap_limit(flights: Sequence[Flight]) -> float:
    """35 ms, or a few periods of a set-point stream that is slower than that."""
    steps = [np.diff(np.unique(flight.telemetry.need(Signal.ATTITUDE_SETPOINT).t_ns)) for flight in flights]
    period_s = float(np.median(np.concatenate(steps))) / NS_PER_S if any(len(s) for s in steps) else 0.0
    return max(MAX_GAP_S, SLOW_SETPOINT_PERIODS * period_s)


def airborne(front: Front, flight: Flight) -> LearntFlight:
    """The flying part of a flight. Raises InputError if it is under a second."""
    rows = rows_of(front, flight.telemetry)
    judged_s = float(sum(int(one.rates.valid.sum()) for one in rows)) * front.align.dt_s
    if judged_s < MIN_FLIGHT_S:
        raise InputError(f"{flight.name}: only {judged_s:.1f} s of airborne flight, too short to learn from")
    return LearntFlight(flight, rows, judged_s)
