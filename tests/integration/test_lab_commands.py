"""`mavdiag model` and its neighbours as a user meets them, on flights of the emulator."""

import json
from pathlib import Path
from typing import Any

import pytest
from plant_process import record


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


def test_the_models_of_a_baseline_are_those_of_its_fsd_monitors(
    mavdiag: Any, flights: list[Path], tmp_path: Path
) -> None:
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["model", "absent.tlog"], "absent.tlog: no such file"),
        (["model", "track", "LOG", "--every", "0"], "--every and --memory must be longer"),
        (["model", "LOG", "--plot", "/dev/null"], "not a regular file"),
        (["model", "LOG", "--order", "2;2"], "three whole numbers"),
        (["identify", "LOG", "-o", "x.json", "--from", "nan"], "--from nan: give a time"),  # R3
        (["baseline", "show", "absent.json"], "no such file; make a baseline"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    mavdiag: Any, flights: list[Path], arguments: list[str], words: str
) -> None:
    code, out, err = mavdiag(*[str(flights[0]) if one == "LOG" else one for one in arguments])
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
