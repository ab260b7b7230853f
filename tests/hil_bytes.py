"""Autopilots as the plant hears them: their bytes, packed here from the published layouts and not by the product.

ArduPilot: libraries/SITL/examples/JSON/readme.md. MAVLink 2: https://mavlink.io/en/guide/serialization.html and the
message definitions of common.xml; a checksum seed is that of the definition.
"""

import json
import struct
from collections.abc import Iterator, Sequence
from typing import Any

__all__ = ["LAYOUTS", "answered", "controls_bytes", "frames_in", "mavlink_bytes", "servo_bytes", "x25"]

# By message: its layout on the wire, and its seed.
LAYOUTS = {
    0: ("<IBBBBB", 50),  # HEARTBEAT: custom_mode, type, autopilot, base_mode, system_status, mavlink_version
    76: ("<7fH3B", 152),  # COMMAND_LONG: param1 to 7, command, target system and component, confirmation
    93: ("<QQ16fB", 47),  # HIL_ACTUATOR_CONTROLS: time_usec, flags, controls, mode
    107: ("<Q13fIB", 108),  # HIL_SENSOR: time_usec, acc, gyro, mag, pressures, altitude, temperature, updated, id
    113: ("<QiiiHHHhhhHBBBH", 124),  # HIL_GPS: time, lat, lon, alt, eph, epv, vel, vn, ve, vd, cog, fix, satellites
    115: ("<Q4f3f3i3hHH3h", 4),  # HIL_STATE_QUATERNION: time, q, rates, lat, lon, alt, v, airspeeds, acc
}


def servo_bytes(count: int, pwm: Sequence[int], rate_hz: int = 1000, channels: int = 16, magic: int = 0) -> bytes:
    """ArduPilot's servo packet: u16 magic, u16 frame_rate, u32 frame_count, u16 pwm[16 or 32], little-endian."""
    given = magic or {16: 18458, 32: 29569}[channels]
    return struct.pack(f"<HHI{channels}H", given, rate_hz, count, *pwm, *[0] * (channels - len(pwm)))


def answered(data: bytes | None) -> dict[str, Any]:
    """The answer, read as strictly as ArduPilot's parser does: between line ends, no blanks, no space behind a name."""
    assert data is not None
    assert data[:1] == data[-1:] == b"\n"
    assert b" " not in data
    found: dict[str, Any] = json.loads(data)
    for name, size in (("position", 3), ("velocity", 3), ("quaternion", 4)):
        assert len(found[name]) == size
    assert len(found["imu"]["gyro"]) == len(found["imu"]["accel_body"]) == 3
    return found


def x25(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def mavlink_bytes(msgid: int, *values: float, seq: int = 0, sysid: int = 1, compid: int = 1) -> bytes:
    """A MAVLink 2 frame from values in the order of the wire."""
    layout, seed = LAYOUTS[msgid]
    payload = struct.pack(layout, *values).rstrip(b"\0") or b"\0"
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, seq & 255, sysid, compid, msgid & 0xFFFF, msgid >> 16) + payload
    return b"\xfd" + body + struct.pack("<H", x25(body + bytes([seed])))


def controls_bytes(t_us: int, controls: Sequence[float], armed: bool = True, flags: int = 1, seq: int = 0) -> bytes:
    """HIL_ACTUATOR_CONTROLS as PX4 in simulation sends it: 1 in the flags for lockstep, mode custom and armed."""
    outputs = [*controls, *[0.0] * (16 - len(controls))]
    return mavlink_bytes(93, t_us, flags, *outputs, 1 | 128 * armed, seq=seq)


def frames_in(data: bytes) -> Iterator[tuple[int, tuple[Any, ...], int]]:
    """Message, values and end of each whole frame; its checksum is checked."""
    at = 0
    while len(data) - at >= 12 and len(data) - at >= data[at + 1] + 12:
        length = data[at + 1]
        assert data[at] == 0xFD
        msgid = int.from_bytes(data[at + 7 : at + 10], "little")
        layout, seed = LAYOUTS[msgid]
        end = at + 10 + length
        assert x25(data[at + 1 : end] + bytes([seed])) == int.from_bytes(data[end : end + 2], "little")
        at = end + 2
        yield msgid, struct.unpack(layout, data[end - length : end].ljust(struct.calcsize(layout), b"\0")), at
