"""Many logs: answers and how they are kept, windows, the table; and the history: trends, warnings, the store."""

import csv
import json
import math
import os
import pwd
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
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
from made_history import DAY_NS, START_NS, record, records, series
from sqlalchemy import create_engine, text, update
from worker_task import work

from mavdiag.archive import pool
from mavdiag.archive import scan as module
from mavdiag.archive import together as of_flights
from mavdiag.archive.figures import FlightRecord, windows_of
from mavdiag.archive.paths import Found, Named, logs_named
from mavdiag.archive.pool import TaskExecutor, run_all
from mavdiag.archive.scan import Answer, Cache, Options, Question, Record, digest_of, judge_file, open_cache, scan
from mavdiag.archive.tables import COLUMNS, rows_of, write_csv, write_parquet
from mavdiag.archive.together import Reference, together
from mavdiag.baseline import SourceLog
from mavdiag.commands.scan import _lines
from mavdiag.decision.alarm import Change
from mavdiag.errors import InputError, UsageError
from mavdiag.history.show import lines_of, overview_json
from mavdiag.history.store import VERSION, address_of, open_history
from mavdiag.history.trend import MEMORY, Sessions, Trend, changes_of, sessions_of, trend_of
from mavdiag.history.warn import Mark, MarkKind, Outlook, overview_of, review, series_of, stretches_of, warned_at
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, judge_in_full
from mavdiag.monitors import BY_NAME
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.evidence import Evidence, Flown, evidence_of
from mavdiag.units import NS_PER_S

LOG = content(1, 200)
DIGEST = "ab" * 32
NAMES = list(COLUMNS)
NEW = flying(4000, 5, weak_rotor=3, rise=0.2)


