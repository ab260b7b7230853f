"""Motion capture: cameras see markers, a rigid body is fitted to them, the pose arrives late (T 2.2).

The fit is T Eq 2.21, min over R, t of sum |q_i - (R p_i + t)|^2, solved by Horn's quaternion method: the best rotation
is the eigenvector of the largest eigenvalue of a symmetric 4 × 4 matrix, found by Newton's method from above, and from
the adjugate (D. Theobald, Acta Cryst. A61 (2005) 478-480).
"""

import math
from typing import NamedTuple

import numpy as np

from mavdiag.jit import jit
from mavdiag.telemetry import FloatArray, IntArray
from sitl_plant.physics.dynamics import rotate_to_world

NEWTON_STEPS = 30
EPSILON = 1e-12
LOST_FRAMES = 25  # without a pose for longer, the vehicle holds where it was seen last (our choice; 0.1 s)


class Mocap(NamedTuple):
    """Constants. period, latency: in steps of the plant. velocity_gain: 1 - exp(-2 pi f frame_s)."""

    markers: FloatArray  # (m, 3) from the geometric centre
    centre: FloatArray  # (3,) geometric centre from the centre of gravity
    noise: float  # rms per marker and axis [m]
    occlusion: float
    period: int
    latency: int
    frame_s: float  # between two frames
    velocity_gain: float


class MocapState(NamedTuple):
    """A pose is position_N of the geometric centre and yaw."""

    queue: FloatArray  # (latency + 1, 4) poses under way, nan where there is none
    pose: FloatArray  # (4,) as last received
    velocity: FloatArray  # (3,)
    received: FloatArray  # (1,) the step at which it came; nan before the first
    seen: FloatArray  # (m, 3) markers of the latest frame
    visible: IntArray  # (m,) 1 or 0
    fit: FloatArray  # (13,) state row fitted to them, rates zero
    work: FloatArray  # (9, 4) scratch of `fit_pose`


@jit
def fit_pose(model: FloatArray, seen: FloatArray, visible: IntArray, fit: FloatArray, work: FloatArray) -> bool:
    """Fit position and attitude to the visible markers (T Eq 2.21). False, and nothing written, below three.

    model, seen: (m, 3) in body and world axes. fit: (13,) a state row; position of the model's origin and q_NB are set.
    work: (9, 4) scratch.
    """
    count = 0
    for i in range(len(model)):
        count += visible[i]
    if count < 3:
        return False
    p_mean, q_mean, S, K = work[0], work[1], work[2:5], work[5:]  # K: Horn's, which q_NB maximises as q^T K q
    for row in range(5):
        for a in range(3):
            work[row, a] = 0.0
    for i in range(len(model)):
        for a in range(3):
            p_mean[a] += visible[i] * model[i, a] / count
            q_mean[a] += visible[i] * seen[i, a] / count
    bound = 0.0  # no eigenvalue is larger: (sum |p|^2 + sum |q|^2) / 2
    for i in range(len(model)):
        for a in range(3):
            p_a, q_a = visible[i] * (model[i, a] - p_mean[a]), visible[i] * (seen[i, a] - q_mean[a])
            bound += 0.5 * (p_a * p_a + q_a * q_a)
            for b in range(3):
                S[a, b] += p_a * (seen[i, b] - q_mean[b])
    K[0, 0] = S[0, 0] + S[1, 1] + S[2, 2]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        K[0, a + 1] = K[a + 1, 0] = S[b, c] - S[c, b]
        K[a + 1, a + 1] = S[a, a] - S[b, b] - S[c, c]
        K[b + 1, c + 1] = K[c + 1, b + 1] = S[b, c] + S[c, b]
    squares = 0.0
    for a in range(3):
        for b in range(3):
            squares += S[a, b] * S[a, b]
    det = (
        S[0, 0] * (S[1, 1] * S[2, 2] - S[1, 2] * S[2, 1])
        - S[0, 1] * (S[1, 0] * S[2, 2] - S[1, 2] * S[2, 0])
        + S[0, 2] * (S[1, 0] * S[2, 1] - S[1, 1] * S[2, 0])
    )
    _leading_eigenvector(K, -2.0 * squares, -8.0 * det, bound, fit[6:10])
    turned = rotate_to_world(fit, p_mean[0], p_mean[1], p_mean[2])
    for a in range(3):
        fit[a] = q_mean[a] - turned[a]
    return True


