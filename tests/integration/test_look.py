"""A first look at flights without a baseline: what it finds is there, and it never calls a vehicle healthy."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from flying_telemetry import flying
from made_baselines import logged
from made_csv import MAP, recording
from shared_data import shared
from typer.testing import CliRunner

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.cli import app
from mavdiag.logs import read_log
from mavdiag.look.first_look import first_look
from mavdiag.look.words import in_full, in_one_line
from mavdiag.telemetry import Log, Series, Signal, Telemetry
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

RUN = CliRunner()


def emulated(seed: int, seconds: float = 15.0, profile: str = "qdrone2", **config: object) -> Log:
    plant = PlantConfig(seed=seed, **config)  # type: ignore[arg-type]  # of several types
    return Log("flight", "", profile, flight_telemetry(plant, seconds, LinkSpec(profile))[0])


def test_the_rotor_line_stands_at_the_speed_that_the_rotors_tell() -> None:
    look = first_look(emulated(5, fault="F1/SV3", rotor=2, onset_s=0.0, trajectory="hover"), airframe_named("qdrone2"))
    assert look.line is not None
    assert look.line.reason == ""
    assert look.line.told_hz == pytest.approx(167.0, rel=0.05)
    assert look.line.hz == pytest.approx(look.line.told_hz, rel=0.03)


def test_a_low_passed_stream_shows_no_line_and_says_why() -> None:
    look = first_look(emulated(5, profile="ardupilot"), airframe_named("qdrone2"))
    assert look.line is not None
    assert math.isnan(look.line.hz)
    assert "low-passed at 20 Hz" in look.line.reason


def test_the_load_of_each_motor_is_its_mean_over_the_mean_of_all() -> None:
    log = logged(flying(3000, seed=3))
    look = first_look(log, Airframe())
    outputs = log[Signal.ACTUATOR].values
    expected = outputs.mean(axis=0) / outputs.mean() - 1
    np.testing.assert_allclose([one.over_mean for one in look.loads], expected, atol=2e-3)
    assert sum(one.over_mean for one in look.loads) == pytest.approx(0.0, abs=1e-9)


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
    look = first_look(changed(changed(log, Signal.ACTUATOR, outputs), Signal.VIBRATION, level), Airframe())
    span_s, left_out_s = 30.0, 30.0 - look.flight_s  # the start is not judged
    assert look.loads[1].full_share == pytest.approx(span_s / 2 / look.flight_s, abs=0.01)
    assert look.vibration is not None
    assert look.vibration.above_high == pytest.approx((span_s / 4 - left_out_s) / look.flight_s, abs=0.02)
    text = "\n".join(in_full(look))
    assert "where ArduPilot expects trouble" in text
    assert "2 at its upper end" in text


def test_it_never_says_that_a_vehicle_is_well() -> None:
    for look in (first_look(logged(flying(3000, seed=3)), Airframe()), first_look(emulated(1), Airframe())):
        text = "\n".join([*in_full(look), in_one_line(look)])
        assert "healthy" not in text
        assert "fault" not in text
        assert "this is no verdict" in text


def test_what_is_missing_is_named_with_the_parameter_that_gives_it() -> None:
    full = emulated(1, profile="ardupilot")
    poor = Log(
        "flight", "", "ardupilot", Telemetry(tuple(o for o in full.telemetry if o.signal is not Signal.VIBRATION))
    )
    missing = {one.monitor: one.missing for one in first_look(poor, airframe_named("qdrone2")).monitors}
    assert missing["vibration_level"] == ("no VIBRATION: SRn_EXTRA3",)


def test_log171_is_looked_at_as_its_records_show() -> None:
    look = first_look(read_log(shared("data/ardupilot_real/log171.bin")), Airframe())
    assert look.flight_s == pytest.approx(165.8, abs=1.0)
    assert [round(100 * one.over_mean) for one in look.loads] == [4, 11, -9, -6]


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
        app, ["scan", str(sound), str(damaged), *columns, "--baseline", baseline, "--json", "--no-cache"]
    )
    first, second = (json.loads(line) for line in judged.stdout.splitlines())
    assert (first["verdict"], second["verdict"]) == ("healthy", "fault"), judged.output
    assert min(one["t_s"] for one in second["events"]) > 3.5
