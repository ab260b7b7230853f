"""Crazyflie uSD-card logs, version 2: packed records behind a header that describes them, closed by a CRC-32.

Layout, little endian: 0xBC, u16 version, u16 number of event types; for each type u16 id, name, NUL, u16 number of
variables, each `name(c)`, NUL, with `c` a code of Python's struct; then records of u16 id, u64 time [us] and the
variables; then the CRC-32 of everything before it.

Frame. The firmware's body frame is x forward, y left, z up, but its attitude is the "legacy" one, with pitch inverted:
nose up is positive, and `controller.r_pitch` is already -gyro.y (crazyflie-firmware, controller_pid.c). So roll and
pitch are those of FRD as logged, and only yaw changes sign. `controller.cmd_yaw` is negated by the firmware and is that
of FRD too: positive commands raise the rotors that turn the nose right. Raw sensor axes (gyro.*, acc.*) change the
signs of y and z. The recorded flights agree: over 77 of them d(setpoint)/dt and the gyro correlate by at least +0.54 on
roll and pitch, and the vehicle accelerates by -7.7 m/s^2 along x for 1 rad of pitch (nose up brakes).
"""

import re
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavdiag.errors import InputError
from mavdiag.logs.log import LogKind, read_bytes, sha256_of
from mavdiag.logs.records import as_floats, gather, recorded
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import DEG, G

__all__ = ["KIND", "read_crazyflie"]

PROFILE = "crazyflie"
TOKEN = 0xBC
VERSION = 2
FIXED_HEADER_BYTES = 5
CRC_BYTES = 4
MAX_TIME_US = 2**53  # 285 years: anything later is damage, and would not fit in nanoseconds

TORQUE_FULL_SCALE = 32767  # the firmware's control_t is int16
THRUST_FULL_SCALE = 65535  # and its thrust and motor ratios are uint16

_VARIABLE = re.compile(r"(?P<name>.+)\((?P<code>[bBhHiIqQefd?])\)")


@dataclass(frozen=True, slots=True)
class _Row:
    """How one signal is made.

    signal: what is made.
    variables: one for each column; None: not logged, the column is NaN.
    factors: of each column.
    """

    signal: Signal
    variables: tuple[str | None, ...]
    factors: tuple[float, ...]


# The first row of a signal whose variables are all in the log is taken. Rows that name gyro, acc, stateEstimate angles,
# pm or motor follow the firmware's log groups; the recorded flights do not carry those variables.
_ROWS = (
    _Row(Signal.ATTITUDE_SETPOINT, ("controller.roll", "controller.pitch", "controller.yaw"), (DEG, DEG, -DEG)),
    _Row(Signal.RATE_SETPOINT, ("controller.rollRate", "controller.pitchRate", "controller.yawRate"), (DEG, DEG, -DEG)),
    _Row(Signal.BODY_RATE, ("controller.r_roll", "controller.r_pitch", "controller.r_yaw"), (1.0, 1.0, -1.0)),
    _Row(Signal.BODY_RATE, ("gyro.x", "gyro.y", "gyro.z"), (DEG, -DEG, -DEG)),
    _Row(
        Signal.TORQUE_COMMAND,
        ("controller.cmd_roll", "controller.cmd_pitch", "controller.cmd_yaw"),
        (1 / TORQUE_FULL_SCALE,) * 3,
    ),
    _Row(Signal.THRUST_SETPOINT, ("controller.actuatorThrust",), (1 / THRUST_FULL_SCALE,)),
    _Row(
        Signal.SPECIFIC_FORCE,
        ("acc.x", "acc.y", "acc.z"),
        (G, -G, -G),  # the firmware's unit of acceleration is the g
    ),
    _Row(Signal.SPECIFIC_FORCE, (None, None, "controller.accelz"), (1.0, 1.0, -G)),
    _Row(Signal.ATTITUDE, ("stateEstimate.roll", "stateEstimate.pitch", "stateEstimate.yaw"), (DEG, DEG, -DEG)),
    _Row(Signal.HEIGHT, ("stateEstimate.z",), (1.0,)),
    _Row(Signal.VOLTAGE, ("pm.vbat",), (1.0,)),
    _Row(Signal.ACTUATOR, ("motor.m1", "motor.m2", "motor.m3", "motor.m4"), (1 / THRUST_FULL_SCALE,) * 4),
)


@dataclass(frozen=True, slots=True)
class _EventType:
    """One kind of record.

    number: its id.
    variables: their names.
    layout: of the whole record, id and time included.
    """

    number: int
    variables: tuple[str, ...]
    layout: np.dtype[np.void]


@dataclass(frozen=True, slots=True, eq=False)
class _Events:
    """All records of one event type, in the order of the file."""

    variables: tuple[str, ...]
    t_ns: IntArray
    records: NDArray[np.void]


