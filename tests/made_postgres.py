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
