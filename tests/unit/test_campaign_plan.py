"""The plan of a campaign: balanced levels, stable beginnings, seeds of the content, and filters that say no."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mavdiag.errors import UsageError
from sitl_plant.campaign.causes import CAUSES, HEALTHY, Group, causes_named, injections_of
from sitl_plant.campaign.conditions import MANOEUVRES, USUAL
from sitl_plant.campaign.levels import with_conditions
from sitl_plant.campaign.plan import PRESETS, Design, FlightTask, balanced, make_plan, task_sequence
from sitl_plant.campaign.runner import task_key
from sitl_plant.campaign.worker import specimen
from sitl_plant.physics.airframe import drone
from sitl_plant.physics.injections import RotorDamage, SensorFault
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2, vehicle_named


def words(seed: int, task: FlightTask) -> list[int]:
    return [int(word) for word in task_sequence(seed, task).generate_state(4)]


@pytest.mark.parametrize("count", [0, 1, 7, 12, 120])
def test_every_level_occurs_equally_often(count: int) -> None:
    found = Counter(balanced("abcd", count, seed=3, factor="x"))
    assert sum(found.values()) == count
    assert max(found.values(), default=0) - min((found[level] for level in "abcd"), default=0) <= 1


def test_a_longer_campaign_begins_with_a_shorter_one() -> None:
    short, long = (make_plan(Design(flights=n, hours=0.0)).flights for n in (40, 90))
    assert long[:40] == short


def test_factors_are_paired_at_random() -> None:
    flights = make_plan(Design(flights=4600, hours=0.0, seed=1)).flights
    pairs = Counter((flight.rotor, flight.conditions.manoeuvre) for flight in flights)
    expected = len(flights) / (4 * len(USUAL))
    assert len(pairs) == 4 * len(USUAL)
    assert max(abs(n - expected) for n in pairs.values()) < 5 * expected**0.5


def test_every_cause_meets_every_rotor_and_scale_equally_often() -> None:
    flights = make_plan(Design(flights=12 * len(CAUSES), hours=0.0)).flights
    assert set(Counter((flight.cause, flight.rotor) for flight in flights).values()) == {3}
    scales = Counter((flight.cause, flight.phenomenology) for flight in flights if CAUSES[flight.cause].fitted)
    assert set(scales.values()) == {4}


def test_quick_has_every_cause_manoeuvre_and_scale_and_healthy_hours() -> None:
    plan = make_plan(PRESETS["quick"])
    assert {flight.cause for flight in plan.flights} == {HEALTHY, *CAUSES}
    assert {flight.conditions.manoeuvre for flight in plan.flights} == set(USUAL) < set(MANOEUVRES)
    assert {flight.phenomenology for flight in plan.flights if flight.cause == "F2/SV2"} <= {0.0, 0.5, 1.0}
    healthy = [flight for flight in plan.flights if flight.cause == HEALTHY]
    assert sum(flight.duration_s for flight in healthy) >= 3600 * PRESETS["quick"].hours
    assert {flight.learnt for flight in plan.flights} == set(plan.learning)


def test_learning_from_the_square_alone_or_from_half_of_it() -> None:
    (square,) = make_plan(Design(airframes=1, learn="square", flights=1, hours=0.0)).learning
    (mixed,) = make_plan(Design(airframes=1, learn="mixed", flights=1, hours=0.0)).learning
    assert {one.manoeuvre for one in square.flights} == {"square"}
    assert square.flights[::2] == mixed.flights[::2]
    assert len({one.manoeuvre for one in mixed.flights}) > 2


def test_seeds_follow_from_what_is_flown() -> None:
    plan = make_plan(Design(flights=30, hours=0.1))
    states = [tuple(words(0, flight)) for flight in plan.flights]
    assert len(set(states)) == len(states)
    flight = plan.flights[0]
    assert words(0, flight) == words(0, replace(flight, phenomenology=0.25, loss=0.1))
    assert words(0, flight) != words(1, flight)
    assert words(0, flight) != words(0, replace(flight, rotor=flight.rotor % 4 + 1))


def test_airframes_are_fresh() -> None:
    drones = [drone(qdrone2(), number).thrust_coefficient_n_s2.tolist() for number in (1, 2, 3)]
    drawn = [specimen(0, number, False, qdrone2()).thrust_coefficient_n_s2.tolist() for number in range(20)]
    assert all(one not in drones for one in drawn)
    assert len({tuple(one) for one in drawn}) == 20
    assert specimen(5, 2, True, qdrone2()).gyro_bias.tolist() == specimen(5, 2, True, qdrone2()).gyro_bias.tolist()


@pytest.mark.parametrize("name", CAUSES)
def test_every_cause_can_be_injected_from_its_onset_on(name: str) -> None:
    (injection,) = injections_of(name, 3, 5.0, 1.0, np.random.default_rng(1))
    assert (injection.rotor, injection.onset_s) == (3, 5.0)
    assert isinstance(injection.cause, SensorFault if CAUSES[name].group is Group.SENSOR else RotorDamage)
    PlantConfig(injections=(injection,))


def test_only_the_nine_faults_have_fitted_terms() -> None:
    assert [name for name, cause in CAUSES.items() if cause.fitted] == list(causes_named(["fault"]))
    (bare,) = injections_of("F2/SV3", 1, 0.0, 0.0, np.random.default_rng(1))
    assert isinstance(bare.cause, RotorDamage)
    assert (bare.cause.fluctuation_rms, bare.cause.thrust_lag_s) == (0.0, 0.0)
    assert injections_of(HEALTHY, 1, 0.0, 1.0, np.random.default_rng(1)) == ()


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
        ("link=qdrone2@9999", "rate must be"),
        ("link=nobody", "no link profile"),
        ("rotor=5", "rotor must be 1 to 4"),
        ("loss=0.95", "loss must be 0 to 0.9"),
    ],
)
def test_nonsense_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        with_conditions(Design(), [text])


@pytest.mark.parametrize(("field", "value"), [("airframes", 0), ("seed", -1), ("hours", float("nan")), ("flights", -1)])
def test_impossible_designs_are_refused(field: str, value: float) -> None:
    with pytest.raises(UsageError):
        replace(Design(), **{field: value})  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(UsageError, match="10 to 600 s"):
        Design(duration_s=1.0)


def test_rotors_are_those_of_the_vehicle() -> None:
    hexa = Design(flights=120, hours=0.0, vehicle=vehicle_named("hexa-x"))
    assert {flight.rotor for flight in make_plan(hexa).flights} == {1, 2, 3, 4, 5, 6}
    assert with_conditions(hexa, ["rotor=6"]).rotor == (6,)
    with pytest.raises(UsageError, match="rotor must be 1 to 6"):
        with_conditions(hexa, ["rotor=7"])


def test_results_of_one_vehicle_are_not_those_of_another() -> None:
    one, other = (make_plan(Design(vehicle=vehicle_named(name))).flights[0] for name in ("qdrone2", "quad-plus"))
    assert task_key(0, one) != task_key(0, other)
