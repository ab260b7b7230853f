"""The counters of a vehicle's messages: wraps undone, late frames kept, strays left out.

A vehicle stamps its messages with milliseconds or microseconds since boot, in 32 bits (which wrap after 49.7 days or
71.6 minutes) or 64, and some of them with microseconds of the unix epoch. How often a counter of 71.6 minutes had
wrapped before its first message follows from the vehicle's other messages. The receiver's clock only decides between a
wrap, a reboot and a leap; it never adds its jitter to a stamp.

A stamp that leaps ahead of all that the receiver's clock explains is left out until others follow it: a forged or
damaged frame must not make the genuine ones old.

Everything is a value: state in, state out; cutting the samples into other pieces gives the same times.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mavdiag.telemetry import BoolArray, IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S, NS_PER_US

__all__ = [
    "MS_32",
    "US_32",
    "US_64",
    "Clock",
    "ClockReading",
    "Counter",
    "Run",
    "changed_clock",
    "unwrap",
]

# Choices, not measurements: links reorder within less, vehicles take longer to boot, and no stream pauses so long.
LATE_NS = NS_PER_S  # a stamp may be this much older than the one before and still be a late frame
WRAP_SLACK_NS = 60 * NS_PER_S  # a wrap must agree with the receiver's clock this well, or it is a reboot
JUMP_SLACK_NS = 3600 * NS_PER_S  # beyond the receiver's clock by more: another clock, not a pause
SILENT_NS = NS_PER_S  # the vehicle's old clock must be silent for so long before a new one is a reboot
LEAP_NS = NS_PER_S // 5  # a stamp so far ahead of the line leaps: links bunch the samples of a stream by less
AGREEING = 3  # samples in a row that must agree on a new clock before it is followed
DRIFT_SHIFT = 11  # the line gives way by one part in 2^11 of the time, ten times the drift of a plain quartz

EPOCH_NS = 1_000_000_000 * NS_PER_S  # stamps from here on (year 2001) are unix time, earlier ones time since boot
HIGHEST_NS = (1 << 62) - 1  # year 2116: garbage beyond is held here, so that a stamp and an offset fit 64 bits


class Clock(IntEnum):
    """The clocks that a vehicle's messages may be stamped on."""

    BOOT_MS = 0  # milliseconds since boot, 32 bits
    BOOT_US = 1  # microseconds since boot, 64 bits
    BOOT_US_32 = 2  # microseconds since boot, 32 bits
    UNIX = 3  # microseconds since 1970


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
        """Whether it wraps within a day, so that its first reading alone does not give the time since boot."""
        return 0 < self.turn * self.tick_ns < 86_400 * NS_PER_S

    def clock(self, on_epoch: bool) -> Clock:
        """The clock that it counts. on_epoch: it shows unix time."""
        if on_epoch:
            return Clock.UNIX
        if self.ambiguous:
            return Clock.BOOT_US_32
        return Clock.BOOT_MS if self.tick_ns == NS_PER_MS else Clock.BOOT_US


MS_32 = Counter(NS_PER_MS, 1 << 32)  # time_boot_ms: wraps after 49.7 days
US_32 = Counter(NS_PER_US, 1 << 32)  # SERVO_OUTPUT_RAW.time_usec: wraps after 71.6 minutes
US_64 = Counter(NS_PER_US, 0)  # time_usec: since boot or since 1970


class Rival(NamedTuple):
    """Another clock than the one followed, which the latest samples show.

    clock_ns: what the latest of them shows [ns].
    host_ns: when it was received [ns].
    frames: how many in a row agree on it.
    """

    clock_ns: int
    host_ns: int
    frames: int = 1


class ClockReading(NamedTuple):
    """Where one message's counter stands.

    raw: highest count so far, as sent.
    turns: how often it has wrapped.
    host_ns: when it was last received in line [ns].
    line_ns: the most that it was ahead of the receiver's clock, which drift takes back slowly [ns].
    rival: samples in a row that leap and agree; None if the latest one did not leap.
    """

    raw: int
    turns: int
    host_ns: int
    line_ns: int
    rival: Rival | None = None


