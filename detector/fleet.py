"""From bytes on a link to sessions: one vehicle a system id, each with its own profile, conversion and state.

A vehicle enters with a heartbeat from its autopilot (component 1), once its profile is clear. Ground stations, cameras
and other companions on the link are not vehicles. No clock, no socket: bytes and `now` in, effects out.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from detector.session import Session
from detector.states import State
from detector.values import Ack, Effect, EventOpened, Inbox, LearningFailed, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.link.codec import Decoder, Frame, field_index
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId
from mavdiag.link.profiles import PROFILES, Profile, detect_profile
from mavdiag.link.samples import Converter, SampleState, by_vehicle
from mavdiag.link.sequence import LinkCount
from mavdiag.telemetry import Instant

__all__ = ["Asked", "Fleet", "PendingVehicle", "Turn", "Vehicle", "VehicleFigures"]

_TYPE, _AUTOPILOT = (field_index(MessageId.HEARTBEAT, name) for name in ("type", "autopilot"))
_ACK_COMMAND, _ACK_RESULT, _ACK_COMPONENT = (
    field_index(MessageId.COMMAND_ACK, name) for name in ("command", "result", "target_component")
)
_COMMANDS: Mapping[int, tuple[int, ...]] = {
    msgid: tuple(field_index(msgid, name) for name in ("command", "target_system", "target_component"))
    for msgid in (MessageId.COMMAND_LONG, MessageId.COMMAND_INT)
}
WATCH_S = 1.0  # how long the messages of a pending vehicle are collected for its profile (our choice)
WAITING_FRAMES = 4096  # of a pending vehicle that are kept
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
class PendingVehicle:
    """A vehicle whose profile is not clear yet. frames: since its first heartbeat."""

    since: Instant
    frames: tuple[Frame, ...]

    @property
    def autopilots(self) -> list[int]:
        """What its autopilot calls itself; empty if no autopilot sent a heartbeat."""
        beats = (frame.fields for frame in self.frames if frame.msgid == MessageId.HEARTBEAT and _is_autopilot(frame))
        return [
            int(fields[_AUTOPILOT])
            for fields in beats
            if fields[_AUTOPILOT] != Autopilot.INVALID and fields[_TYPE] not in _NOT_VEHICLES
        ]

    def profile(self, now: Instant) -> Profile | None:
        """Its profile: by its IMU messages if it sends any, else by its autopilot's name; None while unclear."""
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
    """One vehicle: its session, and what came for it since the last step."""

    def __init__(self, profile: Profile, spec: SessionSpec, now: Instant) -> None:
        self.session = Session(spec, now)
        self._converter = Converter(profile)
        self._frames: list[Frame] = []
        self._samples = SampleState()
        self._outcome: Baseline | LearningFailed | None = None
        self.events = 0

    @property
    def vehicle_ns(self) -> int | None:
        """Latest time of the vehicle's clock, None before its first stamp."""
        return self._samples.timeline.t_ns

    def take(self, frames: Iterable[Frame]) -> None:
        """Frames of this vehicle, in order of arrival."""
        self._frames += frames

    def answer(self, outcome: Baseline | LearningFailed) -> None:
        """What came of the last `Learn`."""
        self._outcome = outcome

    def step(self, now: Instant) -> tuple[Effect, ...]:
        """Hand the session what came."""
        frames, self._frames = self._frames, []
        outcome, self._outcome = self._outcome, None
        self._samples, telemetry = self._converter.step(self._samples, frames)
        alive = any(_is_autopilot(frame) for frame in frames)
        inbox = Inbox(telemetry, alive, self._samples.timeline.reboots, _acks(frames), outcome)
        effects = self.session.step(inbox, now)
        self.events += sum(isinstance(effect, EventOpened) for effect in effects)
        return effects


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with a vehicle of a profile.
    profile: of all vehicles, None to go by what each sends.
    only: the one system id to watch, None for all.
    datagrams: whether a chunk of bytes holds whole frames.
    """

    def __init__(self, spec_of: SpecOf, *, profile: Profile | None, only: int | None, datagrams: bool) -> None:
        wanted = {msgid for one in PROFILES.values() for msgid in Converter(one).wanted}
        self._decoder = Decoder(wanted | {MessageId.COMMAND_ACK} | _COMMANDS.keys())
        self._feed = self._decoder.feed_datagram if datagrams else self._decoder.feed
        self._spec_of, self._profile, self._only = spec_of, profile, only
        self._pending: dict[int, PendingVehicle] = {}
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
        return [Turn(sysid, vehicle.session.finish()) for sysid, vehicle in self.vehicles.items()]

    def figures(self) -> tuple[VehicleFigures, ...]:
        """Where every vehicle stands."""
        senders = self._decoder.senders
        return tuple(self._figures(sysid, senders) for sysid in self.vehicles)

    def _figures(self, sysid: int, senders: Mapping[tuple[int, int], LinkCount]) -> VehicleFigures:
        vehicle, count = self.vehicles[sysid], senders[sysid, Component.AUTOPILOT1]
        state, judge = vehicle.session.state, vehicle.session.state.judge
        judged_s = 0.0 if judge is None else judge.judged_s
        gyro_hz = state.streams.gyro.rate_hz
        return VehicleFigures(sysid, state.state, count.received, count.lost, gyro_hz, judged_s, vehicle.events)

    def _enter(self, sysid: int, frames: list[Frame], now: Instant) -> None:
        """A vehicle that was not known: it is pending until its profile is clear."""
        if sysid == 0:
            return
        before = self._pending.get(sysid, PendingVehicle(now, ()))
        pending = PendingVehicle(before.since, (*before.frames, *frames)[-WAITING_FRAMES:])
        if not pending.autopilots:
            return
        profile = pending.profile(now) if self._profile is None else self._profile
        if profile is None:
            self._pending[sysid] = pending
            return
        self._pending.pop(sysid, None)
        self.vehicles[sysid] = Vehicle(profile, self._spec_of(profile), now)
        self.vehicles[sysid].take(pending.frames)

    def _asked(self, frame: Frame) -> Asked | None:
        """A command for the companion of a vehicle that we watch; one for another companion is left alone."""
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
