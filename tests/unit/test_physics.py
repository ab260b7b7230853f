"""Body, ground, rotors, cameras and gusts against closed forms, scipy and published spectra."""

import math
from functools import cache
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_cases import nominal_airframe, quaternion_rotation
from scipy.signal import bilinear, butter, freqz, welch
from scipy.spatial.transform import Rotation

from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.physics.air import Turbulence, dryden
from sitl_plant.physics.airframe import NO_PAYLOAD, drone
from sitl_plant.physics.control import Controller, ControlState, control
from sitl_plant.physics.dynamics import GRAVITY, NO_GROUND, RIGID, STAGES, WRENCH, Body, Ground, grip, rk4_step
from sitl_plant.physics.faults import Injection, RotorDamage, SensorFault, rotor_condition, sensor_condition
from sitl_plant.physics.kernel import Model
from sitl_plant.physics.mocap import fit_pose
from sitl_plant.physics.parameters import STEP_S, make_model
from sitl_plant.physics.rotors import Condition, RotorState, advance_rotors
from sitl_plant.physics.sensors import CHANNELS, Imu, ImuState, advance_imu, butterworth, feel, gain_of, mode
from sitl_plant.physics.trajectory import (
    DISARMED,
    FLYING,
    IDLE,
    LANDING,
    REFERENCE,
    SHUTDOWN,
    Nose,
    Path,
    Shape,
    path,
    reference,
)
from sitl_plant.vehicle import allocation, qdrone2

K_F, HOVER = 3.364e-6, 1047.2
G_MM = 1e-6
MARKERS = np.array(qdrone2().mocap.markers_m)
ALL: IntArray = np.ones(len(MARKERS), dtype=np.int64)
GUST_STEP_S = 0.02
MODEL = dryden(5.0, 1.0)
WEIGHT = 1.504 * 9.81
DT = 0.001
STUCK, GONE = RotorDamage(unbalance_g_mm=1.0), RotorDamage(0.0, 0.0, ejected=True)
RECORDED = [shape for shape in Shape if shape.recorded]
LIMITS = {1: (2.0, 3.14), 2: (0.333, 0.52)}  # DronePropA: SP1, SP2


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


def make() -> tuple[Model, Condition]:
    airframe = nominal_airframe(qdrone2())
    model = make_model(airframe, NO_PAYLOAD, path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3))
    return model, rotor_condition(airframe, (), STEP_S)


def rest(speed: float = 0.0) -> RotorState:
    thrust, turn = np.full(4, K_F * speed**2), np.tile([1.0, 0.0], (4, 1))
    return RotorState(np.full(4, speed), np.zeros(4), turn, np.zeros(4), np.zeros(4), thrust)


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
    wrench, expected = step(state, model, condition, speed), allocation(qdrone2())[:, rotor] * K_F * HOVER**2
    np.testing.assert_allclose([-wrench[0, 2], *wrench[0, 3:6]], expected, atol=1e-12)


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


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("noise_m", [0.0, 0.00015, 0.01])
def test_fit_is_the_least_squares_fit_of_scipy(seed: int, noise_m: float) -> None:
    rng = np.random.default_rng(seed)
    turn, where = Rotation.from_quat(rng.standard_normal(4)), rng.uniform(-3, 3, 3)
    seen, visible = turn.apply(MARKERS) + where + noise_m * rng.standard_normal(MARKERS.shape), ALL.copy()
    if seed % 2:
        visible[rng.integers(len(visible))] = 0
    fit = np.zeros(RIGID)
    assert fit_pose(MARKERS, seen, visible, fit, np.zeros((9, 4)))
    kept = visible.astype(bool)
    middle, centre = MARKERS[kept].mean(axis=0), seen[kept].mean(axis=0)
    rotation, _ = Rotation.align_vectors(seen[kept] - centre, MARKERS[kept] - middle)
    np.testing.assert_allclose(quaternion_rotation(fit[6:10]), rotation.as_matrix(), atol=1e-7)
    np.testing.assert_allclose(fit[:3], centre - rotation.apply(middle), atol=1e-7)


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


