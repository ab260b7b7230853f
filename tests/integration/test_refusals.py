"""What a command cannot do is one line on stderr and exit code 2, before anything is done."""

import gc
import io
import shlex
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from made_archive import archive_baseline, made

from mavdiag import __version__
from mavdiag.__main__ import start
from sitl_plant.emulator import record_flight
from sitl_plant.options import flight_plan

PROGRAMS = {"mavdiag": "mavdiag.cli", "mavdiag-detector": "detector.__main__", "sitl-plant": "sitl_plant.__main__"}
CAMPAIGN = "sitl-plant campaign -o r.jsonl --flights 0 --hours 0 --workers 1"
FLEET = "sitl-plant fleet -n 2 --fault F2/SV2 --out udpout:127.0.0.1:9"
LEARN, HISTORY = "mavdiag-detector --learn 10 --save b.json", "mavdiag history show --database"
DETECTOR = "mavdiag-detector --baseline baseline.json"
SCAN = "mavdiag scan a.tlog --baseline baseline.json"
REFUSED = [
    ("sitl-plant run --fault F9/SV1", "no fault 'F9/SV1': give F1, F2 or F3"),
    *((f"sitl-plant run --{wrong}", "Invalid value for '--") for wrong in ("phenomenology 7", "wind nan", "wind -1")),
    ("sitl-plant run --propellers nan", "propellers must spread by 0 to 20%, not nan%"),
    *((f"sitl-plant run --{it}", "are of a fault: add") for it in ("onset 3", "rotor 3", "phenomenology 0")),
    ("sitl-plant record -o t.tlog --fault F2/SV2 --onset 60", "--onset 60 is after the end of the flight"),
    ("sitl-plant run --rate 5000", "rate must be 1 to 1000 Hz"),
    ("sitl-plant run --profile betaflight", "no link profile betaflight"),
    ("sitl-plant run --speed fast", "speed must be 0.01 to 100, or max"),
    ("sitl-plant record -o t.tlog --duration inf", "duration must be positive and at most 1e+06 s"),
    *((f"{it} /dev/absent,57600", "no such device") for it in ("sitl-plant run --out", "sitl-plant serve-hil")),
    (f"{LEARN} --connect /dev/null,57600", "this is no serial device"),
    ("sitl-plant run --truth /no/such/t.jsonl --out udpin:127.0.0.1:0", "choose another --truth"),
    ("sitl-plant record", "-o"),
    ("sitl-plant serve-ardupilot --listen tcpin:127.0.0.1:9002", "write udpin:HOST:PORT"),
    ("sitl-plant serve-ardupilot --fault F1/SV1 --rotor 7", "rotor must be 1 to 4"),
    ("sitl-plant serve-ardupilot --print-parameters betaflight", "is not one of 'ardupilot', 'px4'"),
    ("sitl-plant serve-px4 --rate 5", "rate"),
    (f"{CAMPAIGN} --conditions wind=strong", "wind"),
    (f"{CAMPAIGN} --flights -3", "flights"),
    (f"{CAMPAIGN} --duration 12 --conditions condition=take-off", "needs 14.7 s, not 12"),
    (f"{CAMPAIGN} --vehicle qdrone2-recorded --conditions condition=mocap-loss", "does not fly through outages"),
    (f"{CAMPAIGN} --conditions condition=link-400hz --conditions link=px4@160", "rate must be 1 to 250 Hz"),
    (f"{CAMPAIGN} -o .", "Is a directory"),
    (f"{FLEET} --faulty 9", "name system ids of the fleet, 1 to 2"),
    (f"{FLEET} -n 200 --system-id 100", "system ids end at 255"),
    ("mavdiag-detector", "name a --baseline FILE, or --learn SECONDS"),
    ("mavdiag-detector --lern 10", "No such option: --lern"),
    *((f"mavdiag{it} x.js", "x.js: no such file; make a b") for it in ("-detector --baseline", " baseline show")),
    ("mavdiag-detector --baseline /dev/null", "is not a regular file"),
    (f"{LEARN} --connect udp:1", "malformed address 'udp:1'"),
    (f"{LEARN} --connect udpin:127.0.0.1:0 --journal absent/j.jsonl", "choose another --journal file"),
    *((f"{LEARN} --{it} x.toml", words) for it, words in (("airframe", "no airframe"), ("config", "check --config"))),
    (f"{LEARN} --check --record .", "is a folder"),
    (f"{DETECTOR} --metrics x..y:9100", "metrics on x..y:9100: "),
    (f"{DETECTOR} --journal a.tlog", "a.tlog: is no journal so far"),
    (f"{DETECTOR} --history a.tlog --flights empty", "a.tlog: is no history so far"),
    (f"{DETECTOR} --check --journal a.out --record a.out", "a.out: is named twice"),
    (f"{LEARN} --record baseline.json", "baseline.json: is no record so far"),
    (f"{DETECTOR} --check --history h.db --flights baseline.json", "there is no folder baseline.json"),
    ("mavdiag history", "no history there; make one with `mavdiag history add`"),
    ("mavdiag history list --airframe", "'--airframe' requires an argument"),
    ("mavdiag history --airframe x list", "unexpected extra argument"),
    ("mavdiag history mark --airframe x", "say what was done"),
    ("mavdiag identify a.tlog --sessions 2 -o new.json", "--sessions 2: at most 1, one for each log"),
    ("mavdiag history mark --airframe x --repair --at yesterday", "write it like 2026-03-01"),
    ("mavdiag history mark --airframe x --repair --at 2999-03-01", "give one from 1970 to 2262"),
    (f"{HISTORY} postgresql://me:secret@127.0.0.1:1/fleet", "Connection refused"),
    (f"{HISTORY} postgresql://me:secret@127.0.0.1:port/fleet", "postgresql"),
    ("mavdiag history add x --baseline b --at 2026-01-01 --ordered file-time", "both say when"),
    (f"{HISTORY} /etc/passwd", "file is not a database); mend that, or name another one"),
    (f"{HISTORY} /tmp", "/tmp: is a folder"),
    (f"{HISTORY} mysql://a@b/c", "an SQLite file or a postgresql"),
    *((f"mavdiag look {it} ''", f"an empty value behind {it}") for it in ("a.tlog", "--layout")),
    ("mavdiag identify --output= a.tlog", "an empty value behind --output="),
    *((f"mavdiag {it}", "one=: no such file") for it in ("history add x.tlog --baseline=none=", "model none=")),
    ("mavdiag model t.csv", "CSV with --columns MAP.toml where a command has it"),
    *((f"mavdiag model track a.tlog --{it}", "--memory must be longer") for it in ("every 0", "memory 0.04")),
    ("mavdiag model sweep a.tlog --validate fast.tlog", "fast.tlog: its rate is not that of a.tlog"),
    ("mavdiag model a.tlog --plot /dev/null", "not a regular file"),
    *((f"mavdiag model a.tlog --order {order}", "three whole numbers") for order in ("'2;2'", "99,99,99")),
    ("mavdiag model a.tlog --window 1e9", "the window at most 10 s"),
    ("mavdiag export x.ulg", "name one LOG and one of --mcap, --csv, --parquet"),
    ("mavdiag export --lua b.json -o x.lua --vehicle 1", "--lua takes a baseline"),
    ("mavdiag export a.tlog --csv --table-key 5", "-o FILE [--table-key N]"),
    *((f"mavdiag look a.tlog --{it}", "for a link; leave them out") for it in ("ask", "duration 9", "signing-key k")),
    *((f"mavdiag look udpin:127.0.0.1:0 --{it} 1", "are for logs") for it in ("from", "to", "columns")),
    ("mavdiag report", "name logs and --baseline FILE"),
    *((f"mavdiag report {it}", "gone.js: no such file") for it in ("x.tlog --baseline gone.js", "--campaign gone.js")),
    ("mavdiag report x.tlog --campaign c.jsonl", "neither logs nor --baseline"),
    *((f"mavdiag {it} absent/x", "no folder absent") for it in ("report x.tlog -o", "export a.ulg --csv -o")),
    *((f"{it} absent/x", "no folder absent") for it in (f"{SCAN} --csv", "sitl-plant record -o", f"{LEARN} --save")),
    ("mavdiag report empty --baseline baseline.json", "no log there; name files, a folder, or a pattern"),
    (f"{SCAN} --from nan", "--from nan: give a time in seconds"),
    (f"{SCAN} --cache baseline.json", "baseline.json: no folder to keep answers in"),
    *((f"{SCAN} {it}/baseline.json", "is named twice") for it in ("--parquet empty/..", "--csv .")),
    *((f"mavdiag {it} a.tlog", "a.tlog: holds a flight log") for it in ("identify . -o", "history show --html")),
    *((f"sitl-plant record -o {it}", "a flight log, a baseline or a history") for it in ("baseline.json", "h.sqlite")),
    ("sitl-plant record -o t.tlog --truth a.tlog", "a.tlog: holds something else"),
    (f"{CAMPAIGN} -o baseline.json", "baseline.json: holds something else than results"),
    *((f"{SCAN} --windows {wrong}", "Invalid value for '--windows'") for wrong in ("0.5", "inf")),
    (f"{SCAN} --scheduler tcp://127.0.0.1:1", "no Dask scheduler at tcp://127.0.0.1:1"),
    *((f"mavdiag demo --{wrong}", "Invalid value for '--") for wrong in ("rotor 5", "seed -1", "duration nan")),
    *((f"mavdiag shim a b --{wrong}", "Invalid value for '--") for wrong in ("loss nan", "delay -1", "rate 0")),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two logs, a baseline, the beginning of a history and an empty folder."""
    folder = tmp_path_factory.mktemp("place")
    made(folder, "a.tlog")
    record_flight(folder / "fast.tlog", flight_plan(rate=200.0), 10.0, lambda samples: None)
    archive_baseline().save(folder / "baseline.json")
    (folder / "t.csv").write_text("t,p,q,r")
    (folder / "h.sqlite").write_text("SQLite format 3\0")
    (folder / "empty").mkdir()
    return folder


@pytest.mark.parametrize(("command", "words"), REFUSED)
def test_what_cannot_be_done_is_one_line_and_leaves_nothing(
    program: Callable[..., tuple[int, str, str]], place: Path, monkeypatch: pytest.MonkeyPatch, command: str, words: str
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr("mavdiag.archive.pool.PATIENCE_S", 0.5)
    before = sorted(place.rglob("*"))
    name, *arguments = shlex.split(command)
    code, out, err = program(PROGRAMS[name], *arguments)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith(f"{name}: ")
    assert words in line
    assert "secret" not in line
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize("command", ["mavdiag scan", "mavdiag history list", "mavdiag model", *PROGRAMS])
def test_every_command_tells_the_version(program: Callable[..., tuple[int, str, str]], command: str) -> None:
    name, *words = command.split()
    code, out, _ = program(PROGRAMS[name], *words, "--version")
    assert (code, out.split()[-1]) == (0, __version__)


@pytest.mark.parametrize(("end", "code"), [(">/dev/full", 2), (">&- 2>&-", 0), ("no-such-file 2>/dev/full", 2)])
def test_an_output_that_cannot_be_written_is_an_error_and_no_verdict(place: Path, end: str, code: int) -> None:
    command = f"{sys.executable} -m mavdiag baseline show baseline.json {end}"
    ran = subprocess.run(["sh", "-c", command], cwd=place, stdout=-1, stderr=-1, text=True, check=False)
    assert (ran.returncode, "Traceback" in ran.stderr) == (code, False)


def test_a_fault_of_ours_ends_with_2_and_what_a_terminal_lacks_is_shown_as_its_escape(
    program: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", io.TextIOWrapper(raw := io.BytesIO(), "latin-1", write_through=True))
    assert program("mavdiag.cli", "baseline", "show", "отчёт")[0] == 2
    assert rb"\u043e" in raw.getvalue()
    monkeypatch.setattr("mavdiag.commands.identify.Baseline.load", lambda path: 1 / 0)
    assert program("mavdiag.cli", "baseline", "show", "b.json")[0] == 2
    monkeypatch.setattr("mavdiag.commands.watch.stop_signals", lambda: nullcontext(lambda: True))
    assert program("mavdiag.cli", "watch", "udpin:127.0.0.1:0")[0] == 130  # stopped before anything came


INSTALLED = [f"import mavdiag.__main__ as begin; begin.{name}()" for name in ("main", "detector", "plant")]
MODULES = [f"runpy.run_module({name!r}, run_name='__main__')" for name in ("mavdiag", "detector", "sitl_plant")]


@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("begin", [*INSTALLED, *MODULES])
def test_ctrl_c_while_a_program_loads_is_quiet(begin: str, how: str) -> None:
    """Also where the import makes another error of an exception, as that of a class does."""
    stop = f"class Name:\n    def __set_name__(*_): signal.raise_signal(signal.{how})\n"
    stop += "class Stop:\n    def find_spec(name, *_):\n        if name == 'numpy': type('', (), {'': Name()})\n"
    code = f"import runpy, signal, sys\n{stop}sys.meta_path.insert(0, Stop)\n{begin}"
    ran = subprocess.run([sys.executable, "-c", code], stdout=-1, stderr=-1, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (130, b"", b"")


def test_a_program_is_loaded_without_looking_for_garbage_and_runs_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    looked = list[bool]()

    def load(_: str) -> SimpleNamespace:
        looked.append(gc.isenabled())
        return SimpleNamespace(main=lambda: looked.append(gc.isenabled()))

    monkeypatch.setattr("mavdiag.__main__.import_module", load)
    with pytest.raises(SystemExit):
        start("a program")
    gc.unfreeze()
    assert looked == [False, True]
