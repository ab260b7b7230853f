"""Specs and thresholds are plain data: a baseline can hold, validate and write them as they are."""

from typing import Any

import pytest
from flying_telemetry import flying, flying_rows
from pydantic import TypeAdapter, ValidationError

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors import MONITORS, monitor_of
from mavdiag.monitors.base import LearnContext
from mavdiag.thresholds.heldout import score
from mavdiag.thresholds.rule import Threshold, threshold_of

FLIGHT = flying_rows(flying(3000, 1))
CONTEXT = LearnContext(Airframe(layout=layout_named("x")), None, 0.01, 11)
SPECS: list[Any] = [spec for kind in MONITORS for spec in kind.fit([FLIGHT], CONTEXT)[:1]]


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.kind)
def test_a_spec_survives_json(spec: Any) -> None:
    adapter = TypeAdapter(type(spec))
    assert adapter.validate_json(adapter.dump_json(spec)) == spec
    with pytest.raises(ValidationError, match="kind"):
        adapter.validate_python({**adapter.dump_python(spec), "kind": "another"})


def test_a_threshold_survives_json() -> None:
    found = threshold_of(score(monitor_of(SPECS[0]), FLIGHT), flights=1)
    adapter = TypeAdapter(Threshold)
    assert adapter.validate_json(adapter.dump_json(found)) == found
