"""Teaching sets with a damaged propeller in them: how many are refused or of grade D, and how many healthy ones.

    python benchmarks/broken_teaching.py [--sets 100] [--airframes 12] [--pool 8] [--seed 0]

Airframes are drawn, every second one aged, each over one of four links (1 kHz, 200, 160 and 100 Hz). For each a pool of
healthy flights of 30 to 40 s is flown, manoeuvres, wind and payload drawn at random, and one flight for each fault of
the thesis (F1/SV1 to F3/SV3) on a rotor drawn, faulty from before the start, and one in which it breaks at half. A set
is drawn from one airframe's flights: healthy ones; the same with one that is replaced by a faulty one; or a single
flight with the fault at half. Each is learnt as `mavdiag identify` does, by the monitors that a grade rests on (the
others take three quarters of the time and change no grade). One airframe is done after the other. Ctrl-C and SIGTERM
end it early, with the tables of what was done.
"""

import argparse
import contextlib
import signal
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from teaching_guards import Session, session_of

from mavdiag.errors import MavdiagError
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from sitl_plant.campaign.plan import injections_of
from sitl_plant.physics.faults import FAULTS
from sitl_plant.vehicle import airframe_of

CREATED = "2026-01-01T00:00:00+00:00"
SIZES = (1, 2, 3, 5, 8)
MONITORS = ("rotor_signature", "unbalance", "vibration_level", "rotor_trim", "trim_step")
CODES = tuple(FAULTS)


@dataclass(frozen=True, slots=True)
class Pool:
    """Flights of one airframe: healthy ones, and for each fault one that has it throughout and one from half on."""

    session: Session
    healthy: tuple[Log, ...]
    broken: dict[str, Log]
    half: dict[str, Log]

    @property
    def link(self) -> str:
        """Profile and rate."""
        return f"{self.session.link.profile}@{self.session.link.rate_hz:g}"

    def verdict(self, flights: Sequence[Log]) -> str:
        """The grade of a baseline of these flights, or "refused"."""
        frame = airframe_of(self.session.airframe.vehicle, self.session.airframe.name)
        options = LearnOptions(airframe=frame, monitors=MONITORS)
        try:
            return learn(flights, options, created=CREATED).grade or ""
        except MavdiagError:
            return "refused"


def pool_of(seed: int, number: int, size: int, codes: Sequence[str] = CODES) -> Pool:
    """The flights of an airframe. size: how many healthy ones. codes: of the faults."""
    session = session_of(seed, number)
    rng = session.rng

    def flight(code: str = "", onset: float = 0.0) -> Log:
        duration_s = float(rng.uniform(30.0, 40.0))
        return session.flight(
            duration_s, injections_of(code, int(rng.integers(1, 5)), onset * duration_s, 1.0, rng) if code else ()
        )

    healthy = tuple(flight() for _ in range(size))
    return Pool(session, healthy, {code: flight(code) for code in codes}, {code: flight(code, 0.5) for code in codes})


@dataclass(slots=True)
class Tally:
    """Sets that were refused or of grade D, and that were not: by kind, by kind and fault, and those gone wrong."""

    kinds: dict[str, Counter[bool]] = field(default_factory=lambda: defaultdict(Counter))
    codes: dict[tuple[str, str], Counter[bool]] = field(default_factory=lambda: defaultdict(Counter))
    wrong: Counter[str] = field(default_factory=Counter)
    pools: int = 0

    def judge(self, kind: str, pool: Pool, flights: Sequence[Log], code: str = "") -> None:
        """Learn a set and count it. code: the fault in it, empty for none."""
        found = pool.verdict(flights) in ("D", "refused")
        self.kinds[kind][found] += 1
        if code:
            self.codes[kind, code][found] += 1
        if found != bool(code):
            self.wrong[f"{kind}: {code or 'no fault'}, {pool.link}"] += 1

    def show(self) -> None:
        """Print the tables."""
        print(f"{sum(counts.total() for counts in self.kinds.values())} sets judged, of {self.pools} airframes\n")
        print("| teaching set | refused or grade D | share |\n|---|---|---|")
        for kind, counts in sorted(self.kinds.items()):
            total = counts.total()
            print(f"| {kind} | {counts[True]} of {total} | {100 * counts[True] / total:.1f} % |")
        print("\n| teaching set | " + " | ".join(CODES) + " |\n|" + "---|" * (len(CODES) + 1))
        for kind in dict.fromkeys(kind for kind, _ in self.codes):
            cells = (f"{self.codes[kind, code][True]} of {self.codes[kind, code].total()}" for code in CODES)
            print(f"| {kind} | " + " | ".join(cells) + " |")
        print("\nmissed, or marked without a fault: " + "; ".join(f"{a} ({n})" for a, n in sorted(self.wrong.items())))


def judge_sets(pool: Pool, sets: int, rng: np.random.Generator, tally: Tally) -> None:
    """Draw sets of each kind from an airframe's flights and learn them."""
    tally.pools += 1
    codes = list(pool.broken)
    for _ in range(sets):
        for size in SIZES:
            code = str(rng.choice(codes))
            chosen = [pool.healthy[i] for i in rng.permutation(len(pool.healthy))[:size]]
            tally.judge(f"healthy, {size}", pool, chosen)
            chosen[int(rng.integers(size))] = pool.broken[code]
            tally.judge(f"one broken of {size}", pool, chosen, code)
        code = str(rng.choice(codes))
        tally.judge("broken at half of 1", pool, [pool.half[code]], code)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=100, help="of each kind, shared by the airframes")
    parser.add_argument("--airframes", type=int, default=12)
    parser.add_argument("--pool", type=int, default=10, help="healthy flights of an airframe, 8 at least")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, signal.default_int_handler)  # a shell's background command ignores SIGINT
    seed, airframes, sets = arguments.seed, arguments.airframes, arguments.sets
    print(f"seed {seed}, {airframes} airframes, {sets} sets of each kind", flush=True)
    tally = Tally()
    with contextlib.suppress(KeyboardInterrupt):
        for number in range(airframes):
            share = sets * (number + 1) // airframes - sets * number // airframes
            judge_sets(pool_of(seed, number, arguments.pool), share, np.random.default_rng([seed, 1, number]), tally)
    tally.show()


if __name__ == "__main__":
    main()
