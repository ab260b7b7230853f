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
from mavdiag.errors import BaselineError, UsageError
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
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    baseline: Baseline, path: tuple[str | int, ...], value: object, field: str
) -> None:
    assert refusal(changed(baseline, *path, value=value)).startswith(field)


@pytest.mark.parametrize(
    ("path", "value", "place", "says"),
    [
        (("monitors", FSD, "spec", "kind"), "hunch", "monitors.0.spec", "no monitor hunch"),
        (("monitors", FSD, "spec", "kind"), ["fsd"], "monitors.0.spec", "object with a kind"),
        (("monitors", TRIM, "spec", "layout", "signs"), [[1.0, 1.0, 1.0]], "monitors.5.spec", "layout"),
        (("monitors", TRIM, "spec", "layout"), "x", "monitors.5.spec", "layout"),
        (("monitors", TRIM, "spec", "source"), "guess", "monitors.5.spec", "source"),
        (("airframe", "layout", "signs"), [[1.0, 1.0, 1.0]], "airframe", ""),
        (("airframe", "layout"), "x", "airframe.layout", ""),
    ],
)
def test_b23_an_unknown_kind_or_layout_is_a_baseline_error_that_names_the_place(
    baseline: Baseline, path: tuple[str | int, ...], value: object, place: str, says: str
) -> None:
    """B23: a UsageError came through, without file and field."""
    message = refusal(changed(baseline, *path, value=value))
    assert message.startswith(place)
    assert says in message


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", "7", '{"schema": "mavdiag.baseline/2"}'])
def test_other_texts_are_refused_in_one_line(text: str) -> None:
    assert refusal(text)


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


def test_saving_replaces_the_file_whole_or_not_at_all(baseline: Baseline, tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    path.write_text("old")
    baseline.save(path)
    assert Baseline.load(path) == baseline
    assert [p.name for p in tmp_path.iterdir()] == ["b.json"]
    with pytest.raises(UsageError, match="cannot be written"):
        baseline.save(tmp_path / "absent" / "b.json")


@pytest.mark.parametrize(("content", "says"), [(None, "no such file"), (b"\xff\xfe\x00", "not UTF-8 text")])
def test_a_file_that_cannot_be_read_says_so(tmp_path: Path, content: bytes | None, says: str) -> None:
    path = tmp_path / "b.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BaselineError, match=says):
        Baseline.load(path)


def test_l12_a_log_and_a_live_link_are_two_links_and_the_refusal_says_what_to_do() -> None:
    made = thesis()
    with pytest.raises(BaselineError, match="are 'ardupilot-log'; learn one from healthy flights of this kind"):
        check_link(made, profile="ardupilot-log", dt_s=made.link.dt_s)