def tree(folder: Path, *names: str) -> Path:
    """Logs below a folder; a name that ends in .txt is none."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"\xfd notes \xfe" * 9 if name.endswith(".txt") else LOG)
    return folder


def below(folder: Path, *arguments: str) -> list[str]:
    return [str(one.path.relative_to(folder)) for one in logs_named([folder / a for a in arguments]).logs]


def test_a_folder_is_all_logs_below_it_by_name_and_what_is_no_log_is_counted(tmp_path: Path) -> None:
    tree(tmp_path, "b/2.tlog", "b/1.dat", "a.tlog", "z/y/x.tlog", "notes.txt", "b/notes.txt", ".git/a.tlog", ".b.tlog")
    (tmp_path / "empty.tlog").touch()
    found = logs_named([tmp_path])
    assert (below(tmp_path, "."), found.skipped) == (["a.tlog", "b/1.dat", "b/2.tlog", "z/y/x.tlog"], 3)


def test_a_pattern_is_what_it_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree(tmp_path, "a/1.tlog", "a/2.tlog", "a/.2.tlog", "b/3.tlog", "b/notes.txt", "c[1].tlog")
    assert below(tmp_path, "a/.*") == ["a/.2.tlog"]
    assert below(tmp_path, "*/*.tlog") == ["a/1.tlog", "a/2.tlog", "b/3.tlog"]
    assert below(tmp_path, "**/[23]*") == ["a/2.tlog", "b/3.tlog"]
    assert below(tmp_path, "[ab]") == below(tmp_path, "[ab]/**") == ["a/1.tlog", "a/2.tlog", "b/3.tlog"]
    assert (logs_named([tmp_path / "b" / "*"]).skipped, below(tmp_path, "c[1].tlog")) == (1, ["c[1].tlog"])
    monkeypatch.chdir(tmp_path)
    assert [str(one.path) for one in logs_named(["*/1*"]).logs] == ["a/1.tlog"]
    monkeypatch.setattr(Path, "is_dir", lambda one: one.name == "b" or ("3" in one.name and Path("gone").stat()))
    assert logs_named(["b"]) == Found((Named(Path("b/3.tlog"), "cannot be read (No such file or directory)"),), 1)


@pytest.mark.parametrize("argument", ["nothing", "*.ulg", "nothing/*"])
def test_what_names_no_log_is_trouble_and_an_error_where_all_are_needed(tmp_path: Path, argument: str) -> None:
    (tmp_path / "nothing").mkdir()
    assert len(logs_named([tmp_path / argument]).logs) == 1
    with pytest.raises(InputError, match="no log there; name files, a folder, or a pattern"):
        logs_named([tmp_path / argument]).paths()


@given(st.from_type(Record))
def test_an_answer_is_the_same_when_it_is_read_again(tmp_path_factory: pytest.TempPathFactory, record: Record) -> None:
    """By its text, for what is no number differs from itself."""
    folder, record = tmp_path_factory.mktemp("cache"), replace(record, digest=DIGEST)
    Cache(folder).put(record)
    again = Cache(folder).get(DIGEST)
    assert again is not None
    assert str(again) == str(record)
    assert type(again.verdict.verdict) is Verdict
    assert [type(change) for change in again.verdict.changes] == [Change] * len(record.verdict.changes)


def test_every_option_the_baseline_and_the_code_make_another_question(monkeypatch: pytest.MonkeyPatch) -> None:
    options = [Options(), Options(vehicle=1), Options(from_s=1.0), Options(to_s=1.0), Options(windows_s=1.0)]
    options += [Options(figures=True), Options(flown_ns=1)]
    scopes = [asked(option).scope for option in options]
    scopes.append(Question.of(archive_baseline().model_copy(update={"digest": "sha256:other"}), Options()).scope)
    monkeypatch.setattr("mavdiag.archive.scan.judging_version", lambda: "other")
    assert (len({*scopes, asked().scope}), asked().scope) == (len(scopes) + 1, asked().scope)


def test_a_damaged_file_and_one_of_another_log_are_no_answers(tmp_path: Path) -> None:
    record = Record(DIGEST, LogVerdict("", Verdict.HEALTHY, "no alarm"))
    Cache(tmp_path).put(record)
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
    before, installed = module.digest_of_sources.__wrapped__(("mavdiag",)), metadata.version
    assert module.judging_version() == before
    assert module.digest_of_sources(("mavdiag",), ("__pycache__", "mavdiag/monitors/innovation.py")) != before
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.0" if name == package else installed(name))
    assert module.digest_of_sources.__wrapped__(("mavdiag",)) != before


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
    for path, words in zip(paths, contents, strict=True):
        path.write_text(words)

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
    for words, answer in zip(contents, answers, strict=True):
        died = first[words] in deadly
        assert answer.verdict.verdict is (Verdict.ERROR if died else Verdict.HEALTHY)
        assert answer.verdict.reason == (module.DIED if died else words)
    assert [words for words, answer in zip(contents, answers, strict=True) if not answer.copy] == list(first)


def test_answers_are_kept_and_found_again_and_errors_are_not(tmp_path: Path) -> None:
    a, b = made(tmp_path, "a.tlog", "b.tlog")
    (bad := tmp_path / "bad.tlog").write_text("no log")
    copy = Path(shutil.copy(a, tmp_path / "copy.tlog"))
    cache, kept = open_cache(tmp_path / "cache", asked().scope), tmp_path / "cache" / "scan" / asked().scope
    logs = logs_named([a, bad, copy, b, tmp_path / "absent.tlog"]).logs
    run = scan(logs, asked(), 1, cache)
    first = next(run)
    assert (first.path, first.known, len(list(kept.iterdir()))) == (a, False, 1)
    run.close()  # as Ctrl-C does
    answers = list(scan(logs, asked(), 1, open_cache(tmp_path / "cache", asked().scope)))
    assert ([one.known for one in answers], len(list(kept.iterdir()))) == ([True, False, False, False, False], 2)
    assert answers[0].record == first.record == answers[2].record != answers[3].record
    for answer, words in ((answers[1], "not a flight log of a known kind"), (answers[4], "no such file")):
        assert answer.verdict.verdict is Verdict.ERROR
        assert answer.verdict.reason.startswith(words)


def test_only_what_may_be_a_copy_is_read_to_tell_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of one beginning and one size are told apart by their ends; with answers kept every log is looked up."""
    read, cache = list[str](), open_cache(tmp_path / "cache", asked().scope)
    beginning = bytes(module.HEAD_BYTES)
    contents = {"a": beginning + b"1", "b": beginning + b"2", "c": beginning + b"1", "d": beginning, "e": b"\1"}
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)

    def digested(path: Path) -> str:
        read.append(path.name)
        return digest_of(path)

    def judge(path: str, question: Question) -> Record:
        return Record(digest_of(Path(path)), LogVerdict("", Verdict.HEALTHY, Path(path).name))

    monkeypatch.setattr(module, "digest_of", digested)
    monkeypatch.setattr(module, "judge_file", judge)
    logs = logs_named([tmp_path / name for name in contents]).logs
    assert [answer.verdict.reason for answer in scan(logs, asked(), 1, cache)] == ["a", "b", "a", "d", "e"]
    assert read == ["a", "b", "c"]
    assert [answer.known for answer in scan(logs, asked(), 1, cache)] == [True, True, False, True, True]
    assert read[3:] == list(contents)


