"""One vehicle's time from the counters of its messages, frame by frame: wraps, late frames, leaps, reboots, drift.

Counters are milliseconds or microseconds since boot, in 32 bits (a turn is 49.7 days or 71.6 minutes) or 64, or
microseconds since 1970. The receiver's clock decides between a wrap, a reboot and a leap; it never adds its jitter to a
stamp. What is out of line is left out until others follow it. A clock that is set back repeats stamps; once it passes
the highest one again the receiver's clock shows how much time was lost, and what follows is a piece of its own. All of
the stamps must show it, and more of it than late frames of this link usually do: of a burst that a link delays and
reorders, those that come last are hardly late.

Clocks. The first stamped message's clock is the timeline; the others are laid over it. A message stamped c arrives at
h = c + origin + delay, delay >= 0: the least h - c of a window, the clock's lead, is its origin to within the least
delay, and the difference of two leads is the offset of two clocks. The window slides by whole seconds of the receiver's
clock; within a second the offset goes on a straight line. Clocks since boot that begin together count as one until
their leads have moved apart.

TIMESYNC (https://mavlink.io/en/services/timesync.html) is answered and asked; what it tells is shown and not used.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import inline, jit
from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component, MessageId
from mavdiag.units import NS_PER_MS, NS_PER_S, NS_PER_US

# Choices, not measurements, but for the drift of quartz.
LATE_NS = NS_PER_S  # a stamp may be this much older than the one before and still be a late frame
WRAP_SLACK_NS = 60 * NS_PER_S  # a wrap must agree with the receiver's clock this well, or it is a reboot
JUMP_SLACK_NS = 3600 * NS_PER_S  # beyond the receiver's clock by more: another clock, not a pause
SILENT_NS = NS_PER_S  # the vehicle's old clock must be silent for so long before a new one is a reboot
LEAPS = 3  # stamps that leap before they are told: one is a damaged frame (our choice)
LEAP_NS = NS_PER_S // 5  # a stamp so far ahead of the line leaps: links bunch the samples of a stream by less
AGREEING = 3  # samples in a row that must agree on a new clock before it is followed
DRIFT_SHIFT = 11  # the line gives way by one part in 2^11 of the time, ten times the drift of a plain quartz
GONE_NS = 10 * NS_PER_S  # how long the old clock must be silent before a clock that no reboot explains takes over
UPTIME_SLACK_NS = 10 * NS_PER_S  # how much older than that silence a vehicle may be that has rebooted in it
BACK_NS = 40 * NS_PER_MS  # time that is lost where a clock is set back: rows bridge less, and reordering takes less
CALMED_SHIFT = 9  # what a link's late frames seem to lose is forgotten by one part in 2^9 of the time (our choice)
AGREED_STEP_NS = 2 * NS_PER_MS  # by at least so much: messages of one instant are rounded differently
REBOOT_GAP_NS = NS_PER_S  # least time that a reboot takes on the timeline, so that nothing is joined across it
WINDOW = 10  # seconds over which the least lead is taken: 1000 samples at 100 Hz, and 0.5 ms of drift at 50 ppm
SLEW_NS = NS_PER_S // 2000  # by how much an offset changes in a second at most: ten times the drift of a plain quartz
TOGETHER_NS = NS_PER_S  # clocks since boot that begin nearer to each other than this are one
APART_NS = 20 * NS_PER_MS  # so far one clock may seem to move against itself, as the delays of messages change
SET_NS = 100 * NS_PER_MS  # a change of more is no drift: somebody has set a clock
STEPPED = 3  # seconds in a row that must show it

EPOCH_NS = 1_000_000_000 * NS_PER_S  # stamps from here on (year 2001) are unix time, earlier ones time since boot
HIGHEST_NS = (1 << 62) - 1  # year 2116: garbage beyond is held here, so that a stamp and an offset fit 64 bits
NEVER = -(1 << 62)  # stands for "no time known" [ns]
REBOOT = NEVER - 1  # stands for "the vehicle has started anew", or its clock was set back
MESSAGES_MAX = 32  # that are stamped, of one vehicle: there are 18
SECONDS = WINDOW + 3  # of leads that there is room for: a window with both its ends, and one more
_DAY_NS = 86_400 * NS_PER_S
# The clocks that a vehicle's messages may be stamped on: milliseconds since boot in 32 bits, microseconds since boot in
# 64 bits and in 32, microseconds since 1970.
_BOOT_MS, _BOOT_US, _BOOT_US_32, _UNIX = range(CLOCKS := 4)


@dataclass(frozen=True, slots=True)
class Counter:
    """How a message counts time. tick_ns: one count [ns]. turn: counts until it wraps, 0 for never."""

    tick_ns: int
    turn: int


MS_32 = Counter(NS_PER_MS, 1 << 32)  # time_boot_ms
US_32 = Counter(NS_PER_US, 1 << 32)  # SERVO_OUTPUT_RAW.time_usec
US_64 = Counter(NS_PER_US, 0)  # time_usec: since boot or since 1970
TURN_NS = MS_32.turn * MS_32.tick_ns

Fields: TypeAlias = Any  # one of these records, as numba has it
Records: TypeAlias = NDArray[Any]


def _integers(names: str, *others: tuple[str, Any, Any]) -> np.dtype[np.void]:
    return np.dtype([*((name, "i8") for name in names.split()), *others])


# Where one message's counter stands: the message plus one, 0 for none; whether it has begun; highest count so far, with
# its turns; when it was last received in line; the most that it was ahead of the receiver's clock, which drift takes
# back slowly; the other clock that its latest samples show, with how many in a row agree on it; and how many samples
# since the highest count were behind it, one after the other in their order, the last of them, when it was reached, how
# much time these samples all say was lost since, and the most that one says; and how much late ones say usually.
_READING = _integers(
    "msgid used count host_ns line_ns rival_ns rival_host_ns rivals"
    " behind behind_ns high_host_ns lost_ns late_ns usual_ns"
)
# How far the receiver's clock leads one of the vehicle's: whether it was seen, in which second first, with which lead,
# and in which last; and the latest seconds in which it was seen, each at its place modulo `SECONDS`, with their least
# leads.
_LEAD = _integers("seen first_s first_ns last_s", ("seconds", "i8", SECONDS), ("least", "i8", SECONDS))
# What lays a clock over the reference in one second of the receiver's clock: what to add at its beginning and its end;
# whether it counts as one clock with the reference, but for whole turns; the part of its lead that is a delay of its
# messages; seconds in a row in which a shared clock was apart; and when it began, or was set last, and what it was.
_OFFSET = _integers("known second begin_ns end_ns shared zeroed zero_ns odd since_s since_ns")
# The vehicle: the clock that the others are laid over, -1 before the first stamp; what to add to it; latest time known;
# when the last stamp was received; another clock that may take over; how often it started anew, how often its clock was
# set back, and samples left out because they leap; when the last stamp in line was, and the highest stamp, of the clock
# since boot and of unix time.
_MEM = _integers(
    "reference base_ns t_ns host_ns rival_ns rival_host_ns rivals reboots backs leaps",
    ("seen_ns", "i8", 2),
    ("high_ns", "i8", 2),
)
_CLOCKS = (("leads", _LEAD, CLOCKS), ("offsets", _OFFSET, CLOCKS))
_TIME = _integers("", ("mem", _MEM, (1,)), ("readings", _READING, MESSAGES_MAX), *_CLOCKS)


class VehicleTime:
    """Where one vehicle's time stands; `stamp` changes it in place. words: all of the records above.

    records: (1,) the vehicle; (32,) the counters of its messages; (4,) leads and offsets of the clocks: for `stamp`.
    """

    def __init__(self) -> None:
        self.words = np.zeros(_TIME.itemsize // 8, np.int64)
        record = self.words.view(_TIME)[0]
        self.records: tuple[Records, Records, Records, Records] = tuple(record[name] for name in _TIME.names or ())
        record["mem"]["reference"], record["mem"]["t_ns"], record["leads"]["seconds"] = -1, NEVER, NEVER

    def _told(self, name: str) -> int:
        return int(self.records[0][name][0])

    @property
    def t_ns(self) -> int | None:
        """Latest time known [ns], None before the first stamp."""
        latest = self._told("t_ns")
        return None if latest == NEVER else latest

    @property
    def reboots(self) -> int:
        """How often the vehicle started anew."""
        return self._told("reboots")

    @property
    def backs(self) -> int:
        """How often its clock was set back."""
        return self._told("backs")

    @property
    def leaps(self) -> int:
        """Samples left out because their stamps leap, so far."""
        return self._told("leaps")

    @property
    def drift_ppm(self) -> float | None:
        """How fast another clock of the vehicle drifts against the reference [ppm]; None if its messages have one."""
        for offset in self.records[3]:
            if offset["known"] and not offset["shared"]:
                span_s = max(1, int(offset["second"]) + 1 - int(offset["since_s"]))
                return float(offset["since_ns"] - offset["end_ns"]) / span_s * 1e6 / NS_PER_S
        return None


_IN_LINE, _LEFT_OUT, _BROKEN_OFF, _SET_BACK = 0, 1, 2, 3  # what a stamp is


@inline
def stamp(
    records: tuple[Records, Records, Records, Records], msgid: int, tick: int, turn: int, count: int, now_ns: int
) -> int:
    """The vehicle's time of one frame [ns]; `NEVER` if it is left out, `REBOOT` if it must be given again as the first.

    records: of `VehicleTime`. tick, turn: the message's `Counter`; a tick of 0 for one without a time of its own, which
    gets the latest time known. count: as it was sent. now_ns: when it was received.
    """
    mems, readings, leads, offsets = records
    mem = mems[0]
    if tick == 0:
        return int(mem.t_ns)
    raw = min(max(count, 0), HIGHEST_NS // tick)
    ambiguous = 0 < turn * tick < _DAY_NS  # its first reading alone does not give the time since boot
    place = 0  # of the message's reading, the last one where there is no room for one more
    while place < len(readings) - 1 and readings[place].msgid not in (0, msgid + 1):
        place += 1
    reading = readings[place]
    reading.msgid = msgid + 1
    sort, clock_ns = _BROKEN_OFF, NEVER
    if reading.used:
        sort, clock_ns = _unwrapped(mem, reading, tick, turn, raw, now_ns)
        if sort == _BROKEN_OFF and (reading.count * tick >= EPOCH_NS) != (raw * tick >= EPOCH_NS):
            reading.used = 0  # it went over from time since boot to unix time or back, which is no reboot
    if not reading.used:
        if not _begin(reading, leads, tick, turn, ambiguous, raw, count > raw, now_ns):
            return NEVER
        sort, clock_ns = _unwrapped(mem, reading, tick, turn, raw, now_ns)
    clock = _clock_of(tick, ambiguous, clock_ns)
    if sort == _SET_BACK and clock != mem.reference and not (offsets[clock].known and offsets[clock].shared):
        sort = _IN_LINE  # a clock of its own: it is laid anew over the others
    if sort == _IN_LINE:
        return int(_placed(mem, leads, offsets, clock_ns, now_ns, clock))
    reboots = sort == _BROKEN_OFF and _rebooted(mem, reading, raw * tick, now_ns)
    if reboots or sort == _SET_BACK:
        mem.reboots += int(reboots)
        mem.backs += int(not reboots)
        _start_anew(mem, readings, leads, offsets)
        return REBOOT
    return NEVER


@jit
def _start_anew(mem: Fields, readings: Records, leads: Records, offsets: Records) -> None:
    mem.reference, mem.base_ns, mem.rivals = -1, 0, 0
    mem.seen_ns[:], mem.high_ns[:] = 0, 0
    for reading in readings:
        reading.used = 0
    for clock in range(len(leads)):
        leads[clock].seen = offsets[clock].known = 0
        leads[clock].seconds[:] = NEVER


@jit
def _clock_of(tick: int, ambiguous: bool, clock_ns: int) -> int:
    if clock_ns >= EPOCH_NS:
        return _UNIX
    if ambiguous:
        return _BOOT_US_32
    return _BOOT_MS if tick == NS_PER_MS else _BOOT_US


@jit
def _begin(
    reading: Fields, leads: Records, tick: int, turn: int, ambiguous: bool, raw: int, beyond: bool, now_ns: int
) -> bool:
    """Begin a counter at its first sample, or at what others show if it is ahead of them; whether it can be placed.

    beyond: the count was garbage beyond `HIGHEST_NS`. A counter that wraps often needs the time that others show.
    """
    first = raw
    if ambiguous:
        shown = leads[_BOOT_MS] if leads[_BOOT_MS].seen else leads[_BOOT_US]
        if not shown.seen:
            return False
        first += turn * max(0, int(np.rint((now_ns - _least(shown) - raw * tick) / (turn * tick))))
    else:
        own = leads[_clock_of(tick, ambiguous, raw * tick)]
        if own.seen and (beyond or raw * tick - (now_ns - _least(own)) > LATE_NS):
            first = max(0, now_ns - _least(own)) // tick
    reading.used, reading.count, reading.host_ns, reading.rivals, reading.behind = 1, first, now_ns, 0, 0
    reading.line_ns = min(first * tick, HIGHEST_NS) - now_ns + (now_ns >> DRIFT_SHIFT)
    return True


@jit
def _unwrapped(mem: Fields, reading: Fields, tick: int, turn: int, raw: int, now_ns: int) -> tuple[int, int]:
    """What the stamp is, and the message's own clock [ns]. The reading goes on, unless the counter has broken off."""
    elapsed_ns = max(now_ns - reading.host_ns, reading.host_ns - now_ns - GONE_NS, 0)  # far back: a part of its own
    step = raw - reading.count
    if turn:
        step = raw - reading.count % turn
        nearest = step + (elapsed_ns // tick - step + turn // 2) // turn * turn  # of whole turns more or less
        if abs(nearest * tick - elapsed_ns) <= WRAP_SLACK_NS:
            step = nearest
    clock_ns = (reading.count + step) * tick
    if (clock_ns >= EPOCH_NS) != (reading.count * tick >= EPOCH_NS):
        return _BROKEN_OFF, clock_ns
    if step < 0:
        if reading.behind == 0:
            reading.high_host_ns, reading.lost_ns, reading.behind_ns = reading.host_ns, HIGHEST_NS, NEVER
            reading.late_ns = 0
        lost_ns = now_ns - reading.high_host_ns - step * tick
        reading.lost_ns, reading.late_ns = min(reading.lost_ns, lost_ns), max(reading.late_ns, lost_ns)
        more = reading.behind + int(elapsed_ns > 0 or reading.behind == 0)  # what comes at once counts once
        reading.behind, reading.behind_ns = more if clock_ns > reading.behind_ns else 1, clock_ns
    elif step > 0:
        reading.usual_ns = max(0, reading.usual_ns - (elapsed_ns >> CALMED_SHIFT))
        lost_ns = min(reading.lost_ns, now_ns - reading.high_host_ns - step * tick)
        behind, reading.behind = reading.behind, 0
        if behind >= AGREEING and lost_ns > max(BACK_NS, reading.usual_ns) and step * tick < LEAP_NS:
            return _SET_BACK, clock_ns
        if behind:
            reading.usual_ns = max(reading.usual_ns, reading.late_ns)
    ahead_ns = clock_ns - now_ns + (now_ns >> DRIFT_SHIFT)
    beyond_ns = step * tick - elapsed_ns  # of what the receiver's clock explains
    if beyond_ns > LEAP_NS and ahead_ns - reading.line_ns > LEAP_NS:
        if beyond_ns > JUMP_SLACK_NS and elapsed_ns >= SILENT_NS:
            return _BROKEN_OFF, clock_ns
        advance_ns = clock_ns - reading.rival_ns
        agrees = reading.rivals and advance_ns > 0
        agrees = agrees and abs(advance_ns - (now_ns - reading.rival_host_ns)) <= LATE_NS
        reading.rivals = reading.rivals + 1 if agrees else 1
        reading.rival_ns, reading.rival_host_ns = clock_ns, now_ns
        if beyond_ns > JUMP_SLACK_NS or reading.rivals < AGREEING or elapsed_ns < SILENT_NS:
            mem.leaps += 1
            return _LEFT_OUT, clock_ns
    elif step * tick < -LATE_NS:
        return _BROKEN_OFF if elapsed_ns >= SILENT_NS else _LEFT_OUT, clock_ns
    reading.host_ns, reading.rivals = now_ns, 0
    reading.line_ns = ahead_ns if beyond_ns < -JUMP_SLACK_NS else max(reading.line_ns, ahead_ns)
    reading.count += max(step, 0)
    return _IN_LINE, clock_ns


@jit
def _rebooted(mem: Fields, reading: Fields, clock_ns: int, now_ns: int) -> bool:
    """Whether a stamp out of line is the last of several that show that the vehicle has started anew."""
    ago_ns = now_ns - mem.seen_ns[int(clock_ns >= EPOCH_NS)]
    silent_ns = max(ago_ns, -ago_ns - GONE_NS)
    early = silent_ns < (SILENT_NS if clock_ns <= silent_ns + UPTIME_SLACK_NS else GONE_NS)
    advance_ns = clock_ns - mem.rival_ns
    if early or (mem.rivals and abs(advance_ns - (now_ns - mem.rival_host_ns)) > LATE_NS):
        mem.rivals = mem.rivals if early else 0
        reading.host_ns = now_ns  # the next decision is due after another second
        return False
    if mem.rivals and advance_ns < AGREED_STEP_NS:
        return False
    mem.rivals += 1
    mem.rival_ns, mem.rival_host_ns = clock_ns, now_ns
    return bool(mem.rivals == AGREEING)


@inline
def _placed(mem: Fields, leads: Records, offsets: Records, clock_ns: int, now_ns: int, clock: int) -> Any:
    """The vehicle's time of a stamp in line; `NEVER` where its clock is not laid over the reference yet."""
    if mem.reference < 0:
        mem.reference = clock
        if mem.t_ns != NEVER:
            mem.base_ns = mem.t_ns + max(now_ns - mem.host_ns, REBOOT_GAP_NS) - clock_ns
    lead, lead_ns, second = leads[clock], now_ns - clock_ns, now_ns // NS_PER_S
    if not lead.seen:
        lead.seen, lead.first_s, lead.first_ns, lead.last_s = 1, second, lead_ns, second
    k, lead.last_s = second % SECONDS, max(lead.last_s, second)
    if second > lead.seconds[k]:
        lead.seconds[k], lead.least[k] = second, lead_ns
    elif second == lead.seconds[k]:
        lead.least[k] = min(lead.least[k], lead_ns)
    t_ns = clock_ns if clock == mem.reference else NEVER
    base = leads[mem.reference]
    for other in range(len(leads)):
        own, offset = leads[other], offsets[other]
        due = other == clock or not offset.known or offset.second < max(own.last_s, base.last_s)
        if due and own.seen and other != mem.reference:
            boot = mem.reference != _UNIX and other != _UNIX
            laid_ns = _follow(offset, own, base, boot, now_ns)
            if other == clock and laid_ns != NEVER:
                t_ns = clock_ns + min(max(laid_ns, -HIGHEST_NS), HIGHEST_NS)
    if t_ns != NEVER:
        t_ns += mem.base_ns
        mem.t_ns = max(mem.t_ns, t_ns)
    mem.host_ns = now_ns
    epoch = int(clock == _UNIX)
    if clock != _BOOT_US_32 and clock_ns >= mem.high_ns[epoch] - GONE_NS:  # else a clock of its own
        if now_ns != mem.seen_ns[epoch]:
            mem.seen_ns[epoch] = now_ns
            if mem.rivals and int(mem.rival_ns >= EPOCH_NS) == epoch:
                mem.rivals = 0
        mem.high_ns[epoch] = max(mem.high_ns[epoch], clock_ns)
    return t_ns


@jit
def _least(lead: Fields, since_s: int = NEVER + 1, until_s: int = HIGHEST_NS) -> int:
    """The least lead of a clock over [since_s, until_s) [ns]; `NEVER` without any."""
    found = NEVER
    for k in range(SECONDS):
        if since_s <= lead.seconds[k] < until_s and (found == NEVER or lead.least[k] < found):
            found = lead.least[k]
    return int(found)


@jit
def _lag(own: Fields, base: Fields, since_s: int, until_s: int) -> int:
    """The least lead of the clock less that of the reference over [since_s, until_s) [ns]; `NEVER` without either."""
    found, least = _least(own, since_s, until_s), _least(base, since_s, until_s)
    return NEVER if found == NEVER or least == NEVER else found - least


@jit
def _follow(offset: Fields, own: Fields, base: Fields, boot: bool, now_ns: int) -> int:
    """Bring an offset on by the seconds that are new; what it is at this time [ns], `NEVER` while it is not known."""
    first_s = max(own.first_s, base.first_s)
    second = offset.second if offset.known else first_s - 1
    found_ns = _at(offset, now_ns) if offset.known else NEVER
    while second < max(own.last_s, base.last_s):
        following = HIGHEST_NS  # the first second after this one in which either clock was seen
        for k in range(SECONDS):
            if second < own.seconds[k] < following:
                following = own.seconds[k]
            if second < base.seconds[k] < following:
                following = base.seconds[k]
        second = following
        if offset.known:
            _go_on(offset, own, base, first_s, second)
        else:
            _lay(offset, own, base, boot, first_s, second)
        if offset.known and second <= now_ns // NS_PER_S:
            found_ns = _at(offset, now_ns)
    return found_ns


@jit
def _at(offset: Fields, now_ns: int) -> int:
    share = min(max((now_ns - offset.second * NS_PER_S) / NS_PER_S, 0.0), 1.0)
    return int(offset.begin_ns + int(np.rint((offset.end_ns - offset.begin_ns) * share)))


@jit
def _lay(offset: Fields, own: Fields, base: Fields, boot: bool, first_s: int, second: int) -> None:
    """Lay a clock over the reference for the first time, if enough is known in this second."""
    first_ns = own.first_ns - base.first_ns
    at_ns = int(np.rint(first_ns / TURN_NS)) * TURN_NS
    offset.shared, offset.zeroed, offset.zero_ns, offset.odd = 1, 0, 0, 0
    if not (boot and abs(first_ns - at_ns) < TOGETHER_NS):
        at_ns = _lag(own, base, second - WINDOW, second) if second >= first_s + 2 else NEVER
        offset.shared, offset.zeroed = 0, 1
    if at_ns != NEVER:
        offset.known, offset.second, offset.since_s = 1, second, second
        offset.begin_ns = offset.end_ns = offset.since_ns = at_ns


@jit
def _go_on(offset: Fields, own: Fields, base: Fields, first_s: int, second: int) -> None:
    """Bring an offset on to the next second in which a sample came."""
    at_ns = offset.end_ns
    offset.second, offset.begin_ns = second, at_ns
    lag_ns = _lag(own, base, max(second - WINDOW, offset.since_s - STEPPED), second)
    if lag_ns == NEVER:
        return
    if not offset.zeroed:
        if second >= first_s + WINDOW:
            offset.zeroed, offset.zero_ns = 1, lag_ns - at_ns
        return
    off_ns = lag_ns - offset.zero_ns - at_ns
    if offset.shared:
        offset.odd = offset.odd + 1 if abs(off_ns) > APART_NS else 0
        offset.shared = int(offset.odd <= WINDOW)
        return
    ahead = behind = 0
    least_ns = HIGHEST_NS
    for each in range(second - STEPPED, second):
        each_ns = _lag(own, base, each, each + 1)
        if each_ns != NEVER:
            step_ns = each_ns - offset.zero_ns - at_ns
            ahead, behind = ahead + int(step_ns > SET_NS), behind + int(step_ns < -SET_NS)
            least_ns = step_ns if abs(step_ns) < abs(least_ns) else least_ns
    if ahead == STEPPED or behind == STEPPED:
        offset.begin_ns = offset.end_ns = offset.since_ns = at_ns + least_ns
        offset.since_s = second
        return
    offset.end_ns = at_ns + min(max(off_ns, -SLEW_NS), SLEW_NS)


EVERY_NS = 10 * NS_PER_S  # our choice: it is only a figure


@dataclass(frozen=True, slots=True)
class TimesyncMessage:
    """One TIMESYNC to send. tc1_ns: our time in an answer, 0 in a request; ts1_ns: the asker's time."""

    tc1_ns: int
    ts1_ns: int


@dataclass(slots=True)
class Timesync:
    """The exchange with one vehicle's autopilot."""

    asked_ns: int | None = None  # when a request was sent last (host)
    open: bool = False  # it has not been answered
    round_trip_s: float | None = None  # of its last answer

    def step(self, frames: Iterable[Frame], now_ns: int, *, alive: bool) -> list[TimesyncMessage]:
        """Read the autopilot's TIMESYNCs among its frames; returns what to send: at most one answer and one request.

        now_ns: on the host's clock. alive: the vehicle sent something, so that asking it makes sense.
        """
        sent = list[TimesyncMessage]()
        for frame in frames:
            if frame.msgid == MessageId.TIMESYNC and frame.compid == Component.AUTOPILOT1:
                tc1_ns, ts1_ns = frame.numbers("tc1", "ts1")
                if tc1_ns == 0:
                    sent = [TimesyncMessage(now_ns, ts1_ns)]
                elif self.open and ts1_ns == self.asked_ns:  # a second answer tells nothing
                    self.open = False
                    self.round_trip_s = max(0, frame.host_ns - ts1_ns) / NS_PER_S
        if alive and (self.asked_ns is None or now_ns - self.asked_ns >= EVERY_NS):
            self.asked_ns, self.open = now_ns, True
            sent.append(TimesyncMessage(0, now_ns))
        return sent
