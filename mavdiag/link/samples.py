"""Frames to telemetry in SI and FRD, by one table: what each message means, and how its fields become signals.

A new message is a row of `SOURCES`, and its number in `mavdiag.link.messages.MessageId`. When a frame was is in
`clock`. One compiled loop takes the frames of a vehicle in order of arrival; how they are cut into blocks does not
matter.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from struct import calcsize
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import allocating, cached, inline, jit
from mavdiag.link.backlog import Backlog
from mavdiag.link.clock import MS_32, NEVER, REBOOT, US_32, US_64, Counter, VehicleTime, stamp
from mavdiag.link.codec import AUTOPILOT, MSGIDS, ROWS, Decoder, Encoder, Frame, Frames, anywhere, frames_of, layout_of
from mavdiag.link.datagrams import Bytes
from mavdiag.link.messages import MavType, MessageId, ModeFlag, TargetMask
from mavdiag.link.parameters import drives_dshot
from mavdiag.link.profiles import PROFILES, Profile
from mavdiag.storage import Column, forget
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_S, RPM

Words: TypeAlias = IntArray  # 8 bytes each, one at every byte
Laid: TypeAlias = tuple[Bytes, Words, Any]  # bytes, words at every one of them, and records or numbers in them
Table: TypeAlias = tuple[NDArray[np.int16], Any, Any, IntArray]
Memory: TypeAlias = tuple[tuple[Any, Any, Any, Any], Any]
Filled: TypeAlias = tuple[IntArray, IntArray, FloatArray, IntArray]

# Columns of ACTUATOR and of ROTOR_SPEED, always: unused outputs are 0, rotors never reported NaN.
ACTUATORS = ROTORS = 16
PAYLOAD_BYTES = 255 + 8  # room for any, and to read a word at its last byte
UNKNOWN_MV = 0xFFFF  # SYS_STATUS.voltage_battery: not sent
LEAST_US, MOST_US = 1000.0, 2000.0  # PWM for 0 and full output
PULSE_LEAST_US = 800.0  # no pulse is shorter (PX4, pwm_out/module.yaml: the least of PWM_MAIN_DISn)
DSHOT_FULL = 1999.0  # 0 when disarmed, then from 1 on (PX4, DShot.h: DSHOT_MAX_THROTTLE)
SQUARED = (1e-2, 1e2)  # length of a quaternion, squared: beyond it is none, but a damaged frame with a right checksum
SHOWN, TOLD = 1, 2  # how outputs are known to be DShot: one showed it, or a parameter tells it (bits)
DISARMED_NS = 3 * NS_PER_S // 2  # without an armed heartbeat before a disarmed one is believed: they come each second
LARGE = 10_000  # rows: beyond it signals share times
BODY_RATE_BITS = TargetMask.BODY_ROLL_RATE | TargetMask.BODY_PITCH_RATE | TargetMask.BODY_YAW_RATE


class Form(IntEnum):
    """How fields become the columns of a signal."""

    VECTOR = 0  # a number each, times a unit
    ANGLES = 1  # roll, pitch and yaw of a quaternion
    PULSES = 2  # shares of the profile's span of pulses, in two groups of eight
    OUTPUTS = 3  # shares of an output whose unit the values so far tell
    ROTORS = 4  # four rotors; what the message leaves out keeps its last value
    VOLTAGE = 5  # millivolts
    ARMED = 6  # a flag of a vehicle's heartbeat


@dataclass(frozen=True, slots=True)
class Part:
    """One signal of a message."""

    signal: Signal
    first: str  # its first field; the others of the same type stand behind it
    form: Form = Form.VECTOR
    unit: float | str = 1.0  # of one count, or the name of that of the profile
    unless: tuple[str, int] | None = None  # field and bits: a row with any of them is without the signal
    beside: str | int = 0  # another field that the form needs; of `ROTORS` maybe the number of the first rotor


@dataclass(frozen=True, slots=True)
class Source:
    """One message that is read, and the signals in it."""

    message: int
    parts: tuple[Part, ...]
    time: tuple[str, Counter] | None = None  # the field that counts time, and how
    chosen_by: int | None = None  # it is read by the profiles that use this message; None for all profiles


_M, _S = MessageId, Signal
_BOOT_MS, _USEC, _USEC_32 = ("time_boot_ms", MS_32), ("time_usec", US_64), ("time_usec", US_32)
_ATTITUDE = Part(_S.ATTITUDE, "roll")
_TARGETS = (
    Part(_S.ATTITUDE_SETPOINT, "q", Form.ANGLES, unless=("type_mask", TargetMask.ATTITUDE)),
    Part(_S.RATE_SETPOINT, "body_roll_rate", unless=("type_mask", BODY_RATE_BITS)),
    Part(_S.THRUST_SETPOINT, "thrust", unless=("type_mask", TargetMask.THROTTLE)),
)
_PULSES = Part(_S.ACTUATOR, "servo1_raw", Form.PULSES, unless=("port", 0xFF), beside="servo9_raw")
_OUTPUTS = Part(_S.ACTUATOR, "actuator", Form.OUTPUTS)
_ESCS = (_M.ESC_TELEMETRY_1_TO_4, _M.ESC_TELEMETRY_5_TO_8, _M.ESC_TELEMETRY_9_TO_12)


def _imu(message: MessageId, time: tuple[str, Counter], unless: tuple[str, int] | None = None) -> Source:
    rate = Part(_S.BODY_RATE, "xgyro", unit="gyro_unit", unless=unless)
    force = Part(_S.SPECIFIC_FORCE, "xacc", unit="accel_unit", unless=unless)
    return Source(message, (rate, force), time, chosen_by=message)


def _speeds(beside: str | int) -> tuple[Part, ...]:
    return (Part(_S.ROTOR_SPEED, "rpm", Form.ROTORS, RPM, beside=beside),)


#: Every message that is read, in any profile. Where several sensors are numbered in one message, the first is read.
SOURCES: tuple[Source, ...] = (
    Source(_M.ATTITUDE_TARGET, _TARGETS, _BOOT_MS, _M.ATTITUDE_TARGET),
    _imu(_M.RAW_IMU, _USEC, ("id", 0xFF)),
    _imu(_M.SCALED_IMU, _BOOT_MS),
    _imu(_M.SCALED_IMU2, _BOOT_MS),
    _imu(_M.SCALED_IMU3, _BOOT_MS),
    _imu(_M.HIGHRES_IMU, _USEC, ("id", 0xFF)),
    Source(_M.ATTITUDE, (_ATTITUDE,), _BOOT_MS),
    # In place of the row above, where the gyro is read from it too.
    Source(_M.ATTITUDE, (_ATTITUDE, Part(_S.BODY_RATE, "rollspeed")), _BOOT_MS, _M.ATTITUDE),
    Source(_M.LOCAL_POSITION_NED, (Part(_S.HEIGHT, "z", unit=-1.0), Part(_S.POSITION, "x")), _BOOT_MS),
    Source(_M.GLOBAL_POSITION_INT, (Part(_S.COORDINATES, "lat", unit=1e-7 * DEG),), _BOOT_MS),
    Source(_M.SYS_STATUS, (Part(_S.VOLTAGE, "voltage_battery", Form.VOLTAGE, 1e-3),)),
    Source(_M.HEARTBEAT, (Part(_S.ARMED, "base_mode", Form.ARMED, beside="type"), Part(_S.MODE, "custom_mode"))),
    Source(_M.SERVO_OUTPUT_RAW, (_PULSES,), _USEC_32, _M.SERVO_OUTPUT_RAW),
    Source(_M.ACTUATOR_OUTPUT_STATUS, (_OUTPUTS,), _USEC, _M.ACTUATOR_OUTPUT_STATUS),
    Source(_M.VIBRATION, (Part(_S.VIBRATION, "vibration_x"),), _USEC, _M.VIBRATION),
    Source(_M.ESC_STATUS, _speeds("index"), _USEC, _M.ESC_STATUS),
    *(Source(message, _speeds(4 * k), chosen_by=_ESCS[0]) for k, message in enumerate(_ESCS)),
)

_SIGNALS, _NO_TIMES = tuple(Signal), np.empty(0, np.int64)
_COLUMNS = [signal.width or ACTUATORS for signal in _SIGNALS]
_WIDTHS = np.array(_COLUMNS)


def sources(profile: Profile, table: Iterable[Source] = SOURCES) -> tuple[Source, ...]:
    """The rows of the table that a profile reads; of two for one message the later one counts."""
    read = (row for row in table if row.chosen_by is None or row.chosen_by in profile.messages)
    return tuple({row.message: row for row in read}.values())


# What one vehicle's conversion carries on: the rotors' latest known speeds [rad/s], NaN for unknown; when the latest
# armed heartbeat was received; disarmed ones amid armed ones, left out; and how its outputs are known to be DShot.
_MEMORY = np.dtype([("speeds", "f8", ROTORS), *((name, "i8") for name in ("armed_ns", "contrary", "dshot"))])
# Of a message: bytes of its payload, `Counter`, place of its count and the bits of this in a word, and its parts.
_SOURCE = np.dtype([(name, "i8") for name in ("length", "tick", "turn", "at", "mask", "first", "last")])
# `Part`, with places in the payload; a rotor's number beside it is negative. kind 16: signed, 32: floating.
_INDEXES = ("signal", "form", "at", "kind", "size", "mask", "width", "hidden", "bits", "beside")
_PART = np.dtype([*((name, "i8") for name in _INDEXES), ("unit", "f8"), ("zero", "f8")])
_KINDS = {"f": 32, "h": 16, "i": 16}


class SampleState:
    """What one vehicle's conversion carries from block to block: where its time stands, and the record above."""

    def __init__(self) -> None:
        self.timeline, self.memory = VehicleTime(), np.zeros(1, _MEMORY)
        self.memory["speeds"], self.memory["armed_ns"] = np.nan, NEVER

    def take_parameters(self, parameters: Mapping[str, float]) -> None:
        """Take in what the autopilot's parameters tell of its outputs."""
        self.memory["dshot"] |= TOLD * drives_dshot(parameters)

    @property
    def contrary(self) -> int:
        """Disarmed heartbeats amid armed ones, left out so far."""
        return int(self.memory["contrary"][0])


