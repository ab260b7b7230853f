"""Attitude estimate and controllers: closed forms, directions, limits."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from plant_cases import nominal_airframe

from mavdiag.telemetry import FloatArray
from sitl_plant.physics.airframe import NO_PAYLOAD
from sitl_plant.physics.control import Controller, ControlState, control
from sitl_plant.physics.parameters import make_model
from sitl_plant.physics.trajectory import DISARMED, FLYING, IDLE, LANDING, SHUTDOWN, Shape, path
from sitl_plant.vehicle import qdrone2

WEIGHT = 1.504 * 9.81


@cache
def gains() -> Controller:
    airframe = nominal_airframe(qdrone2())
    return make_model(airframe, NO_PAYLOAD, path(Shape.HOVER, 1.0, 0.5, 0.0, 1.0), np.zeros(3)).controller


def fresh() -> ControlState:
    z = np.zeros
    return ControlState(np.array([0.0, 0.0, -WEIGHT, 0.0]), z(3), z(3), z(4), z(4), z(1), z(4), z(3), z(4))


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
    state = fresh()
    reference = np.array([0.3, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, motors])
    pose = np.array([0.0, 0.0, -height, 0.0])
    control(state, gains(), reference, pose, np.zeros(3), 0.0, np.zeros(9), None, 15.0, 0.001)
    assert state.motors[0] == armed
    if duty is not None:
        np.testing.assert_array_equal(state.duty, duty)
        np.testing.assert_array_equal(state.integral, fresh().integral)
        assert state.wrench[0] == pytest.approx(forces(state.duty).sum())
