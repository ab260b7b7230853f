"""The plan of a campaign: balanced levels, stable beginnings, seeds of the content, and filters that say no."""

import hashlib
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mavdiag.errors import UsageError
from sitl_plant.campaign.plan import (
    CALM,
    CAUSES,
    CONDITIONS,
    HEALTHY,
    MANOEUVRES,
    PRESETS,
    USUAL,
    Conditions,
    Design,
    FlightTask,
    Group,
    LearnTask,
    balanced,
    built,
    built_link,
    causes_named,
    injections_of,
    make_plan,
    task_sequence,
    with_conditions,
)
from sitl_plant.campaign.worker import specimen, task_key
from sitl_plant.physics.airframe import drone
from sitl_plant.physics.faults import RotorDamage, SensorFault
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
    fitted = causes_named(["fault"])
    scales = Counter((flight.cause, flight.phenomenology) for flight in flights if flight.cause in fitted)
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


def test_an_isolator_passes_a_tenth_of_the_rotors_line() -> None:
    """The stationary gain of a base-driven mode, by hand, at 167 Hz."""
    mount = built(qdrone2(), "isolation-10").imu.mount
    assert mount is not None
    warped = math.tan(math.pi * 0.1667) / math.tan(math.pi * mount.resonance_hz * 1e-3)
    loss = (2 * mount.damping_ratio * warped) ** 2
    assert math.sqrt((1 + loss) / ((1 - warped**2) ** 2 + loss)) == pytest.approx(0.1, rel=0.01)
    assert built(qdrone2(), CALM) is built(qdrone2(), "turbulence-5")


def test_conditions_set_wind_payload_manoeuvre_and_duration() -> None:
    design = with_conditions(Design(hours=2.0, flights=0), ["condition=wind-5,yaw-turns,payload-200", "wind=1"])
    flights = make_plan(design).flights
    own = {name: [one.conditions for one in flights if one.conditions.condition == name] for name in design.condition}
    assert {one.wind_m_s for one in own["wind-5"]} == {5.0}
    assert {one.wind_m_s for one in own["yaw-turns"]} == {1.0}
    assert {one.manoeuvre for one in own["yaw-turns"]} == set(CONDITIONS["yaw-turns"].manoeuvres)
    assert {one.payload_g for one in own["payload-200"]} == {200.0}
    assert with_conditions(Design(), ["condition=all"]).condition == tuple(CONDITIONS)
    assert all(set(row.manoeuvres) <= MANOEUVRES.keys() for row in CONDITIONS.values())


def test_flights_on_another_day_share_their_day_by_fours() -> None:
    design = with_conditions(Design(hours=0.5, flights=0, airframes=2), ["condition=sessions,propellers-1,pick-up"])
    flights = make_plan(design).flights
    days = Counter((one.conditions.condition, one.learnt.airframe, one.session) for one in flights)
    assert {session for (name, _, session) in days if name == "pick-up"} == {0}
    for name in ("sessions", "propellers-1"):
        own = {(airframe, session): n for (condition, airframe, session), n in days.items() if condition == name}
        assert min(session for _, session in own) == 1
        assert max(own.values()) == 4


def test_the_same_flight_in_two_conditions_has_two_streams() -> None:
    (one,) = make_plan(with_conditions(Design(flights=1, hours=0.0), ["condition=turbulence-5"])).flights
    other = replace(one, conditions=replace(one.conditions, condition="turbulence-8"))
    assert words(0, one) != words(0, other)


def test_a_rate_that_the_profile_does_not_grant_is_refused() -> None:
    assert built_link("px4@100", "link-200hz") == "px4@200"
    with pytest.raises(UsageError, match="rate must be"):
        built_link("px4@160", "link-400hz")
