"""Crazyflie uSD-card logs, version 2: packed records behind a header that describes them, closed by a CRC-32.

Layout, little endian: 0xBC, u16 version, u16 number of event types; for each type u16 id, name, NUL, u16 number of
variables, each `name(c)`, NUL, with `c` a code of Python's struct; then records of u16 id, u64 time [us] and the
variables; then the CRC-32 of everything before it.

Frame. The firmware's body frame is x forward, y left, z up, but its attitude is the "legacy" one, with pitch inverted
(crazyflie-firmware, controller_pid.c): roll and pitch are those of FRD as logged, and only yaw changes sign, but for
`controller.cmd_yaw`, which the firmware negates. Raw sensor axes (gyro.*, acc.*) change the signs of y and z.
"""

import hashlib
import re
import struct
import zlib
from pathlib import Path

import numpy as np

from mavdiag.errors import InputError
from mavdiag.logs.log import MAX_TIME_US, LogKind, Row, Table, gather, read_bytes, read_rows, usable_as
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import IntArray, Log, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_US, G

PROFILE = "crazyflie"
TOKEN, VERSION = 0xBC, 2
FIXED_HEADER_BYTES, CRC_BYTES = 5, 4
TORQUE_FULL_SCALE = 32767  # the firmware's control_t is int16
THRUST_FULL_SCALE = 65535  # and its thrust and motor ratios are uint16
_VARIABLE = re.compile(r"(?P<name>.+)\((?P<code>[bBhHiIqQefd?])\)")


def _row(signal: Signal, group: str, names: str, *factors: float) -> Row:
    """names: of the variables of a group; "-" for a column that is not logged. factors: of each column, or of all."""
    fields = tuple(None if name == "-" else f"{group}.{name}" for name in names.split())
    return Row(signal, "", fields, lambda stored: stored * np.array(factors))


# The first row of a signal whose variables are all in the log is taken. Rows that name gyro, acc, stateEstimate angles,
# pm or motor follow the firmware's log groups; the recorded flights do not carry those variables.
_ROWS = (
    _row(Signal.ATTITUDE_SETPOINT, "controller", "roll pitch yaw", DEG, DEG, -DEG),
    _row(Signal.RATE_SETPOINT, "controller", "rollRate pitchRate yawRate", DEG, DEG, -DEG),
    _row(Signal.BODY_RATE, "controller", "r_roll r_pitch r_yaw", 1.0, 1.0, -1.0),
    _row(Signal.BODY_RATE, "gyro", "x y z", DEG, -DEG, -DEG),
    _row(Signal.TORQUE_COMMAND, "controller", "cmd_roll cmd_pitch cmd_yaw", 1 / TORQUE_FULL_SCALE),
    _row(Signal.THRUST_SETPOINT, "controller", "actuatorThrust", 1 / THRUST_FULL_SCALE),
    _row(Signal.SPECIFIC_FORCE, "acc", "x y z", G, -G, -G),  # the firmware counts in g
    _row(Signal.SPECIFIC_FORCE, "controller", "- - accelz", 1.0, 1.0, -G),
    _row(Signal.ATTITUDE, "stateEstimate", "roll pitch yaw", DEG, DEG, -DEG),
    _row(Signal.HEIGHT, "stateEstimate", "z", 1.0),
    _row(Signal.VOLTAGE, "pm", "vbat", 1.0),
    _row(Signal.ACTUATOR, "motor", "m1 m2 m3 m4", 1 / THRUST_FULL_SCALE),
)


