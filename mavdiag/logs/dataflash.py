"""ArduPilot DataFlash logs (.bin): the messages of any era become one vehicle's telemetry, in SI and FRD.

Every record is A3 95, a type byte and a body. Records of type 0x80 (FMT) give each type its length, its name, a format
of one character per field, and the fields' labels; a type keeps its first sound definition, for a later one is damage.
The type's length tells where the next record begins. After damage the chain resumes at the next A3 95 of a known type;
a last record that is cut short is dropped. Records carry no checksum: a flipped bit in a value is a wrong value.

Eras differ: `TimeMS` or `TimeUS`, `IMU2` or an instance field, centi-degrees or degrees per second in RATE. Each is
decided from the file itself.
"""

import hashlib
import math
import re
import struct
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.airframe.parameters import COPTER_MOTORS, output_functions
from mavdiag.errors import InputError
from mavdiag.jit import cached
from mavdiag.logs.log import MAX_TIME_US, RECORDED_GATE, LogKind, Row, Table, gather, read_rows, recorded, windows_of
from mavdiag.telemetry import Batch, BoolArray, FloatArray, IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_MS, NS_PER_S, NS_PER_US, RPM

PROFILE = "ardupilot-log"
SIGNATURE = b"\xa3\x95\x80\x80"  # the format record of the format message comes first
MIN_HEADERS = 8  # of records in the first 4096 bytes: no record is longer than 255 (our choice)
CENTIDEGREE_OUTPUT = 4500.0  # full scale of ROut, POut, YOut up to Copter 3.3
THROTTLE_PER_MILLE = 1e-3  # ThrOut up to Copter 3.3 is 0..1000
CENTIVOLT = 0.01  # CURR.Volt where it is an integer
PWM_ZERO_US, PWM_SPAN_US = 1000.0, 1000.0
MAX_CHANNELS = 14  # of RCOU
ACCELEROMETER = 0  # ISBH.type
ESC_HOLDS_S = 1.5  # the last speed of an ESC counts so long (our choice, as of a live one in `rows.align`)
ESC_SAYS = {1 << 2: "an alert", 1 << 3: "a warning", 1 << 4: "an error"}  # EDT2.Status (AP_ESC_Telem, log_Edt2_Status)
EVENT_ARMED, EVENT_DISARMED = 10, 11

GPS_EPOCH_UNIX_S = 315_964_800
WEEK_S = 604_800
LEAP_SECONDS = ((1930, 18), (1851, 17), (1695, 16))  # GPS - UTC from this GPS week on (IERS bulletin C), to the week
GPS_FIX_3D = 3

HEADER = b"\xa3\x95"
HEADER_BYTES = 3
FMT_TYPE = 0x80
FMT_BODY = struct.Struct("<BB4s16s64s")  # type, length, name, format, labels
FMT_BYTES = HEADER_BYTES + FMT_BODY.size

# Format characters (ArduPilot, AP_Logger/LogStructure.h): numpy layout, and what a stored unit is worth.
_LAYOUTS = {
    "a": "(32,)<i2", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "M": "u1",
    "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
}  # fmt: skip
_SIZES = {character: np.dtype(layout).itemsize for character, layout in _LAYOUTS.items()}
_MULTIPLIERS = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
_TIMES = {"TimeUS": NS_PER_US, "TimeMS": NS_PER_MS}
_INSTANCES = ("I", "IMU", "Inst", "Instance")
_ESCS = tuple(f"ESC{n}" for n in range(1, 13))  # a message of each, before Copter 4.1
_OF_ROTORS = ("ESC", "EDT2", "RPM")

#: The messages by name; one without time or fields for each that is absent.
Tables: TypeAlias = defaultdict[str, Table]


