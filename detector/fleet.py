"""From bytes on a link to sessions: one vehicle a system id, each with its own profile, conversion and state.

A vehicle enters with a heartbeat from its autopilot (component 1), once it is clear what profile it speaks. Ground
stations, cameras and other companions on the link are not vehicles. No clock, no socket: bytes and `now` in, effects
out.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from detector import session
from detector.effects import Effect, EventOpened
from detector.negotiate import Ack
from detector.states import State
from detector.values import Inbox, Learned, LearningFailed, SessionSpec, SessionState
from mavdiag.link.codec import Decoder, Frame, field_index
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId
from mavdiag.link.profiles import PROFILES, Profile, detect_profile
from mavdiag.link.samples import Converter, SampleState, by_vehicle
from mavdiag.link.sequence import LinkCount
from mavdiag.telemetry import Instant

__all__ = ["Asked", "Fleet", "Newcomer", "Turn", "Vehicle", "VehicleFigures"]

_TYPE, _AUTOPILOT = (field_index(MessageId.HEARTBEAT, name) for name in ("type", "autopilot"))
_ACK_COMMAND, _ACK_RESULT, _ACK_COMPONENT = (
    field_index(MessageId.COMMAND_ACK, name) for name in ("command", "result", "target_component")
)
_COMMANDS: Mapping[int, tuple[int, ...]] = {
    msgid: tuple(field_index(msgid, name) for name in ("command", "target_system", "target_component"))
    for msgid in (MessageId.COMMAND_LONG, MessageId.COMMAND_INT)
}
WATCH_S = 1.0  # how long a newcomer's messages are watched for its profile (our choice)
WAITING_FRAMES = 4096  # of a newcomer that are kept meanwhile
_NOT_VEHICLES = (MavType.GCS, MavType.ONBOARD_CONTROLLER)

SpecOf: TypeAlias = Callable[[Profile], SessionSpec]


@dataclass(frozen=True, slots=True)
class Asked:
    """A command that was addressed to us, by whom, and as which vehicle's companion."""

    command: int
    vehicle: int
    sysid: int
    compid: int


@dataclass(frozen=True, slots=True)
class Turn:
    """What one vehicle's session wants done."""

    vehicle: int
    effects: tuple[Effect, ...]


@dataclass(frozen=True, slots=True)
class Newcomer:
    """A vehicle whose profile is not clear yet. frames: since its first heartbeat."""

    since: Instant
    frames: tuple[Frame, ...]

    @property
    def autopilots(self) -> list[int]:
        """What its autopilot calls itself; empty if no autopilot was heard."""
        beats = (frame.fields for frame in self.frames if frame.msgid == MessageId.HEARTBEAT and _is_autopilot(frame))
        return [
            int(fields[_AUTOPILOT])
            for fields in beats
            if fields[_AUTOPILOT] != Autopilot.INVALID and fields[_TYPE] not in _NOT_VEHICLES
        ]

    def profile(self, now: Instant) -> Profile | None:
        """How it speaks: by its IMU messages if it sends any, else by its autopilot's name; None while unclear."""
        imu = sum(frame.msgid in (MessageId.RAW_IMU, MessageId.HIGHRES_IMU) for frame in self.frames)
        if now - self.since < WATCH_S and imu < WAITING_FRAMES // 2:
            return None
        if imu >= 2:
            return PROFILES[detect_profile(self.frames)]
        named = (profile for profile in PROFILES.values() if profile.autopilot in self.autopilots)
        return next(named, PROFILES["qdrone2"])


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """One vehicle at a moment. received, lost: its autopilot's frames, so far; judged_s, events: so far."""

    vehicle: int
    state: State
    received: int
    lost: int
    gyro_hz: float
    judged_s: float
    events: int