def test_run_all_gives_every_task_its_result_though_workers_die() -> None:
    ended = dict(run_all(work, iter([1, -1, 2, 0, -2, 3, 4, 5]), 2, known=lambda task: 99 if task == 5 else None))
    assert {task: future.result() for task, future in ended.items() if task > 0} == {1: 1, 2: 4, 3: 9, 4: 16, 5: 99}
    assert isinstance(ended[0].exception(), ValueError)
    assert {type(ended[task].exception()).__base__ for task in (-1, -2)} == {BrokenExecutor}
    ended = dict(run_all(lambda task: len(bytes(1 << task)), [3, 60, 2], 1))
    assert (ended[3].result(), type(ended[60].exception()), ended[2].result()) == (8, MemoryError, 4)


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
        Answer(whole, judge_file(str(whole), asked())),
        Answer(shaken, judge_file(str(shaken), asked(Options(windows_s=5.0)))),
        Answer(Path("x.tlog"), module.refused("no such file")),
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
    assert {healthy[f"{name}_judged_s"] for name in set(BY_NAME) - set(MONITORS)} == {None}
    assert [row["verdict"] for row in windows] == ["healthy", "fault", "fault"]
    assert {row["log_verdict"] for row in windows} == {"fault"}
    assert [row["to_s"] for row in windows] == [10.0, 15.0, 20.0]
    assert {row["since_s"] for row in windows} == {answers[1].verdict.events[-1].t_s} or windows[0]["since_s"]
    assert [row["ratio"] for row in windows] == [one.ratio for one in answers[1].record.windows]
    assert (error["verdict"], error["reason"], error["sha256"]) == ("error", "no such file", None)
    last = replace(answers[1].record.windows[-1], from_s=1.7e9 + 15, to_s=1.7e9 + 20)  # by the unix clock of a CSV
    record = replace(answers[1].record, windows=(last,))
    assert "  1700000015 to 1700000020 s: fault" in _lines(replace(answers[1], record=record))[-1]


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


@pytest.fixture(scope="module")
def flight() -> JudgedFlight:
    """Healthy for 20 s, then with a weak rotor for 20 s, after a gap of one second."""
    healthy, weak = without(flying(4000, 5), (20.0, 100.0)), without(NEW, (0.0, 21.0))
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


def test_a_window_in_which_no_rows_came_for_long_is_not_healthy(flight: JudgedFlight) -> None:
    unseen = replace(flight, hidden=((10 * NS_PER_S, 15 * NS_PER_S),))
    differ = [one.to_s for one, two in zip(*(windows_of(f, 5.0) for f in (unseen, flight)), strict=True) if one != two]
    assert differ == [15.0]
    assert windows_of(unseen, 5.0)[2].verdict is Verdict.NOT_JUDGEABLE


