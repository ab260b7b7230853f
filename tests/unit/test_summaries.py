"""What fits gather of flights one by one, against plain numpy over the rows of all flights together."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flying_telemetry import DT_S, flying, flying_rows, without
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext, segments
from mavdiag.monitors.decimated import samples_of
from mavdiag.monitors.healthy import joined_moments, moments, smoothed, three, variance_law_of
from mavdiag.monitors.innovation import Innovation
from mavdiag.monitors.model_residual import HealthyMotion, residuals_of
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.monitors.run_length import RunLength, margin_of, residuals
from mavdiag.monitors.sensor_noise import SensorNoise
from mavdiag.monitors.thrust_loss import ThrustLoss
from mavdiag.monitors.vibration_level import VibrationLevel
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import forgetting

CONTEXT = LearnContext(Airframe(layout=layout_named("x")), None, DT_S, 11)


@cache
def flights() -> list[list[Rows]]:
    """Three flights, one of them with two breaks and losses."""
    broken = without(flying(3000, 2), (8.0, 9.5), (15.0, 15.2), (20.0, 22.0))
    return [flying_rows(one) for one in (flying(2600, 1), broken, flying(2800, 3))]


def joined(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A column of all valid rows, and the rows of all flights."""
    blocks = [rows.block for flight in flights() for rows in flight]
    return np.concatenate([getattr(one, name)[one.valid] for one in blocks]), np.array([len(one) for one in blocks])


@given(st.lists(st.lists(st.floats(-1e3, 1e3), max_size=9), min_size=1, max_size=5).filter(any), st.floats(-1e3, 1e3))
def test_moments_join_as_the_rows_do(parts: list[list[float]], centre: float) -> None:
    found = joined_moments([moments(np.array(part).reshape(-1, 1)) for part in parts])
    rows = np.concatenate([np.array(part) for part in parts])
    assert found.count == len(rows)
    assert found.mean[0] == pytest.approx(rows.mean(), abs=1e-9)
    assert found.squares[0] == pytest.approx(np.square(rows - rows.mean()).sum(), rel=1e-9, abs=1e-6)
    about = float(found.about(np.array([centre]))[0])
    assert about == pytest.approx(np.square(rows - centre).mean(), rel=1e-9, abs=1e-6)


