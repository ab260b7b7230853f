"""Telemetry logs in windows: whatever is in the file, what the live decoder finds record by record is found."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from framewise_tlog import decode_framewise
from hypothesis import example, given, settings
from hypothesis import strategies as st
from made_telemetry import assert_same_telemetry
from shared_data import shared

from mavdiag.link.codec import MSGIDS, Encoder, frames_of, layout_of
from mavdiag.link.messages import MavType, MessageId
from mavdiag.link.profiles import Witness, detect_profile, with_imu
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.link.sequence import SENDERS_MAX
from mavdiag.link.signing import Signing
from mavdiag.logs.tlog import TlogContent, decode_tlog, decode_windows, read_tlog, tlog_record
from mavdiag.telemetry import Telemetry

START_US = 1_763_000_000_000_000
MESSAGES = MSGIDS[:-1]
SEEDS = {msgid: layout_of(msgid).crc_extra[0] for msgid in MESSAGES}


def checked(body: bytes, seed: int) -> bytes:
    """The body of a frame with its checksum, bit by bit: no table and no library."""
    crc = 0xFFFF
    for byte in (*body, seed):
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return body + crc.to_bytes(2, "little")


def old(msgid: int, payload: bytes, seq: int, sender: tuple[int, int]) -> bytes:
    """A MAVLink 1 frame."""
    return b"\xfe" + checked(bytes([len(payload), seq, *sender, msgid]) + payload, SEEDS.get(msgid, 0))


def new(msgid: int, payload: bytes, seq: int, sender: tuple[int, int], flags: int = 0) -> bytes:
    """A MAVLink 2 frame; with the flag of a signature something that stands for one."""
    body = bytes([len(payload), flags, 0, seq, *sender]) + msgid.to_bytes(3, "little") + payload
    return b"\xfd" + checked(body, SEEDS.get(msgid, 0)) + bytes(range(0xF3, 0x100)) * (flags & 1)


# Bytes that look like markers, stamps and lengths.
nasty = st.lists(st.sampled_from([0, 0, 0, 0, 0, 1, 5, 6, 12, 16, 83, 0xFD, 0xFE, 0xFF]), max_size=60).map(bytes)
senders = st.sampled_from([(1, 1), (1, 1), (1, 1), (1, 158), (7, 1), (255, 190)])
few = st.sampled_from([0, 1, 22, 27, 27, 83, 83, 83, 105, 253, 291, 11030])
payloads = st.one_of(nasty, st.binary(max_size=255))
stamps = st.integers(0, 10**7).map(lambda more: START_US + more) | st.sampled_from([0, 1, (1 << 52) - 1, 1 << 52])
numbers = st.integers(0, 255)
frames = st.one_of(
    st.builds(new, few, payloads, numbers, senders, st.sampled_from([0, 0, 0, 0, 1, 2, 3])),
    st.builds(new, st.sampled_from(MESSAGES) | st.integers(0, (1 << 24) - 1), payloads, numbers, senders),
    st.builds(old, few.filter(lambda one: one < 256), payloads, numbers, senders),
    st.builds(old, numbers, payloads, numbers, senders),
)


@st.composite
def logs(draw: st.DrawFn) -> bytes:
    """Records, runs of regular ones, garbage between them, bytes changed, and an end that may be cut."""
    pieces: list[bytes] = []
    for kind in draw(st.lists(st.sampled_from("rrrrsg"), max_size=30)):
        if kind == "r":
            pieces.append(draw(stamps).to_bytes(8, "big") + draw(frames))
        elif kind == "s":
            first, sender, payload = draw(numbers), draw(senders), draw(payloads)
            run = (new(draw(few), payload, (first + k) % 256, sender) for k in range(draw(st.integers(1, 12))))
            pieces += [tlog_record(START_US, one) for one in run]
        else:
            pieces.append(draw(payloads))
    data = bytearray(b"".join(pieces))
    for at in draw(st.lists(st.integers(0, max(0, len(data) - 1)), max_size=6)):
        if data:
            data[at] = draw(numbers)
    return bytes(data[: len(data) - draw(st.sampled_from([0, 0, 0, 1, 7, 20, 40]))])


def cut(data: bytes, sizes: Sequence[int]) -> list[bytes]:
    places = np.cumsum(np.resize(sizes, len(data) // min(sizes) + 1)).tolist()
    return [data[first:last] for first, last in zip([0, *places], [*places, len(data)], strict=True)]


def assert_same(found: TlogContent, data: bytes) -> None:
    expected = decode_framewise(data)
    assert found.records == expected.records
    assert found.damaged_bytes == expected.damaged_bytes
    assert found.trailing_bytes == expected.trailing_bytes
    if len(expected.numbers) <= SENDERS_MAX:
        by_message = {sender: count.by_message for sender, count in found.senders.items()}
        assert by_message == {s: Counter(msgid for msgid, _ in own) for s, own in expected.numbers.items()}
    assert len(found.senders) <= SENDERS_MAX
    assert found.size == len(data)
    assert found.frames == expected.frames


@settings(max_examples=400)
@given(logs(), st.lists(st.integers(1, 900), min_size=1, max_size=4))
@example(b"\xfd" * 500, [100])
@example(bytes(8) + b"\xfe\x00" * 300, [33])
@example((bytes(8) + b"\xfd\x00") * 60, [700])
def test_the_loop_finds_what_the_decoder_finds(data: bytes, sizes: list[int]) -> None:
    assert_same(decode_windows([data]), data)
    assert_same(decode_windows(cut(data, sizes)), data)


def flight(seed: int) -> bytes:
    """Forty seconds at 100 Hz, from boot: lost and swapped records, a reboot, another vehicle, a signed stretch."""
    rng = np.random.default_rng(seed)
    plain, other = Encoder(1, 1), Encoder(7, 1)
    sealing = Encoder(1, 1, Signing(bytes(32), stamp=START_US // 10))
    records: list[bytes] = []
    reboot = int(rng.integers(1000, 3000))
    for k in range(4000):
        encoder = sealing if 500 < k < 700 else plain
        boot_ms = 10 * (k - reboot if k >= reboot else k + 7000)
        time_us = START_US + 10_000 * k + int(rng.integers(0, 4000)) + (3_000_000 if k >= reboot else 0)
        found = [
            encoder.encode(MessageId.ATTITUDE_TARGET, boot_ms, 0, (1.0, 0.1 * np.sin(k), 0.0, 0.0), 0, 0, 0, 0.5),
            encoder.encode(MessageId.RAW_IMU, 1000 * boot_ms, *rng.integers(-900, 900, 6).tolist()),
        ]
        if k % 7 == 0:
            found.append(encoder.encode(MessageId.SERVO_OUTPUT_RAW, 1000 * boot_ms, 0, 1500, 1400, 1600, 1500))
            found.append(encoder.encode(MessageId.STATUSTEXT, 6, b"text"))
            found.append(other.encode(MessageId.ATTITUDE, boot_ms, 0.1, 0.2))
        if k % 50 == 0:
            found.append(encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, 3, 128, 0, 4, 3))
            found.append(encoder.encode(MessageId.SYS_STATUS, 1, 1, 1, 0, 15_200))
        records += [tlog_record(time_us, one) for one in found if rng.random() > 0.01]
    for k in rng.integers(0, len(records) - 1, 40).tolist():
        records[k], records[k + 1] = records[k + 1], records[k]
    return b"".join(records)


def harmed(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes changed, a stretch lost, another put in, the end cut."""
    harm = np.frombuffer(data, np.uint8).copy()
    harm[rng.integers(0, len(harm), 60)] = rng.integers(0, 256, 60)
    a, b = sorted(rng.integers(0, len(harm), 2).tolist())
    whole = harm.tobytes()
    return whole[:a] + rng.bytes(700) + whole[a:b] + whole[b + 5000 : len(whole) - int(rng.integers(0, 60))]


