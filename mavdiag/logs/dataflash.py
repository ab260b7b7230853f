"""ArduPilot DataFlash logs (.bin): the messages of any era become one vehicle's telemetry, in SI and FRD.

Eras differ: `TimeMS` or `TimeUS`, `IMU2` or an instance field, centi-degrees or degrees per second in RATE. Each is
decided from the file itself. What is damaged is skipped (see `mavdiag.logs.dataflash_records`).
"""

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from mavdiag.airframe.parameters import COPTER_MOTORS, output_functions
from mavdiag.errors import InputError
from mavdiag.logs.dataflash_records import HEADER, Walk
from mavdiag.logs.log import RECORDED_GATE, LogKind, Row, Table, read_rows, recorded, windows_of
from mavdiag.telemetry import FloatArray, IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import DEG, NS_PER_MS, NS_PER_S, NS_PER_US

PROFILE = "ardupilot-log"
SIGNATURE = b"\xa3\x95\x80\x80"  # the format record of the format message comes first
MIN_HEADERS = 8  # of records in the first 4096 bytes: no record is longer than 255 (our choice)
CENTIDEGREE_OUTPUT = 4500.0  # full scale of ROut, POut, YOut up to Copter 3.3
THROTTLE_PER_MILLE = 1e-3  # ThrOut up to Copter 3.3 is 0..1000
CENTIVOLT = 0.01  # CURR.Volt where it is an integer
PWM_ZERO_US, PWM_SPAN_US = 1000.0, 1000.0
MAX_CHANNELS = 14  # of RCOU
EVENT_ARMED, EVENT_DISARMED = 10, 11

GPS_EPOCH_UNIX_S = 315_964_800
WEEK_S = 604_800
LEAP_SECONDS = ((1930, 18), (1851, 17), (1695, 16))  # GPS - UTC from this GPS week on (IERS bulletin C), to the week
GPS_FIX_3D = 3


def _wrapped(degrees: FloatArray) -> FloatArray:
    """Angles in -pi..pi, as a quaternion would give them; those already there are left as they are, to the bit."""
    angle = degrees * DEG
    return np.where(np.abs(angle) > math.pi, np.remainder(angle + math.pi, 2 * math.pi) - math.pi, angle)


# The first row of a signal whose message and fields are in the log is taken.
_ROWS = (
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
    Row(Signal.VOLTAGE, "BAT", ("Volt",), integer_unit=CENTIVOLT),
    Row(Signal.VOLTAGE, "CURR", ("Volt",), integer_unit=CENTIVOLT),
)
WANTED = frozenset(row.table for row in _ROWS) | {"RATE", "RCOU", "PARM", "ARM", "EV", "GPS", "MSG"}

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
    otherwise one per output channel up to the last one in use. ARMED has a row for each change. Raises InputError for a
    file that is unreadable, of another kind, or without a known signal.
    """
    walk, digest = Walk(WANTED), hashlib.sha256()
    for window in windows_of(path):
        digest.update(window)
        walk.feed(window)
    tables, notes = walk.finish()
    parameters = _parameters(tables)
    functions = output_functions(parameters)
    motors = _motor_channels(functions)
    found = read_rows(_ROWS, tables.values())
    loop, outputs = _rate_loop(tables, found.get(Signal.BODY_RATE)), _actuator(tables, motors, functions)
    series = (*found.values(), *loop, *outputs, *_armed(tables))
    if not series:
        raise InputError(f"{path}: not a usable DataFlash log: no record of a known signal; check that logging was on")
    named = (path.name, digest.hexdigest(), PROFILE)
    kind = _mav_type(tables.get("MSG"), parameters)
    return Log(*named, Telemetry(series), _started_ns(tables, series), notes, parameters, bool(motors), kind)


def _rate_loop(tables: Mapping[str, Table], gyro: Series | None) -> tuple[Series, ...]:
    """Rate setpoints and torque commands of the RATE message."""
    table = tables.get("RATE")
    fields = ("RDes", "PDes", "YDes", "ROut", "POut", "YOut", "R", "P", "Y")
    if table is None or table.t_ns is None or not table.has(*fields):
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
    said = _mean_size(table.columns(("R", "P", "Y"))[(t_ns >= low) & (t_ns <= high)])
    measured = _mean_size(gyro.values[(gyro.t_ns >= low) & (gyro.t_ns <= high)]) / DEG
    return DEG / 100 if said > 10 * measured > 0 else DEG


def _mean_size(values: FloatArray) -> float:
    """Mean absolute value of the finite ones; 0 if there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.mean()) if len(finite) else 0.0


