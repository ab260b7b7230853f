"""Recorded flights of ArduCopter in simulation, against pymavlink's own parser."""

import struct
from pathlib import Path

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from shared_data import shared

from mavdiag.link.messages import MessageId
from mavdiag.logs import read_log
from mavdiag.logs.tlog import decode_tlog
from mavdiag.telemetry import Signal

G = 9.80665


def recordings() -> list[Path]:
    return sorted(shared("data/arducopter_sitl").glob("*.tlog"))


def parsed(data: bytes) -> list[tuple[int, dialect.MAVLink_message]]:
    """Every record of a sound log by pymavlink: time [us] and message."""
    mav, at, found = dialect.MAVLink(None), 0, []
    while at < len(data):
        (time_us,) = struct.unpack_from(">Q", data, at)
        stop = at + 8 + 12 + data[at + 9]
        found += [(time_us, message) for message in mav.parse_buffer(data[at + 8 : stop]) or ()]
        at = stop
    return found


def test_counts_and_values_equal_pymavlink() -> None:
    (path,) = [p for p in recordings() if p.name == "healthy_jsonplant2_sq1.tlog"]
    messages = parsed(path.read_bytes())
    content = decode_tlog([path.read_bytes()])
    counts = dict.fromkeys(content.senders[1, 1].by_message, 0)
    for _, message in messages:
        counts[message.get_msgId()] += 1
    assert content.records == len(messages)
    assert content.senders[1, 1].by_message == counts

    log = read_log(path)
    assert log.profile == "ardupilot"
    imu = [(t, m.to_dict()) for t, m in messages if m.get_msgId() == MessageId.RAW_IMU]
    rate, force = log.telemetry.need(Signal.BODY_RATE), log.telemetry.need(Signal.SPECIFIC_FORCE)
    counts_of = {
        name: np.array([m[name] for _, m in imu], dtype=np.float64) for name in imu[0][1] if name != "mavpackettype"
    }
    assert rate.t_ns.tolist() == (1000 * counts_of["time_usec"]).astype(int).tolist()
    assert rate.host_ns.tolist() == [1000 * t for t, _ in imu]
    np.testing.assert_allclose(rate.values, 1e-3 * np.column_stack([counts_of[f"{axis}gyro"] for axis in "xyz"]))
    np.testing.assert_allclose(force.values, 1e-3 * G * np.column_stack([counts_of[f"{axis}acc"] for axis in "xyz"]))
