"""PX4 ULog files (.ulg), parsed by pyulog: the topics of any PX4 since 2016 become one vehicle's telemetry.

PX4 logs SI units in FRD. Where a topic says when its sample was taken, that time is used, else that of its publication.
Damaged parts are skipped as pyulog skips them.
"""

import hashlib
import io
import struct
from collections import Counter
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from math import isfinite
from pathlib import Path

import numpy as np
from pyulog import ULog, ULogException

from mavdiag.errors import InputError
from mavdiag.link.messages import px4_custom_mode
from mavdiag.link.samples import DSHOT_FULL, LEAST_US, MOST_US, PULSE_LEAST_US, euler_angles, shows_dshot
from mavdiag.logs.log import MAX_TIME_US, RECORDED_GATE, LogKind, Row, Table, read_bytes, read_rows, usable_as
from mavdiag.telemetry import EARLIEST_NS, FloatArray, Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_US, RPM

PROFILE = "px4-log"
SIGNATURE = b"ULog\x01\x12\x35"
ACCELEROMETER = "sensor_combined, accelerometer"  # the same topic, at times of its own
NO_ACCELEROMETER = 2**31 - 1  # of accelerometer_timestamp_relative (PX4, SensorCombined.msg)
ARMED_STATE = 2  # of arming_state (PX4, VehicleStatus.msg; the same number in all versions)
FIRST_MOTOR, MOTORS = 101, 12  # of actuator_function "Motor 1" (PX4, EscReport.msg), and how many there are

READ_ALLOWANCE = 8  # a sound file is read once; a run of zeros, byte by byte, costs five times its length
HEAD_BYTES, HEADER_BYTES = 16, 3  # of the file; of a message
DEFINITIONS_END = (b"A", b"L", b"C")  # types of messages: subscription, text, text with a tag
COMPARED_AT_ONCE = 32  # definitions that are compared in the time of reading a byte (our estimate)
MAX_FIELDS = 65_535  # a ULog message is at most this many bytes (its length is a u16)
MAX_NESTING = 16  # PX4 nests messages two deep
BLOCK_BYTES, ZERO_BLOCKS = 4096, 18  # zeros longer than any message: so many blocks are left of them (our choice)

# What pyulog lets through on damaged files besides its own errors.
_PARSER_ERRORS = (
    ULogException, struct.error, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, OSError,
    RecursionError, MemoryError,
)  # fmt: skip


def _angles(q: FloatArray) -> FloatArray:
    """Roll, pitch, yaw of quaternions; none at all where nobody set one."""
    angles = euler_angles(q)
    return angles if np.isfinite(angles).any() else angles[:0]


def _norm(values: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(values, axis=1, keepdims=True))


def _outputs(output: FloatArray) -> FloatArray:
    """Shares of the outputs in their order up to the last in use; as `samples` tells DShot from pulses."""
    dshot = shows_dshot(output).any()
    least, low, span = (1.0, 0.0, DSHOT_FULL) if dshot else (PULSE_LEAST_US, LEAST_US, MOST_US - LEAST_US)
    carry = np.flatnonzero((output >= least).any(axis=0))
    width = int(carry[-1]) + 1 if len(carry) else 0
    used = np.where(np.isin(np.arange(width), carry), output[:, :width], low)
    return np.maximum(_moving(used) - low, 0.0) / span


def _moving(values: FloatArray) -> FloatArray:
    """The columns up to the last that ever changes: what stands still behind the motors is none (all, if none does)."""
    moves = np.flatnonzero((values[1:] != values[:-1]).any(axis=0))
    return values[:, : int(moves[-1]) + 1] if len(moves) else values


def _in_use(values: FloatArray) -> FloatArray:
    """Columns that are ever a number: PX4 fills unused outputs with NaN."""
    return _moving(values[:, np.isfinite(values).any(axis=0)])


def _turning(values: FloatArray) -> FloatArray:
    """Columns that ever turn, from rpm of either sign to rad/s."""
    return np.abs(values[:, (values != 0).any(axis=0)]) * RPM


