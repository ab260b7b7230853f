"""The thesis's plane on synthetic clusters: what is named, and what is honestly not."""

import sys
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.propellers import FaultType, propeller

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from thesis_plane_rules import (
    Classification,
    Example,
    FaultPoint,
    HealthyScale,
    Outcome,
    ThesisPlane,
    classify,
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


ratios = st.floats(1.05, 50.0)
points = st.builds(FaultPoint, ratios, ratios)
ANCHORS = [
    Example(FaultPoint(1.5, 2.0), F1, 1),
    Example(FaultPoint(1.6, 2.1), F1, 2),
    Example(FaultPoint(3.5, 7.0), F2, 1),
]
extra = st.lists(st.builds(Example, points, st.sampled_from(FaultType), st.sampled_from((1, 2, 3))), max_size=12)


@given(others=extra, point=points, shuffle=st.randoms(use_true_random=False))
def test_neither_the_order_nor_the_names_of_the_types_matter(
    others: list[Example], point: FaultPoint, shuffle: Random
) -> None:
    known = ANCHORS + others
    mixed = list(known)
    shuffle.shuffle(mixed)
    found = classify(fit_plane(known), point)
    assert classify(fit_plane(mixed), point) == found
    assert (found.fault_type is not None) == (found.confidence is not None) == (found.outcome is Outcome.NAMED)
    swap = {F1: F2, F2: F1}
    other = classify(fit_plane([Example(one.point, swap[one.fault_type], one.severity) for one in ANCHORS]), point)
    own = classify(fit_plane(ANCHORS), point)
    assert own.outcome is other.outcome
    assert own.fault_type is None or other.fault_type is swap[own.fault_type]
