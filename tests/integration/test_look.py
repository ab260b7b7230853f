"""A first look at flights, which calls no vehicle healthy; and `mavdiag setup` with a pilot who does as he is told."""

import json
import math
import subprocess
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import logged
from made_telemetry import changed
from made_vehicle import recorded
from memory_port import memory_pair
from shared_data import shared, written
from typer.testing import CliRunner
from virtual_endpoint import Clock, VirtualEndpoint, linked

from detector.config import load_settings
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.cli import app
from mavdiag.commandline import say
from mavdiag.commands.inspect import inspect
from mavdiag.commands.setup import BASELINE, CONFIG, HOME, config_text, service_script, setup
from mavdiag.errors import InputError
from mavdiag.learning.coaching import ROUNDS
from mavdiag.link.codec import Argument, Decoder, Encoder, Frame
from mavdiag.link.datagrams import Chunk, Datagrams, as_columns
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.logs import read_log
from mavdiag.look.inspection import inspection_of
from mavdiag.look.words import in_full, in_one_line
from mavdiag.telemetry import Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.commands import Autopilot as Emulated
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.stream import ImuFilters, to_global
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.emulator import Link
from sitl_plant.plant import STEP_NS, Plant, PlantConfig
from sitl_plant.vehicle import vehicle_named

RUN = CliRunner()
NAN = float("nan")
CORNERS = ((1.5, 1.5), (1.5, -1.5), (-1.5, -1.5), (-1.5, 1.5))  # m, of the square
AIRBORNE_M = -0.3  # down
TASKS = {"take off": 30.0, "hover": 60.0, "square": 2.6, "nose": 2.5, "land": 60.0}  # how often an order goes out [s]
PLAYED_S = 90.0  # of a recording
LINK = "udpin:127.0.0.1:14550"
Heard = Callable[[str], None]


def emulated(seed: int, seconds: float = 15.0, profile: str = "qdrone2", **config: object) -> Log:
    plant = PlantConfig(seed=seed, **config)  # type: ignore[arg-type]  # of several types
    return Log("flight", "", profile, flight_telemetry(plant, seconds, LinkSpec(profile))[0])


#: Times in us, gyro in deg/s and accelerometer in g, both in a frame with y to the left and z up.
MAP = """
[time]
column = "t_us"
unit = "us"

[body_rate]
columns = ["gyro_x", "-gyro_y", "-gyro_z"]
unit = "deg/s"

[specific_force]
columns = ["acc_x", "-acc_y", "-acc_z"]
unit = "g"
"""
HEADER = "t_us,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,remark"
SIGNS = np.array([1.0, -1.0, -1.0])


def recording(path: Path, seed: int, seconds: float = 10.0, **config: object) -> Path:
    """Write a flight of the emulated QDrone 2 at 1 kHz. config: of the plant."""
    log = emulated(seed, seconds, **config)  # type: ignore[arg-type]  # of several types
    gyro, force = log[Signal.BODY_RATE], log[Signal.SPECIFIC_FORCE]
    columns = np.column_stack([gyro.t_ns / 1e3, np.degrees(gyro.values) * SIGNS, force.values / 9.80665 * SIGNS])
    lines = [",".join(f"{cell:.6f}" for cell in row) + ",a b" for row in columns]
    path.write_text("\n".join([HEADER, *lines]) + "\n")
    return path


def test_the_rotor_line_stands_at_the_speed_that_the_rotors_tell() -> None:
    log = emulated(5, fault="F1/SV3", rotor=2, onset_s=0.0, trajectory="hover")
    look = inspection_of(log, airframe_named("qdrone2"))
    assert look.line is not None
    assert look.line.told_hz == pytest.approx(167.0, rel=0.05)
    assert look.line.hz == pytest.approx(look.line.told_hz, rel=0.03)


