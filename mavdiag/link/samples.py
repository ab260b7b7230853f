"""Frames of one vehicle to telemetry in SI on one timeline, a block at a time.

    state = SampleState()
    state, telemetry = decoder.step(state, frames)

What a message means is in `conversion`, when it was is in `clock`; here they are put together. How the frames are cut
into blocks does not matter.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mavdiag.link.batch import Batch, batch_of
from mavdiag.link.clock import NEVER, VehicleTime
from mavdiag.link.codec import Frame
from mavdiag.link.conversion import SOURCES, Part, Source, euler_angles, sources
from mavdiag.link.profiles import Profile
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

DISARMED_NS = 3 * NS_PER_S // 2  # without an armed heartbeat before a disarmed one is believed: they come each second


@dataclass(frozen=True, slots=True)
class SampleState:
    """What one vehicle's conversion carries from block to block.

    timeline: where its time stands.
    held: last known row of the signals whose messages carry only some of the columns.
    dropped: rows with NaN, infinity or a zero quaternion so far.
    armed_ns: when the latest armed heartbeat was received [ns].
    contrary: disarmed heartbeats amid armed ones, left out so far.
    """

    timeline: VehicleTime = field(default_factory=VehicleTime)
    held: Mapping[Signal, FloatArray] = field(default_factory=dict, compare=False)
    dropped: int = 0
    armed_ns: int = NEVER
    contrary: int = 0

    @property
    def leaps(self) -> int:
        """Samples left out because their stamps leap, so far."""
        return self.timeline.leaps


def warm() -> None:
    """Compile what converts frames, or load it from disk, before the first of them comes: seconds, or half of one."""
    none = np.empty(0, np.int64)
    VehicleTime().stamped(np.zeros((1, 3), np.int64), none, none, none)
    euler_angles(np.empty((0, 4)))


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


class SampleDecoder:
    """Turns one vehicle's frames into telemetry, by its profile. Holds nothing but the profile; the state is passed.

    profile: how the vehicle sends.
    signals: those of interest; messages without any of them are passed over.
    table: the messages that are known.
    wanted: the message ids that it reads, for the decoder of frames.
    Only the autopilot's own frames (component 1) count. Frames of SERVO_OUTPUT_RAW are left out until another message
    has given the time since boot. A block costs some 50 us however short it is.
    """

    def __init__(
        self, profile: Profile, signals: Collection[Signal] = tuple(Signal), table: Iterable[Source] = SOURCES
    ) -> None:
        self.profile = profile
        self._sources: dict[int, Source] = {row.message: row for row in sources(profile, signals, table)}
        self.wanted = frozenset(self._sources)
        counters = [(msgid, row.counter) for msgid, row in self._sources.items()]
        self._messages = np.array(
            [(msgid, c.tick_ns, c.turn) if c else (msgid, 0, 0) for msgid, c in counters], np.int64
        ).reshape(-1, 3)
        self._rows = {msgid: number for number, msgid in enumerate(self._sources)}

    def step(self, state: SampleState, frames: Sequence[Frame]) -> tuple[SampleState, Telemetry]:
        """Take the next frames of one vehicle, in order of arrival."""
        return self.step_batch(state, batch_of(frames, self.wanted))

    def step_batch(self, state: SampleState, batch: Batch) -> tuple[SampleState, Telemetry]:
        """As `step`, for frames that are laid out message by message."""
        frames, done, pieces = self._stamps(batch), 0, []
        while done < batch.size:
            timeline, t_ns, taken = state.timeline.stamped(self._messages, *frames[:, done:])
            stretch = batch if taken == batch.size else batch.part(done, done + taken)
            state, piece = self._converted(state, timeline, stretch, t_ns)
            pieces.append(piece)
            done += taken
            if done < batch.size:  # the vehicle started anew
                state = replace(state, held={}, armed_ns=NEVER)
        return state, joined(pieces)

    def _stamps(self, batch: Batch) -> IntArray:
        """(3, n): message, count and time of arrival of each frame, as `VehicleTime.stamped` takes them."""
        frames = np.empty((3, batch.size), np.int64)
        rows, raw, host_ns = frames
        rows.fill(-1)
        for msgid, column in batch.columns.items():
            source = self._sources.get(msgid)
            if source is not None:
                rows[column.places], host_ns[column.places] = self._rows[msgid], column.host_ns
                if source.counter:
                    raw[column.places] = column.record(source.dtype)[source.time]
        return frames

    def _converted(
        self, state: SampleState, timeline: VehicleTime, batch: Batch, times_ns: IntArray
    ) -> tuple[SampleState, Telemetry]:
        found: dict[Signal, list[tuple[Part, Series, IntArray]]] = {}
        dropped, all_timed = state.dropped, bool(times_ns.min(initial=0) > NEVER)
        with np.errstate(invalid="ignore", over="ignore"):  # NaN and infinity are dropped, not warned of
            for msgid, column in batch.columns.items():
                source = self._sources.get(msgid)
                if source is None:
                    continue
                places, host_ns, record = column.places, column.host_ns, column.record(source.dtype)
                t_ns = times_ns[places]
                if not all_timed:
                    timed = t_ns > NEVER
                    places, host_ns, record, t_ns = places[timed], host_ns[timed], record[timed], t_ns[timed]
                for part in source.convert(self.profile, record) if len(record) else ():
                    rows, unsound = _sound(part)
                    dropped += unsound
                    if rows is None:
                        made = Series(part.signal, t_ns, host_ns, part.values)
                    else:
                        made = Series(part.signal, t_ns[rows], host_ns[rows], part.values[rows])
                    if len(made):
                        found.setdefault(part.signal, []).append((part, made, places if rows is None else places[rows]))
        series, held, armed_ns, contrary = [], dict(state.held), state.armed_ns, state.contrary
        for signal, parts in found.items():
            part, made, _ = parts[0]
            if len(parts) > 1:
                made = merged(signal, [(each, places) for _, each, places in parts])
            if part.held:
                made = replace(made, values=filled(made.values, held.get(signal)))
                held[signal] = made.values[-1]
            if signal is Signal.ARMED:
                beats = len(made)
                made, armed_ns = _steady(made, armed_ns)
                contrary += beats - len(made)
            series += [made] if len(made) else []
        return SampleState(timeline, held, dropped, armed_ns, contrary), Telemetry(tuple(series))


def _sound(part: Part) -> tuple[IntArray | None, int]:
    """The rows of a part that are meant and sound, None for all, and how many are meant and not sound."""
    keep, unsound = part.meant, 0
    if not part.finite and not np.isfinite(part.values).all():
        sound = np.isfinite(part.values).all(axis=1)
        meant = np.ones_like(sound) if keep is None else keep
        unsound = int(np.count_nonzero(meant & ~sound))
        keep = meant & sound
    return None if keep is None else np.flatnonzero(keep), unsound


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
