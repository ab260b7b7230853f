"""What judges is compiled by a command, and what it compiles is what runs."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
JUDGED = """
from flying_telemetry import flying
from made_baselines import whole
from made_telemetry import cut
from mavdiag.chain import chain_of, warm
from mavdiag import kernel
from mavdiag.rows import align, gate, rates

baseline = whole()
kernels = [kernel.judge, align._take, align._rows, gate._follow, rates._filter]
warm()
chain = chain_of(baseline)
state, telemetry = chain.start(), flying(3000, 7)
first = int(telemetry.series[0].t_ns[0])
for chunk in cut(telemetry, [first + k * 40_000_000 for k in range(1, 700)]):
    state, _ = chain.step(state, chunk)
assert state.judged_s > 10.0
print({len(kernel.signatures) for kernel in kernels})
"""


def test_a_live_flight_finds_every_kernel_compiled() -> None:
    """No look waits for a compilation: a second one would be of another kind of array."""
    environment = os.environ | {"PYTHONPATH": str(TESTS)}
    run = [sys.executable, "-c", JUDGED]
    done = subprocess.run(run, capture_output=True, text=True, check=False, env=environment, cwd=TESTS.parent)
    assert (done.returncode, done.stdout) == (0, "{1}\n"), done.stderr


def test_what_was_compiled_beside_the_sources_is_taken_over(tmp_path: Path) -> None:
    """As by a user who may not write into the installation, where root's `mavdiag warm` compiled."""
    for environment in (os.environ, os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}):
        run = [sys.executable, "-m", "mavdiag", "warm"]
        done = subprocess.run(run, capture_output=True, text=True, check=False, env=environment, cwd=TESTS.parent)
    assert done.returncode == 0, done.stderr
    taken = list(tmp_path.rglob("*.nbi"))
    assert taken
    for index in taken:
        assert index.read_bytes() == next(TESTS.parent.rglob(f"__pycache__/{index.name}")).read_bytes()
