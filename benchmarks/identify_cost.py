"""What `mavdiag identify` takes: processor time and most memory, and how much of it is the reading of the files.

    python benchmarks/identify_cost.py FOLDER [--flights 60] [--seconds 40] [--seed 100] [--long 1800] [--before TREE]

The flights are made once into FOLDER by `sitl-plant record` (1 kHz, seeds counted up from `--seed`), and one long
flight besides. `mavdiag identify` runs as a process of its own; its processor time is user and system time, its memory
the most that was resident, which counts pages of the shelf's file while they are mapped. `--before` names a tree of the
code of another version, whose figures are measured in the same run, in turns. The baselines of both are compared: the
largest relative difference of any number in them.
"""

import argparse
import json
import math
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavdiag.logs import read_log

HERE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class Cost:
    """seconds: processor time. mib: most memory resident. baseline: what was learnt."""

    seconds: float
    mib: float
    baseline: Any


def recorded(folder: Path, name: str, flights: int, seconds: float, seed: int) -> list[Path]:
    """The flights, made if they are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{name}-{i:03d}.tlog" for i in range(flights)] if flights > 1 else [f"{name}.tlog"]
    if not all((folder / one).exists() for one in names):
        options = ["--flights", str(flights), "--duration", str(seconds), "--seed", str(seed), "--rate", "1000"]
        command = [sys.executable, "-m", "sitl_plant", "record", *options, "-o", str(folder / f"{name}.tlog")]
        subprocess.run(command, cwd=HERE, check=True, stdout=subprocess.DEVNULL)
    return [folder / one for one in names]


def identified(tree: Path, files: Sequence[Path], output: Path) -> Cost:
    """`mavdiag identify` of a tree over the files."""
    options = ["--airframe", "qdrone2", "--accept", "-o", str(output)]  # half an hour empties the battery
    command = [sys.executable, "-m", "mavdiag", "identify", *map(str, files), *options]
    with subprocess.Popen(
        command, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, stdout=subprocess.DEVNULL
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{tree}: identify ended with {process.returncode}")
    return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, json.loads(output.read_text()))


def differences(one: Any, other: Any) -> Iterator[float]:
    """Relative differences of the numbers of two baselines; infinite where they are not alike."""
    if isinstance(one, dict):
        for key in one.keys() | other.keys():
            if key not in ("digest", "created"):
                yield from differences(one.get(key), other.get(key))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for a, b in zip(one, other, strict=True):
            yield from differences(a, b)
    elif isinstance(one, float) and isinstance(other, int | float):
        yield abs(one - other) / max(abs(one), abs(other), 1e-300)
    else:
        yield 0.0 if one == other else math.inf


def reading(files: Sequence[Path]) -> float:
    """Processor time of the readers alone [s]."""
    before = time.process_time()
    for path in files:
        read_log(path)
    return time.process_time() - before


def shown(what: str, cost: Cost, before: Cost | None) -> str:
    """A line of the table."""
    line = f"{what:28s} {cost.seconds:7.1f} s {cost.mib:7.0f} MiB"
    if before is None:
        return line
    apart = max(differences(before.baseline, cost.baseline))
    ratios = f"{before.seconds / cost.seconds:.1f} x less time, {before.mib / cost.mib:.1f} x less memory"
    return f"{line}   before {before.seconds:7.1f} s {before.mib:7.0f} MiB: {ratios}, differs by {apart:.1g}"


def main() -> None:
    """Print what identify took, and what the readers took of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--long", type=float, default=1800.0, help="length of the one long flight [s], 0 for none")
    parser.add_argument("--before", type=Path, help="tree of another version")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {load:.1f}; Python {platform.python_version()}")
    print(f"seeds {options.seed} to {options.seed + options.flights - 1}")
    sets = [(f"{options.flights} flights of {options.seconds:g} s", options.flights, options.seconds, "healthy")]
    if options.long:
        sets.append((f"one flight of {options.long:g} s", 1, options.long, "long"))
    for what, count, seconds, name in sets:
        files = recorded(options.folder, f"{name}-{seconds:g}", count, seconds, options.seed)
        output = options.folder / "baseline.json"
        before = None if options.before is None else identified(options.before.resolve(), files, output)
        print(shown(what, identified(HERE, files, output), before), flush=True)
        print(f"{'  of it the readers':28s} {reading(files):7.1f} s", flush=True)
    print(f"this process itself: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
