"""`mavdiag setup`: the emulated vehicle with a pilot who does what he is told, in virtual time and on real sockets."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from memory_port import memory_pair
from shared_data import shared
from virtual_endpoint import Clock, VirtualEndpoint, linked

from detector.config import load_settings
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.setup import BASELINE, CONFIG, setup
from mavdiag.errors import InputError
from mavdiag.learning.coaching import ROUNDS
from mavdiag.link.codec import Argument, Decoder, Encoder, Frame, field_index
from mavdiag.link.datagrams import Chunk, Datagrams, as_columns
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.commands import Autopilot
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.stream import ImuFilters, to_global
from sitl_plant.emulator import Link, obey
from sitl_plant.plant import STEP_NS, Plant, PlantConfig

NAN = float("nan")
CORNERS = ((1.5, 1.5), (1.5, -1.5), (-1.5, -1.5), (-1.5, 1.5))  # m, of the square
AIRBORNE_M = -0.3  # down
TASKS = {"take off": 30.0, "hover": 60.0, "square": 2.6, "nose": 2.5, "land": 60.0}  # how often an order goes out [s]
PLAYED_S = 90.0  # of a recording


class Pilot:
    """Flies by MAVLink commands what a coach's texts say. send: takes the frames. task: what was said last."""

    def __init__(self, profile: str, send: Callable[[bytes], object]) -> None:
        self.task, self._profile, self._send = "", profile, send
        self._station, self._next_s, self._step = Encoder(255, 190), 0.0, 0

    def hear(self, text: str) -> None:
        """Note a task; a task that is said again is gone on with."""
        task = next((task for task in TASKS if f"now {task}" in text), self.task)
        self._next_s = self._next_s if task == self.task else 0.0
        self.task = task

    def fly(self, now_s: float) -> None:
        """Do what is due. now_s: the vehicle's time."""
        if self.task and now_s >= self._next_s:
            self._next_s, self._step = now_s + TASKS[self.task], self._step + 1
            match self.task:
                case "take off":
                    self._take_off()
                case "square":
                    self._go(*CORNERS[self._step % 4], 0.0)
                case "nose":
                    self._go(0.0, 0.0, math.pi / 2 * (self._step % 4))
                case "hover":
                    self._go(0.0, 0.0, 0.0)
                case "land":
                    self._command(MavCmd.NAV_LAND)

    def _take_off(self) -> None:
        if self._profile == "ardupilot":
            self._order(MessageId.SET_MODE, 1, 1, 4)
        self._command(MavCmd.COMPONENT_ARM_DISARM, 1)
        height = NAN if self._profile == "px4" else 2.0
        self._command(MavCmd.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, height)

    def _go(self, north: float, east: float, yaw: float) -> None:
        latitude, longitude, _ = to_global(np.array([[north, east, 0.0]]))[0].tolist()
        place = (round(latitude * 1e7), round(longitude * 1e7), 2.0)
        self._order(MessageId.COMMAND_INT, 1, 1, 6, MavCmd.DO_REPOSITION, 0, 0, 1.5, 0.0, 0.0, yaw, *place)

    def _command(self, command: int, *parameters: float) -> None:
        self._order(MessageId.COMMAND_LONG, 1, 1, command, 0, *parameters)

    def _order(self, msgid: int, *fields: Argument) -> None:
        self._send(self._station.encode(msgid, *fields))


