"""All monitors together on emulated flights: what is found, named, and how little the cutting of the stream matters."""

from functools import cache

import numpy as np
import pytest
from made_telemetry import cut

from mavdiag.baseline import Baseline, dump, parse
from mavdiag.chain import chain_of
from mavdiag.decision.events import Event
from mavdiag.judging import Verdict, judge
from mavdiag.learning import Flight, LearnOptions, learn
from mavdiag.logs import Log
from mavdiag.telemetry import Telemetry
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

ONSET_S = 8.0


def flown(config: PlantConfig, duration_s: float) -> Telemetry:
    return flight_telemetry(config, duration_s)[0]


@cache
def baseline() -> Baseline:
    flights = [
        Flight(f"f{seed}", f"{seed:064x}", "qdrone2", flown(PlantConfig(seed=100 + seed), 25.0)) for seed in range(6)
    ]
    return parse(dump(learn(flights, LearnOptions(), created="2026-01-01T00:00:00+00:00")))


@cache
def damaged(rotor: int) -> Telemetry:
    return flown(PlantConfig(seed=7, fault="F2/SV2", rotor=rotor, onset_s=ONSET_S), 22.0)


def run(chunks: list[Telemetry]) -> list[Event]:
    chain = chain_of(baseline())
    state = chain.start()
    found: list[Event] = []
    for chunk in chunks:
        state, findings = chain.step(state, chunk)
        found += findings.events
    found += chain.finish(state).events
    latest = {(event.monitor, event.axis, event.start_ns): event for event in found}
    return sorted(latest.values(), key=lambda event: (event.start_ns, event.monitor))


def test_every_monitor_can_work_on_this_link() -> None:
    assert baseline().not_judgeable == ()
    kinds = {entry.spec.kind for entry in baseline().monitors}
    assert kinds == {"latency", "innovation", "energy", "vibration", "effort"}


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_crack_is_declared_soon_and_its_rotor_named(rotor: int) -> None:
    verdict = judge(Log("crack", "", "qdrone2", damaged(rotor), 0), baseline())
    assert verdict.verdict is Verdict.FAULT
    assert ONSET_S < verdict.events[0].t_s < ONSET_S + 3.0
    assert {one.event.rotor for one in verdict.events if one.event.rotor is not None} == {rotor}


@pytest.mark.parametrize("seed", [900, 901, 902])
def test_a_healthy_flight_is_healthy(seed: int) -> None:
    verdict = judge(Log("healthy", "", "qdrone2", flown(PlantConfig(seed=seed), 25.0), 0), baseline())
    assert verdict.verdict is Verdict.HEALTHY, f"seed {seed}: {verdict.reason}"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_events_do_not_depend_on_the_chunks(seed: int) -> None:
    whole = run([damaged(3)])
    edges = np.cumsum(np.random.default_rng(seed).integers(2_000_000, 60_000_000 * seed, 800))
    pieces = run(cut(damaged(3), [int(edge) for edge in edges if edge < 22_000_000_000]))
    assert [event.start_ns for event in pieces] == [event.start_ns for event in whole], f"seed {seed}"
    for piece, one in zip(pieces, whole, strict=True):
        assert (piece.monitor, piece.end_ns, piece.rotor, piece.fault_type, piece.severity) == (
            one.monitor,
            one.end_ns,
            one.rotor,
            one.fault_type,
            one.severity,
        )
        assert piece.statistic == pytest.approx(one.statistic, rel=1e-9)
