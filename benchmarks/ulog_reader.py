"""How much of the time of reading a ULog is the reader's own, beside pyulog's for the same topics in the same run.

Usage: python benchmarks/ulog_reader.py LOG.ulg [...]
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

from pyulog import ULog

from mavdiag.logs.ulog import TOPICS, read_ulog

REPEATS = 15


def peer(path: Path) -> None:
    """Read the same topics with pyulog alone."""
    ULog(str(path), list(TOPICS))


def least_s(actions: tuple[Callable[[Path], object], ...], path: Path) -> list[float]:
    """The least processor time of each action [s], in turns."""
    spans = [[0.0] * REPEATS for _ in actions]
    for turn in range(REPEATS):
        for action, own in zip(actions, spans, strict=True):
            start = time.process_time()
            action(path)
            own[turn] = time.process_time() - start
    return [min(own) for own in spans]


def main() -> None:
    """Print one line per log."""
    for path in map(Path, sys.argv[1:]):
        whole_s, pyulog_s = least_s((read_ulog, peer), path)
        figures = f"read_ulog {whole_s * 1e3:.0f} ms, pyulog alone {pyulog_s * 1e3:.0f} ms of processor time"
        print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB; {figures}; own share {whole_s / pyulog_s - 1:.0%}")


if __name__ == "__main__":
    main()
