"""`mavdiag setup`: the emulated vehicle with a pilot who does what he is told, in virtual time and on real sockets."""

import shlex
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from patience import PATIENCE_S
from piloted import Clock, Pilot, PilotedVehicle
from plant_process import flying, process

from detector.config import load_settings
from mavdiag.baseline import Baseline
from mavdiag.commandline import say
from mavdiag.commands.setup import BASELINE, CONFIG, UNIT, config_text, service_script, setup
from mavdiag.errors import InputError
from mavdiag.learning.coaching import ROUNDS, Coverage, Task
from mavdiag.link.ports import open_endpoint

SPEED = 5
LINK = "udpin:127.0.0.1:14550"
Heard = Callable[[str], None]


@contextmanager
def coached(vehicle: PilotedVehicle, hear: Heard | None = None) -> Iterator[list[str]]:
    """What `setup` says to the vehicle's pilot, on the vehicle's clock. hear: is told, too."""
    lines = list[str]()

    def told(text: str, **options: Any) -> None:
        lines.append(text)
        say(text, **options)
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
def test_a_bare_vehicle_becomes_a_watched_one_though_setup_is_stopped_in_flight(
    profile: str, autopilot: str, tmp_path: Path
) -> None:
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


def test_the_tasks_are_asked_for_in_rounds_until_all_is_flown() -> None:
    coverage, asked = Coverage(), list[Task]()
    while (step := coverage.step) is not None:
        asked.append(step.task)
        coverage.flown_s[step.task] += step.left_s
    assert asked == [*Task] * ROUNDS
    assert coverage.flown_s == {task: task.wanted_s for task in Task}


def test_the_script_of_the_service_is_sound_for_any_folder(tmp_path: Path) -> None:
    folder = tmp_path / "it's mine; rm -rf"
    folder.mkdir()
    (folder / CONFIG).write_text(config_text(LINK, 3, folder, None))
    script = service_script(folder, Path("deploy", UNIT), Path("/usr/local/bin"))
    subprocess.run(["sh", "-n"], input=script, text=True, check=True, timeout=PATIENCE_S)
    edits = [shlex.split(line.partition(" >")[0]) for line in script.splitlines() if line.startswith("sed")]
    config, unit = (subprocess.run(edit, capture_output=True, text=True, check=True).stdout for edit in edits)
    settings = tomllib.loads(config)
    assert (settings["baseline"], settings["vehicle"]) == ("/var/lib/mavdiag/baseline.json", 3)
    assert "ExecStart=/usr/local/bin/mavdiag-detector" in unit


@pytest.mark.realtime
def test_setup_over_udp_with_a_vehicle_that_flies_five_times_as_fast(tmp_path: Path) -> None:
    options = ("--trajectory", "commanded", "--profile", "px4", "--fresh-link", "--speed", str(SPEED))
    with flying(*options, links=2) as (link, other), open_endpoint(other) as endpoint:
        pilot, ended, began_s = Pilot("px4", endpoint.send), threading.Event(), time.monotonic()

        def fly() -> None:
            while not ended.wait(0.02):
                endpoint.receive(0.0)
                pilot.fly(SPEED * (time.monotonic() - began_s))

        command = [sys.executable, "-m", "mavdiag", "setup", link, "-o", str(tmp_path / "made"), "--yes"]
        hands = threading.Thread(target=fly)
        hands.start()
        try:
            with process(command) as coach:
                assert coach.stdout is not None
                lines = []
                for line in coach.stdout:
                    lines.append(line)
                    pilot.hear(line)
                assert coach.wait(PATIENCE_S) == 0, "".join(lines)
        finally:
            ended.set()
            hands.join()
    assert Baseline.load(tmp_path / "made" / BASELINE).grade in ("A", "B")
    assert "now land" in "".join(lines)
    assert "px4 at 160 Hz" in "".join(lines)  # the detector has checked its configuration
