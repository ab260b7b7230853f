"""The answers of a scan: each log once, each content judged once, whatever the workers do."""

import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_archive import asked, content, made

from mavdiag.archive import scan as module
from mavdiag.archive.cache import open_cache
from mavdiag.archive.job import Answer, Question, Record, refused
from mavdiag.archive.paths import Named, logs_named
from mavdiag.archive.pool import TaskExecutor, in_this_process
from mavdiag.archive.scan import in_order, scan
from mavdiag.archive.work import answer_of, mark_of
from mavdiag.errors import LinkError, UsageError
from mavdiag.judging import LogVerdict, Verdict

HERE = in_this_process
QUESTION = Question("baseline", asked().options, "version", "scope")
Opened = Callable[[], AbstractContextManager[TaskExecutor]]


class KilledError(Exception):
    """As Dask says that a task's workers died."""


class Workers(Executor):
    """Workers that do nothing until they are asked for a result, then any of their tasks; and that can die.

    order: draws the next task to finish. deadly: paths that end the worker. judged: paths that were judged.
    """

    def __init__(self, order: np.random.Generator, deadly: frozenset[str], judged: list[str]) -> None:
        self._order, self._deadly, self._judged = order, deadly, judged
        self._waiting: list[tuple[Future[Any], str, Question | None]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self._waiting.append((future, *args))
        return future

    def finish_one(self) -> None:
        future, path, question = self._waiting.pop(int(self._order.integers(len(self._waiting))))
        if question is not None and Path(path).name in self._deadly:
            for other in (future, *(one for one, *_ in self._waiting)):
                other.set_exception(BrokenExecutor("a process died"))
            self._waiting.clear()
            return
        text = Path(path).read_text()
        if question is not None:
            self._judged.append(text)
        future.set_result(text if question is None else Record(text, LogVerdict("", Verdict.HEALTHY, text)))


@contextmanager
def made_workers(
    monkeypatch: pytest.MonkeyPatch, seed: int, deadly: frozenset[str], judged: list[str]
) -> Iterator[Opened]:
    """Workers that finish their tasks in a drawn order, one at a time."""
    order, now = np.random.default_rng(seed), list[Workers]()

    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        now[:] = [Workers(order, deadly, judged)]
        yield TaskExecutor(now[0], 4)

    def wait(
        running: dict[Future[Any], Any], timeout: float, return_when: str
    ) -> tuple[set[Future[Any]], set[Future[Any]]]:
        if not any(one.done() for one in running):
            now[0].finish_one()
        return {one for one in running if one.done()}, set()

    with monkeypatch.context() as patch:
        patch.setattr(module, "wait", wait)
        yield opened


@given(
    st.lists(st.sampled_from("abcdefgh"), min_size=1, max_size=14),
    st.integers(0, 2**31),
    st.frozensets(st.integers(0, 13), max_size=3),
    st.sampled_from(["", "abcd", "abcdefgh"]),
)
def test_each_log_is_answered_once_and_each_content_judged_once(
    tmp_path_factory: pytest.TempPathFactory, contents: list[str], seed: int, deadly: frozenset[int], alike: str
) -> None:
    """alike: contents that share a mark, as files do that differ in the middle only."""
    folder = tmp_path_factory.mktemp("logs")
    paths = [folder / str(number) for number in range(len(contents))]
    for path, text in zip(paths, contents, strict=True):
        path.write_text(text)
    judged: list[str] = []
    names = frozenset(map(str, deadly))
    with pytest.MonkeyPatch.context() as patch, made_workers(patch, seed, names, judged) as opened:
        patch.setattr(module, "mark_of", lambda path: text if (text := path.read_text()) not in alike else "alike")
        answers = list(scan(logs_named(paths).logs, QUESTION, opened))
    assert sorted(one.number for one in answers) == list(range(len(contents)))
    assert [one.number for one in in_order(answers)] == list(range(len(contents)))
    whole = set(contents) - {contents[number] for number in deadly if number < len(contents)}
    for answer in answers:
        verdict = answer.verdict
        assert verdict.log == str(paths[answer.number])
        if verdict.verdict is Verdict.ERROR:
            assert contents[answer.number] not in whole
            assert "the process that judged it died" in verdict.reason
        else:
            assert verdict.reason == contents[answer.number]
    assert whole <= {one.record.digest for one in answers}
    if not deadly:
        assert sorted(judged) == sorted(set(contents))
    assert sum(one.fresh for one in answers) == len(set(contents))
    shutil.rmtree(folder)


def test_answers_are_kept_as_they_come_and_errors_are_not(tmp_path: Path) -> None:
    a, b = made(tmp_path, "a.tlog", "b.tlog")
    bad = tmp_path / "bad.tlog"
    bad.write_text("no log")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))
    cache = open_cache(tmp_path / "cache", asked().scope)
    run = scan(logs_named([a, bad, copy, b]).logs, asked(), HERE, cache)
    first = next(run)
    assert (first.path, first.fresh, len(list(cache.folder.iterdir()))) == (a, True, 1)
    run.close()  # as Ctrl-C does
    answers = list(scan(logs_named([a, bad, copy, b]).logs, asked(), HERE, cache))
    assert [(one.path, one.fresh) for one in in_order(answers)] == [(a, False), (bad, True), (copy, False), (b, True)]
    assert len(list(cache.folder.iterdir())) == 2
    by_path = {one.path: one for one in answers}
    assert by_path[bad].verdict.verdict is Verdict.ERROR
    assert by_path[bad].verdict.reason.startswith("not a flight log of a known kind")
    assert by_path[a].record == first.record == by_path[copy].record != by_path[b].record
    again = list(scan(logs_named([b]).logs, asked(), HERE, cache))
    assert [(one.fresh, one.record) for one in again] == [(False, by_path[b].record)]


