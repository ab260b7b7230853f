"""From aligned rows to the pair that the model relates: commanded body rate u and measured body rate y (T 4.3.4).

Savitzky-Golay filters of one window of 2m + 1 rows and order 2 give value and slope of the commanded Euler angles at
the centre of the window, and W(phi, theta) (`body_rates`) turns the slopes into body rates. The gyro has that window.

Value and slope at the centre follow from the moments M_j = sum of k^j x over the window, k = -m..m (T Eq 4.11):

    value = c_0 M_0 + c_2 M_2,    slope = M_1/(sum of k^2)/dt

Moments run: without the oldest row, M_1 <- M_1 - M_0 and M_2 <- M_2 - 2 M_1 + M_0 move the window on by one, then the
newest row is added. They are formed anew at fixed rows of a segment, so that what is rounded does not grow.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.jit import cached_loop, jit
from mavdiag.rows.block import Block
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

ANEW = 4  # windows after which the moments are formed anew (our choice)
SIGNALS = 6  # gyro p, q, r; set-point roll, pitch, yaw
# Places in the memory: of each signal three moments, and how long it will be spoilt by what is no number, its value
# and its slope; rows so far, rows in a line in which the gyro was valid, and in which the set-point was, too; then the
# last rows of each signal.
SPOILT, VALUES, SLOPES, ROWS, SOUND, WANTED, HISTORY = 18, 24, 30, 36, 37, 38, 39


@dataclass(frozen=True, slots=True, eq=False)
class RateBlock:
    """Consecutive rows of one segment.

    u: (n, 3) commanded body rates p, q, r [rad/s]; finite, 0 where no set-point is known.
    y: (n, 3) measured body rates, smoothed [rad/s]. gyro: the same as they were measured.
    valid: (n,) the gyro was valid in the whole window. commanded: so were gyro and set-point: u and y may be compared.
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


