"""The answers of a scan: each log once, in order, each content judged once, whatever the workers do."""

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
from mavdiag.archive.job import Question, Record, digest_of, judge_file, mark_of, open_cache
from mavdiag.archive.paths import logs_named
from mavdiag.archive.pool import TaskExecutor, in_this_process
from mavdiag.archive.scan import scan
from mavdiag.errors import LinkError, UsageError
from mavdiag.judging import LogVerdict, Verdict

HERE = in_this_process
QUESTION = Question("baseline", asked().options, "version", "scope")
Opened = Callable[[], AbstractContextManager[TaskExecutor]]


class KilledError(Exception):
    """As Dask says that a task's workers died."""


class Workers(Executor):
    """Workers that do nothing until they are asked for a result, then any of their tasks; and that can die.

    order: draws the next task to finish. deadly: paths that end the worker. judged: contents that were judged.
    """

    def __init__(self, order: np.random.Generator, deadly: frozenset[str], judged: list[str]) -> None:
        self._order, self._deadly, self._judged = order, deadly, judged
        self._waiting: list[tuple[Future[Any], str]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self._waiting.append((future, args[0]))
        return future

    def finish_one(self) -> None:
        future, path = self._waiting.pop(int(self._order.integers(len(self._waiting))))
        if Path(path).name in self._deadly:
            for other in (future, *(waiting for waiting, _ in self._waiting)):
                other.set_exception(BrokenExecutor("a process died"))
            self._waiting.clear()
            return
        text = Path(path).read_text()
        self._judged.append(text)
        future.set_result(Record(text, LogVerdict("", Verdict.HEALTHY, text)))


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

    def wait(running: dict[Future[Any], Any], **_: object) -> tuple[set[Future[Any]], set[Future[Any]]]:
        if not any(future.done() for future in running):
            now[0].finish_one()
        return {future for future in running if future.done()}, set()

    with monkeypatch.context() as patch:
        patch.setattr(module, "wait", wait)
        yield opened


@given(
    st.lists(st.sampled_from("abcdefgh"), min_size=1, max_size=14),
    st.integers(0, 2**31),
    st.frozensets(st.integers(0, 13), max_size=3),
    st.sampled_from(["", "abcd", "abcdefgh"]),
)
def test_each_log_is_answered_once_in_order_and_each_content_judged_once(
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
        patch.setattr(module, "digest_of", Path.read_text)
        answers = list(scan(logs_named(paths).logs, QUESTION, opened))
    assert [answer.verdict.log for answer in answers] == [str(path) for path in paths]
    whole = set(contents) - {contents[number] for number in deadly if number < len(contents)}
    for answer, text in zip(answers, contents, strict=True):
        if answer.verdict.verdict is Verdict.ERROR:
            assert text not in whole
            assert "the process that judged it died" in answer.verdict.reason
        else:
            assert answer.verdict.reason == text
    assert whole <= {answer.record.digest for answer in answers}
    if not deadly:
        assert sorted(judged) == sorted(set(contents))
    assert sum(answer.fresh for answer in answers) == len(set(contents))
    shutil.rmtree(folder)


def test_answers_are_kept_as_they_come_and_errors_are_not(tmp_path: Path) -> None:
    a, b = made(tmp_path, "a.tlog", "b.tlog")
    bad = tmp_path / "bad.tlog"
    bad.write_text("no log")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))
    cache = open_cache(tmp_path / "cache", asked().scope)
    logs = logs_named([a, bad, copy, b]).logs
    run = scan(logs, asked(), HERE, cache)
    first = next(run)
    assert (first.path, first.fresh, len(list(cache.folder.iterdir()))) == (a, True, 1)
    run.close()  # as Ctrl-C does
    answers = list(scan(logs, asked(), HERE, cache))
    assert [(answer.path, answer.fresh) for answer in answers] == [(a, False), (bad, True), (copy, False), (b, True)]
    assert len(list(cache.folder.iterdir())) == 2
    assert answers[1].verdict.verdict is Verdict.ERROR
    assert answers[1].verdict.reason.startswith("not a flight log of a known kind")
    assert answers[0].record == first.record == answers[2].record != answers[3].record

    def opened() -> AbstractContextManager[TaskExecutor]:
        raise AssertionError("workers were opened for what is known")

    again = list(scan(logs_named([b, a]).logs, asked(), opened, cache))
    assert [(answer.fresh, answer.record) for answer in again] == [(False, answers[3].record), (False, first.record)]


