"""The demo's flight over many seeds: alarms only after the onset?

    python benchmarks/demo_seeds.py [--seeds 20] [--duration 25] [--at-once 2]

Runs `mavdiag demo --json` for each seed (baseline: FML from 60 fast-recorded healthy flights) and counts.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np


def demo(seed: int, duration_s: float) -> tuple[bool, float | None, int]:
    """Whether it went well, the latency [s], and the alerts before the onset."""
    command = [
        sys.executable,
        "-m",
        "mavdiag",
        "demo",
        "--thorough",
        "--json",
        "--seed",
        str(seed),
        "--duration",
        f"{duration_s:g}",
    ]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode not in (0, 1):
        raise RuntimeError(run.stderr.strip())
    said = json.loads(run.stdout.splitlines()[-1])
    return run.returncode == 0, said["latency_s"], said["false_alarms"]


def main() -> None:
    """Run and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--duration", type=float, default=25.0)
    parser.add_argument("--at-once", type=int, default=2)
    arguments = parser.parse_args()
    first = demo(5000, arguments.duration)  # makes the baseline, if there is none yet
    with ThreadPoolExecutor(arguments.at_once) as pool:
        rest = pool.map(lambda i: demo(5000 + i, arguments.duration), range(1, arguments.seeds))
        runs = [first, *rest]
    latencies = [latency for _, latency, _ in runs if latency is not None]
    print(f"alarmed only after the onset: {sum(good for good, _, _ in runs)} of {len(runs)} seeds")
    print(f"alerts before the onset: {sum(early for _, _, early in runs)}")
    print(f"latency s: median {np.median(latencies):.2f}, largest {np.max(latencies):.2f}")


if __name__ == "__main__":
    main()