def read_crazyflie(path: Path) -> Log:
    """Read a uSD-card log of a Crazyflie, version 2; the x and y specific force are NaN unless `acc.*` is in the log.

    Raises InputError for a file that is unreadable, truncated, damaged, of another version, or without a known signal.
    """
    data = read_bytes(path)
    with usable_as("Crazyflie log", path):
        if len(data) < FIXED_HEADER_BYTES + CRC_BYTES or data[0] != TOKEN:
            raise InputError("its first bytes are not those of one")
        version = int.from_bytes(data[1:3], "little")
        if version != VERSION:
            raise InputError(f"version {version}; only version {VERSION} is read")
        content, checksum = data[:-CRC_BYTES], data[-CRC_BYTES:]
        if zlib.crc32(content) != int.from_bytes(checksum, "little"):
            raise InputError("its checksum is wrong (truncated or damaged); copy it from the card again")
        series = tuple(read_rows(_ROWS, _tables(content)).values())
        if not series:
            raise InputError("it carries no signal that is known here; log the `controller` group")
    return Log(path.name, hashlib.sha256(data).hexdigest(), PROFILE, Telemetry(series))


def _tables(content: bytes) -> list[Table]:
    types, position = dict[int, np.dtype[np.void]](), FIXED_HEADER_BYTES
    try:
        for _ in range(int.from_bytes(content[3:5], "little")):
            number, types[number], position = _event_type(content, position)
    except (ValueError, struct.error) as error:
        raise InputError("the header ends early") from error
    body = content[position:]
    if len(body) < 2:
        raise InputError("it has no records")
    found = []
    for number, starts in _starts(body, {number: layout.itemsize for number, layout in types.items()}).items():
        records = gather(body, types[number], starts)
        if len(records) and int(records["time"].max()) > MAX_TIME_US:
            raise InputError("a time stamp is out of range")
        fields = {name: records[name] for name in types[number].names or () if "." in name}
        found += [Table("", records["time"].astype(np.int64) * NS_PER_US, fields)] if len(records) else []
    return found


def _event_type(content: bytes, position: int) -> tuple[int, np.dtype[np.void], int]:
    """Number and layout of the event type that is declared here, and where it ends. Raises ValueError, struct.error."""
    (number,), name_end = struct.unpack_from("<H", content, position), content.index(b"\0", position + 2)
    (count,), position = struct.unpack_from("<H", content, name_end + 1), name_end + 3
    variables: dict[str, str] = {}
    for index in range(count):
        end = content.index(b"\0", position)
        match, position = _VARIABLE.fullmatch(content[position:end].decode("latin-1")), end + 1
        if match is None:
            raise InputError(f"event {number} declares a variable without a known type")
        known = "." in match["name"] and match["name"] not in variables
        variables[match["name"] if known else str(index)] = "<" + match["code"]
    return number, np.dtype([("id", "<u2"), ("time", "<u8"), *variables.items()]), position


def _starts(body: bytes, sizes: dict[int, int]) -> dict[int, IntArray]:
    """Where the records of each type begin. Raises InputError at an undeclared id or a record that is cut short."""
    number = int.from_bytes(body[:2], "little")
    if number in sizes and len(body) % sizes[number] == 0:  # the usual log has one type: no walk is needed
        starts = np.arange(0, len(body), sizes[number])
        if (np.frombuffer(body, np.uint8).reshape(-1, sizes[number])[:, :2] == list(body[:2])).all():
            return {number: starts}
    found: dict[int, list[int]] = {number: [] for number in sizes}
    position = 0
    while position < len(body):
        number = int.from_bytes(body[position : position + 2], "little")
        if number not in sizes or position + sizes[number] > len(body):
            raise InputError(f"the record at byte {position} of the data is of no declared type or cut short")
        found[number].append(position)
        position += sizes[number]
    return {number: np.array(starts, np.int64) for number, starts in found.items()}


# It has no arming state; the limits are those that the recorded flights were found to need.
KIND = LogKind(
    "Crazyflie",
    lambda head: head[:1] == bytes([TOKEN]),
    lambda path, *_: read_crazyflie(path),
    (PROFILE,),
    GateSpec(min_height_m=0.38, min_thrust=0.38, need_armed=False, trim_start_s=0.5, trim_end_s=0.6),
    airframe_name="crazyflie",
)
