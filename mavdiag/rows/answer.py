"""How soon a vehicle follows its set-points: the delay with which measured rates agree best with commanded ones.

    U, Y = Fourier transforms of a window of u and y,    S = sum over windows and axes of conj(U) Y,    f = 1 .. 2.5 Hz
    r(tau) = Re sum_f S e^(2 pi i f tau)/sqrt(sum |U|^2 sum |Y|^2),    delay = argmax r

Windows count in which the command moves the vehicle, and r must be high: in a calm hover the command follows the
vehicle. A weak, rough or slow rotor, wind, load and manoeuvre made it less by 21 ms at most, emulated and recorded.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mavdiag.rows.block import COMMANDED, Block, U, Y
from mavdiag.telemetry import FloatArray

WINDOW_S, HOP_S = 4.0, 2.0  # 3 s do not part 1 Hz from the turns of a circle, which are answered sooner (our choice)
STEP_S = 0.04  # rows of so long are one mean, which delays u and y alike (our choice)
BINS, DELAYS_S = np.arange(4, 11), np.arange(-0.2, 0.5, 0.001)
LEAST_RAD_S, LEAST_R = 0.1, 0.95  # of a window's command, where gusts make 0.08; squares reach 0.97 (our choice)
FEWEST = 3  # windows that tell (our choice)
SHIFTS = np.exp(2j * np.pi * np.outer(DELAYS_S, BINS / WINDOW_S))
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
                if self._look(stride, step_s):
                    self.delay_s = delay_of(self.sums)
        return self.delay_s < least_s

    def _look(self, stride: int, step_s: float) -> bool:
        """Take another hop into the window of means, and the window into the sums, if its command moves the vehicle."""
        fresh = self._rows.reshape(len(ROWS), -1, stride).mean(axis=2)
        self._means = means = np.concatenate((self._means, fresh), axis=1)[:, -self._means.shape[1] :]
        if not (np.isfinite(means).all() and (means[COMMAND] == 1.0).all()):
            return False
        rates = means[:COMMAND] - means[:COMMAND].mean(axis=1, keepdims=True)
        spectra = np.einsum("rk,kf->rf", rates, _waves(means.shape[1], step_s))  # no product that BLAS threads
        S = (spectra[:2].conj() * spectra[2:]).sum(axis=0)
        u_power, y_power = np.square(np.abs(spectra)).reshape(2, 2, -1).sum(axis=1)
        if moves := bool(u_power.sum() >= LEAST_RAD_S**2):
            self.sums += S.real, S.imag, u_power, y_power, np.ones(len(BINS))
        return moves


def delay_of(sums: FloatArray) -> float:
    """The delay [s]; nan where too few windows tell, or they tell of none."""
    agreement = np.einsum("df,f->d", SHIFTS, sums[0] + 1j * sums[1]).real
    size = math.sqrt(sums[2].sum() * sums[3].sum())
    best = int(agreement.argmax())
    return float(DELAYS_S[best]) if sums[4, 0] >= FEWEST and agreement[best] >= LEAST_R * size > 0.0 else math.nan


@lru_cache(maxsize=8)
def _waves(n: int, step_s: float) -> NDArray[np.complex128]:
    """What n means are multiplied by for each f, (n, f); |U|^2 are mean squares."""
    hann = np.hanning(n)
    hann *= math.sqrt(2.0 / n / (hann @ hann))
    return np.asarray(hann[:, None] * np.exp(-2j * np.pi * np.outer(np.arange(n) * step_s, BINS / WINDOW_S)))