@given(st.integers(0, 999), st.floats(-2.0, 2.0))
def test_the_variance_law_from_means_is_the_non_negative_least_squares(seed: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    busy = rng.exponential(1.0, 200)
    squares = np.maximum(1.0 + slope * busy + 0.1 * rng.standard_normal(200), 0.01)
    k0, k1 = variance_law_of(squares.mean(), busy.mean(), (busy * busy).mean(), (busy * squares).mean())
    (least0, least1), _ = nnls(np.column_stack((np.ones(200), busy)), squares)
    assert k1 == pytest.approx(least1, rel=1e-6, abs=1e-9)
    assert k0 == pytest.approx(max(least0, 0.05 * squares.mean()), rel=1e-6)


def test_means_of_all_rows() -> None:
    (noise,) = SensorNoise.fit(flights(), CONTEXT)
    (loss,) = ThrustLoss.fit(flights(), CONTEXT)
    (vibration,) = VibrationLevel.fit(flights(), CONTEXT)
    force, _ = joined("force")
    thrust, _ = joined("thrust")
    known = np.isfinite(thrust)
    assert loss.per_command == pytest.approx((-force[known, 2] / thrust[known]).mean(), rel=1e-12)
    shaken, _ = joined("vibration")
    shaken = shaken[np.isfinite(shaken).all(axis=1)]
    assert vibration.healthy == pytest.approx(np.linalg.norm(shaken, axis=1).mean(), rel=1e-12)
    fourth = [
        np.diff(np.column_stack((rows.block.rate, rows.block.force)), n=4, axis=0)[
            np.convolve(rows.block.valid, np.ones(5), "valid") == 5
        ]
        for flight in flights()
        for rows in flight
        if len(rows.block) > 50
    ]
    assert noise.rms == pytest.approx(np.sqrt(np.mean(np.concatenate(fourth) ** 2, axis=0)), rel=1e-2)


def test_the_trim_of_all_windows() -> None:
    (spec,) = RotorTrim.fit(flights(), CONTEXT)
    layout = layout_named("x")
    means = []
    for flight in flights():
        found = []
        for segment in segments(flight):
            outputs = np.concatenate([one.block.actuator for one in segment])
            valid = np.concatenate([one.block.valid for one in segment]) & np.isfinite(outputs).all(axis=1)
            trim = (outputs / outputs.mean(axis=1, keepdims=True) - 1.0) @ layout.unmixing.T
            full = np.convolve(valid, np.ones(500), "valid") == 500
            windows = np.stack([np.convolve(np.where(valid, one, 0.0), np.ones(500) / 500, "valid") for one in trim.T])
            found.append(windows.T[full])
        means.append(np.concatenate(found))
    mu = np.mean([one.mean(axis=0) for one in means], axis=0)
    rms = np.sqrt(np.mean(np.square(np.concatenate(means) - mu), axis=0))
    assert spec.mean == pytest.approx(mu, abs=2e-4)  # ticks are medians, without what a turn takes
    yaw = np.hypot(rms[2], 0.002)
    assert spec.spread == pytest.approx((max(rms[0], 3 * yaw), max(rms[1], 3 * yaw), yaw), rel=0.05)


def test_the_margin_is_that_of_the_residuals_of_all_rows() -> None:
    for spec in RunLength.fit(flights(), CONTEXT):
        model = spec.model.model()
        stepped = margin_of([residuals(flight, spec.axis, model) for flight in flights()])
        assert spec.margin_rad_s == pytest.approx(stepped, rel=1e-9)


def test_the_variances_are_those_of_the_residuals_of_all_rows() -> None:
    (spec,) = RotorSignature.fit(flights(), CONTEXT)
    motion = spec.motion
    first = replace(motion, k0=(1.0, 1.0, 1.0), k1=(0.0, 0.0, 0.0))
    for follows in (False, True):
        k0, k1 = laws(first, follows).T
        first = replace(first, k0=three(k0), k1=three(k1))
    assert motion.k0 == pytest.approx(first.k0, rel=1e-6)
    assert motion.k1 == pytest.approx(first.k1, rel=1e-6, abs=1e-12)


def laws(motion: HealthyMotion, follows: bool) -> np.ndarray:
    """k0 and k1 of roll, pitch and heave, (3, 2), of the residuals of all flights."""
    squares, busy = [], []
    for segment in (segment for flight in flights() for segment in segments(flight)):
        found = residuals_of(motion, samples_of(segment, motion.stride, motion.window), follows)
        squares.append(found.r[found.valid] ** 2)
        busy.append(found.busy[found.valid])
    r2, u2 = np.concatenate(squares), np.concatenate(busy)
    means = (r2.mean(axis=0), u2.mean(axis=0), (u2 * u2).mean(axis=0), (u2 * r2).mean(axis=0))
    return np.array([variance_law_of(*(float(one[axis]) for one in means)) for axis in range(3)])


def test_whole_records_are_smoothed_as_a_stream_is() -> None:
    x, alpha, s = np.random.default_rng(1).normal(size=(50, 2)), forgetting(0.35, 0.01), np.array([1.0, -1.0])
    found = smoothed(x, alpha, s)
    for row, value in zip(x, found, strict=True):
        s = s + alpha * (row - s)
        np.testing.assert_allclose(value, s, rtol=1e-12)
    assert len(smoothed(x[:0], alpha)) == 0


def test_the_innovation_s_share_is_of_every_stretch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavdiag.monitors.innovation.TRAIN_ROWS", 1500)
    summaries = [Innovation.gather(flight, CONTEXT) for flight in flights()]
    (some,) = Innovation.settle(summaries, CONTEXT)
    pairs = [one for summary in summaries for one in np.split(summary[3], np.cumsum(summary[1])[:-1])]
    share = 1500 / sum(int(one.sum()) for one in pairs)
    monkeypatch.undo()
    cut = [shortened(summary, share) for summary in summaries]
    (same,) = Innovation.settle(cut, CONTEXT)
    assert same == some


def shortened(summary: tuple[np.ndarray, ...], share: float) -> tuple[np.ndarray, ...]:
    """A summary in which so large a share of the valid pairs of each stretch stays valid, the first of them."""
    flags, lengths, rows, valid, busy = summary
    kept = valid.copy()
    for part in np.split(kept, np.cumsum(lengths)[:-1]):
        part[np.cumsum(part) > round(share * int(part.sum()))] = False
    return flags, lengths, rows, kept, busy
