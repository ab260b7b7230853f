"""A first look at flights without a baseline: what it finds is there, and it never calls a vehicle healthy."""

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import logged
from shared_data import shared
from typer.testing import CliRunner
from virtual_endpoint import Clock, VirtualEndpoint, linked

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.cli import app
from mavdiag.commands.inspect import inspect
from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.datagrams import Datagrams, as_columns
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId, ModeFlag
from mavdiag.logs import read_log
from mavdiag.look.inspection import inspection_of
from mavdiag.look.words import in_full, in_one_line
from mavdiag.telemetry import Log, Series, Signal, Telemetry
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

RUN = CliRunner()


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
    look = inspection_of(
        emulated(5, fault="F1/SV3", rotor=2, onset_s=0.0, trajectory="hover"), airframe_named("qdrone2")
    )
    assert look.line is not None
    assert look.line.reason == ""
    assert look.line.told_hz == pytest.approx(167.0, rel=0.05)
    assert look.line.hz == pytest.approx(look.line.told_hz, rel=0.03)


def changed(log: Log, signal: Signal, values: np.ndarray) -> Log:
    series = tuple(
        Series(one.signal, one.t_ns, one.host_ns, values) if one.signal is signal else one for one in log.telemetry
    )
    return Log(log.name, log.sha256, log.profile, Telemetry(series))