class SampleDecoder:
    """Turns one vehicle's frames into telemetry, by its profile. Holds nothing but the profile; the state is passed.

    table: the messages that are known. wanted: the message ids that it reads, for the decoder of frames.
    Only the autopilot's own frames (component 1) count. Raises UsageError for a row whose message has no such fields.
    """

    def __init__(self, profile: Profile, table: Iterable[Source] = SOURCES) -> None:
        self.profile = profile
        read = sources(profile, table)
        self.wanted = frozenset(row.message for row in read)
        lookup = np.full(len(MSGIDS), -1, np.int16)
        lookup[[ROWS[row.message] for row in read]] = np.arange(len(read))
        ends = np.cumsum([0, *(len(row.parts) for row in read)]).tolist()
        rows = np.array([(*_counted(row), *ends[k : k + 2]) for k, row in enumerate(read)], _SOURCE)
        parts = np.array([_laid(profile, row.message, part) for row in read for part in row.parts], _PART)
        self._table, payload = (lookup, rows, parts, _WIDTHS), np.zeros(PAYLOAD_BYTES, np.uint8)
        self._payload = payload, anywhere(payload, "<i8"), anywhere(payload, "<f4")  # room for the one that is read

    def step(self, state: SampleState, frames: Sequence[Frame] | Frames, given_ns: IntArray = _NO_TIMES) -> Telemetry:
        """Take the next frames of one vehicle, in order of arrival, and bring its state on, in place.

        given_ns: (n,) their vehicle times, if known.
        """
        some, memory = frames_of(frames), (state.timeline.records, state.memory)
        columns = some.data, anywhere(some.data, "<i8"), some.rows
        t_ns, host_ns, values, filled = _convert(columns, given_ns, self._table, memory, self._payload)
        series = []
        for signal, width, (first, place, count) in zip(_SIGNALS, _COLUMNS, filled.tolist(), strict=True):
            if count:
                block = values[place : place + count * width].reshape(count, width)
                series.append(Series(signal, t_ns[first : first + count], host_ns[first : first + count], block))
        return Telemetry(tuple(series))


