"""A payload taken up and dropped in flight: momentum by conservation laws, trim by paper, continuity by the markers."""

import math

import numpy as np
import pytest
from plant_cases import fly, nominal_airframe, quaternion_rotation, quiet_airframe

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import Payload, PickUp
from sitl_plant.physics.parameters import body_with_payload, initial_state, make_model, reload
from sitl_plant.physics.trajectory import Shape, path
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import qdrone2

BESIDE = Payload(0.2, (0.012, -0.016, 0.05))  # 200 g, 20 mm beside the centre
G = 9.81


def test_two_payloads_are_point_masses_about_the_common_centre() -> None:
    """Sum over the parts, each by the parallel-axis theorem: another way than one after the other."""
    airframe = nominal_airframe(qdrone2())
    parts = [(1.504, np.zeros(3)), (0.1, np.array([0.03, -0.02, 0.06])), (0.2, np.array(BESIDE.position_m))]
    payloads = [Payload(mass, (float(at[0]), float(at[1]), float(at[2]))) for mass, at in parts[1:]]
    body, centre = body_with_payload(airframe, *payloads)
    total = sum(mass for mass, _ in parts)
    expected = sum((mass * at for mass, at in parts), np.zeros(3)) / total
    inertia = np.diag(airframe.inertia_kg_m2)
    for mass, at in parts:
        r = at - expected
        inertia = inertia + mass * (r @ r * np.eye(3) - np.outer(r, r))
    assert body.mass == pytest.approx(total)
    np.testing.assert_allclose(centre, expected, atol=1e-15)
    np.testing.assert_allclose(body.inertia, inertia, atol=1e-15)
    np.testing.assert_allclose(body.inverse @ inertia, np.eye(3), atol=1e-12)


def in_motion() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Momentum (3,) and angular momentum (3,) about the world's origin, of vehicle and payload, before and after."""
    airframe = nominal_airframe(qdrone2())
    model = make_model(airframe, Payload(), path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3))
    state = initial_state(model, np.zeros(4))
    x, rng = state.rigid, np.random.default_rng(5)
    x[:3], x[3:6], x[10:13] = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    x[6:10] = rng.normal(size=4)
    x[6:10] /= np.linalg.norm(x[6:10])
    R = quaternion_rotation(x[6:10])
    place = x[:3] + R @ np.array(BESIDE.position_m)
    speed = x[3:6] + R @ np.cross(x[10:13], BESIDE.position_m)

    def of_vehicle(body_inertia: FloatArray, mass: float) -> tuple[FloatArray, FloatArray]:
        p = mass * x[3:6]
        return p, np.cross(x[:3], p) + R @ body_inertia @ x[10:13]

    p1, L1 = of_vehicle(model.body.inertia, model.body.mass)
    p1, L1 = p1 + BESIDE.mass_kg * speed, L1 + np.cross(place, BESIDE.mass_kg * speed)
    after = reload(model, state, airframe, (Payload(), BESIDE))
    p2, L2 = of_vehicle(after.body.inertia, after.body.mass)
    return p1, L1, p2, L2


def test_momentum_and_angular_momentum_are_kept() -> None:
    p1, L1, p2, L2 = in_motion()
    np.testing.assert_allclose(p2, p1, atol=1e-12)
    np.testing.assert_allclose(L2, L1, atol=1e-12)


def test_dropping_undoes_a_pick_up_at_own_speed() -> None:
    airframe = nominal_airframe(qdrone2())
    model = make_model(airframe, Payload(), path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3))
    state = initial_state(model, np.zeros(4))
    state.rigid[3:6], state.rigid[10:13] = (0.3, -0.2, 0.1), (1.0, -2.0, 0.5)
    rigid, wrench = state.rigid.copy(), state.wrench.copy()
    loaded = reload(model, state, airframe, (Payload(), BESIDE))
    again = reload(loaded, state, airframe, (Payload(),))
    np.testing.assert_allclose(state.rigid, rigid, atol=1e-14)
    np.testing.assert_allclose(state.wrench, wrench, atol=1e-14)
    np.testing.assert_allclose(again.rotors.hub, model.rotors.hub, atol=1e-15)
    np.testing.assert_allclose(again.body.inertia, model.body.inertia, atol=1e-15)


def test_hover_carries_the_payload_while_it_hangs_and_trims_its_offset() -> None:
    """K_F sum w^2 = m g, and the moments about the new centre vanish: rotors near the payload turn faster."""
    pickup = PickUp(Payload(0.2, (0.0, 0.02, 0.05)), 10.0, 40.0)
    samples = fly(PlantConfig(trajectory="hover", airframe=quiet_airframe(), pickup=pickup), 70.0)
    thrust = 3.364e-6 * samples.rotor_speed**2
    for at_s, mass in ((9.5, 1.504), (38.0, 1.704), (69.0, 1.504)):
        assert thrust[round(at_s * 1000)].sum() == pytest.approx(mass * G, rel=0.003)
    right, left = thrust[38_000, :2].sum(), thrust[38_000, 2:].sum()
    assert right - left == pytest.approx(0.2 * G * 0.02 / 0.127, rel=0.03)
    assert np.abs(samples.position[60_000:, :2]).max() < 0.02


def test_the_markers_do_not_jump_and_the_imu_feels_no_impact() -> None:
    pickup = PickUp(BESIDE, 2.0)
    samples = fly(PlantConfig(trajectory="circle", airframe=quiet_airframe(), pickup=pickup), 2.1)
    step = samples.position[2000] - samples.position[1999] - 0.001 * samples.velocity[1999]
    shift = 0.2 / 1.704 * np.array(BESIDE.position_m)
    np.testing.assert_allclose(step, quaternion_rotation(samples.quaternion[2000]) @ shift, atol=2e-5)
    assert np.abs(np.diff(samples.gyro[1990:2010], axis=0)).max() < 0.01


@pytest.mark.parametrize("cuts", [(3000,), (1000, 1, 999, 1000), (7, 993, 1000, 500, 500)])
def test_how_the_flight_is_cut_changes_nothing(cuts: tuple[int, ...]) -> None:
    pickup = PickUp(BESIDE, 1.0, 2.0)
    config = PlantConfig(pickup=pickup, turbulence_m_s=8.0, outages_per_min=20.0, seed=4)
    plant = Plant(config)
    found = np.concatenate([plant.advance(n).gyro for n in cuts])
    np.testing.assert_array_equal(found, fly(config, 3.0).gyro)


@pytest.mark.parametrize(("at_s", "drop_s"), [(0.0, 5.0), (5.0, 5.0), (math.inf, math.inf)])
def test_impossible_pick_ups_are_refused(at_s: float, drop_s: float) -> None:
    with pytest.raises(UsageError, match="pick-up must be after the start"):
        PickUp(BESIDE, at_s, drop_s)
