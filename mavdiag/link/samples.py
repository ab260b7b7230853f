"""Frames of one vehicle to telemetry in SI on one timeline, a block at a time.

    state = SampleState()
    state, telemetry = converter.step(state, frames)

What a message means is in `conversion`, when it was is in `clock`; here they are put together. How the frames are cut
into blocks does not matter.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from mavdiag.link.clock import Reading, Run, Timeline, changed_clock, place, rebooted, unwrap
from mavdiag.link.codec import Frame
from mavdiag.link.conversion import Part, Record, Source, sources
from mavdiag.link.messages import Component
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import IntArray, Series, Signal, Telemetry

__all__ = ["Converter", "SampleState", "by_vehicle", "joined"]

UNSTAMPED = -(1 << 62)  # stands for "no time known yet" [ns]
SMALL_BLOCK = 32  # frames: how carefully to go on after a break, so that many breaks do not cost a rescan each

AUTOPILOT = int(Component.AUTOPILOT1)

_host_ns = itemgetter(5)  # of a Frame


@dataclass(frozen=True, slots=True)
class SampleState:
    """What one vehicle's conversion carries from block to block.

    readings: where each message's counter stands. dropped: rows with NaN, infinity or a zero quaternion so far.
    """

    timeline: Timeline = field(default_factory=Timeline)
    readings: Mapping[int, Reading] = field(default_factory=dict)
    dropped: int = 0


def by_vehicle(frames: Sequence[Frame]) -> dict[int, list[Frame]]:
    """The frames of each system id, in order of arrival."""
    vehicles: dict[int, list[Frame]] = {}
    for frame in frames:
        vehicles.setdefault(frame.sysid, []).append(frame)
    return vehicles


def joined(pieces: Sequence[Telemetry]) -> Telemetry:
    """One telemetry from consecutive pieces: each signal's rows, end to end."""
    if len(pieces) == 1:
        return pieces[0]
    runs: dict[Signal, list[Series]] = {}
    for piece in pieces:
        for series in piece.series:
            runs.setdefault(series.signal, []).append(series)
    return Telemetry(
        tuple(
            Series(
                signal,
                np.concatenate([s.t_ns for s in run]),
                np.concatenate([s.host_ns for s in run]),
                np.concatenate([s.values for s in run]),
            )
            for signal, run in runs.items()
        )
    )


class _Group(NamedTuple):
    """The frames of one message in a block, and what they become. run: None for a message without a time of its own."""

    source: Source
    record: Record
    host_ns: IntArray
    run: Run | None

    @property
    def regular(self) -> bool:
        """Whether the message's counter went on to the end of the block."""
        return self.run is None or len(self.run.clock_ns) == len(self.host_ns)