def _counted(row: Source) -> tuple[int, ...]:
    layout = layout_of(row.message)
    if row.time is None:
        return (layout.packer.size, 0, 0, 0, 0)
    (name, counter), size = row.time, layout.packer.size
    at, code = layout.offset(name)
    return (size, counter.tick_ns, counter.turn, at, _mask(calcsize("<" + code)))


def _mask(size: int) -> int:
    """The bits of a number of so many bytes in a word of 8."""
    return -1 if size == 8 else (1 << 8 * size) - 1


def _laid(profile: Profile, msgid: int, part: Part) -> tuple[float, ...]:
    layout, number = layout_of(msgid), _SIGNALS.index(part.signal)
    at, code = layout.offset(part.first)
    hidden, bits = (layout.offset(part.unless[0])[0], part.unless[1]) if part.unless else (0, 0)
    beside = layout.offset(part.beside)[0] if isinstance(part.beside, str) else -1 - part.beside
    low, high = profile.actuator_span if part.form is Form.PULSES else (0.0, 1.0)
    unit = getattr(profile, part.unit) if isinstance(part.unit, str) else part.unit / (high - low)
    kind, size = _KINDS.get(code, 0), calcsize("<" + code)
    return (number, part.form, at, kind, size, _mask(size), _COLUMNS[number], hidden, bits, beside, unit, low)