def _by_motor(values: FloatArray) -> FloatArray:
    """Speeds of ESCs [rpm], then the functions of their outputs: by motor, from rpm of either sign to rad/s."""
    speeds, functions = np.split(np.nan_to_num(values), 2, axis=1)
    motors = functions.max(axis=0).astype(np.int64) - FIRST_MOTOR
    found = np.full((len(values), MOTORS), np.nan)
    driven = (motors >= 0) & (motors < MOTORS)
    found[:, motors[driven]] = np.abs(speeds[:, driven]) * RPM
    return found[:, : int(motors[driven].max(initial=-1)) + 1]


def _elements(name: str, count: int, member: str = "") -> tuple[str, ...]:
    return tuple(f"{name}[{index}]{member}" for index in range(count))


# The first row of a signal whose topic and fields are in the log is taken. Later rows are other versions' topics.
_ROWS = (
    Row(Signal.ATTITUDE_SETPOINT, "vehicle_attitude_setpoint", _elements("q_d", 4), _angles),  # the controller's
    Row(Signal.ATTITUDE_SETPOINT, "vehicle_attitude_setpoint", ("roll_body", "pitch_body", "yaw_body")),
    Row(Signal.RATE_SETPOINT, "vehicle_rates_setpoint", ("roll", "pitch", "yaw")),
    Row(Signal.THRUST_SETPOINT, "vehicle_attitude_setpoint", ("thrust",)),
    Row(Signal.THRUST_SETPOINT, "vehicle_attitude_setpoint", _elements("thrust_body", 3), _norm),
    Row(Signal.THRUST_SETPOINT, "vehicle_rates_setpoint", _elements("thrust_body", 3), _norm),
    Row(Signal.TORQUE_COMMAND, "vehicle_torque_setpoint", _elements("xyz", 3)),
    Row(Signal.TORQUE_COMMAND, "actuator_controls_0", _elements("control", 3)),
    Row(Signal.BODY_RATE, "sensor_combined", _elements("gyro_rad", 3)),
    Row(Signal.BODY_RATE, "vehicle_angular_velocity", _elements("xyz", 3)),
    Row(Signal.SPECIFIC_FORCE, ACCELEROMETER, _elements("accelerometer_m_s2", 3)),
    Row(Signal.SPECIFIC_FORCE, "vehicle_acceleration", _elements("xyz", 3)),
    Row(Signal.ATTITUDE, "vehicle_attitude", _elements("q", 4), euler_angles),
    Row(Signal.ACTUATOR, "actuator_motors", _elements("control", 12), _in_use),
    Row(Signal.ACTUATOR, "actuator_outputs", _elements("output", 16), _outputs),
    Row(
        Signal.ROTOR_SPEED,
        "esc_status",
        (*_elements("esc", 8, ".esc_rpm"), *_elements("esc", 8, ".actuator_function")),
        _by_motor,
    ),
    Row(Signal.ROTOR_SPEED, "esc_status", _elements("esc", 8, ".esc_rpm"), _turning),
    Row(Signal.HEIGHT, "vehicle_local_position", ("z",), np.negative),
    Row(Signal.POSITION, "vehicle_local_position", ("x", "y")),
    Row(Signal.VOLTAGE, "battery_status", ("voltage_v",)),
    Row(Signal.MODE, "vehicle_status", ("nav_state",), px4_custom_mode),
    Row(Signal.ARMED, "vehicle_status", ("arming_state",), lambda state: np.where(state == ARMED_STATE, 1.0, 0.0)),
)
_GPS_TOPICS = ("vehicle_gps_position", "sensor_gps")
TOPICS = sorted({row.table for row in _ROWS} - {ACCELEROMETER} | set(_GPS_TOPICS))


