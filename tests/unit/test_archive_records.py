"""Answers that are kept: the same when they are read again, and only for the same question."""

import json
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_archive import MONITORS, START_US, archive_baseline, asked, content, made

from mavdiag.archive.job import (
    Answer,
    Cache,
    Options,
    Question,
    Record,
    cache_folder,
    digest_of,
    judge_file,
    mark_of,
    open_cache,
    record_from,
    record_text,
)
from mavdiag.archive.sources import digest_of_sources, judging_version
from mavdiag.as_json import verdict_json
from mavdiag.decision.alarm import Change
from mavdiag.errors import LinkError, UsageError
from mavdiag.judging import LogVerdict, Verdict, judge
from mavdiag.logs import read_log
from mavdiag.logs.log import sha256_of

DIGEST = "ab" * 32


@given(st.from_type(Record))
def test_an_answer_is_the_same_when_it_is_read_again(record: Record) -> None:
    """By its text, for what is no number differs from itself."""
    again = record_from(record_text(record))
    assert record_text(again) == record_text(record)
    assert type(again.verdict.verdict) is Verdict
    assert [type(change) for change in again.verdict.changes] == [Change] * len(record.verdict.changes)


def test_an_answer_is_that_of_a_fresh_judgement_and_prints_the_same(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "crack.tlog", shaken=("crack.tlog",))
    fresh = replace(judge(read_log(path), archive_baseline()), log=str(path))
    assert fresh.verdict is Verdict.FAULT
    assert fresh.events
    record = judge_file(str(path), asked())
    assert record.digest == digest_of(path) == sha256_of(path.read_bytes())
    again = Answer(path, record_from(record_text(record)), fresh=True).verdict
    assert str(again) == str(fresh)
    assert json.dumps(verdict_json(again)) == json.dumps(verdict_json(fresh))


def test_every_option_the_baseline_and_the_code_make_another_question(monkeypatch: pytest.MonkeyPatch) -> None:
    options = [Options(), Options(vehicle=1), Options(from_s=1.0), Options(to_s=1.0), Options(windows_s=1.0)]
    options += [Options(figures=True), Options(flown_ns=1)]
    scopes = [asked(option).scope for option in options]
    other = archive_baseline().model_copy(update={"digest": "sha256:other"})
    scopes.append(Question.of(other, Options()).scope)
    monkeypatch.setattr("mavdiag.archive.job.judging_version", lambda: "other")
    scopes.append(asked().scope)
    assert len(set(scopes)) == len(scopes)
    assert asked().scope == asked().scope


def test_a_cache_gives_back_what_it_got_and_no_damaged_file(tmp_path: Path) -> None:
    cache = open_cache(tmp_path / "new" / "cache", "scope")
    record = Record(DIGEST, LogVerdict("", Verdict.HEALTHY, "no alarm"))
    assert cache.get("mark", DIGEST) is None
    cache.put("mark", record)
    assert cache.get("mark", DIGEST) == record
    (file,) = cache.folder.iterdir()
    assert cache.marks() == {"mark"}
    file.rename(cache.folder / f"mark-{'cd' * 32}.json")
    assert cache.get("mark", "cd" * 32) is None  # it is of another log
    cache.put("mark", record)
    (cache.folder / f"mark-{DIGEST}.json").write_text("{")
    assert cache.get("mark", DIGEST) is None


def test_a_cache_that_cannot_be_used_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"file: no folder to keep answers in .*--no-cache"):
        open_cache(tmp_path / "file", "scope")
    with pytest.raises(UsageError, match="cannot be written"):
        Cache(tmp_path / "absent").put("mark", Record(DIGEST, LogVerdict("", Verdict.HEALTHY, "")))


def test_the_folder_is_that_of_the_xdg_specification(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "mavdiag"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home" / ".cache" / "mavdiag"


def test_a_worker_of_another_version_does_not_answer(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "a.tlog")
    with pytest.raises(LinkError, match="another version of mavdiag"):
        judge_file(str(path), replace(asked(), version="other"))


def test_the_version_is_that_of_what_judges() -> None:
    """A change of a monitor makes another version; one of a command does not."""
    every = digest_of_sources(("mavdiag",), ())
    assert judging_version() == judging_version.__wrapped__() != every
    assert digest_of_sources(("mavdiag",), ("mavdiag/monitors/innovation.py",)) != every


@pytest.mark.parametrize("package", ["numpy", "scipy"])
def test_another_version_of_what_computes_is_another_version(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An upgrade must not keep the answers of before."""
    before, installed = judging_version.__wrapped__(), metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.0" if name == package else installed(name))
    assert judging_version.__wrapped__() != before


def test_files_of_equal_content_share_a_mark_and_most_others_do_not(tmp_path: Path) -> None:
    whole = content(1, 400)
    middle = len(whole) // 2
    other = {
        "middle": whole[:middle] + b"?" + whole[middle + 1 :],
        "start": b"?" + whole[1:],
        "end": whole[:-1] + b"?",
        "size": whole[:-1],
        "short": b"1",
    }
    for name, data in {"a": whole, "b": whole, **other}.items():
        (tmp_path / name).write_bytes(data)
    marks = {path.name: mark_of(path) for path in tmp_path.iterdir()}
    assert marks["a"] == marks["b"] == marks["middle"]
    assert len(set(marks.values())) == 5
    assert mark_of(tmp_path) == mark_of(tmp_path / "absent") == ""


def test_figures_are_of_the_flight_that_was_judged_at_the_time_that_was_told(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "a.tlog")
    record = judge_file(str(path), asked(Options(figures=True, flown_ns=5)))
    assert record.flight is not None
    assert record.flight.started_ns == START_US * 1000  # the log has a clock of its own
    assert record.flight.content.startswith(record.digest)
    assert {slot.monitor for slot in record.flight.slots} == set(MONITORS)
    assert record_from(record_text(record)) == record
    assert record.verdict == judge_file(str(path), asked()).verdict
