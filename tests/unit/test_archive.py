"""Many logs: what names them, the answers and how they are kept, windows, and the table."""

import csv
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying, without
from hypothesis import given
from hypothesis import strategies as st
from made_archive import MONITORS, archive_baseline, asked, content, made
from made_baselines import logged, whole
from worker_task import work

from mavdiag.archive import pool
from mavdiag.archive import scan as module
from mavdiag.archive.figures import windows_of
from mavdiag.archive.paths import logs_named
from mavdiag.archive.pool import TaskExecutor, run_all
from mavdiag.archive.scan import (
    Answer,
    Cache,
    Options,
    Question,
    Record,
    digest_of,
    digest_of_sources,
    judge_file,
    judging_version,
    open_cache,
    refused,
    scan,
)
from mavdiag.archive.tables import COLUMNS, rows_of, write_csv, write_parquet
from mavdiag.decision.alarm import Change
from mavdiag.errors import InputError, UsageError
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, judge_in_full
from mavdiag.monitors import BY_NAME

LOG = content(1, 200)
DIGEST = "ab" * 32
PAGE = (Path(__file__).parents[2] / "docs" / "operating.md").read_text(encoding="utf-8")
NAMES = list(COLUMNS)
NEW = flying(4000, 5, weak_rotor=3, rise=0.2)


def tree(folder: Path, *names: str) -> Path:
    """Logs below a folder; a name that ends in .txt is none."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"notes" if name.endswith(".txt") else LOG)
    return folder


def below(folder: Path, *arguments: str) -> list[str]:
    return [str(one.path.relative_to(folder)) for one in logs_named([folder / a for a in arguments]).logs]


def test_a_folder_is_all_logs_below_it_by_name_and_what_is_no_log_is_counted(tmp_path: Path) -> None:
    tree(tmp_path, "b/2.tlog", "b/1.dat", "a.tlog", "z/y/x.tlog", "notes.txt", "b/notes.txt", ".git/a.tlog", ".b.tlog")
    (tmp_path / "empty.tlog").touch()
    found = logs_named([tmp_path])
    assert below(tmp_path, ".") == ["a.tlog", "b/1.dat", "b/2.tlog", "z/y/x.tlog"]
    assert found.skipped == 3


def test_a_pattern_is_what_it_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree(tmp_path, "a/1.tlog", "a/2.tlog", "b/3.tlog", "b/notes.txt", "c[1].tlog")
    assert below(tmp_path, "*/*.tlog") == ["a/1.tlog", "a/2.tlog", "b/3.tlog"]
    assert below(tmp_path, "**/[23]*") == ["a/2.tlog", "b/3.tlog"]
    assert below(tmp_path, "[ab]") == ["a/1.tlog", "a/2.tlog", "b/3.tlog"]
    assert logs_named([tmp_path / "b" / "*"]).skipped == 1
    assert below(tmp_path, "c[1].tlog") == ["c[1].tlog"]
    monkeypatch.chdir(tmp_path)
    assert [str(one.path) for one in logs_named(["*/1*"]).logs] == ["a/1.tlog"]


@pytest.mark.parametrize("argument", ["nothing", "*.ulg", "nothing/*"])
def test_what_names_no_log_is_trouble_and_an_error_where_all_are_needed(tmp_path: Path, argument: str) -> None:
    (tmp_path / "nothing").mkdir()
    (one,) = logs_named([tmp_path / argument]).logs
    assert one.trouble.startswith("no log there; name files, a folder, or a pattern")
    with pytest.raises(InputError, match="no log there"):
        logs_named([tmp_path / argument]).paths()


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


@pytest.mark.parametrize("package", ["numpy", "scipy"])
def test_the_version_is_that_of_the_sources_and_of_what_computes(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An upgrade must not keep the answers of before."""
    before, installed = digest_of_sources.__wrapped__(("mavdiag",)), metadata.version
    assert judging_version() == before
    assert digest_of_sources(("mavdiag",), ("__pycache__", "mavdiag/monitors/innovation.py")) != before
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.0" if name == package else installed(name))
    assert digest_of_sources.__wrapped__(("mavdiag",)) != before


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

    @contextmanager
    def opened(address: str) -> Iterator[TaskExecutor]:
        cluster = Cluster()
        yield TaskExecutor(cluster, 2, lambda: manned(cluster))

    monkeypatch.setattr(pool, "QUIET_S", 0.001)
    monkeypatch.setattr(pool, "dask_executor", opened)
    (answer,) = scan(logs_named(made(tmp_path, "a.tlog")).logs, asked(), "tcp://there", None, warned.append)
    assert words in answer.verdict.reason
    assert (len(warned), warned[0].startswith("no worker is left; waiting")) == (1, True)


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> list[Answer]:
    """A healthy log, one with a fault in windows, and one that cannot be read."""
    whole, shaken = made(tmp_path_factory.mktemp("logs"), "a, b.tlog", "crack.tlog", shaken=("crack.tlog",))
    return [
        Answer(whole, judge_file(str(whole), asked()), fresh=True),
        Answer(shaken, judge_file(str(shaken), asked(Options(windows_s=5.0))), fresh=True),
        Answer(Path("x.tlog"), refused("no such file"), fresh=True),
    ]


