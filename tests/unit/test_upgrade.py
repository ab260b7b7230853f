"""Baselines of schema /1 are brought to the present one. `baseline_1.json` was made by the version before it."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from mavdiag.baseline import Baseline, dump, parse
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError
from mavdiag.monitors import monitor_of
from mavdiag.monitors.run_length import RunLength
from mavdiag.upgrade import KINDS, upgrade

OLD: dict[str, Any] = json.loads((Path(__file__).parent / "baseline_1.json").read_text())


def with_all_kinds() -> dict[str, Any]:
    """The file, and the one kind that its link did not have."""
    raw = copy.deepcopy(OLD)
    shake = {"kind": "shake", "healthy": 0.4, "window_s": 5.0}
    raw["monitors"].append({"spec": shake, "threshold": raw["monitors"][-1]["threshold"]})
    raw["not_judgeable"].append({"monitor": "effort", "reason": "why"})
    return raw


@pytest.fixture(scope="module")
def upgraded() -> Baseline:
    return upgrade(with_all_kinds())


def test_every_kind_is_there_under_its_present_name(upgraded: Baseline) -> None:
    assert {entry.spec.kind for entry in upgraded.monitors} == {*KINDS.values()}
    assert [one.monitor for one in upgraded.not_judgeable] == ["rotor_trim"]
    assert len(chain_of(upgraded).slots) == 7
    assert upgraded.airframe.layout is not None
    assert upgraded.airframe.layout.name == OLD["airframe"]["frame"]


def test_it_is_a_sound_baseline_that_says_it_was_upgraded(upgraded: Baseline) -> None:
    assert parse(dump(upgraded)) == upgraded
    assert upgraded.provenance.tool == "mavdiag 0.1.0, upgraded from schema /1"
    assert "upgraded from schema /1" in str(upgraded)


def test_thresholds_margins_and_models_are_kept(upgraded: Baseline) -> None:
    for entry, old in zip(upgraded.monitors, with_all_kinds()["monitors"], strict=True):
        assert entry.threshold.value == old["threshold"]["value"]
    spec, _ = upgraded.fsd[0]
    (model,) = (one for one in OLD["models"] if one["axis"] == spec.axis)
    assert spec.margin_rad_s == OLD["monitors"][0]["spec"]["margin_rad_s"]
    assert spec.model.model().a.tolist() == model["a"]
    monitor = monitor_of(spec)
    assert isinstance(monitor, RunLength)
    assert monitor.delay_s == pytest.approx(0.05)


def test_what_the_old_one_did_not_know_stays_unknown(upgraded: Baseline) -> None:
    frame = upgraded.airframe
    assert (frame.mass_kg, frame.hover_rad_s, frame.classifier) == (None, None, None)


@pytest.mark.parametrize("name", [key for key in OLD if key not in ("schema", "digest")])
def test_a_file_that_lacks_a_part_is_refused_in_one_line(name: str) -> None:
    raw = with_all_kinds()
    del raw[name]
    with pytest.raises(BaselineError) as refused:
        upgrade(raw)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("airframe", "frame"), "nonsense"),
        (("monitors", 0, "spec", "kind"), "hunch"),
        (("monitors", 3, "spec", "motion"), 7),
        (("monitors", 0, "spec"), None),
        (("monitors", 0, "threshold"), []),
        (("provenance",), "me"),
        (("models",), []),
        (("link", "dt_s"), "fast"),
        (("monitors",), 3),
    ],
)
def test_damaged_values_are_refused_in_one_line(place: tuple[str | int, ...], value: object) -> None:
    raw = with_all_kinds()
    part: Any = raw
    for step in place[:-1]:
        part = part[step]
    part[place[-1]] = value
    with pytest.raises(BaselineError) as refused:
        upgrade(raw)
    assert "\n" not in str(refused.value)


def test_only_the_old_schema_is_upgraded(upgraded: Baseline) -> None:
    with pytest.raises(BaselineError, match="only that one can be upgraded"):
        upgrade(json.loads(dump(upgraded)))
    with pytest.raises(BaselineError, match="mavdiag baseline upgrade"):
        parse(json.dumps(OLD))
