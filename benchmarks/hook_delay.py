"""Whether hooks delay an alert: the same flight watched by daemons without a hook, with a dead server, a slow program.

    python benchmarks/hook_delay.py [--lines 1200]

A made vehicle (100 Hz, virtual clock) turns now and then though nobody asked it to. The daemons look in turn at the
same frames, so that what else runs on the machine delays all of them. A look with an alert is one in which at least one
line for hooks was written; it is taken from its beginning to its end, which is after the alert was sent. Given are the
lines until the queue is full and more; each must be delivered, or be counted as lost, and the loss be told.
"""

import argparse
import gc
import socket
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from made_session import baseline_for
from made_vehicle import TICK_S, Bench, MadeVehicle

from detector.config import Settings
from detector.hooks import Courier, Hook, parse_hook

CALM_S, TURNING_S, PAUSE_S = 8.0, 0.4, 1.6
TURNING = 1.5  # rad/s
SLOW_S = 2.0
LATE_S = 0.010


class Counter(Hook):
    """A hook that counts what it is given, and what it delivered."""

    def __init__(self, text: str, said: list[str]) -> None:
        deliver = parse_hook(text)
        self.given = self.delivered = 0

        def delivered(line: bytes) -> None:
            deliver(line)
            self.delivered += 1

        Courier.__init__(self, f"hook {text}", delivered, said.append)

    def write(self, text: str, urgent: bool = False) -> None:
        """Queue a line."""
        self.given += urgent
        super().write(text, urgent)


@dataclass
class Watched:
    """One daemon. spans_s, processor_s: of its looks with an alert, by the clock and of its own thread."""

    name: str
    bench: Bench
    hook: Counter
    said: list[str]
    spans_s: list[float] = field(default_factory=list)
    processor_s: list[float] = field(default_factory=list)

    def look(self, count: bool) -> bool:
        """Let one tick pass; return whether there was an alert. count: keep how long it took."""
        bench, given = self.bench, self.hook.given
        for frame in bench.vehicles[0].samples(round(100 * TICK_S)):
            bench.far.send(frame)
        bench.host.sleep(TICK_S)
        began_s, used_s = time.perf_counter(), time.thread_time()
        bench.daemon.tick()
        if count and self.hook.given > given:
            self.spans_s.append(time.perf_counter() - began_s)
            self.processor_s.append(time.thread_time() - used_s)
        return self.hook.given > given


class Nothing(Counter):
    """No hook, but the count."""

    def put(self, line: bytes) -> None:
        """Drop it."""


def watched(name: str, address: str, kind: type[Counter] = Counter) -> Watched:
    """A daemon with a hook."""
    said: list[str] = []
    hook = kind(address, said)
    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
    return Watched(name, Bench(settings, baseline_for(), vehicles=[MadeVehicle(1)], hooks=(hook,)), hook, said)


def flown(lines: int) -> list[Watched]:
    """The daemons after at least so many lines for each hook."""
    with socket.socket() as dead:  # nobody listens there
        dead.bind(("127.0.0.1", 0))
        slow = f"exec:{sys.executable} -c 'import time; time.sleep({SLOW_S:g})'"
        all_ = [
            watched("no hook", f"exec:{sys.executable}", Nothing),
            watched("dead server", f"http://127.0.0.1:{dead.getsockname()[1]}/"),
            watched("slow program", slow),
        ]
        ticks = 0
        while min(one.hook.given for one in all_) < lines:
            t_s, ticks = ticks * TICK_S, ticks + 1
            turning = t_s > CALM_S and (t_s - CALM_S) % (TURNING_S + PAUSE_S) < TURNING_S
            order = all_[ticks % 3 :] + all_[: ticks % 3]
            for one in order:
                one.bench.vehicles[0].turning = TURNING * turning
                one.look(t_s > CALM_S)
        for one in all_:
            one.bench.close()
            one.hook.close()
    return all_


def main() -> None:
    """Print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lines", type=int, default=1200)
    gc.freeze()  # what was imported is not looked through again amid a look, which took 0.1 s
    found = flown(parser.parse_args().lines)
    bare = found[0]
    for one in found:
        wall, own = 1e3 * np.array(one.spans_s), 1e3 * np.array(one.processor_s)
        half, most = np.quantile(wall, [0.5, 0.99])
        print(f"{one.name}: {len(wall)} looks with an alert, {half:.2f} ms (half), {most:.2f} ms (99 %), "
              f"{wall.max():.2f} ms at most; processor {np.median(own):.2f} ms, {own.max():.2f} ms")  # fmt: skip
    for one in found[1:]:
        later = 1e3 * (np.array(one.processor_s) - np.array(bare.processor_s))
        wall = 1e3 * (np.array(one.spans_s) - np.array(bare.spans_s))
        hook = one.hook
        over, chance = int(np.sum(wall > 1e3 * LATE_S)), int(np.sum(wall < -1e3 * LATE_S))
        print(f"{one.name}: later by {np.median(wall):.2f} ms (half), {np.quantile(wall, 0.99):.2f} ms (99 %), "
              f"processor {np.median(later):.2f} ms, {later.max():.2f} ms at most; by more than 10 ms {over} of "
              f"{len(wall)}, earlier by as much {chance}")  # fmt: skip
        print(f"{one.name}: given {hook.given}, delivered {hook.delivered}, lost {hook.lost}, "
              f"of neither {hook.given - hook.delivered - hook.lost}; told in "
              f"{len(one.said)} lines, the last: {one.said[-1].rpartition(': ')[2]}")  # fmt: skip


if __name__ == "__main__":
    main()
