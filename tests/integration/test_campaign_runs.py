"""A tiny campaign: the same numbers however many work on it, and going on where it stopped."""

import json
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

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