# Attitude estimate and controllers: closed forms, directions, limits
@cache
def gains() -> Controller:
    airframe = nominal_airframe(qdrone2())
    return make_model(airframe, NO_PAYLOAD, path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3)).controller


def fresh() -> ControlState:
    z = np.zeros
    return ControlState(np.array([0.0, 0.0, -WEIGHT, 0.0]), z(3), z(3), z(4), z(4), z(1))


def ask(
    state: ControlState,
    *,
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    target_yaw: float = 0.0,
    estimate: tuple[float, ...] = (0.0,) * 9,
    steps: int = 1,
    motors: float = FLYING,
) -> FloatArray:
    reference = np.array([*target, 0.0, 0.0, 0.0, target_yaw, 0.0, motors])
    for _ in range(steps):
        pose = np.array([0.0, 0.0, 0.0, yaw])
        control(state, gains(), reference, pose, np.zeros(3), estimate[5], np.array(estimate), None, 15.0, 0.001)
    return state.duty


def forces(duty: FloatArray) -> FloatArray:
    """Thrust of each rotor at nominal voltage: K_F (K_omega duty)^2, T Eq 2.12."""
    full_speed = 1300 * 2 * math.pi / 60 * 14.8
    return np.asarray(3.364e-6 * (full_speed * duty) ** 2)


@pytest.mark.parametrize(
    ("asked", "more", "less"),
    [
        ({"target": (0.2, 0.0, 0.0)}, [0, 2], [1, 3]),  # ahead: the rear rotors push more (T Eq 2.3, 2.27)
        ({"target": (0.0, 0.2, 0.0)}, [2, 3], [0, 1]),  # to the right: the left ones (T Eq 2.2, 2.26)
        ({"target_yaw": 0.5}, [1, 2], [0, 3]),  # turned right: those whose drag turns the body clockwise
    ],
)
def test_the_rotors_that_lead_to_the_target_push_more(asked: dict[str, Any], more: list[int], less: list[int]) -> None:
    f = forces(ask(fresh(), **asked))
    assert f[more].min() > f[less].max()
    assert f.sum() == pytest.approx(WEIGHT, rel=1e-3)


def test_cascade_is_the_product_of_its_gains() -> None:
    """T Eq 2.36 and 2.40: tau = I (22 (8 (phi_ref - phi) - 0.05 p - p) - 0.08 dp/dt)."""
    state = fresh()
    ask(state, estimate=(0.02, 0.0, 0.0, 0.1, 0.0, 0.0, 3.0, 0.0, 0.0))
    expected = 0.0112 * (22 * (8 * (0.0 - 0.02) - 0.05 * 0.1 - 0.1) - 0.08 * 3.0)
    assert state.wrench[1] == pytest.approx(expected, rel=1e-9)


def test_limits_and_anti_windup_hold() -> None:
    """A target far away for a minute: commands stay limited, and the integrals let go at once."""
    state, limits = fresh(), qdrone2().control
    duty = ask(state, target=(50.0, -50.0, -50.0), target_yaw=3.0, steps=60_000)
    assert np.all(np.abs(state.setpoint[:2]) <= limits.tilt_limit_rad)
    assert np.all(np.abs(state.rate[:2]) <= limits.rate_limit_rad_s)
    assert abs(state.rate[2]) <= limits.yaw_rate_limit_rad_s
    assert state.wrench[0] <= limits.thrust_limit_n[1]
    assert np.all((duty >= qdrone2().propulsion.minimum_duty) & (duty <= 1.0))
    assert np.all(np.abs(state.integral[:2]) <= limits.integral_limit_rad)