def test_an_output_at_its_end_and_a_high_vibration_are_told_in_their_share() -> None:
    telemetry = changed(flying(3000, seed=3), Signal.ACTUATOR, lambda x: x * [1, 0, 1, 1] + [0, 1, 0, 0], 15.0)
    telemetry = changed(telemetry, Signal.VIBRATION, lambda x: 0 * x + [5.0, 6.0, 7.0])
    look = inspection_of(logged(changed(telemetry, Signal.VIBRATION, lambda _: 65.0, to_s=7.5)), Airframe())
    span_s, left_out_s = 30.0, 30.0 - look.flight_s  # the start is not judged
    assert look.loads[1].full_share == pytest.approx(span_s / 2 / look.flight_s, abs=0.01)
    assert look.vibration is not None
    assert look.vibration.above_high == pytest.approx((span_s / 4 - left_out_s) / look.flight_s, abs=0.02)
    text = "\n".join(in_full(look))
    assert "where ArduPilot expects trouble" in text
    assert "2 at its upper end" in text
    assert "this is no verdict" in text  # and it never says that a vehicle is well
    assert not any(word in text + in_one_line(look) for word in ("healthy", "fault"))


def test_a_folder_gives_a_line_each_and_a_bad_file_loses_nothing(tmp_path: Path) -> None:
    for seed in (1, 2):
        recording(tmp_path / f"{seed}.csv", seed, 6.0)
    (tmp_path / "bad.csv").write_text("no,columns\n1,2\n")
    (tmp_path / "map.toml").write_text(MAP)
    done = RUN.invoke(app, ["look", str(tmp_path), "--columns", str(tmp_path / "map.toml")])
    assert done.exit_code == 2
    lines = done.stdout.splitlines()
    assert [line.split(":")[0].rpartition("/")[2] for line in lines[:3]] == ["1.csv", "2.csv", "bad.csv"]
    assert "no column" in lines[2]
    as_json = RUN.invoke(app, ["look", str(tmp_path / "1.csv"), "--columns", str(tmp_path / "map.toml"), "--json"])
    content = json.loads(as_json.stdout)
    assert (content["profile"], content["loads"]) == ("csv", [])


def test_gyro_and_accelerometer_alone_are_enough_to_find_an_unbalance(tmp_path: Path) -> None:
    (tmp_path / "learn").mkdir()
    for seed in range(4):
        recording(tmp_path / "learn" / f"{seed}.csv", 20 + seed)
    columns, baseline = ["--columns", str(written(tmp_path / "map.toml", MAP))], str(tmp_path / "baseline.json")
    learnt = RUN.invoke(app, ["identify", str(tmp_path / "learn"), *columns, "-o", baseline, "--airframe", "qdrone2"])
    assert learnt.exit_code == 0, learnt.output
    names = {entry.spec.kind for entry in Baseline.load(Path(baseline)).monitors}
    assert {"unbalance", "sensor_noise"} <= names
    assert not names & {"fsd", "innovation", "rotor_trim"}
    sound = recording(tmp_path / "sound.csv", 41)
    damaged = recording(tmp_path / "damaged.csv", 42, fault="F1/SV3", rotor=3, onset_s=4.0)
    judged = RUN.invoke(
        app, ["scan", str(sound), str(damaged), *columns, "--baseline", baseline, "--json", "--no-cache", "--jobs", "1"]
    )
    first, second = (json.loads(line) for line in judged.stdout.splitlines())
    assert (first["verdict"], second["verdict"]) == ("healthy", "fault"), judged.output
    assert min(one["t_s"] for one in second["events"]) > 3.5


def two_flights(pause_s: float) -> Log:
    """Two flights of 30 s in one log, with every sample at a low rate."""
    shift_ns, parts = round((30.0 + pause_s) * 1e9), []
    for one, other in zip(flying(3000, seed=3), flying(3000, seed=4), strict=True):
        t_ns = np.concatenate((one.t_ns[::4], other.t_ns[::4] + shift_ns))
        parts.append(Series(one.signal, t_ns, t_ns, np.concatenate((one.values[::4], other.values[::4]))))
    return logged(Telemetry(tuple(parts)))


def test_two_flights_in_a_log_do_not_lower_its_rate() -> None:
    """A pause as long as both flights once made 11.7 Hz of 25 Hz, and monitors were denied."""
    alone, none = (inspection_of(logged(one), Airframe()) for one in (flying(3000, seed=3), Telemetry()))
    assert in_one_line(none).startswith("log: px4, 0 s, no body rate")
    for pause_s in (5.0, 60.0, 600.0):
        look = inspection_of(two_flights(pause_s), Airframe())
        assert {one.signal: one.rate_hz for one in look.signals}["body_rate"] == pytest.approx(25.0, rel=0.01)
        assert look.monitors == inspection_of(two_flights(5.0), Airframe()).monitors
    assert {one.signal: one.rate_hz for one in alone.signals}["body_rate"] == pytest.approx(100.0, rel=0.01)


