"""How fast a DataFlash log becomes telemetry, against pymavlink's reader in the same run.

Usage: python benchmarks/dataflash_reader.py LOG.bin [...]
"""

import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from mavdiag.logs.dataflash import read_dataflash

WANTED = ["ATT", "IMU", "VIBE", "CTUN", "POS", "BARO", "BAT", "CURR", "RATE", "RCOU", "PARM", "ARM", "EV", "GPS"]


def peer(path: Path) -> None:
    """Read the same messages with pymavlink."""
    reader = import_module("pymavlink.DFReader").DFReader_binary(str(path), zero_time_base=False)
    while reader.recv_match(type=WANTED) is not None:
        pass
    reader.close()


def best_s(action: Callable[[Path], object], path: Path, repeats: int) -> float:
    """The shortest of several runs [s]."""
    spans = []
    for _ in range(repeats):
        start = time.perf_counter()
        action(path)
        spans.append(time.perf_counter() - start)
    return min(spans)


def main() -> None:
    """Print one line per log."""
    for path in map(Path, sys.argv[1:]):
        megabytes = path.stat().st_size / 1e6
        ours_s, theirs_s = best_s(read_dataflash, path, 5), best_s(peer, path, 2)
        speed = f"{ours_s * 1e3:.0f} ms, {megabytes / ours_s:.0f} MB/s"
        print(f"{path.name}: {megabytes:.1f} MB in {speed}; {theirs_s / ours_s:.0f} times pymavlink")


if __name__ == "__main__":
    main()
