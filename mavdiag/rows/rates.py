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
from typing import Any, NamedTuple

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.jit import cached, jit
from mavdiag.rows.block import COMMANDED, GYRO, LEAN, RATE, SETPOINT, VALID, WHOLE, Block, Rows, U, Y
from mavdiag.rows.savgol import coefficients
from mavdiag.telemetry import FloatArray, IntArray

ANEW = 4  # windows after which the moments are formed anew (our choice)
SIGNALS = 6  # gyro p, q, r; set-point roll, pitch, yaw
# Places in the memory: of each signal three moments, and for how many rows what is no number spoils it; the segment,
# its rows so far, rows in a line in which the gyro was valid, and in which the set-point was, too; then the last rows
# of each signal.
SPOILT, SEGMENT, ROWS, SOUND, WANTED, HISTORY = 18, 24, 25, 26, 27, 28


class RateState(NamedTuple):
    """What the filters remember of a segment; changed in place. times: (window,) of the last rows [ns]."""

    memory: FloatArray
    times: IntArray


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
        state = RateState(np.zeros(HISTORY + SIGNALS * self.window), np.zeros(self.window, dtype=np.int64))
        state.memory[SEGMENT] = -1.0
        return state

    def step(self, state: RateState, block: Block) -> Rows:
        """Take the next rows; they get the rates whose windows they complete."""
        return Rows(block, filtered(state, self.weights, block.segment, block.t_ns, (block.whole, block.first)))


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
def _moments(history: FloatArray, newest: int) -> tuple[float, float, float]:
    """Of the whole window."""
    window, place, m0, m1, m2 = len(history), newest, 0.0, 0.0, 0.0
    for k in range(window):
        place = place + 1 if place + 1 < window else 0
        value, away = _finite(history[place]), float(k - window // 2)
        m0 += value
        m1 += away * value
        m2 += away * away * value
    return m0, m1, m2


@jit
def _smooth(
    mem: FloatArray, signal: int, weights: tuple[float, float, float], new: FloatArray, window: int, to: Any
) -> None:
    """Of each window that a new row ends the value, the slope, and the row at its centre; any of these may be empty."""
    (values, slopes, centres), (middle, bend, slope), m = to, weights, window // 2
    rows, spoilt, history = int(mem[ROWS]), int(mem[SPOILT + signal]), mem[HISTORY + signal * window :][:window]
    place, (m0, m1, m2) = rows % window, (mem[3 * signal], mem[3 * signal + 1], mem[3 * signal + 2])
    centre, until_anew = (rows + window - m) % window, (window - 1 - rows) % (ANEW * window)
    for i in range(len(new)):
        oldest, newest = _finite(history[place]), new[i]
        history[place] = newest
        spoilt = max(spoilt - 1, 0)
        if not math.isfinite(newest):
            newest, spoilt = 0.0, window
        if until_anew == 0:
            (m0, m1, m2), until_anew = _moments(history, place), ANEW * window
        else:
            m0, m1, m2 = m0 - oldest, m1 + m * oldest, m2 - m * m * oldest
            m2 += m0 - 2.0 * m1 + m * m * newest
            m1 += m * newest - m0
            m0 += newest
        if len(values):
            values[i] = middle * m0 + bend * m2 if spoilt == 0 else np.nan
        if len(slopes):
            slopes[i] = slope * m1 if spoilt == 0 else np.nan
        if len(centres):
            centres[i] = history[centre]
        until_anew -= 1
        place = place + 1 if place + 1 < window else 0
        centre = centre + 1 if centre + 1 < window else 0
    mem[3 * signal], mem[3 * signal + 1], mem[3 * signal + 2], mem[SPOILT + signal] = m0, m1, m2, spoilt


@jit
def _filter(s: RateState, weights: tuple[float, float, float], t_ns: IntArray, place: Any, made: IntArray) -> None:
    """Put into x the rates of the windows that its columns complete, and into `made` their times."""
    (mem, times), (x, begin), stop = s, place, place[1] + len(t_ns)
    window, first, none = len(times), len(t_ns) - len(made), x[U, :0]
    for axis in range(3):
        to = x[Y + axis, begin:stop], none, x[GYRO + axis, begin:stop]
        _smooth(mem, axis, weights, x[RATE + axis, begin:stop], window, to)
    for angle, values in enumerate((x[WHOLE, begin:stop], x[COMMANDED, begin:stop], none)):  # until they are used
        _smooth(mem, 3 + angle, weights, x[LEAN + angle, begin:stop], window, (values, x[U + angle, begin:stop], none))
    rows = int(mem[ROWS])
    for number in range(len(t_ns)):
        i = begin + number
        times[(rows + number) % window] = t_ns[number]
        valid = x[VALID, i] > 0.5
        mem[SOUND] = mem[SOUND] + 1.0 if valid else 0.0
        mem[WANTED] = mem[WANTED] + 1.0 if valid and x[SETPOINT, i] > 0.5 else 0.0
        if x[SETPOINT, i] < 0.5:  # a lean that is not known is none
            x[LEAN, i] = x[LEAN + 1, i] = 0.0
        if number < first:
            x[WHOLE, i], x[COMMANDED, i], x[U : GYRO + 3, i] = 0.0, 0.0, np.nan
            continue
        made[number - first] = times[(rows + number + window - window // 2) % window]
        lean = _finite(x[WHOLE, i]), _finite(x[COMMANDED, i])  # 0 where it is not known, and so are the rates
        x[U, i], x[U + 1, i], x[U + 2, i] = _turned(*lean, _finite(x[U, i]), _finite(x[U + 1, i]), _finite(x[U + 2, i]))
        x[WHOLE, i], x[COMMANDED, i] = mem[SOUND] >= window, mem[WANTED] >= window
    mem[ROWS] += len(t_ns)


@cached
def filtered(s: RateState, weights: tuple[float, float, float], segment: int, t_ns: IntArray, place: Any) -> IntArray:
    """Put into x the rates of the windows that the next rows of a segment complete; return their times [ns].

    place: x, and the first of the columns that belong to t_ns.
    """
    if s.memory[SEGMENT] != segment:
        s.memory[:] = 0.0
        s.memory[SEGMENT] = segment
    known = min(len(t_ns), max(0, len(t_ns) + int(s.memory[ROWS]) - len(s.times) + 1))
    made = np.empty(known, dtype=np.int64)
    _filter(s, weights, t_ns, place, made)
    return made
