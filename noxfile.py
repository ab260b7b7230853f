"""`nox` runs what CI runs, in the environment that the Makefile sets up."""

import itertools
import shutil
from pathlib import Path
from zipfile import ZipFile

import nox

nox.options.sessions = ["check"]
nox.options.default_venv_backend = "none"

CORE = ("tests/unit", "tests/replay")  # what the lowest versions are tried on


@nox.session
def check(session: nox.Session) -> None:
    session.run("bash", ".ci/run", external=True)


@nox.session
def bench(session: nox.Session) -> None:
    session.run("make", "bench", external=True)


@nox.session
def wheels(session: nox.Session) -> None:
    """Whether Debian needs a compiler; asks the package index."""
    session.run("python", "deploy/check_wheels.py")


@nox.session(venv_backend="uv")
def packages(session: nox.Session) -> None:
    """Wheel and sdist in dist/, checked by twine; the wheel is used in a clean environment, with what is compiled."""
    for old in Path("dist").glob("mavdiag-*"):
        old.unlink()
    session.run("uv", "build", "--quiet", "--out-dir", "dist", external=True)  # the wheel is built from the sdist
    session.run("uvx", "twine", "check", "--strict", *map(str, Path("dist").glob("mavdiag-*")), external=True)
    (wheel,) = Path("dist").absolute().glob("mavdiag-*.whl")
    session.install("--only-binary=:all:", "-c", "constraints.txt", f"{wheel}[web]")
    sources = session.run("git", "ls-files", "mavdiag", "detector", "sitl_plant", external=True, silent=True) or ""
    if missing := set(sources.split()) - set(ZipFile(wheel).namelist()):
        session.error(f"not in the wheel: {', '.join(sorted(missing))}")
    (site,) = Path(session.virtualenv.location).absolute().glob("lib/python3*/site-packages")
    for code in itertools.chain.from_iterable(Path().glob(f"{one}/**/*.nb[ci]") for one in ("mavdiag", "sitl_plant")):
        (site / code).parent.mkdir(exist_ok=True)
        shutil.copyfile(code, site / code)
    with session.chdir(session.create_tmp()):
        for program in ("mavdiag", "mavdiag-detector", "sitl-plant"):
            session.run(program, "--help", silent=True)
        session.run("mavdiag-detector", "--web", "0", "--learn", "9", "--save", "b.json", "--check")
        session.run("sitl-plant", "record", "--duration", "1", "-o", "1.tlog")


@nox.session
def older(session: nox.Session) -> None:
    """The suite without what this processor has above AVX2: numpy, its BLAS and numba compute as on an older one."""
    import numpy as np  # of the environment that the Makefile sets up

    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    newer = [name for name in found if name.startswith(("AVX512", "X86_V4"))]
    if not newer:
        session.skip("this processor has nothing above AVX2: the suite as it is tests that")
    kinds = {"OPENBLAS_CORETYPE": "Haswell", "NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": ""}
    session.run("make", "test", external=True, env={"NPY_DISABLE_CPU_FEATURES": " ".join(newer), **kinds})


@nox.session
def bounds(session: nox.Session) -> None:
    """The core part with every index of compiled code checked; in a copy, for machine code lies beside its source."""
    folder = Path(session.create_tmp()).absolute()
    shutil.rmtree(folder / "copy", ignore_errors=True)
    session.run("git", "clone", "-q", ".", str(folder / "copy"), external=True)
    with session.chdir(folder / "copy"):
        kept = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(folder / "compiled")}
        session.run("python", "-m", "pytest", "-m", "not realtime", *CORE, env=kept)


@nox.session(venv_backend="uv")
def lowest(session: nox.Session) -> None:
    """The lowest versions that pyproject.toml allows, in an environment of their own: a core part of the suite."""
    session.install("--resolution", "lowest-direct", "-e", ".[fleet,web,history,mqtt,export]", "--group", "test")
    # what the newest indirect requirements say of the oldest direct ones is no fault of ours
    session.run("python", "-m", "pytest", "-W", "ignore::DeprecationWarning", "-m", "not realtime", *CORE)


@nox.session
def results(session: nox.Session) -> None:
    """Sections of docs/results.md: `nox -s results -- SECTION --shared FOLDER`."""
    session.run("python", "benchmarks/results.py", *session.posargs)


@nox.session(venv_backend="uv")
def constraints(session: nox.Session) -> None:
    """constraints.txt, the versions that an installation of the development environment takes, made again."""
    groups = [part for group in ("test", "check", "site") for part in ("--group", group)]
    how = (*groups, "--all-extras", "--universal", "--no-annotate", "--no-header")
    session.run("uv", "pip", "compile", "pyproject.toml", *how, "--quiet", "-o", "constraints.txt", *session.posargs)


@nox.session(venv_backend="uv")
def mutants(session: nox.Session) -> None:
    """A mutation run over monitors and decision, in an environment of its own."""
    session.install("cosmic-ray", "-e", ".[history]", "--group", "test", "-c", "constraints.txt")
    session.run("python", "benchmarks/mutants.py", *session.posargs)


@nox.session(venv_backend="uv")
def rotorpy(session: nox.Session) -> None:
    """Flights of another simulator, in an environment of its own."""
    session.install("rotorpy==3.0.0", "-e", ".", "-c", "constraints.txt")
    session.run("python", "benchmarks/rotorpy_flights.py", *session.posargs)