def warm() -> None:
    """Compile what finds and converts frames, or load it from disk, before the first comes: seconds, or half of one."""
    backlog = Backlog()
    backlog.put(Decoder().feed(Encoder(1, 1).encode(MessageId.HEARTBEAT), 0))
    SampleDecoder(PROFILES["qdrone2"]).step(SampleState(), backlog.take(1))
    euler_angles(np.empty((0, 4)))


def joined(pieces: Iterable[Telemetry]) -> Telemetry:
    """One telemetry from consecutive pieces: each signal's rows, end to end; long columns that are the same are shared.

    An iterator's pieces are given up one by one, and long columns lie in files: memory holds nothing twice.
    """
    columns, alone = dict[Signal, list[Column]](), Telemetry()
    for number, piece in enumerate(pieces):
        for series in (*alone.series, *piece.series) if number else ():
            arrays = (series.t_ns, series.host_ns, series.values)
            if series.signal not in columns:
                columns[series.signal] = [Column(one) for one in arrays]
            for column, more in zip(columns[series.signal], arrays, strict=True):
                column.add(more)
        alone = Telemetry() if number else piece
    if not columns:
        return alone
    found, known = list[Series](), list[NDArray[Any]]()
    for signal in (one for one in Signal if one in columns):
        found.append(Series(signal, *(_shared(one.whole(), known) for one in columns.pop(signal))))
    return Telemetry(tuple(found))


def _shared(like: NDArray[Any], known: list[NDArray[Any]]) -> NDArray[Any]:
    """An array that is the same, if there is one; few rows are not looked for."""
    if len(like) <= LARGE:
        return like
    alike = (one for one in known if np.array_equal(one[:LARGE], like[:LARGE]))
    found = next((one for one in alike if np.array_equal(one, like)), like)
    known += [like] if found is like else []
    forget(*known)
    return found


@cached
def euler_angles(q: FloatArray) -> FloatArray:
    """Roll, pitch, yaw [rad], (n, 3), of quaternions w, x, y, z (n, 4); NaN for a length outside of 0.1 to 10.

    Body to world, order z-y-x. The length of q does not matter.
    """
    angles = np.empty((len(q), 3))
    for k in range(len(q)):
        angles[k, 0], angles[k, 1], angles[k, 2] = _angles(q[k, 0], q[k, 1], q[k, 2], q[k, 3])
    return angles