class Vehicle:
    """One vehicle: what waits to be looked at, and the session's state."""

    def __init__(self, profile: Profile, spec: SessionSpec, now: Instant) -> None:
        self.spec = spec
        self._converter = Converter(profile)
        self._frames: list[Frame] = []
        self._samples = SampleState()
        self._outcome: Learned | LearningFailed | None = None
        self.events = 0
        self.state: SessionState = session.start(spec, now)

    @property
    def vehicle_ns(self) -> int | None:
        """Latest time of the vehicle's clock, None before its first stamp."""
        return self._samples.timeline.t_ns

    def take(self, frames: Iterable[Frame]) -> None:
        """Frames of this vehicle, in order of arrival."""
        self._frames += frames

    def answer(self, outcome: Learned | LearningFailed) -> None:
        """What came of the last `Learn`."""
        self._outcome = outcome

    def step(self, now: Instant) -> tuple[Effect, ...]:
        """Let the session see what came."""
        frames, self._frames = self._frames, []
        outcome, self._outcome = self._outcome, None
        self._samples, telemetry = self._converter.step(self._samples, frames)
        heard = any(_is_autopilot(frame) for frame in frames)
        inbox = Inbox(telemetry, heard, self._samples.timeline.reboots, _acks(frames), outcome)
        self.state, effects = session.step(self.spec, self.state, inbox, now)
        self.events += sum(isinstance(effect, EventOpened) for effect in effects)
        return effects


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with a vehicle of a profile. profile: how all of them speak, None to go by each heartbeat.
    only: the one system id to watch, None for all. datagrams: whether a chunk of bytes holds whole frames.
    """

    def __init__(self, spec_of: SpecOf, *, profile: Profile | None, only: int | None, datagrams: bool) -> None:
        wanted = {msgid for one in PROFILES.values() for msgid in Converter(one).wanted}
        self._decoder = Decoder(wanted | {MessageId.COMMAND_ACK} | _COMMANDS.keys())
        self._feed = self._decoder.feed_datagram if datagrams else self._decoder.feed
        self._spec_of, self._profile, self._only = spec_of, profile, only
        self._newcomers: dict[int, Newcomer] = {}
        self.vehicles: dict[int, Vehicle] = {}

    @property
    def decoder(self) -> Decoder:
        """The link's decoder, for its counts."""
        return self._decoder

    def feed(self, chunks: Iterable[tuple[bytes, int]], now: Instant) -> list[Asked]:
        """Take bytes with their time of arrival; return the commands that are meant for us."""
        frames = [frame for data, host_ns in chunks for frame in self._feed(data, host_ns)]
        for sysid, own in by_vehicle(frames).items():
            if self._only is None or sysid == self._only:
                if sysid in self.vehicles:
                    self.vehicles[sysid].take(own)
                else:
                    self._enter(sysid, own, now)
        return [asked for frame in frames if frame[0] in _COMMANDS and (asked := self._asked(frame)) is not None]

    def step(self, now: Instant) -> list[Turn]:
        """Let every session go on; time alone changes things, so call it regularly."""
        return [Turn(sysid, vehicle.step(now)) for sysid, vehicle in self.vehicles.items()]

    def finish(self) -> list[Turn]:
        """What is left to say when the daemon stops."""
        return [Turn(sysid, session.finish(vehicle.state)) for sysid, vehicle in self.vehicles.items()]

    def figures(self) -> tuple[VehicleFigures, ...]:
        """Where every vehicle stands."""
        senders = self._decoder.senders
        return tuple(self._figures(sysid, senders) for sysid in self.vehicles)

    def _figures(self, sysid: int, senders: Mapping[tuple[int, int], LinkCount]) -> VehicleFigures:
        vehicle, count = self.vehicles[sysid], senders[sysid, Component.AUTOPILOT1]
        state, judge = vehicle.state, vehicle.state.judge
        judged_s = 0.0 if judge is None else judge.judged_s
        gyro_hz = state.streams.gyro.rate_hz
        return VehicleFigures(sysid, state.state, count.received, count.lost, gyro_hz, judged_s, vehicle.events)

    def _enter(self, sysid: int, frames: list[Frame], now: Instant) -> None:
        """A vehicle that was not known: it waits at the door until its profile is clear."""
        if sysid == 0:
            return
        known = self._newcomers.get(sysid)
        newcomer = Newcomer(now, ()) if known is None else known
        newcomer = Newcomer(newcomer.since, (*newcomer.frames, *frames)[-WAITING_FRAMES:])
        profile = newcomer.profile(now) if self._profile is None else self._profile
        if not newcomer.autopilots:
            return
        if profile is None:
            self._newcomers[sysid] = newcomer
            return
        self._newcomers.pop(sysid, None)
        self.vehicles[sysid] = Vehicle(profile, self._spec_of(profile), now)
        self.vehicles[sysid].take(newcomer.frames)

    def _asked(self, frame: Frame) -> Asked | None:
        """A command for the companion of a vehicle that we watch; for anybody else's it is none of our business."""
        fields = frame.fields
        command, system, component = (int(fields[place]) for place in _COMMANDS[frame.msgid])
        if component != Component.ONBOARD_COMPUTER or system not in self.vehicles:
            return None
        return Asked(command, system, frame.sysid, frame.compid)


def _is_autopilot(frame: Frame) -> bool:
    return frame.compid == Component.AUTOPILOT1


def _acks(frames: Iterable[Frame]) -> tuple[Ack, ...]:
    """The autopilot's acknowledgements to us (or to nobody in particular, as MAVLink 1 has it)."""
    found: list[Ack] = []
    for frame in frames:
        if frame.msgid == MessageId.COMMAND_ACK and _is_autopilot(frame):
            fields = frame.fields
            if fields[_ACK_COMPONENT] in (Component.ALL, Component.ONBOARD_COMPUTER):
                found.append(Ack(int(fields[_ACK_COMMAND]), int(fields[_ACK_RESULT])))
    return tuple(found)
