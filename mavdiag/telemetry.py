"""The values that cross module boundaries: one time type, one telemetry shape, array aliases.

Everything here is in SI units and in the body frame FRD (x forward, y right, z down). Bytes become these values in
`mavdiag.link.samples` and in the readers of `mavdiag.logs`, and nowhere else.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.errors import InputError

__all__ = ["Axis", "BoolArray", "FloatArray", "Instant", "IntArray", "Series", "Signal", "Telemetry"]

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, order=True)
class Instant:
    """A point in time, in nanoseconds of one clock. Spans are plain float seconds.

    >>> Instant(2_000_000_000) - Instant(500_000_000)
    1.5
    >>> Instant(0) + 0.25
    Instant(ns=250000000)
    """

    ns: int

    def __add__(self, span_s: float) -> "Instant":
        return Instant(self.ns + round(span_s * NS_PER_S))

    def __sub__(self, earlier: "Instant") -> float:
        return (self.ns - earlier.ns) / NS_PER_S


class Axis(StrEnum):
    """A body axis, by the name of the rotation about it. Its value indexes nothing: use `Axis.column`."""

    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"

    @property
    def column(self) -> int:
        """Column of this axis in an (n, 3) array of angles or rates."""
        return ("roll", "pitch", "yaw").index(self.value)


class Signal(StrEnum):
    """What a series measures. The comment gives the columns and their unit."""

    ATTITUDE_SETPOINT = "attitude_setpoint"  # roll, pitch, yaw [rad]
    RATE_SETPOINT = "rate_setpoint"  # p, q, r [rad/s]
    THRUST_SETPOINT = "thrust_setpoint"  # collective, 0..1
    TORQUE_COMMAND = "torque_command"  # roll, pitch, yaw, -1..1 of full scale
    BODY_RATE = "body_rate"  # p, q, r from the gyro [rad/s]
    SPECIFIC_FORCE = "specific_force"  # x, y, z from the accelerometer [m/s^2]; (0, 0, -9.81) at rest
    ATTITUDE = "attitude"  # roll, pitch, yaw estimate [rad]
    ACTUATOR = "actuator"  # one column per output, 0..1
    ROTOR_SPEED = "rotor_speed"  # one column per rotor [rad/s], unsigned
    VIBRATION = "vibration"  # x, y, z vibration level [m/s^2]
    HEIGHT = "height"  # above take-off, up positive [m]
    VOLTAGE = "voltage"  # battery [V]
    ARMED = "armed"  # 0 or 1


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One signal over a span of time, as it came: gaps, jitter and order untouched.

    t_ns: (n,) vehicle clock [ns], counter wraps removed. host_ns: (n,) clock of the receiver or recorder [ns].
    values: (n, k), the columns and units that `Signal` gives.
    Raises InputError if the lengths differ.
    """

    signal: Signal
    t_ns: IntArray
    host_ns: IntArray
    values: FloatArray

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or not (len(self.t_ns) == len(self.host_ns) == len(self.values)):
            raise InputError(f"series {self.signal}: t_ns, host_ns and values must have one row per sample")

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """What one vehicle said in a span of time: a whole log, or what arrived since the last look at a live link.

    At most one series per signal; a signal that did not occur is absent.
    """

    series: tuple[Series, ...] = ()

    def get(self, signal: Signal) -> Series | None:
        """The series of `signal`, or None if the vehicle did not send it."""
        return next((s for s in self.series if s.signal is signal), None)

    def need(self, signal: Signal) -> Series:
        """The series of `signal`. Raises InputError, naming the signal, if it is absent or empty."""
        found = self.get(signal)
        if found is None or len(found) == 0:
            raise InputError(f"no {signal.replace('_', ' ')} in the data")
        return found
