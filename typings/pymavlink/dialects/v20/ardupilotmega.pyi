# What the codec and its tests use of the generated dialect, and nothing else.
from struct import Struct

class EnumEntry:
    name: str

enums: dict[str, dict[int, EnumEntry]]

class MAVLink_message:
    id: int
    msgname: str
    fieldnames: list[str]
    ordered_fieldnames: list[str]
    fieldtypes: list[str]
    orders: list[int]
    lengths: list[int]
    array_lengths: list[int]
    crc_extra: int
    unpacker: Struct
    def __init__(self, *fields: object) -> None: ...
    def get_msgId(self) -> int: ...
    def get_srcSystem(self) -> int: ...
    def get_srcComponent(self) -> int: ...
    def get_seq(self) -> int: ...
    def get_type(self) -> str: ...
    def pack(self, mav: MAVLink, force_mavlink1: bool = False) -> bytes: ...
    def to_dict(self) -> dict[str, str | float | int | list[float]]: ...

class MAVLinkSigning:
    secret_key: bytes | None
    link_id: int
    timestamp: int
    sign_outgoing: bool

class MAVLink:
    seq: int
    robust_parsing: bool
    signing: MAVLinkSigning
    def __init__(self, file: object, srcSystem: int = 0, srcComponent: int = 0) -> None: ...
    def parse_buffer(self, s: bytes) -> list[MAVLink_message] | None: ...

mavlink_map: dict[int, type[MAVLink_message]]

class x25crc:
    crc: int
    def __init__(self, buf: bytes | None = None) -> None: ...
