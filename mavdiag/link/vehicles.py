"""From the bytes of a link to its vehicles: one a system id, each with its own profile, clock and state.

A vehicle enters with a heartbeat of its autopilot (component 1), once its frames show its profile. Ground stations,
cameras and other companions on the link are no vehicles. No clock, no socket: bytes and `now` in, values out.

Made-up senders cost a bounded amount: of each one that has not entered the last 4,096 frames are kept, and 32,768 of
all together.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from mavdiag.link.codec import Decoder, Frame, field_index
from mavdiag.link.messages import Component, MessageId
from mavdiag.link.parameters import with_parameters
from mavdiag.link.profiles import IMU_MESSAGES, PROFILES, Profile, detect_profile, is_autopilot_heartbeat, with_imu
from mavdiag.link.samples import SampleDecoder, SampleState, by_vehicle
from mavdiag.link.sequence import LinkCount
from mavdiag.link.timeline import Timeline
from mavdiag.telemetry import Signal, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["WATCH_S", "Ack", "Command", "LinkDecoder", "Received", "VehicleStream"]

WATCH_S = 1.0  # how long a new vehicle's frames are watched for its profile (our choice)
CLEAR_FRAMES = 512  # of a vehicle that are enough to see its profile (our choice)
WAITING_FRAMES = 4096  # of a vehicle that has not entered that are kept (our choice)
WAITING_IN_ALL = 32_768  # of all vehicles that have not entered (our choice)
USEFUL_FRAMES = 20  # of another IMU message than the profile's own, before it is taken instead (our choice)

_ACK_COMMAND, _ACK_RESULT, _ACK_COMPONENT = (
    field_index(MessageId.COMMAND_ACK, name) for name in ("command", "result", "target_component")
)
_COMMANDS: Mapping[int, tuple[int, ...]] = {
    msgid: tuple(field_index(msgid, name) for name in ("command", "target_system", "target_component"))
    for msgid in (MessageId.COMMAND_LONG, MessageId.COMMAND_INT)
}


@dataclass(frozen=True, slots=True)
class Ack:
    """What an autopilot answered to a command of ours.

    command: MAV_CMD.
    result: MAV_RESULT.
    """

    command: int
    result: int


@dataclass(frozen=True, slots=True)
class Command:
    """A command that was addressed to a vehicle's on-board computer.

    command: MAV_CMD.
    sysid, compid: who sent it.
    """

    command: int
    sysid: int
    compid: int


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """What came from, or for, one vehicle since the last call.

    frames: the frames of its system id, any component, in order of arrival.
    telemetry: what its autopilot measured.
    present: whether its autopilot sent any of the frames.
    acks: its autopilot's answers to our commands.
    commands: commands of others to its on-board computer.
    parameters: of its autopilot that passed by since the vehicle entered, by name.
    """

    frames: tuple[Frame, ...] = ()
    telemetry: Telemetry = field(default_factory=Telemetry)
    present: bool = False
    acks: tuple[Ack, ...] = ()
    commands: tuple[Command, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)


class VehicleStream:
    """One vehicle's frames to telemetry, on one clock.

    profile: how it sends; while no gyro sample has come, its IMU message is replaced by another that does come.
    signals: those of interest.
    parameters: of its autopilot that passed by so far, by name.
    """

    def __init__(self, profile: Profile, signals: Collection[Signal] = tuple(Signal)) -> None:
        self._signals = signals
        self._decoder = SampleDecoder(profile, signals)
        self._state = SampleState()
        self._imu: list[Frame] = []
        self._settled = False  # whether the IMU message is chosen for good
        self.parameters: Mapping[str, float] = {}

    @property
    def profile(self) -> Profile:
        """The profile, with the IMU message that is read."""
        return self._decoder.profile

    @property
    def timeline(self) -> Timeline:
        """Where the vehicle's time stands."""
        return self._state.timeline

    @property
    def vehicle_ns(self) -> int | None:
        """Latest time of the vehicle's clock [ns], None before its first stamp."""
        return self._state.timeline.t_ns

    @property
    def reboots(self) -> int:
        """How often it started anew."""
        return self._state.timeline.reboots

    @property
    def dropped(self) -> int:
        """Samples left out for NaN, infinity or a zero quaternion so far."""
        return self._state.dropped

    def step(self, frames: Sequence[Frame]) -> Telemetry:
        """Take the vehicle's next frames, in order of arrival."""
        if not self._settled:
            self._choose_imu(frames)
        self.parameters = with_parameters(self.parameters, frames, self.profile.autopilot)
        self._state, telemetry = self._decoder.step(self._state, frames)
        return telemetry

    def _choose_imu(self, frames: Sequence[Frame]) -> None:
        self._imu = [*self._imu, *(frame for frame in frames if frame.msgid in IMU_MESSAGES)][-CLEAR_FRAMES:]
        chosen = with_imu(self.profile, self._imu, USEFUL_FRAMES)
        if chosen is not self.profile:
            self._decoder = SampleDecoder(chosen, self._signals)
        self._settled = any(frame.msgid == chosen.imu and frame.compid == Component.AUTOPILOT1 for frame in self._imu)
        if self._settled:
            self._imu = []


@dataclass(slots=True)
class _Pending:
    """A system id that has not entered.

    since_ns: since when it is watched [ns].
    frames: its latest.
    beat: its autopilot's latest heartbeat.
    reason: why it waits though its autopilot was received.
    """

    since_ns: int
    frames: list[Frame] = field(default_factory=list)
    beat: Frame | None = None
    reason: str = ""