def _actuator(tables: Mapping[str, Table], motors: Sequence[int], functions: Mapping[int, int]) -> tuple[Series, ...]:
    """The motors' outputs from RCOU: (pulse - 1000 us) / 1000 us; 0 for an idle output (0 us) and for no motor's.

    motors: output channels by motor; empty if they are not known. Then those that have a function are no motors.
    """
    table, others = tables.get("RCOU"), () if motors else tuple(functions)
    if table is None or table.t_ns is None:
        return ()
    prefix = "Ch" if table.has("Ch1") else "C"
    present = [n for n in range(1, MAX_CHANNELS + 1) if table.has(f"{prefix}{n}")]
    channels = [n for n in motors if n in present]
    if not channels:  # nothing says which are motors: every channel up to the last that moves, or gives a pulse
        pulses = {n: table.column(f"{prefix}{n}") for n in present if n not in others}
        moving = [n for n, pulse in pulses.items() if np.ptp(pulse)] or [n for n in pulses if pulses[n].any()]
        channels = [n for n in present if n <= max(moving, default=0)]
    if not channels:
        return ()
    pulse_us = table.columns([f"{prefix}{n}" for n in channels]) * [n not in others for n in channels]
    return (recorded(Signal.ACTUATOR, table.t_ns, np.maximum(pulse_us - PWM_ZERO_US, 0.0) / PWM_SPAN_US),)


def _parameters(tables: Mapping[str, Table]) -> dict[str, float]:
    """The last value of each parameter; empty where the log has none."""
    table = tables.get("PARM")
    if table is None or not table.has("Value") or not table.has("Name", kinds="S"):
        return {}
    names = (name.decode("latin-1") for name in table.fields["Name"].tolist())
    return {name: value for name, value in zip(names, table.column("Value").tolist(), strict=True) if isfinite(value)}


def _mav_type(texts: Table | None, parameters: Mapping[str, float]) -> int | None:
    """MAV_TYPE by the firmware's name and its frame; None where the log does not say."""
    if texts is None or not texts.has("Message", kinds="S"):
        return None
    said = b"\n".join(texts.fields["Message"].tolist())
    firmware, frame = _FIRMWARE.search(said), _FRAME.search(said)
    if firmware is None:
        return None
    name = firmware[1].lower()
    logged = _FRAME_CLASSES.get(frame[1], 0) if frame is not None else 0
    frame_class = int(parameters.get("FRAME_CLASS", logged))
    if name == b"rover" and frame_class == _ROVER_BOAT:
        return _BOAT
    return _FIRMWARE_TYPES.get(name, _COPTER_TYPES.get(frame_class))


def _motor_channels(functions: Mapping[int, int]) -> list[int]:
    """Output channels by motor number; empty where no function is a motor's. Of several of one motor the first."""
    first = {functions[n]: n for n in sorted(functions, reverse=True) if n <= MAX_CHANNELS}
    return [first[wanted] for wanted in COPTER_MOTORS if wanted in first]


def _armed(tables: Mapping[str, Table]) -> tuple[Series, ...]:
    """Arming changes, from ARM or else from EV. Early EV records carry no time: theirs is the last IMU record's."""
    arm, event, clock = (tables.get(name) for name in ("ARM", "EV", "IMU"))
    if arm is not None and arm.has("ArmState"):
        armed = np.minimum(arm.column("ArmState"), 1.0)
        return () if arm.t_ns is None else (recorded(Signal.ARMED, arm.t_ns, armed),)
    number = None if event is None else event.integers("Id")
    if event is None or number is None:
        return ()
    t_ns, change = event.t_ns, np.isin(number, (EVENT_ARMED, EVENT_DISARMED))
    if t_ns is None and clock is not None and clock.t_ns is not None:
        t_ns = clock.t_ns[np.maximum(np.searchsorted(clock.starts, event.starts) - 1, 0)]
    if t_ns is None or not change.any():
        return ()
    return (recorded(Signal.ARMED, t_ns[change], (number[change] == EVENT_ARMED).astype(np.float64)),)


def _started_ns(tables: Mapping[str, Table], series: tuple[Series, ...]) -> int:
    """Unix time of the first sample [ns], by the first three-dimensional GPS fix; 0 if there is none."""
    table = tables.get("GPS")
    if table is None or not table.has("Status"):
        return 0
    # Of the old era TimeMS is the time of the week, and T the time since boot.
    for names, boot_unit_ns in ((("GWk", "GMS", "TimeUS"), NS_PER_US), (("Week", "TimeMS", "T"), NS_PER_MS)):
        week, tow_ms, boot = map(table.integers, names)
        if week is None or tow_ms is None or boot is None:
            continue
        fixed = np.flatnonzero((table.column("Status") >= GPS_FIX_3D) & (week >= LEAP_SECONDS[-1][0]))
        if len(fixed) == 0:
            return 0
        at = int(fixed[0])
        weeks = int(week[at])
        leap_s = next(seconds for since, seconds in LEAP_SECONDS if weeks >= since)
        fix_ns = (GPS_EPOCH_UNIX_S + weeks * WEEK_S - leap_s) * NS_PER_S + int(tow_ms[at]) * NS_PER_MS
        return fix_ns - int(boot[at]) * boot_unit_ns + min(int(one.t_ns[0]) for one in series)
    return 0


def _recognise(head: bytes) -> bool:
    """Whether it begins with the format record, or amid the records: a logger that wraps overwrites its beginning.

    A telemetry log may carry such records as the content of its messages; its ninth byte begins one of those.
    """
    amid = head.count(HEADER) >= MIN_HEADERS and head[8:9] not in (b"\xfd", b"\xfe")
    return head.startswith(SIGNATURE) or amid


KIND = LogKind("DataFlash", _recognise, lambda path, *_: read_dataflash(path), (PROFILE,), RECORDED_GATE)
