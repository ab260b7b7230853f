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
from mavdiag.logs.records import Row, as_floats, gather, read_rows, scaled
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import FloatArray, IntArray, Log, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_US, G

PROFILE = "crazyflie"
TOKEN = 0xBC
VERSION = 2
FIXED_HEADER_BYTES = 5
CRC_BYTES = 4
MAX_TIME_US = 2**53  # 285 years: anything later is damage, and would not fit in nanoseconds

TORQUE_FULL_SCALE = 32767  # the firmware's control_t is int16
THRUST_FULL_SCALE = 65535  # and its thrust and motor ratios are uint16

_VARIABLE = re.compile(r"(?P<name>.+)\((?P<code>[bBhHiIqQefd?])\)")


def _names(group: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{group}.{name}" for name in names)


# The first row of a signal whose variables are all in the log is taken. Rows that name gyro, acc, stateEstimate angles,
# pm or motor follow the firmware's log groups; the recorded flights do not carry those variables.
_FRD_DEG = scaled(DEG, DEG, -DEG)
_ROWS = (
    Row(Signal.ATTITUDE_SETPOINT, "", _names("controller", "roll", "pitch", "yaw"), _FRD_DEG),
    Row(Signal.RATE_SETPOINT, "", _names("controller", "rollRate", "pitchRate", "yawRate"), _FRD_DEG),
    Row(Signal.BODY_RATE, "", _names("controller", "r_roll", "r_pitch", "r_yaw"), scaled(1.0, 1.0, -1.0)),
    Row(Signal.BODY_RATE, "", _names("gyro", "x", "y", "z"), scaled(DEG, -DEG, -DEG)),
    Row(
        Signal.TORQUE_COMMAND,
        "",
        _names("controller", "cmd_roll", "cmd_pitch", "cmd_yaw"),
        scaled(1 / TORQUE_FULL_SCALE),
    ),
    Row(Signal.THRUST_SETPOINT, "", ("controller.actuatorThrust",), scaled(1 / THRUST_FULL_SCALE)),
    Row(Signal.SPECIFIC_FORCE, "", _names("acc", "x", "y", "z"), scaled(G, -G, -G)),  # the firmware counts in g
    Row(Signal.SPECIFIC_FORCE, "", (None, None, "controller.accelz"), scaled(1.0, 1.0, -G)),
    Row(Signal.ATTITUDE, "", _names("stateEstimate", "roll", "pitch", "yaw"), _FRD_DEG),
    Row(Signal.HEIGHT, "", ("stateEstimate.z",)),
    Row(Signal.VOLTAGE, "", ("pm.vbat",)),
    Row(Signal.ACTUATOR, "", _names("motor", "m1", "m2", "m3", "m4"), scaled(1 / THRUST_FULL_SCALE)),
)


@dataclass(frozen=True, slots=True, eq=False)
class _Events:
    """All records of one event type, in the order of the file: id, time and the variables, as fields f0, f1, …"""

    name: str
    variables: tuple[str, ...]
    records: NDArray[np.void]

    def read(self, row: Row) -> tuple[IntArray, FloatArray] | None:
        """See `records.Table`."""
        if not all(name is None or name in self.variables for name in row.fields):
            return None
        values = np.full((len(self.records), len(row.fields)), np.nan)
        for column, name in enumerate(row.fields):
            if name is not None:
                values[:, column] = as_floats(self.records[f"f{self.variables.index(name) + 2}"])
        return self.records["f1"].astype(np.int64) * NS_PER_US, values


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

    def event_type(self) -> tuple[int, _Events]:
        """Number and layout of the next event type that is declared, without records."""
        number, name = self.u16(), self.text()
        variables, fields = [], [("f0", "<u2"), ("f1", "<u8")]
        for index in range(self.u16()):
            match = _VARIABLE.fullmatch(self.text())
            if match is None:
                raise InputError(f"event {name!r} declares a variable without a known type")
            variables.append(match["name"])
            fields.append((f"f{index + 2}", "<" + match["code"]))
        return number, _Events(name, tuple(variables), np.empty(0, fields))


def read_crazyflie(path: Path) -> Log:
    """Read a uSD-card log of a Crazyflie, version 2. Profile "crazyflie"; the file does not say when it was started.

    All signals of a record share its time stamp; nothing is resampled. Only the vertical specific force is logged by
    the PID controller's group, so the x and y columns of that signal are NaN unless `acc.*` is in the log.
    Raises InputError for a file that is unreadable, truncated, damaged, of another version, or without a known signal.
    """
    data = read_bytes(path)
    try:
        series = tuple(read_rows(_ROWS, _events(_checked(data))).values())
        if not series:
            raise InputError("it carries no signal that is known here; log the `controller` group")
    except InputError as error:
        raise InputError(f"{path}: not a usable Crazyflie log: {error}") from error
    return Log(path.name, sha256_of(data), PROFILE, Telemetry(series))


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


def _events(content: bytes) -> list[_Events]:
    """The records by event type, in the order in which the header declares the types; types without records left out.

    Raises InputError if the header or a record does not make sense.
    """
    header = _Header(content)
    types = dict(header.event_type() for _ in range(int.from_bytes(content[3:5], "little")))
    body = content[header.position :]
    if len(body) < 2:
        raise InputError("it has no records")
    found = []
    for number, starts in _starts(body, {number: kind.records.itemsize for number, kind in types.items()}).items():
        kind = types[number]
        records = gather(body, kind.records.dtype, starts)
        if len(records) and int(records["f1"].max()) > MAX_TIME_US:
            raise InputError("a time stamp is out of range")
        found += [_Events(kind.name, kind.variables, records)] if len(records) else []
    return found


def _starts(body: bytes, sizes: dict[int, int]) -> dict[int, list[int] | IntArray]:
    """Where the records of each type begin. Raises InputError at an undeclared id or a record that is cut short."""
    number = int.from_bytes(body[:2], "little")
    if number in sizes and len(body) % sizes[number] == 0:  # the usual log has one type: no walk is needed
        starts = np.arange(0, len(body), sizes[number])
        if (np.frombuffer(body, np.uint8).reshape(-1, sizes[number])[:, :2] == list(body[:2])).all():
            return {number: starts}
    found: dict[int, list[int]] = {number: [] for number in sizes}
    position = 0
    while position < len(body):
        number = body[position] | body[position + 1] << 8 if position + 1 < len(body) else -1
        if number not in sizes or position + sizes[number] > len(body):
            raise InputError(f"the record at byte {position} of the data is of no declared type or cut short")
        found[number].append(position)
        position += sizes[number]
    return dict(found)


# It has no arming state; the limits are those that the recorded flights were found to need (height 0.38 m, thrust 25000
# of 65535, 0.5 s and 0.6 s off the ends).
KIND = LogKind(
    "Crazyflie",
    lambda head: head[:1] == bytes([TOKEN]),
    lambda path, vehicle, profile: read_crazyflie(path),
    PROFILE,
    GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    airframe_name="crazyflie",
)
