"""From the bytes of a link to its vehicles: one a system id, each with its own profile, clock and state.

A vehicle enters with a heartbeat of its autopilot (component 1) that says it is a multirotor, once its frames show its
profile. No clock, no socket: bytes and `now` in, values out. Made-up senders cost a bounded amount; a careful decoder
lets a vehicle enter only with two like heartbeats and running numbers that are one sender's.
"""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mavdiag.airframe.vehicle_type import refusal
from mavdiag.link.backlog import Backlog
from mavdiag.link.codec import (
    AUTOPILOT,
    MSGIDS,
    NO_FRAMES,
    ROWS,
    Decoder,
    Frame,
    Frames,
    field_index,
    frames_joined,
    frames_of,
    layout_of,
)
from mavdiag.link.datagrams import Datagrams
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId, ModeFlag
from mavdiag.link.parameters import ASKING as PARAMETERS_ASKED
from mavdiag.link.parameters import parameters_in
from mavdiag.link.profiles import IMU_MESSAGES, LAST_RESORT, PROFILES, Evidence, Profile, detect_profile, with_imu
from mavdiag.link.samples import SOURCES, SampleDecoder, SampleState, warm
from mavdiag.link.samples import Source as Measured
from mavdiag.link.sequence import LinkCount, Source
from mavdiag.link.signing import Signing
from mavdiag.telemetry import BoolArray, IntArray, Signal, Telemetry
from mavdiag.units import NS_PER_S

WATCH_S = 1.0  # how long a new vehicle's frames are watched for its profile (our choice)
WAITING_FRAMES = 4096  # of a vehicle that has not entered that are kept (our choice)
WAITING_IN_ALL = 32_768  # of all vehicles that have not entered (our choice)
VEHICLES_MAX = 128  # on one link, unless told otherwise (our choice)
PUZZLED_S = 5.0  # without entering although it sends, until that is said (our choice)
RECHECK_S = 0.5  # how often a vehicle that waits is looked at again (our choice)
BEATS_S = (0.2, 10.0)  # how far two heartbeats are apart that show a vehicle: it sends one a second (our choice)
CLEAR_FRAMES = 512  # of a vehicle that are enough to see its profile (our choice)
LAST_RESORT_S = 30.0  # without any IMU message, before the rates of ATTITUDE are read instead (our choice)
LOOK_NS = NS_PER_S // 20  # of a log that is taken at once, as live, where another gyro may be chosen (our choice)
USEFUL_FRAMES = 20  # of an IMU message, before it is taken at once (our choice)
CHOICE_S = 1.0  # for which the choice stays open otherwise, from the first IMU message of any kind on (our choice)
STOPPED_S = 3.0  # for which another IMU message must be the only one that comes, or the better one (our choice)
REQUESTS_MAX = 16  # requests to one vehicle's computer at a time: a flood is not answered (our choice)
MOST_PARAMETERS = 8192  # names that are kept of one vehicle, so that made-up ones cost little (our choice)

#: Messages that carry a command.
COMMANDS = frozenset({MessageId.COMMAND_LONG, MessageId.COMMAND_INT})
#: ... and all that ask something of a component.
ASKING = COMMANDS | PARAMETERS_ASKED
#: Messages that tell where a pilot's sticks are, with the fields of four of them and the positions that these may have.
#: Any other value says that there is none: not known, ignored, released, or a receiver that lost the pilot and says so
#: by a pulse below ArduPilot's FS_THR_VALUE, 975 us as it comes. The longest one is that of RCn_MAX.
STICKS: Mapping[int, tuple[tuple[str, ...], range]] = {
    MessageId.MANUAL_CONTROL: (("x", "y", "z", "r"), range(-1000, 1001)),
    **dict.fromkeys(
        (MessageId.RC_CHANNELS, MessageId.RC_CHANNELS_OVERRIDE),
        (tuple(f"chan{n}_raw" for n in range(1, 5)), range(975, 2201)),
    ),
}
_ANSWERS = {MessageId.COMMAND_ACK, MessageId.PARAM_VALUE, MessageId.TIMESYNC, MessageId.AUTOPILOT_VERSION}
_TALK = ASKING | STICKS.keys() | _ANSWERS | {MessageId.HEARTBEAT}
_TALKS = np.isin(MSGIDS, list(_TALK))  # by row of a message

