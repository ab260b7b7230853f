"""Autopilots outside by their bytes: ArduPilot's JSON physics, PX4's simulator messages, and the table [hil]."""

import math
import struct
from collections import Counter
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from hil_bytes import answered, controls_bytes, frames_in, servo_bytes
from hypothesis import given, settings
from hypothesis import strategies as st

from mavdiag.airframe.layout import layout_named
from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder
from sitl_plant.hil.ardupilot import Lockstep, servo_frame
from sitl_plant.hil.px4 import WANTED, Bridge
from sitl_plant.hil.simulation import AutopilotName, Simulation, output_map, parameter_file, pilot_of
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import Hil, HilPilot, allocation, qdrone2, vehicle_named

OFF, CLIMB = [1000] * 4, [1600] * 4


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


def test_rotor_speeds_come_by_the_autopilots_outputs() -> None:
    link, simulation = lockstep()
    for count in range(300):
        told = answered(link.feed(servo_bytes(count, [1600, 1500, 1400, 1300]), "a", 0.0))
    rpm = simulation.now.rotor_speed[0] * 60 / (2 * math.pi)  # outputs 1 to 4 turn rotors 2, 3, 4 and 1
    np.testing.assert_allclose([told[f"rpm_{n}"] for n in (1, 2, 3, 4)], rpm[[1, 2, 3, 0]], atol=0.051)
    assert told["rpm_1"] > told["rpm_2"] > told["rpm_3"] > told["rpm_4"] > 1000.0


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


RATE_HZ = 250


def bridge() -> Bridge:
    simulation = Simulation(PlantConfig(seed=3))
    return Bridge(simulation, output_map(simulation.config.vehicle, "px4"), RATE_HZ)


def hear(link: Bridge, data: bytes) -> None:
    for frame in Decoder(WANTED).feed(data, 0):
        link.hear(frame)


def sent(link: Bridge, periods: int) -> list[tuple[int, tuple[float, ...]]]:
    return [
        (msgid, values)
        for message in chain.from_iterable(link.advance() for _ in range(periods))
        for msgid, values, _ in frames_in(message)
    ]


