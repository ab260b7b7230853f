"""Rigid body with spinning rotors: the equations of motion and their integration by RK4.

Frames: world NED, body FRD with its origin at the centre of gravity. The state is one row of 13 numbers:

    x = [ position_N (3) | velocity_N (3) | q_NB w x y z (4) | omega_B (3) ]

Rotors enter as a *wrench row*, known at the three times that an RK4 step looks at (start, middle, end):

    [ force_B (3) | moment_B (3) | h | dh/dt ]       h = sum of J sign_i w_i: the rotors' angular momentum about body z

The ground is a plane that pushes each point of the landing gear by a spring and a damper (our model, no source):

    N = max(0, k d + c v_d)                       d: depth of the point below the plane; the ground never pulls
    F = -(k s + c v),  |F| <= mu N                s: horizontal way from where the point stuck; beyond mu N it slides
"""

import math
from typing import NamedTuple

import numpy as np

from mavdiag.jit import inline, jit
from mavdiag.telemetry import FloatArray

GRAVITY = 9.81  # m/s^2, as the hover speed of T 3.2.2 and K_F assume
RIGID, WRENCH, STAGES = 13, 8, 3  # lengths of a state row and of a wrench row; start, middle and end of a step


@jit
def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    turned = angle + math.pi
    if 0.0 <= turned < 2.0 * math.pi:  # as the remainder below has it, without its division
        return turned - math.pi
    return turned % (2.0 * math.pi) - math.pi


class Body(NamedTuple):
    """Constants of the rigid body. inertia: (3, 3) about the centre of gravity [kg m^2]; inverse: of it."""

    mass: float
    inertia: FloatArray
    inverse: FloatArray
    drag: float
    hub_moment: float


@jit
def rotate_to_body(state: FloatArray, v_x: float, v_y: float, v_z: float) -> tuple[float, float, float]:
    """A world vector in body axes: v_B = R(q)^T v_N, with q of unit length from the state row."""
    return _rotated(-state[6], state, v_x, v_y, v_z)


@jit
def rotate_to_world(state: FloatArray, v_x: float, v_y: float, v_z: float) -> tuple[float, float, float]:
    """A body vector in world axes: v_N = R(q) v_B, with q of unit length from the state row."""
    return _rotated(state[6], state, v_x, v_y, v_z)


@jit
def _rotated(w: float, state: FloatArray, v_x: float, v_y: float, v_z: float) -> tuple[float, float, float]:
    x, y, z = state[7], state[8], state[9]
    return (
        (1 - 2 * (y * y + z * z)) * v_x + 2 * (x * y - w * z) * v_y + 2 * (x * z + w * y) * v_z,
        2 * (x * y + w * z) * v_x + (1 - 2 * (x * x + z * z)) * v_y + 2 * (y * z - w * x) * v_z,
        2 * (x * z - w * y) * v_x + 2 * (y * z + w * x) * v_y + (1 - 2 * (x * x + y * y)) * v_z,
    )


class Ground(NamedTuple):
    """Landing gear and the plane below it; stiffness [N/m] and damping [N s/m] are those of one point."""

    gear: FloatArray  # (m, 3) points of the landing gear from the centre of gravity, body FRD [m]
    stuck: FloatArray  # (m, 2) where each point sticks, world north and east [m]; changed by `grip`
    level: float  # z of the plane in the world [m]
    reach: float  # a vehicle with z above this may touch the ground [m]; infinite without a ground
    stiffness: float
    damping: float
    friction: float


NO_GROUND = Ground(np.zeros((0, 3)), np.zeros((0, 2)), np.inf, np.inf, 0.0, 0.0, 0.0)


@jit
def _push(x: FloatArray, ground: Ground, i: int) -> tuple[float, float, float, float, float, float]:
    """Force of the ground on gear point i, world NED [N]; then where the point is, and how hard it sticks."""
    a, b, c = ground.gear[i]
    r_x, r_y, r_z = rotate_to_world(x, a, b, c)
    north, east, depth = x[0] + r_x, x[1] + r_y, x[2] + r_z - ground.level
    p, q, r = x[10], x[11], x[12]
    v_x, v_y, v_z = rotate_to_world(x, q * c - r * b, r * a - p * c, p * b - q * a)
    normal = max(0.0, ground.stiffness * depth + ground.damping * (x[5] + v_z)) if depth > 0.0 else 0.0
    f_x = -ground.stiffness * (north - ground.stuck[i, 0]) - ground.damping * (x[3] + v_x)
    f_y = -ground.stiffness * (east - ground.stuck[i, 1]) - ground.damping * (x[4] + v_y)
    asked = np.sqrt(f_x * f_x + f_y * f_y)
    share = min(1.0, ground.friction * normal / asked) if asked > 0.0 else 1.0
    return share * f_x, share * f_y, -normal, north, east, share


