"""The thesis's plane on synthetic clusters: what is named, and what is honestly not."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from mavdiag.airframe.propellers import FaultType, propeller
from mavdiag.errors import InputError, UsageError
from mavdiag.monitors.run_length import Run

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from thesis_plane_rules import (
    Classification,
    Example,
    FaultPoint,
    HealthyScale,
    Outcome,
    ThesisPlane,
    classify,
    fault_point,
    fit_plane,
)

F1, F2, F3 = FaultType
# FSD [s] and excess [rad/s] by type as T Fig 5.10 and Table 5.2 describe them: F1 short and low, F2 long and high, F3
# long and rising with severity. FML 0.118 s, margin 0.02 rad/s.
SCALE = HealthyScale(fml_s=0.118, margin_rad_s=0.02)
TRACES = {F1: (0.18, (0.040, 0.040, 0.040)), F2: (0.41, (0.150, 0.150, 0.150)), F3: (0.34, (0.060, 0.080, 0.135))}


def examples(seed: int, flights: int, noise: float = 0.08) -> list[Example]:
    """`flights` noisy flights of each of the nine faults."""
    rng = np.random.default_rng(seed)
    found = []
    for fault_type, (fsd_s, excesses) in TRACES.items():
        for severity, excess in enumerate(excesses, start=1):
            unbalance = propeller(fault_type, severity).unbalance_g_mm
            for _ in range(flights):
                u, v = np.exp(noise * rng.standard_normal(2)).tolist()
                point = FaultPoint.scaled(fsd_s * u, excess * v, SCALE)
                found.append(Example(point, fault_type, severity, unbalance))
    return found


def at(fsd_s: float, excess_rad_s: float, plane: ThesisPlane) -> Classification:
    return classify(plane, FaultPoint.scaled(fsd_s, excess_rad_s, SCALE))


@pytest.mark.parametrize("seed", range(5))
def test_separate_types_are_named_with_confidence(seed: int) -> None:
    plane = fit_plane(examples(seed, flights=6))
    for fault_type, (fsd_s, excesses) in TRACES.items():
        found = at(fsd_s, excesses[1], plane)
        assert (found.outcome, found.fault_type) == (Outcome.NAMED, fault_type), f"seed {seed}"
        assert found.confidence is not None
        assert found.confidence > 0.9


@pytest.mark.parametrize("seed", range(5))
def test_severity_is_read_where_the_excess_rises_and_unknown_where_it_is_flat(seed: int) -> None:
    plane = fit_plane(examples(seed, flights=8, noise=0.05))
    slopes = {trend.fault_type: trend.slope / trend.slope_error for trend in plane.trends}
    assert slopes[F3] > 5 > max(slopes[F1], slopes[F2]), f"seed {seed}"
    assert at(0.34, 0.135, plane).severity == 3, f"seed {seed}"
    assert at(0.41, 0.150, plane).fault_type is F2
    assert at(0.41, 0.150, plane).severity is None, f"seed {seed}"
    assert at(0.41, 0.150, plane).severity_confidence is None


def test_a_line_without_noise_gives_every_severity() -> None:
    rising = [Example(FaultPoint(3.0, 2.0 * level), F3, level, float(level)) for level in (1, 2, 3) for _ in range(3)]
    other = [Example(FaultPoint(1.5, 1.0), F1, 1) for _ in range(3)]
    plane = fit_plane(rising + other)
    (trend,) = plane.trends  # F1 was not weighed
    assert trend.slope == pytest.approx(2.0)
    assert trend.intercept == pytest.approx(0.0, abs=1e-12)
    for level in (1, 2, 3):
        found = classify(plane, FaultPoint(3.0, 2.0 * level))
        assert (found.fault_type, found.severity) == (F3, level)
    assert classify(plane, FaultPoint(1.5, 1.0)).severity is None


def test_a_falling_line_names_no_severity() -> None:
    falling = [Example(FaultPoint(3.0, 8.0 - 2 * level), F3, level, float(level)) for level in (1, 2, 3)] * 3
    plane = fit_plane([*falling, Example(FaultPoint(1.5, 1.0), F1, 1)])
    found = classify(plane, FaultPoint(3.0, 4.0))
    assert (found.fault_type, found.severity) == (F3, None)


def test_a_trace_like_none_of_the_known_ones_is_unknown() -> None:
    plane = fit_plane(examples(1, flights=6))
    found = at(4.0, 3.0, plane)
    assert found.outcome is Outcome.FAR
    assert (found.fault_type, found.confidence, found.severity) == (None, None, None)
    assert found.distance is not None
    assert found.distance > 4


def test_a_trace_midway_between_two_types_is_unknown() -> None:
    near, far = FaultPoint(2.0, 2.0), FaultPoint(4.0, 2.0)
    several = [Example(FaultPoint(2.0, k), F1, 1) for k in (1.8, 2.0, 2.2)]
    several += [Example(FaultPoint(4.0, k), F2, 1) for k in (1.8, 2.0, 2.2)]
    several += [Example(FaultPoint(p.duration * k, 2.0), t, 1) for p, t in ((near, F1), (far, F2)) for k in (0.7, 1.43)]
    found = classify(fit_plane(several), FaultPoint(math.sqrt(8.0), 2.0))
    assert found.outcome is Outcome.BETWEEN
    assert found.fault_type is None


def test_identical_clusters_tie_and_nothing_is_named() -> None:
    same = [Example(FaultPoint(2.0, k), one, 1) for one in FaultType for k in (1.5, 2.0, 2.5)]
    assert classify(fit_plane(same), FaultPoint(2.0, 2.0)).outcome is Outcome.BETWEEN


@pytest.mark.parametrize("duration", [0.2, 1.0])
def test_a_run_that_does_not_exceed_the_fml_is_noise(duration: float) -> None:
    plane = fit_plane(examples(1, flights=3))
    assert classify(plane, FaultPoint(duration, 5.0)) == Classification(Outcome.NOT_SIGNIFICANT)
    noisy = [*examples(1, flights=3), Example(FaultPoint(duration, 5.0), F1, 1, 1.0)]
    assert fit_plane(noisy).clusters == plane.clusters
    assert fit_plane(noisy).ignored == 1


def test_the_point_of_a_flight_is_its_longest_run() -> None:
    runs = [Run(0, 1, 0.20, 0.5), Run(2, 3, 0.40, 0.1), Run(4, 5, 0.40, 0.3)]
    found = fault_point(runs, HealthyScale(0.1, 0.1))
    assert found is not None
    assert (found.duration, found.excess) == pytest.approx((4.0, 3.0))
    assert fault_point(runs, HealthyScale(0.4, 0.1)) is None
    assert fault_point([], HealthyScale(0.4, 0.1)) is None


def test_one_in_a_hundred_true_points_is_refused() -> None:
    rng = np.random.default_rng(11)

    def drawn(centre: float) -> FaultPoint:
        duration, excess = np.exp(centre + 0.1 * rng.standard_normal(2)).tolist()
        return FaultPoint(duration, excess)

    refused = 0
    for _ in range(400):
        learnt = [Example(drawn(1.0), F1, 1) for _ in range(6)] + [Example(drawn(9.0), F3, 1) for _ in range(6)]
        plane = fit_plane(learnt)
        refused += sum(classify(plane, drawn(1.0)).outcome is Outcome.FAR for _ in range(10))
    assert 0.003 < refused / 4000 < 0.03, "seed 11"


def test_a_plane_needs_two_types_and_repeats() -> None:
    one = Example(FaultPoint(2.0, 2.0), F1, 1)
    for too_few in ([], [one, one], [one, Example(FaultPoint(3.0, 3.0), F2, 1)]):
        with pytest.raises(InputError, match="two types"):
            fit_plane(too_few)


def test_nonsense_is_refused() -> None:
    for fml_s, margin in ((0.0, 1.0), (1.0, -1.0), (math.nan, 1.0)):
        with pytest.raises(UsageError, match="positive"):
            HealthyScale(fml_s, margin)
    for duration, excess in ((0.0, 1.0), (1.0, 0.0), (math.inf, 1.0)):
        with pytest.raises(UsageError, match="positive"):
            FaultPoint(duration, excess)
    for severity, unbalance in ((0, 1.0), (4, 1.0), (1, -1.0), (1, math.inf)):
        with pytest.raises(UsageError, match="severity 1-3"):
            Example(FaultPoint(2.0, 2.0), F1, severity, unbalance)
