"""How much processor time the detector takes until it is ready, beside what Python, numpy and the dialect alone take.

    python benchmarks/start_time.py [--runs 5]

Both are whole processes, run in turn; the smallest of the runs counts, and the ratio is to the peer. Their modules are
compiled beforehand, as pip compiles what it installs. Demanded: under 0.7 s on the machine that prints it.
"""

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile

PEER = "import numpy, scipy.linalg, pymavlink.dialects.v20.ardupilotmega; print('ready')"
DETECTOR = ("-m", "detector", "--learn", "10", "--save", "b.json", "--connect", "udpin:127.0.0.1:0")


def spent_s(arguments: tuple[str, ...], environment: dict[str, str]) -> float:
    """Processor time of a process until it says that it is ready, and its end [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as child:
        assert child.stdout is not None
        while not child.stdout.readline().startswith("ready"):  # it may have to compile first
            assert child.poll() is None
        child.send_signal(signal.SIGTERM)
        child.stdout.read()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print both and the ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": folder, "PYTHONDONTWRITEBYTECODE": ""}
        commands = (DETECTOR, ("-c", PEER))
        for command in commands:
            spent_s(command, environment)
        pairs = [[spent_s(command, environment) for command in commands] for _ in range(runs)]
    ours, peer = (min(column) for column in zip(*pairs, strict=True))
    print(f"detector ready after {ours:.2f} s of processor time, peer {peer:.2f} s, ratio {ours / peer:.1f}")


if __name__ == "__main__":
    main()
