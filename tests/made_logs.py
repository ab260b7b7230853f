"""Small flight logs, written byte by byte after the published layouts: the readers' tests choose what is in them."""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

ULOG_HEAD = b"ULog\x01\x12\x35"
DATAFLASH_FMT = 0x80
_DATAFLASH_CODES = {
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
    "M": "B",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
    "a": "32h",
}
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


def ulog_message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(topics: Sequence[ULogTopic], records: Sequence[bytes]) -> bytes:
    """A ULog: definitions, subscriptions, records."""
    parts = [ULOG_HEAD + b"\x01" + struct.pack("<Q", 1_000)]
    parts += [topic.definition() for topic in topics]
    parts += [topic.subscription() for topic in topics]
    return b"".join([*parts, *records])
