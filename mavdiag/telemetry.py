"""The values that cross module boundaries, in SI units and in the body frame FRD (x forward, y right, z down)."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavdiag.errors import InputError, UsageError
from mavdiag.printable import counted
from mavdiag.tabular import Tabular, pandas
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from pandas import DataFrame

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
Three: TypeAlias = tuple[float, float, float]
INT64 = np.dtype(np.int64)
EARLIEST_NS = 10**18  # September 2001: an earlier wall clock was not set (our choice)


@dataclass(frozen=True, slots=True, order=True)
class Instant:
    """A point in time, in nanoseconds of one clock. Spans are plain float seconds."""

    ns: int

    def __add__(self, span_s: float) -> "Instant":
        return Instant(self.ns + round(span_s * NS_PER_S))

    def __sub__(self, earlier: "Instant") -> float:
        return (self.ns - earlier.ns) / NS_PER_S


def unix_ns(text: str) -> int:
    """A time of ISO 8601, UTC unless it says another zone, since 1970 [ns]. Raises UsageError, showing the notation."""
    try:
        at = datetime.fromisoformat(text)
    except (TypeError, ValueError) as error:
        raise UsageError(f"time {text!r}: write it like 2026-03-01 or 2026-03-01T14:30") from error
    t_ns = round((at.replace(tzinfo=UTC) if at.tzinfo is None else at).timestamp()) * NS_PER_S
    if not 0 <= t_ns < 1 << 63:
        raise UsageError(f"time {text!r}: give one from 1970 to 2262")
    return t_ns


class Axis(StrEnum):
    """A body axis, by the name of the rotation about it."""

    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"

    @property
    def column(self) -> int:
        """Column of this axis in an (n, 3) array of angles or rates."""
        return list(Axis).index(self)


def axis_named(name: str) -> Axis:
    """The axis of that name. Raises UsageError, listing the names, if there is none."""
    if name not in tuple(Axis):
        raise UsageError(f"no axis {name!r}; there are {', '.join(Axis)}")
    return Axis(name)


class Signal(StrEnum):
    """What a series measures: its name, the names of its columns, and their unit, empty for a pure number."""

    columns: tuple[str, ...]  # none of outputs and rotors, of which there are as many as there are
    unit: str

    def __new__(cls, name: str, columns: str = "", unit: str = "") -> "Signal":  # noqa: D102 - see the class
        found = str.__new__(cls, name)
        found._value_, found.columns, found.unit = name, tuple(columns.split()), unit
        return found

    ATTITUDE_SETPOINT = "attitude_setpoint", "roll pitch yaw", "rad"
    RATE_SETPOINT = "rate_setpoint", "roll pitch yaw", "rad/s"
    THRUST_SETPOINT = "thrust_setpoint", "value"  # collective, 0..1
    TORQUE_COMMAND = "torque_command", "roll pitch yaw"  # -1..1 of full scale
    BODY_RATE = "body_rate", "roll pitch yaw", "rad/s"  # from the gyro
    SPECIFIC_FORCE = "specific_force", "x y z", "m/s^2"  # from the accelerometer; (0, 0, -9.81) at rest
    ATTITUDE = "attitude", "roll pitch yaw", "rad"  # estimate
    ACTUATOR = "actuator"  # one column per output, 0..1; 0 for an output that is not in use
    ROTOR_SPEED = "rotor_speed", "", "rad/s"  # one column per rotor, unsigned; NaN for a rotor that was never reported
    VIBRATION = "vibration", "x y z", "m/s^2"  # level
    HEIGHT = "height", "value", "m"  # above take-off, up positive
    VOLTAGE = "voltage", "value", "V"  # battery
    ARMED = "armed", "value"  # 0 or 1
    MODE = "mode", "value"  # custom_mode of HEARTBEAT, whatever the log has in its place
    POSITION = "position", "north east", "m"  # from the autopilot's origin
    COORDINATES = "coordinates", "latitude longitude", "rad"

    def names(self, width: int) -> tuple[str, ...]:
        """Names of its columns: axes of the body, or the number of an output or rotor."""
        return self.columns or tuple(str(number + 1) for number in range(width))

    @property
    def width(self) -> int | None:
        """Number of its columns; None for outputs and rotors."""
        return len(self.columns) or None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Series:
    """One signal over a span of time, as it came: gaps, jitter and order untouched.

    t_ns, host_ns: (n,) clocks of the vehicle, counter wraps removed, and of the receiver or recorder [ns].
    values: (n, k), the columns and units that `Signal` gives. Raises InputError if they do not fit each other.
    """

    signal: Signal
    t_ns: IntArray
    host_ns: IntArray
    values: FloatArray

    def __post_init__(self) -> None:
        try:  # by attributes, for this is done often
            fits = self.t_ns.shape == self.host_ns.shape == self.values.shape[:1] and self.values.ndim == 2
            fits = fits and self.t_ns.dtype == INT64
        except AttributeError:
            fits = False
        if not fits:
            raise InputError(f"series {self.signal}: t_ns and host_ns (n,) of int64 and values (n, k) are needed")

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, chosen: BoolArray | IntArray | slice) -> "Series":
        """Some of its samples."""
        return Series(self.signal, self.t_ns[chosen], self.host_ns[chosen], self.values[chosen])

    @property
    def t_s(self) -> FloatArray:
        """(n,) vehicle clock [s]."""
        return self.t_ns / NS_PER_S

    @property
    def unit(self) -> str:
        """Of the values; empty for a pure number."""
        return self.signal.unit


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Telemetry:
    """What one vehicle sent in a span of time: at most one series per signal; what did not occur is absent."""

    series: tuple[Series, ...] = ()

    def get(self, signal: Signal | str) -> Series | None:
        """The series of a signal, by the signal or its name, or None if the vehicle did not send it."""
        return next((s for s in self.series if s.signal == signal), None)

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

    @property
    def first_ns(self) -> int:
        """The earliest first sample, vehicle clock; 0 without any."""
        return min((int(series.t_ns[0]) for series in self.series if len(series)), default=0)

    @property
    def digest(self) -> str:
        """SHA-256 of all times and values, hexadecimal: the identity of a flight that never was a file."""
        digest = hashlib.sha256()
        for series in self.series:
            digest.update(series.signal.encode())
            digest.update(np.ascontiguousarray(series.t_ns).tobytes())
            digest.update(np.ascontiguousarray(series.values).tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Batch:
    """Raw samples of one accelerometer in a row, faster than a log has its signals.

    t_ns: time of the first, vehicle clock. force: (n, 3) [m/s^2], FRD.
    """

    t_ns: int
    rate_hz: float
    force: FloatArray


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Log(Tabular):
    """One vehicle's flight, from a file or from a live link.

    name, sha256: what to call it (a file's name), and of the whole file, hexadecimal; empty where there is no file.
    profile: that its signals follow, a key of `mavdiag.link.profiles.PROFILES`, or that of a log format.
    started_ns: wall-clock time of the first sample, unix epoch [ns]; 0 if the file does not say.
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

    @classmethod
    def from_arrays(
        cls,
        name: str,
        signals: Mapping[Signal, tuple[ArrayLike, ArrayLike]] | Mapping[str, tuple[ArrayLike, ArrayLike]],
        *,
        profile: str = "csv",
        started_ns: int = 0,
        motor_order: bool = True,
    ) -> "Log":
        """A log of arrays: of each signal, by its name, times (n,) of one clock [s] and values (n, k) or (n,).

        Columns and units are those of `Signal`, axes those of FRD. The others as in `Log`.
        Raises InputError, naming the signal, for an unknown one and for arrays that do not fit it or each other.

        >>> Log.from_arrays("hover", {"body_rate": ([0.0, 0.01], [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])})["body_rate"].t_ns
        array([       0, 10000000])
        """
        series = []
        for signal, pair in signals.items():
            if signal not in tuple(Signal):
                raise InputError(f"no signal is named {signal!r}; there are {', '.join(Signal)}")
            try:
                arrays: list[np.ma.MaskedArray[Any, Any]] = [np.ma.array(one) for one in pair]
                if {one.dtype.kind for one in arrays} & {*"cmM"}:
                    raise TypeError("neither dates nor complex ones")
                times, columns = (np.ma.array(one, dtype=np.float64).filled(np.nan) for one in arrays)  # masked: NaN
            except (TypeError, ValueError) as error:
                raise InputError(f"{signal}: give times and values, two arrays of numbers: {error}") from error
            columns = columns[:, None] if columns.ndim == 1 else columns
            known = (np.abs(times) < 2**63 / NS_PER_S).all()  # what nanoseconds in 64 bits can hold
            if not known or columns.ndim != 2 or times.shape != columns.shape[:1]:
                shapes = f"not {times.shape}, {columns.shape}" if known else "not NaN or beyond 292 years"
                raise InputError(f"{signal}: give times (n,) in seconds and values (n, k), {shapes}")
            if (width := Signal(signal).width) not in (None, columns.shape[1]):
                raise InputError(f"{signal}: it has {width} columns, not {columns.shape[1]}")
            t_ns = np.round(times * NS_PER_S).astype(np.int64)
            series.append(Series(Signal(signal), t_ns, t_ns, columns))
        telemetry = Telemetry(tuple(series))
        return cls(name, telemetry.digest, profile, telemetry, started_ns, motor_order=motor_order)

    @property
    def epoch_ns(self) -> int:
        """Wall-clock time at second 0 of the vehicle's clock, unix epoch [ns]; 0 if the file does not say."""
        return self.started_ns and self.started_ns - self.telemetry.first_ns

    __iter__: ClassVar[None] = None  # Python would ask for signals 0, 1, ...: `telemetry` has the series

    def __getitem__(self, signal: Signal | str) -> Series:
        """The series of a signal, by the signal or its name. Raises InputError if the log has none."""
        return self.telemetry[signal]

    def columns(self) -> dict[str, list[Any]]:
        """What it has of each signal."""
        series = [one for one in self.telemetry if len(one)]
        spans_s = [max(float(one.t_s.max() - one.t_s.min()), 1 / NS_PER_S) for one in series]
        return {
            "signal": [str(one.signal) for one in series],
            "samples": [len(one) for one in series],
            "rate [Hz]": [(len(one) - 1) / span_s for one, span_s in zip(series, spans_s, strict=True)],
            "from [s]": [float(one.t_s.min()) for one in series],
            "to [s]": [float(one.t_s.max()) for one in series],
            "unit": [one.unit for one in series],
        }

    def to_frame(self, *signals: Signal | str) -> "DataFrame":
        """Its signals, or those named, over time of the vehicle's clock [s]: columns like "body_rate/roll".

        Each row is of one time; what a signal did not sample then is NaN. Raises UsageError without pandas,
        InputError for a signal that the log has not.
        """
        series = [self[name] for name in signals] or [one for one in self.telemetry if len(one)]
        tables = [(one.signal, one.t_s, one.signal.names(one.values.shape[1]), one.values) for one in series]
        return frame_of(tables)

    def plot(self, *signals: Signal | str, **options: Any) -> Any:
        """Draw signals over time; options as of `pandas.DataFrame.plot`."""
        return self.to_frame(*signals).interpolate(method="index").plot(**options)

    def __repr__(self) -> str:
        notes = "".join(f"; {note}" for note in self.notes)
        return f"<Log {self.name}: profile {self.profile}, {counted(len(self.telemetry.series), 'signal')}{notes}>"


def frame_of(tables: Sequence[tuple[str, FloatArray, Sequence[str], FloatArray]]) -> "DataFrame":
    """Tables as one frame over time, columns like "name/column"; of equal times of a table the last row stays.

    tables: of each its name, times [s] (n,), names of its k columns, values (n, k). Raises UsageError without pandas.
    """
    library = pandas()
    frames = [library.DataFrame(x, index=t_s, columns=[f"{name}/{c}" for c in names]) for name, t_s, names, x in tables]
    apart = [frame[~frame.index.duplicated(keep="last")] for frame in frames]
    frame: DataFrame = library.concat(apart, axis=1).sort_index().rename_axis("t_s") if apart else library.DataFrame()
    return frame