class PilotedVehicle(VirtualEndpoint):
    """The near end of the vehicle's link. To receive for some time lets it fly for so long.

    deaf: it hears its pilot only. flown_s: in the air so far.
    """

    def __init__(self, profile: str, clock: Clock, *, deaf: bool = False, seed: int = 0) -> None:
        super().__init__(clock)
        self.flown_s, self._deaf, dialect = 0.0, deaf, dialect_named(profile)
        flight = PlantConfig(trajectory="commanded", start="ground", seed=seed)
        self.plant, self._filters = Plant(flight), ImuFilters(dialect, flight.seed)
        self._near, far = memory_pair(clock=clock.monotonic_ns)
        self._link = Link(far, dialect, None, self.plant.rotors, fresh=True)
        self.autopilot = Autopilot([self._link.schedule], dialect, flight)
        self.pilot = Pilot(profile, lambda data: self._take(Decoder().feed(data, 0)))

    def send(self, data: bytes) -> None:
        self._near.send(data)

    def receive(self, timeout_s: float) -> Datagrams:
        """Let the vehicle fly on; what it sent."""
        steps = max(1, round(timeout_s * NS_PER_S / STEP_NS))
        filtered = self._filters.step(self.plant.advance(steps))
        self.clock.ns += steps * STEP_NS
        heard = self._link.receive()
        self._take([] if self._deaf else heard)
        self._link.queue(filtered, self.autopilot.dialect)
        self._link.send_due(self.plant.t_ns)
        actions, orders = self.autopilot.watch(filtered.samples)
        for action in actions:
            self._link.act(action)
        for order in orders:
            obey(self.plant, order)
        self.flown_s += timeout_s * bool(filtered.samples.position[-1, 2] < AIRBORNE_M)
        self.pilot.fly(self.plant.t_ns / NS_PER_S)
        return self._near.receive(0.0)

    def _take(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            for action in self.autopilot.step(0, frame, self.plant.t_ns):
                self._link.act(action)


LINK = "udpin:127.0.0.1:14550"
Heard = Callable[[str], None]


@contextmanager
def coached(vehicle: "PilotedVehicle | Played", hear: Heard | None = None) -> Iterator[list[str]]:
    """What `setup` says to the vehicle's pilot, on the vehicle's clock. hear: is told, too."""
    lines = list[str]()

    def told(text: str, **options: Any) -> None:
        lines.append(text)
        say(text, **options)
        if isinstance(vehicle, PilotedVehicle):
            vehicle.pilot.hear(text)
        if hear is not None:
            hear(text)

    with (
        linked(vehicle),
        patch("mavdiag.commands.setup.say", told),
        patch("mavdiag.commands.setup.POLL_S", 0.2),  # fewer and longer looks at the link
        patch("typer.confirm", side_effect=AssertionError("a question")),
    ):
        yield lines


@pytest.mark.parametrize(("profile", "autopilot"), [("ardupilot", "ardupilotmega"), ("px4", "px4")])
def test_a_bare_vehicle_is_set_up_though_stopped_in_flight(profile: str, autopilot: str, tmp_path: Path) -> None:
    folder, vehicle = tmp_path / "made", PilotedVehicle(profile, Clock(), seed=3)

    def stop(text: str) -> None:
        if "now square" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), coached(vehicle, stop) as lines:
        setup(LINK, folder, yes=True)
    shown = "\n".join(lines)
    assert f"vehicle 1: a quadrotor, its autopilot is {autopilot}" in shown
    for words in ("rotor layout ", "gravity: 1.00 g, right", "clock: ", "answered ACCEPTED"):
        assert words in shown, words
    vehicle.pilot.hear("now land")
    for _ in range(30):
        vehicle.receive(1.0)

    with coached(vehicle) as lines:
        setup(LINK, folder, yes=True)
    tasks = [line.split(":")[0].removeprefix("now ") for line in lines if line.startswith("now ")]
    asked = [task for task, before in zip(tasks, ["", *tasks], strict=False) if task != before]
    assert "flight-001.tlog is flown already" in "\n".join(lines)
    assert asked == ["take off", *["square", "nose", "hover"] * (ROUNDS - 1), "square", "nose", "land"]
    assert vehicle.flown_s < 600
    assert len(list(folder.glob("flight-*.tlog"))) == 2
    baseline = Baseline.load(folder / BASELINE)
    assert baseline.grade in ("A", "B")
    assert baseline.airframe.name == "vehicle 1"
    assert baseline.airframe.layout is not None
    shown = "\n".join(lines)
    for words in ("fly in steady wind to widen it", f"grade      {baseline.grade}", "notices    a loss of thrust of"):
        assert words in shown, words
    settings = load_settings(folder / CONFIG, {})
    assert (settings.connect, settings.vehicle) == (LINK, 1)
    assert settings.baseline is not None
    assert Baseline.load(settings.baseline).digest == baseline.digest


