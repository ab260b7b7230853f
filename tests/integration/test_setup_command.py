"""`mavdiag setup`: the emulated vehicle with a pilot who does what he is told, in virtual time and on real sockets."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from piloted import Clock, PilotedVehicle
from shared_data import shared

from detector.config import load_settings
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.setup import BASELINE, CONFIG, setup
from mavdiag.errors import InputError
from mavdiag.learning.coaching import ROUNDS, Coverage, Task
from mavdiag.link.codec import Decoder, Frame, field_index
from mavdiag.link.messages import MessageId
from mavdiag.link.ports.base import Chunk, Endpoint
from mavdiag.units import NS_PER_S

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

    places = ("mavdiag.link.link", "mavdiag.commands.inspect", "mavdiag.commands.setup")
    with ExitStack() as stack:
        for place in places:
            stack.enter_context(patch(f"{place}.time", vehicle.clock))
        stack.enter_context(patch("mavdiag.link.link.open_endpoint", lambda address: vehicle))
        stack.enter_context(patch("mavdiag.commands.setup.say", told))
        stack.enter_context(patch("mavdiag.commands.setup.POLL_S", 0.2))  # fewer and longer looks at the link
        stack.enter_context(patch("typer.confirm", side_effect=AssertionError("a question")))
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


class Played(Endpoint):
    """The near end of a link on which a recording is played; what is sent is kept. Long after its end it stops."""

    datagrams = True
    sources = ()

    def __init__(self, path: Path, clock: Clock) -> None:
        super().__init__("memory:near")
        self.clock, self.sent, self._records = clock, Decoder(), deque(records(path))
        self.asked = list[Frame]()
        self._late_ns = clock.ns - self._records[0][0]
        self._stop_ns = self._records[-1][0] + self._late_ns + 60 * NS_PER_S
        self.heard = set[str]()  # parameters
        self._decoder = Decoder((MessageId.PARAM_VALUE,))

    @property
    def connected(self) -> bool:
        return True

    def filenos(self) -> tuple[int, ...]:
        return ()

    def send(self, data: bytes) -> None:
        frames = self.sent.feed(data, 0)
        assert not self.heard.intersection(map(parameter, frames)), "a parameter that was told is asked for"
        self.asked += frames

    def close(self) -> None:
        """It stays open."""

    def _drain(self) -> list[Chunk]:
        return []

    def receive(self, timeout_s: float) -> list[Chunk]:
        self.clock.ns += max(1, round(timeout_s * NS_PER_S))
        if self.clock.ns > self._stop_ns:
            raise KeyboardInterrupt
        found = list[Chunk]()
        while self._records and self._records[0][0] + self._late_ns <= self.clock.ns:
            found.append((self._records.popleft()[1], self.clock.ns))
        self.heard.update(parameter(one) for data, ns in found for one in self._decoder.feed(data, ns))
        return found


def records(path: Path) -> Iterator[tuple[int, bytes]]:
    """Time [ns] and frame of each record of a .tlog."""
    data, at = path.read_bytes(), 0
    while at + 10 < len(data):
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


def test_the_tasks_are_asked_for_in_rounds_until_all_is_flown() -> None:
    coverage, asked = Coverage(), list[Task]()
    while (step := coverage.step) is not None:
        asked.append(step.task)
        coverage.flown_s[step.task] += step.left_s
    assert asked == [*Task] * ROUNDS
    assert coverage.flown_s == {task: task.wanted_s for task in Task}
