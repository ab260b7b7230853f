"""A first look at a log without a baseline: what it shows, and what is missing for a verdict.

It never says that a vehicle is well: without a baseline there is nothing that could show it.
"""

import math
from dataclasses import dataclass

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.learning.guards import upsets
from mavdiag.link.profiles import PROFILES
from mavdiag.look.figures import (
    OutputLoad,
    RotorLine,
    Trim,
    Vibration,
    motors_of,
    output_loads,
    rotor_line,
    told_hz,
    trim,
    vibration,
)
from mavdiag.look.inspection import MonitorState, Summary, Units, monitor_states, rotors_of, summary, units_of
from mavdiag.telemetry import FloatArray, Log, Signal
from mavdiag.units import NS_PER_S

__all__ = ["FirstLook", "first_look"]

GAP_S = 0.035  # of the gyro: a longer one is not interpolated (METHOD section 4)


@dataclass(frozen=True, slots=True)
class FirstLook:
    """What one log shows by itself.

    log: its name. profile: its link or kind. span_s: from its first to its last sample.
    flight_s: valid time in flight; 0 if none. no_flight: why there is none; empty if there is.
    upset: when and how it fell or tumbled, one sentence; empty if it did not.
    signals: what it carries.
    gyro_gaps, lost_s: gaps of the gyro longer than 35 ms, and their time in all.
    rotors: what is known of the rotors' layout, one sentence.
    loads, trim: of the motors; empty or None where outputs and torque commands are missing.
    vibration: by the autopilot's own message; None without it.
    line: the rotors' line in the accelerometer; None without flight.
    monitors: which could work with such logs, and what is missing for the others.
    """

    log: str
    profile: str
    span_s: float
    flight_s: float
    no_flight: str
    upset: str
    notes: tuple[str, ...]
    signals: tuple[Summary, ...]
    gyro_gaps: int
    lost_s: float
    units: Units
    rotors: str
    loads: tuple[OutputLoad, ...]
    trim: Trim | None
    vibration: Vibration | None
    line: RotorLine | None
    monitors: tuple[MonitorState, ...]

    @property
    def works(self) -> tuple[str, ...]:
        """The monitors that such logs carry enough for."""
        return tuple(one.monitor for one in self.monitors if one.works)


def first_look(log: Log, told: Airframe) -> FirstLook:
    """Look at a log. told: what is known of its vehicle; `Airframe()` for nothing."""
    airframe, learnt, no_flight = rotors_of(log, told)
    signals = tuple(summary(series) for series in log.telemetry.series if len(series))
    flight, gaps = () if learnt is None else learnt.rows, _gyro_gaps(log)
    motors = range(airframe.layout.rotors) if airframe.layout is not None else motors_of(flight)
    profile = PROFILES.get(log.profile)
    corner_hz = airframe.imu_corner_hz if profile is None else profile.corner_hz(log.parameters)
    speeds = told_hz(log.telemetry)
    return FirstLook(
        log=log.name,
        profile=log.profile,
        span_s=_span_s(log),
        flight_s=sum(float(np.count_nonzero(one.block.valid)) * one.block.dt_s for one in flight),
        no_flight=no_flight,
        upset="" if learnt is None else "; ".join(one.text for one in upsets([learnt])),
        notes=log.notes,
        signals=signals,
        gyro_gaps=len(gaps),
        lost_s=float(sum(gaps)),
        units=units_of(log),
        rotors=airframe.layout_statement,
        loads=output_loads(flight, motors),
        trim=None if airframe.layout is None else trim(flight, airframe.layout),
        vibration=vibration(flight),
        line=rotor_line(flight, corner_hz, speeds) if flight else None,
        monitors=monitor_states(log, signals, airframe),
    )


def _gyro_gaps(log: Log) -> list[float]:
    """The gaps of the gyro that are too long to be interpolated [s]."""
    gyro = log.telemetry.get(Signal.BODY_RATE)
    if gyro is None or len(gyro) < 2:
        return []
    steps: FloatArray = np.diff(np.unique(gyro.t_ns)).astype(np.float64) / NS_PER_S
    longest = max(GAP_S, 1.5 * float(np.median(steps)))
    return [float(step) for step in steps[steps > longest]]


def _span_s(log: Log) -> float:
    ends = [(int(one.t_ns.min()), int(one.t_ns.max())) for one in log.telemetry.series if len(one)]
    return (max(last for _, last in ends) - min(first for first, _ in ends)) / NS_PER_S if ends else math.nan
