"""The database of a history: SQLite and a real PostgreSQL, of the test's own, give the same answers."""

import os
import pwd
import shutil
import signal
import sqlite3
import subprocess
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from made_history import record, records
from sqlalchemy import create_engine, text, update

from mavdiag.archive.together import Reference, Taught
from mavdiag.errors import MavdiagError, UsageError
from mavdiag.history.store import VERSION, address_of, open_history
from mavdiag.judging import Verdict

START_S = 30.0


@contextmanager
def postgres() -> Iterator[str]:
    """Start it and yield the URL of an empty database. Skips the test, with the reason, where it cannot be had."""
    psycopg = pytest.importorskip("psycopg", reason="the driver is in the extra `history`")
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: float(path.parts[-2]))
    if not programs:
        pytest.skip("PostgreSQL is not installed: apt install postgresql")
    user = None
    if os.getuid() == 0:  # it refuses to run as root
        user = pwd.getpwnam("nobody").pw_uid
    home = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))  # a socket's path must be short
    if user is not None:
        os.chown(home, user, -1)
    try:
        made = [
            str(programs[-1] / "initdb"),
            "-D",
            str(home / "data"),
            *["-U", "owner", "-A", "trust", "-N", "-E", "UTF8"],
        ]
        subprocess.run([*made, "--locale=C"], user=user, cwd=home, check=True, capture_output=True, timeout=120)
        run: list[str | Path] = [programs[-1] / "postgres", "-D", home / "data", "-k", home]
        run += ["-c", "listen_addresses=", "-c", "fsync=off"]
        quiet = subprocess.DEVNULL
        server = subprocess.Popen(run, user=user, cwd=home, stdout=quiet, stderr=quiet)
        try:
            end_s = time.monotonic() + START_S
            while True:
                try:
                    psycopg.connect(host=str(home), user="owner", dbname="postgres").close()
                    break
                except psycopg.OperationalError:
                    assert server.poll() is None
                    assert time.monotonic() < end_s
                    time.sleep(0.05)
            yield f"postgresql://owner@/postgres?host={home}"
        finally:
            server.send_signal(signal.SIGINT)  # "fast": whoever is connected is let go
            server.wait(START_S)
    finally:
        shutil.rmtree(home, ignore_errors=True)


pytest.importorskip("sqlalchemy", reason="the history is an extra")


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with postgres() as url:
        yield url


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
        assert history.names() == ()
        assert [history.add(one) for one in (kept[2], kept[0], unknown, kept[1])] == [True] * 4
    with open_history(database) as history:
        assert history.names() == ("one",)
        assert history.flights("one") == (unknown, *kept)  # added on the first of January
        assert history.flights("another") == ()


def test_what_a_baseline_s_flights_are_compared_with_is_kept_once(database: str) -> None:
    taught = (Taught("a" * 64, 0, 0, 0, 60.0, (0.0, 0.01, 0.02)),)
    reference = Reference("sha256:1", ((0.25, -0.25),) * 3, taught)
    with open_history(database, create=True) as history:
        history.refer(reference)
        history.refer(reference)
        history.refer(replace(reference, baseline="sha256:2"))
    with open_history(database) as history:
        assert history.references() == (reference, replace(reference, baseline="sha256:2"))


def test_a_flight_is_kept_once_and_replaced_when_asked(database: str) -> None:
    with open_history(database, create=True) as history:
        assert history.add(record(1))
        assert not history.add(replace(record(1), airframe="another", reason="changed"))
        assert history.airframe_of(record(1).content) == "one"
        assert history.add(replace(record(1, 0.9), reason="changed"), again=True)
        assert [one.reason for one in history.flights("one")] == ["changed"]
        assert history.flights("one")[0].slots[2].peak == 0.9
        assert history.airframe_of("unknown") is None


def test_several_that_add_at_once_keep_each_flight_once(database: str) -> None:
    """Eight at a time open it, which makes the tables, and add the same ten flights."""

    def add(_: int) -> int:
        with open_history(database, create=True) as history:
            return sum(history.add(one) for one in records([0.5] * 10))

    with ThreadPoolExecutor(8) as pool:
        added = sum(pool.map(add, range(8)))
    with open_history(database) as history:
        assert added == len(history.flights("one")) == 10


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
    before = path.stat().st_mtime_ns
    held = sqlite3.connect(path, isolation_level=None)
    held.execute("BEGIN IMMEDIATE")  # another one writes at the moment
    with open_history(str(path)) as history:
        assert len(history.flights("one")) == 1
    held.close()
    assert path.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    "database", ["postgresql://me:secret@127.0.0.1:1/fleet", "postgresql://me:secret@127.0.0.1:port/fleet"]
)
def test_a_password_is_never_shown(database: str) -> None:
    with pytest.raises(MavdiagError) as caught, open_history(database):
        pass
    assert "secret" not in str(caught.value)