def test_what_does_not_come_is_told_with_the_parameter_that_gives_it(tmp_path: Path) -> None:
    vehicle = PilotedVehicle("ardupilot", Clock(), deaf=True)
    words = r"too little comes to learn from: .*no RAW_IMU: SRn_RAW_SENS"
    with pytest.raises(InputError, match=words) as told, coached(vehicle):
        setup(LINK, tmp_path, yes=True)
    assert "\n" not in str(told.value)
    assert vehicle.flown_s == 0.0


class Played(VirtualEndpoint):
    """The near end of a link on which a recording is played; what is sent is kept. Long after its end it stops."""

    def __init__(self, path: Path, clock: Clock) -> None:
        super().__init__(clock)
        self.sent, self._records = Decoder(), deque(records(path, PLAYED_S))
        self.asked = list[Frame]()
        self._late_ns = clock.ns - self._records[0][0]
        self._stop_ns = self._records[-1][0] + self._late_ns + 60 * NS_PER_S
        self.heard = set[str]()  # parameters
        self._decoder = Decoder((MessageId.PARAM_VALUE,))

    def send(self, data: bytes) -> None:
        frames = self.sent.feed(data, 0)
        assert not self.heard.intersection(map(parameter, frames)), "a parameter that was told is asked for"
        self.asked += frames

    def receive(self, timeout_s: float) -> Datagrams:
        self.clock.ns += max(1, round(timeout_s * NS_PER_S))
        if self.clock.ns > self._stop_ns:
            raise KeyboardInterrupt
        found = list[Chunk]()
        while self._records and self._records[0][0] + self._late_ns <= self.clock.ns:
            found.append((self._records.popleft()[1], self.clock.ns))
        self.heard.update(parameter(one) for data, ns in found for one in self._decoder.feed(data, ns))
        return as_columns(found)


def records(path: Path, most_s: float) -> Iterator[tuple[int, bytes]]:
    """Time [ns] and frame of each record at the beginning of a .tlog."""
    data, at = path.read_bytes(), 0
    until_us = int.from_bytes(data[:8], "big") + round(1e6 * most_s)
    while at + 10 < len(data) and int.from_bytes(data[at : at + 8], "big") < until_us:
        more = 12 + 13 * (data[at + 10] & 1) if data[at + 8] == 0xFD else 8
        end = at + 8 + more + data[at + 9]
        yield 1000 * int.from_bytes(data[at : at + 8], "big"), data[at + 8 : end]
        at = end


def parameter(frame: Frame) -> str:
    if frame.msgid not in (MessageId.PARAM_VALUE, MessageId.PARAM_REQUEST_READ):
        return ""
    return str(frame.fields[field_index(frame.msgid, "param_id")])


@pytest.mark.parametrize(
    ("name", "finds"),
    [
        (
            "arducopter_sitl/healthy_quad3kg_sq1.tlog",
            ("its autopilot is ardupilotmega", "gravity: 1.00 g, right", "rotor layout unknown", "low-passed at 20 Hz"),
        ),
        (
            "autopilots_in_the_loop/px4_hil_healthy.tlog",
            ("its autopilot is px4", "gravity: 1.00 g, right", "rotor layout x (the vehicle's parameters"),
        ),
    ],
)
def test_a_recorded_link_tells_what_it_is_and_that_it_ends(name: str, finds: tuple[str, ...], tmp_path: Path) -> None:
    link = Played(shared(f"data/{name}"), Clock())
    with pytest.raises(KeyboardInterrupt), coached(link) as lines:
        setup(LINK, tmp_path, yes=True)
    shown = "\n".join(lines)
    for words in ("vehicle 1: a quadrotor", *finds):
        assert words in shown, words
    assert [line.split(":")[0] for line in lines].count("nothing has come for 5 s") == 1
    ended = next(n for n, line in enumerate(lines) if line.startswith("nothing has come"))
    assert lines[ended + 1].startswith("cut off; covered so far: hover ")
    assert lines[ended + 2 :] == lines[ended + 2 : ended + 3]  # take off, and then nothing more
    assert {one.msgid for one in link.asked} <= {
        MessageId.HEARTBEAT,
        MessageId.STATUSTEXT,
        MessageId.COMMAND_LONG,
        MessageId.PARAM_REQUEST_READ,
    }
    assert len(list(tmp_path.glob("flight-*.tlog"))) == 1
