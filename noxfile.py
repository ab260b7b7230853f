"""`nox` runs what CI runs, in the environment that the Makefile sets up."""

import os
import sys
from pathlib import Path

import nox

nox.options.sessions = ["check"]
nox.options.default_venv_backend = "none"


@nox.session
def check(session: nox.Session) -> None:
    session.run("bash", ".ci/run", external=True)


@nox.session(venv_backend="venv")
def clients(session: nox.Session) -> None:
    """The test with mavsdk 3, which excludes mavsdk 4 and therefore gets an environment of its own."""
    session.install("mavsdk<4")
    python = Path(session.bin) / "python"
    session.run(
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "tests/integration/test_clients_mavsdk3.py",
        external=True,
        env={"MAVDIAG_MAVSDK3": str(python), "PATH": os.environ["PATH"]},
    )


@nox.session
def bench(session: nox.Session) -> None:
    session.run("make", "bench", external=True)


@nox.session
def wheels(session: nox.Session) -> None:
    """Whether Debian needs a compiler; asks the package index."""
    session.run("python", "deploy/check_wheels.py")
