"""Rotors against closed forms: the motor's exponential, thrust, turning forces, noise statistics."""

import math

import numpy as np
import pytest
from plant_cases import nominal_airframe

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import NO_PAYLOAD
from sitl_plant.physics.dynamics import STAGES, WRENCH
from sitl_plant.physics.faults import rotor_condition
from sitl_plant.physics.kernel import Model
from sitl_plant.physics.parameters import STEP_S, make_model
from sitl_plant.physics.rotors import Condition, RotorState, advance_rotors
from sitl_plant.physics.trajectory import Shape, path
from sitl_plant.vehicle import allocation, qdrone2

K_F, RATIO, HOVER = 3.364e-6, 68.9055, 1047.2
G_MM = 1e-6


def make() -> tuple[Model, Condition]:
    airframe = nominal_airframe(qdrone2())
    model = make_model(airframe, NO_PAYLOAD, path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3))
    return model, rotor_condition(airframe, (), STEP_S)


def rest(speed: float = 0.0) -> RotorState:
    thrust = np.full(4, K_F * speed**2)
    return RotorState(np.full(4, speed), np.zeros(4), np.zeros(4), np.zeros(4), thrust)


def step(state: RotorState, model: Model, condition: Condition, command: FloatArray, dt: float = STEP_S) -> FloatArray:
    wrench = np.empty((STAGES, WRENCH))
    advance_rotors(state, model.rotors, condition, command, dt, wrench)
    return wrench


def test_speed_step_is_the_motor_exponential() -> None:
    model, condition = make()
    state, lag = rest(), 0.025
    for _ in range(50):
        step(state, model, condition, np.full(4, HOVER))
    t = 0.050
    np.testing.assert_allclose(state.speed, HOVER * (1 - math.exp(-t / lag)), rtol=1e-12)
    turned = HOVER * (t - lag * (1 - math.exp(-t / lag)))
    np.testing.assert_allclose(state.azimuth, turned % (2 * math.pi), atol=1e-9)


@pytest.mark.parametrize("rotor", range(4))
def test_wrench_of_one_rotor_is_its_column_of_the_allocation(rotor: int) -> None:
    """The mapping matrix of T Eq 2.7, made from the vehicle file, is what the rotors really do."""
    model, condition = make()
    speed = np.zeros(4)
    speed[rotor] = HOVER
    state = rest()
    state.speed[:] = speed
    state.thrust[:] = K_F * speed**2
    wrench = step(state, model, condition, speed)
    expected = allocation(qdrone2())[:, rotor] * K_F * HOVER**2
    np.testing.assert_allclose([-wrench[0, 2], *wrench[0, 3:6]], expected, atol=1e-12)


def test_unbalance_turns_with_the_rotor_at_full_amplitude() -> None:
    """|f| = U w^2 in the rotor plane, clockwise for rotors 1 and 4, and its moment is hub × f."""
    model, condition = make()
    condition.unbalance[0] = 5.0 * G_MM, 0.0
    state, angles = rest(HOVER), []
    for _ in range(40):
        wrench = step(state, model, condition, np.full(4, HOVER))
        f = np.array([wrench[2, 0], wrench[2, 1], 0.0])
        assert np.linalg.norm(f) == pytest.approx(5e-6 * HOVER**2, rel=1e-9)
        hub = np.array([-0.1016, 0.127, -0.025])
        np.testing.assert_allclose(wrench[2, 3:6], np.cross(hub, f), atol=1e-9)
        angles.append(math.atan2(f[1], f[0]))
    turns = np.diff(np.unwrap(angles))
    np.testing.assert_allclose(turns, HOVER * STEP_S, rtol=1e-9)  # positive about z: clockwise seen from above


def test_lift_and_mass_torques_oppose_each_other() -> None:
    """T Eq 5.3-5.9 and Fig 5.11: at every azimuth the two torques of an edge cut point in opposite directions."""
    model, healthy = make()
    _, unbalanced = make()
    _, shifted = make()
    unbalanced.unbalance[1] = 3.0 * G_MM, 1.0 * G_MM
    shifted.lift_offset[1] = 0.003, 0.001
    states = [rest(HOVER) for _ in range(3)]
    for _ in range(20):
        still, mass, lift = (
            step(state, model, condition, np.full(4, HOVER))[2, 3:5]
            for state, condition in zip(states, (healthy, unbalanced, shifted), strict=True)
        )
        mass_torque, lift_torque = mass - still, lift - still
        cosine = mass_torque @ lift_torque / np.linalg.norm(mass_torque) / np.linalg.norm(lift_torque)
        assert cosine == pytest.approx(-1.0, abs=1e-6)