def telemetry_framewise(data: bytes) -> tuple[int, Telemetry]:
    """When vehicle 1's first frame came, and its flight, frame by frame."""
    own = [frame for frame in decode_framewise(data).frames if frame.sysid == 1]
    profile = detect_profile(Witness().take(frames_of(own)))[0]
    assert profile is not None
    return own[0].host_ns, SampleDecoder(
        with_imu(profile, Counter(frame.msgid for frame in own if frame.compid == 1))
    ).step(SampleState(), own)[1]


@pytest.mark.parametrize("seed", range(4))
def test_a_flight_is_the_same_telemetry(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = flight(seed)
    for one in (data, harmed(data, rng)):
        assert_same(decode_tlog(one), one)
        path = tmp_path / "flight.tlog"
        path.write_bytes(one)
        log = read_tlog(path, vehicle=1)
        start_ns, telemetry = telemetry_framewise(one)
        assert (log.profile, log.started_ns) == ("ardupilot", start_ns)
        assert_same_telemetry(log.telemetry, telemetry)


def test_more_senders_than_are_followed() -> None:
    rng = np.random.default_rng(8)
    keys = [(int(a), int(b)) for a, b in rng.integers(1, 255, (3000, 2))]
    data = b"".join(tlog_record(START_US, new(0, b"\x02\x03", k % 256, sender)) for k, sender in enumerate(keys))
    for sizes in ([len(data)], [20_000]):
        assert_same(decode_windows(cut(data, sizes)), data)


@pytest.mark.parametrize("folder", ["arducopter_sitl", "arducopter_live"])
def test_recorded_flights_are_the_same(folder: str) -> None:
    path = sorted(shared(f"data/{folder}").glob("*healthy*.tlog"))[0]
    data = path.read_bytes()[:3_000_000]
    rng = np.random.default_rng(1)
    for one in (data, harmed(data, rng)):
        assert_same(decode_windows([one]), one)
    assert_same_telemetry(read_tlog(path, vehicle=1).telemetry, telemetry_framewise(path.read_bytes())[1])
