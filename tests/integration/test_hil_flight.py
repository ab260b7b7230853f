"""A small autopilot flies the served plant from the ground and back, over each protocol, through sockets and a process.

The bytes are packed and read by the test. Where a real autopilot is named, one flies as well.
"""

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest
from hil_bytes import answered, controls_bytes, frames_in, mavlink_bytes, servo_bytes
from processes import PATIENCE_S, first_line, process

from mavdiag.telemetry import FloatArray
from sitl_plant.vehicle import qdrone2

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from reference_pilot import Course, Pilot, Sensed

pytestmark = pytest.mark.realtime

MOTORS = (2, 3, 4, 1)  # quad X of both autopilots: front right, rear left, front left, rear right
COURSE = Course(height_m=1.2, side_m=1.0, speed_m_s=0.8)
HOME = (47.397742, 8.545594)
EARTH_M = 6_371_000.0


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
        away = np.subtract(sensed.position, target.position)
        rows.append((t_s, *sensed.position, heading, *away))
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
            link.send(servo_bytes(count, [round(1000 + 1000 * duty) for duty in duties], 400))
            count += 1
            found = answered(link.recv(2048))
            return Sensed(
                found["timestamp"], found["imu"]["gyro"], found["position"], found["velocity"], found["quaternion"]
            )

        check(flown(COURSE, exchange), COURSE)
        link.send(b"who is there?")
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
        self._link.sendall(mavlink_bytes(76, 115.0, 4e3, 0, 0, 0, 0, 0, 511, 0, 0, 0))
        self._link.sendall(mavlink_bytes(0, 0, 0, 12, 0, 0, 0))
        self._pending, self._gyro, self._seq = b"", [0.0] * 3, 0
        self._t_us: int | None = None

    def exchange(self, duties: tuple[float, ...]) -> Sensed:
        """The controls for the last sensor message, if there was one; then what the next one says."""
        if self._t_us is not None:
            self._seq += 1
            self._link.sendall(controls_bytes(self._t_us, duties, armed=any(duties), seq=self._seq))
        while True:
            for msgid, values, end in frames_in(self._pending):
                if msgid == 107:
                    self._t_us, self._gyro = values[0], list(values[4:7])
                if msgid == 115 and values[0] == self._t_us:
                    self._pending = self._pending[end:]
                    return self._state(values)
            data = self._link.recv(4096)
            assert data, "the plant hung up"
            self._pending += data

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


def test_a_flight_controller_in_hil_mode_in_real_time() -> None:
    """Over UDP as over a serial line; it is told that its HIL mode is off."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link,
        process([sys.executable, "-m", "sitl_plant", "serve-hil", "udpin:127.0.0.1:0", "--duration", "2"]) as plant,
    ):
        link.connect(("127.0.0.1", int(first_line(plant).rpartition(":")[2])))
        link.settimeout(PATIENCE_S)
        link.send(mavlink_bytes(0, 0, 2, 12, 81, 4, 3))
        started_s, sensors = time.monotonic(), 0
        while sensors < 490:
            sensors += sum(msgid == 107 for msgid, _, _ in frames_in(link.recv(2048)))
            if sensors % 50 == 0:
                link.send(controls_bytes(0, [0.2] * 4, flags=15))
        assert time.monotonic() - started_s > 1.5
        assert plant.stdout is not None
        said = plant.stdout.read()
        assert plant.wait(PATIENCE_S) == 0
    assert "not in HIL mode" in said
    assert "2.0 s flown" in said