def test_log171_is_seen_to_tumble_with_a_motor_at_its_limit() -> None:
    path = shared("data/ardupilot_real/log171.bin")
    look = inspection_of(read_log(path), Airframe())
    assert look.upset.startswith("the flight ends in an upset, at 238.8 s: it turns at 22.")
    text = "\n".join(in_full(look))
    assert "upset: the flight ends in an upset, at 238.8 s" in text
    assert "2 at its upper end for" in text
    assert "upset" in in_one_line(look)
    assert look.rotors.startswith("rotor layout x (the vehicle's parameter FRAME 1 of a quad)")
    earlier = RUN.invoke(app, ["look", str(path), "--to", "230"]).stdout
    assert "upset" not in earlier
    assert "no output reached an end" in earlier


def test_l10_a_fresh_ardupilot_is_told_what_gives_each_monitor_its_streams(capsys: pytest.CaptureFixture[str]) -> None:
    vehicle = PilotedVehicle("ardupilot", Clock())
    with linked(vehicle):
        inspect([LINK], duration=3.0)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "profile ardupilot" in shown
    for words in ("no RAW_IMU: SRn_RAW_SENS", "no VIBRATION: SRn_EXTRA3", "no ATTITUDE: SRn_EXTRA1", "--ask"):
        assert words in shown, words
    assert "works" not in shown
    assert vehicle.heard == []  # it listens only


