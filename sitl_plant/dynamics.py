"""Rigid body with spinning rotors: the equations of motion and their integration by RK4.

Frames: world NED, body FRD with its origin at the centre of gravity. The state is one row of 13 numbers:

    x = [ position_N (3) | velocity_N (3) | q_NB w x y z (4) | omega_B (3) ]

Rotors enter as a *wrench row*, known at the three times that an RK4 step looks at (start, middle, end):

    [ force_B (3) | moment_B (3) | h | dh/dt ]       h = sum of J_i sign_i w_i, angular momentum of the rotors about body z

All functions are compiled and write into arrays that the caller owns.
"""

from typing import NamedTuple

import numpy as np

from mavdiag.quantities import FloatArray
from sitl_plant.jit import jit

__all__ = [
    "GRAVITY",
    "RIGID",
    "STAGES",
    "WRENCH",
    "Body",
    "derivative",
    "rk4_step",
    "rotate_to_body",
    "rotate_to_world",
]

GRAVITY = 9.81  # m/s^2, as the hover speed of T 3.2.2 and K_F assume
RIGID = 13  # length of the state row
WRENCH = 8  # length of a wrench row
STAGES = 3  # start, middle and end of a step


class Body(NamedTuple):
    """Constants of the rigid body. inertia and inverse: (3, 3) about the centre of gravity [kg m^2], and [1/(kg m^2)]."""

    mass: float
    inertia: FloatArray
    inverse: FloatArray
    drag: float
    hub_moment: float


@jit
def rotate_to_body(q: FloatArray, v_x: float, v_y: float, v_z: float) -> tuple[float, float, float]:
    """A world vector in body axes: v_B = R(q)^T v_N, q = q_NB (w, x, y, z) of unit length."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        (1 - 2 * (y * y + z * z)) * v_x + 2 * (x * y + w * z) * v_y + 2 * (x * z - w * y) * v_z,
        2 * (x * y - w * z) * v_x + (1 - 2 * (x * x + z * z)) * v_y + 2 * (y * z + w * x) * v_z,
        2 * (x * z + w * y) * v_x + 2 * (y * z - w * x) * v_y + (1 - 2 * (x * x + y * y)) * v_z,
    )


@jit
def rotate_to_world(q: FloatArray, v_x: float, v_y: float, v_z: float) -> tuple[float, float, float]:
    """A body vector in world axes: v_N = R(q) v_B."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        (1 - 2 * (y * y + z * z)) * v_x + 2 * (x * y - w * z) * v_y + 2 * (x * z + w * y) * v_z,
        2 * (x * y + w * z) * v_x + (1 - 2 * (x * x + z * z)) * v_y + 2 * (y * z - w * x) * v_z,
        2 * (x * z - w * y) * v_x + 2 * (y * z + w * x) * v_y + (1 - 2 * (x * x + y * y)) * v_z,
    )


@jit
def derivative(x: FloatArray, wrench: FloatArray, body: Body, wind: FloatArray, dx: FloatArray) -> None:
    """Write dx/dt into `dx`. wind: (3,) world NED [m/s].

    m dv/dt     = R (force + drag) + m g
    I domega/dt = moment + hub - omega × (I omega + h e_z) - dh/dt e_z
    hub         = k e_z × v_air                    the disc tilts away from the oncoming air: nose up when flying ahead
    """
    q = x[6:10]
    p, r_y, r_z = x[10], x[11], x[12]
    u, v, w = rotate_to_body(q, x[3] - wind[0], x[4] - wind[1], x[5] - wind[2])
    f_x, f_y, f_z = wrench[0] - body.drag * u, wrench[1] - body.drag * v, wrench[2] - body.drag * w
    a_x, a_y, a_z = rotate_to_world(q, f_x, f_y, f_z)

    dx[0], dx[1], dx[2] = x[3], x[4], x[5]
    dx[3], dx[4], dx[5] = a_x / body.mass, a_y / body.mass, a_z / body.mass + GRAVITY
    # dq/dt = q * (0, omega) / 2
    dx[6] = 0.5 * (-q[1] * p - q[2] * r_y - q[3] * r_z)
    dx[7] = 0.5 * (q[0] * p + q[2] * r_z - q[3] * r_y)
    dx[8] = 0.5 * (q[0] * r_y + q[3] * p - q[1] * r_z)
    dx[9] = 0.5 * (q[0] * r_z + q[1] * r_y - q[2] * p)

    inertia = body.inertia
    h_x = inertia[0, 0] * p + inertia[0, 1] * r_y + inertia[0, 2] * r_z
    h_y = inertia[1, 0] * p + inertia[1, 1] * r_y + inertia[1, 2] * r_z
    h_z = inertia[2, 0] * p + inertia[2, 1] * r_y + inertia[2, 2] * r_z + wrench[6]
    m_x = wrench[3] - body.hub_moment * v - (r_y * h_z - r_z * h_y)
    m_y = wrench[4] + body.hub_moment * u - (r_z * h_x - p * h_z)
    m_z = wrench[5] - (p * h_y - r_y * h_x) - wrench[7]
    for row in range(3):
        dx[10 + row] = body.inverse[row, 0] * m_x + body.inverse[row, 1] * m_y + body.inverse[row, 2] * m_z


@jit
def rk4_step(x: FloatArray, wrench: FloatArray, body: Body, wind: FloatArray, work: FloatArray, dt: float) -> None:
    """Advance `x` in place by dt with the classical Runge-Kutta scheme, then restore |q| = 1.

    wrench: (3, 8) at start, middle and end. work: (5, 13) scratch.
    """
    k1, k2, k3, k4, y = work[0], work[1], work[2], work[3], work[4]
    derivative(x, wrench[0], body, wind, k1)
    for i in range(RIGID):
        y[i] = x[i] + 0.5 * dt * k1[i]
    derivative(y, wrench[1], body, wind, k2)
    for i in range(RIGID):
        y[i] = x[i] + 0.5 * dt * k2[i]
    derivative(y, wrench[1], body, wind, k3)
    for i in range(RIGID):
        y[i] = x[i] + dt * k3[i]
    derivative(y, wrench[2], body, wind, k4)
    for i in range(RIGID):
        x[i] += dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    norm = np.sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9])
    for i in range(6, 10):
        x[i] /= norm
