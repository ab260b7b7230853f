"""`nox` runs what CI runs, in the environment that the Makefile sets up."""

import nox

nox.options.sessions = ["check"]
nox.options.default_venv_backend = "none"


@nox.session
def check(session: nox.Session) -> None:
    session.run("bash", ".ci/run", external=True)


@nox.session
def bench(session: nox.Session) -> None:
    session.run("make", "bench", external=True)


@nox.session
def wheels(session: nox.Session) -> None:
    """Whether Debian needs a compiler; asks the package index."""
    session.run("python", "packaging/check_wheels.py")
