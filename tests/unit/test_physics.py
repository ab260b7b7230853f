"""Body, ground, rotors, cameras and gusts against closed forms, scipy and published spectra."""

import math

import numpy as np
import pytest
from plant_cases import fly, nominal_airframe, quaternion_rotation, quiet_airframe
from scipy.signal import welch

from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.physics.air import Turbulence, dryden
from sitl_plant.physics.airframe import NO_PAYLOAD
from sitl_plant.physics.dynamics import (
    GRAVITY,
    NO_GROUND,
    RIGID,
    STAGES,
    WRENCH,
    Body,
    Ground,
    grip,
    rk4_step,
)
from sitl_plant.physics.faults import rotor_condition
from sitl_plant.physics.kernel import Model
from sitl_plant.physics.mocap import fit_pose
from sitl_plant.physics.parameters import STEP_S, make_model
from sitl_plant.physics.rotors import Condition, RotorState, advance_rotors
from sitl_plant.physics.trajectory import Shape, path
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import allocation, qdrone2


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


K_F, HOVER = 3.364e-6, 1047.2
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


MARKERS = np.array(qdrone2().mocap.markers_m)
ALL: IntArray = np.ones(len(MARKERS), dtype=np.int64)


def scipy_fit(model: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    from scipy.spatial.transform import Rotation

    rotation, _ = Rotation.align_vectors(seen - seen.mean(axis=0), model - model.mean(axis=0))
    return np.asarray(rotation.as_matrix()), seen.mean(axis=0) - rotation.apply(model.mean(axis=0))


def as_matrix(q: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.roll(q, -1)).as_matrix())


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("noise_m", [0.0, 0.00015, 0.01])
def test_fit_is_the_least_squares_fit_of_scipy(seed: int, noise_m: float) -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    turn, where = Rotation.from_quat(rng.standard_normal(4)), rng.uniform(-3, 3, 3)
    seen = turn.apply(MARKERS) + where + noise_m * rng.standard_normal(MARKERS.shape)
    visible = ALL.copy()
    if seed % 2:
        visible[rng.integers(len(visible))] = 0
    fit = np.zeros(RIGID)
    assert fit_pose(MARKERS, seen, visible, fit)
    kept = visible.astype(bool)
    R, t = scipy_fit(MARKERS[kept], seen[kept])
    np.testing.assert_allclose(as_matrix(fit[6:10]), R, atol=1e-7)
    np.testing.assert_allclose(fit[:3], t, atol=1e-7)


GUST_STEP_S = 0.02
MODEL = dryden(5.0, 1.0)


@pytest.fixture(scope="module")
def gusts() -> FloatArray:
    """Three hours, with the wind to the north: u, v, w."""
    return Turbulence(MODEL, 0.0, GUST_STEP_S, np.random.default_rng(3)).draw(round(3 * 3600 / GUST_STEP_S))


def published(omega: FloatArray, axis: int) -> FloatArray:
    """MIL-F-8785C 3.7.1.2, over angular frequency, one-sided [(m/s)^2 / (rad/s)]."""
    rms, T = MODEL.rms_m_s[axis], MODEL.passing_s[axis]
    x = (T * omega) ** 2
    if axis == 0:
        return np.asarray(rms**2 * 2 * T / math.pi / (1 + x))
    return np.asarray(rms**2 * T / math.pi * (1 + 3 * x) / (1 + x) ** 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_spectra_are_those_published(gusts: FloatArray, axis: int) -> None:
    hz, density = welch(gusts[:, axis], 1 / GUST_STEP_S, nperseg=8192)
    for low in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2):
        band = (hz >= low) & (hz < 2 * low)
        expected = 2 * math.pi * published(2 * math.pi * hz[band], axis)
        assert density[band].mean() == pytest.approx(expected.mean(), rel=0.1), low


@pytest.mark.parametrize("w20", [5.0, 8.0])
def test_a_vehicle_in_turbulence_holds_its_place_and_feels_the_drag_of_the_gusts(w20: float) -> None:
    """At rest on average, the specific force of the horizontal axes is drag / mass = 0.25 u / 1.504."""
    config = PlantConfig(trajectory="hover", airframe=quiet_airframe(), turbulence_m_s=w20, seed=4)
    samples = fly(config, 120.0)
    assert np.abs(samples.position[:, :2]).max() < 0.3
    felt = samples.accel[:, :2].std()
    assert felt == pytest.approx(0.25 / 1.504 * dryden(w20, 1.0).rms_m_s[0], rel=0.3)
