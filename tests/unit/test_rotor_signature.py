"""RotorSignature: signature and amplitude by their definitions, identification and variance by scipy, refusals."""

import dataclasses

import numpy as np
import pytest
from made_rows import example_context, example_rows, read
from made_telemetry import body_rates
from scipy.signal import lfilter

from mavdiag.airframe.layout import layout_named
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Flights
from mavdiag.monitors.rotor_signature import (
    DRIFT_S,
    HealthyMotion,
    Residuals,
    RotorSignature,
    RotorSignatureSpec,
    residuals_of,
    samples_of,
)
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray

N, DT_S = 3000, 0.01
MODEL = ((1.0, -1.6, 0.66), (0.0, 0.03, 0.03))
CALM = np.zeros((N, 3))


def fit(flights: Flights, frame: str | None, dt_s: float = DT_S) -> RotorSignatureSpec:
    (spec,) = RotorSignature.fit(flights, example_context(frame, dt_s))
    return spec


def flown(seed: int, push: FloatArray, n: int = N) -> Rows:
    """A linear airframe at 100 Hz. push: (n, 3) added to roll rate, pitch rate and vertical acceleration."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.normal(0, 0.1, (n // 200 + 1, 3)), 200, axis=0)[:n]
    setpoint = lfilter([0.1], [1, -0.9], steps, axis=0)
    rate = lfilter(MODEL[1], MODEL[0], body_rates(setpoint), axis=0)
    thrust, force = 0.3 + lfilter([0.05], [1, -0.95], rng.normal(0, 0.05, n)), np.zeros((n, 3))
    force[:, 2] = -9.81 * lfilter([0.3], [1, -0.7], thrust) / 0.3
    rate[:, :2] += push[:, :2]
    force[:, 2] += push[:, 2]
    rate += rng.normal(0, 0.02, (n, 3))
    force += rng.normal(0, 0.1, (n, 3))
    return example_rows(n, DT_S, setpoint=setpoint, rate=rate, force=force, thrust=thrust)


def wander(seed: int, n: int = N) -> FloatArray:
    """(n, 1) slow noise of unit rms."""
    slow = lfilter([0.1], [1, -0.9], np.random.default_rng([seed, 7]).normal(size=n))
    return np.asarray(slow / slow.std())[:, None]


@pytest.fixture(scope="module")
def spec() -> RotorSignatureSpec:
    return fit([[flown(seed, CALM)] for seed in range(3)], "qdrone2")


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_wandering_rotor_raises_the_statistic_and_is_named(spec: RotorSignatureSpec, rotor: int) -> None:
    roll, pitch, _ = layout_named("qdrone2").signs[rotor - 1]
    push = 0.1 * wander(rotor) * [roll, pitch, -4.0]
    faulty, calm = read(RotorSignature(spec), flown(10, push)), read(RotorSignature(spec), flown(10, CALM))
    assert float(calm.value[calm.valid].max()) < 3.0
    settled = faulty.valid & (faulty.t_ns > 15e9)  # until the window is full healthy values stand for the rest
    assert float(faulty.value[settled].min()) > 5.0
    assert (faulty.rotors[faulty.valid].argmax(axis=1) + 1 == rotor).all()
    assert float(faulty.rotors[settled].max(axis=1).min()) > 0.6


def residuals(motion: HealthyMotion, rows: Rows, follows: bool = True) -> Residuals:
    return residuals_of(motion, samples_of([rows], motion.stride, motion.window)[0], follows)


def test_statistic_follows_its_formula(spec: RotorSignatureSpec) -> None:
    rows = flown(13, 0.1 * wander(5) * [1.0, 1.0, -4.0])
    d, found = residuals(spec.motion, rows), read(RotorSignature(spec), rows)
    n = d.n[-spec.samples :]
    cor = [
        np.sum(n[:, i] * n[:, j]) / np.sqrt(np.sum(n[:, i] ** 2) * np.sum(n[:, j] ** 2))
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    best = 0.0
    for roll, pitch, _ in layout_named("qdrone2").signs:
        S = (roll * pitch * cor[0] - roll * cor[1] - pitch * cor[2]) / 3
        A = np.sqrt(np.mean(((roll * n[:, 0] + pitch * n[:, 1]) / np.sqrt(2)) ** 2))
        B = np.sqrt(np.mean(((pitch * n[:, 0] - roll * n[:, 1]) / np.sqrt(2)) ** 2))
        best = max(best, float(A / max(1.0, B) * np.exp(2 * S)))
    assert found.value[-1] == pytest.approx(best, rel=1e-9)


def test_residuals_are_free_run_by_scipy(spec: RotorSignatureSpec) -> None:
    motion, rows = dataclasses.replace(spec.motion, k0=(1.0, 1.0, 1.0), k1=(0.0, 0.0, 0.0)), flown(14, CALM)
    d = residuals(motion, rows, follows=False)
    alpha = 1 - np.exp(-DT_S / DRIFT_S)
    r = rows.rates.y[:, 0] - lfilter(motion.roll.b, motion.roll.a, rows.rates.u[:, 0])
    r[:150] = 0
    r -= lfilter([alpha], [1, alpha - 1], r)
    np.testing.assert_allclose(d.r[1500:, 0], r[1500:], atol=1e-6)  # the start from the first measured rate dies out
    np.testing.assert_allclose(d.n, np.clip(d.r, -4.0, 4.0))


def test_gain_errors_are_the_recursive_least_squares_of_the_last_seconds(spec: RotorSignatureSpec) -> None:
    """By the definition: weighted least squares with a prior, solved at one instant from all samples before it."""
    rows = flown(19, CALM)
    r, found = residuals(spec.motion, rows, follows=False).r[:, 0], residuals(spec.motion, rows).r[:, 0]
    y_sim = lfilter(spec.motion.roll.b, spec.motion.roll.a, rows.rates.u[:, 0])
    slope, alpha = 0.05 * np.diff(y_sim, prepend=0.0) / DT_S, 1 - np.exp(-DT_S / DRIFT_S)
    F = np.column_stack([x - lfilter([alpha], [1, alpha - 1], x) for x in (y_sim, slope)])
    forget = 1 - np.exp(-DT_S / 10.0)
    for at in (1000, 2000, 2900):
        weights = forget * (1 - forget) ** np.arange(at - 1, -1, -1)
        prior = np.eye(2) * spec.motion.k0[0] * 0.1 / (10.0 * 0.3**2)
        gain = np.linalg.solve((F[:at].T * weights) @ F[:at] + prior, (F[:at].T * weights) @ r[:at])
        assert found[at] == pytest.approx(r[at] - F[at] @ gain, abs=0.02 * float(r.std()))


@pytest.mark.parametrize(("gusts", "gain", "bias"), [(0, 0.85, 0), (0, 1.15, 0.3), (0.06, 1, 0), (0.2, 1, 0)])
def test_gain_bias_and_gusts_are_no_rotor(spec: RotorSignatureSpec, gusts: float, gain: float, bias: float) -> None:
    rows = flown(26, gusts * np.hstack([wander(31), wander(32), 4.0 * wander(33)]))
    rows.rates.y[:] = gain * rows.rates.y + bias  # of the gyro, from the first row on
    found = read(RotorSignature(spec), rows)
    assert float(found.value[found.valid].max()) < 3.0


def test_on_a_plus_frame_the_idle_axis_does_not_count() -> None:
    spec = fit([[flown(seed, CALM)] for seed in range(2)], "plus")
    for rotor, (roll, pitch, _) in enumerate(layout_named("plus").signs, start=1):
        found = read(RotorSignature(spec), flown(15, 0.1 * wander(rotor) * [roll, pitch, -4.0]))
        assert (found.rotors[found.valid].argmax(axis=1) + 1 == rotor).mean() > 0.99


def test_what_cannot_be_judged_is_refused_with_a_reason() -> None:
    blind = example_rows(N, DT_S, rate=np.ones((N, 3)))
    for rows, frame, word in (
        (blind, None, "rotor layout"),
        (blind, "qdrone2", "no accelerometer"),
        (example_rows(3, DT_S), "qdrone2", "no flight"),
    ):
        with pytest.raises(InputError, match=word):
            fit([[rows]], frame)
    (stiff := flown(4, CALM)).rates.u[:, 1] *= 1e-12  # what is left of a set-point that never moved
    with pytest.raises(IdentificationError, match="pitch: u is constant"):
        fit([[stiff]], "qdrone2")
    with pytest.raises(InputError, match="the gyro comes at 20 Hz; 50 Hz are needed, better 100"):
        RotorSignature.need_stream(20.0)
