"""A campaign's plan: levels, seeds, conditions; and its summary, counted by hand."""

from collections import Counter
from dataclasses import replace
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
    FlightTask,
    LearnTask,
    causes_named,
    make_plan,
    task_sequence,
    with_conditions,
)
from sitl_plant.campaign.summary import poisson as poisson_rate
from sitl_plant.campaign.summary import print_summary, summarise
from sitl_plant.campaign.worker import Answer, FlightResult, MonitorResult, Results
from sitl_plant.vehicle import qdrone2


def words(seed: int, task: FlightTask | LearnTask) -> list[int]:
    return [int(word) for word in task_sequence(seed, task).generate_state(4)]


def test_every_cause_meets_every_rotor_and_scale_equally_often() -> None:
    flights = make_plan(Design(flights=12 * len(CAUSES), hours=0.0))
    assert set(Counter((flight.cause, flight.rotor) for flight in flights).values()) == {3}
    fitted = causes_named(["fault"])
    scales = Counter((flight.cause, flight.phenomenology) for flight in flights if flight.cause in fitted)
    assert set(scales.values()) == {4}


def test_seeds_follow_from_what_is_flown() -> None:
    plan = make_plan(Design(flights=30, hours=0.1))
    tasks: list[FlightTask | LearnTask] = [*dict.fromkeys(flight.learnt for flight in plan), *plan]
    states = [tuple(words(0, task)) for task in tasks]
    assert len(set(states)) == len(states)
    flight = plan[0]
    assert words(0, flight) == words(0, replace(flight, phenomenology=0.25, loss=0.1))
    assert words(0, flight) != words(1, flight)
    assert words(0, flight) != words(0, replace(flight, rotor=flight.rotor % 4 + 1))


def test_conditions_replace_levels() -> None:
    design = with_conditions(
        Design(), ["cause=sensor,F2/SV2", "wind=0,2", "manoeuvre=hover", "link=ardupilot@100", "loss=0.1", "rotor=2"]
    )
    assert set(design.cause) == {"F2/SV2", *(name for name in CAUSES if name.startswith(("gyro", "accel")))}
    assert (design.wind, design.manoeuvre, design.rotor) == ((0.0, 2.0), ("hover",), (2,))
    assert (design.link, design.loss) == (("ardupilot@100",), (0.1,))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("colour=red", "no factor 'colour'"),
        ("wind=", "FACTOR=LEVEL"),
        ("wind=strong", "wind: .* valid number"),
        ("wind=99", "wind: .* less than or equal to 10, not 99"),
        ("cause=rust", "no cause 'rust'"),
        ("manoeuvre=loop", "no manoeuvre 'loop'"),
        ("condition=snow", "no condition 'snow'"),
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


CONDITIONED = replace(PRESETS["conditions"], airframes=2, flights=2 * len(CONDITIONS), hours=0.1 * len(CONDITIONS))


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


def test_only_what_belongs_to_the_build_is_learnt_with() -> None:
    """The baseline never flew in the condition, but with the same frame, filters and link."""
    for flight in make_plan(CONDITIONED):
        name, learnt = flight.conditions.condition, flight.learnt
        assert set(learnt.flights) == {Conditions()}
        assert len(learnt.flights) == 5
        row = CONDITIONS[name]
        build = (row.filter_hz, row.resonance_hz, row.isolation) != (None, None, None)
        assert (learnt.vehicle == qdrone2()) == (not build)
        assert learnt.link == ("qdrone2@1000" if row.rate_hz is None else f"qdrone2@{row.rate_hz:g}")
        if row.filter_hz is not None:
            assert learnt.vehicle.imu.filter_hz == row.filter_hz


DESIGN = Design(airframes=2, seed=9)


