"""The ULog reader on a recording of a real autopilot on the bench."""

import numpy as np
import pytest
from pyulog import ULog
from shared_data import shared

from mavdiag.logs.ulog import read_ulog
from mavdiag.telemetry import Signal, Telemetry

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


def test_the_vehicle_never_flew() -> None:
    telemetry = recording()
    assert not telemetry.need(Signal.THRUST_SETPOINT).values.any()
    assert not telemetry.need(Signal.ARMED).values.any()
    assert not telemetry.need(Signal.ACTUATOR).values.any()
    force = np.median(telemetry.need(Signal.SPECIFIC_FORCE).values, axis=0)  # at rest, but not level
    assert float(np.linalg.norm(force)) == pytest.approx(9.81, abs=0.15)
    assert force[2] < -9.0


def test_gyro_is_sample_by_sample_that_of_the_topic() -> None:
    path = shared(FILE)
    topic = next(item for item in ULog(str(path)).data_list if item.name == "sensor_combined")
    gyro = read_ulog(path).telemetry.need(Signal.BODY_RATE)
    np.testing.assert_array_equal(gyro.t_ns, topic.data["timestamp"].astype(np.int64) * 1000)
    for axis in range(3):
        np.testing.assert_array_equal(gyro.values[:, axis], topic.data[f"gyro_rad[{axis}]"].astype(np.float64))


def test_the_attitude_turns_as_the_gyro_says() -> None:
    telemetry = recording()
    attitude, gyro = telemetry.need(Signal.ATTITUDE), telemetry.need(Signal.BODY_RATE)
    moved = attitude.t_ns < attitude.t_ns[0] + 10_000_000_000
    for axis in (0, 1):
        turned = np.gradient(attitude.values[moved, axis], attitude.t_ns[moved] * 1e-9)
        measured = np.interp(attitude.t_ns[moved], gyro.t_ns, gyro.values[:, axis])
        assert float(np.corrcoef(turned, measured)[0, 1]) > 0.9


def test_dropouts_are_gaps_and_nothing_fills_them() -> None:
    gaps_s = np.diff(recording().need(Signal.BODY_RATE).t_ns) * 1e-9
    assert float(gaps_s.max()) == pytest.approx(0.0648, abs=1e-3)
    assert int((gaps_s > 0.02).sum()) >= 1
