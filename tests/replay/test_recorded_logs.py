"""Recorded logs by their readers: counts and values are pymavlink's, signs and rates those of physics."""

import struct
from collections import defaultdict
from collections.abc import Collection, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from scipy.signal import savgol_filter
from shared_data import shared

from mavdiag.link.messages import MessageId
from mavdiag.logs import read_log
from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.logs.dataflash import Walk, read_dataflash
from mavdiag.logs.log import Table
from mavdiag.logs.tlog import decode_tlog
from mavdiag.logs.ulog import read_ulog
from mavdiag.telemetry import FloatArray, Signal, Telemetry

REAL = "data/ardupilot_real/log171.bin"  # Copter 3.3-dev, 2015
SIMULATED = "data/arducopter_sitl/jsonplant_flight.bin"  # Copter 4.5.6
CHECKED = {
    REAL: ("IMU", "ATT", "RATE", "RCOU", "CTUN", "CURR", "BARO", "GPS", "EV"),
    SIMULATED: ("IMU", "ATT", "RATE", "RCOU", "CTUN", "POS", "BARO", "VIBE", "BAT", "ARM", "EV", "GPS"),
}
INSTANCE = {"IMU": "I", "BARO": "I", "VIBE": "IMU", "BAT": "Inst", "GPS": "I"}


@cache
def oracle(path: Path, wanted: Collection[str]) -> dict[str, dict[str, FloatArray]]:
    """Every numeric column of these messages, first instances only, as pymavlink reads them."""
    reader = import_module("pymavlink.DFReader").DFReader_binary(str(path), zero_time_base=False)
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    while (message := reader.recv_match(type=list(wanted))) is not None:
        name = message.get_type()
        fields = message.to_dict()
        if fields.get(INSTANCE.get(name, ""), 0) == 0:
            rows[name].append({k: v for k, v in fields.items() if isinstance(v, int | float)})
    reader.close()
    return {name: {k: np.array([row[k] for row in all_rows]) for k in all_rows[0]} for name, all_rows in rows.items()}


@cache
def tables(path: Path, wanted: Collection[str]) -> Mapping[str, Table]:
    walk = Walk(wanted)
    walk.feed(path.read_bytes())
    return walk.finish()[0]


@pytest.mark.parametrize(("file", "name"), [(file, name) for file, names in CHECKED.items() for name in names])
def test_counts_and_values_are_those_of_pymavlink(file: str, name: str) -> None:
    path = shared(file)
    expected = oracle(path, CHECKED[file])[name]
    table = tables(path, CHECKED[file])[name]
    assert len(table.starts) == len(next(iter(expected.values())))
    for label, values in expected.items():
        np.testing.assert_allclose(table.column(label), values, rtol=1e-12, atol=1e-12, err_msg=label)


@cache
def real() -> Telemetry:
    return read_dataflash(shared(REAL)).telemetry


def test_the_upset_of_the_real_flight_is_where_it_was() -> None:
    attitude = real().need(Signal.ATTITUDE)
    over = np.abs(attitude.values[:, 0]) > np.radians(100)
    assert float(attitude.t_ns[over][0]) * 1e-9 == pytest.approx(240, abs=3)
    armed = real().need(Signal.ARMED)
    assert (armed.t_ns * 1e-9).tolist() == pytest.approx([72.6], abs=0.1)


DT_S = 1 / 101.1
LAGS = range(16)  # the vehicle follows its setpoint within 0.15 s


@cache
def healthy(number: int) -> Telemetry:
    return read_crazyflie(shared("data/crazypad/normal_flight") / f"E8_log{number:02d}").telemetry


def airborne(telemetry: Telemetry) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Rows at least half a second inside a flight: high enough, and with thrust."""
    up = (telemetry.need(Signal.HEIGHT).values[:, 0] > 0.38) & (
        telemetry.need(Signal.THRUST_SETPOINT).values[:, 0] > 0.38
    )
    return np.convolve(up, np.ones(101), "same") > 100.5


def correlation(a: FloatArray, b: FloatArray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


@pytest.mark.parametrize("number", range(5))
@pytest.mark.parametrize("axis", [0, 1])
def test_the_body_follows_its_setpoint_with_the_same_sign(number: int, axis: int) -> None:
    telemetry = healthy(number)
    rows = airborne(telemetry)
    demand = savgol_filter(telemetry.need(Signal.ATTITUDE_SETPOINT).values[:, axis], 11, 2, deriv=1, delta=DT_S)
    rate = savgol_filter(telemetry.need(Signal.BODY_RATE).values[:, axis], 11, 2)
    found = [correlation(np.roll(demand, lag)[rows], rate[rows]) for lag in LAGS]
    assert max(found) > 0.6
    assert max(found) > abs(min(found))


@pytest.mark.parametrize("number", range(5))
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_torque_command_pushes_against_the_rate_error(number: int, axis: int) -> None:
    telemetry = healthy(number)
    rows = airborne(telemetry)
    error = telemetry.need(Signal.RATE_SETPOINT).values[:, axis] - telemetry.need(Signal.BODY_RATE).values[:, axis]
    command = telemetry.need(Signal.TORQUE_COMMAND).values[:, axis]
    assert correlation(np.diff(error)[rows[1:]], np.diff(command)[rows[1:]]) > 0.5  # changes: the integral part is slow


def test_gravity_holds_the_vehicle_up() -> None:
    telemetry = healthy(0)
    force = telemetry.need(Signal.SPECIFIC_FORCE).values[airborne(telemetry), 2]
    assert float(np.mean(force)) == pytest.approx(-9.81, rel=0.02)


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


FILE = "data/px4_real/pyulog_sample.ulg"


def recording() -> Telemetry:
    return read_ulog(shared(FILE)).telemetry


def median_rate_hz(telemetry: Telemetry, signal: Signal) -> float:
    return float(1e9 / np.median(np.diff(telemetry.need(signal).t_ns)))


def test_rates_are_those_of_the_recording() -> None:
    telemetry = recording()
    assert median_rate_hz(telemetry, Signal.BODY_RATE) == pytest.approx(250, rel=0.01)
    assert median_rate_hz(telemetry, Signal.ATTITUDE_SETPOINT) == pytest.approx(50, rel=0.01)
    assert median_rate_hz(telemetry, Signal.RATE_SETPOINT) == pytest.approx(84, rel=0.02)


def test_the_attitude_turns_as_the_gyro_says() -> None:
    telemetry = recording()
    attitude, gyro = telemetry.need(Signal.ATTITUDE), telemetry.need(Signal.BODY_RATE)
    moved = attitude.t_ns < attitude.t_ns[0] + 10_000_000_000
    for axis in (0, 1):
        turned = np.gradient(attitude.values[moved, axis], attitude.t_ns[moved] * 1e-9)
        measured = np.interp(attitude.t_ns[moved], gyro.t_ns, gyro.values[:, axis])
        assert float(np.corrcoef(turned, measured)[0, 1]) > 0.9
