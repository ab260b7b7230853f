"""One vehicle timeline from many counters: wraps undone, reboots bridged, two clocks laid over each other.

A vehicle stamps its messages with milliseconds or microseconds since boot, in 32 bits (which wrap after 49.7 days or
71.6 minutes) or 64, and some of them with microseconds of the unix epoch. The timeline is the clock of the first
stamped message; the other clock is laid over it by the least transport delay seen of each. The receiver's clock only
arbitrates: between a wrap and a reboot, and between the two clocks. It never adds its jitter to a stamp.

Everything is a value: state in, state out; cutting the samples into other pieces gives the same times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import NS_PER_S, IntArray

__all__ = [
    "MS_32",
    "US_32",
    "US_64",
    "Counter",
    "Delay",
    "Reading",
    "Run",
    "Timeline",
    "changed_clock",
    "place",
    "rebooted",
    "unwrap",
]

# Choices, not measurements: links reorder within less, vehicles take longer to boot, and no stream pauses so long.
LATE_NS = NS_PER_S  # a stamp may be this much older than the one before and still be a late frame
WRAP_SLACK_NS = 60 * NS_PER_S  # a wrap must agree with the receiver's clock this well, or it is a reboot
JUMP_SLACK_NS = 3600 * NS_PER_S  # beyond the receiver's clock by more: another clock, not a pause
REBOOT_GAP_NS = NS_PER_S  # least time that a reboot takes on the timeline, so that nothing is joined across it
SETTLE_NS = 2 * NS_PER_S  # how long the delay of a clock is watched before a second clock is laid over the first

EPOCH_NS = 1_000_000_000 * NS_PER_S  # stamps from here on (year 2001) are unix time, earlier ones time since boot
HIGHEST_NS = (1 << 62) - 1  # year 2116: garbage beyond is held here, so that a stamp and an offset fit 64 bits


@dataclass(frozen=True, slots=True)
class Counter:
    """How a message counts time. tick_ns: one count [ns]; turn: counts until it wraps, 0 for never."""

    tick_ns: int
    turn: int


MS_32 = Counter(1_000_000, 1 << 32)  # time_boot_ms: wraps after 49.7 days
US_32 = Counter(1_000, 1 << 32)  # SERVO_OUTPUT_RAW.time_usec: wraps after 71.6 minutes
US_64 = Counter(1_000, 0)  # time_usec: since boot or since 1970


class Reading(NamedTuple):
    """Where one message's counter stood last. raw: the count as sent; turns: how often it has wrapped."""

    raw: int
    turns: int
    host_ns: int


class Run(NamedTuple):
    """Samples of one message whose counter went on regularly.

    clock_ns: (n,) the message's own clock [ns], wraps undone; host_ns: (n,) when received [ns]. latest_ns: the highest
    of clock_ns. on_epoch: they are unix time, rather than time since boot. reading: where the counter stands now.
    """

    clock_ns: IntArray
    host_ns: IntArray
    latest_ns: int
    on_epoch: bool
    reading: Reading


