"""What the daemon writes and tells: the journal, figures for Prometheus, and signs of life for systemd."""

import json
import os
import re
import select
import socket
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle

from detector.config import Settings
from detector.journal import MB, Journal, Reporter, When
from detector.metrics import COUNTERS, GAUGES, Metrics
from detector.notify import Notifier
from detector.states import State
from detector.values import EventClosed, Note, Record, SendText, StateChanged, TextSuppressed
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import UsageError
from mavdiag.link.messages import Autopilot, Severity
from mavdiag.telemetry import Axis


def appender(path: Path, limit: int, keep: int) -> tuple[Journal, list[str]]:
    said: list[str] = []
    return Journal(path, said.append, limit / MB, keep), said


def test_a_file_that_is_full_is_numbered_and_so_are_those_before(tmp_path: Path) -> None:
    file, said = appender(tmp_path / "j.jsonl", limit=10, keep=2)
    for number in range(6):
        file.append(f"line{number}\n".encode())  # 6 bytes: one in each file
    file.close()
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert (found, said) == ({"j.jsonl": "line5\n", "j.1.jsonl": "line4\n", "j.2.jsonl": "line3\n"}, [])


def test_a_rotation_that_fails_is_told_once_and_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, said = appender(tmp_path / "j", limit=4, keep=1)
    file.append(b"old.")

    def full(path: Path, *args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", full)
        file.append(b"lost")
        file.append(b"lost")
    file.append(b"new.")
    file.close()
    assert file.lost == 2
    assert [one.partition("j: ")[2] for one in said] == [
        "cannot be written (No space left on device); watching goes on without it",
        "writing again; 2 entries were lost",
    ]
    assert ((tmp_path / "j").read_bytes(), (tmp_path / "j.1").read_bytes()) == (b"new.", b"old.")


def test_alerts_are_written_through_to_the_disk_once_a_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal(tmp_path / "j", warn=lambda text: None)
    calls: list[int] = []
    monkeypatch.setattr(os, "fsync", calls.append)
    for alerts, synced in ((0, 0), (2, 1), (0, 1)):
        journal.write("a note")
        for _ in range(alerts):
            journal.write("an alarm", urgent=True)
        journal.flush()
        assert len(calls) == synced
    journal.close()


def test_a_pipe_whose_reader_stops_loses_entries_and_never_waits(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    file, said = appender(tmp_path / "pipe", limit=10, keep=0)
    for _ in range(300):
        file.append(b"x" * 1000)
    assert len(os.read(reader, 1 << 20)) + 1000 * file.lost >= 300_000
    assert file.lost > 200
    file.append(b"again")
    os.close(reader)
    file.append(b"nobody is there")
    file.close()
    assert [("cannot" in one, "again" in one) for one in said] == [(True, False), (False, True), (True, False)]


def test_a_file_has_one_writer_through_all_rotations(tmp_path: Path) -> None:
    first, _ = appender(tmp_path / "j.jsonl", limit=10, keep=2)
    for number in range(4):
        with pytest.raises(UsageError, match="another program writes it"):
            appender(tmp_path / "j.jsonl", limit=10, keep=2)
        first.append(f"line{number}\n".encode())
    first.close()
    second, _ = appender(tmp_path / "j.jsonl", limit=10, keep=2)
    second.close()


NOW = datetime(2026, 5, 1, 12, 0, 30, 250_000, tzinfo=UTC)
WHEN = When(NOW, 1, 62_500_000_000)
FOUND: dict[str, Any] = {"monitor": "fsd", "axis": Axis.ROLL, "statistic": 0.41, "threshold": 0.12}
FOUND |= dict.fromkeys(("rotor", "fault_type", "severity", "confidence"))
EVENT = Event(start_ns=60_000_000_000, end_ns=62_000_000_000, level=0.05, **FOUND)
CHANGE = Change(Stage.SUSPECTED, "fsd is above its threshold", unit="s", t_ns=60_000_000_000, **FOUND)
CONTRACT = {"t_s", "end_s", "fsd_s", "fml_s", *FOUND}


def line(record: Record, when: When) -> str:
    lines: list[str] = []
    Reporter([lambda text, urgent: lines.append(text)], lambda text: None, lambda sysid: when, None).record(2, record)
    return lines[0]


def test_an_event_has_the_contracts_fields_and_both_clocks() -> None:
    found = json.loads(line(EventClosed(EVENT), WHEN))
    assert found.keys() >= CONTRACT
    assert (found["kind"], found["t_s"], found["end_s"], found["axis"]) == ("event", 60.0, 62.0, "roll")
    assert (found["fsd_s"], found["fml_s"], found["rotor"]) == (0.41, 0.12, None)
    assert (found["vehicle"], found["vehicle_s"]) == (1, 62.5)
    assert (found["utc"], found["start_utc"]) == ("2026-05-01T12:00:30.250Z", "2026-05-01T12:00:27.750Z")


@pytest.mark.parametrize(
    ("record", "fields"),
    [
        (
            StateChanged(State.WAITING, State.LEARNING, "go"),
            {"kind": "state", "from": "waiting", "to": "learning", "reason": "go"},
        ),
        (SendText(Severity.INFO, "hello"), {"kind": "text", "severity": 6, "text": "hello"}),
        (TextSuppressed("hello", 3), {"kind": "suppressed", "text": "hello", "count": 3}),
        (CHANGE, {"kind": "stage", "stage": "suspected", "t_s": 60.0, "monitor": "fsd", "rotor": None}),
        (replace(CHANGE, statistic=float("inf")), {"kind": "stage", "statistic": None}),
        (Note("got it"), {"kind": "note", "text": "got it"}),
        (baseline_for(), {"kind": "baseline", "airframe": "made"}),
    ],
)
def test_every_record_is_one_json_object_on_one_line(record: Record, fields: dict[str, object]) -> None:
    text = line(record, When(NOW, 2))
    assert "\n" not in text
    found = json.loads(text)
    assert found.items() >= fields.items()
    assert found["vehicle"] == 2
    assert "vehicle_s" not in found


class Filling:
    """A file that takes only so many bytes, until somebody makes room."""

    def __init__(self, room: int) -> None:
        self.room, self.content = room, b""

    def write(self, data: bytes) -> int:
        taken = data[: self.room]
        if data and not taken:
            raise OSError(28, "No space left on device")
        self.room -= len(taken)
        self.content += taken
        return len(taken)


def test_a_line_that_was_torn_does_not_spoil_the_next_one(tmp_path: Path) -> None:
    warnings: list[str] = []
    journal = Journal(tmp_path / "j.jsonl", warnings.append)
    journal.close()
    disk = Filling(room=8)
    journal._file = disk  # type: ignore[assignment]  # a disk that fills up
    journal.write("first")
    journal.write("second")  # two of its bytes fit
    journal.write("third")
    disk.room = 100
    journal.write("fourth")
    assert (disk.content, len(warnings)) == (b"first\nse\nfourth\n", 2)
    assert "writing again; 2 entries were lost" in warnings[1]


@pytest.fixture
def metrics() -> Iterator[Metrics]:
    one = Metrics("127.0.0.1", 0)
    yield one
    one.close()


def page(metrics: Metrics) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{metrics.port}/metrics", timeout=5.0) as answer:
        text: str = answer.read().decode()
    return text


def flown(metrics: Metrics, vehicles: int = 1) -> Bench:
    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
    flying = [MadeVehicle(k + 1) for k in range(vehicles)]
    bench = Bench(settings, baseline_for(), vehicles=flying, links_behind=1, metrics=metrics)
    bench.run(12.0)
    return bench


def value(text: str, name: str) -> float:
    found = re.search(rf"^mavdiag_{re.escape(name)} (.+)$", text, re.MULTILINE)
    assert found, name
    return float(found[1])


def test_the_figures_of_a_flight_are_on_the_page(metrics: Metrics) -> None:
    bench, text = flown(metrics), page(metrics)
    bench.close()
    assert value(text, 'state{state="monitoring",vehicle="1"}') == 1
    assert value(text, 'state{state="lost",vehicle="1"}') == 0
    assert value(text, 'verdict{vehicle="1",verdict="quiet"}') == 1
    assert value(text, 'verdict{vehicle="1",verdict="fault"}') == 0
    assert "mavdiag_fault{" not in text
    assert value(text, 'frames_received{vehicle="1"}') > 2000
    assert value(text, 'frames_lost{vehicle="1"}') == 0
    assert value(text, 'stream_hertz{stream="body_rate",vehicle="1"}') == pytest.approx(100.0, rel=0.01)
    assert value(text, 'judged_seconds{vehicle="1"}') > 4.0
    assert 0.3 < value(text, 'judged_share{vehicle="1"}') < 1.0  # the first five seconds are not judged
    assert 0.0 <= value(text, 'statistic_ratio{axis="roll",monitor="fsd",vehicle="1"}') < 1.0
    assert value(text, 'link_connected{link="vehicle"}') == 1
    assert (value(text, 'link_dropped{link="behind 1 memory:near"}'), value(text, "session_working")) == (0, 1)


def test_requests_that_are_never_ended_cost_no_thread_and_hide_no_page(caplog: pytest.LogCaptureFixture) -> None:
    metrics = Metrics("127.0.0.1", 0)
    bench, threads = flown(metrics), threading.active_count()
    with ExitStack() as stack:
        for _ in range(300):
            begun = stack.enter_context(socket.create_connection(("127.0.0.1", metrics.port)))
            begun.send(b"GET /metrics HTTP/1.1\r\nX: ")
        assert threading.active_count() == threads
        assert "mavdiag_state" in page(metrics)
        metrics.close()
    assert not caplog.records  # nor is one that is cut off an error
    bench.close()


def test_the_dashboard_asks_only_for_figures_and_labels_that_there_are(metrics: Metrics) -> None:
    text = Path(__file__).parents[2].joinpath("deploy", "grafana-dashboard.json").read_text()
    board, bench = json.loads(text), flown(metrics, vehicles=2)
    bench.close()
    known = set(re.findall(r"^# TYPE (\w+) ", page(metrics), re.MULTILINE))
    known |= {f"{name}_{more}" for name in known for more in ("bucket", "total")}
    asked = set(re.findall(r"mavdiag_\w+", text))
    assert len(asked) >= 12
    assert asked <= known
    labels = {label for _, of in (GAUGES | COUNTERS).values() for label in of}
    for panel in board["panels"]:
        for target in panel["targets"]:
            assert set(re.findall(r"{{(\w+)}}", target["legendFormat"])) <= labels
    places = [(one["x"], one["y"]) for one in (panel["gridPos"] for panel in board["panels"])]
    assert len(set(places)) == len(places)


@pytest.mark.parametrize(("autopilot", "alive"), [(Autopilot.GENERIC, True), (Autopilot.ARDUPILOTMEGA, False)])
def test_the_daemon_gives_a_sign_of_life_unless_all_are_off(autopilot: Autopilot, alive: bool, tmp_path: Path) -> None:
    """As where the baseline is of another profile."""
    settings, signs = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json")), list[str]()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "30000000"})
        bench = Bench(settings, baseline_for(), vehicles=[MadeVehicle(1, autopilot)], notifier=notifier)
        bench.run(5.0)
        while select.select([manager], [], [], 0.0)[0]:
            manager.recv(4096)
        for _ in range(10):
            bench.run(1.0)
            while select.select([manager], [], [], 0.0)[0]:
                signs.append(manager.recv(4096).decode())
        bench.close()
        notifier.close()
    assert ("WATCHDOG=1" in signs) == alive
