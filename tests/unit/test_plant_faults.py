"""T's nine faults, and injections: what each does to the tables of the compiled loop, and to a flight."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.errors import UsageError
from sitl_plant.physics.airframe import drone
from sitl_plant.physics.faults import FAULTS, Injection, RotorDamage, parse_fault, rotor_condition
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.rotors import Condition
from sitl_plant.vehicle import qdrone2


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