class _Header:
    """Reads the self-description, byte by byte; every step is checked against the end of the file."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.position = FIXED_HEADER_BYTES

    def u16(self) -> int:
        end = self.position + 2
        if end > len(self._data):
            raise InputError("the header ends early")
        value = int.from_bytes(self._data[self.position : end], "little")
        self.position = end
        return value

    def text(self) -> str:
        end = self._data.find(b"\0", self.position)
        if end < 0:
            raise InputError("the header ends early")
        raw = self._data[self.position : end]
        self.position = end + 1
        return raw.decode("latin-1")


def read_crazyflie(path: Path) -> Log:
    """Read a uSD-card log of a Crazyflie, version 2. Profile "crazyflie"; the file does not say when it was started.

    All signals of a record share its time stamp; nothing is resampled. Only the vertical specific force is logged by
    the PID controller's group, so the x and y columns of that signal are NaN unless `acc.*` is in the log.
    Raises InputError for a file that is unreadable, truncated, damaged, of another version, or without a known signal.
    """
    data = read_bytes(path)
    try:
        series = _series(_events(_checked(data)))
    except InputError as error:
        raise InputError(f"{path}: not a usable Crazyflie log: {error}") from error
    return Log(path.name, sha256_of(data), PROFILE, Telemetry(series))


def _recognise(head: bytes) -> bool:
    """A uSD-card log starts with its token."""
    return head[:1] == bytes([TOKEN])


# It has no arming state; the limits are those that the recorded flights were found to need (height 0.38 m, thrust 25000
# of 65535, 0.5 s and 0.6 s off the ends).
KIND = LogKind(
    "Crazyflie",
    _recognise,
    lambda path, vehicle, profile: read_crazyflie(path),
    PROFILE,
    GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    airframe_name="crazyflie",
)


def _checked(data: bytes) -> bytes:
    """The content without its checksum. Raises InputError if the token, the version or the checksum is wrong."""
    if len(data) < FIXED_HEADER_BYTES + CRC_BYTES or data[0] != TOKEN:
        raise InputError("its first bytes are not those of one")
    version = int.from_bytes(data[1:3], "little")
    if version != VERSION:
        raise InputError(f"version {version}; only version {VERSION} is read")
    content, checksum = data[:-CRC_BYTES], data[-CRC_BYTES:]
    if zlib.crc32(content) != int.from_bytes(checksum, "little"):
        raise InputError("its checksum is wrong (truncated or damaged); copy it from the card again")
    return content


def _events(content: bytes) -> tuple[_Events, ...]:
    """The records by event type, in the order in which the header declares the types; types without records left out.

    Raises InputError if the header or a record does not make sense.
    """
    header = _Header(content)
    types: dict[int, _EventType] = {}
    for _ in range(int.from_bytes(content[3:5], "little")):
        event_type = _event_type(header)
        types[event_type.number] = event_type
    body = content[header.position :]
    found = []
    for event_type, records in _records(body, types):
        time_us = records["f1"]
        if len(time_us) and int(time_us.max()) > MAX_TIME_US:
            raise InputError("a time stamp is out of range")
        found.append(_Events(event_type.variables, time_us.astype(np.int64) * 1000, records))
    return tuple(found)


def _event_type(header: _Header) -> _EventType:
    """The next event type that the header declares."""
    number, name = header.u16(), header.text()
    variables, fields = [], [("f0", "<u2"), ("f1", "<u8")]
    for index in range(header.u16()):
        match = _VARIABLE.fullmatch(header.text())
        if match is None:
            raise InputError(f"event {name!r} declares a variable without a known type")
        variables.append(match["name"])
        fields.append((f"f{index + 2}", "<" + match["code"]))
    return _EventType(number, tuple(variables), np.dtype(fields))


def _records(body: bytes, types: dict[int, _EventType]) -> list[tuple[_EventType, NDArray[np.void]]]:
    """The records of each type that occurs. Raises InputError at an undeclared id or a record that is cut short."""
    if len(body) < 2:
        raise InputError("it has no records")
    only = types.get(int.from_bytes(body[:2], "little"))
    if only is not None and len(body) % only.layout.itemsize == 0:  # the usual log has one type: no walk is needed
        records = np.frombuffer(body, only.layout)
        if bool((records["f0"] == only.number).all()):
            return [(only, records)]
    starts: dict[int, list[int]] = {number: [] for number in types}
    sizes = {number: event_type.layout.itemsize for number, event_type in types.items()}
    position = 0
    while position < len(body):
        number = body[position] | body[position + 1] << 8 if position + 1 < len(body) else -1
        if number not in sizes or position + sizes[number] > len(body):
            raise InputError(f"the record at byte {position} of the data is of no declared type or cut short")
        starts[number].append(position)
        position += sizes[number]
    return [(types[number], gather(body, types[number].layout, at)) for number, at in starts.items() if at]


def _series(events: tuple[_Events, ...]) -> tuple[Series, ...]:
    """One series per signal, from the first row of the table and the first event type that carry it."""
    found: dict[Signal, Series] = {}
    for row in _ROWS:
        for group in events:
            if row.signal not in found and all(v is None or v in group.variables for v in row.variables):
                found[row.signal] = _convert(row, group)
    if not found:
        raise InputError("it carries no signal that is known here; log the `controller` group")
    return tuple(found.values())


def _convert(row: _Row, group: _Events) -> Series:
    """One signal in SI units and FRD. values: (n, columns of the row)."""
    values = np.full((len(group.t_ns), len(row.variables)), np.nan)
    for column, (variable, factor) in enumerate(zip(row.variables, row.factors, strict=True)):
        if variable is not None:
            values[:, column] = as_floats(group.records[f"f{group.variables.index(variable) + 2}"]) * factor
    return recorded(row.signal, group.t_ns, values)
