"""How soon a vehicle follows its set-points: the delay with which measured rates agree best with commanded ones.

    U, Y = Fourier transforms of a window of u and y,    S = sum over windows and axes of conj(U) Y,    f = 1 .. 2.5 Hz
    r(tau) = Re sum_f S e^(2 pi i f tau)/sqrt(sum |U|^2 sum |Y|^2),    delay = argmax r

Windows count in which the command moves the vehicle, and r must be high: in a calm hover the command follows the
vehicle. A weak, rough or slow rotor, wind, load and manoeuvre made it less by 21 ms at most, emulated and recorded.
"""

import math
from functools import lru_cache

import numpy as np

from mavdiag.jit import cached, cached_loop
from mavdiag.rows.block import COMMANDED, Block, U, Y
from mavdiag.telemetry import FloatArray

WINDOW_S, HOP_S = 4.0, 2.0  # 3 s do not part 1 Hz from the turns of a circle, which are answered sooner (our choice)
STEP_S = 0.04  # rows of so long are one mean, which delays u and y alike (our choice)
BINS, DELAYS_S = np.arange(4, 11), np.arange(-0.2, 0.5, 0.001)
LEAST_RAD_S, LEAST_R = 0.1, 0.95  # of a window's command, where gusts make 0.08; squares reach 0.97 (our choice)
FEWEST = 3  # windows that tell (our choice)
TURNS = 2.0 * np.pi * np.outer(DELAYS_S, BINS / WINDOW_S)
SHIFTS = np.cos(TURNS), np.sin(TURNS)
ROWS, COMMAND = [U, U + 1, Y, Y + 1, COMMANDED], 4


class Answer:
    """The windows of a flight so far. sums: (5, f) of Re S, Im S, |U|^2, |Y|^2 and 1. delay_s: nan if not told."""

    def __init__(self) -> None:
        self.sums, self.delay_s = np.zeros((5, len(BINS))), math.nan
        self._rows, self._count, self._means = np.empty((5, 0)), 0, np.empty((5, 0))

    def take(self, block: Block, least_s: float = -math.inf) -> bool:
        """Take the next rows, up to those with which the delay is less; whether it is."""
        stride, done = max(1, round(STEP_S / block.dt_s)), 0
        step_s = stride * block.dt_s
        hop = stride * max(1, round(HOP_S / step_s))
        if not self._rows.size:
            self._rows, self._means = np.empty((5, hop)), np.full((5, max(1, round(WINDOW_S / step_s))), math.nan)
        while done < len(block) and not self.delay_s < least_s:
            stop = min(done + hop - self._count, len(block))
            self._rows[:, self._count : self._count + stop - done] = block.x[ROWS, done:stop]
            self._count, done = self._count + stop - done, stop
            if self._count == hop:
                self._count = 0
                _look(self._rows, stride, self._means, *_waves(self._means.shape[1], step_s), self.sums)
                self.delay_s = delay_of(self.sums)
        return self.delay_s < least_s


def delay_of(sums: FloatArray) -> float:
    """The delay [s]; nan where too few windows tell, or they tell of none."""
    best, power = _best(sums, *SHIFTS)
    return float(DELAYS_S[best]) if sums[4, 0] >= FEWEST and power >= LEAST_R else math.nan


@cached_loop
def _best(sums: FloatArray, cosine: FloatArray, sine: FloatArray) -> tuple[int, float]:
    """The place of the delay with the highest r, and r."""
    best, most, size = 0, -1.0, math.sqrt(sums[2].sum() * sums[3].sum())
    for place in range(len(cosine)):
        r = 0.0
        for f in range(cosine.shape[1]):
            r += cosine[place, f] * sums[0, f] - sine[place, f] * sums[1, f]
        if size > 0.0 and r / size > most:
            best, most = place, r / size
    return best, most


@cached
def _look(rows: FloatArray, stride: int, x: FloatArray, cosine: FloatArray, sine: FloatArray, sums: FloatArray) -> None:
    """Take another hop into the window of means, and the window into the sums, if its command moves the vehicle."""
    hop, n = rows.shape[1] // stride, x.shape[1]
    for row in range(len(x)):
        for k in range(n - hop):
            x[row, k] = x[row, k + hop]
        for k in range(hop):
            x[row, n - hop + k] = rows[row, k * stride : (k + 1) * stride].mean()
    if not (np.isfinite(x).all() and (x[COMMAND] == 1.0).all()):
        return
    found = np.zeros_like(sums)
    for axis in range(2):
        u_mean, y_mean = x[axis].mean(), x[2 + axis].mean()
        for f in range(len(cosine)):
            u_real = u_imaginary = y_real = y_imaginary = 0.0
            for k in range(n):
                u, y = x[axis, k] - u_mean, x[2 + axis, k] - y_mean
                u_real, u_imaginary = u_real + u * cosine[f, k], u_imaginary - u * sine[f, k]
                y_real, y_imaginary = y_real + y * cosine[f, k], y_imaginary - y * sine[f, k]
            found[0, f] += u_real * y_real + u_imaginary * y_imaginary
            found[1, f] += u_real * y_imaginary - u_imaginary * y_real
            found[2, f] += u_real * u_real + u_imaginary * u_imaginary
            found[3, f] += y_real * y_real + y_imaginary * y_imaginary
            found[4, f] += 0.5  # of each axis
    if found[2].sum() >= LEAST_RAD_S**2:
        sums += found


@lru_cache(maxsize=8)
def _waves(n: int, step_s: float) -> tuple[FloatArray, FloatArray]:
    """What n means are multiplied by for the real and the imaginary part of each f, (f, n); |U|^2 are mean squares."""
    hann, turns = np.hanning(n), 2.0 * np.pi * np.outer(BINS / WINDOW_S, np.arange(n) * step_s)
    hann *= math.sqrt(2.0 / n / (hann @ hann))
    return hann * np.cos(turns), hann * np.sin(turns)


def warm() -> None:
    """Compile the sums, or load them from where they are kept."""
    sums = Answer().sums
    _look(np.zeros((len(ROWS), 50)), 1, np.zeros((len(ROWS), 100)), *_waves(100, STEP_S), sums)
    delay_of(sums)
