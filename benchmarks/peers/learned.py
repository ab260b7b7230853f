"""A small neural network on window features (T 1.3.3), trained on other airframes."""

import warnings
from collections.abc import Sequence

import numpy as np

from mavdiag.telemetry import FloatArray
from peers.contender import Learner, Scored, Scorer
from peers.flights import Flown
from peers.torque import trims
from peers.windows import band_powers, cut, mean_over

__all__ = ["features", "neural_network"]

ROWS, HOP_ROWS, BANDS = 1000, 100, 12
HIDDEN, WEIGHT_DECAY, EPOCHS = (32,), 1e-2, 100
Z_LIMIT = 10.0  # standardised features are cut there: the network never saw more
SMOOTHED = 5  # successive windows whose log-odds are averaged
SEED = 1


def neural_network(others: Sequence[Flown]) -> Learner:
    """A multilayer perceptron with one hidden layer of 32: healthy, or rotor 1, 2, 3 or 4 damaged.

    Features of 1 s windows every 0.1 s: log power of gyro and accelerometer in 12 bands, roll, pitch and yaw trim of
    the motors, rms of the rate error. They are standardised by the healthy flights of the airframe that they come
    from, which is all that the judged airframe adds. Score: log-odds of damage, mean of five windows.
    T 1.3.3 (neural networks); Rumelhart, Hinton & Williams, Nature 323 (1986) 533-536.
    """
    from sklearn.exceptions import ConvergenceWarning  # of the `bench` group: the other contenders run without it
    from sklearn.neural_network import MLPClassifier

    x, labels = [], []
    for name in sorted({one.airframe for one in others}):
        flights = [one for one in others if one.airframe == name]
        mean, spread = _scale([one for one in flights if one.truth is None])
        for one in flights:
            z = _standard(features(one), mean, spread)
            x.append(z)
            labels.append(np.full(len(z), 0 if one.truth is None else one.truth.rotor))
    network = MLPClassifier(HIDDEN, alpha=WEIGHT_DECAY, max_iter=EPOCHS, early_stopping=True, random_state=SEED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # stopping after EPOCHS is meant
        network.fit(np.concatenate(x), np.concatenate(labels))

    def learn(healthy: Sequence[Flown]) -> Scorer:
        mean, spread = _scale(healthy)

        def score(one: Flown) -> Scored:
            odds = np.maximum(network.predict_proba(_standard(features(one), mean, spread)), 1e-9)
            damaged = mean_over(np.log(odds[:, 1:].sum(axis=1)) - np.log(odds[:, 0]), SMOOTHED)
            rotor = mean_over(odds[:, 1:], SMOOTHED).argmax(axis=1) + 1
            return Scored(one.t_s[ROWS - 1 :: HOP_ROWS][SMOOTHED - 1 :], damaged, rotor)

        return score

    return learn


def features(one: Flown) -> FloatArray:
    """(k, 78), one row a window."""
    bands = band_powers(cut(np.column_stack([one.gyro, one.force]), ROWS, HOP_ROWS), BANDS)
    trim = mean_over(trims(one), ROWS)[::HOP_ROWS]
    error = np.log(mean_over((one.y - one.u) ** 2, ROWS)[::HOP_ROWS] + 1e-9)
    return np.column_stack([bands, trim, error])


def _scale(healthy: Sequence[Flown]) -> tuple[FloatArray, FloatArray]:
    x = np.concatenate([features(one) for one in healthy])
    return x.mean(axis=0), x.std(axis=0)


def _standard(x: FloatArray, mean: FloatArray, spread: FloatArray) -> FloatArray:
    return np.clip((x - mean) / spread, -Z_LIMIT, Z_LIMIT)
