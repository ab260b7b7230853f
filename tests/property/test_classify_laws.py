"""Laws of the thesis's plane: order, units and ties do not matter, and shares behave."""

import sys
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.airframe.propellers import FaultType

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from thesis_plane_rules import (
    MIN_SHARE,
    Example,
    FaultPoint,
    HealthyScale,
    Outcome,
    classify,
    fit_plane,
)

ratios = st.floats(1.05, 50.0)
points = st.builds(FaultPoint, ratios, ratios)
extra = st.lists(
    st.builds(Example, points, st.sampled_from(FaultType), st.sampled_from((1, 2, 3)), st.floats(0, 6)), max_size=12
)
ANCHORS = [
    Example(FaultPoint(1.5, 2.0), FaultType.EDGE_CUT, 1, 1.4),
    Example(FaultPoint(1.6, 2.1), FaultType.EDGE_CUT, 2, 5.1),
    Example(FaultPoint(3.5, 7.0), FaultType.CRACK, 1, 0.2),
    Example(FaultPoint(3.6, 7.5), FaultType.CRACK, 2, 2.7),
]


@given(others=extra, point=points, shuffle=st.randoms(use_true_random=False))
def test_the_order_of_the_examples_does_not_matter(others: list[Example], point: FaultPoint, shuffle: Random) -> None:
    given_order = ANCHORS + others
    mixed = list(given_order)
    shuffle.shuffle(mixed)
    assert fit_plane(mixed) == fit_plane(given_order)
    assert classify(fit_plane(mixed), point) == classify(fit_plane(given_order), point)


@given(
    traces=st.lists(st.tuples(st.floats(0.05, 5.0), st.floats(0.01, 2.0)), min_size=6, max_size=12),
    time=st.floats(0.1, 10.0),
    rate=st.floats(0.1, 10.0),
)
def test_another_airframe_with_the_same_ratios_gives_the_same_answer(
    traces: list[tuple[float, float]], time: float, rate: float
) -> None:
    small, large = HealthyScale(0.02, 0.01), HealthyScale(0.02 * time, 0.01 * rate)
    here = [FaultPoint.scaled(fsd_s, excess, small) for fsd_s, excess in traces]
    there = [FaultPoint.scaled(fsd_s * time, excess * rate, large) for fsd_s, excess in traces]
    types = tuple(FaultType)
    one = fit_plane(Example(point, types[i % 2], 1 + i % 3) for i, point in enumerate(here))
    two = fit_plane(Example(point, types[i % 2], 1 + i % 3) for i, point in enumerate(there))
    assert one.spread == pytest.approx(two.spread, rel=1e-6)
    for a, b in zip(one.clusters, two.clusters, strict=True):
        assert a.fault_type is b.fault_type
        assert a.centroid == pytest.approx(b.centroid, rel=1e-6, abs=1e-9)


@given(others=extra, point=points)
def test_what_is_named_is_the_nearest_and_has_its_share(others: list[Example], point: FaultPoint) -> None:
    found = classify(fit_plane(ANCHORS + others), point)
    named = found.outcome is Outcome.NAMED
    assert (found.fault_type is not None) == (found.confidence is not None) == named
    assert (found.severity is not None) == (found.severity_confidence is not None)
    for share in (found.confidence, found.severity_confidence):
        assert share is None or MIN_SHARE <= share <= 1.0
    assert found.severity is None or named


@given(point=points)
def test_a_plane_is_mirrored_with_its_types(point: FaultPoint) -> None:
    """Swapping the names of two types swaps the answer: no type is preferred."""
    swap = {FaultType.EDGE_CUT: FaultType.CRACK, FaultType.CRACK: FaultType.EDGE_CUT}
    swapped = [Example(one.point, swap[one.fault_type], one.severity, one.unbalance_g_mm) for one in ANCHORS]
    found, other = classify(fit_plane(ANCHORS), point), classify(fit_plane(swapped), point)
    assert found.outcome is other.outcome
    assert found.fault_type is None or other.fault_type is swap[found.fault_type]
