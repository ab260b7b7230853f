"""`mavdiag model` and its neighbours as a user meets them, on flights of the emulator."""

import json
from pathlib import Path
from typing import Any

import pytest
from droneprop_table import table_of
from made_logs import flight, written
from processes import record

from mavdiag import cli
from mavdiag.baseline import Baseline

FLIGHT_S = 25.0
RISE = 0.3  # of the command of the front right rotor
OWN = tuple(f"F0_SV0_SP1_t2_D1_R{number}.mat" for number in (1, 2, 3))


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("flights")
    record(folder / "f.tlog", "--flights", "3", "--duration", "20", "--seed", "70")
    return sorted(folder.glob("*.tlog"))


def test_the_model_of_a_log_has_figures_with_standard_errors(mavdiag: Any, flights: list[Path], tmp_path: Path) -> None:
    picture = tmp_path / "m.svg"
    code, out, _ = mavdiag("model", flights[0], "--axis", "both", "--plot", picture)
    assert code == 0
    assert out.count("standard errors from the covariance of the parameters") == 2
    assert "bandwidth" in out
    assert sorted(one.name for one in tmp_path.iterdir()) == ["m-pitch.svg", "m-roll.svg"]
    _, out, _ = mavdiag("model", "show", flights[0], "--axis", "roll", "--json")
    found = json.loads(out)
    assert found["dc_gain"]["value"] == pytest.approx(0.93, abs=0.05)
    assert 0 < found["dc_gain"]["standard_error"] < 0.05
    assert found["poles"][0]["damping"]["value"] > 0


def test_models_of_a_baseline_are_those_of_its_fsd_monitors(mavdiag: Any, flights: list[Path], tmp_path: Path) -> None:
    baseline = tmp_path / "b.json"
    asked = ("--airframe", "qdrone2", "--name", "drone 1", "--monitors", "thesis", "--details")
    code, out, _ = mavdiag("identify", *flights, "-o", baseline, *asked)
    assert code == 0
    assert "drone 1 (airframe)\nrotor layout qdrone2 (told)\n" in out
    assert out.endswith(f"written to {baseline}\n")
    code, out, _ = mavdiag("model", baseline, "--json", "--plot", tmp_path / "b.svg")
    assert code == 0
    assert [json.loads(line)["axis"] for line in out.splitlines()] == ["roll", "pitch"]  # B26: both by default
    code, out, _ = mavdiag("scan", flights[0], "--baseline", baseline, "--json")
    assert json.loads(out)["log"] == str(flights[0])  # R1
    assert json.loads(out)["monitors"]["fsd"]["judged_s"] > 5.0
    assert code in (0, 1, 4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """D1 shakes most, and one of two damaged propellers lost lift."""
    base = tmp_path_factory.mktemp("droneprop")
    made = {name: flight(FLIGHT_S, 40 + i) for i, name in enumerate(OWN)}
    made |= {"F0_SV0_SP1_t2_D2.mat": flight(FLIGHT_S, 51, line=0.6)}
    made |= {"F0_SV0_SP1_t2_D3.mat": flight(FLIGHT_S, 52, line=0.5)}
    made |= {"F1_SV1_SP1_t2.mat": flight(FLIGHT_S, 53)}
    made |= {"F3_SV3_SP1_t2.mat": flight(FLIGHT_S, 54, weak_rotor=2, rise=RISE)}
    for name, rows in made.items():
        written(base / name, rows)
    return base


def run(*arguments: object) -> int:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["mavdiag", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
    return int(caught.value.code or 0)


@pytest.fixture(scope="module")
def baseline(folder: Path) -> Path:
    path = folder / "d1.json"
    # The made flights shake more than balanced rotors do, which only their maker knows to be healthy.
    assert run("identify", *(folder / name for name in OWN), "-o", path) == 2
    assert run("identify", *(folder / name for name in OWN), "-o", path, "--accept") == 0
    return path


def test_the_table_has_a_line_for_each_recording(folder: Path, baseline: Path) -> None:
    found, _, _ = table_of(folder, Baseline.load(baseline))
    assert {one.name.label for one in found} >= {"healthy D1, R1", "healthy D2", "healthy D3", "F3/SV3"}


def test_the_baseline_knows_the_vehicle_without_being_told(baseline: Path) -> None:
    learnt = Baseline.load(baseline)
    layout = learnt.airframe.layout
    assert (learnt.airframe.name, layout and layout.name) == ("QDrone 2 as recorded", "qdrone2")
    assert (learnt.airframe.classifier, learnt.link.profile) == (None, "dronepropa")
    assert learnt.provenance.logs[0].sha256
    assert "rotor_trim" in {entry.spec.kind for entry in learnt.monitors}


def test_scan_finds_the_weak_rotor_alone(folder: Path, baseline: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = run("scan", *sorted(folder.glob("F*_SP1_t2*.mat")), "--baseline", baseline, "--jobs", 1)
    told = dict(line.split(": ", 1) for line in capsys.readouterr().out.splitlines())
    flagged = {Path(name).name for name, text in told.items() if text.startswith("fault")}
    assert (code, len(told), flagged) == (1, 7, {"F3_SV3_SP1_t2.mat"})
    assert "rotor 2" in next(text for text in told.values() if text.startswith("fault"))
