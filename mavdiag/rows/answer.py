"""How soon a vehicle follows its set-points: the delay with which measured rates agree best with commanded ones.

    U, Y = Fourier transforms of a window of u and y,    S = sum over windows and axes of conj(U) Y,    f = 1 .. 2.5 Hz
    r(tau) = Re sum_f S e^(2 pi i f tau)/sqrt(sum |U|^2 sum |Y|^2),    delay = argmax r

Windows count in which the command moves the vehicle, and r must be high: in a calm hover the command follows the
vehicle. A weak, rough or slow rotor, wind, load and manoeuvre made it less by 21 ms at most, emulated and recorded.
"""

import math

import numpy as np

from mavdiag.rows.block import COMMANDED, Block, U, Y
from mavdiag.rows.windows import window_rows
from mavdiag.telemetry import FloatArray

WINDOW_S, HOP_S = 4.0, 1.0  # 3 s do not part 1 Hz from the turns of a circle, which are answered sooner (our choice)
BINS, DELAYS_S = np.arange(4, 11), np.arange(-0.4, 0.6, 0.001)
LEAST_RAD_S, LEAST_R = 0.1, 0.95  # of a window's command, where gusts make 0.08; squares reach 0.97 (our choice)
FEWEST = 3  # windows that tell (our choice)
SHIFTS = np.exp(2j * np.pi * np.outer(DELAYS_S, BINS / WINDOW_S))


class Answer:
    """The windows of a flight so far. sums: (5, f) of Re S, Im S, |U|^2, |Y|^2 and 1. delay_s: nan if not told."""

    def __init__(self) -> None:
        self.sums, self.delay_s, self._rest = np.zeros((5, len(BINS))), math.nan, np.empty((5, 0))

    def take(self, block: Block, least_s: float = -math.inf) -> bool:
        """Take the next rows, up to those with which the delay is less; whether it is."""
        x = np.concatenate((self._rest, block.x[[U, U + 1, Y, Y + 1, COMMANDED]]), axis=1)
        n, hop = window_rows(WINDOW_S, block.dt_s), window_rows(HOP_S, block.dt_s)
        while x.shape[1] >= n and not self.delay_s < least_s:
            self.sums += _spectra(x[:, :n])
            self.delay_s, x = delay_of(self.sums), x[:, hop:]
        self._rest = x
        return self.delay_s < least_s


def delay_of(sums: FloatArray) -> float:
    """The delay [s]; nan where too few windows tell, or they tell of none."""
    real, imaginary, uu, yy, windows = sums
    r = (SHIFTS @ (real + 1j * imaginary)).real / (math.sqrt(uu.sum() * yy.sum()) or math.inf)
    return float(DELAYS_S[r.argmax()]) if windows[0] >= FEWEST and r.max() >= LEAST_R else math.nan


def _spectra(window: FloatArray) -> FloatArray:
    """What a window adds to the sums; its |U|^2 add up to the mean square of the command in the band."""
    known, hann = window[:-1], np.hanning(window.shape[1])
    if not ((window[-1] > 0.5).all() and np.isfinite(known).all()):
        return np.zeros(1)
    spectra = np.fft.rfft((known - known.mean(axis=1, keepdims=True)) * hann, max(len(hann), 2 * BINS[-1]))[:, BINS]
    u, y = (spectra * math.sqrt(2.0 / len(hann) / (hann @ hann))).reshape(2, 2, -1)
    s, uu, yy = (u.conj() * y).sum(axis=0), np.square(np.abs(u)).sum(axis=0), np.square(np.abs(y)).sum(axis=0)
    return np.stack((s.real, s.imag, uu, yy, np.ones_like(uu))) if uu.sum() >= LEAST_RAD_S**2 else np.zeros(1)
