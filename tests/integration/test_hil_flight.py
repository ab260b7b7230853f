"""A small autopilot flies the served plant over each protocol, through sockets and a process; and `sitl-plant`."""

import io
import json
import math
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import chain
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_port import memory_pair
from processes import PATIENCE_S, first_line, process
from reference_pilot import Course, Pilot, Sensed

from mavdiag.airframe.layout import layout_named
from mavdiag.link.codec import Decoder, Encoder, field_index
from mavdiag.link.messages import MessageId, ModeFlag, Severity
from mavdiag.link.ports import Endpoint, open_endpoint
from mavdiag.telemetry import FloatArray
from sitl_plant.__main__ import fleet
from sitl_plant.autopilot.dialect import DIALECTS
from sitl_plant.emulator import Link, fly
from sitl_plant.hil.ardupilot import Lockstep, servo_frame
from sitl_plant.hil.px4 import WANTED, Bridge
from sitl_plant.hil.simulation import AutopilotName, Simulation, output_map, parameter_file, pilot_of
from sitl_plant.options import flight_plan
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.truth import Truth
from sitl_plant.vehicle import allocation, qdrone2, vehicle_named

MOTORS = (2, 3, 4, 1)  # quad X of both autopilots: front right, rear left, front left, rear right
COURSE = Course(height_m=0.8, side_m=1.0, speed_m_s=0.8)
HOME = (47.397742, 8.545594)
EARTH_M = 6_371_000.0
OFF, CLIMB = [1000] * 4, [1600] * 4
RATE_HZ = 250
FLEET = [sys.executable, "-m", "sitl_plant", "fleet", "--profile", "ardupilot", "--rate", "50"]
MODE = field_index(MessageId.HEARTBEAT, "base_mode")
DIALECT = DIALECTS["qdrone2"]


def servo_bytes(count: int, pwm: Sequence[int], rate_hz: int = 1000) -> bytes:
    """ArduPilot's servo packet: u16 magic, u16 frame_rate, u32 frame_count, u16 pwm[16], little-endian."""
    return struct.pack("<HHI16H", 18458, rate_hz, count, *pwm, *[0] * (16 - len(pwm)))


def answered(data: bytes | None) -> dict[str, Any]:
    """The answer, read as strictly as ArduPilot's parser does: between line ends, no blanks, no space behind a name."""
    assert data is not None
    assert data[:1] == data[-1:] == b"\n"
    assert b" " not in data
    found: dict[str, Any] = json.loads(data)
    for name, size in (("position", 3), ("velocity", 3), ("quaternion", 4)):
        assert len(found[name]) == size
    assert len(found["imu"]["gyro"]) == len(found["imu"]["accel_body"]) == 3
    return found


def packed(message: dialect.MAVLink_message, seq: int = 0) -> bytes:
    mav = dialect.MAVLink(None, 1, 1)
    mav.seq = seq & 255
    return bytes(message.pack(mav))


def controls_bytes(t_us: int, controls: Sequence[float], armed: bool = True, flags: int = 1, seq: int = 0) -> bytes:
    """HIL_ACTUATOR_CONTROLS as PX4 in simulation sends it: 1 in the flags for lockstep, mode custom and armed."""
    outputs = [*controls, *[0.0] * (16 - len(controls))]
    return packed(dialect.mavlink_map[93](t_us, outputs, 1 | 128 * armed, flags), seq)


def frames_in(data: bytes, mav: dialect.MAVLink | None = None) -> list[tuple[int, tuple[Any, ...]]]:
    """Message and values, in the order of the wire, of each frame that is whole. mav: keeps the rest."""
    found = []
    for message in (mav or dialect.MAVLink(None)).parse_buffer(data) or ():
        values = (getattr(message, name) for name in message.ordered_fieldnames)
        flat = chain.from_iterable(one if isinstance(one, list) else [one] for one in values)
        found.append((message.get_msgId(), tuple(flat)))
    return found


