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
from sitl_plant.physics.faults import Injection, fault_injection
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import vehicle_named

OFF, HOVER, CLIMB = [1000] * 4, [1520] * 4, [1600] * 4


def lockstep(*faults: Injection, **options: float) -> tuple[Lockstep, Simulation]:
    simulation = Simulation(PlantConfig(seed=3, **options), faults)  # type: ignore[arg-type]
    return Lockstep(simulation, output_map(simulation.config.vehicle, "ardupilot")), simulation


def test_it_rests_on_the_ground_with_motors_off() -> None:
    link, _ = lockstep()
    rows = [answered(link.feed(servo_bytes(count, OFF), "a", 0.0)) for count in range(1000)]
    assert [row["timestamp"] for row in rows] == pytest.approx([0.001 * (1 + count) for count in range(1000)])
    accel = np.array([row["imu"]["accel_body"] for row in rows])
    np.testing.assert_allclose(accel.mean(axis=0), [0.0, 0.0, -9.81], atol=0.02)
    np.testing.assert_allclose([row["position"] for row in rows], 0.0, atol=0.003)
    np.testing.assert_allclose(rows[-1]["quaternion"], [1.0, 0.0, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize("rate_hz", [50, 333, 400, 1000, 1200, 2500])
def test_flight_time_is_frames_over_rate(rate_hz: int) -> None:
    link, simulation = lockstep()
    frames = 2 * rate_hz
    stamps = [answered(link.feed(servo_bytes(count, OFF, rate_hz), "a", 0.0))["timestamp"] for count in range(frames)]
    assert simulation.t_s == pytest.approx(2.001, abs=0.0015)  # the sensors were read once before the first frame
    assert np.all(np.diff(stamps) >= 0.0)
    assert np.diff(stamps).max() <= 1.0 / rate_hz + 0.001


@pytest.mark.parametrize(
    ("output", "roll", "pitch", "yaw"), [(0, -1, 1, 1), (1, 1, -1, 1), (2, 1, 1, -1), (3, -1, -1, -1)]
)
def test_each_output_turns_the_motor_of_the_quad_x(output: int, roll: int, pitch: int, yaw: int) -> None:
    """ArduPilot's quad X: 1 front right and 2 rear left counter-clockwise, 3 front left and 4 rear right clockwise."""
    link, _ = lockstep()
    count = 0
    for _ in range(400):  # off the ground
        link.feed(servo_bytes(count, [1700] * 4), "a", 0.0)
        count += 1
    before = answered(link.feed(servo_bytes(count, [1520] * 4), "a", 0.0))["imu"]["gyro"]
    pwm = [1520] * 4
    pwm[output] = 1620
    for _ in range(60):
        count += 1
        after = answered(link.feed(servo_bytes(count, pwm), "a", 0.0))["imu"]["gyro"]
    turned = np.subtract(after, before)
    assert turned[0] * roll > 0.1
    assert turned[1] * pitch > 0.1
    assert turned[2] * yaw > 0.005


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


def test_a_fault_waits_for_the_takeoff() -> None:
    link, simulation = lockstep(fault_injection("F1/SV1", 2, onset_s=0.2))
    for count in range(300):
        link.feed(servo_bytes(count, OFF), "a", 0.0)
    assert simulation.takeoff_s is None
    for count in range(300, 1500):
        row = answered(link.feed(servo_bytes(count, CLIMB), "a", 0.0))
        if row["position"][2] < -0.1:
            break
    assert simulation.takeoff_s is not None
    assert simulation.takeoff_s == pytest.approx(row["timestamp"], abs=0.002)
