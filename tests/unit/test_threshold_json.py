"""Specs and thresholds are plain data: a baseline can hold, validate and write them as they are."""

from typing import Any

import pytest
from flying_telemetry import flying, flying_rows
from pydantic import TypeAdapter, ValidationError

from mavdiag.diagnose.geometry import frame_named
from mavdiag.diagnose.heldout import Scores, score
from mavdiag.diagnose.monitors import effort, innovation, shake
from mavdiag.diagnose.threshold import Threshold, threshold_of

FLIGHT = flying_rows(flying(3000, 1))
SPECS: list[Any] = [effort.fit([FLIGHT], frame_named("x")), innovation.fit([FLIGHT]), shake.fit([FLIGHT])]


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.kind)
def test_a_spec_survives_json(spec: Any) -> None:
    adapter = TypeAdapter(type(spec))
    assert adapter.validate_json(adapter.dump_json(spec)) == spec
    with pytest.raises(ValidationError, match="kind"):
        adapter.validate_python({**adapter.dump_python(spec), "kind": "another"})


def test_a_threshold_survives_json() -> None:
    scores: Scores = score(shake.Shake(SPECS[2]), FLIGHT)
    found = threshold_of(scores, flights=1)
    adapter = TypeAdapter(Threshold)
    assert adapter.validate_json(adapter.dump_json(found)) == found
