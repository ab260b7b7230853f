"""How far a vehicle's clocks are from each other, and how that drifts, as seen by a receiver behind a jittery link.

A message that is stamped c_ns on a clock arrives at host_ns = c_ns + (origin of the clock) + delay, with delay >= 0.
The least host_ns - c_ns of a window, the clock's lead, is its origin to within the least delay. So the difference of
two leads is the offset of two clocks without the receiver's jitter; the receiver's own drift is in both and cancels.
Quartz drifts by tens of parts in a million: 50 ppm are 180 ms in an hour.

The window slides by whole seconds of the receiver's clock. Within a second the offset goes on a straight line, never
faster than `SLEW_NS`. So nothing jumps, and how the samples are cut into blocks does not matter.

Clocks since boot that are within a second of each other, but for whole turns of the one of 49.7 days, count as one:
their stamps stay exactly as sent until their leads have moved apart by more than changing delays explain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from mavdiag.link.clock import HIGHEST_NS, MS_32, Clock, Run
from mavdiag.telemetry import IntArray
from mavdiag.units import NS_PER_MS, NS_PER_S

__all__ = ["NO_CLOCKS", "Clocks", "Leads", "Offset", "followed", "lead_ns", "placed"]

# Choices, not measurements, but for the drift of quartz.
WINDOW = 10  # seconds over which the least lead is taken: 1000 samples at 100 Hz, and 0.5 ms of drift at 50 ppm
SLEW_NS = NS_PER_S // 2000  # by how much an offset changes in a second at most: ten times the drift of a plain quartz
TOGETHER_NS = NS_PER_S  # clocks since boot that begin nearer to each other than this are one
APART_NS = 20 * NS_PER_MS  # so far one clock may seem to move against itself, as the delays of messages change
STEP_NS = 100 * NS_PER_MS  # a change of more is no drift: somebody has set a clock
STEPPED = 3  # seconds in a row that must show it
TURN_NS = MS_32.turn * MS_32.tick_ns


class Leads(NamedTuple):
    """How far the receiver's clock leads one of the vehicle's.

    first_s: the receiver's second in which the clock was seen first.
    first_ns: lead of its first sample [ns].
    seconds: the latest seconds in which it was seen, the last of them unfinished, each with its least lead [ns].
    """

    first_s: int
    first_ns: int
    seconds: tuple[tuple[int, int], ...]


class Offset(NamedTuple):
    """What lays a clock over the reference, in one second of the receiver's clock.

    second: which one.
    begin_ns, end_ns: what to add to a stamp at its beginning and its end [ns].
    shared: it counts as one clock with the reference, but for whole turns.
    zero_ns: the part of its lead that is a delay of its messages [ns]; None while it is not known.
    odd: seconds in a row in which a shared clock was apart.
    since_s, since_ns: the second in which it began, or was set last, and what it was then.
    """

    second: int
    begin_ns: int
    end_ns: int
    shared: bool
    zero_ns: int | None
    odd: int
    since_s: int
    since_ns: int

    @property
    def drift_ppm(self) -> float:
        """Mean drift of the reference against the clock since then, in parts in a million."""
        return (self.end_ns - self.since_ns) / max(1, self.second + 1 - self.since_s) * 1e6 / NS_PER_S


@dataclass(frozen=True, slots=True)
class Clocks:
    """What is known of a vehicle's clocks.

    reference: the one that the others are laid over; None before the first stamp.
    leads, offsets: by `Clock`; None where it was not seen, or is not laid over the reference yet.
    """

    reference: Clock | None = None
    leads: tuple[Leads | None, ...] = (None,) * len(Clock)
    offsets: tuple[Offset | None, ...] = (None,) * len(Clock)


NO_CLOCKS = Clocks()

Seconds: TypeAlias = dict[int, int]  # second -> least lead [ns]
Path: TypeAlias = tuple[Offset, ...]  # of consecutive seconds


def lead_ns(clocks: Clocks, clock: Clock) -> int | None:
    """How far the receiver's clock is ahead of this one, by the least delay of late [ns]; None if it was not seen."""
    leads = clocks.leads[clock]
    return None if leads is None else min(lead for _, lead in leads.seconds)


def followed(clocks: Clocks, runs: Sequence[Run]) -> tuple[Clocks, Mapping[Clock, Path]]:
    """Take in further samples, in order of arrival; returns the offsets of each clock but the reference over them."""
    reference = runs[0].clock if clocks.reference is None else clocks.reference
    before, kinds = clocks.leads, {run.clock for run in runs}
    leads = [_watched(before[c], [run for run in runs if run.clock is c]) if c in kinds else before[c] for c in Clock]
    others = [c for c in Clock if c is not reference and leads[c] is not None]
    latest = max(one.seconds[-1][0] for one in leads if one is not None)
    offsets, paths = list(clocks.offsets), dict[Clock, Path]()
    base = leads[reference]
    table = dict(base.seconds) if base is not None and others else {}
    for clock in others:
        own = leads[clock]
        if own is not None and base is not None:
            boot = Clock.UNIX not in (clock, reference)
            first_s, first_ns = max(own.first_s, base.first_s), own.first_ns - base.first_ns
            path = paths[clock] = _path(offsets[clock], _Pair(boot, first_s, first_ns, dict(own.seconds), table))
            offsets[clock] = path[-1] if path else None
    kept = tuple(None if one is None else _recent(one, latest - WINDOW) for one in leads)
    return Clocks(reference, kept, tuple(offsets)), paths


