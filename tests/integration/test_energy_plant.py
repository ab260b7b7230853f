"""The monitors on the emulated vehicle: an unsteady rotor and an unbalanced one are found and named from healthy
flights of the same airframe alone."""

import numpy as np
import pytest

from mavdiag.airframe.layout import layout_named
from mavdiag.chain import Front
from mavdiag.learning import gate_for, rows_of
from mavdiag.monitors.base import Rows
from mavdiag.monitors.rotor_signature import RotorSignature, RotorSignatureSpec
from mavdiag.monitors.rotor_signature import fit as fit_energy
from mavdiag.monitors.unbalance import Unbalance, UnbalanceSpec
from mavdiag.monitors.unbalance import fit as fit_vibration
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.rates import RateSpec
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

FRONT = Front(AlignSpec(0.001, Grid.NATIVE), gate_for("qdrone2"), RateSpec.of(0.001, 101))
FRAME = layout_named("qdrone2")


def fly(seed: int, fault: str | None = None, rotor: int = 1, seconds: float = 16.0) -> list[Rows]:
    config = PlantConfig(drone=1, seed=seed, fault=fault, rotor=rotor, wind_m_s=0.5)
    return list(rows_of(FRONT, flight_telemetry(config, seconds)[0]))


@pytest.fixture(scope="module")
def healthy() -> list[list[Rows]]:
    return [fly(seed) for seed in (11, 12)]


@pytest.fixture(scope="module")
def moving(healthy: list[list[Rows]]) -> RotorSignatureSpec:
    return fit_energy(healthy, FRAME)


@pytest.fixture(scope="module")
def shaking(healthy: list[list[Rows]]) -> UnbalanceSpec:
    return fit_vibration(healthy, FRAME, (1.504, 1047.2))


def peak(monitor: RotorSignature | Unbalance, rows: list[Rows]) -> tuple[float, int]:
    """Highest statistic, and the rotor that the evidence of the whole flight points at."""
    state, best, evidence = monitor.start(), 0.0, np.zeros(4)
    for one in rows:
        state, reading = monitor.step(state, one)  # type: ignore[arg-type]  # each monitor with its own state
        best = max(best, float(reading.statistic.max(where=reading.valid, initial=0.0)))
        evidence += reading.rotors[reading.valid].sum(axis=0)
    return best, int(evidence.argmax()) + 1


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_crack_that_hardly_shakes_is_seen_in_the_energy(
    moving: RotorSignatureSpec, shaking: UnbalanceSpec, rotor: int
) -> None:
    cracked = fly(20 + rotor, "F2/SV1", rotor)
    calm, _ = peak(RotorSignature(moving), fly(30))
    found, named = peak(RotorSignature(moving), cracked)
    assert found > 2.5 * calm
    assert named == rotor
    assert peak(Unbalance(shaking), cracked)[0] < 1.0


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_an_edge_cut_is_seen_and_placed_by_its_vibration(shaking: UnbalanceSpec, rotor: int) -> None:
    calm, _ = peak(Unbalance(shaking), fly(31))
    found, named = peak(Unbalance(shaking), fly(40 + rotor, "F1/SV1", rotor, seconds=6.0))
    assert calm < 0.8
    assert found > 1.0
    assert named == rotor


def test_the_estimated_unbalance_is_that_of_the_table(shaking: UnbalanceSpec) -> None:
    monitor, levels = Unbalance(shaking), []
    state = monitor.start()
    for one in fly(51, "F3/SV1", 2, seconds=6.0):
        state, reading = monitor.step(state, one)
        levels.append(reading.level[reading.valid])
    assert float(np.concatenate(levels).mean()) == pytest.approx(3.77, rel=0.15)  # T Table 3.2; own unbalance adds
