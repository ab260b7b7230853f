"""What the whole detector costs on a live 1 kHz link, against a mavutil loop that only receives the same stream.

    python benchmarks/detector_load.py [--seconds 20] [--rate 1000]

One emulated vehicle sends to both over UDP loopback at the same time. Figures are shares of one core, by the system's
own account of each process in the same span, without their start-up; the ratio is to the peer.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mavdiag.airframe.load import airframe_named
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs.tlog import read_tlog

SETTLE_S = 4.0  # from the first message until the detector judges
PEER = """
import sys
from pymavlink import mavutil
link = mavutil.mavlink_connection("udpin:127.0.0.1:" + sys.argv[1], dialect="ardupilotmega")
while True:
    link.recv_match(blocking=True)
"""


def baseline_file(folder: Path, rate: int) -> Path:
    """A baseline of the emulated vehicle."""
    log, path = folder / "healthy.tlog", folder / "baseline.json"
    plant = [sys.executable, "-m", "sitl_plant", "record", "-o", str(log), "--duration", "30", "--rate", str(rate)]
    subprocess.run(plant, check=True, capture_output=True)
    options = LearnOptions(airframe=airframe_named("qdrone2"))
    learn([read_tlog(log)], options, created="2026-01-01T00:00:00Z").save(path)
    return path


def cpu_s(pid: int) -> float:
    """Processor time that a process has used [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def free_port() -> int:
    """A port that was free a moment ago."""
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def main() -> None:
    """Run both and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=int, default=1000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        baseline = baseline_file(Path(folder), options.rate)
        detector = subprocess.Popen(
            [sys.executable, "-m", "detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(baseline)],
            stderr=subprocess.PIPE,
            text=True,
        )
        assert detector.stderr is not None
        ports = [int(re.findall(r"\d+", detector.stderr.readline().split(",")[0])[-1]), free_port()]
        peer = subprocess.Popen([sys.executable, "-c", PEER, str(ports[1])])
        time.sleep(1.0)
        outs = [part for port in ports for part in ("--out", f"udpout:127.0.0.1:{port}")]
        span = str(SETTLE_S + options.seconds + 1.0)
        plant = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "sitl_plant",
                "run",
                *outs,
                "--duration",
                span,
                "--rate",
                str(options.rate),
                "--json",
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert plant.stdout is not None
        plant.stdout.readline()
        time.sleep(SETTLE_S)
        before, since = [cpu_s(one.pid) for one in (detector, peer)], time.monotonic()
        time.sleep(options.seconds)
        spent, span_s = [cpu_s(one.pid) for one in (detector, peer)], time.monotonic() - since
        report = json.loads(plant.communicate()[0].splitlines()[-1])
        peer.kill()
        detector.terminate()
        summary = detector.communicate()[1].splitlines()[-1]
    shares = [100.0 * (b - a) / span_s for a, b in zip(before, spent, strict=True)]
    rate = report["messages"] / 2 / report["flown_s"]
    print(f"{rate:.0f} messages a second, {span_s:.0f} s")
    print(f"  mavutil, receiving only   {shares[1]:5.1f} % of a core   1.00")
    print(f"  detector, judging         {shares[0]:5.1f} % of a core   {shares[0] / shares[1]:.2f}")
    print(summary)


if __name__ == "__main__":
    main()
