"""What is learnt, found and named on emulated flights: models, layouts, unbalance, and all monitors together."""

from functools import cache

import numpy as np
import pytest

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import detect_layout
from mavdiag.airframe.layout import layout_named
from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.decision.alarm import Stage
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, front_for, learn, rows_of
from mavdiag.monitors import BY_NAME
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import FloatArray, Log, Telemetry
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import vehicle_named

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


pytest.importorskip("numba", reason="the plant is an extra")


SHAKEN_G_MM = 10.0  # of every rotor; the worst damaged propeller of T Table 3.2 has 5.5


@pytest.mark.parametrize("link", [LinkSpec("qdrone2"), LinkSpec("ardupilot", 100.0)], ids=["1 kHz", "100 Hz"])
@pytest.mark.parametrize(
    ("vehicle", "layout"),
    [
        ("qdrone2", "qdrone2"),
        ("quad-plus", "plus"),
        ("hexa-x", "hexa-x"),
        ("hexa-plus", "hexa-plus"),
        ("octo-x", "octo-x"),
    ],
)
def test_the_layout_of_a_shaken_vehicle_is_found(vehicle: str, layout: str, link: LinkSpec) -> None:
    kind = vehicle_named(vehicle)
    shaken = tuple(Injection(RotorDamage(unbalance_g_mm=SHAKEN_G_MM), n + 1) for n in range(len(kind.rotors)))
    config = PlantConfig(drone=1, vehicle=kind, seed=611, wind_m_s=1.0, injections=shaken)
    telemetry, flown_s = flight_telemetry(config, 15.0, link)
    assert flown_s == pytest.approx(15.0)
    log = Log(vehicle, "", link.profile, telemetry)
    found = detect_layout(rows.block for rows in rows_of(front_for([log], 0.1), log.telemetry))
    assert found.layout is not None, found.reason
    assert found.layout.name == layout
    assert found.outputs == tuple(range(1, len(kind.rotors) + 1))


FRONT = Front(AlignSpec(0.001, Grid.NATIVE), GateSpec(min_thrust=0.1), RateSpec.of(0.001, 101))
QDRONE2 = Airframe(layout=layout_named("qdrone2"), mass_kg=1.504, hover_rad_s=1047.2)


def fly(seed: int, fault: str | None = None, rotor: int = 1, seconds: float = 16.0) -> list[Rows]:
    config = PlantConfig(drone=1, seed=seed, fault=fault, rotor=rotor, wind_m_s=0.5)
    state, rows = FRONT.step(FRONT.start(), flight_telemetry(config, seconds)[0])
    return [one for one in (*rows, *FRONT.finish(state)[1]) if isinstance(one, Rows)]


def test_the_estimated_unbalance_is_that_of_the_table_and_placed() -> None:
    monitor = Unbalance(*Unbalance.fit([fly(11), fly(12)], LearnContext(QDRONE2, None, 0.001, 101)))
    found = [(one.level[one.valid], one.rotors[one.valid]) for one in monitor.over(fly(51, "F3/SV1", 2, seconds=6.0))]
    level, rotors = (np.concatenate(columns) for columns in zip(*found, strict=True))
    assert float(level.mean()) == pytest.approx(3.77, rel=0.15)  # T Table 3.2; own unbalance adds
    assert int(rotors.sum(axis=0).argmax()) + 1 == 2


DT_S = 0.001
WINDOW = 101


@pytest.fixture(scope="module")
def flights() -> dict[int, PlantSamples]:
    return {drone: Plant(PlantConfig(drone=drone, seed=drone)).advance(33_000) for drone in (1, 2, 3)}


def rates(flight: PlantSamples, noise: float, seed: int, column: int = 0) -> tuple[FloatArray, FloatArray]:
    """u and y behind the window [rad/s], the first 3 s left out."""
    gyro = flight.gyro[3000:, column] + noise * np.random.default_rng(seed).standard_normal(30_000)
    value, slope, _ = coefficients(WINDOW)
    return np.correlate(flight.setpoint[3000:, column], slope / DT_S, "valid"), np.correlate(gyro, value, "valid")
