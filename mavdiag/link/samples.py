"""Frames of one vehicle to telemetry in SI on one timeline, a block at a time.

    state = SampleState()
    state, telemetry = decoder.step(state, frames)

What a message means is in `conversion`, when it was is in `clock` and `timeline`; here they are put together. How the
frames are cut into blocks does not matter.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mavdiag.link.batch import Batch, Column, Record, batch_of
from mavdiag.link.clock import EPOCH_NS, ClockReading, Counter, Run, changed_clock, unwrap
from mavdiag.link.codec import Frame
from mavdiag.link.conversion import SOURCES, Part, Source, sources
from mavdiag.link.offsets import lead_ns as lead_of
from mavdiag.link.profiles import Profile
from mavdiag.link.timeline import OutOfLine, Timeline, out_of_line, place
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

UNSTAMPED = -(1 << 62)  # stands for "no time known yet" [ns]
DISARMED_NS = 3 * NS_PER_S // 2  # without an armed heartbeat before a disarmed one is believed: they come each second
SMALL_BLOCK = 32  # frames: how carefully to go on after a break, so that many breaks do not cost a rescan each


@dataclass(frozen=True, slots=True)
class SampleState:
    """What one vehicle's conversion carries from block to block.

    timeline: where its time stands.
    readings: where each message's counter stands.
    held: last known row of the signals whose messages carry only some of the columns.
    dropped: rows with NaN, infinity or a zero quaternion so far.
    leaps: samples left out because their stamps leap, so far.
    armed_ns: when the latest armed heartbeat was received [ns].
    contrary: disarmed heartbeats amid armed ones, left out so far.
    """

    timeline: Timeline = field(default_factory=Timeline)
    readings: Mapping[int, ClockReading] = field(default_factory=dict)
    held: Mapping[Signal, FloatArray] = field(default_factory=dict, compare=False)
    dropped: int = 0
    leaps: int = 0
    armed_ns: int = UNSTAMPED
    contrary: int = 0


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
    runs = Runs()
    for piece in pieces:
        runs.add(piece)
    return runs.joined()


class Runs:
    """Telemetry that comes in consecutive pieces."""

    def __init__(self) -> None:
        self._runs: dict[Signal, list[Series]] = {}

    def add(self, piece: Telemetry) -> None:
        """Take the next piece."""
        for series in piece.series:
            self._runs.setdefault(series.signal, []).append(series)

    def joined(self) -> Telemetry:
        """Each signal's rows, end to end. The pieces are given up one by one, so that memory does not hold all twice.

        Signals of one message share their times, as they do in each piece.
        """
        times: dict[tuple[int, ...], IntArray] = {}

        def whole(parts: list[IntArray]) -> IntArray:
            known = tuple(map(id, parts))
            if known not in times:
                times[known] = np.concatenate(parts)
            return times[known]

        series = []
        while self._runs:
            signal = next(iter(self._runs))
            run = self._runs.pop(signal)
            t_ns, host_ns = whole([one.t_ns for one in run]), whole([one.host_ns for one in run])
            series.append(Series(signal, t_ns, host_ns, np.concatenate([one.values for one in run])))
        return Telemetry(tuple(series))


class _Group(NamedTuple):
    """The frames of one message in a block, and what they become.

    source: the row of the table.
    column: all its frames.
    record: (n,) payloads that are in line.
    host_ns: (n,) when they were received [ns].
    run: None for a message without a time of its own.
    first: frames of this message at the start of the block that cannot be placed in time and are left out.
    total: frames of this message behind those.
    """

    source: Source
    column: Column
    record: Record
    host_ns: IntArray
    run: Run | None
    first: int
    total: int

    @property
    def broken_at(self) -> int | None:
        """Where the message's counter broke off, as a number of its frames; None if it went on to the end."""
        return None if self.run is None or self.run.used == self.total else self.first + self.run.used

    def places(self, kept: IntArray | None = None) -> IntArray:
        """(n,) where in the block the frames of `record` are, or those of them that are kept."""
        rows = self.column.places[self.first :]
        rows = rows if self.run is None or self.run.kept is None else rows[self.run.kept]
        return rows if kept is None else rows[kept]


