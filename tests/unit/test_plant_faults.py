"""T's nine faults, and injections: what each does to the tables of the compiled loop, and to a flight."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_cases import fly, quiet_airframe

from mavdiag.errors import UsageError
from sitl_plant.physics.airframe import drone
from sitl_plant.physics.faults import FAULTS, Injection, RotorDamage, SensorFault, parse_fault, rotor_condition
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.rotors import Condition
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

# T Table 3.2: removed masses [g] and distances [mm] as its own sums write them, and the printed result [g mm].
PRINTED = {
    "F1/SV1": ([(0.035, 40)], 1.400),
    "F1/SV2": ([(0.085, 60)], 5.100),
    "F1/SV3": ([(0.048, 65), (0.048, 50)], 5.520),
    "F2/SV1": ([(0.004, 55)], 0.220),
    "F2/SV2": ([(0.025, 40), (0.025, 70)], 2.750),
    "F2/SV3": ([(0.018, 70), (0.018, 55), (0.018, 40)], 2.640),
    "F3/SV1": ([(0.058, 65)], 3.770),
    "F3/SV2": ([(0.034, 65), (0.034, 50)], 3.910),
    "F3/SV3": ([(0.033, 65), (0.033, 50), (0.033, 35)], 4.950),
}


@pytest.mark.parametrize("code", PRINTED)
def test_unbalance_is_what_the_thesis_prints(code: str) -> None:
    parts, printed = PRINTED[code]
    assert parse_fault(code).propeller.printed_g_mm == pytest.approx(printed)
    if code != "F2/SV3":  # the slip: its sum gives 2.970
        assert sum(mass * distance for mass, distance in parts) == pytest.approx(printed, abs=1e-9)
    else:
        assert sum(mass * distance for mass, distance in parts) == pytest.approx(2.970)


@given(st.text(max_size=12))
def test_other_text_is_refused_in_one_line(text: str) -> None:
    message = "F2/SV2"
    try:
        assert parse_fault(text) in FAULTS
    except UsageError as error:
        message = str(error)
    assert "F2/SV2" in message
    assert "\n" not in message


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


@given(st.integers(1, 10_000_000))
def test_onset_at_a_millisecond_is_that_step(step: int) -> None:
    """However 0.001 s rounds in binary, the fault is there at its step: neither lost nor late."""
    assert Injection(STUCK, onset_s=step / 1000).span(STEP_S)[0] == step
    assert Injection(STUCK, onset_s=step * 0.001).span(STEP_S)[0] == step


def test_lost_propeller_ends_the_flight() -> None:
    config = PlantConfig(
        trajectory="hover", airframe=quiet_airframe(), altitude_m=20.0, injections=(Injection(GONE, 1, 0.5),)
    )
    samples = fly(config, 1.5)
    assert np.abs(samples.gyro[:500]).max() < 0.01
    assert samples.velocity[-1, 2] > 2.0  # falling
    assert np.abs(samples.gyro[-1]).max() > 2.0  # and tumbling towards the lost corner
    assert np.isfinite(samples.gyro).all()


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
