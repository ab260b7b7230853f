"""Telemetry logs made by hand: whole, damaged, of several vehicles, or something else altogether."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil

from mavdiag.errors import InputError
from mavdiag.link.codec import UNKNOWN, Encoder
from mavdiag.link.messages import MavType, MessageId
from mavdiag.link.signing import Signing
from mavdiag.logs import read_log
from mavdiag.logs.log import sha256_of
from mavdiag.logs.tlog import TlogContent, decode_tlog, read_tlog, tlog_record, vehicle_stream
from mavdiag.telemetry import Signal

START_US = 1_763_000_000_000_000
N = 300


def heartbeat(encoder: Encoder, kind: MavType = MavType.QUADROTOR, autopilot: int = 3) -> bytes:
    return encoder.encode(MessageId.HEARTBEAT, kind, autopilot, 128, 0, 4, 3)


def records(sysid: int = 1, n: int = N, scale: int = 1000) -> list[bytes]:
    """n setpoints and IMU samples at 100 Hz, a heartbeat a second, and messages that nobody asks for."""
    encoder, found = Encoder(sysid, 1), []
    for k in range(n):
        time_us = START_US + 10_000 * k
        frames = [
            encoder.encode(MessageId.ATTITUDE_TARGET, 5_000 + 10 * k, 0, (1.0, 0.001 * k, 0.0, 0.0), 0, 0, 0, 0.5),
            encoder.encode(MessageId.RAW_IMU, 5_000_000 + 10_000 * k, k, 0, -scale, -k, 2, 3),
            encoder.encode(MessageId.SYSTEM_TIME, time_us, 5_000 + 10 * k),
        ]
        if k % 100 == 0:
            frames.append(heartbeat(encoder))
        found += [tlog_record(time_us, frame) for frame in frames]
    return found


def written(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "flight.tlog"
    path.write_bytes(data)
    return path


def test_a_whole_log_is_read(tmp_path: Path) -> None:
    data = b"".join(records())
    log = read_log(written(tmp_path, data))
    assert (log.name, log.sha256, log.profile) == ("flight.tlog", sha256_of(data), "ardupilot")
    assert log.started_ns == START_US * 1000
    rate = log.telemetry.need(Signal.BODY_RATE)
    assert rate.t_ns.tolist() == [5_000_000_000 + 10_000_000 * k for k in range(N)]
    assert rate.host_ns.tolist() == [1000 * START_US + 10_000_000 * k for k in range(N)]
    np.testing.assert_allclose(rate.values[-1], [-0.001 * (N - 1), 0.002, 0.003])
    assert len(log.telemetry.need(Signal.ATTITUDE_SETPOINT)) == N
    content = decode_tlog([data])
    assert (content.records, content.damaged_bytes) == (3 * N + 3, 0)
    assert content.senders[1, 1].lost == 0


@pytest.mark.parametrize("seed", range(5))
def test_damage_costs_only_the_records_it_hits(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = records()
    for k in rng.choice(len(pieces), 20, replace=False):
        harm = bytearray(pieces[k])
        harm[8 + int(rng.integers(len(harm) - 8))] ^= 1 << int(rng.integers(8))
        pieces[k] = bytes(harm)
    data = b"".join(pieces[:100]) + rng.bytes(500) + b"".join(pieces[100:]) + pieces[0][:20]
    content = decode_tlog([data])
    known = {msgid: n for msgid, n in content.senders[1, 1].by_message.items() if msgid != UNKNOWN}
    assert sum(known.values()) == len(pieces) - 20  # a frame whose id was hit counts as one of another dialect
    assert content.records - len(pieces) + 20 <= 6
    assert 520 <= content.damaged_bytes <= 520 + 20 * max(map(len, pieces))
    assert len(read_tlog(written(tmp_path, data)).telemetry.need(Signal.BODY_RATE)) >= N - 20


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (b"time,roll,pitch\n1,2,3\n" * 40, "not a flight log"),
        (b"\xfd" * 500, "no MAVLink frame"),
        (b"".join(records(n=3)) + bytes(9000), "% of the file is damaged"),
        (tlog_record(START_US, Encoder(1, 1).encode(MessageId.ATTITUDE, 1)), "no autopilot's heartbeat"),
        (tlog_record(START_US, heartbeat(Encoder(255, 1), MavType.GCS, 8)), "no autopilot's heartbeat"),
        (b"".join(records(1, 9) + records(7, 9)), "vehicles 1, 7; choose one.*vehicle_stream"),
    ],
)
def test_what_cannot_be_read_says_why(tmp_path: Path, data: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read_log(written(tmp_path, data))
    assert "\n" not in str(caught.value)


def test_each_vehicle_of_several_is_read_in_one_pass(tmp_path: Path) -> None:
    ours, theirs = records(1, 250), records(7, 160)
    companion = tlog_record(START_US, heartbeat(Encoder(9, 191), MavType.ONBOARD_CONTROLLER, 8))
    mixed = [one for pair in zip(ours, theirs, strict=False) for one in pair]
    path = written(tmp_path, b"".join((companion, *mixed, *ours[len(theirs) :])))
    found = list(vehicle_stream(path))
    assert [one.vehicle for one in found] == [1, 7]
    assert [one.log.name for one in found] == ["flight.tlog vehicle 1", "flight.tlog vehicle 7"]
    for sysid, log in found:
        alone = read_tlog(path, vehicle=sysid)
        assert (log.sha256, log.profile, log.started_ns) == (alone.sha256, alone.profile, alone.started_ns)
        for series in alone.telemetry:
            assert np.array_equal(log[series.signal].values, series.values)
            assert np.array_equal(log[series.signal].t_ns, series.t_ns)
    assert len(found[1].log[Signal.BODY_RATE]) == 160
    (alone_in_file,) = vehicle_stream(str(written(tmp_path, b"".join(ours))))
    assert alone_in_file.log.name == "flight.tlog"
    with pytest.raises(InputError, match="no autopilot's heartbeat"):
        list(vehicle_stream(written(tmp_path, companion)))


def test_b18_a_log_of_an_unknown_vehicle_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, b"".join(records(scale=16_384)))
    with pytest.raises(InputError, match=r"vehicle 1: its link profile is not clear.*give --profile"):
        read_log(path)
    assert read_log(path, profile="ardupilot").profile == "ardupilot"


def flight(rng: np.random.Generator) -> list[bytes]:
    """Two vehicles: MAVLink 1 and 2, signed stretches, records lost, swapped, broken, and of another dialect."""
    plain, other, sealing = Encoder(1, 1), Encoder(7, 1), Encoder(1, 1, Signing(bytes(32), stamp=START_US // 10))
    old, found = dialect.MAVLink(None, srcSystem=1, srcComponent=1), list[bytes]()
    for k in range(400):
        time_us, boot_us = START_US + 10_000 * k + int(rng.integers(4000)), 5_000_000 + 10_000 * k
        encoder, counts = sealing if 50 < k < 120 else plain, rng.integers(-900, 900, 9).tolist()
        frames = [
            encoder.encode(MessageId.ATTITUDE_TARGET, boot_us // 1000, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, k / 400),
            encoder.encode(MessageId.RAW_IMU, boot_us, *counts[:6]),
            other.encode(MessageId.RAW_IMU, boot_us, *counts),
            dialect.mavlink_map[MessageId.RAW_IMU](boot_us + 5000, *counts).pack(old, force_mavlink1=True),
        ]
        if k % 50 == 0:
            stranger = bytearray(encoder.encode(MessageId.STATUSTEXT, 6, b"text"))
            stranger[7:10] = b"\xff\xff\x7f"
            frames += [heartbeat(encoder), heartbeat(other), bytes(stranger)]
        found += [tlog_record(time_us, bytes(frame)) for frame in frames if rng.random() > 0.02]
    for k in rng.integers(0, len(found) - 1, 20).tolist():
        found[k], found[k + 1] = found[k + 1], found[k]
    for k in rng.integers(0, len(found), 20).tolist():
        found[k] = found[k][:-1] + bytes([found[k][-1] ^ 1])
    return found


@pytest.mark.parametrize(("seed", "window"), [(0, 997), (1, 4096), (2, 20_011), (3, 1 << 21)])
def test_windows_read_as_pymavlink(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, window: int) -> None:
    path = written(tmp_path, b"".join(flight(np.random.default_rng(seed))))
    times, imu, thrust = list[int](), list[list[float]](), list[float]()
    with closing(mavutil.mavlink_connection(str(path), dialect="ardupilotmega")) as theirs:
        while message := theirs.recv_match(type=["RAW_IMU", "ATTITUDE_TARGET"]):
            told = {name: float(value) for name, value in message.to_dict().items() if isinstance(value, int | float)}
            if message.get_srcSystem() == 1 and message.get_type() == "RAW_IMU":
                times.append(round(1e6 * message._timestamp) * 1000)
                imu.append([1000 * told["time_usec"], *(1e-3 * told[f"{axis}gyro"] for axis in "xyz")])
            elif message.get_srcSystem() == 1:
                thrust.append(told["thrust"])
    monkeypatch.setattr("mavdiag.logs.tlog.PIECE_BYTES", window)
    log = read_tlog(path, vehicle=1)
    rate = log.telemetry.need(Signal.BODY_RATE)
    assert len(times) > 700
    assert rate.host_ns.tolist() == times
    np.testing.assert_allclose(np.column_stack([rate.t_ns, rate.values]), imu)
    assert log.telemetry.need(Signal.THRUST_SETPOINT).values[:, 0].tolist() == thrust


def placed(content: TlogContent) -> list[tuple[int, ...]]:
    """Time, place in the file, length, message and sender of each frame."""
    return [
        (host_ns, at + body, stop - body, row, sender)
        for rows, at, _ in content.pieces
        for host_ns, body, stop, row, sender in rows[["host_ns", "body", "stop", "row", "sender"]].tolist()
    ]


@given(st.lists(st.integers(1, 900), min_size=1, max_size=4), st.integers(0, 20))
def test_how_a_damaged_log_is_cut_into_windows_does_not_matter(sizes: list[int], seed: int) -> None:
    rng, pieces = np.random.default_rng(seed), records(1, 20) + records(7, 20)
    whole = b"".join(pieces[int(k)] for k in rng.permutation(len(pieces)))
    data = bytearray(whole[: len(whole) - seed] + rng.bytes(100) + whole)
    for at in rng.integers(0, len(data), seed):
        data[at] ^= 0x55
    places = np.cumsum(np.resize(sizes, len(data) // min(sizes) + 1)).tolist()
    windows = [bytes(data[first:last]) for first, last in zip([0, *places], [*places, len(data)], strict=True)]
    one, other = decode_tlog([bytes(data)]), decode_tlog(windows)
    assert placed(one) == placed(other)
    assert (one.records, one.damaged_bytes, one.notes) == (other.records, other.damaged_bytes, other.notes)
    assert one.senders == other.senders