def read_ulog(path: Path) -> Log:
    """Read a ULog of PX4. Profile "px4-log". Of several instances of a topic, the first.

    ACTUATOR has one column per motor where the log has the topic actuator_motors, and otherwise one per output up to
    the last that moves. HEIGHT is above the origin of the local position, which PX4 sets where it starts. Raises
    InputError for a file that is unreadable, of another kind, damaged beyond use, or without a known signal.
    """
    data = read_bytes(path)
    digest = hashlib.sha256(data).hexdigest()
    with usable_as("ULog", path):
        content, parameters, notes = _content(data)
        del data
        topics = _tables(content)
        found = read_rows(_ROWS, topics.values())
        if not found:
            raise InputError("no record of a known signal; check what the logger was set to record")
    series = tuple(found.values())
    motors = Signal.ACTUATOR in found and "actuator_motors" in topics
    started_ns, kind = _started_ns(topics, series), _mav_type(topics, parameters)
    return Log(path.name, digest, PROFILE, Telemetry(series), started_ns, notes, parameters, motors, kind)


class _Metered(io.BytesIO):
    """A file in memory that may be read only so much: after some damage pyulog steps back for ever.

    since: where the last step led; from there on the messages were read one after the other.
    """

    def __init__(self, data: bytes, log: ULog) -> None:
        super().__init__(data)
        self._data, self._log = data, log
        self._left = READ_ALLOWANCE * len(data)
        self._checked: list[ULog.MessageFormat] = []
        self.since = HEAD_BYTES

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """As of any file. Raises InputError when the allowance is used up, or for messages that are too large.

        pyulog steps back to the first subscription or text and expands the definitions afterwards: they are checked
        before, if there are others than at the last check.
        """
        self._left -= self.tell() - self.since + 1
        self.since = super().seek(offset, whence)
        if self._data[self.since + 2 : self.since + 3] in DEFINITIONS_END:
            formats = list(self._log.message_formats.values())
            self._left -= len(formats) // COMPARED_AT_ONCE
            if formats != self._checked:
                self._checked = formats
                self._left -= sum(len(message.fields) for message in formats)
                _check_definitions(self._log)
        if self._left < 0:
            raise InputError("it is damaged beyond use; download the log again")
        return self.since


class _Reading(ULog):
    """pyulog's reader of the topics of interest from a file in memory, within the bounds that damaged files need."""

    def __init__(self, data: bytes) -> None:
        file = _Metered(data, self)
        super().__init__(file, list(TOPICS))
        _check_definitions(self)
        start, last = file.since, len(data) - HEADER_BYTES
        while start <= last:
            start += HEADER_BYTES + data[start] + (data[start + 1] << 8)
        self.cut_short = start != len(data)  # it ends behind the end of the file, or within a header before it


def _content(data: bytes) -> tuple[Mapping[str, ULog.Data], dict[str, float], tuple[str, ...]]:
    """The topics of interest by name, the last value of each parameter, and what is wrong with the file."""
    try:
        with redirect_stdout(io.StringIO()):  # pyulog prints its warnings
            log = _Reading(_without_holes(data))
    except _PARSER_ERRORS as error:
        raise InputError(f"it is damaged ({' '.join(str(error).split())}); download the log again") from error
    found: dict[str, ULog.Data] = {}
    for item in log.data_list:  # sorted by name and instance
        found.setdefault(item.name, item)
    told = (*log.initial_parameters.items(), *((name, value) for _, name, value in log.changed_parameters))
    values = {name: float(value) for name, value in told if isinstance(value, int | float)}  # damaged ones are bytes
    parameters = {name: value for name, value in values.items() if isfinite(value)}  # PX4 has NaN for "not set"
    damaged = ["parts of it are damaged and were skipped"] if log.file_corruption else []
    cut = ["it ends within a message: the recording was cut off"] if log.cut_short else []
    return found, parameters, (*damaged, *cut)