class LinkDecoder:
    """Bytes of one link to what each of its vehicles sent.

    profile: of all vehicles; None to recognise each by its frames.
    only: the one system id to follow, None for all.
    datagrams: whether a chunk of bytes holds whole frames; what a datagram leaves unfinished is never joined to the
    next one, which may be of another sender.
    profiles: the profiles to choose from.
    vehicles: the stream of each vehicle that has entered, by system id.
    """

    def __init__(
        self,
        profile: Profile | None = None,
        only: int | None = None,
        datagrams: bool = True,
        profiles: Collection[Profile] = tuple(PROFILES.values()),
    ) -> None:
        everyone = profiles if profile is None else (profile,)
        wanted = {msgid for one in everyone for msgid in SampleDecoder(one).wanted}
        others = {MessageId.COMMAND_ACK, MessageId.PARAM_VALUE}
        self._decoder = Decoder(wanted | IMU_MESSAGES.keys() | others | _COMMANDS.keys())
        self._decode = self._decoder.feed_datagram if datagrams else self._decoder.feed
        self._profile, self._only, self._profiles = profile, only, profiles
        self._pending: dict[int, _Pending] = {}
        self._frames: dict[int, list[Frame]] = {}
        self._commanded: dict[int, list[Command]] = {}
        self.vehicles: dict[int, VehicleStream] = {}

    @property
    def decoder(self) -> Decoder:
        """The decoder of the link's frames, for its counts."""
        return self._decoder

    @property
    def waiting(self) -> Mapping[int, str]:
        """Why a vehicle has not entered, by system id, one sentence each; of those whose autopilot was received."""
        return {sysid: pending.reason for sysid, pending in self._pending.items() if pending.reason}

    def count(self, sysid: int) -> LinkCount | None:
        """What came from one vehicle's autopilot so far; None if nothing did."""
        return self._decoder.senders.get((sysid, Component.AUTOPILOT1))

    def feed(self, chunks: Iterable[tuple[bytes, int]], now_ns: int) -> dict[int, Received]:
        """Take bytes, each with its time of arrival [ns]; return what is new, by system id.

        Only vehicles that have entered are in the result; one that enters now brings its latest frames along.
        """
        self.take(chunks, now_ns)
        return {sysid: self.received(sysid) for sysid in sorted(self._frames.keys() | self._commanded.keys())}

    def take(self, chunks: Iterable[tuple[bytes, int]], now_ns: int) -> None:
        """Take bytes, each with its time of arrival [ns]; the frames of vehicles that have entered wait for
        `received`, which need not be called after each `take`."""
        frames = [frame for data, host_ns in chunks for frame in self._decode(data, host_ns)]
        own = {sysid: some for sysid, some in by_vehicle(frames).items() if self._only in (None, sysid)}
        for sysid in [sysid for sysid in own if sysid and sysid not in self.vehicles]:
            own[sysid] = self._enter(sysid, own[sysid], now_ns)
        for sysid in own.keys() & self.vehicles.keys():
            self._frames.setdefault(sysid, []).extend(own[sysid])
        for sysid, commands in self._commands(frames).items():
            self._commanded.setdefault(sysid, []).extend(commands)

    def received(self, sysid: int) -> Received:
        """What waits of a vehicle that has entered."""
        some = self._frames.pop(sysid, [])
        return Received(
            tuple(some),
            self.vehicles[sysid].step(some),
            any(frame.compid == Component.AUTOPILOT1 for frame in some),
            _acks(some),
            tuple(self._commanded.pop(sysid, ())),
            self.vehicles[sysid].parameters,
        )

    def _enter(self, sysid: int, frames: list[Frame], now_ns: int) -> list[Frame]:
        """Let a vehicle enter if its profile is clear; return the frames that it brings along then."""
        pending = self._pending.setdefault(sysid, _Pending(now_ns))
        kept = min(WAITING_FRAMES, WAITING_IN_ALL // len(self._pending))
        pending.frames = [*pending.frames, *frames][-kept:]
        pending.beat = next(filter(is_autopilot_heartbeat, reversed(frames)), pending.beat)
        watched = now_ns - pending.since_ns >= WATCH_S * NS_PER_S or len(pending.frames) >= min(kept, CLEAR_FRAMES)
        if pending.beat is None or (self._profile is None and not watched):
            return []
        profile = self._profile
        if profile is None:
            recognised = detect_profile([pending.beat, *pending.frames], self._profiles)
            profile, pending.reason = recognised.profile, recognised.reason
        if profile is None:
            return []
        self.vehicles[sysid] = VehicleStream(profile)
        del self._pending[sysid]
        return pending.frames

    def _commands(self, frames: Iterable[Frame]) -> dict[int, list[Command]]:
        """Commands to the on-board computers of vehicles that have entered, by the vehicle's system id."""
        found: dict[int, list[Command]] = {}
        for frame in frames:
            if frame.msgid in _COMMANDS:
                fields = frame.fields
                command, system, component = (int(fields[place]) for place in _COMMANDS[frame.msgid])
                if component == Component.ONBOARD_COMPUTER and system in self.vehicles:
                    found.setdefault(system, []).append(Command(command, frame.sysid, frame.compid))
        return found


def _acks(frames: Iterable[Frame]) -> tuple[Ack, ...]:
    """The autopilot's acknowledgements to us (or to nobody in particular, as MAVLink 1 has it)."""
    found: list[Ack] = []
    for frame in frames:
        if frame.msgid == MessageId.COMMAND_ACK and frame.compid == Component.AUTOPILOT1:
            fields = frame.fields
            if fields[_ACK_COMPONENT] in (Component.ALL, Component.ONBOARD_COMPUTER):
                found.append(Ack(int(fields[_ACK_COMMAND]), int(fields[_ACK_RESULT])))
    return tuple(found)
