"""A campaign: its plan and its summary, counted by hand; the same numbers however many work on it; going on."""

import json
import sys
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavdiag.errors import UsageError
from sitl_plant.campaign.plan import (
    CAUSES,
    CONDITIONS,
    HEALTHY,
    PRESETS,
    Conditions,
    Design,
    causes_named,
    make_plan,
    with_conditions,
)
from sitl_plant.campaign.summary import _natural, summarise
from sitl_plant.campaign.worker import Answer, FlightResult, Journal, MonitorResult, Results, run_campaign

SITL_PLANT = "sitl_plant.__main__"
TINY = Design(
    seed=4, airframes=1, learn_flights=2, learn="square", flights=3, hours=0.003, duration_s=12.0,
    cause=("F2/SV3", "gyro-noise", "ejection"), phenomenology=(1.0,), manoeuvre=("square",), wind=(0.0,),
    payload=(0.0,),
)  # fmt: skip
CONDITIONED = replace(PRESETS["conditions"], airframes=2, flights=2 * len(CONDITIONS), hours=0.1 * len(CONDITIONS))
DESIGN = Design(airframes=2, seed=9)


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
    (torn := tmp_path / "torn.jsonl").write_text("\n".join(lines[:3]) + "\n" + lines[3][:100])
    again = run(torn)
    assert (again.reused, again.others) == (3, 1)
    assert again.flights == results.flights
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
    assert results.flights[0].verdict == "not_judgeable"
    assert results.flights[0].reason.startswith("no baseline: ")
    assert "at least 20 are needed to measure the rate" in results.flights[0].reason
    assert summarise(results)["detection"] == []


def test_b13_fresh_keeps_the_results_if_the_scheduler_cannot_be_used(
    program: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    (path := tmp_path / "results.jsonl").write_text("a result\n")
    code, _, _ = program(SITL_PLANT, "campaign", "-o", path, "--fresh", "--scheduler", "tcp://h:1")
    assert (code, path.read_text()) == (2, "a result\n")


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
    assert (json.loads(out)["flights"], path.read_text()) == (1, before)


def test_every_cause_meets_every_rotor_and_scale_equally_often() -> None:
    flights = make_plan(Design(flights=12 * len(CAUSES), hours=0.0))
    assert set(Counter((flight.cause, flight.rotor) for flight in flights).values()) == {3}
    fitted = causes_named(["fault"])
    scales = Counter((flight.cause, flight.phenomenology) for flight in flights if flight.cause in fitted)
    assert set(scales.values()) == {4}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("colour=red", "no factor 'colour'"),
        ("wind=", "FACTOR=LEVEL"),
        ("wind=99", "wind: .* less than or equal to 10, not 99"),
        ("cause=rust", "no cause 'rust'"),
        ("manoeuvre=loop", "no manoeuvre 'loop'"),
        ("link=qdrone2@9999", "rate must be"),
        ("link=nobody", "no link profile"),
        ("rotor=5", "rotor must be 1 to 4"),
        ("link=qdrone2@fast", "link must be like qdrone2@1000"),
        ("rotor=first", "rotor: .* valid integer"),
        ("loss=0.95", "loss: .* less than or equal to 0.9"),
    ],
)
def test_nonsense_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        with_conditions(Design(), [text])


def test_every_condition_has_its_share_of_hours_and_causes() -> None:
    flights = make_plan(CONDITIONED)
    hours: dict[str, float] = {}
    for flight in flights:
        if flight.cause == HEALTHY:
            name = flight.conditions.condition
            hours[name] = hours.get(name, 0.0) + flight.duration_s / 3600
    assert hours.keys() == CONDITIONS.keys()
    assert all(0.1 <= found < 0.1 + 600 / 3600 for found in hours.values())
    assert min(hours.values()) == pytest.approx(0.1)
    causes = Counter(flight.conditions.condition for flight in flights if flight.cause != HEALTHY)
    assert set(causes.values()) == {2}
    assert {flight.duration_s for flight in flights if flight.conditions.condition == "battery-10min"} == {600.0}


