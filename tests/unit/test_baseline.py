"""The baseline as a contract: what it refuses, and that it names the field."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_telemetry import flight

from mavdiag.baseline import Baseline, check_link, dump, parse
from mavdiag.chain import chain_of
from mavdiag.errors import BaselineError, UsageError
from mavdiag.learning import Flight, learn, thesis_options
from mavdiag.monitors.run_length import RunLength
from mavdiag.telemetry import Axis


def healthy(count: int, n: int = 6000) -> list[Flight]:
    return [Flight(f"flight{i}", f"{i:064x}", "qdrone2", flight(n, seed=100 + i)) for i in range(count)]


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    options = thesis_options("test", (Axis.ROLL, Axis.PITCH))
    return learn(healthy(3), options, created="2026-01-01T00:00:00+00:00")


def changed(baseline: Baseline, *path: str | int, value: object) -> str:
    raw: Any = json.loads(dump(baseline))
    place = raw
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    return json.dumps(raw)


def test_text_and_back_is_the_same(baseline: Baseline) -> None:
    assert parse(dump(baseline)) == baseline


def test_the_model_found_is_the_airframe_that_made_the_data(baseline: Baseline) -> None:
    model = baseline.model_of(Axis.ROLL)
    assert model.r2t > 0.97
    assert abs(sum(model.b) / sum(model.a) - 1.0) < 0.05  # DC gain of the made airframe


def test_the_price_of_the_latency_is_stated(baseline: Baseline) -> None:
    spec, fml = baseline.latency[0]
    assert fml.false_alarms_per_flight == 0.25
    assert fml.value == max(spec.longest_run_s)
    assert len(spec.longest_run_s) == 3
    assert "an equal healthy flight alarms with probability 0.25" in fml.statement()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("link", "dt_s"), -1.0, "link.dt_s"),
        (("window", "samples"), 100, "window"),
        (("models", 0, "a"), [1.0], "models.0"),
        (("models", 0, "axis"), "sideways", "models.0.axis"),
        (("monitors", 0, "threshold", "value"), "long", "monitors.0.threshold.value"),
        (("monitors", 0, "spec", "margin_rad_s"), 0.0, "monitors: latency: the margin"),
        (("monitors", 0, "spec", "kind"), "hunch", "monitors.0.spec"),
        (("monitors", 0, "spec", "axis"), "yaw", "baseline"),
        (("provenance", "logs"), [], "provenance.logs"),
        (("provenance", "logs", 0, "sha256"), "abc", "provenance.logs.0.sha256"),
        (("airframe", "colour"), "red", "airframe.colour"),
        (("airframe", "name"), "another", "digest"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    baseline: Baseline, path: tuple[str | int, ...], value: object, field: str
) -> None:
    with pytest.raises(BaselineError) as refused:
        parse(changed(baseline, *path, value=value))
    assert str(refused.value).startswith(field)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", '{"schema": "mavdiag.baseline/2"}'])
def test_other_texts_are_refused_in_one_line(text: str) -> None:
    with pytest.raises(BaselineError) as refused:
        parse(text)
    assert "\n" not in str(refused.value)


@given(st.text(max_size=40), st.integers(0, 400))
def test_garbage_in_the_middle_never_raises_anything_else(garbage: str, at: int) -> None:
    text = dump(learnt())
    with pytest.raises(BaselineError):
        parse(text[: at * 5] + "\x00" + garbage + text[at * 5 :])


def learnt() -> Baseline:
    return _LEARNT[0] if _LEARNT else _learn_once()


_LEARNT: list[Baseline] = []


def _learn_once() -> Baseline:
    _LEARNT.append(learn(healthy(2), thesis_options(), created="2026-01-01T00:00:00+00:00"))
    return _LEARNT[0]


def test_another_link_is_refused_with_the_field(baseline: Baseline) -> None:
    check_link(baseline, profile="qdrone2", dt_s=0.001001)
    with pytest.raises(BaselineError, match=r"link\.profile: .*'px4'"):
        check_link(baseline, profile="px4", dt_s=0.001)
    with pytest.raises(BaselineError, match=r"link\.dt_s: .*1000\.0 Hz.*500\.0 Hz"):
        check_link(baseline, profile="qdrone2", dt_s=0.002)


def test_a_chain_from_the_file_is_the_chain_that_was_learnt(baseline: Baseline, tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    baseline.save(path)
    watch = chain_of(Baseline.load(path)).watches[0]
    assert isinstance(watch.monitor, RunLength)
    np.testing.assert_array_equal(watch.monitor.model.a, baseline.model_of(Axis.ROLL).a)
    assert watch.threshold == baseline.latency[0][1].value


def test_saving_replaces_the_file_whole_or_not_at_all(baseline: Baseline, tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    path.write_text("old")
    baseline.save(path)
    assert Baseline.load(path) == baseline
    assert [p.name for p in tmp_path.iterdir()] == ["b.json"]
    with pytest.raises(UsageError, match="name a folder you can write to"):
        baseline.save(tmp_path / "absent" / "b.json")


@pytest.mark.parametrize(("content", "says"), [(None, "no such file"), (b"\xff\xfe\x00", "not UTF-8 text")])
def test_a_file_that_cannot_be_read_says_so(tmp_path: Path, content: bytes | None, says: str) -> None:
    path = tmp_path / "b.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BaselineError, match=says):
        Baseline.load(path)
