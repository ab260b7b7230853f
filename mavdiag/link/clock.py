"""One vehicle timeline from many counters: wraps undone, reboots bridged, two clocks laid over each other.

A vehicle stamps its messages with milliseconds or microseconds since boot, in 32 bits (which wrap after 49.7 days or
71.6 minutes) or 64, and some of them with microseconds of the unix epoch. The timeline is the clock of the first
stamped message; the other clock is laid over it by the least transport delay seen of each. How often a counter of
71.6 minutes had wrapped before its first message is told by the vehicle's other messages. The receiver's clock only
arbitrates: between a wrap and a reboot, and between the two clocks. It never adds its jitter to a stamp.

A stamp that is out of line (over a second old, or hours ahead) is no reboot while others go on: a second path may be
slower, and somebody may send old frames again. Such frames are left out. The vehicle starts anew when its old clock
has been silent: for a second if the new clock is no further than a reboot in that silence can have brought it, else for
ten. So reboots cannot be counted more often than once a second.

Everything is a value: state in, state out; cutting the samples into other pieces gives the same times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import BoolArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S, NS_PER_US

__all__ = [
    "MS_32",
    "US_32",
    "US_64",
    "ClockReading",
    "Counter",
    "Delay",
    "Run",
    "Timeline",
    "changed_clock",
    "place",
    "rebooted",
    "started_anew",
    "unwrap",
]

# Choices, not measurements: links reorder within less, vehicles take longer to boot, and no stream pauses so long.
LATE_NS = NS_PER_S  # a stamp may be this much older than the one before and still be a late frame
WRAP_SLACK_NS = 60 * NS_PER_S  # a wrap must agree with the receiver's clock this well, or it is a reboot
JUMP_SLACK_NS = 3600 * NS_PER_S  # beyond the receiver's clock by more: another clock, not a pause
SILENT_NS = NS_PER_S  # the vehicle's old clock must be silent for so long before a new one is a reboot
GONE_NS = 10 * NS_PER_S  # and for so long before any other clock is taken over
UPTIME_SLACK_NS = 10 * NS_PER_S  # how much older than that silence a vehicle may be that has rebooted in it
REBOOT_GAP_NS = NS_PER_S  # least time that a reboot takes on the timeline, so that nothing is joined across it
SETTLE_NS = 2 * NS_PER_S  # how long the delay of a clock is watched before a second clock is laid over the first

EPOCH_NS = 1_000_000_000 * NS_PER_S  # stamps from here on (year 2001) are unix time, earlier ones time since boot
HIGHEST_NS = (1 << 62) - 1  # year 2116: garbage beyond is held here, so that a stamp and an offset fit 64 bits


@dataclass(frozen=True, slots=True)
class Counter:
    """How a message counts time.

    tick_ns: one count [ns].
    turn: counts until it wraps, 0 for never.
    """

    tick_ns: int
    turn: int

    @property
    def ambiguous(self) -> bool:
        """Whether it wraps within a day, so that its first reading alone does not tell the time since boot."""
        return 0 < self.turn * self.tick_ns < 86_400 * NS_PER_S


MS_32 = Counter(NS_PER_MS, 1 << 32)  # time_boot_ms: wraps after 49.7 days
US_32 = Counter(NS_PER_US, 1 << 32)  # SERVO_OUTPUT_RAW.time_usec: wraps after 71.6 minutes
US_64 = Counter(NS_PER_US, 0)  # time_usec: since boot or since 1970


class ClockReading(NamedTuple):
    """Where one message's counter stands.

    raw: highest count so far, as sent.
    turns: how often it has wrapped.
    host_ns: when it was last received in line [ns].
    """

    raw: int
    turns: int
    host_ns: int


class Run(NamedTuple):
    """Samples of one message whose counter went on regularly.

    clock_ns: (n,) the message's own clock [ns], wraps undone.
    host_ns: (n,) when received [ns].
    latest_ns: the highest of clock_ns.
    on_epoch: they are unix time, rather than time since boot.
    reading: where the counter stands now.
    used: samples that were looked at, up to where the counter broke off.
    kept: (used,) which of them are in line and make the rows of clock_ns; None for all.
    ambiguous: its counter wraps often, so that going on is no proof that the vehicle did not start anew.
    """

    clock_ns: IntArray
    host_ns: IntArray
    latest_ns: int
    on_epoch: bool
    reading: ClockReading
    used: int
    kept: BoolArray | None = None
    ambiguous: bool = False


def unwrap(
    counter: Counter, last: ClockReading | None, raw: IntArray, host_ns: IntArray, since_boot_ns: int | None = None
) -> Run:
    """Undo the wraps of one message's counter, up to where it breaks off (maybe a reboot, or a change to unix time).

    raw, host_ns: (n,), n >= 1, in order of arrival.
    last: the reading after the samples before, None for the first.
    since_boot_ns: the vehicle's time since boot at the first sample, where `last` is None and it is known [ns].
    A stamp up to a second older than the highest is a late frame and keeps its place. One further out of line is left
    out, unless none has been in line for a second: there the run ends, for the caller to decide.
    """
    before = last or ClockReading(int(raw[0]), _turns(counter, int(raw[0]), since_boot_ns), int(host_ns[0]))
    first, final = int(raw[0]), int(raw[-1])
    ahead_ns = before.turns * counter.turn * counter.tick_ns
    start, end = before.raw * counter.tick_ns + ahead_ns, final * counter.tick_ns + ahead_ns
    on_epoch = start >= EPOCH_NS
    steady = 0 <= before.raw <= first and end - start < WRAP_SLACK_NS  # so that no single step can be out of bounds
    if steady and end <= HIGHEST_NS and on_epoch == (end >= EPOCH_NS) and _ascends(raw):
        clock_ns = raw * counter.tick_ns
        reading = ClockReading(final, before.turns, int(host_ns[-1]))
        return Run(
            clock_ns + ahead_ns if ahead_ns else clock_ns,
            host_ns,
            end,
            on_epoch,
            reading,
            len(raw),
            None,
            counter.ambiguous,
        )
    raw = np.clip(raw, 0, HIGHEST_NS // counter.tick_ns)
    if last is None:
        before = before._replace(raw=int(raw[0]))
    return _unwrap_step_by_step(counter, before, raw, host_ns)


def _turns(counter: Counter, raw: int, since_boot_ns: int | None) -> int:
    """How often a counter had wrapped at its first reading."""
    if since_boot_ns is None or not counter.ambiguous:
        return 0
    return max(0, round((since_boot_ns - raw * counter.tick_ns) / (counter.turn * counter.tick_ns)))


def _ascends(raw: IntArray) -> bool:
    return len(raw) == 1 or bool(np.logical_and.reduce(raw[1:] >= raw[:-1]))


def changed_clock(counter: Counter, last: ClockReading, raw: int) -> bool:
    """Whether a count that broke off went over from time since boot to unix time or back, which is no reboot."""
    return (last.raw * counter.tick_ns >= EPOCH_NS) != (raw * counter.tick_ns >= EPOCH_NS)


def started_anew(timeline: "Timeline", counter: Counter, raw: int, host_ns: int) -> bool:
    """Whether a stamp out of line, received at `host_ns`, is a vehicle that started anew; else it is a stray."""
    clock_ns = raw * counter.tick_ns
    silent_ns = host_ns - timeline.seen_ns[clock_ns >= EPOCH_NS]
    young = clock_ns <= silent_ns + UPTIME_SLACK_NS
    return silent_ns >= (SILENT_NS if young else GONE_NS)


def _unwrap_step_by_step(counter: Counter, before: ClockReading, raw: IntArray, host_ns: IntArray) -> Run:
    tick_ns, turn = counter.tick_ns, counter.turn
    high, turns, seen_ns = before
    on_epoch = (high + turns * turn) * tick_ns >= EPOCH_NS
    count, kept = np.zeros(len(raw), np.int64), np.ones(len(raw), np.bool_)
    used = len(raw)
    for k, (now, now_ns) in enumerate(zip(raw.tolist(), host_ns.tolist(), strict=True)):
        elapsed_ns = max(now_ns - seen_ns, 0)
        step = now - high
        if turn:
            shorter = (step + turn // 2) % turn - turn // 2  # the shorter way round
            step = shorter if abs(shorter * tick_ns - elapsed_ns) <= WRAP_SLACK_NS else step
        count[k] = high + turns * turn + step
        if (int(count[k]) * tick_ns >= EPOCH_NS) != on_epoch:
            used = k
            break
        if step * tick_ns < -LATE_NS or step * tick_ns - elapsed_ns > JUMP_SLACK_NS:
            if elapsed_ns >= SILENT_NS:
                used = k
                break
            kept[k] = False
            continue
        seen_ns = now_ns
        if step > 0:
            turns += (high + step - now) // turn if turn else 0
            high = now
    inline = kept[:used]
    clock_ns = count[:used][inline] * tick_ns
    latest_ns = int(clock_ns.max()) if len(clock_ns) else 0
    reading = ClockReading(high, turns, seen_ns)
    kept_rows = None if inline.all() else inline
    return Run(clock_ns, host_ns[:used][inline], latest_ns, on_epoch, reading, used, kept_rows, counter.ambiguous)


@dataclass(frozen=True, slots=True)
class Delay:
    """How far the receiver's clock is ahead of one of the vehicle's.

    first_host_ns: since when it is watched [ns].
    least_ns: least lead so far [ns].
    """

    first_host_ns: int
    least_ns: int

    @property
    def settled_ns(self) -> int:
        """Receiver's time from which on the delay is known and stays as it is."""
        return self.first_host_ns + SETTLE_NS