class RateState:
    """What the filters remember of a segment; changed in place. times: (window,) of the last rows [ns]."""

    def __init__(self, window: int) -> None:
        self.segment = -1
        self.memory: FloatArray = np.zeros(HISTORY + SIGNALS * window)
        self.times: IntArray = np.zeros(window, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class RateSpec:
    """The two filters, of one window [rows]; build it with `RateSpec.of`.

    weights: c_0, c_2, and what makes a slope of M_1 [1/s].
    """

    window: int
    weights: tuple[float, float, float]

    @classmethod
    def of(cls, dt_s: float, window: int, order: int = 2) -> "RateSpec":
        """Filters for a sample time [s], an odd window [rows] and a polynomial order, 1 or 2. Raises UsageError."""
        if order not in (1, 2) or not (math.isfinite(dt_s) and dt_s > 0):
            raise UsageError(f"rates need a polynomial order of 1 or 2 and a positive sample time, not {order}, {dt_s}")
        (value, slope, *_), m = coefficients(window, order), window // 2
        return cls(window, (float(value[m]), float((value[-1] - value[m]) / m**2), float(slope[-1] / m / dt_s)))

    def start(self) -> RateState:
        """A fresh state, before the first row."""
        return RateState(self.window)

    def step(self, state: RateState, block: Block) -> RateBlock:
        """Take the next rows; return those whose window is complete."""
        if block.segment != state.segment:
            state.segment = block.segment
            state.memory[:] = 0.0
        known = min(len(block), max(0, len(block) + int(state.memory[ROWS]) - self.window + 1))
        out, t_ns, flags = np.empty((9, known)), np.empty(known, np.int64), np.empty((2, known), np.bool_)
        signals = np.ascontiguousarray(block.rate.T), np.ascontiguousarray(block.setpoint.T)
        came = block.t_ns, *signals, block.valid, block.setpoint_valid
        _filter((state.memory, state.times), self.weights, came, (out, t_ns, flags))
        return RateBlock(block.segment, block.dt_s, t_ns, out[:3].T, out[3:6].T, out[6:].T, flags[0], flags[1])


def body_rates(phi: Any, theta: Any, dphi: Any, dtheta: Any, dpsi: Any) -> tuple[Any, Any, Any]:
    """p, q, r of roll and pitch [rad] and the slopes of roll, pitch and yaw (kinematics of the order yaw, pitch, roll).

    Numbers or arrays:    [p]   [ 1   0          -sin theta          ] [dphi  ]
                          [q] = [ 0   cos phi    sin phi cos theta   ] [dtheta]
                          [r]   [ 0   -sin phi   cos phi cos theta   ] [dpsi  ]
    """
    sin_phi, cos_phi, turn = np.sin(phi), np.cos(phi), np.cos(theta) * dpsi
    return dphi - np.sin(theta) * dpsi, cos_phi * dtheta + sin_phi * turn, cos_phi * turn - sin_phi * dtheta


_turned = jit(body_rates)


@jit
def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


@jit
def _move_on(mem: FloatArray, signal: int, newest: float, place: int, window: int, anew: bool) -> None:
    m, at, history = window // 2, 3 * signal, HISTORY + signal * window
    oldest = _finite(mem[history + place])
    mem[history + place] = newest
    mem[SPOILT + signal] = max(mem[SPOILT + signal] - 1.0, 0.0)
    if not math.isfinite(newest):
        newest, mem[SPOILT + signal] = 0.0, float(window)
    if anew:
        m0 = m1 = m2 = 0.0
        for k in range(window):
            place = place + 1 if place + 1 < window else 0
            value, away = _finite(mem[history + place]), float(k - m)
            m0 += value
            m1 += away * value
            m2 += away * away * value
    else:
        m0, m1, m2 = mem[at] - oldest, mem[at + 1] + m * oldest, mem[at + 2] - m * m * oldest
        m2 += m0 - 2.0 * m1 + m * m * newest
        m1 += m * newest - m0
        m0 += newest
    mem[at], mem[at + 1], mem[at + 2] = m0, m1, m2


@cached_loop
def _filter(state: Any, weights: tuple[float, float, float], rows_in: Any, made: Any) -> None:
    """u, y and gyro of the rows whose window is complete, with their times and flags."""
    (mem, times), (middle, bend, slope), (out, t_ns, flags) = state, weights, made
    row_ns, rate, setpoint, valid, commanded = rows_in
    window = len(times)
    for i in range(len(row_ns)):
        rows = int(mem[ROWS])
        place, anew = rows % window, rows % (ANEW * window) == window - 1
        times[place], centre = row_ns[i], (rows + window - window // 2) % window
        mem[ROWS] += 1.0
        mem[SOUND] = mem[SOUND] + 1.0 if valid[i] else 0.0
        mem[WANTED] = mem[WANTED] + 1.0 if valid[i] and commanded[i] else 0.0
        for signal in range(SIGNALS):
            newest = rate[signal, i] if signal < 3 else setpoint[signal - 3, i]
            _move_on(mem, signal, newest, place, window, anew)
            spoilt = np.nan if mem[SPOILT + signal] > 0.0 else 0.0
            mem[VALUES + signal] = middle * mem[3 * signal] + bend * mem[3 * signal + 2] + spoilt
            mem[SLOPES + signal] = slope * mem[3 * signal + 1] + spoilt
        done = i - (len(row_ns) - len(t_ns))
        if done < 0:
            continue
        t_ns[done] = times[centre]
        flags[0, done], flags[1, done] = mem[SOUND] >= window, mem[WANTED] >= window
        out[0, done], out[1, done], out[2, done] = _turned(
            mem[VALUES + 3], mem[VALUES + 4], mem[SLOPES + 3], mem[SLOPES + 4], mem[SLOPES + 5]
        )
        for axis in range(3):
            out[3 + axis, done] = mem[VALUES + axis]
            out[6 + axis, done] = mem[HISTORY + axis * window + centre]