@contextmanager
def serving(*options: str) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """A served plant and its port."""
    with process([sys.executable, "-m", "sitl_plant", *options]) as plant:
        line = first_line(plant)
        assert "waiting for" in line, line
        yield int(line.rpartition(":")[2]), plant


def flown(course: Course, exchange: Callable[[tuple[float, ...]], Sensed]) -> FloatArray:
    """The whole course, (n, 8): time, place, heading, and how far from where the target is."""
    pilot, rows, t_s = Pilot(qdrone2(), MOTORS, course.at), [], 0.0
    duties: tuple[float, ...] = (0.0,) * 4
    while t_s < course.end_s + 0.5:
        sensed = exchange(duties)
        t_s, (w, x, y, z) = sensed.t_s, sensed.quaternion
        duties, target = pilot.step(sensed).duties, course.at(t_s)
        heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        rows.append((t_s, *sensed.position, heading, *np.subtract(sensed.position, target.position)))
    return np.array(rows)


def check(rows: FloatArray, course: Course) -> None:
    """It rose, went round the square, turned its nose to the right and back, and rests on the ground."""
    t_s, place, heading, away = rows[:, 0], rows[:, 1:4], rows[:, 4], rows[:, 5:8]
    square = (t_s > course.up_s) & (t_s < course.down_s)
    assert np.abs(away[square]).max() < 0.4
    np.testing.assert_allclose(place[square, :2].max(axis=0), course.side_m, atol=0.35)  # with what it overshoots
    assert -place[:, 2].min() == pytest.approx(course.height_m, abs=0.2)
    assert heading.max() == pytest.approx(np.pi / 2, abs=0.2)
    assert abs(heading[-1]) < 0.2
    np.testing.assert_allclose(place[t_s > course.end_s, 2], 0.0, atol=0.03)
    assert np.abs(place[-1, :2]).max() < 0.3