def unwrap(counter: Counter, last: Reading | None, raw: IntArray, host_ns: IntArray) -> Run:
    """Undo the wraps of one message's counter, up to where it breaks off (a reboot, or a change to unix time).

    raw, host_ns: (n,), n >= 1, in order of arrival. last: the reading after the samples before, None for the first.
    A stamp up to a second older than the one before is a late frame and keeps its place. The run returned has fewer
    samples than were given if the counter broke off; it may have none.
    """
    first, final = int(raw[0]), int(raw[-1])
    since, turns = (first, 0) if last is None else (last.raw, last.turns)
    ahead_ns = turns * counter.turn * counter.tick_ns
    start, end = since * counter.tick_ns + ahead_ns, final * counter.tick_ns + ahead_ns
    on_epoch = start >= EPOCH_NS
    steady = 0 <= since <= first and end - start < WRAP_SLACK_NS  # so that no single step can be out of bounds
    if steady and end <= HIGHEST_NS and on_epoch == (end >= EPOCH_NS) and _ascends(raw):
        clock_ns = raw * counter.tick_ns
        reading = Reading(final, turns, int(host_ns[-1]))
        return Run(clock_ns + ahead_ns if ahead_ns else clock_ns, host_ns, end, on_epoch, reading)
    return _unwrap_step_by_step(counter, last, np.clip(raw, 0, HIGHEST_NS // counter.tick_ns), host_ns)


def _ascends(raw: IntArray) -> bool:
    return len(raw) == 1 or bool(np.logical_and.reduce(raw[1:] >= raw[:-1]))


def changed_clock(counter: Counter, last: Reading, raw: int) -> bool:
    """Whether a count that broke off went over from time since boot to unix time or back, which is no reboot."""
    return (last.raw * counter.tick_ns >= EPOCH_NS) != (raw * counter.tick_ns >= EPOCH_NS)


def _unwrap_step_by_step(counter: Counter, last: Reading | None, raw: IntArray, host_ns: IntArray) -> Run:
    before = last or Reading(int(raw[0]), 0, int(host_ns[0]))
    start = before.raw + before.turns * counter.turn
    plain = np.diff(raw, prepend=before.raw)
    half = counter.turn // 2
    step = (plain + half) % counter.turn - half if counter.turn else plain  # the shorter way round
    count = start + np.cumsum(step)
    clock_ns = count * counter.tick_ns
    unexplained_ns = step * counter.tick_ns - np.diff(host_ns, prepend=before.host_ns)
    slack_ns = np.where(step == plain, JUMP_SLACK_NS, WRAP_SLACK_NS)
    epoch = clock_ns >= EPOCH_NS
    on_epoch = start * counter.tick_ns >= EPOCH_NS
    broken = (step * counter.tick_ns < -LATE_NS) | (unexplained_ns > slack_ns) | (epoch != on_epoch)
    n = int(np.argmax(broken)) if broken.any() else len(raw)
    if n == 0:
        return Run(clock_ns[:0], host_ns[:0], 0, on_epoch, before)
    turns = (int(count[n - 1]) - int(raw[n - 1])) // counter.turn if counter.turn else 0
    reading = Reading(int(raw[n - 1]), turns, int(host_ns[n - 1]))
    return Run(clock_ns[:n], host_ns[:n], int(clock_ns[:n].max()), on_epoch, reading)


@dataclass(frozen=True, slots=True)
class Delay:
    """How far the receiver's clock is ahead of one of the vehicle's, at least [ns], watched since first_host_ns."""

    first_host_ns: int
    least_ns: int

    @property
    def settled_ns(self) -> int:
        """Receiver's time from which on the delay is known and stays as it is."""
        return self.first_host_ns + SETTLE_NS


@dataclass(frozen=True, slots=True)
class Timeline:
    """Where one vehicle's time stands.

    on_epoch: whether the reference clock is unix time; None before the first stamp. base_ns: what to add to it [ns].
    delays: of the clock since boot and of unix time. t_ns: the latest time known [ns], None before the first stamp;
    host_ns: when that was received. reboots: how often the vehicle started anew.
    """

    on_epoch: bool | None = None
    base_ns: int = 0
    delays: tuple[Delay | None, Delay | None] = (None, None)
    t_ns: int | None = None
    host_ns: int = 0
    reboots: int = 0


def rebooted(timeline: Timeline) -> Timeline:
    """The vehicle starts anew: its clocks are new, and its time goes on with the receiver's, by a second at least."""
    return Timeline(t_ns=timeline.t_ns, host_ns=timeline.host_ns, reboots=timeline.reboots + 1)


def place(timeline: Timeline, runs: Sequence[Run]) -> tuple[Timeline, list[IntArray]]:
    """Give the samples of several messages their vehicle time.

    runs: none empty, and of a fresh timeline the first one to arrive first. Returns the vehicle times of each run [ns];
    where the other clock is not laid over the first yet (two seconds), the leading samples have none and are left out.
    """
    if timeline.on_epoch is None:
        timeline = _begun(timeline, runs[0])
    boot, epoch = timeline.delays
    received_ns, known_ns = timeline.host_ns, timeline.t_ns
    boot = _watched(boot, runs, received_ns, on_epoch=False)
    epoch = _watched(epoch, runs, received_ns, on_epoch=True)
    lag_ns = epoch.least_ns - boot.least_ns if boot and epoch else 0
    times = []
    for run in runs:
        t_ns, offset_ns = run.clock_ns, timeline.base_ns
        if run.on_epoch != timeline.on_epoch:
            offset_ns += lag_ns if run.on_epoch else -lag_ns
            t_ns = t_ns[_unsettled(boot, epoch, run) :]
        if offset_ns:
            offset_ns = min(max(offset_ns, -HIGHEST_NS), HIGHEST_NS)
            t_ns = t_ns + offset_ns
        if len(t_ns) and (known_ns is None or run.latest_ns + offset_ns > known_ns):
            known_ns = run.latest_ns + offset_ns
        received_ns = max(received_ns, run.reading.host_ns)
        times.append(t_ns)
    return Timeline(timeline.on_epoch, timeline.base_ns, (boot, epoch), known_ns, received_ns, timeline.reboots), times


def _begun(timeline: Timeline, first: Run) -> Timeline:
    if timeline.t_ns is None:
        return replace(timeline, on_epoch=first.on_epoch)
    resume_ns = timeline.t_ns + max(int(first.host_ns[0]) - timeline.host_ns, REBOOT_GAP_NS)
    return replace(timeline, on_epoch=first.on_epoch, base_ns=resume_ns - int(first.clock_ns[0]))


def _watched(delay: Delay | None, runs: Sequence[Run], received_ns: int, *, on_epoch: bool) -> Delay | None:
    """The least delay of one clock, with these runs; once settled it stays."""
    if delay is not None and received_ns >= delay.settled_ns:
        return delay
    own = [run for run in runs if run.on_epoch == on_epoch]
    if not own:
        return delay
    first_ns = min(int(run.host_ns[0]) for run in own) if delay is None else delay.first_host_ns
    least_ns = HIGHEST_NS if delay is None else delay.least_ns
    for run in own:
        early = run.host_ns < first_ns + SETTLE_NS
        if early[0]:
            least_ns = min(least_ns, int((run.host_ns - run.clock_ns)[early].min()))
    return Delay(first_ns, least_ns)


def _unsettled(boot: Delay | None, epoch: Delay | None, run: Run) -> int:
    """How many of the run's samples came before both clocks were known."""
    if boot is None or epoch is None:
        return len(run.clock_ns)
    return int(np.searchsorted(run.host_ns, max(boot.settled_ns, epoch.settled_ns)))