def test_a_fresh_ardupilot_is_asked_for_streams_and_rotors_and_nothing_set(capsys: pytest.CaptureFixture[str]) -> None:
    vehicle = PilotedVehicle("ardupilot", Clock(), frame="quad-plus")
    for msgid in (MessageId.SERVO_OUTPUT_RAW, MessageId.VIBRATION):  # this one does not know them
        del vehicle._link.schedule._beats[msgid]
    with linked(vehicle):
        inspect([LINK], duration=3.0, ask=True, as_json=True)
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    works = {one["monitor"] for one in found["monitors"] if one["works"]}
    assert {"fsd", "innovation", "rotor_signature", "sensor_drift", "control_loss", "thrust_loss"} == works
    missing = {one["monitor"]: " ".join(one["missing"]) for one in found["monitors"]}
    assert "no SERVO_OUTPUT_RAW: SRn_RC_CHAN" in missing["rotor_trim"]
    assert "low-passed at 20 Hz" in missing["unbalance"]
    assert "FRAME_CLASS 1, FRAME_TYPE 0" in found["rotors"]
    assert found["units"]["gravity_g"] == pytest.approx(1.0, abs=0.03)
    assert any("ACCEPTED, DENIED" in one or "DENIED, ACCEPTED" in one for one in found["asked"])
    sent = {frame.msgid for frame in vehicle.heard}
    assert sent == {MessageId.HEARTBEAT, MessageId.COMMAND_LONG, MessageId.PARAM_REQUEST_READ}
    commands = {frame.value("command") for frame in vehicle.heard if frame.msgid == MessageId.COMMAND_LONG}
    assert commands == {MavCmd.SET_MESSAGE_INTERVAL}


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
        self._command(MavCmd.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN if self._profile == "px4" else 2.0)

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

    deaf: it hears its pilot only. flown_s: in the air so far. heard: every frame that was sent to it.
    """

    def __init__(
        self, profile: str, clock: Clock, *, deaf: bool = False, seed: int = 0, frame: str = "qdrone2"
    ) -> None:
        super().__init__(clock)
        self.flown_s, self._deaf, dialect = 0.0, deaf, dialect_named(profile)
        self.heard, self._decoder = list[Frame](), Decoder()
        flight = PlantConfig(trajectory="commanded", start="ground", seed=seed, vehicle=vehicle_named(frame))
        self.plant, self._filters = Plant(flight), ImuFilters(dialect, flight.seed)
        self._near, far = memory_pair(clock=clock.monotonic_ns)
        self._link = Link(far, dialect, None, self.plant.rotors, fresh=True)
        self.autopilot = Emulated([self._link.schedule], dialect, flight)
        self.pilot = Pilot(profile, lambda data: self._take(Decoder().feed(data, 0)))

    def send(self, data: bytes) -> None:
        self.heard += self._decoder.take(as_columns([(data, 0)]))
        self._near.send(data)

    def receive(self, timeout_s: float) -> Datagrams:
        """Let the vehicle fly on; what it sent."""
        steps = max(1, round(timeout_s * NS_PER_S / STEP_NS))
        filtered = self._filters.step(self.plant.advance(steps))
        self.clock.ns += steps * STEP_NS
        self._take([] if self._deaf else self._link.receive())
        self._link.queue(filtered, self.autopilot.dialect)
        self._link.send_due(self.plant.t_ns)
        actions, orders = self.autopilot.watch(filtered.samples)
        for action in actions:
            self._link.act(action)
        for order in orders:
            order(self.plant)
        self.flown_s += timeout_s * bool(filtered.samples.position[-1, 2] < AIRBORNE_M)
        self.pilot.fly(self.plant.t_ns / NS_PER_S)
        return self._near.receive(0.0)

    def _take(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            for action in self.autopilot.step(0, frame, self.plant.t_ns):
                self._link.act(action)


@contextmanager
def coached(vehicle: "PilotedVehicle | Played", hear: Heard | None = None) -> Iterator[list[str]]:
    """What `setup` says to the vehicle's pilot, on the vehicle's clock. hear: is told, too."""
    lines = list[str]()

    def told(*texts: str, **options: Any) -> None:
        lines.append(text := "\n".join(texts))
        say(*texts, **options)
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

    (folder / CONFIG).write_text(mine := config_text(LINK, 1, folder.resolve(), None) + "# own\n" * (profile == "px4"))
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
    assert (settings.connect, settings.vehicle, (folder / CONFIG).read_text()) == (LINK, 1, mine)
    assert settings.baseline is not None
    assert Baseline.load(settings.baseline).digest == baseline.digest


def test_the_service_finds_what_was_moved_whatever_the_folder_is_called(tmp_path: Path) -> None:
    (folder := tmp_path / 'a|b [1] "').mkdir()
    (folder / CONFIG).write_text(config_text(LINK, 1, folder, None))
    command = service_script(folder, Path("unit"), Path("bin")).split(" | install")[0].split("\n")[-1]
    assert f'"{HOME / BASELINE}"' in subprocess.check_output(["sh", "-c", command], text=True)


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
        self.sent, self._records = Decoder(), deque(recorded(path, PLAYED_S))
        self.asked = list[Frame]()
        self._late_ns = clock.ns - self._records[0][1]
        self._stop_ns = self._records[-1][1] + self._late_ns + 60 * NS_PER_S
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
        while self._records and self._records[0][1] + self._late_ns <= self.clock.ns:
            found.append((self._records.popleft()[0], self.clock.ns))
        self.heard.update(parameter(one) for data, ns in found for one in self._decoder.feed(data, ns))
        return as_columns(found)


def parameter(frame: Frame) -> str:
    return frame.text("param_id") if frame.msgid in (MessageId.PARAM_VALUE, MessageId.PARAM_REQUEST_READ) else ""


def test_a_recorded_link_tells_what_it_is_and_that_it_ends(tmp_path: Path) -> None:
    link = Played(shared("data/autopilots_in_the_loop/px4_hil_healthy.tlog"), Clock())
    with pytest.raises(KeyboardInterrupt), coached(link) as lines:
        setup(LINK, tmp_path, yes=True)
    shown = "\n".join(lines)
    finds = ("its autopilot is px4", "gravity: 1.00 g, right", "rotor layout x (the vehicle's parameters")
    for words in ("vehicle 1: a quadrotor", *finds):
        assert words in shown, words
    assert [line.split(":")[0] for line in lines].count("nothing has come for 5 s") == 1
    ended = next(n for n, line in enumerate(lines) if line.startswith("nothing has come"))
    assert lines[ended + 1].startswith("cut off; covered so far: hover ")
    assert lines[ended + 2 :] == lines[ended + 2 : ended + 3]  # take off, and then nothing more
    usual = {MessageId.HEARTBEAT, MessageId.STATUSTEXT, MessageId.COMMAND_LONG, MessageId.PARAM_REQUEST_READ}
    assert {one.msgid for one in link.asked} <= usual
    assert len(list(tmp_path.glob("flight-*.tlog"))) == 1