def of(messages: list[tuple[int, tuple[float, ...]]], msgid: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([values for one, values in messages if one == msgid])


def test_messages_come_at_their_rates() -> None:
    counts = Counter(msgid for msgid, _ in sent(bridge(), 10 * RATE_HZ))
    within = {107: 0, 113: 2, 115: 10, 0: 1}
    assert counts == {
        msgid: pytest.approx(10 * rate_hz, abs=within[msgid])
        for msgid, rate_hz in {107: RATE_HZ, 113: 10, 115: 50, 0: 1}.items()
    }


def test_the_sensors_of_a_vehicle_at_rest() -> None:
    """Gravity, the field of Zurich in body axes, and the pressure at 488 m by the standard atmosphere."""
    rows = of(sent(bridge(), 4 * RATE_HZ), 107)
    np.testing.assert_array_equal(np.diff(rows[:, 0]), 4000)
    np.testing.assert_allclose(rows[:, 1:4].mean(axis=0), [0.0, 0.0, -9.81], atol=0.02)
    np.testing.assert_allclose(rows[:, 4:7].mean(axis=0), 0.0, atol=0.004)
    updated = rows[:, 14].astype(int)
    assert np.all(updated & 0b111_111 == 0b111_111)
    compass, baro = updated & 0b111_000_000 != 0, updated & 0b1_000_000_000 != 0
    assert set(updated[baro] & 0b1_101_000_000_000) == {0b1_101_000_000_000}
    assert compass.sum() == pytest.approx(200, abs=4)
    assert baro.sum() == pytest.approx(80, abs=2)
    np.testing.assert_allclose(rows[compass, 7:10].mean(axis=0), [0.21523, 0.00771, 0.42741], atol=0.002)
    assert rows[baro, 10].mean() == pytest.approx(1013.25 * (1 - 0.0065 * 488 / 288.15) ** 5.2559, abs=0.1)
    assert len(np.unique(rows[compass, 7])) > 100, "a reading that stands still is a broken sensor to PX4"


def test_controls_turn_the_motors_only_if_armed() -> None:
    link = bridge()
    hear(link, controls_bytes(0, [0.62] * 4, armed=False))
    sent(link, 100)
    assert link.simulation.now.rotor_speed.max() < 1.0
    hear(link, controls_bytes(0, [0.62] * 4))
    assert (link.answered, link.lockstep, link.controls) == (True, True, 2)
    rows = of(sent(link, 100), 115)
    assert not link.answered
    assert rows[-1][13] < -20, "climbs, in cm/s down"
    assert rows[-1][10] > 488_010


ARDUPILOT = {
    "qdrone2": "x",
    "qdrone2-recorded": "x",
    "quad-plus": "plus",
    "hexa-x": "hexa-x",
    "hexa-plus": "hexa-plus",
    "octo-x": "octo-x",
}


@pytest.mark.parametrize("name", ARDUPILOT)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_output_k_is_the_autopilots_motor_k(name: str, autopilot: AutopilotName) -> None:
    """What an output does to roll, pitch and yaw has the sign that ArduHilPilot's frame of that kind says."""
    vehicle = vehicle_named(name)
    outputs = pilot_of(vehicle, autopilot)[1].rotors
    effects = np.round(allocation(vehicle)[1:, np.array(outputs) - 1].T, 6)
    np.testing.assert_array_equal(np.sign(effects), np.sign(np.round(layout_named(ARDUPILOT[name]).mixing, 6)))


@pytest.mark.parametrize("name", ARDUPILOT)
def test_ardupilots_file_is_name_comma_value(name: str) -> None:
    vehicle = vehicle_named(name)
    lines = parameter_file(vehicle, "ardupilot").splitlines()
    assert lines[0].startswith("#")
    values = {line.split(",")[0]: float(line.split(",")[1]) for line in lines[1:]}
    assert values["FRAME_CLASS"] == {4: 1, 6: 2, 8: 3}[len(vehicle.rotors)]
    assert values["FRAME_TYPE"] == (0 if name.endswith("plus") else 1)
    hover = Plant(PlantConfig(vehicle=vehicle, drone=2, trajectory="hover")).advance(2000).duty
    assert values["MOT_THST_HOVER"] == pytest.approx(np.mean(hover**2), abs=0.015)
    assert all(len(parameter) <= 16 for parameter in values)


def test_px4s_file_has_the_tabs_of_qgroundcontrol_and_the_geometry() -> None:
    """Columns: vehicle, component, name, value, MAV_PARAM_TYPE (6 int32, 9 real32)."""
    rows = [line.split("\t") for line in parameter_file(qdrone2(), "px4").splitlines() if not line.startswith("#")]
    assert {(row[0], row[1]) for row in rows} == {("1", "1")}
    found = {name: (value, kind) for _, _, name, value, kind in rows}
    assert found["CA_ROTOR_COUNT"] == ("4", "6")
    assert found["CA_ROTOR0_PX"] == ("0.1016", "9")
    assert found["CA_ROTOR0_PY"] == ("0.127", "9")
    assert float(found["CA_ROTOR0_KM"][0]) == pytest.approx(1 / 68.9055, abs=1e-5), "front right, counter-clockwise"
    assert float(found["CA_ROTOR2_KM"][0]) < 0
    assert found["PWM_MAIN_FUNC4"] == ("104", "6")
    assert "SYS_HITL" not in found
    assert all(("." in value) == (kind == "9") for value, kind in found.values())


def test_a_vehicle_that_does_not_tell_its_outputs_is_refused() -> None:
    with pytest.raises(UsageError, match=r"add a table \[hil\]"):
        output_map(replace(qdrone2(), hil=None), "ardupilot")
    twice = HilPilot((1, 2, 3, 3))
    with pytest.raises(UsageError, match=r"hil.px4.rotors must name each rotor 1 to 4 once"):
        output_map(replace(qdrone2(), hil=Hil((1000.0, 2000.0), twice, twice)), "px4")