class Converter:
    """Turns one vehicle's frames into telemetry, by its profile. Holds nothing but the profile; the state is passed.

    signals: the signals that are of interest, all unless told; messages without any of them are passed over.
    wanted: the message ids that it reads, for the decoder. Only the autopilot's own frames (component 1) count.
    A block costs some 100 us however short it is: convert 50 pairs of setpoint and IMU message or more at a time.
    """

    def __init__(self, profile: Profile, signals: Collection[Signal] = tuple(Signal)) -> None:
        self.profile = profile
        self._sources: dict[int, Source] = {source.message: source for source in sources(profile, signals)}
        self.wanted = frozenset(self._sources)

    def step(self, state: SampleState, frames: Sequence[Frame]) -> tuple[SampleState, Telemetry]:
        """Take the next frames of one vehicle, in order of arrival."""
        state, telemetry, done = self._stretch(state, frames)
        if done == len(frames):
            return state, telemetry
        pieces, size = [telemetry], SMALL_BLOCK
        while done < len(frames):
            block = frames[done : done + size]
            state, telemetry, more = self._stretch(state, block)
            pieces.append(telemetry)
            done, size = done + more, 2 * size if more == len(block) else SMALL_BLOCK
        return state, joined(pieces)

    def _stretch(self, state: SampleState, frames: Sequence[Frame]) -> tuple[SampleState, Telemetry, int]:
        """Convert frames up to where a counter breaks off; says how many. If it is none, the break is now behind."""
        wanted, autopilot = self.wanted, AUTOPILOT
        members: defaultdict[int, list[Frame]] = defaultdict(list)
        for frame in frames:
            if frame[0] in wanted and frame[2] == autopilot:
                members[frame[0]].append(frame)
        groups = {msgid: self._group(state, msgid, own) for msgid, own in members.items()}
        broken = [members[m][len(g.run.clock_ns)] for m, g in groups.items() if g.run and not g.regular]
        if not broken:
            return *self._converted(state, frames, groups), len(frames)
        first = next(k for k, frame in enumerate(frames) if any(frame is other for other in broken))
        if any(frame[0] in wanted and frame[2] == autopilot for frame in frames[:first]):
            return self._stretch(state, frames[:first])
        return self._restarted(state, frames[first].msgid, groups[frames[first].msgid]), Telemetry(), first

    def _group(self, state: SampleState, msgid: int, members: list[Frame]) -> _Group:
        source = self._sources[msgid]
        record = np.frombuffer(b"".join([frame[4] for frame in members]), source.dtype)
        host_ns = np.fromiter(map(_host_ns, members), np.int64, len(members))
        run = None
        if source.counter:
            run = unwrap(source.counter, state.readings.get(msgid), record[source.time].astype(np.int64), host_ns)
        return _Group(source, record, host_ns, run)

    def _restarted(self, state: SampleState, msgid: int, group: _Group) -> SampleState:
        """A reboot, unless the message only went over to the vehicle's other clock."""
        source, last = group.source, state.readings[msgid]
        if source.counter and changed_clock(source.counter, last, int(group.record[source.time][0])):
            return replace(state, readings={m: reading for m, reading in state.readings.items() if m != msgid})
        return replace(state, timeline=rebooted(state.timeline), readings={})

    def _converted(
        self, state: SampleState, frames: Sequence[Frame], groups: Mapping[int, _Group]
    ) -> tuple[SampleState, Telemetry]:
        runs = {msgid: group.run for msgid, group in groups.items() if group.run is not None}
        timeline, times = place(state.timeline, list(runs.values())) if runs else (state.timeline, [])
        when = dict(zip(runs, times, strict=True))
        if len(runs) < len(groups):
            when |= _times_without_stamp(state.timeline.t_ns, frames, when, groups.keys() - runs.keys())
        series, dropped = [], state.dropped
        with np.errstate(invalid="ignore", over="ignore"):  # NaN and infinity are dropped, not warned of
            for msgid, group in groups.items():
                for part in group.source.convert(self.profile, group.record):
                    one, unsound = _series(part, when[msgid], group.host_ns)
                    dropped += unsound
                    if len(one):
                        series.append(one)
        readings = {**state.readings, **{msgid: run.reading for msgid, run in runs.items()}}
        return SampleState(timeline, readings, dropped), Telemetry(tuple(series))


def _times_without_stamp(
    known_ns: int | None, frames: Sequence[Frame], when: Mapping[int, IntArray], missing: Set[int]
) -> dict[int, IntArray]:
    """For messages without a time of their own the latest vehicle time at their arrival; none before the first stamp.

    known_ns: the latest time before the block. when: the times of its other messages. missing: the messages to place.
    """
    own = (frame[0] if frame[2] == AUTOPILOT else -1 for frame in frames)
    ids = np.fromiter(own, np.int64, len(frames))
    latest = np.full(len(frames), UNSTAMPED if known_ns is None else known_ns)
    for msgid, t_ns in when.items():
        rows = np.flatnonzero(ids == msgid)
        latest[rows[len(rows) - len(t_ns) :]] = t_ns
    latest = np.maximum.accumulate(latest)
    return {msgid: (t_ns := latest[ids == msgid])[t_ns > UNSTAMPED] for msgid in missing}


def _series(part: Part, t_ns: IntArray, host_ns: IntArray) -> tuple[Series, int]:
    """The sound rows of a part, and how many were not. t_ns: times of the last rows; those before have none."""
    values, keep, unsound = part.values, part.meant, 0
    if not part.finite and not np.isfinite(values).all():
        sound = np.logical_and.reduce(np.isfinite(values), axis=1)
        meant = sound | True if keep is None else keep
        unsound = int(np.count_nonzero(meant & ~sound))
        keep = meant & sound
    untimed = len(host_ns) - len(t_ns)
    if untimed:
        host_ns, values, keep = host_ns[untimed:], values[untimed:], None if keep is None else keep[untimed:]
    if keep is not None:
        t_ns, host_ns, values = t_ns[keep], host_ns[keep], values[keep]
    return Series(part.signal, t_ns, host_ns, values), unsound
