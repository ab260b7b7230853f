"""The journal's lines keep the public contract, and a full disk stops nothing but them."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from made_session import baseline_for

from detector.journal import Journal, Reporter, When
from detector.states import State
from detector.values import EventClosed, Note, Record, SendText, StateChanged, TextSuppressed
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Axis

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
    assert found["kind"] == "event"
    assert (found["t_s"], found["end_s"], found["axis"]) == (60.0, 62.0, "roll")
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
    assert disk.content == b"first\nse\nfourth\n"
    assert len(warnings) == 2
    assert "writing again; 2 entries were lost" in warnings[1]
