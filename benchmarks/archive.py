"""An archive of flights judged by `mavdiag scan`: seconds, rows a second, memory; and the same on Dask with a loss.

    python benchmarks/archive.py --folder /var/tmp/archive --flights 1000
    python benchmarks/archive.py --folder /var/tmp/archive --flights 1000 --dask

The emulator flies `--distinct` flights (one of twenty with a propeller fault from the middle on; 100 Hz, profile
qdrone2), once; what is in the folder already is used again. The archive is made of copies of them whose records have
other times of arrival, each later by some hours. So all files differ in content and every one is read and judged, and
no cache of answers can help; but only the distinct ones are really different flights. The files may still be in the
page cache of the system, since they were just written.

Memory is the sum of the proportional set sizes (PSS) of the command and all its children, looked at twice a second. The
peer in the same run judges some of the same files without a pool (`--jobs 1`).

`--dask` starts a scheduler and two workers, each a process with one thread, kills one of them when a third of the
answers has come, and compares the answers with those of the pool, line by line.
"""

import argparse
import os
import platform
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from dask_cluster import cluster

from mavdiag.telemetry import IntArray

RATE_HZ = 100
HOUR_US = 3_600_000_000
LEARNT, LEARNT_S = 4, 60
SAMPLE_S = 0.5
SEED = 1000


@dataclass(frozen=True)
class Ran:
    """One run of the command. lines: its JSON, sorted by log."""

    seconds: float
    processor_s: float
    peak_bytes: int
    lines: tuple[str, ...]


def python(*arguments: str) -> None:
    """A module of ours, to its end."""
    subprocess.run([sys.executable, "-m", *arguments], check=True, stdout=subprocess.DEVNULL)


def flown(folder: Path, distinct: int, seconds: int) -> list[Path]:
    """The distinct flights, and a baseline beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    link = ("--profile", "qdrone2", "--rate", str(RATE_HZ))
    baseline = folder / "baseline.json"
    if not baseline.exists():
        learnt = folder / "learnt"
        learnt.mkdir(exist_ok=True)
        options = ("--flights", str(LEARNT), "--duration", str(LEARNT_S), "--seed", "1")
        python("sitl_plant", "record", "-o", str(learnt / "h.tlog"), *link, *options)
        python("mavdiag", "identify", str(learnt), "-o", str(baseline), "--airframe", "qdrone2")
    paths = [folder / f"distinct-{seconds}s-{number:03d}.tlog" for number in range(distinct)]
    for number, path in enumerate(paths):
        if path.exists():
            continue
        fault = ("--fault", "F2/SV2", "--rotor", str(1 + number // 20 % 4), "--onset", str(seconds / 2))
        options = ("--duration", str(seconds), "--seed", str(SEED + number), *(fault if number % 20 == 3 else ()))
        part = path.with_suffix(".part")
        python("sitl_plant", "record", "-o", str(part), *link, *options)
        part.rename(path)
    return paths


def stamps_at(data: npt.NDArray[np.uint8]) -> IntArray:
    """Where the times of the records begin: 8 bytes, before frames of MAVLink 2 without signature."""
    found, at = [], 0
    while at + 20 <= len(data):
        assert data[at + 8] == 0xFD, "not a record of a MAVLink 2 frame"
        found.append(at)
        at += 8 + 12 + int(data[at + 9])
    return np.array(found, dtype=np.int64)


def archive(folder: Path, flights: int, originals: Sequence[Path], seconds: int) -> Path:
    """So many flights, all different in content. What is there already stays."""
    target = folder / f"archive-{flights}x{seconds}s"
    target.mkdir(exist_ok=True)
    for number, original in enumerate(originals):
        missing = [
            (copy, path)
            for copy in range(1 + (flights - 1 - number) // len(originals) if number < flights else 0)
            if not (path := target / f"{number:03d}-{copy:03d}.tlog").exists()
        ]
        if not missing:
            continue
        data = np.frombuffer(original.read_bytes(), dtype=np.uint8)
        where = stamps_at(data)[:, np.newaxis] + np.arange(8)
        times = data[where].copy().view(">u8")
        for copy, path in missing:
            later = data.copy()
            later[where] = (times + np.uint64(copy * HOUR_US)).astype(">u8").view(np.uint8)
            path.write_bytes(later.tobytes())
    return target


def family(pid: int) -> list[int]:
    """A process and all its descendants."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents.setdefault(int(fields[1]), []).append(int(entry.name))
    found, left = [], [pid]
    while left:
        found.append(left.pop())
        left += parents.get(found[-1], [])
    return found


