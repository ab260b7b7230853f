"""The plan of a campaign: balanced levels, stable beginnings, seeds of the content, and filters that say no."""

import hashlib
from collections import Counter
from dataclasses import replace

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
from sitl_plant.vehicle import qdrone2


def words(seed: int, task: FlightTask) -> list[int]:
    return [int(word) for word in task_sequence(seed, task).generate_state(4)]


def test_every_cause_meets_every_rotor_and_scale_equally_often() -> None:
    flights = make_plan(Design(flights=12 * len(CAUSES), hours=0.0)).flights
    assert set(Counter((flight.cause, flight.rotor) for flight in flights).values()) == {3}
    fitted = causes_named(["fault"])
    scales = Counter((flight.cause, flight.phenomenology) for flight in flights if flight.cause in fitted)
    assert set(scales.values()) == {4}


def test_seeds_follow_from_what_is_flown() -> None:
    plan = make_plan(Design(flights=30, hours=0.1))
    states = [tuple(words(0, flight)) for flight in plan.flights]
    assert len(set(states)) == len(states)
    flight = plan.flights[0]
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
        ("wind=strong", "must be a number"),
        ("wind=99", "wind must be 0 to 10"),
        ("cause=rust", "no cause 'rust'"),
        ("manoeuvre=loop", "no manoeuvre 'loop'"),
        ("condition=snow", "no condition 'snow'"),
        ("link=qdrone2@9999", "rate must be"),
        ("link=nobody", "no link profile"),
        ("rotor=5", "rotor must be 1 to 4"),
        ("loss=0.95", "loss must be 0 to 0.9"),
    ],
)
def test_nonsense_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        with_conditions(Design(), [text])


@pytest.mark.parametrize(
    ("preset", "digest"), [("quick", "74063096addbab78c34c2972"), ("full", "58eb7faddcaa8bab91f033e4")]
)
def test_campaigns_without_conditions_keep_the_random_streams_they_had_before(preset: str, digest: str) -> None:
    """The digests were taken before there were conditions."""
    plan, whole = make_plan(PRESETS[preset]), hashlib.sha256()
    tasks: list[LearnTask | FlightTask] = [*plan.learning, *plan.flights]
    for task in tasks:
        whole.update(task_sequence(0, task).generate_state(4).tobytes())
    assert whole.hexdigest()[:24] == digest


CONDITIONED = replace(PRESETS["conditions"], airframes=2, flights=2 * len(CONDITIONS), hours=0.1 * len(CONDITIONS))


def test_every_condition_has_its_share_of_hours_and_causes() -> None:
    flights = make_plan(CONDITIONED).flights
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
    for flight in make_plan(CONDITIONED).flights:
        name, learnt = flight.conditions.condition, flight.learnt
        assert set(learnt.flights) == {Conditions()}
        assert len(learnt.flights) == 5
        row = CONDITIONS[name]
        build = (row.filter_hz, row.resonance_hz, row.isolation) != (None, None, None)
        assert (learnt.vehicle == qdrone2()) == (not build)
        assert learnt.link == ("qdrone2@1000" if row.rate_hz is None else f"qdrone2@{row.rate_hz:g}")
        if row.filter_hz is not None:
            assert learnt.vehicle.imu.filter_hz == row.filter_hz