#: The IMU messages that number their sensors, with the byte that does so.
_NUMBERED = {one: layout_of(one).offset("id")[0] for one in (MessageId.RAW_IMU, MessageId.HIGHRES_IMU)}
_UID2 = field_index(MessageId.AUTOPILOT_VERSION, "uid2")


@dataclass(frozen=True, slots=True)
class Ack:
    """What an autopilot answered to a command of ours: MAV_CMD and MAV_RESULT."""

    command: int
    result: int


@dataclass(frozen=True, slots=True)
class Command:
    """A command (MAV_CMD), who sent it, its first parameter, and how often it was sent before, if that is told."""

    command: int
    sysid: int
    compid: int
    parameter: float = 0.0
    confirmation: int = 0


def acks_in(frames: Iterable[Frame]) -> tuple[Ack, ...]:
    """The autopilot's acknowledgements to us (or to nobody in particular, as MAVLink 1 has it)."""
    found = []
    for frame in frames:
        if frame.msgid == MessageId.COMMAND_ACK and frame.compid == AUTOPILOT:
            system, component = frame.numbers("target_system", "target_component")
            if component in (Component.ALL, Component.ONBOARD_COMPUTER) and system in (0, frame.sysid):
                found.append(Ack(*frame.numbers("command", "result")))
    return tuple(found)


def mode_in(frames: Iterable[Frame]) -> int | None:
    """The custom_mode of the autopilot's latest heartbeat; None without one, or if it has none."""
    beats = [frame for frame in frames if frame.msgid == MessageId.HEARTBEAT and frame.compid == AUTOPILOT]
    if not beats:
        return None
    base, custom = beats[-1].numbers("base_mode", "custom_mode")
    return custom if base & ModeFlag.CUSTOM_MODE_ENABLED else None


def sticks_in(frames: Iterable[Frame], compid: int | None = AUTOPILOT) -> dict[tuple[int, str], int]:
    """The latest positions of sticks, by message and field. compid: of who tells them, None for anybody.

    Pulses [us] of RC_CHANNELS and RC_CHANNELS_OVERRIDE, -1000..1000 of MANUAL_CONTROL.
    """
    found = dict[tuple[int, str], int]()
    for frame in frames:
        if frame.msgid in STICKS and compid in (None, frame.compid):
            names, positions = STICKS[frame.msgid]
            told = zip(names, frame.numbers(*names), strict=True)
            found |= {(frame.msgid, name): at for name, at in told if at in positions}
    return found


def asked_of(frame: Frame) -> int | None:
    """The system id of the vehicle whose on-board computer a frame asks something of; None for any other frame.

    Who asks all components of it for parameters asks that one, too.
    """
    if frame.msgid not in ASKING:
        return None
    system, component = frame.numbers("target_system", "target_component")
    reads = frame.msgid in (MessageId.PARAM_REQUEST_LIST, MessageId.PARAM_REQUEST_READ)
    return system if component == Component.ONBOARD_COMPUTER or (reads and component == Component.ALL) else None


def command_in(frame: Frame) -> Command | None:
    """The command in a frame; None for a frame without one."""
    if frame.msgid not in COMMANDS:
        return None
    confirmation = frame.value("confirmation") if frame.msgid == MessageId.COMMAND_LONG else 0
    return Command(frame.value("command"), frame.sysid, frame.compid, frame.value("param1"), confirmation)


def uid_in(frames: Iterable[Frame]) -> str:
    """What AUTOPILOT_VERSION calls the autopilot's board: uid2 (ArduPilot has no other), else uid, hexadecimal.

    Zeros at the end of uid2 are left out; empty if no autopilot told it.
    """
    told = [one for one in frames if one.msgid == MessageId.AUTOPILOT_VERSION and one.compid == AUTOPILOT]
    for frame in told:
        if uid2 := bytes(int(one) for one in frame.fields[_UID2:]).rstrip(b"\0"):
            return uid2.hex()
        if (uid := frame.numbers("uid")[0]) != 0:
            return f"{uid:016x}"
    return ""