def test_a_file_that_changes_while_it_is_judged_answers_for_itself_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (a,) = made(tmp_path, "a.tlog")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))

    def digest(path: Path) -> str:
        return digest_of(copy)  # as it was before the change

    def changing(path: str, question: Question) -> Record:
        if path == str(a):
            a.write_bytes(content(9))
        return judge_file(path, question)

    monkeypatch.setattr(module, "digest_of", digest)
    monkeypatch.setattr(module, "judge_file", changing)
    cache = open_cache(tmp_path / "cache", asked().scope)

    @contextmanager
    def two() -> Iterator[TaskExecutor]:
        with HERE() as here:
            yield TaskExecutor(here.pool, 2)

    answers = list(scan(logs_named([a, copy]).logs, asked(), two, cache))
    assert [answer.record.digest for answer in answers] == [digest_of(a), digest_of(copy)]
    assert {path.name for path in cache.folder.iterdir()} == {
        f"{mark_of(copy)}-{answer.record.digest}.json" for answer in answers
    }


def giving(future: Future[Any]) -> Opened:
    """Workers whose tasks all end alike."""

    class Giving(Executor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            given_up: Future[Any] = Future()
            if future.cancelled():
                given_up.cancel()
                given_up.set_running_or_notify_cancel()
            else:
                given_up.set_exception(future.exception())
            return given_up

    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        yield TaskExecutor(Giving(), 2, (KilledError,))

    return opened


def failing(error: Exception) -> Opened:
    future: Future[Any] = Future()
    future.set_exception(error)
    return giving(future)


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
    assert all(words in answer.verdict.reason for answer in answers)


def test_workers_that_cannot_go_on_end_the_scan(tmp_path: Path) -> None:
    logs = logs_named(made(tmp_path, "a.tlog")).logs
    cancelled: Future[Any] = Future()
    cancelled.cancel()

    @contextmanager
    def never() -> Iterator[TaskExecutor]:
        raise BrokenExecutor("no process")
        yield

    for opened, kind, words in (
        (never, UsageError, "use --jobs 1"),
        (giving(cancelled), LinkError, "the scheduler went away"),
        (failing(LinkError("a worker has another version")), LinkError, "another version"),
    ):
        with pytest.raises(kind, match=words):
            list(scan(logs, asked(), opened))


def test_that_no_worker_is_left_is_told_once_and_the_scan_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submitted: list[Future[Any]] = []
    looks: list[bool] = []

    class Deserted(Executor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            submitted.append(Future())
            return submitted[-1]

    def manned() -> bool:
        looks.append(len(looks) >= 3)
        if looks[-1]:
            submitted[-1].set_result(Record("ab", LogVerdict("", Verdict.HEALTHY, "no alarm")))
        return looks[-1]

    @contextmanager
    def opened() -> Iterator[TaskExecutor]:
        yield TaskExecutor(Deserted(), 2, (), manned)

    monkeypatch.setattr(module, "QUIET_S", 0.001)
    warned: list[str] = []
    (answer,) = scan(logs_named(made(tmp_path, "a.tlog")).logs, asked(), opened, None, warned.append)
    assert answer.verdict.verdict is Verdict.HEALTHY
    assert (len(warned), warned[0].startswith("no worker is left; waiting")) == (1, True)


def test_answers_that_cannot_be_kept_are_told_once_and_lose_nothing(tmp_path: Path) -> None:
    paths = made(tmp_path, "a.tlog", "b.tlog")
    cache = open_cache(tmp_path / "cache", asked().scope)
    cache.folder.rmdir()
    warned: list[str] = []
    answers = list(scan(logs_named(paths).logs, asked(), HERE, cache, warned.append))
    assert {answer.verdict.verdict for answer in answers} == {Verdict.HEALTHY}
    assert len(warned) == 1
    assert warned[0].startswith("answers are not kept any more: ")