@jit
def _leading_eigenvector(K: FloatArray, c2: float, c1: float, bound: float, q: FloatArray) -> None:
    # of the characteristic polynomial L^4 + c2 L^2 + c1 L + det K, from above
    c0 = 0.0
    for a in range(4):
        c0 += K[0, a] * _cofactor(K, 0, a)
    top = bound
    for _ in range(NEWTON_STEPS):
        step = (((top * top + c2) * top + c1) * top + c0) / ((4.0 * top * top + 2.0 * c2) * top + c1)
        top -= step
        if abs(step) < EPSILON * top:
            break
    for a in range(4):
        K[a, a] -= top
    column, largest = 0, -1.0
    for k in range(4):  # the adjugate is a multiple of q q^T: its longest column has the largest number on the diagonal
        size = abs(_cofactor(K, k, k))
        if size > largest:
            column, largest = k, size
    w, x, y, z = _cofactor(K, 0, column), _cofactor(K, 1, column), _cofactor(K, 2, column), _cofactor(K, 3, column)
    length, sign = math.sqrt(w * w + x * x + y * y + z * z), 1.0 if w >= 0.0 else -1.0
    q[0], q[1], q[2], q[3] = sign * w / length, sign * x / length, sign * y / length, sign * z / length


@jit
def _cofactor(M: FloatArray, row: int, column: int) -> float:
    i, j, k = (row + 1) & 3, (row + 2) & 3, (row + 3) & 3  # modulo 4
    a, b, c = (column + 1) & 3, (column + 2) & 3, (column + 3) & 3
    # The cyclic order of three indices is an even permutation of the sorted one, so the minor keeps its sign.
    minor = (
        M[i, a] * (M[j, b] * M[k, c] - M[j, c] * M[k, b])
        - M[i, b] * (M[j, a] * M[k, c] - M[j, c] * M[k, a])
        + M[i, c] * (M[j, a] * M[k, b] - M[j, b] * M[k, a])
    )
    return float(-minor if (row + column) & 1 else minor)


@jit
def observe(
    state: MocapState, mocap: Mocap, x: FloatArray, step: int, normals: FloatArray, uniforms: FloatArray, frame: int
) -> None:
    """Take a frame of the vehicle with state row x and put its pose under way.

    normals: (frames, m, 3) and uniforms: (frames, m), of which row `frame` is used.
    """
    for i in range(len(mocap.markers)):
        r = mocap.markers[i]
        place = rotate_to_world(x, r[0] + mocap.centre[0], r[1] + mocap.centre[1], r[2] + mocap.centre[2])
        for a in range(3):
            state.seen[i, a] = x[a] + place[a] + mocap.noise * normals[frame, i, a]
        state.visible[i] = 1 if uniforms[frame, i] >= mocap.occlusion else 0
    if fit_pose(mocap.markers, state.seen, state.visible, state.fit, state.work):
        slot = state.queue[(step + mocap.latency) % (mocap.latency + 1)]
        w, x_q, y_q, z_q = state.fit[6], state.fit[7], state.fit[8], state.fit[9]
        yaw = math.atan2(2.0 * (w * z_q + x_q * y_q), 1.0 - 2.0 * (y_q * y_q + z_q * z_q))
        slot[0], slot[1], slot[2], slot[3] = state.fit[0], state.fit[1], state.fit[2], yaw


@jit
def deliver_pose(state: MocapState, mocap: Mocap, step: int) -> None:
    """Receive the pose that is due at this step, if any, and differentiate it over the time since the last one."""
    slot = state.queue[step % (mocap.latency + 1)]
    if np.isnan(slot[0]):
        return
    elapsed = mocap.frame_s
    if not np.isnan(state.received[0]):
        elapsed *= (step - state.received[0]) / mocap.period
    state.received[0] = step
    for a in range(3):
        rate = (slot[a] - state.pose[a]) / elapsed
        state.velocity[a] += mocap.velocity_gain * (rate - state.velocity[a])
        state.pose[a] = slot[a]
    state.pose[3] = slot[3]
    slot[0] = np.nan


@jit
def hold_if_lost(state: MocapState, mocap: Mocap, step: int, reference: FloatArray) -> None:
    """Without a pose for long, ask for the last one: the vehicle coasts level instead of chasing its path blindly.

    reference: (9,) = position_N, velocity_N, yaw, yaw rate, motors; changed in place.
    """
    if step - state.received[0] <= LOST_FRAMES * mocap.period or np.isnan(state.received[0]):
        return
    for a in range(3):
        reference[a] = state.pose[a]
        reference[3 + a] = state.velocity[a]
    reference[6], reference[7] = state.pose[3], 0.0
