"""Whose evidence counts, how much, and when no rotor is named."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_statistics import made_slot

from mavdiag.decision.kinds import Reading, isolate
from mavdiag.monitors import MONITORS
from mavdiag.monitors.base import RotorEvidence
from mavdiag.monitors.rotor_signature import RotorSignature
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.monitors.unbalance import Unbalance

SHAKING = (0.05, 0.95, -0.45, -0.5)
DIRECT = [kind for kind in MONITORS if kind.evidence is not None]


def reading(how: RotorEvidence | None, ratio: float, threshold: float, rotors: tuple[float, ...]) -> Reading:
    return Reading(made_slot("any", threshold, evidence=how), ratio, rotors=rotors)


def of(kind: type[Unbalance | RotorSignature | RotorTrim], ratio: float, *rotors: float) -> Reading:
    return reading(kind.evidence, ratio, 0.5, rotors)


def test_the_rotor_that_one_clear_monitor_points_at_is_named() -> None:
    found = isolate([of(Unbalance, 3.0, *SHAKING)])
    assert found.rotor == 2
    assert found.confidence > 0.99


def test_two_that_contradict_each_other_name_none() -> None:
    how = RotorEvidence(8.0)
    found = isolate([reading(how, 2.0, 0.5, (0.9, 0, 0, 0)), reading(how, 2.0, 0.5, (0, 0.9, 0, 0))])
    assert found.rotor is None
    assert found.confidence == pytest.approx(0.5, abs=0.01)


def test_a_small_lead_names_none() -> None:
    found = isolate([of(RotorSignature, 1.5, 0.50, 0.45, -0.3, -0.3)])
    assert found.rotor is None
    assert found.confidence > 0.25


def test_a_monitor_far_below_its_threshold_does_not_count() -> None:
    calm = of(RotorSignature, 0.5, 1.0, -1.0, -1.0, -1.0)
    assert isolate([calm]).confidence == 0.0
    assert isolate([calm, of(Unbalance, 1.2, *SHAKING)]).rotor == 2


def test_its_weight_grows_up_to_the_threshold_and_no_further() -> None:
    found = [isolate([of(RotorSignature, ratio, 0.4, 0.0, 0.0, 0.0)]).confidence for ratio in (0.6, 0.8, 1.0, 5.0)]
    assert found == sorted(found)
    assert found[-1] == found[-2]


def test_trim_counts_in_units_of_its_threshold() -> None:
    how = RotorTrim.evidence
    for threshold in (0.02, 0.2):
        rises = tuple(threshold * x for x in (1.5, 0.1, 0.1, -1.5))
        assert isolate([reading(how, 1.5, threshold, rises)]).rotor == 1


def test_trim_does_not_count_while_the_damage_itself_is_observed() -> None:
    trim = of(RotorTrim, 3.0, 2.0, -1.0, -1.0, -1.0)
    assert isolate([trim]).rotor == 1
    assert isolate([trim, of(Unbalance, 0.9, *SHAKING)]).rotor != 2
    assert isolate([trim, of(Unbalance, 1.1, *SHAKING)]).rotor == 2


def test_evidence_that_is_empty_or_not_finite_does_not_count() -> None:
    assert isolate([]).confidence == 0.0
    assert isolate([of(Unbalance, 3.0)]).confidence == 0.0
    assert isolate([of(Unbalance, 3.0, math.nan, 1.0)]).confidence == 0.0
    assert isolate([of(RotorTrim, 1.5, 1.0, -1.0, -1.0, -1.0), of(Unbalance, 3.0)]).rotor == 1


def test_six_rotors_are_no_different() -> None:
    assert isolate([of(Unbalance, 3.0, 0.0, 0.1, 0.0, 0.0, 0.9, 0.0)]).rotor == 5


@given(
    st.lists(
        st.tuples(st.sampled_from(DIRECT), st.floats(0, 5), st.lists(st.floats(-1, 1), min_size=4, max_size=4)),
        max_size=4,
    )
)
def test_confidence_is_a_probability_and_a_name_needs_enough_of_it(
    readings: list[tuple[type[Unbalance], float, list[float]]],
) -> None:
    found = isolate([of(kind, ratio, *rotors) for kind, ratio, rotors in readings])
    assert found.confidence == 0.0 or 0.25 - 1e-12 <= found.confidence <= 1.0 + 1e-12
    assert (found.rotor is not None) == (found.confidence >= 0.9)


def test_16_monitors_of_different_layouts_do_not_end_the_session() -> None:
    """It raised a ValueError, which ended the daemon."""
    four = reading(RotorEvidence(8.0), 4.0, 0.5, (0.1, 0.9, -0.4, -0.5))
    three = reading(RotorEvidence(8.0), 4.0, 0.5, (0.9, 0.1, -0.4))
    assert isolate([three, four, three]).rotor == isolate([four]).rotor == 2
