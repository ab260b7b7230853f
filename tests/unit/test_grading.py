"""Type and severity from the features: what was trained is found again, what is missing or far is said to be so."""

import math

import numpy as np
import pytest

from mavdiag.airframe.propellers import FaultType
from mavdiag.decision import grading
from mavdiag.decision.grading import (
    FaultTypes,
    Features,
    Gathered,
    Outcome,
    assess,
    known_fault_types,
    parse_fault_types,
)
from mavdiag.errors import InputError
from mavdiag.kernel import EVIDENCE, LAST_LEVEL, LOOK_NS
from mavdiag.monitors.base import Feature
from mavdiag.units import NS_PER_S

TRAINED = ("qdrone2", 1000.0)  # profile and rate of the links that the classifier was trained for
KNOWN = known_fault_types("qdrone2-emulated", *TRAINED)
LATE = max(KNOWN, key=lambda one: one.after_s)


def centre(code: str, strength: float = 1.0) -> Features:
    """The middle of a trained cloud."""
    kind, level = FaultType(code[:2]), int(code[-1])
    cloud = next(c for c in LATE.clouds if (c.fault_type, c.severity, c.strength) == (kind, level, strength))
    return Features(math.exp(cloud.mean[0]), math.exp(cloud.mean[1]), float(cloud.mean[2]) / 100)


def look(level: float, rotors: tuple[float, ...] = (), count: int = 10) -> np.ndarray:
    """What a look found of a feature, the same in every value."""
    sums = [count * one for one in rotors]
    return np.array([1.0, level, count, count * level**2, level, *rotors, *sums])


@pytest.mark.parametrize("classifier", [None, "another"])
def test_b17_without_a_classifier_no_fault_type_is_known(classifier: str | None) -> None:
    """B17: types trained on one emulated vehicle were reported for any."""
    assert known_fault_types(classifier, *TRAINED) == ()


@pytest.mark.parametrize("link", [("qdrone2", 100.0), ("qdrone2", 500.0), ("ardupilot", 1000.0), ("spec", 1000.0)])
def test_u3_on_a_link_that_it_was_not_trained_for_no_fault_type_is_known(link: tuple[str, float]) -> None:
    """U3: at 100 Hz four of five names were wrong, with a confidence of 1.0."""
    assert known_fault_types("qdrone2-emulated", *link) == ()
    assert known_fault_types("qdrone2-emulated", "qdrone2", 999.0)


def test_the_packaged_parameters_hold_nine_faults_at_three_strengths_and_say_what_they_are() -> None:
    assert [one.after_s for one in KNOWN] == [3.0, 8.0]
    for one in KNOWN:
        assert len({(c.fault_type, c.severity, c.strength) for c in one.clouds}) == 27
        assert "emulated" in one.trained_on


@pytest.mark.parametrize("strength", [1.0, 0.5])
@pytest.mark.parametrize("code", ["F1/SV1", "F1/SV2", "F1/SV3", "F2/SV1", "F3/SV1", "F3/SV3"])
def test_the_middle_of_a_cloud_is_its_fault(code: str, strength: float) -> None:
    found = assess(centre(code, strength), LATE)
    assert (found.outcome, found.fault_type) == (Outcome.NAMED, code[:2])
    assert found.severity is not None
    assert abs(found.severity - int(code[-1])) <= 1
    assert found.confidence is not None
    assert found.confidence > 0.8


def test_the_shares_are_those_of_bayes_by_scipy() -> None:
    from scipy.stats import multivariate_normal

    near = np.add(centre("F3/SV1", 0.5).vector, (0.05, 0.1, 0.2))
    features = Features(math.exp(near[0]), math.exp(near[1]), near[2] / 100)
    density = {
        (c.fault_type, c.severity, c.strength): multivariate_normal(c.mean, c.covariance).pdf(features.vector)
        for c in LATE.clouds
    }
    total = sum(density.values())
    found = assess(features, LATE)
    share = sum(v for k, v in density.items() if k[0] is found.fault_type) / total
    assert found.confidence == pytest.approx(share, rel=1e-9)


def test_without_the_trim_the_other_features_decide() -> None:
    full = centre("F2/SV2")
    found = assess(Features(full.unbalance_g_mm, full.motion_rad_s), LATE)
    assert found.fault_type is FaultType.CRACK


def test_what_no_fault_looks_like_gets_no_name() -> None:
    found = assess(Features(60.0, 2.0, 0.3), LATE)
    assert (found.outcome, found.fault_type, found.severity) == (Outcome.FAR, None, None)
    assert found.distance is not None
    assert found.distance > grading.FAR


def test_between_two_types_none_is_named() -> None:
    a, b = centre("F2/SV3", 0.5), centre("F3/SV1", 1.0)
    known = FaultTypes(0.0, tuple(c for c in LATE.clouds if c.strength == 1.0), "")
    outcomes = set()
    for weight in np.linspace(0, 1, 60):
        x = (1 - weight) * a.vector + weight * b.vector
        outcomes.add(assess(Features(math.exp(x[0]), math.exp(x[1]), x[2] / 100), known).outcome)
    assert Outcome.NAMED in outcomes
    assert outcomes & {Outcome.BETWEEN, Outcome.FAR}


def test_only_windows_after_the_declaration_are_gathered() -> None:
    state = Gathered(10 * NS_PER_S)
    for number in range(-50, 100):  # looks after the declaration
        until_ns = state.since_ns + number * LOOK_NS
        state = state.add(Feature.UNBALANCE, look(9.0 if number < 6 else 2.0), until_ns)
        state = state.add(Feature.MOTION, look(9.0 if number < 30 else 0.1), until_ns - LOOK_NS // 2)
        state = state.add(Feature.RISE, look(0.0, (0.0, 0.5 if number < 40 else 0.03, 0.0, 0.0)), until_ns)
    found = state.features(2)
    assert found.unbalance_g_mm == pytest.approx(2.0)
    assert found.motion_rad_s == pytest.approx(0.1)
    assert found.rise == pytest.approx(0.03)


def test_of_a_look_that_began_too_early_its_last_value_counts() -> None:
    mixed = look(9.0, (0.9, 0.9))
    mixed[LAST_LEVEL], mixed[EVIDENCE : EVIDENCE + 2] = 2.0, (0.1, 0.2)
    state = Gathered(0).add(Feature.UNBALANCE, mixed, round(0.65 * NS_PER_S))
    assert state.add(Feature.RISE, mixed, 4 * NS_PER_S).features(2) == Features(2.0, None, 0.2)


def test_9_the_rise_is_that_of_the_rotor_that_is_named_at_last() -> None:
    """Rises of two rotors were averaged when the name changed: a true 0.0 was 0.15."""
    state = Gathered(0).add(Feature.RISE, look(0.0, (0.1, 0.3)), 5 * NS_PER_S)
    assert [state.features(rotor).rise for rotor in (1, 2)] == pytest.approx([0.1, 0.3])
    assert state.features(None) == state.features(3) == Features()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        '{"schema": "other/1"}',
        '{"schema": "mavdiag.fault_types/1", "trained_on": "", "profiles": [], "rate_hz": 1, "tables": [{}]}',
    ],
)
def test_a_damaged_file_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="fault types"):
        parse_fault_types(text)