class Run(NamedTuple):
    """Samples of one message whose counter went on regularly.

    clock_ns: (n,) the message's own clock [ns], wraps undone.
    host_ns: (n,) when received [ns].
    latest_ns: the highest of clock_ns.
    clock: which clock it is.
    reading: where the counter stands now.
    used: samples that were looked at, up to where the counter broke off.
    kept: (used,) which of them are in line and make the rows of clock_ns; None for all.
    leaps: how many of them were left out because their stamps leap.
    """

    clock_ns: IntArray
    host_ns: IntArray
    latest_ns: int
    clock: Clock
    reading: ClockReading
    used: int
    kept: BoolArray | None = None
    leaps: int = 0

    @property
    def on_epoch(self) -> bool:
        """They are unix time, rather than time since boot."""
        return self.clock is Clock.UNIX

    @property
    def ambiguous(self) -> bool:
        """Its counter wraps often, so that going on is no proof that the vehicle did not start anew."""
        return self.clock is Clock.BOOT_US_32


def unwrap(
    counter: Counter,
    last: ClockReading | None,
    raw: IntArray,
    host_ns: IntArray,
    since_boot_ns: int | None = None,
    lead_ns: int | None = None,
) -> Run:
    """Undo the wraps of one message's counter, up to where it breaks off (maybe a reboot, or a change to unix time).

    raw, host_ns: (n,), n >= 1, in order of arrival.
    last: the reading after the samples before, None for the first.
    since_boot_ns: the vehicle's time since boot at the first sample, where `last` is None and it is known [ns].
    lead_ns: how far the receiver's clock leads the message's, where other messages have shown it [ns].
    A stamp up to a second older than the highest is a late frame and keeps its place. One further out of line is left
    out, unless none has been in line for a second: there the run ends, for the caller to decide. A stamp that leaps is
    left out, unless none has been in line for a second and three in a row agree.
    """
    before = last or _first_reading(counter, raw, host_ns, since_boot_ns, lead_ns)
    first, final = int(raw[0]), int(raw[-1])
    ahead_ns = before.turns * counter.turn * counter.tick_ns
    start, end = before.raw * counter.tick_ns + ahead_ns, final * counter.tick_ns + ahead_ns
    on_epoch = start >= EPOCH_NS
    regular = 0 <= before.raw <= first and end <= HIGHEST_NS and on_epoch == (end >= EPOCH_NS)
    if regular and (_ascends(raw) if end - start < WRAP_SLACK_NS else _steady(raw, before.raw, counter.tick_ns)):
        clock_ns = raw * counter.tick_ns
        clock_ns = clock_ns + ahead_ns if ahead_ns else clock_ns
        line_ns = max(before.line_ns, int((clock_ns - _receiver(host_ns)).max()))
        if line_ns - before.line_ns <= LEAP_NS or not _leaps(before, start, clock_ns, host_ns):
            reading = ClockReading(final, before.turns, int(host_ns[-1]), line_ns)
            return Run(clock_ns, host_ns, end, counter.clock(on_epoch), reading, len(raw))
    raw = np.clip(raw, 0, HIGHEST_NS // counter.tick_ns)
    if last is None and before.raw == first:
        before = before._replace(raw=int(raw[0]))
    return _unwrap_step_by_step(counter, before, raw, host_ns)


def _first_reading(
    counter: Counter, raw: IntArray, host_ns: IntArray, since_boot_ns: int | None, lead_ns: int | None
) -> ClockReading:
    """Where a counter stood before its first sample: there, unless it is ahead of what other messages show."""
    first, received_ns = int(raw[0]), int(host_ns[0])
    clock_ns = first * counter.tick_ns
    if lead_ns is not None and not counter.ambiguous and clock_ns - (received_ns - lead_ns) > LATE_NS:
        clock_ns = max(0, received_ns - lead_ns)
        first = clock_ns // counter.tick_ns
    turns = _turns(counter, first, since_boot_ns)
    clock_ns = min(clock_ns + turns * counter.turn * counter.tick_ns, HIGHEST_NS)
    return ClockReading(first, turns, received_ns, clock_ns - received_ns + (received_ns >> DRIFT_SHIFT))


def _receiver(host_ns: IntArray) -> IntArray:
    """The receiver's clock, slowed by as much as the line gives way."""
    return host_ns - (host_ns >> DRIFT_SHIFT)


def _leaps(before: ClockReading, start_ns: int, clock_ns: IntArray, host_ns: IntArray) -> bool:
    """Whether a stamp of a regular run may leap: ahead of the line and of the sample before it."""
    steps = np.diff(clock_ns, prepend=start_ns) - np.maximum(np.diff(host_ns, prepend=before.host_ns), 0)
    if steps.max() <= LEAP_NS:
        return False
    ahead = clock_ns - _receiver(host_ns)
    line = np.maximum.accumulate(np.concatenate(([before.line_ns], ahead)))[:-1]
    return bool(((ahead - line > LEAP_NS) & (steps > LEAP_NS)).any())


def _turns(counter: Counter, raw: int, since_boot_ns: int | None) -> int:
    """How often a counter had wrapped at its first reading."""
    if since_boot_ns is None or not counter.ambiguous:
        return 0
    return max(0, round((since_boot_ns - raw * counter.tick_ns) / (counter.turn * counter.tick_ns)))


def _ascends(raw: IntArray) -> bool:
    return len(raw) == 1 or bool(np.logical_and.reduce(raw[1:] >= raw[:-1]))


def _steady(raw: IntArray, before: int, tick_ns: int) -> bool:
    """Whether no count is below the one before, and no step can be a wrap or out of bounds."""
    steps = np.diff(raw, prepend=before)
    return int(steps.min()) >= 0 and int(steps.max()) * tick_ns < WRAP_SLACK_NS


def changed_clock(counter: Counter, last: ClockReading, raw: int) -> bool:
    """Whether a count that broke off went over from time since boot to unix time or back, which is no reboot."""
    return (last.raw * counter.tick_ns >= EPOCH_NS) != (raw * counter.tick_ns >= EPOCH_NS)


def _unwrap_step_by_step(counter: Counter, before: ClockReading, raw: IntArray, host_ns: IntArray) -> Run:
    tick_ns, turn = counter.tick_ns, counter.turn
    high, turns, seen_ns, line_ns, rival = before
    on_epoch = (high + turns * turn) * tick_ns >= EPOCH_NS
    count, kept = np.zeros(len(raw), np.int64), np.ones(len(raw), np.bool_)
    used, leaps = len(raw), 0
    for k, (now, now_ns) in enumerate(zip(raw.tolist(), host_ns.tolist(), strict=True)):
        elapsed_ns = max(now_ns - seen_ns, 0)
        step = now - high
        if turn:
            shorter = (step + turn // 2) % turn - turn // 2  # the shorter way round
            step = shorter if abs(shorter * tick_ns - elapsed_ns) <= WRAP_SLACK_NS else step
        count[k] = high + turns * turn + step
        clock_ns = int(count[k]) * tick_ns
        if (clock_ns >= EPOCH_NS) != on_epoch:
            used = k
            break
        ahead_ns = clock_ns - now_ns + (now_ns >> DRIFT_SHIFT)
        beyond_ns = step * tick_ns - elapsed_ns  # of what the receiver's clock explains
        if beyond_ns > LEAP_NS and ahead_ns - line_ns > LEAP_NS:
            rival = _agreeing(rival, clock_ns, now_ns)
            if beyond_ns > JUMP_SLACK_NS and elapsed_ns >= SILENT_NS:
                used = k
                break
            if beyond_ns > JUMP_SLACK_NS or rival.frames < AGREEING or elapsed_ns < SILENT_NS:
                kept[k], leaps = False, leaps + 1
                continue
        elif step * tick_ns < -LATE_NS:
            if elapsed_ns >= SILENT_NS:
                used = k
                break
            kept[k] = False
            continue
        seen_ns, line_ns, rival = now_ns, max(line_ns, ahead_ns), None
        if step > 0:
            turns += (high + step - now) // turn if turn else 0
            high = now
    inline = kept[:used]
    clock = count[:used][inline] * tick_ns
    latest_ns = int(clock.max()) if len(clock) else 0
    reading = ClockReading(high, turns, seen_ns, line_ns, rival)
    kept_rows = None if inline.all() else inline
    return Run(clock, host_ns[:used][inline], latest_ns, counter.clock(on_epoch), reading, used, kept_rows, leaps)


def _agreeing(rival: Rival | None, clock_ns: int, host_ns: int) -> Rival:
    """The clock that a sample that leaps shows, with the samples in a row that agree on it."""
    if rival is not None:
        advance_ns = clock_ns - rival.clock_ns
        if advance_ns > 0 and abs(advance_ns - (host_ns - rival.host_ns)) <= LATE_NS:
            return Rival(clock_ns, host_ns, rival.frames + 1)
    return Rival(clock_ns, host_ns)
