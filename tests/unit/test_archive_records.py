"""Answers that are kept: the same when they are read again, and only for the same question."""

import json
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_archive import MONITORS, START_US, archive_baseline, asked, made

from mavdiag.archive.scan import Answer, Cache, Options, Question, Record, digest_of, judge_file, open_cache
from mavdiag.archive.sources import digest_of_sources, judging_version
from mavdiag.as_json import verdict_json
from mavdiag.decision.alarm import Change
from mavdiag.errors import LinkError, UsageError
from mavdiag.judging import LogVerdict, Verdict, judge
from mavdiag.logs import read_log
from mavdiag.logs.log import sha256_of

DIGEST = "ab" * 32


@given(st.from_type(Record))
def test_an_answer_is_the_same_when_it_is_read_again(tmp_path_factory: pytest.TempPathFactory, record: Record) -> None:
    """By its text, for what is no number differs from itself."""
    folder, record = tmp_path_factory.mktemp("cache"), replace(record, digest=DIGEST)
    Cache(folder).put(DIGEST, record)
    again = Cache(folder).get(DIGEST)
    assert again is not None
    assert str(again) == str(record)
    assert type(again.verdict.verdict) is Verdict
    assert [type(change) for change in again.verdict.changes] == [Change] * len(record.verdict.changes)


def test_an_answer_is_that_of_a_fresh_judgement_and_prints_the_same(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "crack.tlog", shaken=("crack.tlog",))
    fresh = replace(judge(read_log(path), archive_baseline()), log=str(path))
    assert fresh.verdict is Verdict.FAULT
    assert fresh.events
    record, cache = judge_file(str(path), asked()), Cache(tmp_path)
    assert record.digest == digest_of(path) == sha256_of(path.read_bytes())
    cache.put(record.digest, record)
    kept = Cache(tmp_path).get(record.digest)
    assert kept is not None
    again = Answer(path, kept, fresh=False).verdict
    assert str(again) == str(fresh)
    assert json.dumps(verdict_json(again)) == json.dumps(verdict_json(fresh))


def test_every_option_the_baseline_and_the_code_make_another_question(monkeypatch: pytest.MonkeyPatch) -> None:
    options = [Options(), Options(vehicle=1), Options(from_s=1.0), Options(to_s=1.0), Options(windows_s=1.0)]
    options += [Options(figures=True), Options(flown_ns=1)]
    scopes = [asked(option).scope for option in options]
    other = archive_baseline().model_copy(update={"digest": "sha256:other"})
    scopes.append(Question.of(other, Options()).scope)
    monkeypatch.setattr("mavdiag.archive.scan.judging_version", lambda: "other")
    scopes.append(asked().scope)
    assert len(set(scopes)) == len(scopes)
    assert asked().scope == asked().scope


def test_a_damaged_file_and_one_of_another_log_are_no_answers(tmp_path: Path) -> None:
    record = Record(DIGEST, LogVerdict("", Verdict.HEALTHY, "no alarm"))
    Cache(tmp_path).put(DIGEST, record)
    assert Cache(tmp_path).get(DIGEST) == record
    file = tmp_path / f"{DIGEST}.json"
    (tmp_path / f"{'cd' * 32}.json").write_text(file.read_text())
    file.write_text("{")
    assert Cache(tmp_path).get("cd" * 32) is None
    assert Cache(tmp_path).get(DIGEST) is None


def test_the_folder_is_that_of_the_xdg_specification(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    open_cache(None, "scope")
    assert (tmp_path / "mavdiag" / "scan" / "scope").is_dir()
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    open_cache(None, "scope")
    assert (tmp_path / "home" / ".cache" / "mavdiag" / "scan" / "scope").is_dir()
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    warned: list[str] = []
    assert open_cache(None, "scope", warned.append).get(DIGEST) is None
    assert warned[0].startswith("answers are not kept: ")
    with pytest.raises(UsageError, match=r"file: no folder to keep answers in .*--no-cache"):
        open_cache(tmp_path / "file", "scope")


def test_a_worker_of_another_version_does_not_answer(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "a.tlog")
    with pytest.raises(LinkError, match="another version of mavdiag"):
        judge_file(str(path), replace(asked(), version="other"))


@pytest.mark.parametrize("package", ["numpy", "scipy"])
def test_the_version_is_that_of_the_sources_and_of_what_computes(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An upgrade must not keep the answers of before."""
    before, installed = judging_version.__wrapped__(), metadata.version
    assert judging_version() == before
    assert digest_of_sources(("mavdiag",), ("__pycache__", "mavdiag/monitors/innovation.py")) != before
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.0" if name == package else installed(name))
    assert judging_version.__wrapped__() != before


def test_figures_are_of_the_flight_that_was_judged_at_the_time_that_was_told(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "a.tlog")
    record = judge_file(str(path), asked(Options(figures=True, flown_ns=5)))
    assert record.flight is not None
    assert record.flight.started_ns == START_US * 1000  # the log has a clock of its own
    assert record.flight.content.startswith(record.digest)
    assert {slot.monitor for slot in record.flight.slots} == set(MONITORS)
    assert record.verdict == judge_file(str(path), asked()).verdict
