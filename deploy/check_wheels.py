"""Whether the detector installs on Debian without a compiler: a wheel for every dependency, by the rules of pip.

    python deploy/check_wheels.py [--platform arm64] [--python 3.13]

Nothing is installed: pip resolves the dependencies of pyproject.toml as the target would and says which files it would
take. Exit code 0 if there is one for each, 1 if not, 3 if the index cannot be reached.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}  # Debian's names
# glibc of each Debian's Python: wheels for it or an older one run there (PEP 600).
PYTHONS = {"3.11": 36, "3.13": 41}  # Debian 12 and 13
OLDEST_GLIBC = 17
OFFLINE = ("NewConnectionError", "Connection error", "ConnectTimeoutError", "Could not fetch URL", "name resolution")


@dataclass(frozen=True)
class Found:
    """The files that pip would take, or why it cannot. offline: the index was not reached."""

    wheels: tuple[str, ...] = ()
    problem: str = ""
    offline: bool = False


def dependencies() -> list[str]:
    """What the Debian package holds: what runs, with the live page, in the versions of constraints.txt."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*project["dependencies"], *project["optional-dependencies"]["web"], "-c", str(ROOT / "constraints.txt")]


def resolve(machine: str, python: str) -> Found:
    """What pip would install on a Debian machine."""
    arch, glibc = MACHINES[machine], PYTHONS[python]
    tags = [f"manylinux2014_{arch}", *(f"manylinux_2_{minor}_{arch}" for minor in range(OLDEST_GLIBC, glibc + 1))]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--dry-run",
            "--ignore-installed",
            "--quiet",
            "--retries",
            "1",
        ]
        command += ["--only-binary=:all:", "--python-version", python, "--target", folder, "--report", str(report)]
        command += [part for tag in tags for part in ("--platform", tag)]
        run = subprocess.run([*command, *dependencies()], capture_output=True, text=True, check=False)
        if run.returncode:
            errors = [line for line in run.stderr.splitlines() if line.startswith("ERROR")]
            offline = any(words in run.stderr for words in OFFLINE)
            return Found(problem=" ".join(errors) or run.stderr.strip(), offline=offline)
        taken = json.loads(report.read_text(encoding="utf-8"))["install"]
    return Found(tuple(sorted(one["download_info"]["url"].rpartition("/")[2] for one in taken)))


def main() -> int:
    """Print one line for each target, and what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", choices=MACHINES, action="append")
    parser.add_argument("--python", choices=PYTHONS, action="append")
    options = parser.parse_args()
    code = 0
    for machine in options.platform or MACHINES:
        for python in options.python or PYTHONS:
            found = resolve(machine, python)
            compiled = [wheel for wheel in found.wheels if not wheel.endswith("-any.whl")]
            words = found.problem or f"{len(found.wheels)} wheels, {len(compiled)} of them compiled, no source package"
            print(f"Python {python} on {machine}: {words}")
            code = max(code, 3 if found.offline else 1 if found.problem else 0)
    return code


if __name__ == "__main__":
    sys.exit(main())