@pytest.mark.parametrize(
    ("motors", "height", "armed", "duty"),
    [
        (DISARMED, 0.0, 0, 0.0),
        (IDLE, 0.0, 1, 0.08),
        (LANDING, 0.0, 1, 0.08),
        (SHUTDOWN, 0.0, 0, 0.0),
        (LANDING, 0.5, 2, None),
    ],
)
def test_motors_are_off_or_idle_on_the_ground_and_the_integrals_wait(
    motors: float, height: float, armed: int, duty: float | None
) -> None:
    """A vehicle that is led to land keeps flying until it stands."""
    state, reference = fresh(), np.array([0.3, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, motors])
    pose = np.array([0.0, 0.0, -height, 0.0])
    control(state, gains(), reference, pose, np.zeros(3), 0.0, np.zeros(9), None, 15.0, 0.001)
    assert state.motors[0] == armed
    if duty is not None:
        np.testing.assert_array_equal(state.duty, duty)
        np.testing.assert_array_equal(state.integral, fresh().integral)
        assert state.wrench[0] == pytest.approx(forces(state.duty).sum())


# The IMUs against kinematics, scipy and the sampling theorem; their mount; the two of the recordings
@pytest.mark.parametrize("corner_hz", [5.0, 80.0, 250.0, 480.0, 700.0])
@pytest.mark.parametrize("kind", ["lowpass", "highpass"])
def test_the_filters_are_those_of_scipy(corner_hz: float, kind: Literal["lowpass", "highpass"]) -> None:
    expected = butter(2, min(corner_hz * 0.001, 0.499), kind, fs=1.0, output="sos")[0, [0, 1, 2, 4, 5]]
    np.testing.assert_allclose(butterworth(corner_hz, 0.001, kind), expected, rtol=1e-12, atol=1e-14)


def test_lever_arm_is_the_acceleration_of_a_point_on_the_body() -> None:
    """Oracle: a body at rest in the middle that nods as theta(t) = A sin w t; its point is differentiated twice."""
    amplitude, w, t, h = 0.4, 7.0, 0.3, 1e-4
    r = np.array([0.01, 0.005, -0.02])

    def pitch(at: float) -> float:
        return amplitude * math.sin(w * at)

    def place(at: float) -> FloatArray:
        c, s = math.cos(pitch(at)), math.sin(pitch(at))
        return np.array([c * r[0] + s * r[2], r[1], -s * r[0] + c * r[2]])  # R_y(theta) r, world NED

    acceleration = (place(t + h) - 2 * place(t) + place(t - h)) / h**2
    c, s = math.cos(pitch(t)), math.sin(pitch(t))
    in_body = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ (acceleration - [0, 0, GRAVITY])

    x, dx, truth = np.zeros(RIGID), np.zeros((1, RIGID)), np.empty(6)
    x[6], x[8] = math.cos(pitch(t) / 2), math.sin(pitch(t) / 2)
    x[11] = amplitude * w * math.cos(w * t)
    dx[0, 11] = -amplitude * w**2 * math.sin(w * t)
    feel(x, dx, r, truth)
    np.testing.assert_allclose(truth[3:], in_body, atol=1e-5)
    np.testing.assert_allclose(truth[:3], [0.0, x[11], 0.0])


def test_sensor_faults_act_as_written() -> None:
    """reading = scale truth + offset + drift t, once the filter has settled; the other axes are untouched."""
    faults = (
        Injection(SensorFault("gyro", 1, scale=2.0, offset=0.1, drift_per_s=0.5)),
        Injection(SensorFault("accel", 2, scale=0.5)),
    )
    truth = np.array([0.3, 0.3, 0.3, 1.0, 1.0, 1.0])
    z, still = np.zeros, np.zeros((1000, CHANNELS))
    sensor = Imu(z(3), z(CHANNELS), z(CHANNELS), butterworth(250.0, 0.001))
    state = ImuState(z((CHANNELS, 2)), z(CHANNELS), z(CHANNELS), z((CHANNELS, 2)))
    for row in range(1000):
        advance_imu(state, sensor, sensor_condition(faults), truth, still, row, 0.001)
    assert state.reading[1] == pytest.approx(2 * 0.3 + 0.1 + 0.5, abs=0.002)
    np.testing.assert_allclose(state.reading[[0, 2, 3, 4, 5]], [0.3, 0.3, 1.0, 1.0, 0.5], atol=1e-9)