def dicts(answers: list[Answer]) -> list[dict[str, object]]:
    return [{name: row.get(name) for name in NAMES} for answer in answers for row in rows_of(answer)]


def test_a_row_says_what_the_verdict_says(answers: list[Answer]) -> None:
    healthy, *windows, error = dicts(answers)
    verdict = answers[0].verdict
    assert (healthy["log"], healthy["verdict"], healthy["reason"]) == (verdict.log, "healthy", verdict.reason)
    assert (healthy["judged_s"], healthy["from_s"], healthy["since_s"]) == (verdict.judged_s, None, None)
    for monitor in verdict.monitors:
        assert healthy[f"{monitor.name}_judged_s"] == monitor.judged_s
        assert monitor.maximum is not None
        assert healthy[f"{monitor.name}_ratio"] == monitor.maximum / monitor.threshold
    unused = set(BY_NAME) - set(MONITORS)
    assert {healthy[f"{name}_judged_s"] for name in unused} == {None}
    assert [row["verdict"] for row in windows] == ["healthy", "fault", "fault"]
    assert {row["log_verdict"] for row in windows} == {"fault"}
    assert [row["to_s"] for row in windows] == [10.0, 15.0, 20.0]
    assert {row["since_s"] for row in windows} == {answers[1].verdict.events[-1].t_s} or windows[0]["since_s"]
    assert [row["ratio"] for row in windows] == [one.ratio for one in answers[1].record.windows]
    assert (error["verdict"], error["reason"], error["sha256"]) == ("error", "no such file", None)


def test_csv_and_parquet_hold_the_same(answers: list[Answer], tmp_path: Path) -> None:
    rows = [row for answer in answers for row in rows_of(answer)]
    write_csv(tmp_path / "a.csv", rows)
    with (tmp_path / "a.csv").open(newline="") as file:
        text = list(csv.DictReader(file))
    assert list(text[0]) == NAMES
    back = [{name: COLUMNS[name](value) if value else None for name, value in row.items()} for row in text]
    assert back == dicts(answers)
    pytest.importorskip("pyarrow", reason="it is an extra")
    from pyarrow.parquet import read_table

    write_parquet(tmp_path / "a.parquet", rows)
    table = read_table(str(tmp_path / "a.parquet"))
    assert table.to_pylist() == dicts(answers)
    write_parquet(tmp_path / "none.parquet", [])
    assert read_table(str(tmp_path / "none.parquet")).schema == table.schema


def test_every_column_is_in_the_manual() -> None:
    section = PAGE[PAGE.index("## An archive of logs") :]
    named = set(re.findall(r"`([a-z_A-Z0-9]+)`", section))
    own = [name for name in NAMES if not any(name.startswith(f"{monitor}_") for monitor in BY_NAME)]
    assert set(own) <= named
    assert {"MONITOR_judged_s", "MONITOR_ratio"} <= named


@pytest.fixture(scope="module")
def flight() -> JudgedFlight:
    """Healthy for 20 s, then with a weak rotor for 20 s, after a gap of one second."""
    healthy = without(flying(4000, 5), (20.0, 100.0))
    weak = without(NEW, (0.0, 21.0))
    parts = tuple(
        replace(
            one,
            t_ns=np.concatenate((one.t_ns, two.t_ns)),
            host_ns=np.concatenate((one.host_ns, two.host_ns)),
            values=np.concatenate((one.values, two.values)),
        )
        for one, two in zip(healthy.series, weak.series, strict=True)
    )
    return judge_in_full(logged(replace(healthy, series=parts)), whole())


def test_the_windows_add_up_to_the_accounts_of_the_flight(flight: JudgedFlight) -> None:
    windows = windows_of(flight, 5.0)
    assert [(one.from_s, one.to_s) for one in windows] == [(5.0 * k, 5.0 * k + 5.0) for k in range(9)]
    for monitor in flight.verdict.monitors:
        own = [one for window in windows for one in window.monitors if one.name == monitor.name]
        assert len(own) == len(windows)
        assert sum(one.judged_s for one in own) == pytest.approx(monitor.judged_s, abs=0.5)
        assert monitor.maximum is not None
        highest = max(one.ratio for one in own if one.ratio is not None)
        assert highest == pytest.approx(monitor.maximum / monitor.threshold)
    assert sum(one.judged_s for one in windows) == pytest.approx(flight.verdict.judged_s, abs=0.5)
    decided = [(one.maximum or 0.0) / one.threshold for one in flight.verdict.monitors if one.decides]
    assert max(one.ratio or 0.0 for one in windows) == pytest.approx(max(decided))
