"""Make sections of docs/results.md again: run their commands and put what they print into the document.

    python benchmarks/results.py [SECTION]... [--shared FOLDER] [--list]      (without a section: all of them)

FOLDER holds the recordings in its folder `data`; commands that need them are left out without it. What a section prints
stands between two marks in the document, under the commit, the day and the machine that it was made with. A section
whose command fails keeps its old text, and the exit code is 1. Of each command the time by the clock and the processor
time are told: on a shared machine the first may be several times the second. Two of these may run side by side, best
one with attacks, page, soak, daemon and loop, which wait for the real clock, and one with the others.
"""

import argparse
import datetime
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "results.md"
CAMPAIGN = "--airframes 4 --learn-flights 15 --conditions loss=0 --conditions link=qdrone2@1000"
BUILT_IN = "resonance,isolation-10,isolation-30,imu-20hz,imu-42hz,imu-98hz,imu-188hz,link-100hz,link-200hz,link-400hz"

SECTIONS: dict[str, tuple[str, ...]] = {
    "size": ("python benchmarks/size.py",),
    "recorded": (
        "python benchmarks/recorded_flights.py FOLDER",
        "python benchmarks/arducopter_live.py FOLDER/arducopter_live",
        "python benchmarks/layouts.py --shared FOLDER",
        "python benchmarks/crazypad_thesis.py FOLDER/crazypad",
        "python benchmarks/evidence.py recorded FOLDER/crazypad",
        "python benchmarks/arducopter_live.py FOLDER/arducopter_live --turning --seed 2",
        "mavdiag identify FOLDER/autopilots_in_the_loop/ap463_hil_healthy.tlog -o TEMPORARY/b.json",
    ),
    "campaign": (
        f"sitl-plant campaign --flights 216 --hours 0 {CAMPAIGN} --conditions cause=fault --conditions wind=0,0.5,1 "
        "--conditions payload=0 --conditions phenomenology=0,0.5,1 --seed 41 --fresh -o TEMPORARY/faults.jsonl",
        "python benchmarks/campaign_grades.py TEMPORARY/faults.jsonl",
        f"sitl-plant campaign --flights 0 --hours 12 --duration 60 {CAMPAIGN} --conditions wind=0,0.5,1,1.5 "
        "--conditions payload=0,50,100 --seed 46 --fresh -o TEMPORARY/healthy.jsonl",
        "sitl-plant campaign --flights 72 --hours 0 --airframes 2 --learn-flights 5 --conditions cause=sensor,loss "
        "--seed 97 --fresh -o TEMPORARY/sensors.jsonl",
    ),
    "conditions": (
        "sitl-plant campaign --preset conditions --seed 75 --airframes 2 --hours 5 --flights 135 --fresh "
        "-o TEMPORARY/conditions.jsonl",
        "sitl-plant campaign --preset conditions --seed 76 --airframes 1 --hours 1 --flights 90 "
        f"--conditions condition={BUILT_IN} --fresh -o TEMPORARY/built_in.jsonl",
        "python benchmarks/vehicle_campaigns.py --seed 9",
    ),
    "other_kinds": (
        "python benchmarks/other_kinds.py",
        "python benchmarks/other_kinds.py --profile px4 --seed 700",
        "python benchmarks/other_kinds.py --seed 2700 --flights 1 --wind 5",
        "python benchmarks/other_kinds.py --profile px4 --seed 2700 --flights 1 --turbulence 10",
    ),
    "rotorpy": (
        "nox -s rotorpy -- --seed 2001 --flights 3",
        "nox -s rotorpy -- --seed 3001 --flights 3 --vehicle crazyflie",
    ),
    "hostile": (
        "python benchmarks/hostile_values.py --shared FOLDER/.. --seed 1",
        "python benchmarks/latched_faults.py --flights 3",
    ),
    "teaching": (
        "python benchmarks/broken_teaching.py --sets 40 --airframes 8 --seed 67",
        "python benchmarks/teaching_guards.py --sets 40 --seed 1",
        "python benchmarks/airframe_likeness.py --airframes 5 --seed 23",
    ),
    "attacks": ("python benchmarks/attacks.py --seconds 12",),
    "reactions": (
        "python benchmarks/reactions.py faults --place hover",
        "python benchmarks/reactions.py faults --place cruise --seeds 2",
        "python benchmarks/reactions.py faults --place mission --seeds 3",
        "python benchmarks/reactions.py loop",
        "python benchmarks/reactions.py called --calls 3",
        "python benchmarks/hook_delay.py",
    ),
    "no_reaction": ("python benchmarks/reactions.py healthy --healthy-h 10 --rate 200",),
    "loop": (
        "python benchmarks/hil.py --healthy-s 120",
        "python benchmarks/live_sessions.py resets --seconds 75",
        "python benchmarks/live_sessions.py takeoffs --flights 60",
        "python benchmarks/bad_link.py --seed 9200 --healthy 2",
    ),
    "thesis": (
        "python benchmarks/thesis_table.py --trials 5 --workers 1 --vehicle both --residual free-run one-step",
        "python benchmarks/identification.py --seeds 3",
        "python benchmarks/false_alarm_law.py",
    ),
    "damage": (
        "python benchmarks/least_damage.py --airframes 2 --flights 8 --seed 701",
        "python benchmarks/rotor_speed.py --flights 30 --airframes 2 --seed 971",
    ),
    "calibration": ("python benchmarks/calibration.py --airframes 12 --seed 95", "python benchmarks/promises.py"),
    "peers": ("python benchmarks/peers_table.py --airframes 1",),
    "speed": (
        "python benchmarks/chain_speed.py --seconds 30 --repeats 5",
        "python benchmarks/scan_speed.py --repeats 5",
        "python benchmarks/decode.py",
        "python benchmarks/endpoint.py",
        "python benchmarks/plant_speed.py",
        "python benchmarks/start_time.py",
        "python benchmarks/latency.py",
    ),
    "daemon": (
        "mavdiag demo --json",
        "python benchmarks/detector_load.py --seconds 15",
        "python benchmarks/many_vehicles.py --seconds 14",
        "python benchmarks/loopback.py --healthy-minutes 0",
        "python benchmarks/fleet.py",
    ),
    "soak": (
        "python fuzz/datagrams.py --count 100000",
        "python fuzz/baselines.py --count 1000 --seed 1",
        "python benchmarks/soak.py virtual --hours 2",
        "python benchmarks/soak.py real --minutes 5",
    ),
    "logs": (
        "python benchmarks/dataflash_reader.py FOLDER/ardupilot_real/log171.bin",
        "python benchmarks/dataflash_reader.py FOLDER/arducopter_sitl/jsonplant_flight.bin",
        "python benchmarks/ulog_reader.py FOLDER/px4_real/pyulog_sample.ulg",
        "python benchmarks/tlog_reader.py",
        "python benchmarks/report_size.py",
        "python benchmarks/archive.py --folder TEMPORARY/archive --flights 1000 --dask",
        "python benchmarks/identify_cost.py TEMPORARY/identify",
    ),
    "history": ("python benchmarks/history_wear.py drawn --seed 9300",),
    "page": ("python benchmarks/live_page.py --pairs 4 --seconds 10", "python benchmarks/replay_page.py"),
    "mutants": (
        "nox -s mutants -- --room decision --count 40 --seed 2",
        "nox -s mutants -- --room monitors --count 12 --seed 1 --longest 1200",
    ),
}