@jit
def _angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    squared = ww + xx + yy + zz
    if not (squared > SQUARED[0] and squared < SQUARED[1]):
        return np.nan, np.nan, np.nan
    sine, cosine = 2.0 * (w * x + y * z), ww - xx - yy + zz
    pitch = math.atan2(2.0 * (w * y - x * z), math.hypot(sine, cosine))
    return math.atan2(sine, cosine), pitch, math.atan2(2.0 * (w * z + x * y), ww + xx - yy - zz)


@jit
def _number(words: Words, floats: Any, at: int, part: Any) -> float:
    if part.kind == 32:
        return np.float64(floats[at])
    value = words[at] & part.mask
    return np.float64(value - (part.mask + 1 if part.kind == 16 and value > part.mask >> 1 else 0))


@jit
def _pulses(words: Words, part: Any, out: FloatArray) -> None:
    for k in range(ACTUATORS):
        at = part.at + 2 * k if k < 8 else part.beside + 2 * (k - 8)
        out[k] = min(max(((words[at] & part.mask) - part.zero) * part.unit, 0.0), 1.0)


def shows_dshot(output: Any) -> Any:
    """Whether an output, or each of an array, is too low for a pulse and no share: as DShot is when it idles."""
    return (output > 1.0) & (output < PULSE_LEAST_US)


_shows_dshot = jit(shows_dshot)


@jit
def _outputs(words: Words, floats: Any, part: Any, memory: Any, out: FloatArray) -> None:
    """PX4 sends what its driver gets, and no unit. An unused output may be 0 with any.

    DShot where a parameter tells it, or since one showed it; else nothing above 1: shares, as in simulation; else PWM.
    """
    highest, low, span = 0.0, LEAST_US, MOST_US - LEAST_US
    for k in range(ACTUATORS):
        out[k] = _number(words, floats, part.at + 4 * k, part)
        out[k] = out[k] if math.isfinite(out[k]) else 0.0
        highest = max(highest, out[k])
        memory.dshot |= SHOWN * int(_shows_dshot(out[k]))
    if memory.dshot or highest <= 1.0:
        low, span = 0.0, DSHOT_FULL if memory.dshot else 1.0
    for k in range(ACTUATORS):
        out[k] = min(max((out[k] - low) / span, 0.0), 1.0)


@jit
def _rotors(words: Words, floats: Any, part: Any, memory: Any, out: FloatArray) -> bool:
    """Four rotors; returns whether there are such. `ESC_STATUS` tells the first of them by its index."""
    first = words[part.beside] & 0xFF if part.beside >= 0 else -1 - part.beside
    for k in range(min(4, ROTORS - first)):
        memory.speeds[first + k] = part.unit * abs(_number(words, floats, part.at + part.size * k, part))
    for k in range(ROTORS):
        out[k] = memory.speeds[k]
    return bool(first < ROTORS)


@jit
def _heartbeat(words: Words, part: Any, host_ns: int, memory: Any, out: FloatArray) -> bool:
    """Whether a heartbeat is a vehicle's, and is believed: a disarmed one amid armed ones is another sender's."""
    kind, armed = words[part.beside] & 0xFF, words[part.at] & _ARMED > 0
    if kind in (_GCS, _COMPUTER):
        return False
    out[0] = 1.0 if armed else 0.0
    if armed:
        memory.armed_ns = host_ns
    doubted = not armed and memory.armed_ns > NEVER and abs(host_ns - memory.armed_ns) < DISARMED_NS
    memory.contrary += int(doubted)
    return not doubted


@inline
def _filled(words: Words, floats: Any, part: Any, host_ns: int, memory: Any, out: FloatArray) -> bool:
    """Whether a part of a frame is meant and sound; then its values are in `out`."""
    if words[part.hidden] & part.bits:
        return False
    if part.form == Form.ROTORS:
        return _rotors(words, floats, part, memory, out)
    if part.form == Form.ARMED:
        return _heartbeat(words, part, host_ns, memory, out)
    if part.form == Form.VOLTAGE and words[part.at] & part.mask == UNKNOWN_MV:
        return False
    sound = True
    if part.form == Form.ANGLES:
        at, one = part.at, np.float64(1.0)  # not in single precision
        q = one * floats[at], one * floats[at + 4], one * floats[at + 8], one * floats[at + 12]
        out[0], out[1], out[2] = _angles(q[0], q[1], q[2], q[3])
        sound = math.isfinite(out[0])
    elif part.form == Form.PULSES:
        _pulses(words, part, out)
    elif part.form == Form.OUTPUTS:
        _outputs(words, floats, part, memory, out)
    else:
        for k in range(part.width):
            out[k] = part.unit * _number(words, floats, part.at + part.size * k, part)
            sound = sound and math.isfinite(out[k])
    return sound


