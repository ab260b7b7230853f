"""Whether the tests notice small changes of monitors and decision: a mutation run by cosmic-ray.

    nox -s mutants -- [--count 60] [--seed 1] [--room NAME]... [--longest 300]

From all mutations that cosmic-ray knows of the files of a room (an operator exchanged, a number changed by one, a
condition negated, ...) so many are drawn by chance. Each is applied to a copy of the project and the tests of the room
run; a mutant that no test notices survives.
"""

import argparse
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
LEFT_OUT = shutil.ignore_patterns(
    ".git", ".venv", ".nox", ".*cache*", "__pycache__", "out", "build", "dist", "*.egg-info"
)

ROOMS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {  # files, and the tests that should notice
    "decision": (
        ("mavdiag/decision",),
        ("decision", "kernel", "journal", "judging_logs", "face", "report_page", "session"),
    ),
    "monitors": (
        ("mavdiag/monitors",),
        (
            "unbalance",
            "trim_step",
            "rotor_trim",
            "rotor_speed",
            "rotor_signature",
            "run_length",
            "sensor_monitors",
            "kernel",
        ),
    ),
}
UNCOMPILED = ("monitors",)  # else each mutant is compiled anew, which takes a minute of processor time


def survivors(room: str, count: int, seed: int, longest_s: float, folder: Path) -> tuple[int, list[str]]:
    """How many mutants were tried, and those that no test noticed.

    longest_s: that the tests may take, without a mutant, too [s].
    """
    sources, names = ROOMS[room]
    tests = " ".join(f"tests/unit/test_{name}.py" for name in names)
    command = f"{sys.executable} -m pytest -x -q -n 0 -p no:cacheprovider -W ignore::RuntimeWarning {tests}"
    modules = ", ".join(f'"{source}"' for source in sources)
    (folder / "mutants.toml").write_text(
        f"[cosmic-ray]\nmodule-path = [{modules}]\ntimeout = {longest_s}\nexcluded-modules = []\n"
        f'test-command = "{command}"\n[cosmic-ray.distributor]\nname = "local"\n'
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "compiled")}
    if room in UNCOMPILED:
        environment["NUMBA_DISABLE_JIT"] = "1"
    session = folder / "mutants.sqlite"
    session.unlink(missing_ok=True)

    def cosmic_ray(*arguments: str) -> str:
        words = [str(Path(sys.executable).with_name("cosmic-ray")), *arguments]
        return subprocess.run(words, cwd=folder, env=environment, check=True, capture_output=True, text=True).stdout

    cosmic_ray("baseline", "mutants.toml")
    cosmic_ray("init", "mutants.toml", session.name)
    with sqlite3.connect(session) as store:
        mutations = "select job_id from mutation_specs order by module_path, operator_name, start_pos_row, occurrence"
        jobs = [row[0] for row in store.execute(mutations)]
        dropped = [(job,) for job in set(jobs) - set(random.Random(seed).sample(jobs, min(count, len(jobs))))]
        store.executemany("delete from mutation_specs where job_id = ?", dropped)
        store.executemany("delete from work_items where job_id = ?", dropped)
    cosmic_ray("exec", "mutants.toml", session.name)
    with sqlite3.connect(session) as store:
        found = store.execute(
            "select module_path, start_pos_row, operator_name, test_outcome, diff "
            "from mutation_specs join work_results using (job_id) order by module_path, start_pos_row"
        ).fetchall()
    lived = [one for one in found if "SURVIVED" in one[3].upper()]
    return len(found), [
        f"{path}:{row} {operator.split('/')[-1]}: {changed(diff)}" for path, row, operator, _, diff in lived
    ]


def changed(diff: str) -> str:
    """The line that a mutant has in place of another one."""
    lines = [line[1:].strip() for line in diff.splitlines() if line.startswith("+") and not line.startswith("+++")]
    return " ".join(lines)


def main() -> None:
    """Print how many mutants were noticed, and each that was not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", choices=tuple(ROOMS), action="append")
    parser.add_argument("--longest", type=float, default=300.0, help="that the tests may take [s]")
    arguments = parser.parse_args()
    for room in arguments.room or ROOMS:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "copy"
            shutil.copytree(ROOT, folder, ignore=LEFT_OUT)
            tried, lived = survivors(room, arguments.count, arguments.seed, arguments.longest, folder)
        print(f"{room}: {tried - len(lived)} of {tried} mutants noticed (seed {arguments.seed}); not noticed:")
        for mutant in lived:
            print(f"    {mutant}")


if __name__ == "__main__":
    main()
