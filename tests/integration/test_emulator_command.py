"""`sitl-plant` as its user meets it: files, exit codes, errors of one line, and the wall clock."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE_S

from mavdiag.link.codec import Decoder, field_index
from mavdiag.link.messages import MessageId
from mavdiag.link.ports import open_endpoint


def sitl_plant(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sitl_plant", *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def read_lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_the_same_options_give_the_same_file_and_another_seed_another(tmp_path: Path) -> None:
    flight = ("--duration", "2", "--fault", "F2/SV2", "--rotor", "3", "--onset", "1", "--rate", "200", "--seed")
    files = {name: tmp_path / f"{name}.tlog" for name in ("one", "same", "other")}
    truth = tmp_path / "truth.jsonl"
    for (name, path), seed in zip(files.items(), ("4", "4", "5"), strict=True):
        done = sitl_plant("record", "-o", str(path), *flight, seed, "--truth", str(truth))
        assert done.returncode == 0, done.stderr
        assert str(files[name]) in done.stdout
    one, same, other = (path.read_bytes() for path in files.values())
    assert one == same
    assert one != other
    lines = read_lines(truth)
    assert [line["record"] for line in lines] == ["flight", "state", "onset", "state"]
    assert (lines[0]["seed"], lines[0]["started_unix_ns"]) == (5, None)
    assert (lines[2]["t_s"], lines[2]["fault"], lines[2]["rotor"]) == (1.0, "F2/SV2", 3)
    assert [line["fault_present"] for line in lines if line["record"] == "state"] == [False, True]


@pytest.mark.parametrize(
    ("arguments", "advice"),
    [
        (["run", "--fault", "F9/SV1"], "no fault 'F9/SV1': give F1, F2 or F3"),
        (["run", "--onset", "3"], "--onset needs a fault"),
        (["run", "--rate", "5000"], "rate must be 1 to 1000 Hz"),
        (["run", "--profile", "betaflight"], "no link profile betaflight"),
        (["run", "--speed", "fast"], "speed must be 0.01 to 100, or max"),
        (["run", "--duration", "-1"], "duration must be positive"),
        (["run", "--out", "udpout:localhost"], "malformed address"),
        (["run", "--out", "/dev/no-such-tty,57600"], "no such device"),
        (["run", "--truth", "/no/such/folder/truth.jsonl", "--out", "udpin:127.0.0.1:0"], "choose another --truth"),
        (["record", "-o", "/no/such/folder/x.tlog", "--duration", "1"], "cannot write"),
        (["record"], "-o"),
        (["serve-ardupilot", "--listen", "tcpin:127.0.0.1:9002"], "write udpin:HOST:PORT"),
        (["serve-ardupilot", "--fault", "F1/SV1", "--rotor", "7"], "rotor must be 1 to 4"),
        (["serve-ardupilot", "--print-parameters", "betaflight"], "give ardupilot or px4"),
        (["serve-ardupilot", "--truth", "/no/such/folder/t.jsonl", "--listen", "udpin:127.0.0.1:0"], "choose another"),
        (["serve-px4", "--rate", "5"], "rate"),
        (["serve-hil", "/dev/no-such-tty,921600"], "no such device"),
    ],
)
def test_a_mistake_is_one_line_on_stderr_and_exit_code_2(program: Any, arguments: list[str], advice: str) -> None:
    code, out, err = program("sitl_plant.__main__", *arguments)
    assert code == 2
    assert advice in err
    assert err.count("\n") == 1, err
    assert out == ""


@pytest.mark.realtime
def test_a_flight_keeps_the_wall_clock_and_no_message_comes_early() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as ear:
        command = ["run", "--json", "--out", ear.address.replace("udpin", "udpout"), "--duration", "3"]
        flight = subprocess.Popen([sys.executable, "-m", "sitl_plant", *command], stdout=subprocess.PIPE, text=True)
        decoder, frames = Decoder(), []
        place = field_index(MessageId.RAW_IMU, "time_usec")
        until = time.monotonic() + PATIENCE_S
        while flight.poll() is None and time.monotonic() < until:
            frames += [frame for data, host_ns in ear.receive(0.1) for frame in decoder.feed(data, host_ns)]
        frames += [frame for data, host_ns in ear.receive(0.1) for frame in decoder.feed(data, host_ns)]
        output, _ = flight.communicate(timeout=PATIENCE_S)
        assert ear.traffic.overflowed == 0
    assert flight.returncode == 0
    report = json.loads(output.splitlines()[-1])
    assert report["event"] == "landed"
    assert report["wall_s"] > 2.9
    imu = [(frame.host_ns, int(frame.fields[place]) * 1000) for frame in frames if frame.msgid == MessageId.RAW_IMU]
    assert len(imu) == 3000
    assert decoder.senders[1, 1].lost == 0
    if report["late_max_ms"] < 100.0:  # else the machine had other things to do, and the report says so
        delay = [host_ns - t_ns for host_ns, t_ns in imu]
        assert report["wall_s"] < 3.5
        assert report["slips"] == 0
        assert sorted(delay)[len(delay) // 2] - min(delay) < 0.1e9


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_flight_in_good_order(number: signal.Signals, tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    command = ["run", "--json", "--out", "udpin:127.0.0.1:0", "--truth", str(truth)]
    flight = subprocess.Popen([sys.executable, "-m", "sitl_plant", *command], stdout=subprocess.PIPE, text=True)
    assert flight.stdout is not None
    assert json.loads(flight.stdout.readline())["event"] == "flying"
    time.sleep(0.3)
    flight.send_signal(number)
    output, _ = flight.communicate(timeout=PATIENCE_S)
    assert flight.returncode == 0
    assert json.loads(output)["event"] == "landed"
    assert [line["record"] for line in read_lines(truth)][:2] == ["flight", "state"]
