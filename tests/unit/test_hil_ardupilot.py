"""ArduPilot's JSON physics by its bytes: rest, rates, resend, restart, foreign datagrams, two autopilots."""

import math
import struct

import numpy as np
import pytest
from hil_bytes import answered, servo_bytes
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl_plant.hil.ardupilot import Lockstep, servo_frame
from sitl_plant.hil.simulation import Simulation, output_map
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import vehicle_named

OFF, HOVER, CLIMB = [1000] * 4, [1520] * 4, [1600] * 4


def lockstep(*faults: Injection, **options: float) -> tuple[Lockstep, Simulation]:
    simulation = Simulation(PlantConfig(seed=3, **options), faults)  # type: ignore[arg-type]
    return Lockstep(simulation, output_map(simulation.config.vehicle, "ardupilot")), simulation


@pytest.mark.parametrize("rate_hz", [50, 333, 400, 1000, 1200, 2500])
def test_flight_time_is_frames_over_rate(rate_hz: int) -> None:
    link, simulation = lockstep()
    frames = 2 * rate_hz
    stamps = [answered(link.feed(servo_bytes(count, OFF, rate_hz), "a", 0.0))["timestamp"] for count in range(frames)]
    assert simulation.t_s == pytest.approx(2.001, abs=0.0015)  # the sensors were read once before the first frame
    assert np.all(np.diff(stamps) >= 0.0)
    assert np.diff(stamps).max() <= 1.0 / rate_hz + 0.001


def test_a_repeated_frame_is_answered_again_and_not_flown() -> None:
    link, simulation = lockstep()
    link.feed(servo_bytes(0, CLIMB), "a", 0.0)
    first = link.feed(servo_bytes(1, CLIMB), "a", 0.1)
    t_s = simulation.t_s
    assert link.feed(servo_bytes(1, OFF), "a", 1.1) == first
    assert simulation.t_s == t_s
    assert link.counts.resent == 1
    assert answered(link.feed(servo_bytes(2, CLIMB), "a", 1.2))["timestamp"] > answered(first)["timestamp"]


def test_a_smaller_count_is_a_restarted_autopilot_and_the_plant_stands_on_the_ground_anew() -> None:
    link, _ = lockstep()
    for count in range(500):
        high = answered(link.feed(servo_bytes(count, CLIMB), "a", 0.0))
    assert high["position"][2] < -0.05
    low = answered(link.feed(servo_bytes(0, OFF), "a", 0.0))
    assert link.counts.restarts == 1
    assert low["timestamp"] == pytest.approx(0.001)
    assert low["position"][2] == pytest.approx(0.001, abs=0.002)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=100))
def test_no_datagram_raises(data: bytes) -> None:
    frame = servo_frame(data)
    assert frame is None or struct.unpack_from("<H", data)[0] in (18458, 29569)


def test_the_newest_address_flies_and_the_one_it_replaced_is_ignored() -> None:
    link, simulation = lockstep()
    for count in range(100):
        link.feed(servo_bytes(count, CLIMB), "old", 0.0)
    assert answered(link.feed(servo_bytes(0, OFF), "new", 0.1))["timestamp"] == pytest.approx(0.001)
    t_s = simulation.t_s
    assert link.feed(servo_bytes(100, CLIMB), "old", 0.2) is None
    assert (link.counts.ignored, link.counts.restarts, simulation.t_s) == (1, 1, t_s)
    assert link.feed(servo_bytes(1, OFF), "new", 0.3) is not None
    assert link.feed(servo_bytes(101, OFF), "old", 3.0) is not None, "the new one has been silent for 2.7 s"


def test_pulses_become_duties_in_the_order_of_the_rotors() -> None:
    """Outputs 1 to 4 turn rotors 2 (front right), 3 (rear left), 4 (front left) and 1 (rear right)."""
    outputs = output_map(vehicle_named("qdrone2"), "ardupilot")
    np.testing.assert_allclose(outputs.from_pwm([1100, 1200, 1300, 1400, 1900]), [0.4, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(outputs.from_pwm([0, 900, 2100, 65535]), [1.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(outputs.from_share([math.nan, -1.0, 2.0, 0.5]), [0.5, 0.0, 0.0, 1.0])
    assert [outputs.motor(rotor) for rotor in (1, 2, 3, 4)] == [4, 1, 2, 3]