class Format(NamedTuple):
    """One message type: length of a record with its header, name, and a character and a label for each field."""

    length: int
    name: str
    characters: str
    labels: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether the characters add up to the length. Records of a type that is not are stepped over, not read."""
        sizes = [_SIZES.get(character, 256) for character in self.characters]  # too much if unknown
        return HEADER_BYTES + sum(sizes) == self.length and len(self.labels) == len(self.characters)

    def layout(self) -> np.dtype[np.void]:
        """A record as numpy has it, fields f0, f1, … by label. Only of a sound type."""
        fields = [(f"f{i}", _LAYOUTS[character]) for i, character in enumerate(self.characters)]
        return np.dtype([("header", f"V{HEADER_BYTES}"), *fields])


def table_of(form: Format, starts: IntArray, records: NDArray[np.void]) -> Table:
    """The records of one type; of those that carry the instance of a sensor, only those of the lowest one.

    Of those that tell of several rotors (`_OF_ROTORS`), all.
    """
    fields = {label: records[f"f{place}"] for place, label in enumerate(form.labels)}
    units = {label: _MULTIPLIERS.get(c) for label, c in zip(form.labels, form.characters, strict=True)}
    table = Table(form.name, None, fields, {label: unit for label, unit in units.items() if unit}, starts)
    instance = next((found for found in map(table.integers, _INSTANCES) if found is not None), None)
    if instance is not None and form.name not in _OF_ROTORS and (instance != instance.min()).any():
        first = instance == instance.min()
        whole = records.view(f"V{records.itemsize}")  # copied in one piece each, not field by field
        return table_of(form, starts[first], whole[first].view(records.dtype))
    stamps = ((table.integers(label), unit_ns) for label, unit_ns in _TIMES.items())
    return replace(table, t_ns=next((stamp * unit_ns for stamp, unit_ns in stamps if stamp is not None), None))


class Walk:
    """The records of the wanted messages, taken from a file that is fed piece by piece. wanted: their names."""

    def __init__(self, wanted: Collection[str]) -> None:
        self._wanted = wanted
        self.formats: dict[int, Format] = {}
        self._lengths = np.zeros(256, np.int64)  # by type; 0 for unknown
        self._lengths[FMT_TYPE] = FMT_BYTES
        self._taken = np.zeros(256, np.bool_)  # whether records of a type are gathered
        # Places in the file (int64) and records, by type, in the order of their declaration. As bytes, for arrays that
        # grow would be held twice.
        self._gathered: dict[int, tuple[bytearray, bytearray]] = {}
        self._base = 0  # place in the file where the present piece starts
        self._carry = b""  # the end of the last piece, where a record may have begun
        self._sound_end = 0  # place in the file behind the last whole record of a known type
        self._sound = 0  # bytes in such records so far
        self._lost = False  # whether anything but padding was behind it

    def feed(self, data: bytes) -> None:
        """Take in the next piece of the file. Never raises on content."""
        data = self._carry + data
        octets, found = np.frombuffer(data, np.uint8), np.empty(len(data) // HEADER_BYTES + 1, np.int64)
        position = count = sound_end = 0
        while True:
            at = _follow(octets, position, self._lengths, self._taken, found[count:])
            position, more, end, sound = at.tolist()
            count, sound_end, self._sound = count + more, max(sound_end, end), self._sound + sound
            if position >= 0:
                break
            position = -position  # behind a declaration
            self._learn(data, position - FMT_BYTES)
        places = found[:count]
        for kind, (starts, records) in self._gathered.items():
            at = places[octets[places + 2] == kind]
            if len(at):
                starts += (at + self._base).data
                records += gather(data, self.formats[kind].layout(), at).view(np.uint8).data
        self._lost = bool(data[sound_end:].strip(b"\0\xff")) or (self._lost and not sound_end)
        self._sound_end = self._base + sound_end if sound_end else self._sound_end
        self._carry = data[position:]
        self._base += position

    def finish(self) -> tuple[Tables, tuple[str, ...]]:
        """The tables by name, and what is wrong with the file, one sentence each.

        Of several instances of a sensor the first is kept; of two types with one name, the first that has records.
        """
        found: Tables = defaultdict(lambda: Table("", None, {}))
        for kind, (starts, records) in self._gathered.items():
            form = self.formats[kind]
            if starts and form.name not in found:
                stored = np.frombuffer(records, form.layout())
                found[form.name] = table_of(form, np.frombuffer(starts, np.int64), stored)
        lost = self._base + len(self._carry) - self._sound_end
        cut = f"it ends within a record, {lost} bytes are lost: the recording was cut off"
        between = self._sound_end - self._sound
        damaged = f"{between} bytes of it are no records of a known type and were skipped"
        return found, tuple(note for note, told in ((damaged, between), (cut, self._lost)) if told)

    def _learn(self, data: bytes, position: int) -> None:
        kind, length, *texts = FMT_BODY.unpack_from(data, position + HEADER_BYTES)
        name, characters, labels = (raw.partition(b"\0")[0].decode("latin-1") for raw in texts)
        form = Format(length, name, characters, tuple(labels.split(",")))
        known = self.formats.get(kind)
        if kind == FMT_TYPE or form.length < HEADER_BYTES or (known is not None and known.sound):
            return
        self.formats[kind], self._lengths[kind] = form, form.length
        if form.name in self._wanted and form.sound:
            self._taken[kind] = True
            self._gathered[kind] = bytearray(), bytearray()


@cached
def _follow(data: NDArray[np.uint8], position: int, lengths: IntArray, taken: BoolArray, found: IntArray) -> IntArray:
    """Follow the chain of records from a place on, up to a declaration or to where a record may go on behind the data.

    found: gets the places of the records that are taken. Returns (4,): where to go on, negative behind a declaration;
    how many were found; behind the last whole record of a known type, or 0; bytes in such records.
    """
    count, end, sound, size = 0, 0, 0, len(data)
    while position <= size - 3:
        if data[position] != 0xA3 or data[position + 1] != 0x95:
            position += 1
            continue
        kind = data[position + 2]
        length = lengths[kind]
        if position + length > size:
            break
        if length == 0:
            position += 1
            continue
        if taken[kind]:
            found[count] = position
            count += 1
        position += length
        sound += length
        end = position
        if kind == 0x80:
            return np.array([-position, count, end, sound])
    while position < size and (data[position] != 0xA3 or (position + 1 < size and data[position + 1] != 0x95)):
        position += 1  # where the next record may begin that the data does not hold whole
    return np.array([position, count, end, sound])


def _wrapped(degrees: FloatArray) -> FloatArray:
    """Angles in -pi..pi, as a quaternion would give them; those already there are left as they are, to the bit."""
    angle = degrees * DEG
    return np.where(np.abs(angle) > math.pi, np.remainder(angle + math.pi, 2 * math.pi) - math.pi, angle)


# The first row of a signal whose message and fields are in the log is taken.
_ROWS = (
    Row(Signal.ATTITUDE_SETPOINT, "ANG", ("DesRoll", "DesPitch", "DesYaw"), _wrapped),  # where it is, ATT has 10 Hz
    Row(Signal.ATTITUDE, "ANG", ("Roll", "Pitch", "Yaw"), _wrapped),
    Row(Signal.ATTITUDE_SETPOINT, "ATT", ("DesRoll", "DesPitch", "DesYaw"), _wrapped),
    Row(Signal.ATTITUDE, "ATT", ("Roll", "Pitch", "Yaw"), _wrapped),
    Row(Signal.BODY_RATE, "IMU", ("GyrX", "GyrY", "GyrZ")),
    Row(Signal.SPECIFIC_FORCE, "IMU", ("AccX", "AccY", "AccZ")),
    Row(Signal.VIBRATION, "VIBE", ("VibeX", "VibeY", "VibeZ")),
    Row(Signal.THRUST_SETPOINT, "CTUN", ("ThO",)),
    Row(Signal.THRUST_SETPOINT, "CTUN", ("ThrOut",), integer_unit=THROTTLE_PER_MILLE),
    Row(Signal.HEIGHT, "POS", ("RelHomeAlt",)),
    Row(Signal.HEIGHT, "CTUN", ("Alt",)),
    Row(Signal.HEIGHT, "BARO", ("Alt",)),
    Row(Signal.MODE, "MODE", ("Mode",)),
    Row(Signal.COORDINATES, "POS", ("Lat", "Lng"), np.deg2rad),
    Row(Signal.VOLTAGE, "BAT", ("Volt",), integer_unit=CENTIVOLT),
    Row(Signal.VOLTAGE, "CURR", ("Volt",), integer_unit=CENTIVOLT),
)
_OTHERS = ["RATE", "RCOU", "PARM", "ARM", "EV", "GPS", "MSG", "ISBH", "ISBD"]
WANTED = frozenset((*(row.table for row in _ROWS), *_OTHERS, *_OF_ROTORS, *_ESCS))

# What the firmware says at its start: "ArduCopter V4.5.6 (bbf0b066)", "APM:Copter V3.3", "Frame: QUAD/X".
_FIRMWARE = re.compile(rb"(?:ardu|apm:|antenna)?(copter|plane|rover|sub|tracker|blimp)[0-9]? V\d", re.IGNORECASE)
_FRAME = re.compile(rb"Frame: ([A-Z0-9_]+)")
_FIRMWARE_TYPES = {b"plane": 1, b"tracker": 5, b"blimp": 7, b"rover": 10, b"sub": 12}  # MAV_TYPE
_ROVER_BOAT, _BOAT = 2, 11  # FRAME_CLASS of a rover that is a boat, and its MAV_TYPE
# MAV_TYPE of a Copter by its FRAME_CLASS (AP_Motors_Class.h), and by the name that older ones log in its place.
_COPTER_TYPES = {1: 2, 2: 13, 3: 14, 4: 14, 5: 13, 6: 4, 7: 15, 8: 3, 9: 3, 11: 4, 12: 29, 13: 4, 14: 35}
_FRAME_CLASSES = {b"QUAD": 1, b"HEXA": 2, b"OCTA": 3, b"OCTA_QUAD": 4, b"Y6": 5, b"HELI": 6, b"TRI": 7, b"SINGLE": 8}


def read_dataflash(path: Path) -> Log:
    """Read a DataFlash log of ArduPilot, of any era that describes itself. Profile "ardupilot-log".

    ACTUATOR has one column per motor, in the order of the SERVOn_FUNCTION parameters where the log has them, and
    otherwise one per output channel up to the last one in use; so has ROTOR_SPEED, for an ESC has the number of its
    output. ARMED has a row a change. Raises InputError for a file that is unreadable, of another kind or empty.
    """
    walk, digest = Walk(WANTED), hashlib.sha256()
    for window in windows_of(path):
        digest.update(window)
        walk.feed(window)
    tables, notes = walk.finish()
    parameters = _parameters(tables)
    functions = output_functions(parameters)
    first = {functions[n]: n for n in sorted(functions, reverse=True) if n <= MAX_CHANNELS}
    motors = [first[wanted] for wanted in COPTER_MOTORS if wanted in first]  # channels by motor; of several the first
    found = read_rows(_ROWS, tables.values())
    loop, outputs = _rate_loop(tables, found.get(Signal.BODY_RATE)), _actuator(tables, motors, functions)
    series = (*found.values(), *loop, *outputs, *_rotor_speeds(tables, motors, parameters), *_armed(tables))
    if not series:
        lost = "its start, which says what its records are (FMT), is missing; take the whole file"
        why = "no record of a known signal; check that logging was on" if walk.formats else lost
        raise InputError(f"{path}: not a usable DataFlash log: {why}")
    named = (path.name, digest.hexdigest(), PROFILE)
    kind = _mav_type(tables["MSG"], parameters)
    told, began_ns = (*notes, *_esc_notes(tables["EDT2"])), _started_ns(tables, series)
    batches = _batches(tables["ISBH"], tables["ISBD"])
    return Log(*named, Telemetry(series), began_ns, told, parameters, bool(motors), kind, batches=batches)


def _rate_loop(tables: Tables, gyro: Series | None) -> tuple[Series, ...]:
    table = tables["RATE"]
    fields = ("RDes", "PDes", "YDes", "ROut", "POut", "YOut", "R", "P", "Y")
    if table.t_ns is None or not table.has(*fields):
        return ()
    unit = _rate_unit(table, table.t_ns, gyro)
    output_unit = 1.0 if unit == DEG else 1 / CENTIDEGREE_OUTPUT
    return (
        recorded(Signal.RATE_SETPOINT, table.t_ns, table.columns(fields[:3]) * unit),
        recorded(Signal.TORQUE_COMMAND, table.t_ns, table.columns(fields[3:6]) * output_unit),
    )


def _rate_unit(table: Table, t_ns: IntArray, gyro: Series | None) -> float:
    """What RATE counts in [rad/s]: degrees per second, or hundredths of them up to Copter 3.3.

    The message repeats the gyro, so the file decides: its mean size against the IMU's over their common span is near
    1 or near 100. Logs with TimeMS all come from the hundredths' era; without an IMU the present unit is assumed.
    """
    if "TimeMS" in table.fields:
        return DEG / 100
    if gyro is None:
        return DEG
    low, high = max(t_ns[0], gyro.t_ns[0]), min(t_ns[-1], gyro.t_ns[-1])
    told = table.columns(("R", "P", "Y"))[(t_ns >= low) & (t_ns <= high)]
    seen = gyro.values[(gyro.t_ns >= low) & (gyro.t_ns <= high)] / DEG
    said, measured = (np.abs(one[np.isfinite(one)]) for one in (told, seen))
    return DEG / 100 if len(said) and len(measured) and said.mean() > 10 * measured.mean() > 0 else DEG


def _actuator(tables: Tables, motors: Sequence[int], functions: Mapping[int, int]) -> tuple[Series, ...]:
    """The motors' outputs from RCOU: (pulse - 1000 us) / 1000 us; 0 for an idle output (0 us) and for no motor's.

    motors: output channels by motor; empty if they are not known. Then those that have a function are no motors.
    """
    table, others = tables["RCOU"], () if motors else tuple(functions)
    prefix = "Ch" if table.has("Ch1") else "C"
    present = [n for n in range(1, MAX_CHANNELS + 1) if table.has(f"{prefix}{n}")]
    channels = [n for n in motors if n in present]
    if not channels:  # nothing says which are motors: every channel up to the last that moves, or gives a pulse
        pulses = {n: table.column(f"{prefix}{n}") for n in present if n not in others}
        moving = [n for n, pulse in pulses.items() if np.ptp(pulse)] or [n for n in pulses if pulses[n].any()]
        channels = [n for n in present if n <= max(moving, default=0)]
    if not channels or table.t_ns is None:
        return ()
    pulse_us = table.columns([f"{prefix}{n}" for n in channels]) * [n not in others for n in channels]
    return (recorded(Signal.ACTUATOR, table.t_ns, np.maximum(pulse_us - PWM_ZERO_US, 0.0) / PWM_SPAN_US),)


def _rotor_speeds(tables: Tables, motors: Sequence[int], parameters: Mapping[str, float]) -> tuple[Series, ...]:
    """The speeds that ESCs tell, by ESC or, where the motors' channels are known, by motor; NaN where it is old.

    RPM has sensors: only one that stands for a single ESC (RPMn_ESC_MASK) tells which rotor it is of.
    """
    parts = list[tuple[IntArray, IntArray, FloatArray]]()  # times, numbers of ESCs from 1, rpm

    def take(table: Table, numbers: IntArray | int, field: str) -> None:
        if table.t_ns is not None and table.has(field) and table.fields[field].dtype.itemsize >= 4:
            parts.append((table.t_ns, np.broadcast_to(np.asarray(numbers), len(table.t_ns)), table.column(field)))

    esc, rpm = tables["ESC"], tables["RPM"]
    number = esc.integers("Instance")
    if number is not None:
        take(esc, number + 1, "RawRPM" if esc.has("RawRPM") else "RPM")
    for place, name in enumerate(_ESCS):
        take(tables[name], place + 1, "RPM")
    for sensor in (1, 2) if not parts else ():
        mask = int(parameters.get(f"RPM{sensor}_ESC_MASK", 0))
        if mask.bit_count() == 1:
            take(rpm, mask.bit_length(), f"rpm{sensor}")
    if not parts:
        return ()
    t_ns, numbers, speeds = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    order = np.argsort(t_ns, kind="stable")
    t_ns, numbers, speeds = t_ns[order], numbers[order], np.abs(speeds[order]) * RPM
    values = np.full((len(t_ns), len(motors) or min(int(numbers.max()), MAX_CHANNELS)), np.nan)
    for column in range(values.shape[1]):
        own = numbers == (motors[column] if motors else column + 1)
        last = np.maximum.accumulate(np.where(own, np.arange(len(t_ns)), -1))
        fresh = (last >= 0) & (t_ns - t_ns[last] <= ESC_HOLDS_S * NS_PER_S)
        values[fresh, column] = speeds[last[fresh]]
    return (recorded(Signal.ROTOR_SPEED, t_ns, values),) if np.isfinite(values).any() else ()


def _batches(head: Table, data: Table) -> tuple[Batch, ...]:
    """Raw batches of the lowest accelerometer (AP_InertialSensor, BatchSampler): of each what came without a gap."""
    names = ("N", "type", "instance", "mul", "SampleUS", "smp_rate")
    axes = [data.fields.get(axis, np.empty(0)) for axis in "xyz"]
    if not (head.has(*names) and data.has("N", "seqno")) or any(one.ndim != 2 for one in axes):
        return ()
    number, kind, instance, unit, time_us, rate_hz = (head.column(name) for name in names)
    raw, found = np.stack(axes, axis=2), list[Batch]()
    wanted = (kind == ACCELEROMETER) & (unit > 0) & (rate_hz > 0)
    wanted &= np.isfinite(unit * rate_hz) & (time_us < MAX_TIME_US)
    wanted &= instance == instance[wanted].min(initial=np.inf)
    ends = np.searchsorted(data.starts, np.append(head.starts, np.iinfo(np.int64).max))  # its data are before the next
    for at in np.flatnonzero(wanted).tolist():
        own = np.arange(ends[at], ends[at + 1])
        own = own[data.column("N")[own] == number[at]]
        whole = data.column("seqno")[own] == np.arange(len(own))
        own = own[: len(own) if whole.all() else int(whole.argmin())]
        if len(own):
            found.append(Batch(int(time_us[at]) * NS_PER_US, float(rate_hz[at]), raw[own].reshape(-1, 3) / unit[at]))
    return tuple(sorted(found, key=lambda batch: batch.t_ns))


def _esc_notes(table: Table) -> tuple[str, ...]:
    number, status = table.integers("Instance"), table.integers("Status")
    if number is None or status is None:
        return ()
    said = {(one, what) for bit, what in ESC_SAYS.items() for one in number[status & bit > 0].tolist()}
    return tuple(f"ESC {one + 1} told {what}" for one, what in sorted(said))


def _parameters(tables: Tables) -> dict[str, float]:
    table = tables["PARM"]
    if not table.has("Value") or not table.has("Name", kinds="S"):
        return {}
    names = (name.decode("latin-1") for name in table.fields["Name"].tolist())
    return {name: value for name, value in zip(names, table.column("Value").tolist(), strict=True) if isfinite(value)}


def _mav_type(texts: Table, parameters: Mapping[str, float]) -> int | None:
    """MAV_TYPE by the firmware's name and its frame; None where the log does not say."""
    if not texts.has("Message", kinds="S"):
        return None
    said = b"\n".join(texts.fields["Message"].tolist())
    firmware, frame = _FIRMWARE.search(said), _FRAME.search(said)
    if firmware is None:
        return None
    name = firmware[1].lower()
    frame_class = int(parameters.get("FRAME_CLASS", _FRAME_CLASSES.get(frame[1], 0) if frame is not None else 0))
    if name == b"rover" and frame_class == _ROVER_BOAT:
        return _BOAT
    return _FIRMWARE_TYPES.get(name, _COPTER_TYPES.get(frame_class))


