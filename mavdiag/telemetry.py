"""The values that cross module boundaries, in SI units and in the body frame FRD (x forward, y right, z down)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.errors import InputError
from mavdiag.units import NS_PER_S

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
Three: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True, order=True)
class Instant:
    """A point in time, in nanoseconds of one clock. Spans are plain float seconds."""

    ns: int

    def __add__(self, span_s: float) -> "Instant":
        return Instant(self.ns + round(span_s * NS_PER_S))

    def __sub__(self, earlier: "Instant") -> float:
        return (self.ns - earlier.ns) / NS_PER_S


class Axis(StrEnum):
    """A body axis, by the name of the rotation about it."""

    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"

    @property
    def column(self) -> int:
        """Column of this axis in an (n, 3) array of angles or rates."""
        return ("roll", "pitch", "yaw").index(self.value)


class Signal(StrEnum):
    """What a series measures. The comment gives its columns and their unit."""

    ATTITUDE_SETPOINT = "attitude_setpoint"  # roll, pitch, yaw [rad]
    RATE_SETPOINT = "rate_setpoint"  # p, q, r [rad/s]
    THRUST_SETPOINT = "thrust_setpoint"  # collective, 0..1
    TORQUE_COMMAND = "torque_command"  # roll, pitch, yaw, -1..1 of full scale
    BODY_RATE = "body_rate"  # p, q, r from the gyro [rad/s]
    SPECIFIC_FORCE = "specific_force"  # x, y, z from the accelerometer [m/s^2]; (0, 0, -9.81) at rest
    ATTITUDE = "attitude"  # roll, pitch, yaw estimate [rad]
    ACTUATOR = "actuator"  # one column per output, 0..1; 0 for an output that is not in use
    ROTOR_SPEED = "rotor_speed"  # one column per rotor [rad/s], unsigned; NaN for a rotor that was never reported
    VIBRATION = "vibration"  # x, y, z vibration level [m/s^2]
    HEIGHT = "height"  # above take-off, up positive [m]
    VOLTAGE = "voltage"  # battery [V]
    ARMED = "armed"  # 0 or 1


_UNITS = {
    **dict.fromkeys((Signal.ATTITUDE_SETPOINT, Signal.ATTITUDE), "rad"),
    **dict.fromkeys((Signal.RATE_SETPOINT, Signal.BODY_RATE, Signal.ROTOR_SPEED), "rad/s"),
    **dict.fromkeys((Signal.SPECIFIC_FORCE, Signal.VIBRATION), "m/s^2"),
    Signal.HEIGHT: "m",
    Signal.VOLTAGE: "V",
}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Series:
    """One signal over a span of time, as it came: gaps, jitter and order untouched.

    t_ns, host_ns: (n,) clocks of the vehicle, counter wraps removed, and of the receiver or recorder [ns].
    values: (n, k), the columns and units that `Signal` gives. Raises InputError if the lengths differ.
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

    @property
    def t_s(self) -> FloatArray:
        """(n,) vehicle clock [s]."""
        return self.t_ns / NS_PER_S

    @property
    def unit(self) -> str:
        """Of the values; empty for a pure number."""
        return _UNITS.get(self.signal, "")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Telemetry:
    """What one vehicle sent in a span of time: at most one series per signal; what did not occur is absent."""

    series: tuple[Series, ...] = ()

    def get(self, signal: Signal) -> Series | None:
        """The series of `signal`, or None if the vehicle did not send it."""
        return next((s for s in self.series if s.signal is signal), None)

    def need(self, signal: Signal) -> Series:
        """The series of `signal`. Raises InputError, naming it and what there is, if it is absent or empty."""
        found = self.get(signal)
        if found is None or len(found) == 0:
            there = ", ".join(one.signal for one in self.series if len(one)) or "nothing"
            raise InputError(f"no {signal.replace('_', ' ')} in the data; there is {there}")
        return found

    def __getitem__(self, signal: Signal | str) -> Series:
        """As `need`, by the signal or its name. Raises InputError also for a name that no signal has."""
        if signal not in tuple(Signal):
            raise InputError(f"no signal is named {signal!r}; there are {', '.join(Signal)}")
        return self.need(Signal(signal))

    def __iter__(self) -> Iterator[Series]:
        return iter(self.series)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Batch:
    """Raw samples of one accelerometer in a row, faster than a log has its signals.

    t_ns: time of the first, vehicle clock. force: (n, 3) [m/s^2], FRD.
    """

    t_ns: int
    rate_hz: float
    force: FloatArray


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Log:
    """One vehicle's flight, from a file or from a live link.

    name, sha256: what to call it (a file's name), and of the whole file, hexadecimal; empty where there is no file.
    profile: that its signals follow, a key of `mavdiag.link.profiles.PROFILES`, or that of a log format.
    started_ns: wall-clock time of the first record, unix epoch [ns]; 0 if the file does not say.
    notes: what is wrong with the file though it can be used, one sentence each.
    parameters: the autopilot's own, by name, as far as the log or link carries them; the latest values.
    motor_order: whether the columns of ACTUATOR are the motors in their order, and not the outputs of the autopilot.
    mav_type, vehicle: MAV_TYPE and MAVLink system id; None where the log does not say.
    batches: raw samples of the accelerometer, in order of time.
    """

    name: str
    sha256: str
    profile: str
    telemetry: Telemetry
    started_ns: int = 0
    notes: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    motor_order: bool = False
    mav_type: int | None = None
    vehicle: int | None = None
    batches: tuple[Batch, ...] = ()

    def __getitem__(self, signal: Signal | str) -> Series:
        """The series of a signal, by the signal or its name. Raises InputError if the log has none."""
        return self.telemetry[signal]

    def __repr__(self) -> str:
        notes = "".join(f"; {note}" for note in self.notes)
        return f"<Log {self.name}: profile {self.profile}, {len(self.telemetry.series)} signals{notes}>"
