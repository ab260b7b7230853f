"""Who has a say, how loud, and when nobody is named."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.decision.isolation import Outcome, Voice, Witness, isolate
from mavdiag.errors import UsageError

SHAKING = (0.05, 0.95, -0.45, -0.5)


def witness(monitor: str, ratio: float, *rotors: float, threshold: float = 0.5) -> Witness:
    return Witness(monitor, ratio, threshold, rotors)


def test_the_rotor_that_one_clear_monitor_points_at_is_named() -> None:
    found = isolate([witness("vibration", 3.0, *SHAKING)])
    assert (found.outcome, found.rotor) == (Outcome.NAMED, 2)
    assert found.confidence > 0.99


def test_two_that_contradict_each_other_leave_it_open() -> None:
    found = isolate([witness("vibration", 2.0, 0.9, 0.0, 0.0, 0.0), witness("energy", 2.0, 0.0, 0.9, 0.0, 0.0)])
    assert (found.outcome, found.rotor) == (Outcome.UNDECIDED, None)
    assert found.confidence == pytest.approx(0.5, abs=0.01)


def test_a_small_lead_names_nobody() -> None:
    assert isolate([witness("energy", 1.5, 0.50, 0.45, -0.3, -0.3)]).outcome is Outcome.UNDECIDED


def test_a_monitor_far_below_its_threshold_has_no_say() -> None:
    calm = witness("energy", 0.5, 1.0, -1.0, -1.0, -1.0)
    assert isolate([calm]).outcome is Outcome.SILENT
    assert isolate([calm, witness("vibration", 1.2, *SHAKING)]).rotor == 2


def test_its_say_grows_up_to_the_threshold_and_no_further() -> None:
    confidences = [isolate([witness("energy", ratio, 0.4, 0.0, 0.0, 0.0)]).confidence for ratio in (0.6, 0.8, 1.0, 5.0)]
    assert confidences == sorted(confidences)
    assert confidences[-1] == confidences[-2]


def test_trim_counts_in_units_of_its_threshold() -> None:
    for threshold in (0.02, 0.2):
        rises = [threshold * x for x in (1.5, 0.1, 0.1, -1.5)]
        assert isolate([witness("effort", 1.5, *rises, threshold=threshold)]).rotor == 1


def test_those_who_know_no_rotors_or_are_not_known_are_passed_over() -> None:
    dumb, stranger = witness("innovation", 3.0), witness("none such", 3.0, 1.0, 0.0)
    assert isolate([dumb, stranger]).outcome is Outcome.SILENT
    assert isolate([]).outcome is Outcome.SILENT
    assert isolate([witness("vibration", 3.0, math.nan, 1.0)]).outcome is Outcome.SILENT
    assert isolate([stranger], {"none such": Voice(9.0)}).rotor == 1


def test_six_rotors_are_no_different() -> None:
    assert isolate([witness("vibration", 3.0, 0.0, 0.1, 0.0, 0.0, 0.9, 0.0)]).rotor == 5


def test_a_threshold_must_be_positive() -> None:
    with pytest.raises(UsageError):
        witness("energy", 1.0, threshold=0.0)


@given(
    st.lists(st.tuples(st.sampled_from(["vibration", "energy", "effort"]), st.floats(0, 5),
             st.lists(st.floats(-1, 1), min_size=4, max_size=4)), max_size=4)
)  # fmt: skip
def test_confidence_is_a_probability_and_a_name_needs_enough_of_it(words: list[tuple[str, float, list[float]]]) -> None:
    found = isolate([witness(name, ratio, *rotors) for name, ratio, rotors in words])
    assert 0.0 <= found.confidence <= 1.0 + 1e-12
    assert (found.rotor is not None) == (found.outcome is Outcome.NAMED)
    if found.outcome is not Outcome.SILENT:
        assert found.confidence >= 0.25 - 1e-12
    if found.rotor is not None:
        assert found.confidence >= 0.9
