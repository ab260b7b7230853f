"""The compiled loop of `clock`, whose words are there: frame after frame, in the records of a vehicle's time."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mavdiag.jit import cached
from mavdiag.link.clock import (
    AGREED_STEP_NS,
    AGREEING,
    APART_NS,
    DRIFT_SHIFT,
    EPOCH_NS,
    GONE_NS,
    HIGHEST_NS,
    JUMP_SLACK_NS,
    LATE_NS,
    LEAP_NS,
    NEVER,
    REBOOT_GAP_NS,
    SET_NS,
    SILENT_NS,
    SLEW_NS,
    STEPPED,
    TOGETHER_NS,
    TURN_NS,
    UPTIME_SLACK_NS,
    WINDOW,
    WRAP_SLACK_NS,
    Clock,
)
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S

Fields: TypeAlias = Any  # one record of `clock`, as numba has it
Records: TypeAlias = NDArray[Any]

_BOOT_MS, _BOOT_US, _BOOT_US_32, _UNIX = (int(clock) for clock in Clock)
_DAY_NS = 86_400 * NS_PER_S
_IN_LINE, _LEFT_OUT, _BROKEN_OFF = 0, 1, 2  # what a stamp is
_STRAY, _RIVAL, _REBOOT = 0, 1, 2  # what a stamp out of line is


@cached
def stamp(
    mems: Records,
    readings: Records,
    leads: Records,
    offsets: Records,
    frames: tuple[IntArray, IntArray, IntArray, IntArray],
    t_ns: IntArray,
) -> int:
    """See `clock.VehicleTime.stamped`, which passes its records. t_ns: gets the times. Returns how many were taken."""
    mem = mems[0]
    messages, rows, raws, host_ns = frames
    for k in range(len(raws)):
        t_ns[k] = 0
        if rows[k] < 0:
            continue
        t_ns[k] = NEVER
        msgid, tick, turn = messages[rows[k]]
        now_ns = host_ns[k]
        if tick == 0:
            t_ns[k] = mem.t_ns
            continue
        raw = min(max(raws[k], 0), HIGHEST_NS // tick)
        ambiguous = 0 < turn * tick < _DAY_NS  # its first reading alone does not give the time since boot
        reading = readings[_place(readings, msgid)]
        sort, clock_ns = _BROKEN_OFF, NEVER
        if reading.used:
            sort, clock_ns = _unwrapped(mem, reading, tick, turn, raw, now_ns)
            if sort == _BROKEN_OFF and (reading.raw * tick >= EPOCH_NS) != (raw * tick >= EPOCH_NS):
                reading.used = 0  # it went over from time since boot to unix time or back, which is no reboot
        if not reading.used:
            beyond = raws[k] > raw
            if not _begin(reading, leads, tick, turn, ambiguous, raw, beyond, now_ns):
                continue
            sort, clock_ns = _unwrapped(mem, reading, tick, turn, raw, now_ns)
        if sort == _BROKEN_OFF:
            what = _out_of_line(mem, raw * tick, now_ns)
            if what == _REBOOT:
                _start_anew(mem, readings, leads, offsets)
                return k
            if what == _STRAY:
                reading.host_ns = now_ns  # the next decision is due after another second
        elif sort == _IN_LINE:
            t_ns[k] = _placed(mem, leads, offsets, clock_ns, now_ns, _clock_of(tick, ambiguous, clock_ns))
    return len(raws)


@cached
def _clock_of(tick: int, ambiguous: bool, clock_ns: int) -> int:
    if clock_ns >= EPOCH_NS:
        return _UNIX
    if ambiguous:
        return _BOOT_US_32
    return _BOOT_MS if tick == NS_PER_MS else _BOOT_US


@cached
def _place(readings: Records, msgid: int) -> int:
    """Where a message's reading is, or can be: the last place where there is no room for one more."""
    for k in range(len(readings)):
        if readings[k].msgid == msgid + 1 or readings[k].msgid == 0:
            readings[k].msgid = msgid + 1
            return k
    return len(readings) - 1


@cached
def _begin(
    reading: Fields, leads: Records, tick: int, turn: int, ambiguous: bool, raw: int, beyond: bool, now_ns: int
) -> bool:
    """Where a counter stood before its first sample: there, unless it is ahead of what other messages show.

    beyond: the count was garbage beyond `HIGHEST_NS`. Returns whether it can be placed: a counter that wraps often
    needs the time since boot that the others show.
    """
    first, wrapped = raw, 0
    if ambiguous:
        shown = leads[_BOOT_MS] if leads[_BOOT_MS].count else leads[_BOOT_US]
        if not shown.count:
            return False
        since_boot_ns = now_ns - _least(shown)
        wrapped = max(0, int(np.rint((since_boot_ns - raw * tick) / (turn * tick))))
    else:
        own = leads[_clock_of(tick, ambiguous, raw * tick)]
        if own.count and (beyond or raw * tick - (now_ns - _least(own)) > LATE_NS):
            first = max(0, now_ns - _least(own)) // tick
    clock_ns = min(first * tick + wrapped * turn * tick, HIGHEST_NS)
    reading.used, reading.raw, reading.turns, reading.host_ns, reading.rivals = 1, first, wrapped, now_ns, 0
    reading.line_ns = clock_ns - now_ns + (now_ns >> DRIFT_SHIFT)
    return True


