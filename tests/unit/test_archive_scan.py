"""The answers of a scan: each log once, in order, each content judged once, whatever the workers do."""

import os
import shutil
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_archive import asked, content, made

from mavdiag.archive import pool
from mavdiag.archive import scan as module
from mavdiag.archive.paths import logs_named
from mavdiag.archive.pool import TaskExecutor, run_all
from mavdiag.archive.scan import Question, Record, digest_of, judge_file, open_cache, scan
from mavdiag.errors import LinkError, UsageError
from mavdiag.judging import LogVerdict, Verdict


def in_drawn_order(seed: int, deadly: frozenset[str]) -> Callable[..., Iterator[Any]]:
    """As `run_all`, but of the four tasks that are out at a time any ends next; `deadly` ones end their worker."""
    order = np.random.default_rng(seed)

    def run(function: Callable[[Any], Any], tasks: Iterable[Any], *_: Any, known: Any, **__: Any) -> Iterator[Any]:
        out: list[Any] = []
        for task in (*tasks, None, None, None, None):
            out += [] if task is None else [task]
            if out and (task is None or len(out) == 4):
                chosen, future = out.pop(int(order.integers(len(out)))), Future[Any]()
                if Path(chosen).name in deadly:
                    future.set_exception(BrokenExecutor("a process died"))
                else:
                    future.set_result(known(chosen) or function(chosen))
                yield chosen, future

    return run


@given(
    st.lists(st.sampled_from("abcdefgh"), min_size=1, max_size=14),
    st.integers(0, 2**31),
    st.frozensets(st.sampled_from([str(k) for k in range(14)]), max_size=3),
)
def test_each_log_is_answered_once_in_order_and_each_content_judged_once(
    tmp_path_factory: pytest.TempPathFactory, contents: list[str], seed: int, deadly: frozenset[str]
) -> None:
    folder, judged = tmp_path_factory.mktemp("logs"), list[str]()
    paths = [folder / str(number) for number in range(len(contents))]
    for path, text in zip(paths, contents, strict=True):
        path.write_text(text)

    def judge(path: str, question: Question) -> Record:
        judged.append(Path(path).read_text())
        return Record(digest_of(Path(path)), LogVerdict("", Verdict.HEALTHY, judged[-1]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "run_all", in_drawn_order(seed, deadly))
        patch.setattr(module, "judge_file", judge)
        answers = list(scan(logs_named(paths).logs, asked()))
    assert [answer.verdict.log for answer in answers] == [str(path) for path in paths]
    first = {text: str(contents.index(text)) for text in contents}
    assert sorted(judged) == sorted(text for text, name in first.items() if name not in deadly)
    for text, answer in zip(contents, answers, strict=True):
        died = first[text] in deadly
        assert answer.verdict.verdict is (Verdict.ERROR if died else Verdict.HEALTHY)
        assert answer.verdict.reason == (module.DIED if died else text)
    assert sum(answer.fresh for answer in answers) == len(set(contents))


def test_answers_are_kept_and_found_again_and_errors_are_not(tmp_path: Path) -> None:
    a, b = made(tmp_path, "a.tlog", "b.tlog")
    bad = tmp_path / "bad.tlog"
    bad.write_text("no log")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))
    cache, kept = open_cache(tmp_path / "cache", asked().scope), tmp_path / "cache" / "scan" / asked().scope
    logs = logs_named([a, bad, copy, b, tmp_path / "absent.tlog"]).logs
    run = scan(logs, asked(), 1, cache)
    first = next(run)
    assert (first.path, first.fresh, len(list(kept.iterdir()))) == (a, True, 1)
    run.close()  # as Ctrl-C does
    answers = list(scan(logs, asked(), 1, open_cache(tmp_path / "cache", asked().scope)))
    assert [answer.fresh for answer in answers] == [False, True, False, True, True]
    assert len(list(kept.iterdir())) == 2
    assert answers[0].record == first.record == answers[2].record != answers[3].record
    for answer, words in ((answers[1], "not a flight log of a known kind"), (answers[4], "no such file")):
        assert answer.verdict.verdict is Verdict.ERROR
        assert answer.verdict.reason.startswith(words)


