"""How fast a DataFlash log is read, against pymavlink's DFReader on the same file in the same run, in processor time.

Usage: python benchmarks/dataflash_reader.py [--copies N] LOG.bin [...]

DFReader is opened and asked for every record of the messages that `mavdiag` needs (recv_match). Beside it stand the
same messages as tables of numbers (the walk), and the whole reader: with SHA-256 of the file and series in SI. With
--copies the log is also read from a file with its content so many times, for the memory that a long one takes.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from mavdiag.logs.dataflash import WANTED, Walk, read_dataflash
from mavdiag.logs.log import Table, windows_of

REPEATS = 20
PEER_REPEATS = 3


def peer(path: Path) -> int:
    """Read the needed messages with pymavlink. Returns how many."""
    reader = import_module("pymavlink.DFReader").DFReader_binary(str(path), zero_time_base=False)
    count = 0
    while reader.recv_match(type=list(WANTED)) is not None:
        count += 1
    reader.close()
    return count


def tables_of(path: Path) -> list[Table]:
    """Read the needed messages as tables."""
    walk = Walk(WANTED)
    for window in windows_of(path):
        walk.feed(window)
    return list(walk.finish()[0].values())


def least_s(action: Callable[[Path], object], path: Path, repeats: int) -> float:
    """The least processor time of several runs [s]."""
    spans = []
    for _ in range(repeats):
        start = time.process_time()
        action(path)
        spans.append(time.process_time() - start)
    return min(spans)


def long_file(path: Path, copies: int) -> str:
    """Time and memory of the walk through a file that holds the log several times."""
    with tempfile.TemporaryDirectory() as folder:
        long = Path(folder) / "long.bin"
        content = path.read_bytes().rstrip(b"\0\xff")
        with long.open("wb") as file:
            for _ in range(copies):
                file.write(content)
        size = long.stat().st_size
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
        start = time.process_time()
        tables = tables_of(long)
        took_s = time.process_time() - start
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10) - before
    held = sum(sum(one.nbytes for one in table.fields.values()) + table.starts.nbytes for table in tables)
    return f"{size / 1e6:.0f} MB in {took_s:.2f} s; peak {peak / 1e6:.0f} MB for {held / 1e6:.0f} MB of records"


def main() -> None:
    """Print one line per log."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--copies", type=int, default=0)
    parser.add_argument("logs", nargs="+", type=Path)
    arguments = parser.parse_args()
    for path in arguments.logs:
        theirs_s = least_s(peer, path, PEER_REPEATS)
        walk_s, whole_s = least_s(tables_of, path, REPEATS), least_s(read_dataflash, path, REPEATS)
        theirs_s = min(theirs_s, least_s(peer, path, PEER_REPEATS))
        print(
            f"{path.name}: {path.stat().st_size / 1e6:.1f} MB, {peer(path)} needed messages, "
            f"DFReader {theirs_s * 1e3:.0f} ms; tables {walk_s * 1e3:.1f} ms, {theirs_s / walk_s:.0f} times as fast; "
            f"whole reader {whole_s * 1e3:.1f} ms, {theirs_s / whole_s:.0f} times"
        )
        if arguments.copies:
            print(f"{path.name} x {arguments.copies}: {long_file(path, arguments.copies)}")


if __name__ == "__main__":
    main()
