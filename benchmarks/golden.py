"""What the product answers, kept in a file, and compared with what it answered before.

    python benchmarks/golden.py record FILE.json [--shared FOLDER] [--flights 60]
    python benchmarks/golden.py compare FILE.json [--shared FOLDER] [--flights 60]

Of each emulated flight (healthy and with each fault of the thesis, calm and in wind; seeds from 700 on) and of each
recorded one: verdict, kind, rotor, time of the first alarm, and of each monitor the highest value and the threshold. A
number differs where it is off by more than 1e-6 of itself. Record with the old code, compare with the new one. FOLDER
has the recordings.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from emulated import as_flight

import mavdiag as md
from mavdiag.airframe.load import airframe_named
from mavdiag.as_json import plain, verdict_json
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from sitl_plant.physics.faults import FAULTS
from sitl_plant.plant import PlantConfig

CREATED = "1970-01-01T00:00:00+00:00"
RELATIVE = 1e-6
RECORDED = {  # folder: what teaches, what is judged by it
    "arducopter_sitl": ("healthy_quad3kg_sq1.tlog", "*_quad3kg_*.tlog"),
    "autopilots_in_the_loop": ("px4_hil_healthy.tlog", "px4_*.tlog"),
    "crazypad": ("normal_flight/E8_log0*", "*/E8_log*"),
}


def emulated(count: int) -> Iterator[tuple[str, Log]]:
    """Flights of 24 s, the same ones for the same count."""
    causes = [None, *FAULTS]
    for number in range(count):
        cause, wind_m_s = causes[number % len(causes)], (0.0, 2.0)[number // len(causes) % 2]
        faulty = PlantConfig(seed=700 + number, wind_m_s=wind_m_s, fault=cause, rotor=1 + number % 4, onset_s=10.0)
        yield f"emulated {number} {cause or 'healthy'}", as_flight(faulty, 24.0)


def answers(shared: Path | None, count: int) -> dict[str, Any]:
    """What is said of every flight."""
    healthy = [as_flight(PlantConfig(seed=690 + seed), 30.0) for seed in range(4)]
    baseline = learn(healthy, LearnOptions(airframe=airframe_named("qdrone2")), created=CREATED)
    found = {name: answer(log, baseline) for name, log in emulated(count)}
    for folder, (teaching, judged) in (RECORDED if shared else {}).items():
        root = Path(shared or "") / folder
        teachers = [md.read_log(path) for path in sorted(root.glob(teaching))]
        baseline = learn(teachers, LearnOptions(), created=CREATED)
        for path in sorted(root.glob(judged)):
            found[f"{folder}/{path.name}"] = answer(md.read_log(path), baseline)
    return found


def answer(log: Log, baseline: Baseline) -> dict[str, Any]:
    """Of one flight."""
    told = verdict_json(md.judge(log, baseline))
    events = told["events"]
    monitors = {name: [one["max"], one["threshold"]] for name, one in told["monitors"].items()}
    first = {"first_s": events[0]["t_s"] if events else None, "events": len(events)}
    return dict(plain({key: told[key] for key in ("verdict", "kind", "rotor", "judged_s")} | first | monitors))


def differences(old: Any, new: Any, where: str) -> Iterator[str]:
    """Where two answers differ, a line each."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            yield from differences(old.get(key), new.get(key), f"{where} {key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for before, now in zip(old, new, strict=True):
            yield from differences(before, now, where)
    elif isinstance(old, float) and isinstance(new, float):
        if not math.isclose(old, new, rel_tol=RELATIVE, abs_tol=1e-9):
            yield f"{where}: {old:.9g} -> {new:.9g}"
    elif old != new:
        yield f"{where}: {old} -> {new}"


def main() -> int:
    """Record, or print what differs; 1 if anything does."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--shared", type=Path)
    parser.add_argument("--flights", type=int, default=60)
    options = parser.parse_args()
    found = answers(options.shared, options.flights)
    if options.what == "record":
        options.file.write_text(json.dumps(found, indent=1))
        print(f"{len(found)} answers written to {options.file}")
        return 0
    lines = list(differences(json.loads(options.file.read_text()), found, ""))
    print(*lines, f"{len(found)} answers, {len(lines)} differences", sep="\n")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