_GCS, _COMPUTER, _ARMED = int(MavType.GCS), int(MavType.ONBOARD_CONTROLLER), int(ModeFlag.SAFETY_ARMED)


@allocating
def _room(rows: NDArray[Any], lookup: NDArray[np.int16], sources: Any, parts: Any, widths: IntArray) -> IntArray:
    """Where the rows and the values of each signal begin, and how many there may be."""
    room = np.zeros((len(widths), 3), np.int64)
    for k in range(len(rows)):
        source = lookup[rows[k].row]
        if source >= 0 and rows[k].sender & 0xFF == AUTOPILOT:
            for p in range(sources[source].first, sources[source].last):
                room[parts[p].signal, 2] += 1
    for signal in range(1, len(widths)):
        room[signal, 0] = room[signal - 1, 0] + room[signal - 1, 2]
        room[signal, 1] = room[signal - 1, 1] + room[signal - 1, 2] * widths[signal - 1]
    return room


@cached
def _convert(frames: Laid, given_ns: IntArray, table: Table, memory: Memory, payload: Laid) -> Filled:
    """Times, times of arrival and values of all signals; and where each one's rows and values begin, and how many."""
    lookup, sources, parts, widths = table
    filled = _room(frames[2], lookup, sources, parts, widths)
    room = filled[-1, 0] + filled[-1, 2]
    t_ns, host_ns = np.empty(room, np.int64), np.empty(room, np.int64)
    values = np.empty(filled[-1, 1] + filled[-1, 2] * widths[-1])
    filled[:, 2] = 0
    _fill(frames, given_ns, table, memory, payload, (t_ns, host_ns, values, filled))
    return t_ns, host_ns, values, filled


@jit
def _fill(frames: Laid, given_ns: IntArray, table: Table, memory: Memory, payload: Laid, signals: Filled) -> None:
    rows, (lookup, sources, parts, _), (time, own) = frames[2], table, (memory[0], memory[1][0])
    (t_ns, host_ns, values, filled), k = signals, 0
    while k < len(rows):
        frame, k = rows[k], k + 1
        if lookup[frame.row] < 0 or frame.sender & 0xFF != AUTOPILOT:
            continue
        source = sources[lookup[frame.row]]
        _lay(frames[0], frames[1], frame.body, min(frame.stop - frame.body, source.length), source.length, payload)
        if len(given_ns):
            at_ns, own.armed_ns = given_ns[k - 1], NEVER  # of one sender: no heartbeat is doubted
        else:
            count = payload[1][source.at] & source.mask
            at_ns = stamp(time, frame.row, source.tick, source.turn, count, frame.host_ns)
        if at_ns == REBOOT:
            own.speeds[:], own.armed_ns, own.dshot, k = np.nan, NEVER, own.dshot & TOLD, k - 1
        for p in range(source.first, source.last if at_ns > NEVER else source.first):
            part, done = parts[p], filled[parts[p].signal]
            place, row = done[1] + done[2] * part.width, done[0] + done[2]
            out = values[place : place + part.width]
            if _filled(payload[1], payload[2], part, frame.host_ns, own, out):
                t_ns[row], host_ns[row] = at_ns, frame.host_ns
                done[2] += 1


@inline
def _lay(data: Bytes, words: Words, begin: int, size: int, length: int, payload: Laid) -> None:
    """Copy a payload to where its numbers are read. size: of it; up to its length the zeros behind it were trimmed."""
    for k in range(0, length, 8):
        payload[1][k] = 0
    for k in range(0, size - 7, 8):
        payload[1][k] = words[begin + k]
    for k in range(size & ~7, size):
        payload[0][k] = data[begin + k]
