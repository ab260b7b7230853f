"""The rigid body against mechanics that does not need a simulation."""

import math

import numpy as np
import pytest
from plant_cases import quaternion_rotation

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.dynamics import (
    GRAVITY,
    NO_GROUND,
    RIGID,
    STAGES,
    WRENCH,
    Body,
    Ground,
    derivative,
    grip,
    rk4_step,
)


def body(inertia: FloatArray, mass: float = 1.5, drag: float = 0.0, hub_moment: float = 0.0) -> Body:
    return Body(mass, inertia, np.linalg.inv(inertia).astype(np.float64), drag, hub_moment)


def state(omega: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloatArray:
    x = np.zeros(RIGID)
    x[6] = 1.0
    x[10:] = omega
    return x


def run(
    x: FloatArray, b: Body, wrench: FloatArray, seconds: float, dt: float = 0.001, ground: Ground = NO_GROUND
) -> FloatArray:
    work = np.empty((5, RIGID))
    for _ in range(round(seconds / dt)):
        rk4_step(x, wrench, b, ground, np.zeros(3), work, dt)
        grip(x, ground)
    return x


@pytest.mark.parametrize("rotor_momentum", [0.0, 0.05])
def test_free_tumbling_keeps_angular_momentum_and_energy(rotor_momentum: float) -> None:
    """Rotors of constant momentum h add to the momentum and, being gyroscopic, do no work."""
    inertia = np.array([[0.0112, 0.0004, 0.0], [0.0004, 0.0104, -0.0003], [0.0, -0.0003, 0.0182]])
    wrench = np.zeros((STAGES, WRENCH))
    wrench[:, 6] = rotor_momentum
    x = state((3.0, -4.0, 2.0))

    def momentum() -> FloatArray:
        return quaternion_rotation(x[6:10]) @ (inertia @ x[10:] + [0.0, 0.0, rotor_momentum])

    def energy() -> float:
        return float(x[10:] @ inertia @ x[10:])

    before, energy_before = momentum(), energy()
    run(x, body(inertia), wrench, 5.0)
    np.testing.assert_allclose(momentum(), before, rtol=1e-8)
    assert energy() == pytest.approx(energy_before, rel=1e-9)


def precession(t: float, transverse: float, axial: float, omega: tuple[float, float, float]) -> FloatArray:
    """Torque-free axisymmetric body: the transverse rate turns at (Iz - I) / I of the axial rate (Goldstein, 5.6)."""
    angle = (axial - transverse) / transverse * omega[2] * t
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * omega[0] - s * omega[1], s * omega[0] + c * omega[1], omega[2]])


def test_integration_is_of_fourth_order() -> None:
    omega = (2.0, -1.0, 20.0)
    b, wrench = body(np.diag([0.011, 0.011, 0.018])), np.zeros((STAGES, WRENCH))
    exact = precession(1.0, 0.011, 0.018, omega)
    errors = [np.linalg.norm(run(state(omega), b, wrench, 1.0, dt)[10:] - exact) for dt in (0.02, 0.01, 0.005)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 3.8), orders
    assert np.all(orders < 4.3), orders


BOX = body(np.diag([0.0112, 0.0104, 0.0182]))
REST = np.zeros((STAGES, WRENCH))


def ground(friction: float = 0.5, damping: float = 50.0) -> Ground:
    """Four feet, 0.1 m below the centre and 0.1 m beside it, on springs that give way by 1 mm under the weight."""
    feet = np.array([[x, y, 0.1] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    return Ground(feet, np.zeros((4, 2)), 0.1, -0.1, 1.5 * GRAVITY / 4 / 1e-3, damping, friction)


def test_ground_carries_the_weight_at_the_depth_that_the_springs_ask_for() -> None:
    x = run(state(), BOX, REST, 3.0, ground=ground())
    np.testing.assert_allclose(x[:3], [0.0, 0.0, 1e-3], atol=1e-9)
    np.testing.assert_allclose(x[[3, 4, 5, 10, 11, 12]], 0.0, atol=1e-9)


@pytest.mark.parametrize("push", [(3.0, 0.0), (0.0, -6.0)])
def test_friction_holds_below_its_limit_without_creeping(push: tuple[float, float]) -> None:
    """mu m g = 7.4 N: after the feet have given way the vehicle stays where it is."""
    wrench = REST.copy()
    wrench[:, :2] = push
    plane = ground()
    x = run(state(), BOX, wrench, 1.0, ground=plane)
    settled = x[:3].copy()
    run(x, BOX, wrench, 10.0, ground=plane)
    np.testing.assert_allclose(x[:3], settled, atol=1e-9)


def test_the_ground_never_pulls() -> None:
    x, dx = state(), np.empty((1, RIGID))
    x[2], x[5] = 0.5e-3, -2.0  # still below the plane, leaving fast
    derivative(x, REST, 0, BOX, NO_GROUND, np.zeros(3), dx, 0)
    before = dx.copy()
    derivative(x, REST, 0, BOX, ground(), np.zeros(3), dx, 0)
    np.testing.assert_array_equal(dx, before)