@jit
def grip(x: FloatArray, ground: Ground) -> None:
    """After a step: let the points that slid or left the ground stick where they can hold."""
    if x[2] > ground.reach:
        for i in range(len(ground.gear)):
            f_x, f_y, f_z, north, east, share = _push(x, ground, i)
            if f_z == 0.0:
                ground.stuck[i, 0], ground.stuck[i, 1] = north, east
            elif share < 1.0:
                ground.stuck[i, 0], ground.stuck[i, 1] = north + f_x / ground.stiffness, east + f_y / ground.stiffness


@jit
def _stand(x: FloatArray, body: Body, ground: Ground, dx: FloatArray, row: int) -> None:
    m_x = m_y = m_z = 0.0
    for i in range(len(ground.gear)):
        f_x, f_y, f_z, _, _, _ = _push(x, ground, i)
        dx[row, 3] += f_x / body.mass
        dx[row, 4] += f_y / body.mass
        dx[row, 5] += f_z / body.mass
        b_x, b_y, b_z = rotate_to_body(x, f_x, f_y, f_z)
        a, b, c = ground.gear[i]
        m_x += b * b_z - c * b_y
        m_y += c * b_x - a * b_z
        m_z += a * b_y - b * b_x
    for axis in range(3):
        dx[row, 10 + axis] += _along(body.inverse, axis, m_x, m_y, m_z)


@jit
def _along(matrix: FloatArray, axis: int, x: float, y: float, z: float) -> float:
    return float(matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z)


@inline
def derivative(
    x: FloatArray, wrench: FloatArray, stage: int, body: Body, ground: Ground, wind: FloatArray, dx: FloatArray, at: int
) -> None:
    """Write dx/dt under wrench[stage] into dx[at]. wind: (3,) world NED [m/s].

    m dv/dt     = R (force + drag) + m g
    I domega/dt = moment + hub - omega × (I omega + h e_z) - dh/dt e_z
    hub         = k e_z × v_air                    the discs tilt away from the oncoming air: nose up when flying ahead
    """
    q_w, q_x, q_y, q_z, p, q, r = x[6], x[7], x[8], x[9], x[10], x[11], x[12]
    u, v, w = rotate_to_body(x, x[3] - wind[0], x[4] - wind[1], x[5] - wind[2])
    a_x, a_y, a_z = rotate_to_world(
        x,
        (wrench[stage, 0] - body.drag * u) / body.mass,
        (wrench[stage, 1] - body.drag * v) / body.mass,
        (wrench[stage, 2] - body.drag * w) / body.mass,
    )
    h_x, h_y, h_z = _along(body.inertia, 0, p, q, r), _along(body.inertia, 1, p, q, r), _along(body.inertia, 2, p, q, r)
    h_z += wrench[stage, 6]
    m_x = wrench[stage, 3] - body.hub_moment * v - (q * h_z - r * h_y)
    m_y = wrench[stage, 4] + body.hub_moment * u - (r * h_x - p * h_z)
    m_z = wrench[stage, 5] - (p * h_y - q * h_x) - wrench[stage, 7]
    dx[at, 0], dx[at, 1], dx[at, 2] = x[3], x[4], x[5]
    dx[at, 3], dx[at, 4], dx[at, 5] = a_x, a_y, a_z + GRAVITY
    dx[at, 6] = 0.5 * (-q_x * p - q_y * q - q_z * r)  # dq/dt = q * (0, omega) / 2
    dx[at, 7] = 0.5 * (q_w * p + q_y * r - q_z * q)
    dx[at, 8] = 0.5 * (q_w * q + q_z * p - q_x * r)
    dx[at, 9] = 0.5 * (q_w * r + q_x * q - q_y * p)
    for axis in range(3):
        dx[at, 10 + axis] = _along(body.inverse, axis, m_x, m_y, m_z)
    if x[2] > ground.reach:
        _stand(x, body, ground, dx, at)


@jit
def rk4_step(
    x: FloatArray, wrench: FloatArray, body: Body, ground: Ground, wind: FloatArray, work: FloatArray, dt: float
) -> None:
    """Advance `x` in place by dt with the classical Runge-Kutta scheme, then restore |q| = 1.

    wrench: (3, 8) at start, middle and end. work: (5, 13) scratch for the four slopes and the point.
    """
    y = work[4]
    for i in range(RIGID):
        y[i] = x[i]
    for k in range(4):
        derivative(y, wrench, (k + 1) // 2, body, ground, wind, work, k)
        span = dt if k == 2 else 0.5 * dt
        if k < 3:
            for i in range(RIGID):
                y[i] = x[i] + span * work[k, i]
    for i in range(RIGID):
        x[i] += dt / 6.0 * (work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i])
    norm = np.sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9])
    for i in range(6, 10):
        x[i] /= norm