def _armed(tables: Tables) -> tuple[Series, ...]:
    """Arming changes, from ARM or else from EV, and the state that the first one, if it arms, was a change of.

    Early EV records carry no time: theirs is the last IMU record's.
    """
    arm, event, clock = (tables[name] for name in ("ARM", "EV", "IMU"))
    number, t_ns, armed = event.integers("Id"), event.t_ns, np.empty(0)
    if arm.has("ArmState"):
        t_ns, armed = arm.t_ns, np.minimum(arm.column("ArmState"), 1.0)
    elif number is not None:
        change = np.isin(number, (EVENT_ARMED, EVENT_DISARMED))
        if t_ns is None and clock.t_ns is not None:
            t_ns = clock.t_ns[np.maximum(np.searchsorted(clock.starts, event.starts) - 1, 0)]
        t_ns, armed = None if t_ns is None else t_ns[change], (number[change] == EVENT_ARMED).astype(np.float64)
    if t_ns is None or not len(armed):
        return ()
    if armed[0] and clock.t_ns is not None and clock.t_ns[0] < t_ns[0]:
        t_ns, armed = np.append(clock.t_ns[0], t_ns), np.append(0.0, armed)
    return (recorded(Signal.ARMED, t_ns, armed),)


def _started_ns(tables: Tables, series: tuple[Series, ...]) -> int:
    """Unix time of the first sample [ns], by the first three-dimensional GPS fix; 0 if there is none."""
    table = tables["GPS"]
    if not table.has("Status"):
        return 0
    # Of the old era TimeMS is the time of the week, and T the time since boot.
    for names, boot_unit_ns in ((("GWk", "GMS", "TimeUS"), NS_PER_US), (("Week", "TimeMS", "T"), NS_PER_MS)):
        week, tow_ms, boot = map(table.integers, names)
        if week is None or tow_ms is None or boot is None:
            continue
        fixed = np.flatnonzero((table.column("Status") >= GPS_FIX_3D) & (week >= LEAP_SECONDS[-1][0]))
        if not len(fixed):
            return 0
        at, weeks = int(fixed[0]), int(week[fixed[0]])
        leap_s = next(seconds for since, seconds in LEAP_SECONDS if weeks >= since)
        fix_ns = (GPS_EPOCH_UNIX_S + weeks * WEEK_S - leap_s) * NS_PER_S + int(tow_ms[at]) * NS_PER_MS
        started_ns = fix_ns - int(boot[at]) * boot_unit_ns + Telemetry(series).first_ns
        return started_ns if 0 < started_ns < MAX_TIME_US * NS_PER_US else 0
    return 0


def _recognise(head: bytes) -> bool:
    """Whether it begins with the format record, or amid the records: a logger that wraps overwrites its beginning.

    A telemetry log may carry such records as the content of its messages; its ninth byte begins one of those.
    """
    return head.startswith(SIGNATURE) or (head.count(HEADER) >= MIN_HEADERS and head[8:9] not in (b"\xfd", b"\xfe"))


KIND = LogKind("DataFlash .bin", _recognise, lambda path, *_: read_dataflash(path), (PROFILE,), RECORDED_GATE)
