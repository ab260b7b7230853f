"""The monitors on the emulated vehicle: an unsteady rotor and an unbalanced one are found and named from healthy
flights of the same airframe alone."""

import numpy as np
import pytest

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

FRONT = Front(AlignSpec(0.001, Grid.NATIVE), GateSpec(min_thrust=0.1), RateSpec.of(0.001, 101))
QDRONE2 = Airframe(layout=layout_named("qdrone2"), mass_kg=1.504, hover_rad_s=1047.2)
CONTEXT = LearnContext(QDRONE2, None, 0.001, 101)


def fly(seed: int, fault: str | None = None, rotor: int = 1, seconds: float = 16.0) -> list[Rows]:
    config = PlantConfig(drone=1, seed=seed, fault=fault, rotor=rotor, wind_m_s=0.5)
    state, rows = FRONT.step(FRONT.start(), flight_telemetry(config, seconds)[0])
    return [one for one in (*rows, *FRONT.finish(state)[1]) if isinstance(one, Rows)]


@pytest.fixture(scope="module")
def healthy() -> list[list[Rows]]:
    return [fly(seed) for seed in (11, 12)]


@pytest.fixture(scope="module")
def moving(healthy: list[list[Rows]]) -> RotorSignature:
    return RotorSignature(*RotorSignature.fit(healthy, CONTEXT))


@pytest.fixture(scope="module")
def shaking(healthy: list[list[Rows]]) -> Unbalance:
    return Unbalance(*Unbalance.fit(healthy, CONTEXT))


def peak(monitor: RotorSignature | Unbalance, rows: list[Rows]) -> tuple[float, int]:
    """Highest statistic, and the rotor that the evidence of the whole flight points at."""
    best, evidence = 0.0, np.zeros(4)
    for found in monitor.over(rows):
        best = max(best, float(found.value.max(where=found.valid, initial=0.0)))
        evidence += found.rotors[found.valid].sum(axis=0)
    return best, int(evidence.argmax()) + 1


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_crack_that_hardly_shakes_is_seen_in_the_rotor_signature(
    moving: RotorSignature, shaking: Unbalance, rotor: int
) -> None:
    cracked = fly(20 + rotor, "F2/SV1", rotor)
    calm, _ = peak(moving, fly(30))
    found, named = peak(moving, cracked)
    assert found > 2.5 * calm
    assert named == rotor
    assert peak(shaking, cracked)[0] < 1.0


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_an_edge_cut_is_seen_and_placed_by_its_vibration(shaking: Unbalance, rotor: int) -> None:
    calm, _ = peak(shaking, fly(31))
    found, named = peak(shaking, fly(40 + rotor, "F1/SV1", rotor, seconds=6.0))
    assert calm < 0.8
    assert found > 1.0
    assert named == rotor


def test_the_estimated_unbalance_is_that_of_the_table(shaking: Unbalance) -> None:
    flown = fly(51, "F3/SV1", 2, seconds=6.0)
    levels = [found.level[found.valid] for found in shaking.over(flown)]
    assert float(np.concatenate(levels).mean()) == pytest.approx(3.77, rel=0.15)  # T Table 3.2; own unbalance adds