def line(
    index: int, cause: str, episodes: int = 0, latency_s: float | None = None, answer: Answer | None = None, **more: Any
) -> FlightResult:
    onset_s, after = None if cause == "healthy" else 20.0, 0 if latency_s is None else 1
    monitors = (MonitorResult("latency", episodes, after), MonitorResult("other", 0, 0))
    told: dict[str, Any] = {"phenomenology": 1.0, "verdict": "healthy", "reason": "", "link": "qdrone2@1000", **more}
    told |= {"healthy_s": 60.0 if onset_s is None else 20.0, "onset_s": onset_s, "monitors": monitors}
    told |= {"conditions": Conditions(wind_m_s=float(index % 2)), "loss": 0.0, "flown_s": 60.0, "judged_s": 60.0}
    told |= {"episodes": episodes, "latency_s": latency_s, "answer": answer or Answer("nothing")}
    return FlightResult(str(index), index, index % 2, cause, 1 + index % 4, **told)


def made() -> Results:
    found = "propeller fault"
    return Results(
        DESIGN,
        (
            *(line(i, "healthy", episodes=int(i == 3)) for i in range(30)),
            line(30, "F1/SV2", latency_s=1.0, answer=Answer(found, rotor=3, fault_type="F1", severity=2)),
            line(31, "F1/SV2", latency_s=3.0, answer=Answer(found, rotor=1, fault_type="F2")),
            line(32, "F2/SV1", episodes=1, phenomenology=0.5),
            line(33, "F2/SV1", verdict="not_judgeable", answer=Answer("not_judgeable")),
            line(34, "gyro-bias", latency_s=2.0, answer=Answer("sensor fault")),
        ),
        reused=0,
        others=0,
    )


def test_false_alarms_are_counted_in_healthy_flight_and_before_an_onset() -> None:
    summary = summarise(made())
    hours = (30 * 60 + 4 * 20) / 3600  # the flight that was not judged does not count
    assert summary["healthy_hours"] == pytest.approx(hours)
    rows = {(row["factor"], row["level"]): row for row in summary["alarms"]}
    every = rows["all", "all"]
    assert (every["rate"].count, every["flights"].hits, every["flights"].of) == (2, 2, 34)
    assert every["rate"].hours == pytest.approx(hours)
    assert (rows["flight", "healthy"]["rate"].count, rows["flight", "before an onset"]["rate"].count) == (1, 1)
    assert rows["flight", "before an onset"]["rate"].hours == pytest.approx(80 / 3600)
    assert (rows["wind m/s", "0"]["rate"].count, rows["wind m/s", "1"]["rate"].count) == (1, 1)
    assert "loss" not in {row["factor"] for row in summary["alarms"]}  # it does not vary
    assert summary["chance"] == pytest.approx(1 - np.exp(-2 / hours * 40 / 3600))


def test_detections_are_counted_on_judged_faults_alone() -> None:
    summary = summarise(made())
    every = summary["detection"][0]
    assert (every["detected"].hits, every["detected"].of, every["early"]) == (2, 3, 1)
    assert (every["latency_median_s"], every["latency_p90_s"]) == pytest.approx((2.0, 2.8))
    assert (every["rotor_right"].hits, every["rotor_right"].of) == (1, 2)
    assert (every["type_right"].hits, every["type_right"].of) == (1, 2)
    assert (every["severity_right"].hits, every["severity_right"].of) == (1, 1)
    cells = {row["level"]: row["detected"] for row in summary["detection"] if row["factor"] == "fault, phenomenology"}
    assert (cells["F1/SV2 x1"].hits, cells["F2/SV1 x0.5"].of) == (2, 1)
    assert summary["unjudged"] == (("not_judgeable: ", 1),)


def test_levels_are_in_order_of_numbers_and_a_name_may_begin_with_a_digit() -> None:
    assert sorted(["3dr iris", "100", "20", "hexa-x"], key=_natural) == ["20", "100", "3dr iris", "hexa-x"]
