"""Signal-based contenders (T 1.3.2): FFT with PCA on the accelerometer, wavelet energies of the gyro."""

from collections.abc import Sequence

import numpy as np

from mavdiag.telemetry import FloatArray
from peers.contender import Learner, Scored, Scorer
from peers.flights import Flown
from peers.windows import band_powers, cut

__all__ = ["fft_pca", "wavelet"]

FFT_ROWS, HOP_ROWS = 512, 100
BANDS = 32  # of each axis, about 16 Hz wide at 1 kHz
VARIANCE_KEPT = 0.9  # by the principal components (our choice)

WAVELET, LEVELS, WAVELET_ROWS = "db4", 6, 1024


def fft_pca(_others: Sequence[Flown]) -> Learner:
    """Band spectra of the accelerometer against the principal components of healthy flight.

    0.5 s windows every 0.1 s, log power in 32 bands of three axes, standardised; components that keep 90 % of the
    variance. Score: sqrt(T^2/p + Q/q), Hotelling's T^2 within and the squared prediction error Q outside them, each
    over its healthy mean (a combined index: Yue & Qin, Ind. Eng. Chem. Res. 40 (2001) 4403-4414).
    T 1.3.2 (FFT + PCA); Jackson & Mudholkar, Technometrics 21 (1979) 341-349.
    """

    def learn(healthy: Sequence[Flown]) -> Scorer:
        x = np.concatenate([_spectra(one) for one in healthy])
        mean, spread = x.mean(axis=0), x.std(axis=0)
        _, s, Vt = np.linalg.svd((x - mean) / spread, full_matrices=False)
        variance = s**2 / len(x)
        p = int(np.searchsorted(np.cumsum(variance) / variance.sum(), VARIANCE_KEPT)) + 1
        P, inside, outside = Vt[:p].T, variance[:p], float(variance[p:].sum())

        def score(one: Flown) -> Scored:
            z = (_spectra(one) - mean) / spread
            t = z @ P
            T2 = (t**2 / inside).sum(axis=1)
            Q = np.maximum((z**2).sum(axis=1) - (t**2).sum(axis=1), 0.0)
            return Scored.anonymous(_ends(one, FFT_ROWS), np.sqrt(T2 / p + Q / outside))

        return score

    return learn


def wavelet(_others: Sequence[Flown]) -> Learner:
    """Energies of a discrete wavelet transform of the raw gyro, against healthy flight.

    Daubechies-4, 6 levels, windows of 1 s every 0.1 s: log energy of each level and axis, standardised. Score: rms of
    the positive parts, since damage adds energy.
    T 1.3.2 (wavelet transforms); Mallat, IEEE Trans. Pattern Analysis 11 (1989) 674-693.
    """

    def learn(healthy: Sequence[Flown]) -> Scorer:
        x = np.concatenate([_energies(one) for one in healthy])
        mean, spread = x.mean(axis=0), x.std(axis=0)

        def score(one: Flown) -> Scored:
            z = np.maximum((_energies(one) - mean) / spread, 0.0)
            return Scored.anonymous(_ends(one, WAVELET_ROWS), np.sqrt(np.mean(z**2, axis=1)))

        return score

    return learn


def _spectra(one: Flown) -> FloatArray:
    return band_powers(cut(one.force, FFT_ROWS, HOP_ROWS), BANDS)


def _energies(one: Flown) -> FloatArray:
    import pywt  # of the `bench` group: the other contenders run without it

    windows = cut(one.gyro, WAVELET_ROWS, HOP_ROWS)
    levels = pywt.wavedec(windows - windows.mean(axis=1, keepdims=True), WAVELET, "periodization", LEVELS, axis=1)
    return np.log(np.concatenate([np.mean(level**2, axis=1) for level in levels], axis=1) + 1e-12)


def _ends(one: Flown, length: int) -> FloatArray:
    return one.t_s[length - 1 :: HOP_ROWS]
