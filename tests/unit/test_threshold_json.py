"""Specs and thresholds are plain data: a baseline can hold, validate and write them as they are."""

from typing import Any

import pytest
from flying_telemetry import flying, flying_rows
from pydantic import TypeAdapter, ValidationError

from mavdiag.airframe.layout import layout_named
from mavdiag.monitors import innovation, rotor_trim, vibration_level
from mavdiag.thresholds.heldout import Scores, score
from mavdiag.thresholds.rule import Threshold, threshold_of

FLIGHT = flying_rows(flying(3000, 1))
SPECS: list[Any] = [
    rotor_trim.fit([FLIGHT], layout_named("x")),
    innovation.fit([FLIGHT]),
    vibration_level.fit([FLIGHT]),
]


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.kind)
def test_a_spec_survives_json(spec: Any) -> None:
    adapter = TypeAdapter(type(spec))
    assert adapter.validate_json(adapter.dump_json(spec)) == spec
    with pytest.raises(ValidationError, match="kind"):
        adapter.validate_python({**adapter.dump_python(spec), "kind": "another"})


def test_a_threshold_survives_json() -> None:
    scores: Scores = score(vibration_level.VibrationLevel(SPECS[2]), FLIGHT)
    found = threshold_of(scores, flights=1)
    adapter = TypeAdapter(Threshold)
    assert adapter.validate_json(adapter.dump_json(found)) == found
