"""A PostgreSQL of the test's own: made in a new folder, heard on a socket in it alone, stopped by its id."""

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

__all__ = ["postgres"]

USERS = ("postgres", "nobody")  # it refuses to run as root
START_S = 30.0


def programs() -> Path | None:
    """The folder of initdb and postgres: of Debian's package, or on the path."""
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: float(path.parts[-3]))
    found = debian[-1] if debian else shutil.which("initdb")
    return None if found is None else Path(found).resolve().parent


def unprivileged() -> int | None:
    """The user to run it as; None for who we are."""
    if os.getuid() != 0:
        return None
    known = [one.pw_uid for one in pwd.getpwall() if one.pw_name in USERS and one.pw_uid != 0]
    if not known:
        pytest.skip(f"PostgreSQL does not run as root, and there is no user {' or '.join(USERS)}")
    return known[0]


@contextmanager
def postgres() -> Iterator[str]:
    """Start it and yield the URL of an empty database. Skips the test, with the reason, where it cannot be had."""
    pytest.importorskip("psycopg", reason="the driver is in the extra `history`")
    folder = programs()
    if folder is None:
        pytest.skip("PostgreSQL is not installed: apt install postgresql")
    user = unprivileged()
    home = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))  # a socket's path must be short
    if user is not None:
        os.chown(home, user, -1)
    try:
        data = home / "data"
        made: list[str | Path] = [
            folder / "initdb",
            "-D",
            data,
            "-U",
            "owner",
            "-A",
            "trust",
            "-N",
            "-E",
            "UTF8",
            "--locale=C",
        ]
        subprocess.run(made, user=user, cwd=home, check=True, capture_output=True, timeout=120)
        options = ["-c", "listen_addresses=", "-c", "fsync=off", "-k", str(home)]
        with (home / "log").open("w") as log:
            server = subprocess.Popen(
                [folder / "postgres", "-D", data, *options], user=user, cwd=home, stdout=log, stderr=log
            )
        try:
            wait_for(server, home)
            yield f"postgresql://owner@/postgres?host={home}"
        finally:
            server.send_signal(signal.SIGINT)  # "fast": whoever is connected is let go
            server.wait(START_S)
    finally:
        shutil.rmtree(home, ignore_errors=True)


def wait_for(server: subprocess.Popen[bytes], home: Path) -> None:
    """Until it takes connections."""
    import psycopg

    end_s = time.monotonic() + START_S
    while True:
        try:
            psycopg.connect(host=str(home), user="owner", dbname="postgres").close()
            return
        except psycopg.OperationalError as error:
            if server.poll() is not None or time.monotonic() > end_s:
                raise AssertionError(f"{error}: {(home / 'log').read_text()}") from error
            time.sleep(0.05)