def line(
    index: int,
    cause: str,
    episodes: int = 0,
    latency_s: float | None = None,
    answer: Answer = Answer("nothing"),  # noqa: B008  # frozen
    verdict: str = "healthy",
    phenomenology: float = 1.0,
) -> FlightResult:
    onset_s = None if cause == "healthy" else 20.0
    after = 0 if latency_s is None else 1
    return FlightResult(
        key=str(index),
        index=index,
        airframe=index % 2,
        cause=cause,
        rotor=1 + index % 4,
        phenomenology=phenomenology,
        conditions=Conditions(wind_m_s=float(index % 2)),
        link="qdrone2@1000",
        loss=0.0,
        flown_s=60.0,
        verdict=verdict,
        reason="",
        judged_s=60.0,
        healthy_s=60.0 if onset_s is None else 20.0,
        onset_s=onset_s,
        episodes=episodes,
        latency_s=latency_s,
        answer=answer,
        monitors=(MonitorResult("latency", episodes, after, latency_s), MonitorResult("other", 0, 0, None)),
    )


def made() -> Results:
    found = "propeller fault"
    return Results(
        DESIGN,
        (),
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
    assert every["latency_median_s"] == pytest.approx(2.0)
    assert every["latency_p90_s"] == pytest.approx(2.8)
    assert (every["rotor_right"].hits, every["rotor_right"].of) == (1, 2)
    assert (every["type_right"].hits, every["type_right"].of) == (1, 2)
    assert (every["severity_right"].hits, every["severity_right"].of) == (1, 1)
    cells = {row["level"]: row["detected"] for row in summary["detection"] if row["factor"] == "fault, phenomenology"}
    assert (cells["F1/SV2 x1"].hits, cells["F2/SV1 x0.5"].of) == (2, 1)
    assert summary["unjudged"] == (("not_judgeable: ", 1),)


def flown(index: int, condition: str, cause: str = "healthy", **other: Any) -> FlightResult:
    return replace(line(index, cause), conditions=Conditions(condition=condition), **other)


def in_conditions() -> Results:
    late = MonitorResult("energy", 0, 1, 2.0)
    flights = (
        *(flown(i, "wind-2", judged_s=45.0, episodes=i // 8, faults=i // 9) for i in range(10)),
        flown(10, "wind-2", verdict="fault", judged_s=45.0),
        flown(11, "wind-2", verdict="not_judgeable", judged_s=0.0, monitors=()),
        flown(12, "wind-2", "F1/SV1", latency_s=1.0, declared_s=1.5, phenomenology=0.5),
        flown(13, "wind-2", "F1/SV1", latency_s=1.0, monitors=(late,), phenomenology=0.5),
        flown(14, "wind-2", "F2/SV1", verdict="not_judgeable", phenomenology=0.5),
        flown(15, "wind-2", "F2/SV1", phenomenology=1.0),
        flown(16, "wind-2", "gyro-bias", latency_s=1.0),
        flown(17, "calm"),
    )
    return Results(DESIGN, (), flights, 0, 0)


def test_each_condition_tells_its_hours_alarms_and_detections() -> None:
    calm, wind = summarise(in_conditions())["conditions"]
    assert (calm["condition"], wind["condition"]) == ("calm", "wind-2")
    assert wind["flown_h"] == pytest.approx(12 * 60 / 3600)
    assert wind["judged_h"] == pytest.approx(11 * 45 / 3600)
    assert wind["judged_share"] == pytest.approx(11 * 45 / (12 * 60))
    assert (wind["alarms"].count, wind["faults"].count) == (2, 1)
    assert wind["faults"].high == pytest.approx(poisson_rate(1, 11 * 45 / 3600).high)
    assert (wind["flagged"].hits, wind["flagged"].of) == (1, 12)
    found = {one["phenomenology"]: one for one in wind["detection"]}
    assert (found[0.5]["flights"], found[0.5]["detected"].hits, found[0.5]["detected"].of) == (3, 2, 2)
    assert (found[0.5]["declared"].hits, found[1.0]["detected"].hits, found[1.0]["detected"].of) == (1, 0, 1)
    assert calm["detection"] == []


def test_the_tables_print(capsys: pytest.CaptureFixture[str]) -> None:
    print_summary(summarise(made()))
    shown = capsys.readouterr().out
    for text in ("False alarms", "2/3", "F1/SV2", "gyro-bias", "not judged: 1 flights", "seed 9"):
        assert text in shown
    print_summary(summarise(Results(DESIGN, (), (), 0, 0)))
    assert "0 flights" in capsys.readouterr().out
