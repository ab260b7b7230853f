"""The ULog reader on a recording of a real autopilot on the bench."""

import numpy as np
import pytest
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


def test_the_attitude_turns_as_the_gyro_says() -> None:
    telemetry = recording()
    attitude, gyro = telemetry.need(Signal.ATTITUDE), telemetry.need(Signal.BODY_RATE)
    moved = attitude.t_ns < attitude.t_ns[0] + 10_000_000_000
    for axis in (0, 1):
        turned = np.gradient(attitude.values[moved, axis], attitude.t_ns[moved] * 1e-9)
        measured = np.interp(attitude.t_ns[moved], gyro.t_ns, gyro.values[:, axis])
        assert float(np.corrcoef(turned, measured)[0, 1]) > 0.9
