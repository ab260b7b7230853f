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
