"""Type and severity from the features: what was trained is found again, what is missing or far gets no name."""

import numpy as np
import pytest

from mavdiag.airframe.propellers import FaultType
from mavdiag.decision.grading import Assessment, FaultTypes, Gathered, assess, known_fault_types
from mavdiag.kernel import EVIDENCE, LAST_LEVEL, LOOK_NS
from mavdiag.monitors.base import Feature
from mavdiag.telemetry import FloatArray
from mavdiag.units import NS_PER_S

TRAINED = ("qdrone2", 1000.0)  # profile and rate of the links that the classifier was trained for
KNOWN = known_fault_types("qdrone2-emulated", *TRAINED)
LATE = max(KNOWN, key=lambda one: one.after_s)


def centre(code: str, strength: float = 1.0) -> FloatArray:
    """The middle of a trained cloud."""
    wanted = (FaultType(code[:2]), int(code[-1]), strength)
    return next(c.mean for c in LATE.clouds if (c.fault_type, c.severity, c.strength) == wanted)


def look(level: float, rotors: tuple[float, ...] = (), count: int = 10) -> FloatArray:
    """What a look found of a feature, the same in every value."""
    sums = [count * one for one in rotors]
    return np.array([1.0, level, count, count * level**2, level, *rotors, *sums])


@pytest.mark.parametrize("link", [("qdrone2", 100.0), ("qdrone2", 500.0), ("ardupilot", 1000.0), ("spec", 1000.0)])
def test_u3_no_fault_type_is_known_without_a_classifier_or_on_other_links(link: tuple[str, float]) -> None:
    """B17: types of one emulated vehicle were reported for any. U3: at 100 Hz four of five names were wrong."""
    assert known_fault_types("qdrone2-emulated", *link) == known_fault_types("another", *TRAINED) == ()
    assert known_fault_types("qdrone2-emulated", "qdrone2", 999.0)


@pytest.mark.parametrize("strength", [1.0, 0.5])
@pytest.mark.parametrize("code", ["F1/SV1", "F1/SV2", "F1/SV3", "F2/SV1", "F3/SV1", "F3/SV3"])
def test_the_middle_of_a_cloud_is_its_fault(code: str, strength: float) -> None:
    found = assess(centre(code, strength), LATE)
    assert found.fault_type == code[:2]
    assert found.severity is not None
    assert abs(found.severity - int(code[-1])) <= 1
    assert (found.confidence or 0.0) > 0.8


def test_the_shares_are_those_of_bayes_by_scipy() -> None:
    from scipy.stats import multivariate_normal

    near = np.add(centre("F3/SV1", 0.5), (0.05, 0.1, 0.2))
    density = [(c.fault_type, multivariate_normal(c.mean, c.covariance).pdf(near)) for c in LATE.clouds]
    found = assess(near, LATE)
    share = sum(one for kind, one in density if kind is found.fault_type) / sum(one for _, one in density)
    assert found.confidence == pytest.approx(share, rel=1e-9)


def test_without_the_trim_the_other_features_decide() -> None:
    assert assess(np.array([*centre("F2/SV2")[:2], np.nan]), LATE).fault_type is FaultType.CRACK
    assert assess(np.array([*centre("F2/SV2")[:1], np.nan, 1.0]), LATE) == Assessment()


def test_what_no_fault_looks_like_or_lies_between_two_types_gets_no_name() -> None:
    assert assess(np.array([np.log(60.0), np.log(2.0), 30.0]), LATE) == Assessment()
    a, b = centre("F2/SV3", 0.5), centre("F3/SV1", 1.0)
    known = FaultTypes(0.0, tuple(c for c in LATE.clouds if c.strength == 1.0))
    named = {assess((1 - weight) * a + weight * b, known).fault_type for weight in np.linspace(0, 1, 60)}
    assert {None, FaultType.SURFACE_UNBALANCE} <= named


def test_only_windows_after_the_declaration_are_gathered() -> None:
    state = Gathered(10 * NS_PER_S)
    for number in range(-50, 100):  # looks after the declaration
        until_ns = state.since_ns + number * LOOK_NS
        state = state.add(Feature.UNBALANCE, look(9.0 if number < 6 else 2.0), until_ns)
        state = state.add(Feature.MOTION, look(9.0 if number < 30 else 0.1), until_ns - LOOK_NS // 2)
        state = state.add(Feature.RISE, look(0.0, (0.0, 0.5 if number < 40 else 0.03, 0.0, 0.0)), until_ns)
    assert state.features(2) == pytest.approx([np.log(2.0), np.log(0.1), 3.0])


def test_of_a_look_that_began_too_early_its_last_value_counts() -> None:
    mixed = look(9.0, (0.9, 0.9))
    mixed[LAST_LEVEL], mixed[EVIDENCE : EVIDENCE + 2] = 2.0, (0.1, 0.2)
    state = Gathered(0).add(Feature.UNBALANCE, mixed, round(0.65 * NS_PER_S))
    found = state.add(Feature.RISE, mixed, 4 * NS_PER_S).features(2)
    assert found == pytest.approx([np.log(2.0), np.nan, 20.0], nan_ok=True)


def test_9_the_rise_is_that_of_the_rotor_that_is_named_at_last() -> None:
    """Rises of two rotors were averaged when the name changed: a true 0.0 was 0.15."""
    state = Gathered(0).add(Feature.RISE, look(0.0, (0.1, 0.3)), 5 * NS_PER_S)
    assert [state.features(rotor)[2] for rotor in (1, 2)] == pytest.approx([10.0, 30.0])
    assert np.isnan([state.features(None), state.features(3)]).all()
