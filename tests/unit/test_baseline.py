"""The baseline as a contract: what it refuses, and that it names the field."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_baselines import thesis, whole

from mavdiag.baseline import Baseline, check_link, dump, parse
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError
from mavdiag.monitors.run_length import RunLength

FSD, TRIM = 0, 5  # places in the list of the monitors


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    return whole()


def changed(baseline: Baseline, *path: str | int, value: object) -> str:
    raw: Any = json.loads(dump(baseline))
    place = raw
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    return json.dumps(raw)


def refusal(text: str) -> str:
    with pytest.raises(BaselineError) as refused:
        parse(text)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("made", [whole, thesis])
def test_text_and_back_is_the_same(made: Any) -> None:
    assert parse(dump(made())) == made()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("link", "dt_s"), -1.0, "link.dt_s"),
        (("link", "gate", "colour"), 1.0, "link.gate"),
        (("window", "samples"), 100, "window"),
        (("monitors", FSD, "spec", "model", "a"), [1.0], "monitors.0.spec"),
        (("monitors", FSD, "spec", "axis"), "sideways", "monitors.0.spec"),
        (("monitors", FSD, "spec", "margin_rad_s"), 0.0, "monitors.0.spec"),
        (("monitors", FSD, "spec", "colour"), "red", "monitors.0.spec"),
        (("monitors", FSD, "spec", "delay_s"), 1e308, "monitors.0.spec"),
        (("monitors", FSD, "spec", "delay_s"), 2**62, "monitors.0.spec"),
        (("monitors", FSD, "spec", "delay_s"), -1.0, "monitors.0.spec"),
        (("monitors", FSD, "spec"), {}, "monitors.0.spec"),
        (("monitors", FSD, "spec"), 7, "monitors.0.spec"),
        (("monitors", FSD, "spec"), None, "monitors.0.spec"),
        (("monitors", FSD, "threshold", "value"), "long", "monitors.0.threshold.value"),
        (("monitors", FSD, "threshold", "rule"), "hunch", "monitors.0.threshold.rule"),
        (("monitors",), [], "monitors"),
        (("monitors",), 5, "monitors"),
        (("provenance", "logs"), [], "provenance.logs"),
        (("provenance", "logs", 0, "sha256"), "abc", "provenance.logs.0.sha256"),
        (("airframe", "colour"), "red", "airframe"),
        (("airframe", "mass_kg"), -1.0, "airframe"),
        (("airframe", "name"), "another", "digest"),
        (("not_judgeable", 0, "reason"), 3, "not_judgeable.0.reason"),
        (("monitors", FSD, "spec", "kind"), "hunch", "monitors.0.spec: no monitor hunch"),
        (("monitors", FSD, "spec", "kind"), ["fsd"], "monitors.0.spec"),
        (("monitors", TRIM, "spec", "layout", "signs"), [[1.0, 1.0, 1.0]], "monitors.5.spec"),
        (("monitors", TRIM, "spec", "layout"), "x", "monitors.5.spec.layout"),
        (("airframe", "layout", "signs"), [[1.0, 1.0, 1.0]], "airframe"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    baseline: Baseline, path: tuple[str | int, ...], value: object, field: str
) -> None:
    assert refusal(changed(baseline, *path, value=value)).startswith(field)


@given(st.text(max_size=40), st.integers(0, 400))
def test_garbage_in_the_middle_never_raises_anything_else(garbage: str, at: int) -> None:
    text = dump(whole())
    with pytest.raises(BaselineError):
        parse(text[: at * 5] + "\x00" + garbage + text[at * 5 :])


def test_another_link_is_refused_with_the_field() -> None:
    check_link(thesis(), profile="qdrone2", dt_s=0.001001)
    with pytest.raises(BaselineError, match=r"link\.profile: .*'px4'"):
        check_link(thesis(), profile="px4", dt_s=0.001)
    with pytest.raises(BaselineError, match=r"link\.dt_s: .*1000\.0 Hz.*500\.0 Hz"):
        check_link(thesis(), profile="qdrone2", dt_s=0.002)


def test_a_chain_from_the_file_is_the_chain_that_was_learnt(tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    thesis().save(path)
    slot = chain_of(Baseline.load(path)).slots[0]
    spec, fml = thesis().monitors[0].spec, thesis().monitors[0].threshold
    assert isinstance(slot.monitor, RunLength)
    np.testing.assert_array_equal(slot.monitor.spec.model.a, spec.model.a)
    assert (slot.threshold, slot.decides) == (fml.value, True)  # it stands alone
