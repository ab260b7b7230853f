"""Logs of each kind that are made by hand, byte by byte."""

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from made_telemetry import body_rates
from scipy.io import savemat
from scipy.signal import bilinear, butter, lfilter

from mavdiag.telemetry import FloatArray

ULOG_HEAD = b"ULog\x01\x12\x35"
DATAFLASH_FMT = 0x80
_DATAFLASH_CODES = dict(zip("cCeELMnNZa", ("h", "H", "i", "I", "i", "B", "4s", "16s", "64s", "32h"), strict=True))
_ULOG_CODES = {"uint64_t": "Q", "int32_t": "i", "uint8_t": "B", "float": "f", "double": "d"}


@dataclass(frozen=True)
class CrazyflieEvent:
    """An event type of a Crazyflie log: variables such as `gyro.x(f)`."""

    number: int
    name: str
    variables: tuple[str, ...]

    def record(self, time_us: int, *values: float) -> bytes:
        codes = "".join(variable[-2] for variable in self.variables)
        return struct.pack("<HQ" + codes, self.number, time_us, *values)


def crazyflie_content(events: Sequence[CrazyflieEvent], records: Sequence[bytes], version: int = 2) -> bytes:
    header = struct.pack("<BHH", 0xBC, version, len(events))
    for event in events:
        header += struct.pack("<H", event.number) + event.name.encode() + b"\0"
        header += struct.pack("<H", len(event.variables)) + b"".join(v.encode() + b"\0" for v in event.variables)
    return header + b"".join(records)


def with_checksum(content: bytes) -> bytes:
    return content + struct.pack("<I", zlib.crc32(content))


@dataclass(frozen=True)
class DataFlashMessage:
    kind: int
    name: str
    characters: str
    labels: str

    @property
    def codes(self) -> str:
        return "<" + "".join(_DATAFLASH_CODES.get(c, c) for c in self.characters)

    def definition(self) -> bytes:
        length = 3 + struct.calcsize(self.codes)
        names = (self.name.encode(), self.characters.encode(), self.labels.encode())
        return b"\xa3\x95" + struct.pack("<BBB4s16s64s", DATAFLASH_FMT, self.kind, length, *names)

    def record(self, *values: float | bytes) -> bytes:
        """One record of stored values: a `c` field takes hundredths."""
        return b"\xa3\x95" + struct.pack("<B", self.kind) + struct.pack(self.codes, *values)