@cached
def _unwrapped(mem: Fields, reading: Fields, tick: int, turn: int, raw: int, now_ns: int) -> tuple[int, int]:
    """What the stamp is, and the message's own clock [ns]. The reading goes on, unless the counter has broken off."""
    ahead_of_it = reading.turns * turn
    elapsed_ns = max(now_ns - reading.host_ns, 0)
    step = raw - reading.raw
    if turn:
        shorter = (step + turn // 2) % turn - turn // 2  # the shorter way round
        if abs(shorter * tick - elapsed_ns) <= WRAP_SLACK_NS:
            step = shorter
    clock_ns = (reading.raw + ahead_of_it + step) * tick
    if (clock_ns >= EPOCH_NS) != ((reading.raw + ahead_of_it) * tick >= EPOCH_NS):
        return _BROKEN_OFF, clock_ns
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
    reading.host_ns, reading.line_ns, reading.rivals = now_ns, max(reading.line_ns, ahead_ns), 0
    if step > 0:
        if turn:
            reading.turns += (reading.raw + step - raw) // turn
        reading.raw = raw
    return _IN_LINE, clock_ns


@cached
def _out_of_line(mem: Fields, clock_ns: int, now_ns: int) -> int:
    """What a stamp out of line is taken for: a stray, a clock that may take over, or the vehicle that started anew."""
    silent_ns = now_ns - mem.seen_ns[int(clock_ns >= EPOCH_NS)]
    young = clock_ns <= silent_ns + UPTIME_SLACK_NS
    if silent_ns < (SILENT_NS if young else GONE_NS):
        return _STRAY
    advance_ns = clock_ns - mem.rival_ns
    if mem.rivals == 0:
        mem.rivals = 1
    elif abs(advance_ns - (now_ns - mem.rival_host_ns)) > LATE_NS:
        mem.rivals = 0
        return _STRAY
    elif advance_ns < AGREED_STEP_NS:
        return _RIVAL
    elif mem.rivals + 1 == AGREEING:
        return _REBOOT
    else:
        mem.rivals += 1
    mem.rival_ns, mem.rival_host_ns = clock_ns, now_ns
    return _RIVAL


@cached
def _start_anew(mem: Fields, readings: Records, leads: Records, offsets: Records) -> None:
    """The clocks are new, and the time goes on with the receiver's, by a second at least."""
    mem.reference, mem.base_ns, mem.rivals = -1, 0, 0
    mem.reboots += 1
    for k in range(2):
        mem.seen_ns[k] = mem.high_ns[k] = 0
    for reading in readings:
        reading.used = 0
    for clock in range(len(leads)):
        leads[clock].count = offsets[clock].known = 0


@cached
def _placed(mem: Fields, leads: Records, offsets: Records, clock_ns: int, now_ns: int, clock: int) -> Any:
    """The vehicle's time of a stamp in line; `NEVER` where its clock is not laid over the reference yet."""
    if mem.reference < 0:
        mem.reference = clock
        if mem.t_ns != NEVER:
            mem.base_ns = mem.t_ns + max(now_ns - mem.host_ns, REBOOT_GAP_NS) - clock_ns
    _watch(leads, clock, clock_ns, now_ns)
    t_ns = clock_ns if clock == mem.reference else NEVER
    for other in range(len(leads)):
        if other != mem.reference and leads[other].count:
            laid_ns = _follow(offsets[other], leads[other], leads[mem.reference], mem.reference, other, now_ns)
            if other == clock and laid_ns != NEVER:
                t_ns = clock_ns + min(max(laid_ns, -HIGHEST_NS), HIGHEST_NS)
    _forget(leads)
    if t_ns != NEVER:
        t_ns += mem.base_ns
        mem.t_ns = max(mem.t_ns, t_ns)
    mem.host_ns = max(mem.host_ns, now_ns)
    epoch = int(clock == _UNIX)
    if clock != _BOOT_US_32 and clock_ns >= mem.high_ns[epoch] - GONE_NS:  # else a clock of its own
        if now_ns > mem.seen_ns[epoch]:
            mem.seen_ns[epoch] = now_ns
            if mem.rivals and int(mem.rival_ns >= EPOCH_NS) == epoch:
                mem.rivals = 0
        mem.high_ns[epoch] = max(mem.high_ns[epoch], clock_ns)
    return t_ns


@cached
def _least(lead: Fields) -> Any:
    least = lead.least[0]
    for k in range(1, lead.count):
        least = min(least, lead.least[k])
    return least


@cached
def _watch(leads: Records, clock: int, clock_ns: int, now_ns: int) -> None:
    """Take a sample into the leads of its clock."""
    lead, second, found_ns = leads[clock], now_ns // NS_PER_S, now_ns - clock_ns
    if lead.count == 0:
        lead.first_s, lead.first_ns = second, found_ns
    k = lead.count
    while k > 0 and lead.seconds[k - 1] > second:
        k -= 1
    if k > 0 and lead.seconds[k - 1] == second:
        lead.least[k - 1] = min(lead.least[k - 1], found_ns)
        return
    for j in range(lead.count, k, -1):  # there is room: `_forget` leaves a window of them
        lead.seconds[j], lead.least[j] = lead.seconds[j - 1], lead.least[j - 1]
    lead.count += 1
    lead.seconds[k], lead.least[k] = second, found_ns


@cached
def _forget(leads: Records) -> None:
    """Drop the seconds that no window will use any more; the latest one of each clock stays."""
    since_s = NEVER
    for lead in leads:
        if lead.count:
            since_s = max(since_s, lead.seconds[lead.count - 1] - WINDOW)
    for lead in leads:
        old = 0
        while old < lead.count - 1 and lead.seconds[old] < since_s:
            old += 1
        if old:
            for k in range(old, lead.count):
                lead.seconds[k - old], lead.least[k - old] = lead.seconds[k], lead.least[k]
            lead.count -= old


@cached
def _follow(offset: Fields, own: Fields, base: Fields, reference: int, clock: int, now_ns: int) -> int:
    """Bring an offset on by the seconds that are new; what it is at this time [ns], `NEVER` while it is not known."""
    boot = reference != _UNIX and clock != _UNIX
    first_s, first_ns = max(own.first_s, base.first_s), own.first_ns - base.first_ns
    second = offset.second if offset.known else first_s - 1
    found_ns = _at(offset, now_ns) if offset.known else NEVER
    while True:
        following, other = _after(own, second), _after(base, second)
        if following == NEVER or NEVER < other < following:
            following = other
        if following == NEVER:
            return found_ns
        second = following
        if offset.known:
            _go_on(offset, own, base, first_s, second)
        else:
            _lay(offset, own, base, boot, first_s, first_ns, second)
        if offset.known and second <= now_ns // NS_PER_S:
            found_ns = _at(offset, now_ns)


@cached
def _after(lead: Fields, second: int) -> int:
    """The first second after this one in which a clock was seen; `NEVER` if there is none."""
    for k in range(lead.count):
        if lead.seconds[k] > second:
            return int(lead.seconds[k])
    return NEVER


@cached
def _at(offset: Fields, now_ns: int) -> int:
    """An offset within its second [ns]."""
    share = min(max((now_ns - offset.second * NS_PER_S) / NS_PER_S, 0.0), 1.0)
    return int(offset.begin_ns + int(np.rint((offset.end_ns - offset.begin_ns) * share)))


@cached
def _lag(own: Fields, base: Fields, since_s: int, until_s: int) -> int:
    """The least lead of the clock less that of the reference over [since_s, until_s) [ns]; `NEVER` without either."""
    found = NEVER
    for k in range(own.count):
        if since_s <= own.seconds[k] < until_s and (found == NEVER or own.least[k] < found):
            found = own.least[k]
    least = NEVER
    for k in range(base.count):
        if since_s <= base.seconds[k] < until_s and (least == NEVER or base.least[k] < least):
            least = base.least[k]
    return NEVER if found == NEVER or least == NEVER else int(found - least)


@cached
def _lay(offset: Fields, own: Fields, base: Fields, boot: bool, first_s: int, first_ns: int, second: int) -> None:
    """Lay a clock over the reference for the first time, if enough is known in this second."""
    at_ns = int(np.rint(first_ns / TURN_NS)) * TURN_NS
    offset.shared, offset.zeroed, offset.zero_ns, offset.odd = 1, 0, 0, 0
    if not (boot and abs(first_ns - at_ns) < TOGETHER_NS):
        at_ns = _lag(own, base, second - WINDOW, second) if second >= first_s + 2 else NEVER
        offset.shared, offset.zeroed = 0, 1
    if at_ns != NEVER:
        offset.known, offset.second, offset.since_s = 1, second, second
        offset.begin_ns = offset.end_ns = offset.since_ns = at_ns


@cached
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
