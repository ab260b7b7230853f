"""The Crazyflie reader on recorded flights: every file reads, and the axes are those of FRD, by correlation."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import savgol_filter
from shared_data import shared

from mavdiag.logs.crazyflie import read_crazyflie
from mavdiag.telemetry import FloatArray, Signal, Telemetry

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
