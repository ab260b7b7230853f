"""The manufacturer's controller: filters against scipy, mixer and motor map as they are printed."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

import sitl_plant.vehicle as vehicle_module
from mavdiag.errors import UsageError
from sitl_plant.options import flight_plan
from sitl_plant.physics.control import second_order, thrust_of, voltage_of
from sitl_plant.vehicle import allocation, qdrone2, vehicle_named

VEHICLE = vehicle_named("qdrone2-recorded")
SOURCE = (Path(vehicle_module.__file__).parent / "qdrone2-recorded.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(("wn", "zeta"), [(120.0, 1.0), (100.0, 0.7), (50.0, 1.0)])
def test_second_order_filter_is_the_exponential_of_its_matrix(wn: float, zeta: float) -> None:
    from scipy.linalg import expm

    exact = expm(np.array([[0.0, 1.0], [-wn * wn, -2 * zeta * wn]]) * 0.001)
    np.testing.assert_allclose(np.reshape(second_order(wn, zeta, 0.001), (2, 2)), exact, rtol=1e-12, atol=1e-15)


def test_feedback_filter_delays_by_what_was_measured() -> None:
    """wn 120 rad/s, zeta 1: -3 dB at 12.3 Hz and 2 zeta / wn = 16.7 ms at low frequency."""
    f11, f12, f21, f22 = second_order(120.0, 1.0, 0.001)
    y, slope, w = 0.0, 0.0, 2 * math.pi * 12.3
    out = []
    for k in range(2000):
        u = math.sin(w * k * 0.001)
        y, slope = u + f11 * (y - u) + f12 * slope, f21 * (y - u) + f22 * slope
        out.append(y)
    assert max(out[-400:]) == pytest.approx(1 / math.sqrt(2), rel=0.02)
    y, slope = 0.0, 0.0
    for k in range(2000):  # a ramp is followed late by 16.7 ms, and the slope is the ramp's
        u = k * 0.001
        y, slope = u + f11 * (y - u) + f12 * slope, f21 * (y - u) + f22 * slope
    assert 1.999 - y == pytest.approx(0.0167, abs=0.0006)
    assert slope == pytest.approx(1.0, rel=2e-3)  # at the end of each held input


def test_the_motor_map_is_the_printed_one_and_is_inverted() -> None:
    """F = .03616 V^2 + .117 V - .01215: the weight's quarter takes 8.63 V."""
    given = (0.03616, 0.117, -0.01215)
    assert VEHICLE.recorded is not None
    assert VEHICLE.recorded.motors.thrust_map == given
    assert thrust_of(given, 8.0) == pytest.approx(0.03616 * 64 + 0.117 * 8 - 0.01215)
    assert voltage_of(given, 14.754 / 4) == pytest.approx(8.63, abs=0.01)
    for volts in (0.5, 3.0, 12.0):
        assert voltage_of(given, thrust_of(given, volts)) == pytest.approx(volts)
    assert (voltage_of(given, -1.0), thrust_of(given, 0.0)) == (0.0, 0.0)


def test_the_mixer_is_the_manufacturers_motor_matrix() -> None:
    """Rows M1 to M4, FLU: [.25, -+1/2 Lr, +-1/2 Lp, +-Kt/4]; pitch and yaw change sign in FRD."""
    roll, pitch, yaw = 1 / (2 * 0.254), 1 / (2 * 0.2032), 68.9055 / 4
    printed = np.array(
        [
            [0.25, -roll, pitch, yaw],
            [0.25, -roll, -pitch, -yaw],
            [0.25, roll, pitch, -yaw],
            [0.25, roll, -pitch, yaw],
        ]
    )
    np.testing.assert_allclose(np.linalg.pinv(allocation(VEHICLE)), printed * [1, 1, -1, -1], atol=1e-12)


def test_every_number_in_the_file_has_its_source_beside_it() -> None:
    numbers = [line for line in SOURCE.splitlines() if re.match(r"\w+ = [^\"]*\d", line)]
    assert len(numbers) > 50
    known = re.compile(r"# .*(manufacturer|measured|inferred|estimate|fitted)")
    assert [line for line in numbers if not known.search(line)] == []


def test_as_recorded_is_a_choice_and_the_thesis_the_default() -> None:
    assert flight_plan(as_recorded=True).config.vehicle == VEHICLE
    assert flight_plan(as_recorded=True, vehicle="qdrone2-recorded").config.vehicle == VEHICLE
    assert flight_plan().config.vehicle == qdrone2()
    assert qdrone2().recorded is None
    with pytest.raises(UsageError, match="as-recorded"):
        flight_plan(as_recorded=True, vehicle="hexa-x")