class SampleDecoder:
    """Turns one vehicle's frames into telemetry, by its profile. Holds nothing but the profile; the state is passed.

    profile: how the vehicle sends.
    signals: those of interest; messages without any of them are passed over.
    table: the messages that are known.
    wanted: the message ids that it reads, for the decoder of frames.
    Only the autopilot's own frames (component 1) count. Frames of SERVO_OUTPUT_RAW are left out until another message
    has given the time since boot. A block costs some 100 us however short it is: convert 50 pairs of set-point and IMU
    message or more at a time.
    """

    def __init__(
        self, profile: Profile, signals: Collection[Signal] = tuple(Signal), table: Iterable[Source] = SOURCES
    ) -> None:
        self.profile = profile
        self._sources: dict[int, Source] = {row.message: row for row in sources(profile, signals, table)}
        self.wanted = frozenset(self._sources)

    def step(self, state: SampleState, frames: Sequence[Frame]) -> tuple[SampleState, Telemetry]:
        """Take the next frames of one vehicle, in order of arrival."""
        return self.step_batch(state, batch_of(frames, self.wanted))

    def step_batch(self, state: SampleState, batch: Batch) -> tuple[SampleState, Telemetry]:
        """As `step`, for frames that are laid out message by message."""
        state, telemetry, done = self._stretch(state, batch)
        if done == batch.size:
            return state, telemetry
        pieces, size = [telemetry], SMALL_BLOCK
        while done < batch.size:
            block = batch.part(done, done + size)
            state, telemetry, more = self._stretch(state, block)
            pieces.append(telemetry)
            done, size = done + more, 2 * size if more == block.size else SMALL_BLOCK
        return state, joined(pieces)

    def _stretch(self, state: SampleState, block: Batch) -> tuple[SampleState, Telemetry, int]:
        """Convert frames up to where a counter breaks off; says how many. If it is none, the break is now behind."""
        columns = {msgid: column for msgid, column in block.columns.items() if msgid in self.wanted}
        groups = self._groups(state, columns)
        broken = {m: at for m, group in groups.items() if (at := group.broken_at) is not None}
        if not broken:
            return *self._converted(state, block.size, groups), block.size
        first, msgid, at = min((int(columns[m].places[at]), m, at) for m, at in broken.items())
        if any(column.places[0] < first for column in columns.values()):
            return self._stretch(state, block.part(0, first))
        state, stray = self._decided(state, msgid, columns[msgid], at)
        return state, Telemetry(), first + stray

    def _groups(self, state: SampleState, columns: Mapping[int, Column]) -> dict[int, _Group]:
        """The messages in order of arrival, but those whose counter needs another's time come last."""
        groups: dict[int, _Group] = {}
        ambiguous: list[int] = []
        for msgid, own in columns.items():
            counter = self._sources[msgid].counter
            if counter is not None and counter.ambiguous:
                ambiguous.append(msgid)
            else:
                groups[msgid] = self._group(state, msgid, own)
        for msgid in ambiguous:
            own, first, since_boot_ns = columns[msgid], 0, None
            if msgid not in state.readings:
                first, since_boot_ns = _first_placed(state.timeline, own, groups)
            if first < len(own):
                groups[msgid] = self._group(state, msgid, own, first, since_boot_ns)
        return groups

    def _group(
        self, state: SampleState, msgid: int, own: Column, first: int = 0, since_boot_ns: int | None = None
    ) -> _Group:
        source = self._sources[msgid]
        record, host_ns = own.record(source.dtype)[first:], own.host_ns[first:]
        total, run = len(host_ns), None
        if source.counter:
            raw = record[source.time].astype(np.int64)
            last, lead_ns = state.readings.get(msgid), None
            if last is None:
                on_epoch = int(raw[0]) * source.counter.tick_ns >= EPOCH_NS
                lead_ns = lead_of(state.timeline.clocks, source.counter.clock(on_epoch))
            run = unwrap(source.counter, last, raw, host_ns, since_boot_ns, lead_ns)
            if run.kept is not None:
                record, host_ns = record[: run.used][run.kept], run.host_ns
        return _Group(source, own, record, host_ns, run, first, total)

    def _decided(self, state: SampleState, msgid: int, own: Column, at: int) -> tuple[SampleState, bool]:
        """A frame out of line: a change of clock, a reboot, or (True) a stray to leave out."""
        source, last, host_ns = self._sources[msgid], state.readings[msgid], int(own.host_ns[at])
        counter = source.counter or Counter(1, 0)
        raw = max(0, int(own.record(source.dtype)[source.time][at].astype(np.int64)))
        if changed_clock(counter, last, raw):
            return replace(state, readings={m: reading for m, reading in state.readings.items() if m != msgid}), False
        timeline, what = out_of_line(state.timeline, counter, raw, host_ns)
        if what is OutOfLine.REBOOT:
            anew = SampleState(timeline, dropped=state.dropped, leaps=state.leaps, contrary=state.contrary)
            return anew, False
        readings = dict(state.readings)
        if what is OutOfLine.STRAY:  # the next decision is due after another second
            readings[msgid] = last._replace(host_ns=host_ns)
        return replace(state, timeline=timeline, readings=readings), True

    def _converted(self, state: SampleState, size: int, groups: Mapping[int, _Group]) -> tuple[SampleState, Telemetry]:
        runs = {m: group.run for m, group in groups.items() if group.run is not None and len(group.record)}
        timeline, times = place(state.timeline, list(runs.values())) if runs else (state.timeline, [])
        when = dict(zip(runs, times, strict=True))
        missing = {m for m, group in groups.items() if group.run is None}
        if missing:
            when |= _times_without_stamp(state.timeline.t_ns, size, when, groups, missing)
        found: dict[Signal, list[tuple[_Group, Part, Series, IntArray | None]]] = {}
        dropped = state.dropped
        with np.errstate(invalid="ignore", over="ignore"):  # NaN and infinity are dropped, not warned of
            for msgid, t_ns in when.items():
                group = groups[msgid]
                for part in group.source.convert(self.profile, group.record):
                    made, rows, unsound = _series(part, t_ns, group.host_ns)
                    dropped += unsound
                    if len(made):
                        found.setdefault(part.signal, []).append((group, part, made, rows))
        series, held, armed_ns, contrary = [], dict(state.held), state.armed_ns, state.contrary
        for signal, parts in found.items():
            _, part, made, _ = parts[0]
            if len(parts) > 1:
                made = merged(signal, [(each, group.places(kept)) for group, _, each, kept in parts])
            if part.held:
                made = replace(made, values=filled(made.values, held.get(signal)))
                held[signal] = made.values[-1]
            if signal is Signal.ARMED:
                beats = len(made)
                made, armed_ns = _steady(made, armed_ns)
                contrary += beats - len(made)
            series += [made] if len(made) else []
        readings, leaps = dict(state.readings), state.leaps
        for msgid, group in groups.items():
            if group.run is not None:
                readings[msgid] = group.run.reading
                leaps += group.run.leaps
        return SampleState(timeline, readings, held, dropped, leaps, armed_ns, contrary), Telemetry(tuple(series))