@pytest.mark.parametrize(("hz", "damping"), [(25.0, 0.1), (50.0, 0.1), (165.0, 0.05), (300.0, 1.2)])
def test_the_filter_is_the_bilinear_transform_of_a_driven_mode(hz: float, damping: float) -> None:
    warped = 2 / DT * math.tan(math.pi * hz * DT)
    b, a = bilinear([2 * damping * warped, warped**2], [1, 2 * damping * warped, warped**2], 1 / DT)
    b0, b1, b2, a1, a2 = mode(hz, damping, DT)
    np.testing.assert_allclose([b0, b1, b2], b, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose([1.0, a1, a2], a, rtol=1e-9)
    _, (still, line) = freqz(b, a, [0.0, hz], fs=1 / DT)
    assert abs(still) == pytest.approx(1.0)  # slow motion passes
    assert abs(line) == pytest.approx(math.sqrt(1 + 1 / (2 * damping) ** 2))  # Den Hartog, Mechanical Vibrations, 2.12
    assert gain_of(mode(hz, damping, DT), hz, DT) == pytest.approx(abs(line))


# T's nine faults, and injections: what each does to the tables of the compiled loop, and to a flight
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
    assert Injection(STUCK, onset_s=step / 1000).first_step(STEP_S) == step
    assert Injection(STUCK, onset_s=step * 0.001).first_step(STEP_S) == step


# Paths: closed, smooth where they should be, flown at the speed asked for; where the recorded ones go
def at(p: Path, t: float) -> FloatArray:
    out = np.empty(REFERENCE)
    reference(p, t, out)
    return out


@given(
    st.sampled_from([Shape.SQUARE, Shape.CIRCLE]),
    st.floats(0.5, 5.0),
    st.floats(0.1, 3.0),
    st.floats(-3.0, 3.0),
    st.floats(0.0, 60.0),
)
def test_speed_along_the_path_is_constant(shape: Shape, size: float, speed: float, heading: float, t: float) -> None:
    assert np.linalg.norm(at(path(shape, size, speed, heading, 1.0), t)[3:6]) == pytest.approx(speed)


@pytest.mark.parametrize("nose", list(Nose))
@pytest.mark.parametrize("shape", list(Shape))
def test_yaw_rate_is_the_slope_of_yaw_which_stays_within_pi(shape: Shape, nose: Nose) -> None:
    p, h = path(shape, 1.0, 0.5, 2.0, 1.0, nose), 1e-5
    for t in np.linspace(0.0137, 19.0, 301):
        before, here, after = at(p, t - h), at(p, t), at(p, t + h)
        slope = (after[6] - before[6] + math.pi) % (2 * math.pi) - math.pi
        assert slope / (2 * h) == pytest.approx(here[7], abs=1e-3)
        assert -math.pi <= here[6] < math.pi


def flown(shape: Shape, seconds: float = 60.0, dt: float = 0.01, takeoff: bool = False) -> FloatArray:
    one, out = path(shape, 1.0, 0.5, 0.0, 1.0, takeoff=takeoff), np.empty((round(seconds / dt), REFERENCE))
    for row in range(len(out)):
        reference(one, row * dt, out[row])
    return out


@pytest.mark.parametrize("shape", RECORDED)
def test_the_limiter_holds_and_rates_are_slopes(shape: Shape) -> None:
    assert shape.recorded is not None
    speed, turn = LIMITS[shape.recorded[1]]
    rows = flown(shape)
    slope, nose = np.diff(rows[:, :3], axis=0) / 0.01, np.diff(np.unwrap(rows[:, 6])) / 0.01
    assert np.linalg.norm(slope, axis=1).max() <= speed * (1 + 1e-6)
    assert np.abs(nose).max() <= turn * (1 + 1e-6)
    steady = np.all(rows[1:, 3:6] == rows[:-1, 3:6], axis=1) & (rows[1:, 7] == rows[:-1, 7])
    np.testing.assert_allclose(slope[steady], rows[:-1][steady, 3:6], atol=1e-9)
    np.testing.assert_allclose(nose[steady], rows[:-1][steady, 7], atol=1e-9)
    assert np.all(rows[:, 8] == FLYING)
