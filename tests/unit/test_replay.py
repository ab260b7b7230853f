"""A replay judges a log as a scan does, and tells the page what a live vehicle would have told it."""

import json
import math
from dataclasses import replace
from typing import cast

import pytest
from made_session import baseline_for
from made_vehicle import record
from test_web_feed import FakeChild

from detector.replay import Judged, Player
from detector.web.child import ServerProcess
from detector.web.snapshot import Level
from mavdiag.judging import judge
from mavdiag.logs import read_log
from mavdiag.telemetry import Instant, Log, Signal, Telemetry

START = Instant(1_000_000_000_000)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("replay") / "flight.tlog"
    record(path, ((30.0, 0.0), (10.0, 0.5), (20.0, 0.0)))
    return read_log(path)


def judged(log: Log, most_s: float = 1e9) -> Judged:
    found = Judged(log, baseline_for(), 1)
    while not found.done and (not found.moments or found.moments[-1].t_ns - found.begin_ns < most_s * 1e9):
        found.go_on()
    return found


@pytest.fixture
def child() -> FakeChild:
    return FakeChild()


def player(child: FakeChild, found: Judged, speed: float = 1.0, at_s: float = 0.0) -> Player:
    return Player(cast(ServerProcess, child), found, speed, at_s)


def test_a_log_is_judged_as_a_scan_judges_it_and_said_as_the_detector_says_it(log: Log) -> None:
    entries = [json.loads(entry) for moment in judged(log).moments for entry in moment.entries]
    stages = [(one["stage"], one["t_s"]) for one in entries if one["kind"] == "stage"]
    changes = [(change.stage, change.t_ns / 1e9) for change in judge(log, baseline_for()).changes]
    assert stages[: len(changes)] == [(stage, pytest.approx(t_s, abs=1e-6)) for stage, t_s in changes]
    assert ("fault", pytest.approx(35.3, abs=1.0)) in stages  # its stamps begin at 5 s
    texts = [one["text"] for one in entries if one["kind"] == "text"]
    assert any(text.startswith("PROP FAULT") for text in texts)
    assert entries[0]["utc"].startswith("2026-05-01T")


def test_a_log_that_lacks_an_axis_of_the_accelerometer_is_judged(log: Log) -> None:
    series = (
        replace(one, values=one.values * (float("nan"), 1.0, 1.0)) if one.signal is Signal.SPECIFIC_FORCE else one
        for one in log.telemetry
    )
    moments = judged(replace(log, telemetry=Telemetry(tuple(series)))).moments
    assert Level.FAULT in {moment.level for moment in moments}


def test_it_plays_at_its_speed_and_begins_when_somebody_looks(log: Log, child: FakeChild) -> None:
    one, now = player(child, judged(log), speed=10.0), START
    for _ in range(20):
        now += 0.1
        one.look(now)
    assert one.at_s == 0.0
    assert [line["vehicles"][0]["vehicle"] for line in child.of("F")] == [1]  # for a page to choose
    child.says = ["watch 1"]
    for _ in range(10):
        now += 0.1
        one.look(now)
    assert one.at_s == pytest.approx(10.0)
    assert len(child.of("N")) == pytest.approx(50, abs=2)  # of a flight of 10 s, none is left out
    assert child.of("P")[-1]["speed"] == 10.0
    child.says = ["play speed 0.0"]
    one.look(now + 5.0)
    one.look(now + 9.0)
    assert one.at_s == pytest.approx(10.0)


def test_a_jump_begins_anew_with_what_was_until_then(log: Log, child: FakeChild) -> None:
    one, now = player(child, judged(log), at_s=50.0), START
    one.look(now)
    assert any("FAULT" in entry.get("text", "") for entry in child.of("J"))
    child.lines, child.says = [], ["play at 3.0", "play at 25.0"]
    one.look(now + 0.1)
    assert child.lines[0].startswith("C ")
    assert child.numbers == list(range(1, len(child.numbers) + 1))
    assert all(entry["vehicle_s"] <= 30.1 for entry in child.of("J"))
    (now_told,) = child.of("N")
    bins = [number for strip in now_told["strips"] if strip["axis"] == "roll" for number in strip["bins"]]
    assert bins == sorted(bins)
    assert bins[-1] - bins[0] == pytest.approx(20 / 0.05, abs=8)  # 20 s
    assert len(child.of("A")) == 1
    track = now_told["track"]  # of a circle of 5 m
    assert len(track) == pytest.approx(2 * 26, abs=2)
    radii = [math.hypot(north, east - 5) for north, east in zip(track[::2], track[1::2], strict=True)]
    assert radii == pytest.approx([5.0] * len(radii), abs=0.02)
    assert child.of("F")[-1]["vehicles"][0]["level"] == Level.QUIET
    assert [level for _, level in child.of("P")[-1]["spans"]][1:3] == [Level.QUIET, Level.FAULT]


def test_a_jump_to_what_is_not_judged_yet_waits_for_it(log: Log, child: FakeChild) -> None:
    found = judged(log, 10.0)
    one = player(child, found)
    one.look(START)
    child.says = ["play at 40.0"]
    one.look(START + 0.3)
    assert (one.at_s, child.of("P")[-1]["wanted_s"]) == (0.0, 40.0)
    while not found.done:
        found.go_on()
    one.look(START + 0.6)
    assert one.at_s == pytest.approx(40.0)
    assert child.of("P")[-1]["wanted_s"] is None
