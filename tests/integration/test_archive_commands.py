"""`mavdiag scan` on an archive, with real worker processes: order, cache, stops, and what it prints where."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from made_archive import archive_baseline, made
from patience import PATIENCE_S

NAMES = ("a.tlog", "b/1.tlog", "b/2.tlog", "c.tlog")


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("baseline") / "baseline.json"
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
def scan(mavdiag: Any, baseline: Path) -> Any:
    def run(*arguments: object) -> tuple[int, str, str]:
        ran: tuple[int, str, str] = mavdiag("scan", *arguments, "--baseline", baseline)
        return ran

    return run


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "mavdiag", "scan", *map(str, arguments)]


def test_a_pool_answers_as_one_process_does_in_order_and_keeps_it(scan: Any, archive: Path, tmp_path: Path) -> None:
    alone = scan(archive, archive / "absent.tlog", "--json", "--jobs", 1, "--no-cache")
    pool = scan(archive, archive / "absent.tlog", "--json", "--jobs", 2, "--cache", tmp_path / "cache")
    again = scan(archive, archive / "absent.tlog", "--json", "--cache", tmp_path / "cache", "--jobs", 2)
    assert alone == pool == again
    code, out, err = pool
    assert (code, err) == (2, "1 file skipped that are no flight logs\n")
    lines = [json.loads(line) for line in out.splitlines()]
    wanted = ("a.tlog", "b/1.tlog", "b/2.tlog", "b/9.tlog", "c.tlog", "absent.tlog")
    assert [one["log"] for one in lines] == [str(archive / name) for name in wanted]
    assert [one["verdict"] for one in lines] == ["healthy", "healthy", "fault", "healthy", "healthy", "error"]
    assert {**lines[0], "log": ""} == {**lines[3], "log": ""}
    assert len(list(tmp_path.glob("cache/scan/*/*.json"))) == 4
    code, out, err = scan(archive, "--cache", tmp_path / "cache")
    assert (code, len(out.splitlines())) == (1, 5)
    assert "5 of 5 answers were known already; --no-cache judges anew" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--csv", "absent/a.csv"), "absent/a.csv: cannot be written"),
        (("--parquet", "."), ".: is a folder"),
        (("--from", "nan"), "--from nan: give a time in seconds"),
        (("--cache", "baseline.json"), "baseline.json: no folder to keep answers in"),
        (("--windows", "0.5"), "Invalid value for '--windows'"),
        (("--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler at tcp://127.0.0.1:1"),
    ],
)
def test_what_cannot_be_is_one_line_before_anything_is_judged(
    scan: Any, archive: Path, baseline: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, str], words: str
) -> None:
    monkeypatch.chdir(baseline.parent)
    monkeypatch.setattr("mavdiag.archive.pool.PATIENCE_S", 0.5)
    code, out, err = scan(archive / "a.tlog", *options)
    assert (code, out) == (2, "")
    assert words in err.splitlines()[-1]
    assert sum(line.startswith("mavdiag: ") for line in err.splitlines()) == 1


def heed_interrupts() -> None:
    """In a child: what was started in the background of a shell would ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_scan_that_is_stopped_leaves_no_process_and_goes_on(
    scan: Any, archive: Path, baseline: Path, tmp_path: Path, number: int
) -> None:
    """Copies of one log that differ in their first time stamp, so many that it does not end by itself."""
    first = (archive / "a.tlog").read_bytes()
    many = tmp_path / "many"
    many.mkdir()
    for k in range(400):
        (many / f"{k:03d}.tlog").write_bytes((int.from_bytes(first[:8], "big") - k).to_bytes(8, "big") + first[8:])
    told = command(many, "--baseline", baseline, "--cache", tmp_path / "cache", "--jobs", 2, "--json")
    pipe = subprocess.PIPE
    child = subprocess.Popen(
        told, stdout=pipe, stderr=pipe, text=True, start_new_session=True, preexec_fn=heed_interrupts
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
