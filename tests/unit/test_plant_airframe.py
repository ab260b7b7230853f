"""One specimen: sessions, propellers, wear; a payload taken up and dropped in flight."""

import numpy as np
import pytest
from plant_cases import fly, nominal_airframe, quaternion_rotation
from scipy.stats import kstest, uniform

from mavdiag.errors import UsageError
from mavdiag.telemetry import FloatArray
from sitl_plant.physics.air import dryden
from sitl_plant.physics.airframe import NO_PAYLOAD, Payload, drone, in_session_number, with_propellers
from sitl_plant.physics.kernel import Streams
from sitl_plant.physics.parameters import body_with_payload, initial_state, make_model, reload
from sitl_plant.physics.trajectory import Shape, path
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import qdrone2

DRONE = drone(qdrone2(), 2)


@pytest.mark.parametrize("spread", [0.01, 0.03])
def test_a_new_set_of_propellers_differs_uniformly_and_is_balanced_as_permitted(spread: float) -> None:
    rng = np.random.default_rng(1)
    sets = [with_propellers(DRONE, spread, rng) for _ in range(300)]
    ratio = np.array([one.thrust_coefficient_n_s2 / DRONE.thrust_coefficient_n_s2 for one in sets]).ravel()
    assert kstest(ratio, uniform(1 - spread, 2 * spread).cdf).pvalue > 0.01
    size = np.array([np.hypot(*one.unbalance_g_mm.T) for one in sets]).ravel()
    assert kstest(size, uniform(0.0, 0.18).cdf).pvalue > 0.01
    assert (sets[0].battery_gain, sets[0].centre_of_gravity_m[0]) == (DRONE.battery_gain, DRONE.centre_of_gravity_m[0])


def test_a_session_is_drawn_by_its_number_and_the_airframe() -> None:
    first, same, other = (in_session_number(DRONE, number) for number in (1, 1, 2))
    assert in_session_number(DRONE, 0) is DRONE
    assert first.gyro_bias.tolist() == same.gyro_bias.tolist() != other.gyro_bias.tolist()
    assert in_session_number(drone(qdrone2(), 3), 1).charge_used_ah != first.charge_used_ah
    assert first.thrust_coefficient_n_s2.tolist() == DRONE.thrust_coefficient_n_s2.tolist()
    assert in_session_number(DRONE, 1, 0.01).thrust_coefficient_n_s2.tolist() != first.thrust_coefficient_n_s2.tolist()
    with pytest.raises(UsageError, match="session must be zero or more"):
        in_session_number(DRONE, -1)


@pytest.mark.parametrize("seed", range(8))
def test_a_vehicle_without_cameras_stays_in_its_hall(seed: int) -> None:
    """It coasts level at up to 0.5 m/s for up to 2 s, and comes back: no fly-away, no fall."""
    samples = fly(PlantConfig(drone=1 + seed % 3, seed=100 + seed, outages_per_min=3.0), 40.0)
    assert np.abs(samples.position[:, :2] - 0.5).max() < 3.0
    assert samples.position[:, 2].max() < -0.5
    assert np.abs(samples.position[:, 2]).max() < 2.0


def test_what_is_asked_for_changes_no_other_stream() -> None:
    """Rotors, IMU, markers and the wind that is left out: the same numbers with turbulence and outages as without."""
    model = make_model(DRONE, NO_PAYLOAD, path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3))
    plain, full = Streams(7, 0.001), Streams(7, 0.001, (dryden(5.0, 1.0), 0.0), 20.0)
    assert plain.angle.random() == full.angle.random()
    hidden = 0
    for first, count in ((-10, 10), (0, 7), (7, 20_000)):
        one, other = plain.draw(first, count, model), full.draw(first, count, model)
        for name in ("rotors", "imu", "markers"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        seen = other.occlusion >= 0.0
        np.testing.assert_array_equal(one.occlusion[seen], other.occlusion[seen])
        hidden += int((~seen).sum())
    assert hidden > 0


BESIDE = Payload(0.2, (0.012, -0.016, 0.05))  # 200 g, 20 mm beside the centre


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
