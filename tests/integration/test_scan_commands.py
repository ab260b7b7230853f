"""`mavdiag identify`, `scan` and `baseline` as a user meets them, on recordings of the emulator."""

import json
from pathlib import Path
from typing import Any

import pytest
from plant_process import record

from mavdiag.monitors import BY_NAME

EVENT_KEYS = {
    "t_s", "end_s", "monitor", "axis", "statistic", "threshold", "fsd_s", "fml_s", "rotor", "fault_type", "severity",
    "confidence", "fault_kind",
}  # fmt: skip
VERDICT_KEYS = {
    "log", "verdict", "kind", "since_s", "rotor", "rotors", "reason", "judged_s", "flown_s", "profile", "rate_hz",
    "monitors", "events", "notes",
}  # fmt: skip
MONITOR_KEYS = {"max", "threshold", "unit", "alarms", "judged_s", "not_judged", "outside_s", "axis"}


def recorded(folder: Path, name: str, *options: str) -> Path:
    path = folder / name
    record(path, *options)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def healthy(folder: Path) -> list[Path]:
    recorded(folder, "h.tlog", "--flights", "4", "--duration", "25", "--seed", "70")
    return sorted(folder.glob("h*.tlog"))


@pytest.fixture(scope="module")
def crack(folder: Path) -> Path:
    fault = ("--fault", "F2/SV2", "--rotor", "3", "--onset", "12", "--duration", "22", "--seed", "7")
    return recorded(folder, "crack.tlog", *fault)


@pytest.fixture(scope="module")
def short(folder: Path) -> Path:
    return recorded(folder, "short.tlog", "--duration", "3", "--seed", "8")


@pytest.fixture
def baseline(mavdiag: Any, folder: Path, healthy: list[Path]) -> Path:
    path = folder / "b.json"
    if not path.exists():
        named = ("--airframe", "qdrone2", "--name", "drone 1")
        code, out, err = mavdiag("identify", *healthy[1:], "-o", path, *named)
        assert code == 0
        assert err in ("", "learning from 3 flights ...\n")  # on a slow machine it says what takes so long
        assert out.startswith(f"written to {path}, from 3 flights of 1.0 min in all\n"), out
        assert [line.split()[0] for line in out.splitlines()[-3:]] == ["grade", "notices", "better"]
    return path


def test_a_healthy_flight_is_0_and_a_crack_is_1(mavdiag: Any, baseline: Path, healthy: list[Path], crack: Path) -> None:
    code, out, err = mavdiag("scan", healthy[0], "--baseline", baseline)
    assert (code, err) == (0, ""), out
    assert out.startswith(f"{healthy[0]}: healthy, no alarm; judged ")
    code, out, _ = mavdiag("scan", healthy[0], crack, "--baseline", baseline)
    assert code == 1
    assert [line.split(": ")[1].split(",")[0] for line in out.splitlines()] == ["healthy", "fault"]
    assert "rotor 3" in out.splitlines()[1]


def test_the_json_line_has_the_fields_of_the_contract(mavdiag: Any, baseline: Path, crack: Path) -> None:
    code, out, _ = mavdiag("scan", crack, "--baseline", baseline, "--json")
    assert code == 1
    found = json.loads(out)
    assert {*found} == VERDICT_KEYS
    assert (found["log"], found["verdict"], found["profile"]) == (str(crack), "fault", "qdrone2")  # R1
    assert found["rate_hz"] == pytest.approx(1000, rel=0.01)
    assert 10 < found["judged_s"] < 17.5
    assert {*found["monitors"]} == set(BY_NAME) - {"vibration_level"}
    assert all({*one} == MONITOR_KEYS for one in found["monitors"].values())
    assert found["events"]
    for event in found["events"]:
        assert {*event} == EVENT_KEYS
        assert event["rotor"] in (3, None)
        assert (event["fsd_s"] is None) == (event["monitor"] != "fsd")
        assert event["t_s"] > 12


def test_what_cannot_be_judged_is_3_and_an_error_2(
    mavdiag: Any, baseline: Path, healthy: list[Path], crack: Path, short: Path, tmp_path: Path
) -> None:
    code, out, _ = mavdiag("scan", healthy[0], short, "--baseline", baseline)
    assert code == 3
    assert "not_judgeable" in out
    assert "of take-off or start" in out
    absent = tmp_path / "absent.tlog"
    code, out, err = mavdiag("scan", absent, crack, "--baseline", baseline, "--json")
    assert code == 2
    lines = [json.loads(line) for line in out.splitlines()]
    assert [one["verdict"] for one in lines] == ["error", "fault"]
    assert "Traceback" not in err
    code, out, err = mavdiag("scan", crack, "--baseline", absent)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "mavdiag identify" in err


def test_show_and_check(mavdiag: Any, baseline: Path, tmp_path: Path) -> None:
    code, out, _ = mavdiag("baseline", "show", baseline)
    assert code == 0
    assert "rotor_trim      threshold" in out
    assert "in a session of these flights; another may differ" in out
    assert "\nenvelope        yaw rate up to " in out
    code, out, _ = mavdiag("baseline", "show", baseline, "--json")
    assert json.loads(out) == json.loads(baseline.read_text())
    code, out, _ = mavdiag("baseline", "check", baseline)
    assert (code, out.startswith(f"{baseline}: sound, sha256:")) == (0, True)
    spoilt = tmp_path / "spoilt.json"
    spoilt.write_text(baseline.read_text().replace("drone 1", "drone 2"))
    code, out, err = mavdiag("baseline", "check", spoilt)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{spoilt}: digest: " in err