def test_without_a_cache_a_copy_is_not_judged_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (a,) = made(tmp_path, "a.tlog")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))
    asked_for: list[str] = []

    def counted(path: str, question: Question | None) -> str | Record:
        if question is not None:
            asked_for.append(path)
        return answer_of(path, question)

    monkeypatch.setattr(module, "answer_of", counted)
    answers = list(scan(logs_named([a, copy, a]).logs, asked(), HERE))
    assert [one.fresh for one in in_order(answers)] == [True, False, False]
    assert asked_for == [str(a)]


def test_what_could_not_be_looked_for_is_an_error_among_the_others(tmp_path: Path) -> None:
    (a,) = made(tmp_path, "a.tlog")
    logs = (Named(tmp_path, "the folder cannot be read (Permission denied)"), Named(a), Named(tmp_path / "absent.tlog"))
    answers = list(in_order(scan(logs, asked(), HERE)))
    assert [str(one.verdict.verdict) for one in answers] == ["error", "healthy", "error"]
    assert answers[0].verdict.reason == "the folder cannot be read (Permission denied)"
    assert answers[2].verdict.reason == "no such file"


def test_a_file_that_changes_while_it_is_judged_answers_for_itself_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (a,) = made(tmp_path, "a.tlog")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))

    def changing(path: str, question: Question | None) -> str | Record:
        if question is not None and path == str(a):
            a.write_bytes(content(9))
        return answer_of(path, question)

    monkeypatch.setattr(module, "answer_of", changing)

    @contextmanager
    def two() -> Iterator[TaskExecutor]:
        with HERE() as one:
            yield TaskExecutor(one.pool, 2)

    cache = open_cache(tmp_path / "cache", asked().scope)
    answers = list(in_order(scan(logs_named([a, copy]).logs, asked(), two, cache)))
    assert [one.record.digest for one in answers] == [answer_of(str(a), None), answer_of(str(copy), None)]
    assert {one.name for one in cache.folder.iterdir()} == {
        f"{mark_of(copy)}-{one.record.digest}.json" for one in answers
    }


def failing(error: Exception) -> Opened:
    """Workers whose tasks all end by an error."""

    class Failing(Executor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_exception(error)
            return future

    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        yield TaskExecutor(Failing(), 2, (KilledError,))

    return opened


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (KilledError(), "the process that judged it died"),
        (MemoryError(), "the process that judged it died"),
        (ValueError("of\nours"), "please report it: ValueError: of ours"),
        (BrokenExecutor(), "the process that judged it died"),
    ],
)
def test_an_error_of_a_worker_is_the_answer_of_its_log(tmp_path: Path, error: Exception, words: str) -> None:
    paths = made(tmp_path, "a.tlog", "b.tlog")
    answers = list(scan(logs_named(paths).logs, asked(), failing(error)))
    assert len(answers) == 2
    assert all(words in one.verdict.reason for one in answers)


def test_that_no_worker_is_left_is_told_once_and_the_scan_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked_for: list[Future[Any]] = []
    looks: list[bool] = []

    class Deserted(Executor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            asked_for.append(Future())
            return asked_for[-1]

    def manned() -> bool:
        looks.append(len(looks) >= 3)
        if looks[-1]:
            asked_for[-1].set_result(Record("ab", LogVerdict("", Verdict.HEALTHY, "no alarm")))
        return looks[-1]

    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        yield TaskExecutor(Deserted(), 2, (), manned)

    monkeypatch.setattr(module, "QUIET_S", 0.001)
    warned: list[str] = []
    logs = logs_named(made(tmp_path, "a.tlog")).logs
    (answer,) = scan(logs, asked(), opened, None, warned.append)
    assert answer.verdict.verdict is Verdict.HEALTHY
    assert (len(warned), warned[0].startswith("no worker is left; waiting")) == (1, True)


def test_workers_that_never_live_are_told(tmp_path: Path) -> None:
    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        raise BrokenExecutor("no process")
        yield

    with pytest.raises(UsageError, match="use --jobs 1"):
        list(scan(logs_named(made(tmp_path, "a.tlog")).logs, asked(), opened))


def test_a_scheduler_that_goes_away_ends_the_scan(tmp_path: Path) -> None:
    class Gone(Executor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        yield TaskExecutor(Gone(), 2)

    logs = logs_named(made(tmp_path, "a.tlog")).logs
    with pytest.raises(LinkError, match="the scheduler went away"):
        list(scan(logs, asked(), opened))
    with pytest.raises(LinkError, match="another version"):
        list(scan(logs, asked(), failing(LinkError("a worker has another version"))))


def test_answers_that_cannot_be_kept_are_told_once_and_lose_nothing(tmp_path: Path) -> None:
    paths = made(tmp_path, "a.tlog", "b.tlog")
    cache = open_cache(tmp_path / "cache", asked().scope)
    cache.folder.rmdir()
    warned: list[str] = []
    answers = list(scan(logs_named(paths).logs, asked(), HERE, cache, warned.append))
    assert {one.verdict.verdict for one in answers} == {Verdict.HEALTHY}
    assert len(warned) == 1
    assert warned[0].startswith("answers are not kept any more: ")


def test_answers_wait_for_those_before_them() -> None:
    def answer(number: int) -> Answer:
        return Answer(number, Path(str(number)), refused("x"), fresh=True)

    came: list[int] = []

    def coming() -> Iterator[Answer]:
        for number in (1, 0, 3, 2):
            came.append(number)
            yield answer(number)

    seen = [(one.number, len(came)) for one in in_order(coming())]
    assert seen == [(0, 2), (1, 2), (2, 4), (3, 4)]