def pss_bytes(pids: Sequence[int]) -> int:
    """Sum of their proportional set sizes; a process that has ended counts nothing."""
    total = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/smaps_rollup").read_text()
        except OSError:
            continue
        found = re.search(r"^Pss:\s+(\d+) kB", text, re.MULTILINE)
        total += 1024 * int(found[1]) if found else 0
    return total


@contextmanager
def watched(pids: Callable[[], Sequence[int]]) -> Iterator[list[int]]:
    """The highest memory of these processes while the block runs, as a list of one."""
    peak, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(SAMPLE_S):
            peak[0] = max(peak[0], pss_bytes(pids()))

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield peak
    finally:
        ended.set()
        thread.join()


def scanned(
    logs: Sequence[Path], baseline: Path, *options: str, seen: Callable[[int], None] = lambda count: None,
    others: Sequence[int] = (),
) -> Ran:  # fmt: skip
    """Run the command with an empty cache. seen: is told how many answers there are. others: its workers elsewhere."""
    with tempfile.TemporaryDirectory() as cache:
        told = ("--baseline", str(baseline), "--json", "--cache", cache, *options)
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        command = [sys.executable, "-m", "mavdiag", "scan", *map(str, logs), *told]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            with watched(lambda: [*family(child.pid), *(one for pid in others for one in family(pid))]) as peak:
                lines = []
                for line in child.stdout:
                    lines.append(line)
                    seen(len(lines))
        seconds, after = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    assert child.returncode in (0, 1), f"the command ended with {child.returncode}"
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Ran(seconds, used, peak[0], tuple(sorted(lines)))


def on_dask(logs: Path, baseline: Path, flights: int) -> Ran:
    """The same on two workers, one of which is killed by its id when a third of the answers is there."""
    with cluster(2) as (address, processes):

        def seen(count: int) -> None:
            if count == max(1, flights // 3):
                processes[1].send_signal(signal.SIGKILL)

        ran = scanned([logs], baseline, "--scheduler", address, seen=seen, others=[one.pid for one in processes])
        assert processes[1].wait() == -signal.SIGKILL
        return ran


def told(name: str, ran: Ran, flights: int, seconds: int) -> None:
    """Print a run."""
    rows = flights * seconds * RATE_HZ
    print(
        f"{name}: {flights} flights in {ran.seconds:.1f} s, {rows / ran.seconds / 1e3:.0f}k rows a second; "
        f"{ran.processor_s:.1f} s of processor time; {ran.peak_bytes / 1e6:.0f} MB of memory (PSS)"
    )


def main() -> None:
    """Make the archive, scan it, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--flights", type=int, default=50)
    parser.add_argument("--distinct", type=int, default=20)
    parser.add_argument("--seconds", type=int, default=300)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--peer", type=int, default=10, help="flights that one worker judges, for the ratio")
    parser.add_argument("--dask", action="store_true")
    arguments = parser.parse_args()
    flights, seconds = arguments.flights, arguments.seconds
    originals = flown(arguments.folder, min(arguments.distinct, flights), seconds)
    logs, baseline = archive(arguments.folder, flights, originals, seconds), arguments.folder / "baseline.json"
    size = sum(path.stat().st_size for path in logs.iterdir())
    print(
        f"{flights} flights of {seconds} s, {len(originals)} of them distinct, {size / 1e9:.2f} GB; seed {SEED}; ",
        end="",
    )
    print(f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}, numpy {np.__version__}")
    pool = scanned([logs], baseline, "--jobs", str(arguments.jobs))
    assert len(pool.lines) == flights
    told(f"{arguments.jobs} worker processes", pool, flights, seconds)
    few = sorted(logs.iterdir())[: min(arguments.peer, flights)]
    if few:
        one = scanned(few, baseline, "--jobs", "1")
        told("one process", one, len(few), seconds)
        print(f"the pool is {one.seconds / len(few) / (pool.seconds / flights):.2f} x as fast a flight as one process")
    if arguments.dask:
        ran = on_dask(logs, baseline, flights)
        told("two Dask workers, one killed", ran, flights, seconds)
        print(f"answers identical to the pool's: {'yes' if ran.lines == pool.lines else 'NO'}")


if __name__ == "__main__":
    main()