def _first_placed(timeline: Timeline, own: Column, groups: Mapping[int, _Group]) -> tuple[int, int | None]:
    """From which of its frames on a message can be placed by another's time since boot, and that time there [ns]."""
    known_ns = timeline.since_boot_ns(int(own.host_ns[0]))
    if known_ns is not None:
        return 0, known_ns
    for group in groups.values():
        if group.run is not None and len(group.record) and not group.run.on_epoch:
            first = int(np.searchsorted(own.places, group.column.places[0]))
            since_ns = int(group.run.clock_ns[0]) - int(group.run.host_ns[0])
            return first, since_ns + int(own.host_ns[first]) if first < len(own) else None
    return len(own), None


def _times_without_stamp(
    known_ns: int | None, size: int, when: Mapping[int, IntArray], groups: Mapping[int, _Group], missing: Set[int]
) -> dict[int, IntArray]:
    """For messages without a time of their own the latest vehicle time at their arrival; none before the first stamp.

    known_ns: the latest time before the block. when: the times of its other messages. missing: the messages to place.
    """
    latest = np.full(size, UNSTAMPED if known_ns is None else known_ns)
    for msgid, t_ns in when.items():
        rows = groups[msgid].places()
        latest[rows[len(rows) - len(t_ns) :]] = t_ns
    latest = np.maximum.accumulate(latest)
    return {m: (t_ns := latest[groups[m].column.places])[t_ns > UNSTAMPED] for m in missing}


def _series(part: Part, t_ns: IntArray, host_ns: IntArray) -> tuple[Series, IntArray | None, int]:
    """The sound rows of a part, which they are (None: all), and how many were not.

    t_ns: times of the last rows; those before have none.
    """
    values, keep, unsound = part.values, part.meant, 0
    if not part.finite and not np.isfinite(values).all():
        sound = np.isfinite(values).all(axis=1)
        meant = np.ones_like(sound) if keep is None else keep
        unsound = int(np.count_nonzero(meant & ~sound))
        keep = meant & sound
    untimed = len(host_ns) - len(t_ns)
    if keep is None and not untimed:
        return Series(part.signal, t_ns, host_ns, values), None, unsound
    rows = np.arange(untimed, len(host_ns)) if keep is None else untimed + np.flatnonzero(keep[untimed:])
    return Series(part.signal, t_ns[rows - untimed], host_ns[rows], values[rows]), rows, unsound


def _steady(armed: Series, armed_ns: int) -> tuple[Series, int]:
    """Without the disarmed heartbeats amid armed ones, which are another sender's; and the time of the last armed one.

    armed_ns: when an armed one was received before [ns].
    """
    flying = armed.values[:, 0] > 0.0
    latest = np.maximum.accumulate(np.where(flying, armed.host_ns, armed_ns))
    believed = flying | (armed.host_ns - latest >= DISARMED_NS)
    if believed.all():
        return armed, int(latest[-1])
    steady = Series(armed.signal, armed.t_ns[believed], armed.host_ns[believed], armed.values[believed])
    return steady, int(latest[-1])


def merged(signal: Signal, parts: Sequence[tuple[Series, IntArray]]) -> Series:
    """One series of a signal that several messages carry, in order of arrival. parts: each with its places."""
    order = np.argsort(np.concatenate([places for _, places in parts]), kind="stable")
    columns = [
        np.concatenate([getattr(one, name) for one, _ in parts])[order] for name in ("t_ns", "host_ns", "values")
    ]
    return Series(signal, *columns)


def filled(values: FloatArray, before: FloatArray | None) -> FloatArray:
    """The values with each NaN replaced by the last number in its column. before: the row before them, if any."""
    stacked = values if before is None else np.vstack((before, values))
    rows = np.where(np.isnan(stacked), 0, np.arange(len(stacked))[:, None])
    whole = np.take_along_axis(stacked, np.maximum.accumulate(rows, axis=0), axis=0)
    return whole if before is None else whole[1:]
