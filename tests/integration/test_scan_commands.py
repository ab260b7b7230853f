"""`mavdiag identify`, `scan`, `baseline` and `model` as a user meets them, on recordings of the emulator."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from dask_cluster import cluster
from droneprop_table import table_of
from made_archive import archive_baseline, made
from made_logs import flight, written
from processes import PATIENCE_S, record

from mavdiag.baseline import Baseline
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
NAMES = ("a.tlog", "b/1.tlog", "b/2.tlog", "c.tlog")
COUNT = 18


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def healthy(folder: Path) -> list[Path]:
    record(folder / "h.tlog", "--flights", "4", "--duration", "25", "--seed", "70")
    return sorted(folder.glob("h*.tlog"))


@pytest.fixture(scope="module")
def crack(folder: Path) -> Path:
    fault = ("--fault", "F2/SV2", "--rotor", "3", "--onset", "12", "--duration", "22", "--seed", "7")
    record(folder / "crack.tlog", *fault)
    return folder / "crack.tlog"


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
    code, out, _ = mavdiag("scan", healthy[0], crack, "--baseline", baseline, "--jobs", 1)
    assert (code, [line.split(": ")[1].split(",")[0] for line in out.splitlines()]) == (1, ["healthy", "fault"])
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
    mavdiag: Any, baseline: Path, healthy: list[Path], crack: Path, tmp_path: Path
) -> None:
    record(tmp_path / "short.tlog", "--duration", "3", "--seed", "8")
    code, out, _ = mavdiag("scan", healthy[0], tmp_path / "short.tlog", "--baseline", baseline, "--jobs", 1)
    assert code == 3
    assert "not_judgeable" in out
    assert "of take-off or start" in out
    absent = tmp_path / "absent.tlog"
    code, out, err = mavdiag("scan", absent, crack, "--baseline", baseline, "--json", "--jobs", 1)
    assert code == 2
    assert [json.loads(line)["verdict"] for line in out.splitlines()] == ["error", "fault"]
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
    code, out, _ = mavdiag("baseline", "check", baseline)
    assert (code, out.startswith(f"{baseline}: sound, sha256:")) == (0, True)
    (spoilt := tmp_path / "spoilt.json").write_text(baseline.read_text().replace("drone 1", "drone 2"))
    code, out, err = mavdiag("baseline", "check", spoilt)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{spoilt}: digest: " in err


@pytest.fixture(scope="module")
def baseline_archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("baseline_archive") / "baseline.json"
    archive_baseline().save(path)
    return path


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """Four logs of which one has a fault, a copy of one, and a file that is no log."""
    folder = tmp_path / "archive"
    made(folder, *NAMES, shaken=("b/2.tlog",))
    shutil.copy(folder / "a.tlog", folder / "b" / "9.tlog")
    (folder / "notes.txt").write_text("of the flights")
    return folder


@pytest.fixture
def scan(mavdiag: Any, baseline_archive: Path) -> Any:
    def run(*arguments: object) -> tuple[int, str, str]:
        ran: tuple[int, str, str] = mavdiag("scan", *arguments, "--baseline", baseline_archive)
        return ran

    return run


def test_a_pool_answers_as_one_process_does_in_order_and_keeps_it(
    scan: Any, archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = archive / ("x" * 300)  # its name is too long
    (tmp_path / "pickle.py").write_text("raise SystemExit('of the present folder')")
    monkeypatch.chdir(tmp_path)
    alone = scan(archive, lost, "--json", "--jobs", 1, "--no-cache")
    code, out, err = pool = scan(archive, lost, "--json", "--jobs", 2, "--cache", tmp_path / "cache")
    again = scan(archive, lost, "--json", "--cache", tmp_path / "cache", "--jobs", 2)
    assert alone == pool == again
    assert (code, err) == (2, "skipped 1 file without a flight log\n")
    lines = [json.loads(line) for line in out.splitlines()]
    wanted = ("a.tlog", "b/1.tlog", "b/2.tlog", "b/9.tlog", "c.tlog", lost.name)
    assert [one["log"] for one in lines] == [str(archive / name) for name in wanted]
    assert [one["verdict"] for one in lines] == ["healthy", "healthy", "fault", "healthy", "healthy", "error"]
    assert ({**lines[0], "log": ""}, len(list(tmp_path.glob("cache/scan/*/*.json")))) == ({**lines[3], "log": ""}, 4)
    code, out, err = scan(archive, "--cache", tmp_path / "cache", "--jobs", 1)
    assert (code, len(out.splitlines())) == (1, 5)
    assert "4 of 5 answers were known already; --no-cache judges anew\n1 of 5 logs: a copy of another log" in err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_scan_that_is_stopped_leaves_no_process_and_goes_on(
    scan: Any, archive: Path, baseline_archive: Path, tmp_path: Path, number: int
) -> None:
    """Copies of one log that differ in their first time stamp, so many that it does not end by itself."""
    first, many = (archive / "a.tlog").read_bytes(), tmp_path / "many"
    many.mkdir()
    for k in range(400):
        (many / f"{k:03d}.tlog").write_bytes((int.from_bytes(first[:8], "big") - k).to_bytes(8, "big") + first[8:])
    options = ("--baseline", baseline_archive, "--cache", tmp_path / "cache", "--jobs", 2, "--json")
    told, pipe = [sys.executable, "-m", "mavdiag", "scan", *map(str, (many, *options))], subprocess.PIPE
    child = subprocess.Popen(
        told,
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background would ignore it
    )
    assert child.stdout is not None
    child.stdout.readline()
    workers = children(child.pid)
    assert len(workers) >= 2
    child.send_signal(number)
    _, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    if number == signal.SIGINT:
        assert err == "mavdiag: stopped\n"
    until = time.monotonic() + PATIENCE_S
    while any(alive(pid) for pid in workers):
        assert time.monotonic() < until, "a worker outlived its scan"
        time.sleep(0.05)
    kept = len(list(tmp_path.glob("cache/scan/*/*.json")))
    assert 1 <= kept < 400
    for path in sorted(many.iterdir())[kept + 2 :]:
        path.unlink()
    code, out, err = scan(many, "--cache", tmp_path / "cache", "--jobs", 1)
    assert (code, len(out.splitlines())) == (0, kept + 2)
    assert f"of {kept + 2} answers were known already" in err


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and (entry / "stat").exists():
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            found += [int(entry.name)] if int(fields[1]) == pid else []
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_killed_worker_loses_nothing_and_gives_nothing_twice(
    mavdiag: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = [f"{number:03d}.tlog" for number in range(COUNT)]
    made(tmp_path / "logs", *names, first_seed=300, shaken=names[::7])
    archive_baseline().save(tmp_path / "baseline.json")
    command = ("scan", "logs", "--baseline", "baseline.json", "--json", "--no-cache")

    with cluster(2) as (address, processes):
        _, doomed, _ = processes
        told = [sys.executable, "-m", "mavdiag", *command, "--scheduler", address]
        with subprocess.Popen(told, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            assert child.stderr is not None
            lines = [child.stdout.readline().rstrip("\n") for _ in range(5)]
            doomed.send_signal(signal.SIGKILL)
            lines += child.stdout.read().splitlines()
            assert child.wait(PATIENCE_S) == 1, child.stderr.read()
        assert doomed.wait(PATIENCE_S) == -signal.SIGKILL
    code, out, err = mavdiag(*command, "--jobs", 1)
    assert (code, err, out.splitlines()) == (1, "", lines)
    assert [json.loads(line)["log"] for line in lines] == [f"logs/{name}" for name in names]
    assert sum(json.loads(line)["verdict"] == "fault" for line in lines) == len(names[::7])


FLIGHT_S = 25.0
RISE = 0.3  # of the command of the front right rotor
OWN = tuple(f"F0_SV0_SP1_t2_D1_R{number}.mat" for number in (1, 2, 3))


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    recordings = tmp_path_factory.mktemp("flights")
    record(recordings / "f.tlog", "--flights", "3", "--duration", "20", "--seed", "70")
    return sorted(recordings.glob("*.tlog"))


def test_the_model_of_a_log_has_figures_with_standard_errors(mavdiag: Any, flights: list[Path], tmp_path: Path) -> None:
    code, out, err = mavdiag("model", flights[0], "--axis", "both", "--plot", tmp_path / "m.svg")
    assert (code, out.count("standard errors from the covariance of the parameters"), err.count("m-")) == (0, 2, 2)
    assert "bandwidth" in out
    assert sorted(one.name for one in tmp_path.iterdir()) == ["m-pitch.svg", "m-roll.svg"]
    _, out, _ = mavdiag("model", "show", flights[0], "--axis", "roll", "--json")
    found = json.loads(out)
    assert found["dc_gain"]["value"] == pytest.approx(0.93, abs=0.05)
    assert 0 < found["dc_gain"]["standard_error"] < 0.05
    assert found["poles"][0]["damping"]["value"] > 0


def test_models_of_a_baseline_are_those_of_its_fsd_monitors(mavdiag: Any, flights: list[Path], tmp_path: Path) -> None:
    baseline = tmp_path / "$x^$.json"  # no formula
    asked = ("--layout", "qdrone2", "--monitors", "thesis", "--details")
    code, out, _ = mavdiag("identify", *flights, "-o", baseline, *asked)
    assert code == 0
    assert "$x^$ (airframe)\nrotor layout qdrone2 (told)\n" in out  # called as its file
    assert out.endswith(f"written to {baseline}\n")
    code, out, _ = mavdiag("model", baseline, "--json", "--plot", tmp_path / "b.svg")
    assert (code, *(json.loads(line)["axis"] for line in out.splitlines())) == (0, "roll", "pitch")  # B26: by default
    assert mavdiag("model", baseline, "--plot", tmp_path / "b")[0] == 2  # a picture of no kind
    code, out, _ = mavdiag("scan", flights[0], "--baseline", baseline, "--json")
    assert json.loads(out)["log"] == str(flights[0])  # R1
    assert json.loads(out)["monitors"]["fsd"]["judged_s"] > 5.0
    assert code in (0, 1, 4)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """D1 shakes most, and one of two damaged propellers lost lift."""
    base, made = tmp_path_factory.mktemp("droneprop"), {name: flight(FLIGHT_S, 40 + i) for i, name in enumerate(OWN)}
    made |= {"F0_SV0_SP1_t2_D2.mat": flight(FLIGHT_S, 51, line=0.6)}
    made |= {"F0_SV0_SP1_t2_D3.mat": flight(FLIGHT_S, 52, line=0.5)}
    made |= {"F1_SV1_SP1_t2.mat": flight(FLIGHT_S, 53)}
    made |= {"F3_SV3_SP1_t2.mat": flight(FLIGHT_S, 54, weak_rotor=2, rise=RISE)}
    for name, rows in made.items():
        written(base / name, rows)
    return base


def test_recordings_of_dronepropa_teach_a_baseline_by_which_the_weak_rotor_alone_is_found(
    mavdiag: Any, recordings: Path
) -> None:
    path, own = recordings / "d1.json", [recordings / name for name in OWN]
    # The made flights shake more than balanced rotors do, which only their maker knows to be healthy.
    assert (mavdiag("identify", *own, "-o", path)[0], mavdiag("identify", *own, "-o", path, "--accept")[0]) == (2, 0)
    learnt = Baseline.load(path)
    layout = learnt.airframe.layout
    assert (learnt.airframe.name, layout and layout.name) == ("QDrone 2 as recorded", "qdrone2")
    assert (learnt.airframe.classifier, learnt.link.profile) == (None, "dronepropa")
    assert learnt.provenance.logs[0].sha256
    assert "rotor_trim" in {entry.spec.kind for entry in learnt.monitors}
    code, out, _ = mavdiag("scan", *sorted(recordings.glob("F*_SP1_t2*.mat")), "--baseline", path, "--jobs", 1)
    told = dict(line.split(": ", 1) for line in out.splitlines())
    flagged = {Path(name).name for name, text in told.items() if text.startswith("fault")}
    assert (code, len(told), flagged) == (1, 7, {"F3_SV3_SP1_t2.mat"})
    assert "rotor 2" in next(text for text in told.values() if text.startswith("fault"))
    table, _, _ = table_of(recordings, learnt)
    assert {one.name.label for one in table} >= {"healthy D1, R1", "healthy D2", "healthy D3", "F3/SV3"}