@dataclass(frozen=True, slots=True)
class Timeline:
    """Where one vehicle's time stands.

    on_epoch: whether the reference clock is unix time; None before the first stamp.
    base_ns: what to add to it [ns].
    delays: of the clock since boot and of unix time.
    t_ns: latest time known [ns], None before the first stamp.
    host_ns: when the last stamp was received [ns].
    seen_ns: when the last stamp in line was, of the clock since boot and of unix time [ns].
    reboots: how often the vehicle started anew.
    """

    on_epoch: bool | None = None
    base_ns: int = 0
    delays: tuple[Delay | None, Delay | None] = (None, None)
    t_ns: int | None = None
    host_ns: int = 0
    seen_ns: tuple[int, int] = (0, 0)
    reboots: int = 0

    def since_boot_ns(self, host_ns: int) -> int | None:
        """The vehicle's time since boot at the receiver's time, to a few milliseconds; None if it is not known."""
        boot = self.delays[0]
        return None if boot is None else host_ns - boot.least_ns


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
    received_ns, known_ns, seen_ns = timeline.host_ns, timeline.t_ns, list(timeline.seen_ns)
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
        if not run.ambiguous:
            seen_ns[run.on_epoch] = max(seen_ns[run.on_epoch], run.reading.host_ns)
        times.append(t_ns)
    seen, delays = (seen_ns[0], seen_ns[1]), (boot, epoch)
    return replace(timeline, delays=delays, t_ns=known_ns, host_ns=received_ns, seen_ns=seen), times


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