DATAFLASH_SELF = DataFlashMessage(DATAFLASH_FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")


def dataflash(messages: Sequence[DataFlashMessage], records: Sequence[bytes]) -> bytes:
    """A DataFlash log: all definitions, then the records."""
    return b"".join(message.definition() for message in (DATAFLASH_SELF, *messages)) + b"".join(records)


IMU = DataFlashMessage(163, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ATT = DataFlashMessage(70, "ATT", "Qccccff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
RATE = DataFlashMessage(73, "RATE", "Qfffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut")
RCOU = DataFlashMessage(62, "RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6")
PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")


@dataclass(frozen=True)
class ULogTopic:
    """A topic of a ULog; a field is (type, name) or (type[count], name)."""

    number: int
    name: str
    fields: tuple[tuple[str, str], ...]

    @property
    def codes(self) -> str:
        codes = "<"
        for kind, _ in self.fields:
            base, _, count = kind.partition("[")
            codes += (count.rstrip("]") or "1") + _ULOG_CODES[base]
        return codes

    def definition(self) -> bytes:
        return ulog_message("F", f"{self.name}:{''.join(f'{kind} {name};' for kind, name in self.fields)}".encode())

    def subscription(self) -> bytes:
        return ulog_message("A", struct.pack("<BH", 0, self.number) + self.name.encode())

    def record(self, *values: float) -> bytes:
        return ulog_message("D", struct.pack("<H", self.number) + struct.pack(self.codes, *values))


STAMP = ("uint64_t", "timestamp")
SENSORS = ULogTopic(1, "sensor_combined", (STAMP, ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")))
SETPOINT = ULogTopic(2, "vehicle_attitude_setpoint", (STAMP, ("float[4]", "q_d"), ("float[3]", "thrust_body")))


def ulog_message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(topics: Sequence[ULogTopic], records: Sequence[bytes]) -> bytes:
    """A ULog: definitions, subscriptions, records."""
    parts = [ULOG_HEAD + b"\x01" + struct.pack("<Q", 1_000)]
    parts += [topic.definition() for topic in topics]
    parts += [topic.subscription() for topic in topics]
    return b"".join([*parts, *records])


DT_S = 0.001
LINE_HZ = 150.0
IDLE_S, SPINNING_S, TAKE_OFF_S, LANDING_S = 0.5, 1.0, 1.0, 1.0  # spans on the ground and below height
HOVER_N, LEVEL_V = 13.1, 15.2
MIXER = np.array([[-1, 1, 1], [-1, -1, -1], [1, 1, -1], [1, -1, 1]]) / [2 * 0.254, 2 * 0.2032, 4 / 68.9055]

Rows = dict[str, FloatArray]


def flight(duration_s: float, seed: int, *, weak_rotor: int = 0, rise: float = 0.0, line: float = 1.0) -> Rows:
    """The three matrices, (rows, n). rise: of the command of `weak_rotor` (from 1); line: size of the rotors' shake."""
    rng, n = np.random.default_rng(seed), round(duration_s / DT_S)
    t = DT_S * np.arange(n, dtype=np.float64)
    state = states(t)
    up = state >= 4
    reference = smooth(rng, n, 0.7, (0.1, 0.1, 0.1)) * up[:, None]
    angle = second_order(reference, 9.0, 0.8) + smooth(rng, n, 2.0, (0.004, 0.004, 0.004)) * up[:, None]
    rate = body_rates(angle, DT_S)
    shake = np.sin(2 * np.pi * LINE_HZ * t[:, None] + rng.uniform(0, 6, 6)) * (state >= 3)[:, None] * line
    gyro = rate + 0.03 * shake[:, :3] + rng.normal(0, 0.004, (n, 3))
    gyro = np.repeat(gyro[::2], 2, axis=0)[:n]  # 500 Hz, held
    force = np.array([0.0, 0.0, 9.81]) + 1.5 * shake[:, 3:] + rng.normal(0, 0.3, (n, 3))
    slow = second_order(gyro, 120.0, 1.0)
    volt = LEVEL_V - 0.005 * t + rng.normal(0, 0.01, n)
    thrust = np.where(up, HOVER_N + smooth(rng, n, 1.0, (0.3,))[:, 0], np.where(state == 3, 3.0, 0.0))
    rate_command = np.array([12.0, 12.0, 2.0]) * (reference - angle) - np.array([0.1, 0.1, 0.0]) * slow
    torque = np.array([0.1876, 0.1544, 0.079]) * (rate_command - slow) * up[:, None]
    torque = np.clip(torque, [-1.0915, -0.8984, -0.0984], [1.0915, 0.8984, 0.0984])
    outputs = duty(thrust[:, None] / 4 + torque @ MIXER.T, volt)
    if weak_rotor:
        outputs[:, weak_rotor - 1] *= 1.0 + rise

    rows = {name: np.zeros((n, count)) for name, count in (("QDrone_data", 56), ("commander_data", 37))}
    rows["stabilizer_data"] = np.zeros((n, 21))
    q, c, s = rows.values()
    q[:, 0] = c[:, 0] = s[:, 0] = t
    q[:, 1:4], q[:, 4:7], q[:, 10:13], q[:, 13:16] = angle, slow, angle, slow
    q[:, 19:23], q[:, 23] = outputs, volt
    q[:, 26:29], q[:, 29:32], q[:, 32:35], q[:, 35:38] = gyro, force, gyro, force
    q[:, [52, 50, 48, 46]] = outputs
    q[:, [53, 51, 49, 47]] = (LINE_HZ / 18.571 / volt * (state >= 3))[:, None]
    q[: n // 80, [51, 49, 47]], q[: n // 80, 53] = np.nan, np.inf
    c[:, 1], c[:, 23], c[:, 24], c[:, 28] = state, np.where(up, 0.6, 0.0), angle[:, 2], reference[:, 2]
    c[:, 34:37] = s[:, 8:11] = reference
    s[:, 7] = s[:, 17] = thrust
    s[:, 14:17] = s[:, 18:21] = torque
    return {name: np.asfortranarray(table.T) for name, table in rows.items()}


def content(rows: Mapping[str, Any], *, compressed: bool = True) -> bytes:
    file = BytesIO()
    savemat(file, dict(rows), do_compression=compressed)  # type: ignore[arg-type]  # the stubs know no open files
    return file.getvalue()


def written(path: Path, rows: Mapping[str, FloatArray]) -> Path:
    savemat(path, dict(rows), appendmat=False)
    return path


def states(t: FloatArray) -> FloatArray:
    """State of the commander: idle, throttle up, take-off, flight, landing."""
    edges = np.cumsum([IDLE_S, SPINNING_S, TAKE_OFF_S])
    return np.select([t < edges[0], t < edges[1], t < edges[2], t < t[-1] - LANDING_S], [1.0, 3.0, 4.0, 5.0], 6.0)


def smooth(rng: np.random.Generator, n: int, corner_hz: float, size: tuple[float, ...]) -> FloatArray:
    """Low-passed noise of these standard deviations, (n, k)."""
    b, a = butter(3, corner_hz * 2 * DT_S)
    noise = lfilter(b, a, rng.standard_normal((n + 5000, len(size))), axis=0)[5000:]
    return np.asarray(noise / noise.std(axis=0) * size)


def second_order(x: FloatArray, wn: float, zeta: float) -> FloatArray:
    """A low-pass of natural frequency wn [rad/s] and damping zeta, (n, k)."""
    b, a = bilinear([wn**2], [1, 2 * zeta * wn, wn**2], 1 / DT_S)
    return np.asarray(lfilter(b, a, x, axis=0))


def duty(force: FloatArray, volt: FloatArray) -> FloatArray:
    """Share of the battery's voltage that makes these forces [N], (n, 4)."""
    a, b, c = 0.03616, 0.117, -0.01215
    needed = (-b + np.sqrt(b * b + 4 * a * (np.maximum(force, 0.0) - c))) / (2 * a)
    return np.clip(needed / volt[:, None], 0.0, 1.0)
