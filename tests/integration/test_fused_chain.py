"""All monitors together on emulated flights: what is found, named, and how little the cutting of the stream matters."""

from functools import cache

import pytest

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.decision.alarm import Stage
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.monitors import BY_NAME
from mavdiag.telemetry import Log, Telemetry
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

ONSET_S = 12.0  # 5 s after take-off nothing is judged


def flown(config: PlantConfig, duration_s: float) -> Telemetry:
    return flight_telemetry(config, duration_s)[0]


@cache
def baseline() -> Baseline:
    flights = [
        Log(f"f{seed}", f"{seed:064x}", "qdrone2", flown(PlantConfig(seed=100 + seed), 25.0)) for seed in range(6)
    ]
    return parse(
        dump(learn(flights, LearnOptions(airframe=airframe_named("qdrone2")), created="2026-01-01T00:00:00+00:00"))
    )


@cache
def damaged(rotor: int) -> Telemetry:
    return flown(PlantConfig(seed=7, fault="F2/SV2", rotor=rotor, onset_s=ONSET_S), 26.0)


def test_every_monitor_can_work_on_this_link() -> None:
    assert [one.monitor for one in baseline().not_judgeable] == ["vibration_level"]  # no such message
    kinds = {entry.spec.kind for entry in baseline().monitors}
    assert kinds == set(BY_NAME) - {"vibration_level"}


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_crack_is_declared_soon_and_its_rotor_named(rotor: int) -> None:
    verdict = judge(Log("crack", "", "qdrone2", damaged(rotor)), baseline())
    assert verdict.verdict is Verdict.FAULT
    faults = [one for one in verdict.changes if one.stage is Stage.FAULT]
    assert ONSET_S < faults[0].t_ns / 1e9 < ONSET_S + 3.0
    assert {one.event.rotor for one in verdict.events if one.event.rotor is not None} == {rotor}
    assert {one.fault_type for one in faults} <= {None, "F2", "F3"}  # a crack, or what looks like one


@pytest.mark.parametrize("seed", [900, 901, 902])
def test_a_healthy_flight_is_healthy(seed: int) -> None:
    verdict = judge(Log("healthy", "", "qdrone2", flown(PlantConfig(seed=seed), 25.0)), baseline())
    assert verdict.verdict is Verdict.HEALTHY, f"seed {seed}: {verdict.reason}"
