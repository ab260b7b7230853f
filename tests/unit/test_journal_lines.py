"""The journal's lines keep the public contract, and a full disk stops nothing but them."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from made_session import baseline_for

from detector.effects import (
    BaselineLearned,
    EventClosed,
    EventOpened,
    Note,
    Record,
    SendText,
    StateChanged,
    TextSuppressed,
)
from detector.journal import Journal, When, line, mark
from detector.states import State
from mavdiag.decision.events import Event
from mavdiag.errors import UsageError
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Axis

NOW = datetime(2026, 5, 1, 12, 0, 30, 250_000, tzinfo=UTC)
WHEN = When(NOW, 1, 62_500_000_000)
EVENT = Event("latency", Axis.ROLL, 60_000_000_000, 62_000_000_000, 0.41, 0.12, 0.05)
CONTRACT = {
    "t_s",
    "end_s",
    "monitor",
    "axis",
    "statistic",
    "threshold",
    "fsd_s",
    "fml_s",
    "rotor",
    "fault_type",
    "severity",
    "confidence",
}


def test_an_event_has_the_contracts_fields_and_both_clocks() -> None:
    found = json.loads(line(EventClosed(EVENT), WHEN))
    assert found.keys() >= CONTRACT
    assert found["kind"] == "event"
    assert (found["t_s"], found["end_s"], found["axis"]) == (60.0, 62.0, "roll")
    assert (found["fsd_s"], found["fml_s"], found["rotor"]) == (0.41, 0.12, None)
    assert (found["vehicle"], found["vehicle_s"]) == (1, 62.5)
    assert (found["utc"], found["start_utc"]) == ("2026-05-01T12:00:30.250Z", "2026-05-01T12:00:27.750Z")


def test_an_event_that_lasts_has_no_end() -> None:
    open_event = Event("latency", None, 1, None, 0.4, 0.1, 0.0)
    assert json.loads(line(EventClosed(open_event), WHEN))["end_s"] is None
    assert json.loads(line(EventOpened(open_event), WHEN))["kind"] == "opened"


@pytest.mark.parametrize(
    ("record", "fields"),
    [
        (
            StateChanged(State.WAITING, State.LEARNING, "go"),
            {"kind": "state", "from": "waiting", "to": "learning", "reason": "go"},
        ),
        (SendText(Severity.INFO, "hello"), {"kind": "text", "severity": 6, "text": "hello"}),
        (TextSuppressed("hello", 3), {"kind": "suppressed", "text": "hello", "count": 3}),
        (Note("got it"), {"kind": "note", "text": "got it"}),
        (BaselineLearned(baseline_for()), {"kind": "baseline", "airframe": "made"}),
    ],
)
def test_every_record_is_one_json_object_on_one_line(record: Record, fields: dict[str, object]) -> None:
    text = line(record, When(NOW, 2))
    assert "\n" not in text
    found = json.loads(text)
    assert found.items() >= fields.items()
    assert found["vehicle"] == 2
    assert "vehicle_s" not in found


def test_the_daemons_own_lines_belong_to_no_vehicle() -> None:
    found = json.loads(mark("start", When(NOW), {"version": "1"}))
    assert found == {"kind": "start", "utc": "2026-05-01T12:00:30.250Z", "vehicle": None, "version": "1"}


def test_lines_are_there_as_soon_as_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    path.write_text("old\n", encoding="utf-8")
    journal = Journal(path, warn=lambda text: None)
    journal.write("new")
    assert path.read_text() == "old\nnew\n"
    journal.close()


def test_a_full_disk_is_told_once_and_lines_are_counted() -> None:
    warnings: list[str] = []
    journal = Journal(Path("/dev/full"), warnings.append)
    for _ in range(5):
        journal.write("a line")
    journal.close()
    assert journal.lost == 5
    assert len(warnings) == 1
    assert "No space left on device" in warnings[0]


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
    assert disk.content == b"first\nse\nfourth\n"
    assert len(warnings) == 2
    assert "writing again; 2 lines were lost" in warnings[1]


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"j\.jsonl: cannot be written .* choose another --journal file"):
        Journal(tmp_path / "absent" / "j.jsonl", warn=lambda text: None)
