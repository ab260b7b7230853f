"""How fast a telemetry log is decoded and becomes telemetry, against pymavlink's mavlogfile on the same file.

    python benchmarks/tlog_reader.py [LOG.tlog] [--seconds 440] [--repeats 5]

Without a file an emulated QDrone 2 at 1 kHz is recorded: 1,009,000 messages in 440 s. The peer reads the file to its
end with `recv_msg`, which tests the checksum of every message and unpacks its fields. We read the file and test the
checksum of every message as well, count every sender's losses, and lay the fields of the messages that any profile
reads side by side as arrays ("decoding"); `read_tlog` goes on to the telemetry of one vehicle, in SI, on one timeline,
and takes the SHA-256 of the file.

Figures are processor time: the median of the repeats against the mean of one run of the peer before and one after them.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from mavdiag.logs.log import windows_of
from mavdiag.logs.tlog import PIECE_BYTES, TlogContent, decode_tlog, read_tlog

SEED = 1


def peer(path: Path) -> int:
    """Messages that pymavlink reads."""
    file, count = import_module("pymavlink.mavutil").mavlogfile(str(path)), 0
    while file.recv_msg() is not None:
        count += 1
    return count


def decoded(path: Path) -> TlogContent:
    """Every frame checked, the wanted ones as columns, read as `read_tlog` reads them."""
    return decode_tlog(windows_of(path, PIECE_BYTES))


def seconds_of(work: Callable[[], object]) -> float:
    """Processor time of one run."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def race(path: Path, repeats: int) -> None:
    """Print each contender's time and its ratio to the peer."""
    first = seconds_of(lambda: decoded(path))
    content = decoded(path)
    print(f"{path.name}: {content.records} messages, {content.size / 1e6:.1f} MB, seed {SEED}")
    assert peer(path) == content.records + content.damaged_bytes, "the peer reads something else"
    theirs = [seconds_of(lambda: peer(path))]
    decoding = [seconds_of(lambda: decoded(path)) for _ in range(repeats)]
    whole = [seconds_of(lambda: read_tlog(path)) for _ in range(repeats)]
    theirs.append(seconds_of(lambda: peer(path)))
    against = statistics.mean(theirs)
    print(f"  the peer {1e6 * against / content.records:.2f} us a message, our first run {first:.2f} s")
    for name, own in (("decoding", decoding), ("read_tlog to telemetry", whole)):
        ours = statistics.median(own)
        speed = f"{1e6 * ours / content.records:.3f} us a message, {content.size / ours / 1e6:.0f} MB/s"
        print(f"    {name:24} {speed:36} {against / ours:6.1f} x (worst {against / max(own):.1f} x)")
    print(f"  peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


def main() -> None:
    """Run the race."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, nargs="?")
    parser.add_argument("--seconds", type=float, default=440.0)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = options.log or Path(folder) / "emulated.tlog"
        if options.log is None:
            record = [sys.executable, "-m", "sitl_plant", "record", "-o", str(path), "--seed", str(SEED)]
            subprocess.run([*record, "--duration", str(options.seconds)], check=True)
        race(path, options.repeats)


if __name__ == "__main__":
    main()
