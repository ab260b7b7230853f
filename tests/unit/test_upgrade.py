"""Baselines of schema /1 and /2 are brought to the present one; each file was made by the version that wrote it.

`baseline_2.json` rests on two flights of `flying_telemetry`.
"""

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from flying_telemetry import flying
from made_baselines import logged

from mavdiag.baseline import Baseline, dump, parse
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError, InputError
from mavdiag.judging import Verdict, judge
from mavdiag.learning.extend import extend
from mavdiag.monitors import monitor_of
from mavdiag.monitors.run_length import RunLength
from mavdiag.upgrade import CHANGED, KINDS, upgrade

OLD: dict[str, Any] = json.loads((Path(__file__).parent / "baseline_1.json").read_text())
SECOND: dict[str, Any] = json.loads((Path(__file__).parent / "baseline_2.json").read_text())


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
    assert {entry.spec.kind for entry in upgraded.monitors} == {*KINDS.values()} - {CHANGED}
    assert [one.monitor for one in upgraded.not_judgeable] == ["rotor_trim", CHANGED]
    assert len(chain_of(upgraded).slots) == 6
    assert upgraded.airframe.layout is not None
    assert upgraded.airframe.layout.name == OLD["airframe"]["frame"]


def test_it_is_a_sound_baseline_that_says_it_was_upgraded(upgraded: Baseline) -> None:
    assert parse(dump(upgraded)) == upgraded
    assert upgraded.provenance.tool == "mavdiag 0.1.0, upgraded from schema /1"
    assert "upgraded from schema /1" in str(upgraded)


def test_thresholds_margins_and_models_are_kept(upgraded: Baseline) -> None:
    kept = [one for one in with_all_kinds()["monitors"] if KINDS[one["spec"]["kind"]] != CHANGED]
    for entry, old in zip(upgraded.monitors, kept, strict=True):
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
    with pytest.raises(BaselineError, match="only these can be upgraded"):
        upgrade(json.loads(dump(upgraded)))
    with pytest.raises(BaselineError, match="mavdiag baseline upgrade"):
        parse(json.dumps(OLD))


def test_a_second_schema_keeps_all_but_the_rotor_signature() -> None:
    found = upgrade(copy.deepcopy(SECOND))
    old = {one["spec"]["kind"]: one for one in SECOND["monitors"]}
    assert CHANGED in old
    assert [entry.spec.kind for entry in found.monitors] == [
        one["spec"]["kind"] for one in SECOND["monitors"] if one["spec"]["kind"] != CHANGED
    ]
    for entry in found.monitors:
        threshold = old[entry.spec.kind]["threshold"]
        if entry.spec.kind != "fsd":
            assert (entry.threshold.value, entry.threshold.hours) == (threshold["value"], threshold["hours"])
        assert (entry.threshold.session_allowance, entry.threshold.sessions) == (0.0, 2)
        assert entry.scores is None
    assert found.provenance.tool == f"{SECOND['provenance']['tool']}, upgraded from schema /2"
    assert parse(dump(found)) == found


@pytest.mark.parametrize("raw", [with_all_kinds(), SECOND], ids=["first", "second"])
def test_the_rotor_signature_is_left_out_with_its_reason(raw: dict[str, Any]) -> None:
    found = upgrade(copy.deepcopy(raw))
    (refusal,) = (one for one in found.not_judgeable if one.monitor == CHANGED)
    assert refusal.reason == "its statistic has changed since; learn a baseline anew"
    assert f"{CHANGED} not judgeable: its statistic has changed since" in str(found)
    assert CHANGED not in {slot.monitor.name for slot in chain_of(found).slots}


def test_a_signature_that_was_not_judgeable_before_is_named_once() -> None:
    raw = copy.deepcopy(SECOND)
    raw["monitors"] = [one for one in raw["monitors"] if one["spec"]["kind"] != CHANGED]
    raw["not_judgeable"] = [{"monitor": CHANGED, "reason": "why"}]
    assert [(one.monitor, one.reason) for one in upgrade(raw).not_judgeable] == [(CHANGED, "why")]


def test_a_file_of_the_signature_alone_has_nothing_left_and_is_refused() -> None:
    raw = copy.deepcopy(SECOND)
    raw["monitors"] = [one for one in raw["monitors"] if one["spec"]["kind"] == CHANGED]
    with pytest.raises(BaselineError, match=r"monitors: .*at least 1 item"):
        upgrade(raw)


def test_what_neither_old_schema_knew_stays_unknown(upgraded: Baseline) -> None:
    for found in (upgraded, upgrade(copy.deepcopy(SECOND))):
        assert (found.envelope, found.fingerprint) == ((), None)
        assert {(one.started_ns, one.propellers) for one in found.provenance.logs} == {(0, 0)}
        assert not found.same_session(1_777_600_000 * 10**9)


def test_an_upgraded_baseline_judges_and_cannot_be_extended() -> None:
    found = upgrade(copy.deepcopy(SECOND))
    assert judge(logged(flying(3000, 11)), found).verdict is Verdict.HEALTHY
    weak = judge(logged(flying(3000, 12, weak_rotor=3, rise=0.3)), found)
    assert (weak.verdict, "rotor 3" in weak.reason) == (Verdict.FAULT, True)
    with pytest.raises(InputError, match="of an older schema and holds no scores"):
        extend(found, [logged(flying(3000, 13))], created="")


@pytest.mark.parametrize("name", [key for key in SECOND if key not in ("schema", "digest")])
def test_a_second_schema_that_lacks_a_part_is_refused_in_one_line(name: str) -> None:
    raw = copy.deepcopy(SECOND)
    del raw[name]
    with pytest.raises(BaselineError) as refused:
        upgrade(raw)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)
