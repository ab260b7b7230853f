"""A tiny campaign: the same numbers however many work on it, and going on where it stopped."""

import json
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavdiag.baseline import Baseline
from mavdiag.judging import JudgedFlight, judge_in_full
from mavdiag.learning import learn
from mavdiag.telemetry import Log
from sitl_plant.campaign import worker
from sitl_plant.campaign.plan import Design
from sitl_plant.campaign.summary import summarise
from sitl_plant.campaign.worker import Journal, Results, run_campaign

SITL_PLANT = "sitl_plant.__main__"
TINY = Design(
    seed=4, airframes=1, learn_flights=2, learn="square", flights=3, hours=0.003, duration_s=12.0,
    cause=("F2/SV3", "gyro-noise", "ejection"), phenomenology=(1.0,), manoeuvre=("square",), wind=(0.0,),
    payload=(0.0,),
)  # fmt: skip


def run(path: Path, design: Design = TINY, workers: int = 1) -> Results:
    with closing(Journal(path)) as journal:
        return run_campaign(design, journal, workers)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Results]:
    path = tmp_path_factory.mktemp("campaign") / "results.jsonl"
    return path, run(path)


def test_flights_come_out_as_flown(finished: tuple[Path, Results]) -> None:
    _, results = finished
    (learnt,) = results.learnt
    assert learnt.error == ""
    assert learnt.judged_s == pytest.approx(
        2 * (12.0 - 5.1), abs=0.1
    )  # five seconds after take-off and windows are not judged
    by_cause = {flight.cause: flight for flight in results.flights}
    assert by_cause["healthy"].onset_s is None
    assert by_cause["healthy"].flown_s == 12.0
    assert by_cause["healthy"].healthy_s == by_cause["healthy"].judged_s
    crack, gone = by_cause["F2/SV3"], by_cause["ejection"]
    assert crack.onset_s is not None
    assert 0.3 * 12 <= crack.onset_s <= 0.5 * 12
    assert gone.onset_s is not None
    assert gone.onset_s < gone.flown_s < gone.onset_s + 2.0  # it falls
    for one in (crack, gone):  # as in the healthy flight; what was judged after the onset is not in it
        assert one.healthy_s == pytest.approx(max(0.0, (one.onset_s or 0.0) - 5.1), abs=0.15)
    assert gone.latency_s is not None
    assert gone.latency_s > 0.0
    assert summarise(results)["flights"] == 4


def test_two_worker_processes_give_the_same_numbers(finished: tuple[Path, Results], tmp_path: Path) -> None:
    found = run(tmp_path / "results.jsonl", workers=2)
    assert found.flights == finished[1].flights  # a process with more threads of arithmetic rounds otherwise


def test_a_rerun_flies_only_what_is_missing(finished: tuple[Path, Results], tmp_path: Path) -> None:
    path, results = finished
    lines = path.read_text().splitlines()
    assert len(lines) == 5
    torn = tmp_path / "torn.jsonl"
    torn.write_text("\n".join(lines[:3]) + "\n" + lines[3][:100])
    again = run(torn)
    assert (again.reused, again.others) == (3, 1)
    assert (again.learnt, again.flights) == (results.learnt, results.flights)
    kept = torn.read_text().splitlines()
    assert kept[:3] == lines[:3]
    assert [json.loads(line)["key"] for line in kept[4:]] == [json.loads(line)["key"] for line in lines[3:]]
    assert run(torn).reused == 5


def test_an_airframe_that_cannot_be_learnt_is_told_not_hidden(tmp_path: Path) -> None:
    design = Design(
        airframes=1, learn_flights=1, flights=1, hours=0.0, duration_s=10.0, cause=("bending",),
        manoeuvre=("hover",), link=("qdrone2@1",),
    )  # fmt: skip
    results = run(tmp_path / "results.jsonl", design)
    assert "at least 20 are needed to measure the rate" in results.learnt[0].error
    assert results.flights[0].verdict == "not_judgeable"
    assert "no baseline" in results.flights[0].reason
    assert summarise(results)["detection"] == []


def test_conditions_are_flown_judged_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One short flight in each of four conditions, against one baseline; the logs say which day they are of."""
    started: dict[str, list[int]] = {"learn": [], "judge": []}

    def learn_seen(logs: Sequence[Log], *told: Any, **named: Any) -> Baseline:
        started["learn"] += [one.started_ns for one in logs]
        return learn(logs, *told, **named)

    def judge_seen(log: Log, baseline: Baseline) -> JudgedFlight:
        started["judge"].append(log.started_ns)
        return judge_in_full(log, baseline)

    monkeypatch.setattr(worker, "learn", learn_seen)
    monkeypatch.setattr(worker, "judge_in_full", judge_seen)
    names = ("turbulence-8", "pick-up", "mocap-loss", "propellers-3")
    design = replace(TINY, flights=0, hours=4 * 12.0 / 3600, condition=names)
    results = run(tmp_path / "results.jsonl", design)
    assert [one.conditions.condition for one in results.flights] == list(names)
    assert [one.session for one in results.flights] == [0, 0, 0, 1]
    gaps_s = np.diff([*started["learn"], started["judge"][0]]) / 1e9
    np.testing.assert_allclose(gaps_s, 12.0 + 300.0)
    same, day = started["judge"][:3], started["judge"][3]
    assert len(set(same)) == 1
    assert day - started["learn"][0] == 86_400 * 10**9
    for row in summarise(results)["conditions"]:
        assert row["flown_h"] == pytest.approx(12.0 / 3600)
        assert 0.3 < row["judged_share"] < 0.8
        assert {one["name"] for one in row["monitors"]} >= {"fsd", "innovation"}
        assert all(0.0 <= one["judged_share"] <= 1.0 for one in row["monitors"])
    again = run(tmp_path / "results.jsonl", design)
    assert (again.reused, again.flights) == (5, results.flights)


def test_b13_fresh_keeps_the_results_if_the_scheduler_cannot_be_used(
    program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    path = tmp_path / "results.jsonl"
    path.write_text("a result\n")
    code, _, _ = program(SITL_PLANT, "campaign", "-o", path, "--fresh", "--scheduler", "tcp://h:1")
    assert code == 2
    assert path.read_text() == "a result\n"


def test_the_command_reuses_and_reports(program: Any, tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    arguments = (
        "campaign", "-o", str(path), "--flights", "1", "--hours", "0", "--airframes", "1", "--learn-flights", "2",
        "--learn", "square", "--duration", "12", "--conditions", "cause=ejection", "--conditions", "wind=0",
        "--workers", "1", "--seed", "2",
    )  # fmt: skip
    code, out, err = program(SITL_PLANT, *arguments)
    assert code == 0, err
    assert "ejection" in out
    before = path.read_text()
    code, out, err = program(SITL_PLANT, *arguments, "--json")
    assert code == 0, err
    assert "2 results reused; 0 lines" in err
    assert json.loads(out)["flights"] == 1
    assert path.read_text() == before


@pytest.mark.parametrize(
    "arguments",
    [("--conditions", "wind=strong"), ("--flights", "-3"), ("-o", ".")],
)
def test_the_command_says_no_in_one_line(program: Any, arguments: tuple[str, ...], tmp_path: Path) -> None:
    nothing = ("-o", str(tmp_path / "r.jsonl"), "--flights", "0", "--hours", "0", "--workers", "1")
    code, _, err = program(SITL_PLANT, "campaign", *nothing, *arguments)
    assert code == 2
    assert len([line for line in err.splitlines() if line.startswith("sitl-plant: ")]) == 1, err