def test_over_ardupilots_protocol(tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    fault = ("--fault", "F1/SV1", "--rotor", "2", "--onset", "4", "--truth", str(truth))
    with (
        serving("serve-ardupilot", "--listen", "udpin:127.0.0.1:0", *fault) as (port, plant),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link,
    ):
        link.connect(("127.0.0.1", port))
        link.settimeout(PATIENCE_S)
        count = 0

        def exchange(duties: tuple[float, ...]) -> Sensed:
            nonlocal count
            link.send(servo_bytes(count, [round(1000 + 1000 * duty) for duty in duties], RATE_HZ))
            count += 1
            found = answered(link.recv(2048))
            return Sensed(
                found["timestamp"], found["imu"]["gyro"], found["position"], found["velocity"], found["quaternion"]
            )

        check(flown(COURSE, exchange), COURSE)
        link.send(b"who is there?")
        exchange((0.5,) * 4)  # answered after what came before it was read
        plant.send_signal(signal.SIGINT)
        assert plant.stdout is not None
        said = plant.stdout.read().splitlines()
        assert plant.wait(PATIENCE_S) == 0
    assert said[0].startswith("ignored 13 bytes that are no servo frame")
    assert f"{count} frames" in said[1]
    assert "0 restarts" in said[1]
    assert "1 foreign" in said[1]
    lines = [json.loads(line) for line in truth.read_text(encoding="utf-8").splitlines()]
    onset = next(line for line in lines if line["record"] == "onset")
    risen = next(line["t_s"] for line in lines if line["record"] == "state" and line["position_m"][2] < -0.1)
    assert (onset["fault"], onset["rotor"]) == ("F1/SV1", 2)
    assert risen + 3.0 <= onset["t_s"] <= risen + 4.0


class Px4(AbstractContextManager["Px4"]):
    """PX4 in simulation: connects, says that it is there, asks for the truth, answers every HIL_SENSOR in lockstep."""

    def __init__(self, port: int) -> None:
        self._link = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._link.sendall(packed(dialect.mavlink_map[76](0, 0, 511, 0, 115.0, 4e3, 0, 0, 0, 0, 0)))
        self._link.sendall(packed(dialect.mavlink_map[0](0, 12, 0, 0, 0, 0)))
        self._mav, self._gyro, self._seq = dialect.MAVLink(None), [0.0] * 3, 0
        self._waiting = list[tuple[int, tuple[Any, ...]]]()
        self._t_us: int | None = None

    def exchange(self, duties: tuple[float, ...]) -> Sensed:
        """The controls for the last sensor message, if there was one; then what the next one says."""
        if self._t_us is not None:
            self._seq += 1
            self._link.sendall(controls_bytes(self._t_us, duties, armed=any(duties), seq=self._seq))
        while True:
            while self._waiting:
                msgid, values = self._waiting.pop(0)
                if msgid == 107:
                    self._t_us, self._gyro = values[0], list(values[4:7])
                if msgid == 115 and values[0] == self._t_us:
                    return self._state(values)
            data = self._link.recv(4096)
            assert data, "the plant hung up"
            self._waiting += frames_in(data, self._mav)

    def _state(self, values: tuple[float, ...]) -> Sensed:
        north = np.radians(values[8] * 1e-7 - HOME[0]) * EARTH_M
        east = np.radians(values[9] * 1e-7 - HOME[1]) * EARTH_M * np.cos(np.radians(HOME[0]))
        position = (north, east, 488.0 - 1e-3 * values[10])
        return Sensed(1e-6 * values[0], self._gyro, position, [1e-2 * one for one in values[11:14]], values[1:5])

    def __exit__(self, kind: object, error: object, at: object) -> None:
        self._link.close()


def test_over_px4s_protocol() -> None:
    with serving("serve-px4", "--listen", "tcpin:127.0.0.1:0", "--speed", "max") as (port, plant):
        with Px4(port) as autopilot:
            check(flown(COURSE, autopilot.exchange), COURSE)
        time.sleep(0.5)
        with Px4(port) as again:  # restarted: the flight begins anew
            assert again.exchange((0.0,) * 4).t_s < 1.0
        plant.send_signal(signal.SIGTERM)
        assert plant.stdout is not None
        said = plant.stdout.read()
        assert plant.wait(PATIENCE_S) == 0
    assert "1 restarts" in said


@pytest.mark.realtime
def test_a_flight_controller_in_hil_mode_in_real_time() -> None:
    """Over UDP as over a serial line; it is told that its HIL mode is off."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link,
        process([sys.executable, "-m", "sitl_plant", "serve-hil", "udpin:127.0.0.1:0", "--duration", "2"]) as plant,
    ):
        link.connect(("127.0.0.1", int(first_line(plant).rpartition(":")[2])))
        link.settimeout(PATIENCE_S)
        link.send(packed(dialect.mavlink_map[0](2, 12, 81, 0, 4, 3)))
        started_s, sensors = time.monotonic(), 0
        while sensors < 490:
            sensors += sum(msgid == 107 for msgid, _ in frames_in(link.recv(2048)))
            if sensors % 50 == 0:
                link.send(controls_bytes(0, [0.2] * 4, flags=15))
        assert time.monotonic() - started_s > 1.5
        assert plant.stdout is not None
        said = plant.stdout.read()
        assert plant.wait(PATIENCE_S) == 0
    assert "not in HIL mode" in said
    assert "2.0 s flown" in said


def lockstep(*faults: Injection, **options: float) -> tuple[Lockstep, Simulation]:
    simulation = Simulation(PlantConfig(seed=3, **options), faults)  # type: ignore[arg-type]
    return Lockstep(simulation, output_map(simulation.config.vehicle, "ardupilot")), simulation


@pytest.mark.parametrize("rate_hz", [50, 333, 1000, 2500])
def test_flight_time_is_frames_over_rate(rate_hz: int) -> None:
    link, simulation = lockstep()
    stamps = [answered(link.feed(servo_bytes(count, OFF, rate_hz), "a", 0.0))["timestamp"] for count in range(rate_hz)]
    assert simulation.t_s == pytest.approx(1.001, abs=0.0015)  # the sensors were read once before the first frame
    assert np.all(np.diff(stamps) >= 0.0)
    assert np.diff(stamps).max() <= 1.0 / rate_hz + 0.001


def test_a_repeated_frame_is_answered_again_and_not_flown() -> None:
    link, simulation = lockstep()
    link.feed(servo_bytes(0, CLIMB), "a", 0.0)
    first, t_s = link.feed(servo_bytes(1, CLIMB), "a", 0.1), simulation.t_s
    assert (link.feed(servo_bytes(1, OFF), "a", 1.1), simulation.t_s, link.counts.resent) == (first, t_s, 1)
    assert answered(link.feed(servo_bytes(2, CLIMB), "a", 1.2))["timestamp"] > answered(first)["timestamp"]


def test_a_smaller_count_is_a_restarted_autopilot_and_the_plant_stands_on_the_ground_anew() -> None:
    link, _ = lockstep()
    for count in range(500):
        high = answered(link.feed(servo_bytes(count, CLIMB), "a", 0.0))
    assert high["position"][2] < -0.05
    low = answered(link.feed(servo_bytes(0, OFF), "a", 0.0))
    assert (link.counts.restarts, low["timestamp"]) == (1, pytest.approx(0.001))
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
    assert servo_frame(data) is None or struct.unpack_from("<H", data)[0] in (18458, 29569)


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


def bridge() -> Bridge:
    simulation = Simulation(PlantConfig(seed=3))
    return Bridge(simulation, output_map(simulation.config.vehicle, "px4"), RATE_HZ)


def hear(link: Bridge, data: bytes) -> None:
    for frame in Decoder(WANTED).feed(data, 0):
        link.hear(frame)


def sent(link: Bridge, periods: int) -> list[tuple[int, tuple[float, ...]]]:
    return [one for _ in range(periods) for message in link.advance() for one in frames_in(message)]


def of(messages: list[tuple[int, tuple[float, ...]]], msgid: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([values for one, values in messages if one == msgid])


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
    assert (compass.sum(), baro.sum()) == (pytest.approx(200, abs=4), pytest.approx(80, abs=2))
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


ARDUPILOT = {"qdrone2": "x", "qdrone2-recorded": "x", "quad-plus": "plus"}
ARDUPILOT |= {name: name for name in ("hexa-x", "hexa-plus", "octo-x")}


@pytest.mark.parametrize("name", ARDUPILOT)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_output_k_is_the_autopilots_motor_k(name: str, autopilot: AutopilotName) -> None:
    """What an output does to roll, pitch and yaw has the sign that ArduHilPilot's frame of that kind says."""
    vehicle = vehicle_named(name)
    effects = np.round(allocation(vehicle)[1:, np.array(pilot_of(vehicle, autopilot)[1].rotors) - 1].T, 6)
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


def read_lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_the_same_options_give_the_same_file_and_another_seed_another(program: Any, tmp_path: Path) -> None:
    flight = ("--duration", "2", "--fault", "F2/SV2", "--rotor", "3", "--onset", "1", "--rate", "200", "--seed")
    files, truth = {name: tmp_path / f"{name}.tlog" for name in ("one", "same", "other")}, tmp_path / "truth.jsonl"
    for (name, path), seed in zip(files.items(), ("4", "4", "5"), strict=True):
        code, out, err = program("sitl_plant.__main__", "record", "-o", path, *flight, seed, "--truth", truth)
        assert code == 0, err
        assert str(files[name]) in out
    one, same, other = (path.read_bytes() for path in files.values())
    assert one == same
    assert one != other
    lines = read_lines(truth)
    assert [line["record"] for line in lines] == ["flight", "state", "onset", "state"]
    assert (lines[0]["seed"], lines[0]["started_unix_ns"]) == (5, None)
    assert (lines[2]["t_s"], lines[2]["fault"], lines[2]["rotor"]) == (1.0, "F2/SV2", 3)
    assert [line["fault_present"] for line in lines if line["record"] == "state"] == [False, True]


def test_a_record_that_is_ended_leaves_no_file(tmp_path: Path) -> None:
    with process([sys.executable, "-m", "sitl_plant", "record", "-o", f"{tmp_path}/a.tlog", "--duration=1e6"]) as plant:
        assert "flying 1e+06 s" in first_line(plant)
        plant.terminate()
        assert plant.wait(PATIENCE_S) in (130, -signal.SIGINT)  # the latter out of code that is being compiled
    assert list(tmp_path.iterdir()) == []


@pytest.mark.realtime
def test_a_flight_keeps_the_wall_clock_and_no_message_comes_early() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as ear:
        command = ["run", "--json", "--out", ear.address.replace("udpin", "udpout"), "--duration", "3"]
        flight = subprocess.Popen([sys.executable, "-m", "sitl_plant", *command], stdout=subprocess.PIPE, text=True)
        decoder, frames = Decoder(), []
        place, until = field_index(MessageId.RAW_IMU, "time_usec"), time.monotonic() + PATIENCE_S
        while flight.poll() is None and time.monotonic() < until:
            frames += [frame for data, host_ns in ear.receive(0.1) for frame in decoder.feed(data, host_ns)]
        frames += [frame for data, host_ns in ear.receive(0.1) for frame in decoder.feed(data, host_ns)]
        output, _ = flight.communicate(timeout=PATIENCE_S)
        assert ear.traffic.overflowed == 0
    assert flight.returncode == 0
    report = json.loads(output.splitlines()[-1])
    assert report["event"] == "landed"
    assert report["wall_s"] > 2.9
    imu = [(frame.host_ns, int(frame.fields[place]) * 1000) for frame in frames if frame.msgid == MessageId.RAW_IMU]
    assert (len(imu), decoder.senders[1, 1].lost) == (3000, 0)
    if report["late_max_ms"] < 100.0:  # else the machine had other things to do, and the report says so
        delay = [host_ns - t_ns for host_ns, t_ns in imu]
        assert report["wall_s"] < 3.5
        assert report["slips"] == 0
        assert sorted(delay)[len(delay) // 2] - min(delay) < 0.1e9


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_flight_in_good_order(program: Any, number: signal.Signals, tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    command = ["run", "--json", "--out", "udpin:127.0.0.1:0", "--truth", str(truth)]
    flight = subprocess.Popen([sys.executable, "-m", "sitl_plant", *command], stdout=subprocess.PIPE, text=True)
    assert flight.stdout is not None
    assert json.loads(flight.stdout.readline())["event"] == "flying"
    time.sleep(0.3)
    flight.send_signal(number)
    output, _ = flight.communicate(timeout=PATIENCE_S)
    assert (flight.returncode, json.loads(output)["event"]) == (0, "landed")
    assert [line["record"] for line in read_lines(truth)][:2] == ["flight", "state"]
    refused, _, _ = program("sitl_plant.__main__", *command, "--rotor", "9", "--fault", "F2/SV2")
    assert (refused, truth.read_text(encoding="utf-8").count("flight") > 0) == (2, True)


def test_the_truth_keeps_the_wall_clock_when_the_flight_was_late() -> None:
    plant, file = Plant(PlantConfig(fault="F2/SV2", onset_s=0.3)), io.StringIO()
    truth = Truth(plant.config, "qdrone2", 200.0, 1, file)

    def watch(samples: PlantSamples) -> None:
        truth.write(samples)
        time.sleep(float(samples.t_ns[0] == 100_000_000))  # once, a second

    fly(plant, DIALECT, [], duration_s=0.5, speed=1.0, stop=lambda: False, watch=watch, slip=truth.slip)
    onset = json.loads(file.getvalue().splitlines()[-1])
    assert onset["unix_ns"] - 1e9 * onset["t_s"] > 0.9e9


def heard(ends: list[Endpoint], until_disarmed: set[int]) -> list[dict[int, list[bool]]]:
    """For each end, whether each system id was armed, heartbeat by heartbeat, until these landed."""
    found: list[dict[int, list[bool]]] = [{} for _ in ends]
    deadline, decoder = time.monotonic() + PATIENCE_S, Decoder({MessageId.HEARTBEAT})
    landed = set[int]()
    while landed < until_disarmed and time.monotonic() < deadline:
        for end, own in zip(ends, found, strict=True):
            for frame in decoder.take(end.receive(0.05)):
                armed = bool(int(frame.fields[MODE]) & ModeFlag.SAFETY_ARMED)
                told = own.setdefault(frame.sysid, [])
                landed |= {frame.sysid} if told and told[-1] and not armed else set()
                told.append(armed)
    assert landed == until_disarmed
    return found


@pytest.mark.realtime
def test_a_fleet_takes_off_and_lands_on_one_port() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as end:
        out = end.address.replace("udpin", "udpout")
        options = ["-n", "2", "--system-id", "7", "--out", out, "--takeoff", "--duration", "15"]
        with process([*FLEET, *options]) as plant:
            (found,) = heard([end], {7, 8})
            assert plant.wait(PATIENCE_S) == 0
    assert set(found) == {7, 8}
    assert all(True in told for told in found.values())


def test_a_fleet_ends_with_the_process_that_began_it() -> None:
    with subprocess.Popen([*FLEET, "-n2", "--out", "udpout:127.0.0.1:9"], stdout=subprocess.PIPE, text=True) as plant:
        assert "2 vehicles fly" in first_line(plant)
        plant.kill()
        plant.communicate(timeout=PATIENCE_S)  # the output ends with the last process that has it


def test_only_the_vehicles_that_are_named_get_the_fault() -> None:
    flown: list[tuple[int, str | None, int]] = []

    class Inline:
        """In place of a process."""

        exitcode = 0

        def __init__(self, target: object, args: tuple[object, ...]) -> None:
            plan = args[0]
            flown.append((plan.dialect.sysid, plan.config.fault, plan.config.seed))  # type: ignore[attr-defined]  # a plan

        def start(self) -> None: ...
        def join(self) -> None: ...
        def is_alive(self) -> bool:
            return False

    with patch("multiprocessing.context.ForkContext.Process", Inline):
        fleet.__wrapped__(flight_plan(fault="F2/SV2", seed=5), 4, "2,4", "udpout:127.0.0.1:9")  # type: ignore[attr-defined]  # the command without its options
    assert flown == [(1, None, 5), (2, "F2/SV2", 6), (3, None, 7), (4, "F2/SV2", 8)]


# The run loop over in-memory links, as fast as it goes: what is said, answered and passed on
def test_an_alert_is_passed_on_in_its_senders_name() -> None:
    """At the far ends of two links are a ground station and a companion computer."""
    with ExitStack() as stack:
        pairs = [[stack.enter_context(end) for end in memory_pair()] for _ in range(2)]
        (_, station), (_, companion) = pairs
        station.send(Encoder(255, 190).encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3))
        alerter, decoders = Encoder(1, 191), [Decoder(), Decoder()]
        for rotor in (1, 2):
            companion.send(alerter.statustext(Severity.CRITICAL, f"PROP FAULT r{rotor}"))
        links, plant = [Link(near, DIALECT, 200.0) for near, _ in pairs], Plant(PlantConfig(seed=11))
        fly(plant, DIALECT, links, duration_s=0.5, speed=None, stop=lambda: False, watch=lambda _: None)
        forward, back = (
            [frame for data, host_ns in far.receive(0.0) for frame in decoder.feed(data, host_ns)]
            for (_, far), decoder in zip(pairs, decoders, strict=True)
        )
    assert [one.text("text") for one in forward if one.compid == 191] == ["PROP FAULT r1", "PROP FAULT r2"]
    assert decoders[0].senders[1, 191].lost == 0
    assert not [one for one in back if one.compid == 191 or one.sysid == 255]  # that was heard before the companion was


def test_b28_a_cut_off_datagram_of_one_peer_does_not_spoil_the_next_ones() -> None:
    with ExitStack() as stack:
        near, far = (stack.enter_context(end) for end in memory_pair())
        near.datagrams = True  # as a udpin endpoint has several peers
        link, encoder = Link(near, DIALECT, None), Encoder(255, 190)
        whole = encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3)
        far.send(whole[:-5])
        far.send(encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3))
        assert [frame.seq for frame in link.receive()] == [1]
