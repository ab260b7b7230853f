"""How fast the plant flies: against real time, a bare plant in C, the same code interpreted; and what a start costs.

    python benchmarks/plant_speed.py

Process time on one core, so that a busy machine changes little. The square with a fault, controller, sensors, cameras
and records included. The target is 300 times real time. The bare plant (`peers/bare_plant.c`, compiled by `cc -O2` if
there is one) has the same physics and a cascade, no cameras, and records nothing; both draw their noise by numpy, and
they take turns.
"""

import ctypes
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

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


def bare_plant(folder: str) -> Callable[[int], float] | None:
    """Flies the plant in C for so many steps and returns the process time that it took; None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    source, library = Path(__file__).parent / "peers" / "bare_plant.c", Path(folder) / "bare_plant.so"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"], check=True)
    bare = ctypes.CDLL(str(library))
    bare.fly.restype = ctypes.c_double
    state, rng, flown = (ctypes.c_double * 80)(), np.random.default_rng(1), 0
    bare.begin(state)

    def fly(steps: int) -> float:
        nonlocal flown
        start = time.process_time()
        for _ in range(steps // 1000):
            normals = rng.standard_normal((1000, 17))
            end = bare.fly(1000, state, normals.ctypes.data_as(ctypes.c_void_p), ctypes.c_double(1e-3 * flown))
            flown += 1000
        spent = time.process_time() - start
        assert math.isfinite(end), "the bare plant does not fly"
        assert abs(state[2]) < 3.0, "the bare plant does not fly"
        return spent

    return fly


def against_bare(bare: Callable[[int], float], steps: int = 40_000, repeats: int = 7) -> tuple[float, float]:
    """Microseconds a step of the plant and of the bare one, the best of the turns."""
    from sitl_plant.plant import Plant, PlantConfig

    plant, ours, theirs = Plant(PlantConfig(fault="F2/SV2", onset_s=5.0)), math.inf, math.inf
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(steps // 1000):
            plant.advance(1000)
        ours = min(ours, time.process_time() - start)
        theirs = min(theirs, bare(steps))
    return 1e6 * ours / steps, 1e6 * theirs / steps


def probe(interpreted: bool) -> tuple[float, float]:
    """Process time of import and of the first plant, with its 10 s of settling, in a new process."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1" if interpreted else "0"}
    run = subprocess.run([sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, check=True)
    imported, started = map(float, run.stdout.split())
    return imported, started


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        bare = bare_plant(folder)
        if bare is None:
            print("no C compiler here, so no bare plant to compare with")
        else:
            ours, theirs = against_bare(bare)
            print(f"plant {ours:.2f} us a step, bare plant in C {theirs:.2f} us: {theirs / ours:.2f} x its speed")
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