def main() -> int:
    """Run the sections that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="of: " + ", ".join(SECTIONS))
    parser.add_argument("--shared", type=Path, help="the folder of the recordings")
    parser.add_argument("--list", action="store_true", help="print the commands and run nothing")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.sections if name not in SECTIONS]:
        parser.error(f"no section {unknown[0]!r}; there are {', '.join(SECTIONS)}")
    failed = []
    for section in arguments.sections or SECTIONS:
        if arguments.list:
            print(section, *SECTIONS[section], sep="\n    ")
        elif not renew(section, arguments.shared):
            failed.append(section)
    if failed:
        print(f"not made: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def renew(section: str, shared: Path | None) -> bool:
    """Run the commands of a section and write what they print; False if one fails."""
    commands = [command for command in SECTIONS[section] if shared is not None or "FOLDER" not in command]
    with tempfile.TemporaryDirectory() as temporary:
        printed = [outcome for command in commands if (outcome := run(command, shared, temporary)) is not None]
    if not commands or len(printed) < len(commands):
        return False
    write(section, "\n".join([provenance(), *printed]))
    return True


def run(command: str, shared: Path | None, temporary: str) -> str | None:
    """The command as it stands in the document and what it prints; None if it fails."""
    print(f"$ {command}", flush=True)
    data = str(shared / "data") if shared else ""
    words = [word.replace("FOLDER", data).replace("TEMPORARY", temporary) for word in shlex.split(command)]
    program = Path(sys.executable).with_name(words[0])
    paths = os.pathsep.join(map(str, (ROOT, ROOT / "tests", ROOT / "benchmarks", ROOT / "fuzz")))
    environment = {**os.environ, "PYTHONPATH": paths}
    started, spent_s = time.monotonic(), sum(os.times()[2:4])
    done = subprocess.run([str(program), *words[1:]], cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode not in (0, 1) or "Traceback (most recent call last)" in done.stdout + done.stderr:
        print(done.stdout, done.stderr, sep="\n", file=sys.stderr)
        return None
    text = done.stdout.replace(temporary, "TEMPORARY")
    text = f"$ {command}\n{text.replace(data, 'FOLDER') if data else text}".rstrip()
    spent_s = sum(os.times()[2:4]) - spent_s
    return f"{text}\n[{time.monotonic() - started:.0f} s by the clock, {spent_s:.0f} s of processor time]"


def provenance() -> str:
    """Commit, day and machine."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout
    found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    units = "AVX-512" if any(name.startswith(("AVX512", "X86_V4")) for name in found) else "no AVX-512"
    machine = f"{os.cpu_count()} cores, {platform.machine()}, {units}, Python {platform.python_version()}"
    today = datetime.datetime.now(datetime.UTC).date()
    return f"# commit {commit.strip()}, {today}, {machine}, load before {os.getloadavg()[0]:.1f}"


def write(section: str, text: str) -> None:
    """Put the text between the marks of the section."""
    first, last = f"<!-- made: {section} -->", f"<!-- end: {section} -->"
    document = DOCUMENT.read_text(encoding="utf-8")
    pattern = re.compile(re.escape(first) + ".*?" + re.escape(last), re.DOTALL)
    if not pattern.search(document):
        raise SystemExit(f"docs/results.md has no marks for {section}: {first} ... {last}")
    block = f"{first}\n```text\n{text}\n```\n{last}"
    DOCUMENT.write_text(pattern.sub(lambda _: block, document), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
