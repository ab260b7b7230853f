"""Hostile datagrams beside a genuine vehicle: nothing may raise, nobody may be alarmed, memory may not grow.

    PYTHONPATH=tests python fuzz/datagrams.py [--count 10000000] [--seed 7] [--spoof]

A third of the datagrams are random bytes; a third are genuine or made frames cut, joined, repeated or changed in some
bytes; a third are frames with a valid checksum of every message that is read and of some that are not, with random and
with small payloads, of any system and component but the vehicle's own autopilot. The genuine vehicle flies on among
them and is judged by its baseline; `--vehicle 1` is chosen, as docs/operating.md advises on a link that others reach.
With --spoof the frames are also in the autopilot's own name: unsigned, these can lie, so only "no crash" is asserted.
"""

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from made_session import baseline_for
from made_vehicle import RATE_HZ, START_NS, TICK_S, MadeVehicle

from detector.config import SessionSettings
from detector.fleet import Fleet
from detector.states import State
from detector.values import EventOpened, SendText, SessionSpec
from mavdiag.link.codec import Encoder, layout_of
from mavdiag.link.datagrams import as_columns
from mavdiag.link.messages import MessageId, Severity
from mavdiag.link.samples import SOURCES
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S

__all__ = ["Found", "fuzzed"]

VEHICLE = 1
A_TICK = 600  # hostile datagrams in one look at the link
WARM = 0.1  # of the run, before which memory is not compared: tables of senders fill
AUTOPILOT = (VEHICLE, 1)
IDS = sorted(
    {int(one) for one in MessageId} | {source.message for source in SOURCES} | {66, 69, 70, 84, 147, 263, 12901}
)


@dataclass(frozen=True, slots=True)
class Found:
    """What a run gave. growth_mb: of the resident memory since the warm-up; vehicles: that were let in."""

    fed: int
    alerts: tuple[str, ...]
    events: int
    state: State
    judged_s: float
    flown_s: float
    vehicles: int
    growth_mb: float


class Source:
    """Makes hostile datagrams from a seed."""

    def __init__(self, seed: int, spoof: bool) -> None:
        self._rng, self._spoof = np.random.default_rng(seed), spoof
        blank = Encoder(1, 1)
        self._sizes = {msgid: layout_of(msgid).packer.size for msgid in IDS}
        self._seen = [blank.encode_payload(msgid, b"\0") for msgid in IDS]

    def datagrams(self, count: int, genuine: list[bytes]) -> Iterator[bytes]:
        """So many, some of them made of these genuine frames."""
        rng = self._rng
        noise, at = rng.bytes(300 * count + 600), 0
        kinds, lengths = rng.integers(0, 3, count).tolist(), rng.integers(0, 300, (count, 4)).tolist()
        senders = rng.integers(1, 256, (count, 2)).tolist()
        for kind, (a, b, c, d), (system, component) in zip(kinds, lengths, senders, strict=True):
            at += 300
            if kind == 0:
                yield noise[at : at + a]
            elif kind == 1:
                pool = genuine if a % 2 and genuine else self._seen
                yield self._mutated(pool[b % len(pool)], pool[c % len(pool)], noise[at : at + d], c)
            else:
                yield self._valid(IDS[a % len(IDS)], system, component, noise[at : at + 300], b)

    def _mutated(self, one: bytes, other: bytes, noise: bytes, how: int) -> bytes:
        place = how % len(one)
        match how % 5:
            case 0:
                return one[:place]
            case 1:
                return noise + one[place:] + other
            case 2:
                return one[:place] + other[place:]
            case 3:
                return one[:place] + bytes([one[place] ^ (1 + how % 255)]) + one[place + 1 :]
            case _:
                return one[:place] + noise + other

    def _valid(self, msgid: int, system: int, component: int, noise: bytes, how: int) -> bytes:
        if not self._spoof and (system, component) == AUTOPILOT:
            component = 2
        if how % 3 == 0:
            system = VEHICLE
            component = 1 if self._spoof else max(2, component)
        size = self._sizes[msgid]
        payload = noise[:size] if how % 2 else bytes(one if k % 4 == 0 else 0 for k, one in enumerate(noise[:size]))
        frame = Encoder(system, component).encode_payload(msgid, payload)
        self._seen[how % len(self._seen)] = frame
        return frame


def fuzzed(count: int, seed: int, spoof: bool = False, progress: float = 0.0, a_tick: int = A_TICK) -> Found:
    """Feed so many hostile datagrams beside a genuine vehicle, so many in each look at the link.

    progress: seconds between two lines; 0 for none.
    """
    settings = SessionSettings(negotiate=False)
    fleet = Fleet(
        lambda sysid, profile: SessionSpec(profile, baseline_for(), settings),
        profile=None,
        only=VEHICLE,
        datagrams=True,
    )
    source, vehicle, now_ns = Source(seed, spoof), MadeVehicle(VEHICLE), START_NS
    alerts, events, fed, warm_mb, flown_s = list[str](), 0, 0, 0.0, 0.0
    told_at = time.monotonic()
    while fed < count:
        now_ns += round(TICK_S * NS_PER_S)
        flown_s += TICK_S
        genuine = vehicle.samples(round(TICK_S * RATE_HZ))
        hostile = list(source.datagrams(min(a_tick, count - fed), genuine))
        between = max(1, len(hostile) // len(genuine))
        mixed = [one for k, frame in enumerate(genuine) for one in (frame, *hostile[k * between : (k + 1) * between])]
        mixed += hostile[len(genuine) * between :]
        fleet.take(as_columns([(data, now_ns) for data in mixed]), Instant(now_ns))
        for turn in fleet.judge(Instant(now_ns)):
            for effect in turn.effects:
                events += isinstance(effect, EventOpened)
                if isinstance(effect, SendText) and effect.severity <= Severity.WARNING:
                    alerts.append(f"{flown_s:.0f} s: {effect.text}")
        fed += len(hostile)
        if not warm_mb and fed >= WARM * count:
            warm_mb = resident_mb()
        if progress and time.monotonic() - told_at > progress:
            told_at = time.monotonic()
            print(f"{fed} fed, {resident_mb():.1f} MB, {len(alerts)} alerts", flush=True)
    session = fleet.vehicles[VEHICLE].session if VEHICLE in fleet.vehicles else None
    state = State.WAITING if session is None else session.state
    judged_s = session.judge.judged_s if session is not None and session.judge is not None else 0.0
    growth_mb = resident_mb() - warm_mb
    return Found(fed, tuple(alerts), events, state, judged_s, flown_s, len(fleet.vehicles), growth_mb)


def resident_mb() -> float:
    """Resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Run it and print what came of it; the exit code is 1 if it was not held."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--spoof", action="store_true")
    options = parser.parse_args()
    found = fuzzed(options.count, options.seed, options.spoof, progress=60.0)
    print(f"seed {options.seed}: {found.fed} datagrams, {len(found.alerts)} alerts {sorted(set(found.alerts))[:5]}")
    print(f"{found.events} events, state {found.state}, {found.judged_s:.0f} of {found.flown_s:.0f} s judged")
    print(f"{found.vehicles} vehicles let in, memory grew by {found.growth_mb:.1f} MB")
    held = options.spoof or not (found.alerts or found.events or found.growth_mb >= 5.0)
    raise SystemExit(0 if held else 1)


if __name__ == "__main__":
    main()
