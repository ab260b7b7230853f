"""The JSON objects of the public contract."""

import json

from mavdiag.as_json import event_json, json_line
from mavdiag.decision.alarm import Event
from mavdiag.judging import MonitorSummary
from mavdiag.telemetry import Axis


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
