"""The command as a user meets it: a process, its exit codes, its one-line errors, and real sockets."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from detector_process import ended, port_of, ran, running
from patience import PATIENCE_S

LEARN, FREE = ("--learn", "10", "--save", "b.json"), ("--connect", "udpin:127.0.0.1:0")


def test_help_names_every_option_of_the_contract() -> None:
    text = ran("--help").stdout
    own = "connect baseline learn save airframe layout frame name forward journal record metrics web vehicle profile"
    more = "config keep-rates check print-config working signing-key reset-stamp web-token-file version"
    assert set(re.findall(r"--[a-z-]+(?=[ ,\n])", text)) >= {f"--{option}" for option in f"{own} {more}".split()}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "name a --baseline FILE, or --learn SECONDS"),
        (("--learn", "10", "--baseline", "b.json"), "not both"),
        (("--learn", "ten"), "learn: Input should be a valid number"),
        (("--lern", "10"), "No such option: --lern"),
        (("--baseline", "absent.json"), "absent.json: no such file; make a baseline with `mavdiag identify`"),
        (("--baseline", os.devnull), "is not a regular file"),
        ((*LEARN, "--connect", "udp:1"), "malformed address 'udp:1'"),
        ((*LEARN, "--connect", "/dev/absent,57600"), "no such device"),
        ((*LEARN, *FREE, "--journal", "absent/j.jsonl"), "choose another --journal file"),
        ((*LEARN, *FREE, "--record", "absent/f.tlog"), "choose another --record file"),
        ((*LEARN, *FREE, "--airframe", "absent.toml"), "absent.toml"),
        ((*LEARN, "--config", "absent.toml"), "absent.toml: no such file; check --config"),
        ((*LEARN, "--vehicle", "300"), "vehicle: "),
    ],
)
def test_what_is_wrong_is_one_line_and_exit_code_2(program: Any, options: tuple[str, ...], words: str) -> None:
    code, out, err = program("detector.__main__", *options)
    assert code == 2
    assert words in err
    assert len(err.splitlines()) == 1
    assert err.startswith("mavdiag-detector: ")
    assert out == ""


def default(number: int) -> None:
    """Not ignored, as `nohup` has its children ignore SIGHUP."""
    signal.signal(number, signal.SIG_DFL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_it_cleanly_with_a_summary_and_a_last_line(number: int, tmp_path: Path) -> None:
    journal = tmp_path / "j.jsonl"
    with running(*LEARN, *FREE, "--journal", str(journal), before=lambda: default(number)) as (child, first):
        assert port_of(first) > 0
        code, rest = ended(child, number)
    assert code == 0
    assert len(rest.splitlines()) == 1
    assert "stopped after" in rest
    assert [json.loads(line)["kind"] for line in journal.read_text().splitlines()] == ["start", "stop"]


FITTING = """
import signal, sys, time
from detector.fitting import FittingJob, ProcessFitter
from detector.values import Learn
from mavdiag.airframe.airframe import Airframe
from mavdiag.telemetry import Telemetry
if __name__ == "__main__":
    signal.signal(signal.SIGINT, lambda number, frame: None)
    fitter = ProcessFitter()
    fitter.begin(FittingJob(1, Airframe(), Learn("qdrone2", Telemetry())))
    print("begun", flush=True)
    until = time.monotonic() + 100.0
    while time.monotonic() < until and not (done := fitter.poll()):
        time.sleep(0.01)
    print(done)
"""


@pytest.mark.realtime
@pytest.mark.parametrize("after_s", [0.0, 0.2])
def test_ctrl_c_does_not_reach_the_fit(after_s: float) -> None:
    """A terminal sends it to every process of the group."""
    child = subprocess.Popen(
        [sys.executable, "-c", FITTING],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "begun\n"
    time.sleep(after_s)
    os.killpg(child.pid, signal.SIGINT)
    out, errors = child.communicate(timeout=PATIENCE_S)
    assert errors == ""
    assert "no body rate in the data" in out


@pytest.mark.realtime
def test_over_udp_it_learns_from_the_plant_and_finds_its_fault(tmp_path: Path) -> None:
    """The plant as a process, real time, 1 kHz: 12 s of learning, then a strong fault."""
    saved = tmp_path / "learned.json"
    options = ("--learn", "12", "--save", str(saved), "--connect", "udpin:127.0.0.1:0")
    with running(*options, "--journal", str(tmp_path / "j.jsonl")) as (child, first):
        plant = subprocess.run(
            [
                *(sys.executable, "-m", "sitl_plant", "run", "--out", f"udpout:127.0.0.1:{port_of(first)}"),
                *("--duration", "40", "--fault", "F2/SV3", "--onset", "30", "--seed", "3"),
            ],
            capture_output=True,
            text=True,
            timeout=5 * PATIENCE_S,  # a flight of 40 s in real time
            check=False,
        )
        code, rest = ended(child, signal.SIGTERM)
    assert plant.returncode == 0, plant.stderr
    assert code == 0
    assert saved.exists()
    assert "0 datagrams overflowed here" in rest
    assert " 0 lost on the way" in rest
    lines = [json.loads(line) for line in (tmp_path / "j.jsonl").read_text().splitlines()]
    alerts = [line for line in lines if line["kind"] == "text" and line["severity"] == 2]
    assert alerts, "nothing was alerted"
    events = [line for line in lines if line["kind"] == "event" and line["t_s"] > 30.0]
    assert events
