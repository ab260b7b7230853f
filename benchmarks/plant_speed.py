"""How fast the plant flies: against real time, against the same code interpreted, and what a start costs.

    python benchmarks/plant_speed.py

Process time on one core, so that a busy machine changes little. The square with a fault, controller, sensors, cameras
and records included. The target is 300 times real time.
"""

import os
import subprocess
import sys
import time

TARGET = 300.0
PROBE = """
import time
start = time.process_time()
from sitl_plant.plant import Plant, PlantConfig
imported = time.process_time()
plant = Plant(PlantConfig(fault="F2/SV2", onset_s=5.0))
ready = time.process_time()
print(imported - start, ready - imported)
"""


def speed(block: int, seconds: float) -> float:
    """Flight seconds per second of one core, flown in blocks of `block` steps; the best of three."""
    from sitl_plant.plant import Plant, PlantConfig

    plant = Plant(PlantConfig(fault="F2/SV2", onset_s=5.0))
    best = 0.0
    for _ in range(3):
        start = time.process_time()
        for _ in range(round(seconds * 1000) // block):
            plant.advance(block)
        best = max(best, seconds / (time.process_time() - start))
    return best


def probe(interpreted: bool) -> tuple[float, float]:
    """Process time of import and of the first plant, with its 10 s of settling, in a new process."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1" if interpreted else "0"}
    run = subprocess.run([sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, check=True)
    imported, started = map(float, run.stdout.split())
    return imported, started


def main() -> None:
    """Print the table."""
    compiled = {block: speed(block, 40.0 if block > 20 else 4.0) for block in (1000, 100, 10)}
    imported, started = probe(interpreted=False)
    _, interpreted = probe(interpreted=True)
    for block, ratio in compiled.items():
        print(f"flown in blocks of {block:4d} steps   {ratio:7.0f} x real time   {1000 / ratio:6.2f} us a step")
    print(f"same code interpreted                {10.0 / interpreted:7.1f} x real time")
    print(f"compiled over interpreted            {compiled[1000] * interpreted / 10.0:7.0f} x")
    print(f"warm start: import {imported:.2f} s, first plant {started:.2f} s (machine code from the cache)")
    print(f"target {TARGET:.0f} x real time: {'met' if compiled[1000] >= TARGET else 'missed'}")


if __name__ == "__main__":
    main()
