"""From aligned rows to the pair that the model relates: commanded body rate u and measured body rate y (T 4.3.4).

The set-point is an attitude in Euler angles, the gyro measures body rates. Savitzky-Golay filters of one window and
order give the value and the slope of the angles at the centre of the window, and W(phi, theta) turns the slopes into
body rates (the kinematics of the order yaw, pitch, roll):

    p = dphi - sin(theta) dpsi
    q = cos(phi) dtheta + sin(phi) cos(theta) dpsi
    r = -sin(phi) dtheta + cos(phi) cos(theta) dpsi

The gyro is smoothed by the same window, so u and y have the same delay of m samples. Output row i belongs to input row
i + m; a new segment starts the filters afresh.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.rows.block import Block
from mavdiag.rows.savgol import SavgolFilter, SavgolState
from mavdiag.rows.windows import window_all
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = ["RateBlock", "RateSpec", "RateState"]


@dataclass(frozen=True, slots=True, eq=False)
class RateBlock:
    """Consecutive rows of one segment.

    segment: as in `Block`.
    dt_s: row period [s].
    t_ns: (n,) vehicle time.
    u: (n, 3) commanded body rates p, q, r [rad/s]; finite, 0 where no set-point is known.
    y: (n, 3) measured body rates, smoothed [rad/s].
    gyro: (n, 3) the same as they were measured.
    valid: (n,) the gyro was valid in the whole window.
    commanded: (n,) so were gyro and set-point: u and y may be compared.
    """

    segment: int
    dt_s: float
    t_ns: IntArray
    u: FloatArray
    y: FloatArray
    gyro: FloatArray
    valid: BoolArray
    commanded: BoolArray

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class RateState:
    """Filter histories, and the times and flags of the rows that wait for the rest of their window."""

    segment: int
    setpoint: SavgolState
    smooth: SavgolState
    t_ns: IntArray
    valid: BoolArray
    commanded: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class RateSpec:
    """The two filters, of one window [samples] and order; build it with `RateSpec.of`.

    slope: gives the slopes of the set-point angles.
    value: gives the smoothed gyro and set-point angles.
    """

    window: int
    slope: SavgolFilter
    value: SavgolFilter

    @classmethod
    def of(cls, dt_s: float, window: int, order: int = 2) -> "RateSpec":
        """Filters for a sample time [s], an odd window [samples] and a polynomial order. Raises UsageError."""
        slope = SavgolFilter.differentiator(window, dt_s, order)
        return cls(window, slope, SavgolFilter.smoother(window, order))

    def start(self, segment: int = -1) -> RateState:
        """A fresh state, before the first row of a segment."""
        none = np.empty(0, dtype=np.bool_)
        return RateState(segment, self.slope.start(3), self.value.start(5), np.empty(0, dtype=np.int64), none, none)

    def step(self, state: RateState, block: Block) -> tuple[RateState, RateBlock]:
        """Take the next rows; return those whose window is complete."""
        if block.segment != state.segment:
            state = self.start(block.segment)
        setpoint, slope = self.slope.step(state.setpoint, block.setpoint)
        rows = np.concatenate((block.rate, block.setpoint[:, :2]), axis=1)
        gyro = np.concatenate((state.smooth.history[:3], block.rate.T), axis=1)
        smooth, value = self.value.step(state.smooth, rows)
        t_ns = np.concatenate((state.t_ns, block.t_ns))
        valid = np.concatenate((state.valid, block.valid))
        commanded = np.concatenate((state.commanded, block.valid & block.setpoint_valid))
        m, known = self.window // 2, len(slope)
        out = RateBlock(
            block.segment,
            block.dt_s,
            t_ns[m : m + known],
            _body_rates(value[:, 3], value[:, 4], slope),
            value[:, :3],
            gyro[:, m : m + known].T,
            window_all(valid, self.window),
            window_all(commanded, self.window),
        )
        state = RateState(block.segment, setpoint, smooth, t_ns[known:], valid[known:], commanded[known:])
        return state, out


def _body_rates(phi: FloatArray, theta: FloatArray, slope: FloatArray) -> FloatArray:
    """W(phi, theta) times the slopes of roll, pitch and yaw, (n, 3)."""
    #     [ 1   0          -sin theta          ]
    # W = [ 0   cos phi    sin phi cos theta   ]
    #     [ 0   -sin phi   cos phi cos theta   ]
    sin_phi, cos_phi = np.sin(phi), np.cos(phi)
    dphi, dtheta, dpsi = slope.T
    turn = np.cos(theta) * dpsi
    u = np.empty((3, len(slope)))
    u[0] = dphi - np.sin(theta) * dpsi
    u[1] = cos_phi * dtheta + sin_phi * turn
    u[2] = cos_phi * turn - sin_phi * dtheta
    return u.T