def test_an_output_at_its_end_and_a_high_vibration_are_told_in_their_share() -> None:
    log = logged(flying(3000, seed=3))
    outputs = log[Signal.ACTUATOR].values.copy()
    outputs[len(outputs) // 2 :, 1] = 1.0
    level = log[Signal.VIBRATION].values * 0 + np.array([5.0, 6.0, 7.0])
    level[: len(level) // 4] = 65.0
    look = inspection_of(changed(changed(log, Signal.ACTUATOR, outputs), Signal.VIBRATION, level), Airframe())
    span_s, left_out_s = 30.0, 30.0 - look.flight_s  # the start is not judged
    assert look.loads[1].full_share == pytest.approx(span_s / 2 / look.flight_s, abs=0.01)
    assert look.vibration is not None
    assert look.vibration.above_high == pytest.approx((span_s / 4 - left_out_s) / look.flight_s, abs=0.02)
    text = in_full(look)
    assert "where ArduPilot expects trouble" in text
    assert "2 at its upper end" in text


def test_it_never_says_that_a_vehicle_is_well() -> None:
    for look in (inspection_of(logged(flying(3000, seed=3)), Airframe()), inspection_of(emulated(1), Airframe())):
        text = f"{in_full(look)}\n{in_one_line(look)}"
        assert "healthy" not in text
        assert "fault" not in text
        assert "this is no verdict" in text


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
    assert content["profile"] == "csv"
    assert content["loads"] == []


@pytest.fixture(scope="module")
def csv_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("csv")
    (folder / "map.toml").write_text(MAP)
    (folder / "learn").mkdir()
    for seed in range(4):
        recording(folder / "learn" / f"{seed}.csv", 20 + seed)
    return folder


def test_gyro_and_accelerometer_alone_are_enough_to_find_an_unbalance(csv_folder: Path) -> None:
    columns = ["--columns", str(csv_folder / "map.toml")]
    baseline = str(csv_folder / "baseline.json")
    learnt = RUN.invoke(app, ["identify", str(csv_folder / "learn"), *columns, "-o", baseline, "--airframe", "qdrone2"])
    assert learnt.exit_code == 0, learnt.output
    names = {entry.spec.kind for entry in Baseline.load(Path(baseline)).monitors}
    assert {"unbalance", "sensor_noise"} <= names
    assert not names & {"fsd", "innovation", "rotor_trim"}
    sound = recording(csv_folder / "sound.csv", 41)
    damaged = recording(csv_folder / "damaged.csv", 42, fault="F1/SV3", rotor=3, onset_s=4.0)
    judged = RUN.invoke(
        app, ["scan", str(sound), str(damaged), *columns, "--baseline", baseline, "--json", "--no-cache", "--jobs", "1"]
    )
    first, second = (json.loads(line) for line in judged.stdout.splitlines())
    assert (first["verdict"], second["verdict"]) == ("healthy", "fault"), judged.output
    assert min(one["t_s"] for one in second["events"]) > 3.5


def two_flights(pause_s: float, rate_hz: int = 25) -> Log:
    """Two flights of 30 s in one log, with every sample at a low rate."""
    every = 100 // rate_hz
    parts = []
    for number, seed in enumerate((3, 4)):
        shift_ns = number * round((30.0 + pause_s) * 1e9)
        parts.append(
            {one.signal: (one.t_ns[::every] + shift_ns, one.values[::every]) for one in flying(3000, seed=seed)}
        )
    series = tuple(
        Series(signal, t_ns, t_ns, np.concatenate([part[signal][1] for part in parts]))
        for signal in parts[0]
        for t_ns in [np.concatenate([part[signal][0] for part in parts])]
    )
    return Log("two", "", "px4", Telemetry(series))


def test_two_flights_in_a_log_do_not_lower_its_rate() -> None:
    """A pause as long as both flights once made 11.7 Hz of 25 Hz, and monitors were denied."""
    alone = inspection_of(logged(flying(3000, seed=3)), Airframe())
    for pause_s in (5.0, 60.0, 600.0):
        look = inspection_of(two_flights(pause_s), Airframe())
        rates = {one.signal: one.rate_hz for one in look.signals}
        assert rates["body_rate"] == pytest.approx(25.0, rel=0.01)
        assert look.monitors == inspection_of(two_flights(5.0), Airframe()).monitors
    assert {one.signal: one.rate_hz for one in alone.signals}["body_rate"] == pytest.approx(100.0, rel=0.01)


def test_log171_is_seen_to_tumble_with_a_motor_at_its_limit() -> None:
    path = shared("data/ardupilot_real/log171.bin")
    look = inspection_of(read_log(path), Airframe())
    assert look.upset.startswith("the flight ends in an upset, at 238.8 s: it turns at 22.")
    text = in_full(look)
    assert "upset: the flight ends in an upset, at 238.8 s" in text
    assert "2 at its upper end for" in text
    assert "upset" in in_one_line(look)
    assert look.rotors.startswith("rotor layout x (the vehicle's parameter FRAME 1 of a quad)")
    earlier = RUN.invoke(app, ["look", str(path), "--to", "230"]).stdout
    assert "upset" not in earlier
    assert "no output reached an end" in earlier


class FreshArduPilot(VirtualEndpoint):
    """Sends heartbeats until it is asked for more, and knows some parameters: ArduPilot after a start.

    heard: every frame that came.
    """

    # The corner is clearly below a fifth of 100 Hz.
    PARAMETERS: ClassVar = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "INS_GYRO_FILTER": 18.0}

    def __init__(self) -> None:
        super().__init__(Clock())
        self.heard, self._waiting, self._decoder = list[Frame](), list[bytes](), Decoder()
        self._encoder, self._rates, self._k = Encoder(1, Component.AUTOPILOT1), dict[int, float](), 0

    def send(self, data: bytes) -> None:
        self._waiting += [answer for frame in self._decoder.feed_datagram(data, 0) for answer in self.answers(frame)]

    def answers(self, frame: Frame) -> list[bytes]:
        self.heard.append(frame)
        encode = self._encoder.encode
        if frame.msgid == MessageId.COMMAND_LONG:
            names = ("command", "param1", "param2")
            command, msgid, interval = (frame.fields[field_index(frame.msgid, name)] for name in names)
            known = msgid in (MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET, MessageId.ATTITUDE)
            self._rates |= {int(msgid): 1e6 / float(interval)} if known else {}
            result = MavResult.ACCEPTED if known else MavResult.DENIED
            return [encode(MessageId.COMMAND_ACK, command, result, 0, 0, frame.sysid, frame.compid)]
        if frame.msgid == MessageId.PARAM_REQUEST_READ:
            raw = frame.fields[field_index(frame.msgid, "param_id")]
            name = raw.partition(b"\0")[0].decode() if isinstance(raw, bytes) else ""
            found = self.PARAMETERS.get(name)
            return [] if found is None else [encode(MessageId.PARAM_VALUE, name, found, 9, 3, 0)]
        return []

    def messages(self, k: int) -> list[bytes]:
        """What it sends in the hundredth of a second number k."""
        encode, t_ms = self._encoder.encode, 5000 + 10 * k
        beat = (MavType.QUADROTOR, Autopilot.ARDUPILOTMEGA, ModeFlag.SAFETY_ARMED, 0, 4, 3)
        frames = [encode(MessageId.HEARTBEAT, *beat)] if k % 100 == 0 else []
        for msgid, rate_hz in self._rates.items():
            if k % max(1, round(100 / rate_hz)):
                continue
            if msgid == MessageId.RAW_IMU:
                frames.append(encode(msgid, 1000 * t_ms, 0, 0, -1000, 1, 2, 3))
            elif msgid == MessageId.ATTITUDE_TARGET:
                frames.append(encode(msgid, t_ms, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5))
            else:
                frames.append(encode(msgid, t_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        return frames

    def receive(self, timeout_s: float) -> Datagrams:
        """Let time pass; what it sent."""
        first, self._k = self._k, self._k + max(1, round(100 * timeout_s))
        self.clock.ns += (self._k - first) * 10_000_000
        sent = [*self._waiting, *(message for k in range(first, self._k) for message in self.messages(k))]
        self._waiting = []
        return as_columns([(data, self.clock.ns) for data in sent])


def test_l10_a_fresh_ardupilot_is_told_what_gives_each_monitor_its_streams(capsys: pytest.CaptureFixture[str]) -> None:
    vehicle = FreshArduPilot()
    with linked(vehicle):
        inspect(["udpin:127.0.0.1:14550"], duration=3.0)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "profile ardupilot" in shown
    for words in ("no RAW_IMU: SRn_RAW_SENS", "no VIBRATION: SRn_EXTRA3", "no ATTITUDE: SRn_EXTRA1", "--ask"):
        assert words in shown, words
    assert "works" not in shown
    assert vehicle.heard == []  # it listens only


def test_a_fresh_ardupilot_is_asked_for_streams_and_rotors_and_nothing_set(capsys: pytest.CaptureFixture[str]) -> None:
    vehicle = FreshArduPilot()
    with linked(vehicle):
        inspect(["udpin:127.0.0.1:14550"], duration=3.0, ask=True, as_json=True)
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    works = {one["monitor"] for one in found["monitors"] if one["works"]}
    assert {"fsd", "innovation", "rotor_signature", "sensor_drift", "control_loss", "thrust_loss"} == works
    missing = {one["monitor"]: " ".join(one["missing"]) for one in found["monitors"]}
    assert "no SERVO_OUTPUT_RAW: SRn_RC_CHAN" in missing["rotor_trim"]
    assert "low-passed at 18 Hz" in missing["unbalance"]
    assert "FRAME_CLASS 1, FRAME_TYPE 1" in found["rotors"]
    assert found["units"]["gravity_g"] == pytest.approx(1.0, abs=0.03)
    assert any("ACCEPTED, DENIED" in one or "DENIED, ACCEPTED" in one for one in found["asked"])
    sent = {frame.msgid for frame in vehicle.heard}
    assert sent == {MessageId.HEARTBEAT, MessageId.COMMAND_LONG, MessageId.PARAM_REQUEST_READ}
    place = field_index(MessageId.COMMAND_LONG, "command")
    commands = {frame.fields[place] for frame in vehicle.heard if frame.msgid == MessageId.COMMAND_LONG}
    assert commands == {MavCmd.SET_MESSAGE_INTERVAL}