shares = st.lists(st.floats(0.0, 3.0) | st.just(math.nan), min_size=1, max_size=40)
C = np.array([[-0.25, -0.25, 0.25, 0.25], [0.25, -0.25, -0.25, 0.25], [0.25, -0.25, 0.25, -0.25]])
HOUR_NS = DAY_NS // 24
AT = {"name": "", "judged_s": 60.0, "trim": (0.0, 0.0, 0.1)}
DAYS = [{"sha256": "abcd"[i] * 64, "started_ns": START_NS + i // 2 * DAY_NS, "session": i // 2} for i in range(4)]
TAUGHT = tuple(SourceLog.model_validate(AT | day) for day in DAYS)
REFERENCE = Reference("sha256:b", tuple(map(tuple, C.tolist())), TAUGHT)


def one_each(share: FloatArray) -> Sessions:
    return sessions_of(range(len(share)), share)


def forecast(trend: Trend, flights: float) -> tuple[float, float]:
    """Level so many flights from now, and its standard error."""
    variance = trend.level_variance + 2 * flights * trend.covariance + flights**2 * trend.slope_variance
    return trend.level + trend.slope * flights, math.sqrt(max(variance, 0.0))


def test_the_line_is_that_of_a_weighted_polynomial_fit() -> None:
    """`numpy.polyfit`, where no session is odd, so that Huber's weights are all 1."""
    x = np.arange(1.0, 61.0)
    y = 0.3 + 0.004 * x + 0.02 * np.sign(np.sin(x))
    found = trend_of(one_each(y), 60.0)
    slope, level = np.polyfit(x - 60.0, y, 1, w=np.sqrt(np.exp((x - 60.0) / MEMORY)))
    assert found is not None
    assert (found.level, found.slope) == pytest.approx((level, slope), rel=1e-9)


def test_the_stated_error_is_the_scatter_of_repetitions() -> None:
    """Sessions of one flight with normal errors, 300 times."""
    rng, x = np.random.default_rng(2), np.arange(1.0, 101.0)
    found = [trend_of(one_each(0.4 + 0.002 * x + 0.03 * rng.standard_normal(100)), 100.0) for _ in range(300)]
    trends = [one for one in found if one is not None]
    levels, slopes = np.array([one.level for one in trends]), np.array([one.slope for one in trends])
    assert np.median([math.sqrt(one.level_variance) for one in trends]) == pytest.approx(levels.std(), rel=0.3)
    assert np.median([math.sqrt(one.slope_variance) for one in trends]) == pytest.approx(slopes.std(), rel=0.3)
    ahead = [forecast(one, 20.0) for one in trends]
    within = [abs(value - (0.4 + 0.002 * 120)) < 1.645 * error for value, error in ahead]
    assert np.mean(within) > 0.8  # 0.9 for many sessions; the memory leaves some twenty
    assert levels.mean() == pytest.approx(0.6, abs=0.005)


@given(st.floats(0.3, 1.1), st.floats(1e-4, 0.05), st.floats(1e-6, 1e-3), st.floats(0.001, 0.9), st.floats(-0.9, 0.9))
def test_the_interval_of_the_remaining_flights_holds_what_cannot_be_told_from_the_threshold(
    level: float, slope: float, level_variance: float, relative: float, correlation: float
) -> None:
    """Fieller's inequality, asked directly over a grid of flights."""
    slope_variance = (relative * slope) ** 2
    covariance = correlation * math.sqrt(level_variance * slope_variance)
    trend = Trend(level, slope, level_variance, covariance, slope_variance, 0.05)
    found = trend.remaining()
    assert found is not None
    assert found.low <= found.flights <= found.high
    for ahead in np.linspace(0.0, 2 * (1.0 + found.flights), 50).tolist():
        value, error = forecast(trend, ahead)
        inside = abs(1.0 - value) <= 1.645 * error
        near = min(abs(ahead - found.low), abs(ahead - found.high)) < 1e-6 * (1 + ahead)
        if level < 1.0 and not near:
            assert inside == (found.low <= ahead <= found.high)


@given(shares)
def test_no_series_is_too_odd_for_a_trend_and_its_changes(share: list[float]) -> None:
    sessions = one_each(np.array(share))
    trend = trend_of(sessions, float(len(share)))
    assert (trend is None) == (len(sessions) < 5)
    if trend is not None:
        assert math.isfinite(trend.level)
        assert trend.slope_variance > 0
    assert all(1 < one.number <= len(share) for one in changes_of(sessions))


def worn(flights: int, power: float, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(0.4 + 0.6 * (np.arange(1, flights + 1) / flights) ** power + 0.03 * rng.standard_normal(flights))


@pytest.mark.parametrize("power", [0.8, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_wear_is_warned_of_5_to_40_flights_before_its_threshold(power: float, seed: int) -> None:
    found = warned_at(series(worn(150, power, seed)))
    assert found is not None
    assert 5 <= 150 - found <= 40


def test_a_warning_stands_while_the_level_does_and_ends_when_it_falls_back() -> None:
    slow = np.concatenate((worn(150, 1.0, 1)[:140], np.full(10, 0.93)))
    found = review(series(slow))
    assert found.outlook is Outlook.WARNING
    assert (found.warned_at or 140) < 140
    assert review(series(np.concatenate((slow, np.full(60, 0.4))))).outlook is Outlook.STEADY
    assert review(series(np.concatenate((slow, np.full(40, 1.1))))).outlook is Outlook.REACHED


def test_marks_and_other_baselines_begin_a_stretch() -> None:
    flights = (*records([0.5] * 10), *(record(number, baseline="sha256:new") for number in range(11, 16)))
    told = ((4, MarkKind.NEW_PROPELLERS, ""), (90, MarkKind.REPAIR, "arm 2"))
    marks = [Mark("one", START_NS + day * DAY_NS + 1, kind, note) for day, kind, note in told]
    found = [(one.first, one.began, len(one.flights)) for one in stretches_of(flights, marks)]
    assert found == [(1, "", 4), (5, "new propellers", 6), (11, "new baseline", 5), (16, "repair: arm 2", 0)]
    assert stretches_of((), marks) == ()


def test_a_series_has_the_monitors_of_propellers_the_sessions_and_the_highest_threshold() -> None:
    times = [START_NS, START_NS + DAY_NS // 48, START_NS + DAY_NS, 0, 0]
    (stretch,) = stretches_of([record(n, 0.5 if n != 2 else None, t_ns=t) for n, t in enumerate(times)], ())
    found = series_of(stretch)
    assert [one.name for one in found] == ["fsd roll", "fsd pitch", "unbalance"]
    assert found[2].session.tolist() == [0, 0, 1, 2, 3]
    assert np.isnan(found[2].share[2])
    assert (found[0].share[0], found[2].share[0]) == (0.5, 0.5)


@given(st.lists(st.floats(0.0, 5.0) | st.none(), min_size=1, max_size=60), st.booleans())
def test_every_history_has_words_and_json(peaks: list[float | None], marked: bool) -> None:
    marks = (Mark("one", START_NS + 5 * DAY_NS + 1, MarkKind.NEW_PROPELLERS),) if marked else ()
    found = overview_of("one", records(peaks), marks)
    assert sum("of the threshold" in line.text for line in lines_of(found)) == sum(
        one.trend is not None for one in found.found
    )
    json.dumps(overview_json(found), allow_nan=False)


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """The URL of an empty database of a server of its own. It refuses to run as root."""
    pytest.importorskip("psycopg", reason="the driver is in the extra `history`")
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: float(path.parts[-2]))
    if not programs:
        pytest.skip("PostgreSQL is not installed: apt install postgresql")
    user = pwd.getpwnam("nobody").pw_uid if os.getuid() == 0 else os.getuid()
    home = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))  # a socket's path must be short
    os.chown(home, user, -1)

    def run(program: str, *options: str) -> None:
        told: list[str | Path] = [programs[-1] / program, "-D", home / "data", *options]
        subprocess.run(told, user=user, cwd=home, check=True, stdout=subprocess.DEVNULL, timeout=120)

    run("initdb", *("-U", "owner", "-A", "trust", "-N", "-E", "UTF8", "--locale=C"))
    run("pg_ctl", "start", "-w", "-s", "-l", str(home / "log"), "-o", f"-k {home} -c listen_addresses= -c fsync=off")
    try:
        yield f"postgresql://owner@/postgres?host={home}"
    finally:
        run("pg_ctl", "stop", "-w", "-s", "-m", "fast")  # whoever is connected is let go
        shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    if request.param == "sqlite":
        yield str(tmp_path / "history.sqlite")
        return
    url: str = request.getfixturevalue("server")
    yield url
    engine = create_engine(address_of(url))
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE; CREATE SCHEMA public"))
    engine.dispose()


def test_what_is_kept_comes_back_in_order_of_time(database: str) -> None:
    kept = records([0.5, None, 0.7])
    unknown = replace(record(9), started_ns=0, rotor_trim=(), slots=(), verdict=Verdict.NOT_JUDGEABLE)
    with open_history(database, create=True) as history:
        with pytest.raises(UsageError, match="no flight is in the history yet; add one with"):
            history.names()
        assert [history.add(one) for one in (kept[2], kept[0], unknown, kept[1])] == [True] * 4
    with open_history(database) as history:
        assert history.names() == ("one",)
        assert history.flights("one") == (unknown, *kept)  # added on the first of January
        assert history.flights("another") == ()


def test_a_flight_is_kept_once_and_replaced_when_asked(database: str) -> None:
    with open_history(database, create=True) as history:
        assert history.add(record(1))
        assert not history.add(replace(record(1), airframe="another", reason="changed"))
        assert history.kept_as(record(1).content) == ("one", record(1).baseline)
        later = replace(record(1, 0.9), reason="changed", started_ns=0, added_ns=START_NS + 9 * DAY_NS)
        assert history.add(later, again=True)
        assert [(one.reason, one.started_ns) for one in history.flights("one")] == [("changed", record(1).started_ns)]
        assert history.flights("one")[0].added_ns == record(1).added_ns  # it keeps its place
        assert history.flights("one")[0].slots[2].peak == 0.9
        assert history.kept_as("unknown") is None


def test_several_that_add_at_once_keep_each_flight_and_each_reference_once(database: str) -> None:
    """Eight at a time open it, which makes the tables, and add the same flights and references."""
    references = [Reference(f"sha256:{n}", ((0.25, -0.25),) * 3, (TAUGHT[0],)) for n in range(10, 60)]

    def add(_: int) -> int:
        with open_history(database, create=True) as history:
            list(map(history.refer, references))
            return sum(history.add(one) for one in records([0.5] * 10))

    with ThreadPoolExecutor(8) as pool:
        added = sum(pool.map(add, range(8)))
    with open_history(database) as history:
        assert added == len(history.flights("one")) == 10
        assert sorted(history.references(), key=str) == references


def test_a_database_of_another_schema_is_refused(database: str) -> None:
    with open_history(database, create=True) as history:
        history.add(record(1))
    engine = create_engine(address_of(database))
    with engine.begin() as connection:
        connection.execute(update(VERSION).values(version_num="0001"))
    engine.dispose()
    with pytest.raises(UsageError, match=r"of schema 0001.*add the logs to a new history"), open_history(database):
        pass


def test_a_reader_needs_no_rights_to_write(tmp_path: Path) -> None:
    """As little as while another one writes: a lock to write would have to wait for it."""
    path = tmp_path / "h.sqlite"
    with open_history(str(path), create=True) as history:
        history.add(record(1))
    before, held = path.stat().st_mtime_ns, sqlite3.connect(path, isolation_level=None)
    held.execute("BEGIN IMMEDIATE")  # another one writes at the moment
    with open_history(str(path)) as history:
        assert len(history.flights("one")) == 1
    held.close()
    assert path.stat().st_mtime_ns == before


def test_a_damaged_history_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    with open_history(str(path), create=True) as history:
        history.add(record(1))
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute("UPDATE mavdiag_flight SET slots = '{'")
    with pytest.raises(UsageError, match="cannot be used") as caught, open_history(str(path)) as history:
        history.flights("one")
    assert "\n" not in str(caught.value)


def flown(starts_ns: Sequence[int], rise: float = 0.0) -> list[FlightRecord]:
    """Flights that began then, with a rise of rotor 3."""
    trim = tuple((np.array([0.0, 0.0, 0.1]) + rise * C[:, 2]).tolist())
    return [replace(record(i, t_ns=t_ns), trim=trim) for i, t_ns in enumerate(starts_ns)]


@pytest.fixture
def readings(monkeypatch: pytest.MonkeyPatch) -> list[Flown]:
    found: list[Flown] = []

    def ask(flights: Flown, *rest: object) -> Evidence:
        found.append(flights)
        return evidence_of(flights, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(of_flights, "evidence_of", ask)
    return found


def test_flights_within_an_hour_share_a_session_and_those_without_a_clock_may(readings: list[Flown]) -> None:
    day = START_NS + 9 * DAY_NS
    together(REFERENCE, flown([START_NS + HOUR_NS // 2, day, day + HOUR_NS // 2, 0, day + DAY_NS, day + 2 * DAY_NS]))
    assert [one.sessions.tolist()[4:] for one in readings] == [[0, 3, 3, 3, 3, 4], [0, 3, 3, 4, 5, 6]]
    readings.clear()
    together(REFERENCE, flown([START_NS, START_NS + 1]), new_propellers=True)
    assert [one.sessions.tolist()[4:] for one in readings] == [[2, 2]]
    assert readings[0].propellers.tolist() == [0, 0, 0, 0, 1, 1]


def test_without_clocks_the_lower_odds_of_both_readings_are_told(readings: list[Flown]) -> None:
    said = together(REFERENCE, flown([0, 0, 0], rise=0.1))
    odds = [evidence_of(one, C, of_flights.priors_of(C)).odds for one in readings]
    assert said.evidence is not None
    assert (len(odds), said.evidence.odds) == (2, min(odds))


def test_flights_that_taught_and_those_without_a_trim_do_not_count(readings: list[Flown]) -> None:
    one, other, third = flown([START_NS + i * DAY_NS for i in (5, 6, 7)])
    said = together(REFERENCE, [replace(one, content="a" * 64 + ":1"), replace(other, trim=()), third])
    assert said.flights == 1
    assert said.since is third
    assert len(readings[0].trims) == 5
    assert together(REFERENCE, [replace(third, trim=())]).evidence is None
    assert "nothing can be said" in str(together(replace(REFERENCE, flights=()), [third]))


def test_a_change_is_told_with_its_rotor_odds_and_first_flight() -> None:
    days = [START_NS + i * DAY_NS for i in range(5, 13)]
    healthy, damaged = flown(days[:4]), flown(days[4:], rise=0.1)
    said = together(REFERENCE, [*healthy, *damaged])
    assert said.changed
    assert (said.rotors, said.since) == ((3,), damaged[0])
    assert "8 flights together: rotor 3 has changed, " in str(said)
    assert str(said).endswith(" to 1, since flight 0.tlog")
    assert not together(REFERENCE, healthy).changed
    assert "no rotor's trim is known to have changed" in str(together(REFERENCE, healthy))


def test_new_propellers_begin_anew_and_may_differ() -> None:
    flights = [*flown([START_NS + i * DAY_NS for i in range(5, 13)], rise=0.1)]
    found = overview_of("one", flights, (), (REFERENCE,))
    assert found.together is not None
    assert found.together.changed
    assert overview_json(found)["together"]["rotors"] == [3]
    assert any(line.loud and "rotor 3 has changed" in line.text for line in lines_of(found))
    mark = Mark("one", flights[3].started_ns + 1, MarkKind.NEW_PROPELLERS)
    fresh = overview_of("one", flown([one.started_ns for one in flights], rise=0.02), (mark,), (REFERENCE,))
    assert fresh.together is not None
    assert fresh.together.flights == 4
    assert not fresh.together.changed
    assert overview_of("one", flights, (), ()).together is None


def test_a_reader_that_goes_gets_no_verdict() -> None:
    read, write = os.pipe()
    os.close(read)
    assert subprocess.run([sys.executable, "-m", "mavdiag", "--help"], stdout=write, check=False).returncode == 2