def placed(clock_ns: IntArray, host_ns: IntArray, path: Path, settled: bool) -> IntArray:
    """The reference's time of stamps of another clock.

    settled: it was laid over the reference before; if not, the leading samples before the first second of the path have
    no time and are left out.
    """
    if not path:
        return clock_ns[:0]
    if not settled and (early := path[0].second * NS_PER_S) > host_ns[0]:
        first = int(np.searchsorted(host_ns, early))
        clock_ns, host_ns = clock_ns[first:], host_ns[first:]
    begin_ns = path[0].begin_ns
    if all(one.begin_ns == begin_ns == one.end_ns for one in path):
        return clock_ns + min(max(begin_ns, -HIGHEST_NS), HIGHEST_NS) if begin_ns else clock_ns
    seconds = np.fromiter((one.second for one in path), np.int64, len(path))
    at = np.maximum(np.searchsorted(seconds, host_ns // NS_PER_S, side="right") - 1, 0)
    begin = np.fromiter((one.begin_ns for one in path), np.int64, len(path))[at]
    change = np.fromiter((one.end_ns - one.begin_ns for one in path), np.int64, len(path))[at]
    share = np.clip((host_ns - seconds[at] * NS_PER_S) / NS_PER_S, 0.0, 1.0)
    return clock_ns + np.clip(begin + np.rint(change * share).astype(np.int64), -HIGHEST_NS, HIGHEST_NS)


def _watched(leads: Leads | None, runs: Sequence[Run]) -> Leads | None:
    """The leads of a clock with these further samples of it."""
    if leads is None and runs:
        leads = Leads(int(runs[0].host_ns[0]) // NS_PER_S, int(runs[0].host_ns[0] - runs[0].clock_ns[0]), ())
    if leads is None:
        return None
    table = dict(leads.seconds)
    for run in runs:
        found, first = run.host_ns - run.clock_ns, int(run.host_ns[0]) // NS_PER_S
        if first == int(run.host_ns[-1]) // NS_PER_S:
            table[first] = min(int(found.min()), table.get(first, HIGHEST_NS))
            continue
        second = run.host_ns // NS_PER_S
        starts = np.flatnonzero(np.diff(second, prepend=second[0] - 1))
        for one, least in zip(second[starts].tolist(), np.minimum.reduceat(found, starts).tolist(), strict=True):
            table[one] = min(least, table.get(one, HIGHEST_NS))
    return leads._replace(seconds=tuple(sorted(table.items())))


class _Pair(NamedTuple):
    """A clock and the reference.

    boot: both count since boot.
    first_s: the second in which the later of the two was seen first.
    first_ns: what the first sample of the clock seemed to be behind the first of the reference [ns].
    own, base: their leads.
    """

    boot: bool
    first_s: int
    first_ns: int
    own: Seconds
    base: Seconds

    def lag_ns(self, since_s: int, until_s: int) -> int | None:
        """The least lead of the clock less that of the reference over the seconds [since_s, until_s) [ns]."""
        own = [self.own[second] for second in range(since_s, until_s) if second in self.own]
        base = [self.base[second] for second in range(since_s, until_s) if second in self.base]
        return min(own) - min(base) if own and base else None


def _recent(leads: Leads, since_s: int) -> Leads:
    """Without the seconds that no window will use any more; the latest one stays."""
    if leads.seconds[0][0] >= since_s:
        return leads
    recent = tuple(one for one in leads.seconds if one[0] >= since_s)
    return leads._replace(seconds=recent or leads.seconds[-1:])


def _path(offset: Offset | None, pair: _Pair) -> Path:
    """The offsets of the seconds from the one that is known on, as far as samples came."""
    now_s = offset.second if offset else pair.first_s
    path = [offset] if offset else []
    for second in sorted(one for one in pair.own.keys() | pair.base.keys() if one >= now_s):
        if path and second == path[-1].second:
            continue
        after = _next(path[-1], pair, second) if path else _first(pair, second)
        path += [after] if after else []
    return tuple(path)


def _first(pair: _Pair, second: int) -> Offset | None:
    turns = round(pair.first_ns / TURN_NS) * TURN_NS
    if pair.boot and abs(pair.first_ns - turns) < TOGETHER_NS:
        return Offset(second, turns, turns, True, None, 0, second, turns)
    lag_ns = pair.lag_ns(second - WINDOW, second) if second >= pair.first_s + 2 else None
    return None if lag_ns is None else Offset(second, lag_ns, lag_ns, False, 0, 0, second, lag_ns)


def _next(before: Offset, pair: _Pair, second: int) -> Offset:
    at_ns = before.end_ns
    offset = before._replace(second=second, begin_ns=at_ns)
    lag_ns = pair.lag_ns(max(second - WINDOW, offset.since_s - STEPPED), second)
    if lag_ns is None:
        return offset
    if offset.zero_ns is None:
        return offset._replace(zero_ns=lag_ns - at_ns) if second >= pair.first_s + WINDOW else offset
    off_ns = lag_ns - offset.zero_ns - at_ns
    if offset.shared:
        odd = offset.odd + 1 if abs(off_ns) > APART_NS else 0
        return offset._replace(odd=odd, shared=odd <= WINDOW)
    each = [pair.lag_ns(one, one + 1) for one in range(second - STEPPED, second)]
    steps = [one - offset.zero_ns - at_ns for one in each if one is not None]
    if len(steps) == STEPPED and (min(steps) > STEP_NS or max(steps) < -STEP_NS):
        at_ns += min(steps, key=abs)
        return offset._replace(begin_ns=at_ns, end_ns=at_ns, since_s=second, since_ns=at_ns)
    return offset._replace(end_ns=at_ns + min(max(off_ns, -SLEW_NS), SLEW_NS))