class VehicleStream:
    """One vehicle's frames to telemetry, on one clock.

    profile: how it sends; another IMU message is read while no gyro sample comes of its own.
    sensor: number of the one whose rows of that message are read; 0 but where only another one's come.
    mav_type: MAV_TYPE, if known. uid: the latest, as in `uid_in`. parameters: of its autopilot that passed by, by name.
    """

    def __init__(self, profile: Profile, mav_type: int | None = None) -> None:
        self.mav_type, self.uid, self.sensor = mav_type, "", 0
        self._decoder, self.state = SampleDecoder(profile), SampleState()
        self._own, self._since_ns = profile, 0
        self._imu = NO_FRAMES.rows
        self._settled = False  # whether the IMU message is chosen
        self._worse_ns = 0  # since when another one is the better choice, or the only one that comes; 0 if none is
        self._least = 255  # number of a sensor that came since
        self.parameters: Mapping[str, float] = {}

    @property
    def profile(self) -> Profile:
        """The profile, with the IMU message that is read."""
        return self._decoder.profile

    def step(self, frames: Frames, talk: Sequence[Frame] = ()) -> Telemetry:
        """Take the vehicle's next frames, in order of arrival. talk: those of them that are no measurements."""
        if not self._settled and len(frames):
            self._choose_imu(frames)
        self.uid = (uid_in(talk) if talk else "") or self.uid
        if talk and (told := parameters_in(talk, self.profile.autopilot)):
            merged = {**self.parameters, **told}
            self.parameters = merged if len(merged) <= MOST_PARAMETERS else self.parameters
            self.state.take_parameters(self.parameters)
        read = frames
        if self.sensor:
            read = frames.where((frames.rows["row"] != ROWS[self.profile.imu]) | self._reads(frames))
        telemetry = self._decoder.step(self.state, read)
        if (self.profile.imu, self.sensor) == (self._own.imu, 0) and telemetry.get(Signal.BODY_RATE) is not None:
            self._worse_ns = 0
        elif self._settled and len(imus := frames.of(*IMU_MESSAGES)):
            self._choose_again(imus)
        return telemetry

    def take_log(self, frames: Frames) -> Iterator[Telemetry]:
        """Take many frames, as of a log: at once, but look by look where another gyro may have to be chosen."""
        at_ns, done = frames.rows["host_ns"], 0
        if not self._settled:
            imus = len(frames.of(*IMU_MESSAGES))
            cuts = np.flatnonzero(np.diff((at_ns - at_ns[:1]) // round(WATCH_S * NS_PER_S))) + 1
            for cut in (*cuts.tolist(), len(frames)):
                if not self._settled and (imus or self.profile.imu != LAST_RESORT):
                    yield self.step(frames.where(slice(done, cut)))
                    done = cut
        yield from self._looked(frames.where(slice(done, None)))

    def _looked(self, frames: Frames) -> Iterator[Telemetry]:
        cut, imus = len(frames) // 2, frames.of(*IMU_MESSAGES)
        at_ns, imu_ns, read, counts = frames.rows["host_ns"], imus.rows["host_ns"], self._reads(imus), imus.counts()
        latest = np.maximum.accumulate(np.where(read, np.arange(1, len(imus) + 1), 0))  # that is read, 0 for none
        alone_ns = imu_ns - np.append(self._worse_ns or at_ns[:1], imu_ns)[latest]
        best = with_imu(self._own, counts).imu == self.profile.imu and read.sum() == counts[self.profile.imu]
        best = best or (self.profile.imu, self.sensor) == (self._own.imu, 0)
        steady = best and alone_ns.max(initial=0) < STOPPED_S * NS_PER_S
        if not len(imus) or (steady and alone_ns[-1] < LOOK_NS) or cut == 0 or np.ptp(at_ns) < LOOK_NS:
            yield self.step(frames)
        else:
            for part in (slice(cut), slice(cut, None)):
                yield from self._looked(frames.where(part))

    def _choose_again(self, imus: Frames) -> None:
        """Take another message, or another sensor's rows of the same, once it was the better choice for `STOPPED_S`."""
        first_ns, last_ns = imus.rows["host_ns"][[0, -1]].tolist()
        if not self._worse_ns:
            self._worse_ns, self._imu, self._least = first_ns, imus.rows[:0], 255
        self._imu = np.concatenate((self._imu, imus.rows))[-CLEAR_FRAMES:]
        counts = Frames(imus.data, self._imu).counts()
        chosen = with_imu(self._own, counts)
        better, sensor, latest = imus.of(chosen.imu), 0, 0
        if chosen.imu in _NUMBERED:
            latest = int(_sensors(better, chosen.imu).min(initial=255))
            self._least = sensor = min(self._least, latest)
        waited_s = (last_ns - self._worse_ns) / NS_PER_S
        if (chosen.imu, sensor) == (self.profile.imu, self.sensor):
            self._worse_ns = 0
        elif len(better) and latest == sensor and waited_s > STOPPED_S and counts[chosen.imu] >= USEFUL_FRAMES:
            self.sensor, self._worse_ns = sensor, 0
            self._decoder = SampleDecoder(chosen, map(_any_sensor, SOURCES) if sensor else SOURCES)

    def _reads(self, frames: Frames) -> BoolArray:
        """Which of them the gyro is read from."""
        own: BoolArray = frames.rows["row"] == ROWS[self.profile.imu]
        if self.profile.imu in _NUMBERED:
            own[own] = _sensors(frames.where(own), self.profile.imu) == self.sensor
        return own

    def _choose_imu(self, frames: Frames) -> None:
        self._imu = np.concatenate((self._imu, frames.of(*IMU_MESSAGES).rows))[-CLEAR_FRAMES:]
        seen = Frames(frames.data, self._imu)
        counts, times_ns = seen.counts(), self._imu["host_ns"]
        chosen = with_imu(self._own, counts, USEFUL_FRAMES)
        host_ns = frames.rows["host_ns"]
        self._since_ns = self._since_ns or int(host_ns[0])
        waited_ns = int(host_ns[-1]) - self._since_ns
        if not counts and (waited_ns > LAST_RESORT_S * NS_PER_S or self.profile.imu == LAST_RESORT):
            chosen = replace(self._own, imu=LAST_RESORT, accel_unit=1.0, gyro_unit=1.0)
        if chosen.imu != self.profile.imu:
            self._decoder = SampleDecoder(chosen)
        told_s = int(times_ns[-1] - times_ns[0]) / NS_PER_S if counts else 0.0
        self._settled = counts[chosen.imu] >= USEFUL_FRAMES or (counts[chosen.imu] > 0 and told_s >= CHOICE_S)


def _talk(frames: Frames) -> tuple[Frame, ...]:
    """Those that are no measurements."""
    talks = _TALKS[frames.rows["row"]]
    return tuple(frames.where(talks)) if talks.any() else ()


def _sensors(frames: Frames, message: MessageId) -> IntArray:
    """The number that each frame of such a message has; 0 where the zeros at its end were trimmed."""
    at, found = frames.rows["body"].astype(np.int64) + _NUMBERED[message], np.zeros(len(frames), np.int64)
    there = at < frames.rows["stop"]
    found[there] = frames.data[at[there]]
    return found


def _any_sensor(row: Measured) -> Measured:
    """A row of the table, of an IMU message that numbers its sensors whichever it is."""
    parts = tuple(replace(part, unless=None) for part in row.parts)
    return replace(row, parts=parts) if row.message in _NUMBERED else row


@dataclass(slots=True)
class _Waiting:
    since_ns: int  # it is watched
    pieces: list[Frames] = field(default_factory=list)  # its autopilot's latest frames, and how many they are
    count: int = 0
    mute: bool = True  # whether no heartbeat came of that one, of whatever kind
    beat: Frame | None = None  # its latest heartbeat
    kind: tuple[int, int] = (0, 0)  # its MAV_TYPE and MAV_AUTOPILOT
    beats: int = 0  # how many like it came, each at its time after the one before
    checked_ns: int | None = None  # when its profile was looked for last
    reason: str = ""  # why it waits though its autopilot was received

    def take(self, frames: Frames, kept: int) -> None:
        """Take in its autopilot's next frames, with bytes of their own; so many of the latest ones are kept."""
        if not len(frames):
            return
        latest = frames.where(slice(-kept, None))
        self.pieces.append(Frames(np.frombuffer(latest.data.tobytes(), np.uint8), latest.rows.copy()))
        self.count += len(latest)
        while self.count - len(self.pieces[0]) >= kept:
            self.count -= len(self.pieces.pop(0))
        for frame in frames.of(MessageId.HEARTBEAT):
            self.mute = False
            self._note(frame)

    def _note(self, frame: Frame) -> None:
        kind, autopilot = frame.numbers("type", "autopilot")
        if autopilot == Autopilot.INVALID or kind in (MavType.GCS, MavType.ONBOARD_CONTROLLER):
            return
        span_s = math.inf if self.beat is None else (frame.host_ns - self.beat.host_ns) / NS_PER_S
        if (kind, autopilot) != self.kind or span_s > BEATS_S[1]:
            self.beat, self.beats, self.kind = frame, 1, (kind, autopilot)
        elif span_s >= BEATS_S[0]:
            self.beat, self.beats = frame, self.beats + 1


@dataclass(slots=True)
class _Unread:
    """What came from, or for, a vehicle that has entered, until it is asked for, but for frames in the backlog."""

    pieces: list[Frames] = field(default_factory=list)  # before those
    asked: list[Frame] = field(default_factory=list)
    urgent: bool = False  # whether a command or a TIMESYNC waits, which want an answer


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """What came from, or for, one vehicle since the last call."""

    telemetry: Telemetry = field(default_factory=Telemetry)
    alive: bool = False  # whether its autopilot sent any frame
    reboots: int = 0  # all so far
    acks: tuple[Ack, ...] = ()  # its autopilot's answers to our commands
    parameters: Mapping[str, float] = field(default_factory=dict)  # of its autopilot that passed by so far, by name
    imu: MessageId | None = None  # the message that its gyro is read from; None for the profile's
    sensor: int = 0  # number of the one that it is of
    mode: int | None = None  # custom_mode of its latest heartbeat; None if none came
    sticks: Mapping[tuple[int, str], int] = field(default_factory=dict)  # a pilot's; see `sticks_in`
    asked: tuple[Frame, ...] = ()  # what others ask of its on-board computer
    frames: tuple[Frame, ...] = ()  # of its system id, any component, that are no measurements, in order of arrival


class LinkDecoder:
    """Bytes of one link to what each of its vehicles sent.

    profile: of all vehicles; None to recognise each by its frames. only: the one system id to follow, None for all.
    datagrams: whether a chunk holds whole frames. careful: a vehicle must show that it is one before it enters.
    most: how many may enter. signing, passed: as in `Decoder`. ours: keys (system id << 8 | component id) in whose name
    nobody else is heard. decoder: of the link's frames. vehicles: those that have entered, by system id.
    """

    def __init__(
        self,
        profile: Profile | None = None,
        only: int | None = None,
        datagrams: bool = True,
        *,
        careful: bool = False,
        most: int = VEHICLES_MAX,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
        ours: Collection[int] = (),
    ) -> None:
        warm()
        chosen = PROFILES.values() if profile is None else (profile,)
        wanted = {msgid for one in chosen for msgid in SampleDecoder(one).wanted}
        self.decoder = Decoder(wanted | IMU_MESSAGES.keys() | _TALK, signing, passed)
        self.decoder.heard.claim(ours)
        self._profile, self._only, self._careful = profile, only, careful
        self._most, self._datagrams = most, datagrams
        self._waiting: dict[int, _Waiting] = {}
        self._unread = defaultdict[int, _Unread](_Unread)
        self._latest: dict[int, Frames] = {}
        self._backlog = Backlog()  # of vehicles that nobody contests
        self.vehicles: dict[int, VehicleStream] = {}

    @property
    def waiting(self) -> Mapping[int, str]:
        """Why a vehicle has not entered, by system id, one sentence each; of those whose autopilot was received."""
        return {sysid: waiting.reason for sysid, waiting in self._waiting.items() if waiting.reason}

    @property
    def babble(self) -> str:
        """What to do where no vehicle entered and most bytes are in no frame; empty elsewhere."""
        few = 2 * self.decoder.garbage_bytes <= self.decoder.size
        return "" if few or self.vehicles else "bytes come that are no MAVLink frames: is the baud rate the vehicle's?"

    def count(self, sysid: int, compid: int = AUTOPILOT) -> LinkCount:
        """What came from a vehicle's autopilot, or another sender, so far."""
        return self.decoder.heard.count(sysid << 8 | compid) or LinkCount()

    def sources_since(self, host_ns: int) -> list[Source]:
        """Where the vehicles are heard from whose autopilots were heard at this time or later [ns]."""
        counts = map(self.count, self.vehicles)
        return list(dict.fromkeys(count.source for count in counts if count.heard_ns >= host_ns))

    def source(self, sysid: int, compid: int = AUTOPILOT) -> Source:
        """Where a vehicle's autopilot, or another sender, is heard from; None on a link with one other end."""
        return self.decoder.heard.source(sysid << 8 | compid)

    def claim(self, sysid: int, *, ours: bool) -> None:
        """Hear nobody else as a vehicle's on-board computer, or let others be it."""
        self.decoder.heard.claim((sysid << 8 | Component.ONBOARD_COMPUTER,), ours=ours)

    def feed(self, some: Datagrams, now_ns: int) -> dict[int, Received]:
        """Take what the link brought; return what is new, by vehicle that has entered."""
        self.take(some, now_ns)
        return {sysid: self.received(sysid) for sysid in sorted({*self._unread, *self._backlog.sysids})}

    def take(self, some: Datagrams, now_ns: int) -> None:
        """Take what `feed` does; what is for or from vehicles that have entered waits for `received`."""
        frames = self.decoder.take(some, datagrams=self._datagrams)
        if not len(frames):
            return
        clashed = {key >> 8 for key in self.decoder.heard.clashed if key & 0xFF == AUTOPILOT}
        for sysid in clashed.intersection(self.vehicles):  # what waits came before
            self._unread[sysid].pieces.append(self._backlog.take(sysid))
        self._backlog.put(frames)
        others = [sysid for sysid in self._backlog.sysids if sysid not in self.vehicles or sysid in clashed]
        for sysid in others:
            self._file(sysid, self._backlog.take(sysid), sysid in clashed, now_ns)
        if others:
            self._backlog.make_room()
        self._take_talk(_talk(frames))

    def _file(self, sysid: int, frames: Frames, clashes: bool, now_ns: int) -> None:
        """Let frames wait without those that two senders claim; see whether a vehicle may enter."""
        if not sysid or self._only not in (None, sysid):
            return
        pieces = self._uncontested(sysid, frames) if clashes else [frames]
        if sysid not in self.vehicles:
            pieces = self._enter(sysid, pieces, now_ns)
        if sysid in self.vehicles:
            self._unread[sysid].pieces += pieces

    def _take_talk(self, frames: Iterable[Frame]) -> None:
        """Hand out what is asked of on-board computers, at most `REQUESTS_MAX` to each; note who wants an answer."""
        for frame in frames:
            sysid = asked_of(frame)
            if sysid is not None and sysid in self.vehicles:
                unread = self._unread[sysid]
                unread.asked += [frame] if len(unread.asked) < REQUESTS_MAX else []
                unread.urgent = True
            elif frame.msgid == MessageId.TIMESYNC and frame.sysid in self.vehicles:
                self._unread[frame.sysid].urgent = True

    def received(self, sysid: int) -> Received:
        """What waits of a vehicle that has entered."""
        unread, stream = self._unread.pop(sysid, _Unread()), self.vehicles[sysid]
        frames = frames_joined([*unread.pieces, self._backlog.take(sysid)])
        talk = _talk(frames)
        alive = bool((frames.rows["sender"] & 0xFF == AUTOPILOT).any())
        telemetry = stream.step(frames, talk)
        told = (acks_in(talk), stream.parameters, stream.profile.imu, stream.sensor, mode_in(talk), sticks_in(talk))
        return Received(telemetry, alive, stream.state.timeline.reboots, *told, tuple(unread.asked), talk)

    def urgent(self) -> set[int]:
        """The vehicles for or from which something waits that wants an answer."""
        return {sysid for sysid, unread in self._unread.items() if unread.urgent}

    def leave(self, sysid: int) -> None:
        """Drop what waits of a vehicle that nobody asks for."""
        self._unread.pop(sysid, None)
        self._backlog.take(sysid)

    def _uncontested(self, sysid: int, frames: Frames) -> list[Frames]:
        """Without the autopilot's frames that two senders claim; then the latest one waits for what may contest it."""
        contested, sound = self.decoder.heard.contested(sysid << 8 | AUTOPILOT), []
        for piece in (self._latest.pop(sysid, NO_FRAMES), frames):
            rows = piece.rows
            sound.append(piece.where((rows["sender"] & 0xFF != AUTOPILOT) | ~np.isin(rows["seq"], contested)))
        last = sound[-1] if len(sound[-1]) else sound[0]
        self._latest[sysid] = last.where(slice(-1, None))
        return [piece.where(slice(None, -1)) if piece is last else piece for piece in sound]

    def _enter(self, sysid: int, pieces: Iterable[Frames], now_ns: int) -> list[Frames]:
        """Let a vehicle enter if its profile is clear; return the frames that it brings along then."""
        waiting = self._waiting.setdefault(sysid, _Waiting(now_ns))
        kept = min(WAITING_FRAMES, WAITING_IN_ALL // len(self._waiting))
        for piece in pieces:
            waiting.take(piece.where(piece.rows["sender"] & 0xFF == AUTOPILOT), kept)
        waited_s = (now_ns - waiting.since_ns) / NS_PER_S
        watched = waited_s >= WATCH_S or waiting.count >= min(kept, CLEAR_FRAMES)
        if waiting.mute and waiting.count and waited_s >= PUZZLED_S:
            waiting.reason = "no heartbeat of its autopilot comes; does a router hold it back?"
        if (
            waiting.beat is None
            or (self._profile is None and not watched)
            or not self._may_enter(sysid, waiting, waited_s)
        ):
            return []
        if waiting.checked_ns is not None and now_ns - waiting.checked_ns < RECHECK_S * NS_PER_S:
            return []
        waiting.checked_ns, profile = now_ns, self._profile
        if refused := refusal(waiting.kind[0]):
            waiting.reason = refused
            return []
        if profile is None:
            shown = frames_joined([frames_of([waiting.beat]), *waiting.pieces])
            profile, why = detect_profile(Evidence().take(shown))
            waiting.reason = why and f"{why}; give --profile"
        if profile is None:
            return []
        self.vehicles[sysid] = VehicleStream(profile, waiting.kind[0])
        self.decoder.heard.keep(sysid << 8 | AUTOPILOT)
        del self._waiting[sysid]
        return waiting.pieces

    def _may_enter(self, sysid: int, waiting: _Waiting, waited_s: float) -> bool:
        one_sender = not self._careful or self.decoder.heard.sound(sysid << 8 | AUTOPILOT)
        if not one_sender or (self._careful and waiting.beats < 2):
            if waited_s >= PUZZLED_S:
                which = "heartbeats contradict each other" if one_sender else "frames are numbered as of two senders"
                waiting.reason = f"its {which}: does another vehicle use this system id?"
            return False
        if len(self.vehicles) >= self._most:
            waiting.reason = f"there are {self._most} vehicles already (max_vehicles)"
            return False
        return True
