"""The JSON objects of the public contract."""

import json

import pytest

from mavdiag.as_json import event_json, json_line, verdict_json
from mavdiag.commands import progress
from mavdiag.decision.alarm import Event
from mavdiag.judging import LogVerdict, MonitorSummary, Verdict
from mavdiag.telemetry import Axis


def test_r2_a_monitor_that_never_judged_has_no_maximum_but_a_reason() -> None:
    silent = MonitorSummary(
        name="rotor_trim", axis=None, maximum=None, threshold=0.15, unit="1", alarms=0, judged_s=0.0,
        not_judged="no actuator outputs",
    )  # fmt: skip
    found = json.loads(
        json.dumps(verdict_json(LogVerdict("a/b.tlog", Verdict.NOT_JUDGEABLE, "why", monitors=(silent,))))
    )
    assert found["log"] == "a/b.tlog"
    assert found["verdict"] == "not_judgeable"
    told = found["monitors"]["rotor_trim"]
    assert (told["max"], told["judged_s"], told["not_judged"]) == (None, 0.0, "no actuator outputs")


def test_the_run_length_and_its_limit_are_told_of_the_thesis_monitor_only() -> None:
    event = Event("fsd", Axis.ROLL, 60_000_000_000, None, 0.41, 0.12, 0.05)
    found = json.loads(json.dumps(event_json(60.0, None, event)))
    assert (found["axis"], found["fsd_s"], found["fml_s"], found["end_s"]) == ("roll", 0.41, 0.12, None)
    other = event_json(1.0, 2.0, Event("innovation", None, 1, 2, float("inf"), 0.12, 0.05, rotor=2, confidence=0.98765))
    assert (other["statistic"], other["fsd_s"], other["rotor"], other["confidence"]) == (None, None, 2, 0.988)


def test_what_is_not_finite_is_null_wherever_it_stands() -> None:
    silent = MonitorSummary("unbalance", Axis.ROLL, float("nan"), float("inf"), "g mm", 0)
    found = json.loads(json_line({"a": (1.5, float("-inf")), "b": [silent]}))
    assert found["a"] == [1.5, None]
    assert (found["b"][0]["maximum"], found["b"][0]["threshold"], found["b"][0]["axis"]) == (None, None, "roll")


@pytest.mark.parametrize("terminal", [False, True])
def test_r10_progress_is_shown_on_a_terminal_only_and_loses_no_item(
    terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
    monkeypatch.setenv("TERM", "xterm")
    assert list(progress.each([1, 2, 3], "judging")) == [1, 2, 3]
    with progress.working("learning ..."):
        pass
    out, err = capsys.readouterr()
    assert out == ""
    assert ("judging" in err) == terminal
