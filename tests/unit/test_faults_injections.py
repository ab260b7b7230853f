"""Injections: what each does to the tables of the compiled loop, and to a flight."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_cases import fly, quiet_airframe

from mavdiag.errors import UsageError
from sitl_plant.physics.airframe import drone
from sitl_plant.physics.faults import Injection, RotorDamage, SensorFault, rotor_condition
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.rotors import Condition
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import qdrone2

STUCK, GONE = RotorDamage(unbalance_g_mm=1.0), RotorDamage(0.0, 0.0, ejected=True)


def condition(damage: RotorDamage, angle: float = 0.5, rotor: int = 2) -> Condition:
    return rotor_condition(drone(qdrone2(), 1), (Injection(damage, rotor, angle_rad=angle),), STEP_S)


def test_unbalance_adds_as_a_vector_to_the_rotors_own() -> None:
    own = drone(qdrone2(), 1).unbalance_g_mm[1]
    expected = own + 5.1 * np.array([math.cos(0.5), math.sin(0.5)])
    np.testing.assert_allclose(condition(RotorDamage(unbalance_g_mm=5.1)).unbalance[1], expected * 1e-6)
    np.testing.assert_allclose(
        condition(RotorDamage(unbalance_g_mm=5.1)).unbalance[0] * 1e6, drone(qdrone2(), 1).unbalance_g_mm[0]
    )


def test_each_cause_changes_what_it_is_about() -> None:
    chip = condition(RotorDamage(0.97, 1.02, 0.5))
    assert (chip.thrust_gain[1], chip.drag_gain[1]) == (0.97, 1.02)
    assert np.hypot(*chip.lift_offset[1]) == pytest.approx(0.03 * 0.062)
    bent = condition(RotorDamage(0.95, 1.1))
    np.testing.assert_allclose(bent.unbalance, condition(RotorDamage()).unbalance)
    assert np.hypot(*bent.lift_offset[1]) > 0
    assert condition(RotorDamage(speed_factor=0.95)).speed_gain[1] == 0.95
    gone = condition(GONE)
    assert (gone.thrust_gain[1], gone.drag_gain[1]) == (0.0, 0.0)
    np.testing.assert_array_equal(gone.unbalance[1], 0.0)
    np.testing.assert_array_equal(gone.thrust_gain[[0, 2, 3]], 1.0)


def test_injection_is_present_from_onset_to_end() -> None:
    assert Injection(STUCK, onset_s=2.0, end_s=3.0).span(STEP_S) == (2000, 3000)
    first, end = Injection(STUCK).span(STEP_S)
    assert first < -1_000_000  # from the start means before the start, too
    assert end > 1_000_000_000


@given(st.integers(1, 10_000_000))
def test_onset_at_a_millisecond_is_that_step(step: int) -> None:
    """However 0.001 s rounds in binary, the fault is there at its step: neither lost nor late."""
    assert Injection(STUCK, onset_s=step / 1000).span(STEP_S)[0] == step
    assert Injection(STUCK, onset_s=step * 0.001).span(STEP_S)[0] == step


def test_several_damages_combine() -> None:
    both = rotor_condition(
        drone(qdrone2(), 2),
        (
            Injection(RotorDamage(0.9, 1.1)),
            Injection(RotorDamage(thrust_factor=0.5, fluctuation_rms=0.03, fluctuation_corner_hz=6)),
        ),
        STEP_S,
    )
    assert both.thrust_gain[0] == pytest.approx(0.45)
    assert both.fluctuation_rms[0] == pytest.approx(0.03)
    assert both.fluctuation_decay[0] == pytest.approx(math.exp(-2 * math.pi * 6 * STEP_S))


def test_lost_propeller_ends_the_flight() -> None:
    config = PlantConfig(
        trajectory="hover", airframe=quiet_airframe(), altitude_m=20.0, injections=(Injection(GONE, 1, 0.5),)
    )
    samples = fly(config, 1.5)
    assert np.abs(samples.gyro[:500]).max() < 0.01
    assert samples.velocity[-1, 2] > 2.0  # falling
    assert np.abs(samples.gyro[-1]).max() > 2.0  # and tumbling towards the lost corner
    assert np.isfinite(samples.gyro).all()


def test_gyro_offset_is_seen_between_its_onset_and_end() -> None:
    fault = Injection(SensorFault("gyro", 2, offset=0.2), onset_s=0.3, end_s=0.4)
    samples = fly(PlantConfig(trajectory="hover", airframe=quiet_airframe(), injections=(fault,)), 0.6)
    error = samples.gyro[:, 2] - samples.omega[:, 2]
    np.testing.assert_allclose(error[:300], 0.0, atol=0.005)
    assert error[310:400].mean() == pytest.approx(0.2, abs=0.01)
    np.testing.assert_allclose(error[410:], 0.0, atol=0.01)


def test_direction_is_drawn_from_the_seed_unless_given() -> None:
    def line(seed: int, angle: float | None) -> float:
        config = PlantConfig(
            trajectory="hover",
            seed=seed,
            airframe=quiet_airframe(),
            injections=(Injection(RotorDamage(unbalance_g_mm=5.0), angle_rad=angle),),
        )
        return float(Plant(config).advance(10).accel[5, 0])

    assert line(1, None) == line(1, None)
    assert line(1, None) != line(2, None)


@pytest.mark.parametrize(
    "make",
    [
        lambda: SensorFault("magnetometer", 0),
        lambda: SensorFault("gyro", 3),
        lambda: RotorDamage(thrust_factor=-1.0),
        lambda: RotorDamage(drag_factor=math.nan),
        lambda: RotorDamage(fluctuation_rms=0.1, fluctuation_corner_hz=0.0),
    ],
)
def test_meaningless_causes_are_refused(make: object) -> None:
    assert callable(make)
    with pytest.raises(UsageError):
        make()
