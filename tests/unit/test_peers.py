"""The comparison's own tools: the one threshold rule, alarms, windows, and known answers for the small detectors."""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavdiag.airframe.layout import layout_named
from mavdiag.telemetry import Log, Telemetry
from mavdiag.thresholds.rule import ThresholdRule

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from peers.contender import Alarm, Contender, Learner, Scored, Scorer, alarms, block_scores, calibrated, caught
from peers.flights import Flown, Truth, airframe, faulty, mixed, other_airframe
from peers.learned import neural_network
from peers.model_based import bank_of_models, fixed_threshold, kalman, sliding_mode
from peers.ours import thesis_rule
from peers.signal_based import fft_pca, wavelet
from peers.torque import fit_torque
from peers.windows import band_powers, cut, mean_over
from peers_table import poisson_interval

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


def test_alarms_need_a_strictly_higher_score_and_join_over_short_gaps() -> None:
    score = np.array([0.0, 1.0, 2.0, 1.0, 3.0, 0.0, 0.0, 0.0, 5.0, 0.0])
    found = alarms(Scored(np.arange(10.0), score, np.arange(10)), 1.0)
    assert found == (Alarm(2.0, 4.0, 4), Alarm(8.0, 8.0, 8))
    assert alarms(Scored.anonymous(np.arange(3.0), np.ones(3)), 1.0) == ()


def test_an_alarm_that_stands_at_the_onset_is_no_detection() -> None:
    truth = Truth("F1/SV1", 1, 1.0, 10.0)
    standing, later = Alarm(9.0, 12.0, 1), Alarm(15.0, 16.0, 2)
    assert caught([standing], truth) is None
    assert caught([standing, later], truth) == later


def test_blocks_take_ten_seconds_and_a_shorter_rest_joins_the_last() -> None:
    t_s = np.arange(0.0, 26.0, 0.5)
    assert block_scores(Scored.anonymous(t_s, t_s)).maxima.tolist() == [9.5, 19.5, 25.5]
    joined = block_scores(Scored.anonymous(t_s[:48], t_s[:48]))
    assert joined.maxima.tolist() == [9.5, 23.5]
    assert joined.spans_s.tolist() == [10.0, 14.0]


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


def test_a_contender_with_rules_of_its_own_keeps_them(healthy: list[Flown]) -> None:
    learn: Learner = fixed_threshold([])
    assert calibrated(Contender("made", fixed_threshold, rule=None), learn, healthy).threshold == 0.5


def test_windows_end_where_they_say() -> None:
    x = np.arange(20.0)[:, None]
    assert cut(x, 5, 3)[:, -1, 0].tolist() == [4.0, 7.0, 10.0, 13.0, 16.0, 19.0]
    assert mean_over(np.arange(6.0), 3).tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_tone_is_in_its_band() -> None:
    tone = np.sin(2.0 * np.pi * 167.0 * np.arange(512) * DT_S)
    assert int(band_powers(tone[None, :, None], 32)[0].argmax()) == int(167.0 / (500.0 / 32))


def test_the_torque_model_is_recovered(healthy: list[Flown]) -> None:
    fast = fit_torque(healthy)
    assert fast.gain == pytest.approx(GAIN, rel=0.05)


@pytest.mark.parametrize("study", [kalman, fft_pca])
def test_a_shaking_vehicle_raises_the_score(study: Callable[[Sequence[Flown]], Learner], healthy: list[Flown]) -> None:
    before, after = before_and_after(study([])(healthy)(made(9, shake=5.0)))
    assert after > 2.0 * before


def test_a_shaking_vehicle_raises_its_wavelet_energies(healthy: list[Flown]) -> None:
    pytest.importorskip("pywt", reason="of the bench group")
    before, after = before_and_after(wavelet([])(healthy)(made(9, shake=5.0)))
    assert after > 2.0 * before


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_the_sliding_mode_observer_names_the_rotor(healthy: list[Flown], rotor: int) -> None:
    scored = sliding_mode([])(healthy)(made(9, loss=0.05, rotor=rotor))
    before, after = before_and_after(scored)
    assert after > 2.0 * before
    assert set(scored.rotor[scored.t_s > ONSET_S + 2.0].tolist()) == {rotor}


def test_the_bank_prefers_the_model_that_made_the_flight(healthy: list[Flown]) -> None:
    truth = Truth("F2/SV1", 1, 1.0, 0.0)
    rng = np.random.default_rng(5)

    def rough(one: Flown) -> Flown:
        noise = np.cumsum(rng.standard_normal(one.y.shape), axis=0) * 0.01
        return replace(one, y=one.y + noise, truth=truth)

    score = bank_of_models([rough(one) for one in healthy])(healthy)
    assert float(np.median(score(made(9)).score)) < 0.0 < float(np.median(score(rough(made(9))).score))


def test_the_thesis_rule_measures_how_long_the_residual_stays_away(healthy: list[Flown]) -> None:
    one = made(9)
    pushed = one.y.copy()
    pushed[8000:8500] += 5.0
    scored = thesis_rule([])(healthy)(replace(one, y=pushed))
    assert float(scored.score.max()) == pytest.approx(0.5, abs=0.2)
    assert float(scored.t_s[scored.score.argmax()]) == pytest.approx(8.55, abs=0.2)


def test_the_network_finds_what_it_was_shown(healthy: list[Flown]) -> None:
    pytest.importorskip("sklearn", reason="of the bench group")
    shown = [
        replace(made(20 + rotor, shake=5.0, loss=0.02, rotor=rotor), truth=Truth("F1/SV1", rotor, 1.0, 0.0))
        for rotor in (1, 2, 3, 4)
    ]
    scored = neural_network([*healthy, *shown])(healthy)(made(9, shake=5.0, loss=0.02))
    before, after = before_and_after(scored)
    assert after > before
    assert set(scored.rotor.tolist()) <= {1, 2, 3, 4}


def test_conditions_repeat_and_no_two_uses_share_a_seed() -> None:
    one = airframe(0, 3)
    configs = [mixed(one, number, (3, use, 0)) for use in (1, 2, 3) for number in range(8)]
    assert [config.seed for config in configs] == [
        mixed(one, n, (3, use, 0)).seed for use in (1, 2, 3) for n in range(8)
    ]
    assert len({config.seed for config in configs}) == len(configs)
    assert not np.array_equal(one.motor_lag_s, other_airframe(0, 3).motor_lag_s)


def test_faults_come_once_a_scale_under_the_same_conditions() -> None:
    configs = faulty(airframe(0, 3), 0, (3, 3, 0), (1.0, 0.0), 10.0)
    full, physics = configs[:9], configs[9:]
    assert len({config.fault for config in full}) == 9
    assert {config.rotor for config in full} == {1, 2, 3, 4}
    assert [(c.fault, c.rotor, c.seed) for c in full] == [(c.fault, c.rotor, c.seed) for c in physics]


@pytest.mark.parametrize(("events", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)])
def test_the_poisson_interval_is_garwoods(events: int, low: float, high: float) -> None:
    assert poisson_interval(events, 1.0) == pytest.approx((low, high), rel=1e-3)
