"""The comparison's own tools: the one threshold rule, alarms, windows, and known answers for the small detectors."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from mavdiag.airframe.layout import layout_named
from mavdiag.telemetry import Log, Telemetry
from mavdiag.thresholds.rule import ThresholdRule

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from peers.contender import Contender, Scored, Scorer, calibrated
from peers.flights import Flown
from peers.model_based import sliding_mode

GAIN = np.array([120.0, 100.0, 14.0])  # rad/s^2 per unit of trim
DT_S = 0.001
ONSET_S = 6.0


def made(seed: int, *, seconds: float = 12.0, loss: float = 0.0, rotor: int = 1, shake: float = 0.0) -> Flown:
    """A vehicle that obeys the torque model; from second 6 a rotor loses thrust and gains drag, or everything shakes.

    Its measured rate follows the commanded one by a lag of 0.1 s.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(seconds / DT_S), dtype=np.float64) * DT_S
    after = (t_s >= ONSET_S)[:, None]
    frame = layout_named("qdrone2")
    m = 0.02 * np.sin(np.outer(t_s, [5.0, 6.0, 7.0]) + rng.uniform(0.0, 6.0, 3))
    missing = after * loss * frame.unmixing[:, rotor - 1] * np.array([-1.0, -1.0, 1.0])
    rate = np.cumsum(GAIN * (m - m.mean(axis=0) + missing), axis=0) * DT_S
    line = after * shake * np.sin(2.0 * math.pi * 167.0 * t_s)[:, None]
    slow = np.cumsum(rng.standard_normal((len(t_s), 3)), axis=0) * 0.003
    return Flown(
        flight=Log(f"made {seed}", "0" * 64, "qdrone2", Telemetry()),
        airframe="made",
        t_s=t_s,
        dt_s=DT_S,
        u=np.gradient(slow, DT_S, axis=0) * 0.1 + slow + 0.003 * rng.standard_normal(slow.shape),
        y=slow,
        gyro=rate + 0.002 * rng.standard_normal(rate.shape) + 0.003 * line,
        force=np.array([0.0, 0.0, -9.81]) + 0.05 * rng.standard_normal(rate.shape) + line,
        duty=0.7 * np.sqrt(1.0 + m @ frame.mixing.T),
        delay_s=0.05,
        front_s=0.0,
    )


@pytest.fixture(scope="module")
def healthy() -> list[Flown]:
    return [made(seed) for seed in range(4)]


def before_and_after(scored: Scored) -> tuple[float, float]:
    """Highest score before the damage, and the usual one a second after it."""
    return float(scored.score[scored.t_s < ONSET_S].max()), float(np.median(scored.score[scored.t_s > ONSET_S + 1.0]))


@pytest.mark.parametrize("rule", list(ThresholdRule))
def test_the_threshold_comes_from_flights_that_the_fit_did_not_see(healthy: list[Flown], rule: ThresholdRule) -> None:
    unseen: list[Flown] = []

    def learn(training: Sequence[Flown]) -> Scorer:
        def score(one: Flown) -> Scored:
            assert all(one is not other for other in training)
            unseen.append(one)
            return Scored.anonymous(one.t_s, np.abs(one.gyro[:, 0]))

        return score

    watch = calibrated(Contender("made", lambda _: learn, rule=rule), learn, healthy)
    largest = max(float(np.abs(one.gyro[:, 0]).max()) for one in healthy)
    assert len(unseen) == len(healthy)
    assert watch.threshold == largest if rule is ThresholdRule.MAXIMUM else watch.threshold > largest


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_the_sliding_mode_observer_names_the_rotor(healthy: list[Flown], rotor: int) -> None:
    scored = sliding_mode([])(healthy)(made(9, loss=0.05, rotor=rotor))
    before, after = before_and_after(scored)
    assert after > 2.0 * before
    assert set(scored.rotor[scored.t_s > ONSET_S + 2.0].tolist()) == {rotor}