def _without_holes(data: bytes) -> bytes:
    """The file with its long runs of zeros shortened, not below any message: pyulog goes through them byte by byte."""
    whole = len(data) // BLOCK_BYTES
    filled = np.frombuffer(data, np.uint64, whole * BLOCK_BYTES // 8).reshape(whole, BLOCK_BYTES // 8).any(axis=1)
    since = np.arange(whole) - np.maximum.accumulate(np.where(filled, np.arange(whole), -1))  # zero blocks up to here
    kept = np.append(since <= ZERO_BLOCKS, [True])
    if kept.all():
        return data
    edges = np.flatnonzero(np.diff(kept, prepend=False, append=False)) * BLOCK_BYTES
    return b"".join(data[first:stop] for first, stop in edges.reshape(-1, 2).tolist())


def _check_definitions(log: ULog) -> None:
    """Refuse messages that are declared too large to exist, before pyulog expands them field by field."""
    sizes: dict[str, int] = {}

    def fields_of(name: str, depth: int) -> int:
        if depth > MAX_NESTING:
            raise InputError(f"it declares the message {name[:32]!r} within itself; download the log again")
        if name not in sizes:
            parts = [(max(1, count), kind) for kind, count, _ in log.message_formats[name].fields]
            inner = (fields_of(kind, depth + 1) if kind in log.message_formats else 1 for _, kind in parts)
            sizes[name] = sum(count * size for (count, _), size in zip(parts, inner, strict=True))
        if sizes[name] > MAX_FIELDS:
            raise InputError(f"it declares the message {name[:32]!r} with too many fields; download the log again")
        return sizes[name]

    for name in log.message_formats:
        fields_of(name, 0)


def _tables(content: Mapping[str, ULog.Data]) -> dict[str, Table]:
    """The topics by name, with the time of the sample where they tell it. A sample that was never taken is left out."""
    found = {name: Table(name, None, item.data) for name, item in content.items()}
    sensors = found.get("sensor_combined")
    if sensors is not None:
        found[ACCELEROMETER] = replace(sensors, name=ACCELEROMETER)
    for name, table in found.items():
        time_us, sample_us = table.integers("timestamp"), table.integers("timestamp_sample")
        if time_us is not None and sample_us is not None:
            time_us = np.where(sample_us > 0, sample_us, time_us)  # some drivers leave it 0
        late = table.integers("accelerometer_timestamp_relative") if name == ACCELEROMETER else None
        if time_us is not None and late is not None:
            time_us = np.where(late == NO_ACCELEROMETER, 0, time_us + late)
        if time_us is None:
            continue
        known = (time_us > 0) & (time_us < MAX_TIME_US)  # a topic that was never published is stamped 0
        fields = table.fields if known.all() else {label: stored[known] for label, stored in table.fields.items()}
        found[name] = replace(table, t_ns=time_us[known] * NS_PER_US, fields=fields)
    return found


def _mav_type(topics: Mapping[str, Table], parameters: Mapping[str, float]) -> int | None:
    """MAV_TYPE as most of the vehicle's states tell it, or by its parameter; None where the log does not say."""
    told = topics["vehicle_status"].integers("system_type") if "vehicle_status" in topics else None
    if told is None or not len(told):
        return int(parameters["MAV_TYPE"]) if "MAV_TYPE" in parameters else None
    return int(Counter(told.tolist()).most_common(1)[0][0])


def _started_ns(topics: Mapping[str, Table], series: tuple[Series, ...]) -> int:
    """Unix time of the first sample [ns], by the first GPS time; 0 if there is none."""
    gps = next((topics[name] for name in _GPS_TOPICS if name in topics), None)
    utc, boot = (None, None) if gps is None else map(gps.integers, ("time_utc_usec", "timestamp"))
    if utc is None or boot is None:
        return 0
    known = np.flatnonzero((utc < MAX_TIME_US) & (utc - boot > EARLIEST_NS // NS_PER_US))
    return int((utc - boot)[known[0]]) * NS_PER_US + Telemetry(series).first_ns if len(known) else 0


KIND = LogKind(
    "ULog", lambda head: head.startswith(SIGNATURE), lambda path, *_: read_ulog(path), (PROFILE,), RECORDED_GATE
)