def test_a_file_that_changes_while_it_is_judged_answers_for_itself_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (a,) = made(tmp_path, "a.tlog")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))

    def changing(path: str, question: Question) -> Record:
        if path == str(a):
            a.write_bytes(content(9))
        return judge_file(path, question)

    monkeypatch.setattr(module, "judge_file", changing)
    monkeypatch.setattr(module, "digest_of", lambda path, now=digest_of: now(copy))
    cache = open_cache(tmp_path / "cache", asked().scope)
    answers = list(scan(logs_named([a, copy]).logs, asked(), 1, cache))
    assert [answer.record.digest for answer in answers] == [digest_of(a), digest_of(copy)]
    assert [path.stem for path in (tmp_path / "cache").rglob("*.json")] == [digest_of(a)]


def test_answers_that_cannot_be_kept_are_told_once_and_lose_nothing(tmp_path: Path) -> None:
    paths, warned = made(tmp_path, "a.tlog", "b.tlog"), list[str]()
    cache = open_cache(tmp_path / "cache", asked().scope, warned.append)
    shutil.rmtree(tmp_path / "cache")
    answers = list(scan(logs_named([*paths, paths[0]]).logs, asked(), 1, cache))
    assert [answer.verdict.verdict for answer in answers] == [Verdict.HEALTHY] * 3
    assert (len(warned), warned[0].startswith("answers are not kept any more: ")) == (1, True)


def work(task: int) -> int:
    """In a worker process."""
    if task < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 0:
        raise ValueError("of\nours")
    return task * task


def test_run_all_gives_every_task_its_result_though_workers_die() -> None:
    ended = dict(run_all(work, iter([1, -1, 2, 0, -2, 3, 4, 5]), 2, known=lambda task: 99 if task == 5 else None))
    assert {task: future.result() for task, future in ended.items() if task > 0} == {1: 1, 2: 4, 3: 9, 4: 16, 5: 99}
    assert isinstance(ended[0].exception(), ValueError)
    assert {type(ended[task].exception()).__base__ for task in (-1, -2)} == {BrokenExecutor}
    assert [(task, future.result()) for task, future in run_all(work, [2, 3], 1)] == [(2, 4), (3, 9)]


class Cluster(Executor):
    """As that of Dask, whose tasks end when they are told to."""

    def __init__(self) -> None:
        self.tasks: list[Future[Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.tasks.append(Future())
        return self.tasks[-1]


def on_cluster(monkeypatch: pytest.MonkeyPatch, manned: Callable[[Cluster], bool]) -> None:
    @contextmanager
    def opened(address: str) -> Iterator[TaskExecutor]:
        cluster = Cluster()
        yield TaskExecutor(cluster, 2, lambda: manned(cluster))

    monkeypatch.setattr(pool, "QUIET_S", 0.001)
    monkeypatch.setattr(pool, "dask_executor", opened)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (type("KilledWorker", (Exception,), {})(), "the process that judged it died"),
        (MemoryError(), "the process that judged it died"),
        (ValueError("of\nours"), "please report it: ValueError: of ours"),
    ],
)
def test_an_error_of_a_worker_is_the_answer_of_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, words: str
) -> None:
    """And that no worker is left is told once, and waited for."""
    looks, warned = list[int](), list[str]()

    def manned(cluster: Cluster) -> bool:
        looks.append(1)
        cluster.tasks[-1].set_exception(error)
        return False

    on_cluster(monkeypatch, manned)
    (answer,) = scan(logs_named(made(tmp_path, "a.tlog")).logs, asked(), "tcp://there", None, warned.append)
    assert words in answer.verdict.reason
    assert (len(warned), warned[0].startswith("no worker is left; waiting")) == (1, True)


def test_workers_that_cannot_go_on_end_the_scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = logs_named(made(tmp_path, "a.tlog", "b.tlog")).logs
    for end, words in (
        (lambda future: future.cancel() and future.set_running_or_notify_cancel(), "the scheduler went away"),
        (lambda future: future.set_exception(LinkError("a worker has another version")), "another version"),
    ):
        on_cluster(monkeypatch, lambda cluster, end=end: bool(end(cluster.tasks[0])) or True)  # type: ignore[misc]
        with pytest.raises(LinkError, match=words):
            list(scan(logs, asked(), "tcp://there"))
    monkeypatch.setattr(pool, "_settle", os._exit)  # fails for want of an argument, so that no worker starts
    with pytest.raises(UsageError, match="use --jobs 1"):
        list(scan(logs, asked(), 2))
