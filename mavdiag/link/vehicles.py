"""From the bytes of a link to its vehicles: one a system id, each with its own profile, clock and state.

A vehicle enters with a heartbeat of its autopilot (component 1) that says it is a multirotor, once its frames show its
profile. Ground stations, cameras and other companions on the link are no vehicles. No clock, no socket: bytes and `now`
in, values out.

Made-up senders cost a bounded amount: of each one that has not entered the last 4,096 frames are kept, and 32,768 of
all together. A careful decoder lets a vehicle enter only with two like heartbeats, a fraction of a second to some
seconds apart, and running numbers that are one sender's; and at most so many as it is told.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import repeat
from typing import TypeVar

from mavdiag.airframe.vehicle_type import refusal
from mavdiag.link.addressed import (
    COMMANDS,
    PARAMETER_REQUESTS,
    Ack,
    Command,
    acks_in,
    commands_in,
    parameters_asked_in,
)
from mavdiag.link.codec import Decoder, Frame
from mavdiag.link.evidence import mav_type_of
from mavdiag.link.messages import Component, MessageId
from mavdiag.link.profiles import (
    IMU_MESSAGES,
    PROFILES,
    Profile,
    detect_profile,
)
from mavdiag.link.samples import SampleDecoder, by_vehicle, warm
from mavdiag.link.sequence import Intruder, LinkCount, Source
from mavdiag.link.signing import Signing
from mavdiag.link.stream import CLEAR_FRAMES, VehicleStream
from mavdiag.link.waiting import Waiting
from mavdiag.telemetry import Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["WATCH_S", "Ack", "Command", "LinkDecoder", "Received", "VehicleStream"]

WATCH_S = 1.0  # how long a new vehicle's frames are watched for its profile (our choice)
WAITING_FRAMES = 4096  # of a vehicle that has not entered that are kept (our choice)
WAITING_IN_ALL = 32_768  # of all vehicles that have not entered (our choice)
VEHICLES_MAX = 128  # on one link, unless told otherwise (our choice)
RECHECK_S = 0.5  # how often a vehicle that waits is looked at again (our choice)

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """What came from, or for, one vehicle since the last call.

    frames: the frames of its system id, any component, in order of arrival.
    telemetry: what its autopilot measured.
    present: whether its autopilot sent any of the frames.
    acks: its autopilot's answers to our commands.
    commands: commands of others to its on-board computer.
    parameters: of its autopilot that passed by since the vehicle entered, by name.
    parameter_requests: frames of others that ask for, or set, parameters of its on-board computer.
    """

    frames: tuple[Frame, ...] = ()
    telemetry: Telemetry = field(default_factory=Telemetry)
    present: bool = False
    acks: tuple[Ack, ...] = ()
    commands: tuple[Command, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    parameter_requests: tuple[Frame, ...] = ()


class LinkDecoder:
    """Bytes of one link to what each of its vehicles sent.

    profile: of all vehicles; None to recognise each by its frames.
    only: the one system id to follow, None for all.
    datagrams: whether a chunk of bytes holds whole frames; what a datagram leaves unfinished is never joined to the
    next one, which may be of another sender.
    profiles: the profiles to choose from.
    careful: whether a vehicle must show that it is one before it enters; else one heartbeat will do.
    signing: lets only genuine frames pass; None passes all.
    passed: gets the bytes of every frame that passes, with its time of arrival; None for nobody.
    ours: keys (system id << 8 | component id) that are ours, in whose name nobody else is heard.
    most: how many vehicles may enter.
    vehicles: the stream of each vehicle that has entered, by system id.
    """

    def __init__(
        self,
        profile: Profile | None = None,
        only: int | None = None,
        datagrams: bool = True,
        profiles: Collection[Profile] = tuple(PROFILES.values()),
        *,
        careful: bool = False,
        most: int = VEHICLES_MAX,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
        ours: Collection[int] = (),
    ) -> None:
        warm()
        everyone = profiles if profile is None else (profile,)
        wanted = {msgid for one in everyone for msgid in SampleDecoder(one).wanted}
        others = {MessageId.COMMAND_ACK, MessageId.PARAM_VALUE, MessageId.TIMESYNC}
        wanted |= IMU_MESSAGES.keys() | others | COMMANDS | PARAMETER_REQUESTS
        self._decoder = Decoder(wanted, signing=signing, passed=passed)
        self._decoder.heard.kept = self._kept = set[int]()
        self._decoder.heard.ours = self._ours = set(ours)
        self._decode = self._decoder.feed_datagram if datagrams else self._decoder.feed
        self._profile, self._only, self._profiles, self._careful = profile, only, profiles, careful
        self._most = most
        self._pending: dict[int, Waiting] = {}
        self._frames: dict[int, list[Frame]] = {}
        self._commanded: dict[int, list[Command]] = {}
        self._asked: dict[int, list[Frame]] = {}
        self._latest: dict[int, list[Frame]] = {}
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
        sender = self._decoder.heard.get(sysid, Component.AUTOPILOT1)
        return None if sender is None else sender.count()

    def heard_since(self, host_ns: int) -> list[int]:
        """The vehicles whose autopilots were heard at this time or later [ns]."""
        senders = ((sysid, self._decoder.heard.get(sysid, Component.AUTOPILOT1)) for sysid in self.vehicles)
        return [sysid for sysid, sender in senders if sender is not None and sender.heard_ns >= host_ns]

    def source(self, sysid: int, compid: int = Component.AUTOPILOT1) -> Source:
        """Where a vehicle's autopilot, or another sender, is heard from; None on a link with one other end."""
        sender = self._decoder.heard.get(sysid, compid)
        return None if sender is None else sender.source

    def intruder(self, sysid: int) -> Intruder | None:
        """Who else sends as a vehicle's autopilot; None if nobody does."""
        sender = self._decoder.heard.get(sysid, Component.AUTOPILOT1)
        return None if sender is None else sender.intruder

    def impostor(self, sysid: int) -> Intruder | None:
        """Who sends in our name as a vehicle's on-board computer; None if nobody does."""
        return self._decoder.heard.impostors.get(sysid << 8 | Component.ONBOARD_COMPUTER)

    def give_up(self, sysid: int) -> None:
        """Let others be a vehicle's on-board computer."""
        self._ours.discard(sysid << 8 | Component.ONBOARD_COMPUTER)

    def feed(
        self, chunks: Iterable[tuple[bytes, int]], now_ns: int, sources: Sequence[Source] = ()
    ) -> dict[int, Received]:
        """Take bytes, each with its time of arrival [ns]; return what is new, by system id.

        Only vehicles that have entered are in the result; one that enters now brings its latest frames along.
        sources: where each of the chunks comes from; empty for a link with one other end.
        """
        self.take(chunks, now_ns, sources)
        return {sysid: self.received(sysid) for sysid in sorted(self._waiting())}

    def take(self, chunks: Iterable[tuple[bytes, int]], now_ns: int, sources: Sequence[Source] = ()) -> None:
        """Take bytes as `feed` does; what is for or from vehicles that have entered waits for `received`, which need
        not be called after each `take`."""
        frames: list[Frame] = []
        decoder, decode = self._decoder, self._decode
        pairs = zip(chunks, sources, strict=True) if sources else zip(chunks, repeat(None), strict=False)
        for (data, host_ns), source in pairs:
            decoder.source = source
            frames += decode(data, host_ns)
        own = {sysid: some for sysid, some in by_vehicle(frames).items() if self._only in (None, sysid)}
        for sysid, some in own.items():
            own[sysid] = self._uncontested(sysid, some)
        for sysid in [sysid for sysid in own if sysid and sysid not in self.vehicles]:
            own[sysid] = self._enter(sysid, own[sysid], now_ns)
        self._wait(self._frames, own)
        self._wait(self._commanded, commands_in(frames))
        self._wait(self._asked, parameters_asked_in(frames))

    def received(self, sysid: int) -> Received:
        """What waits of a vehicle that has entered."""
        some = self._frames.pop(sysid, [])
        return Received(
            tuple(some),
            self.vehicles[sysid].step(some),
            any(frame.compid == Component.AUTOPILOT1 for frame in some),
            acks_in(some),
            tuple(self._commanded.pop(sysid, ())),
            self.vehicles[sysid].parameters,
            tuple(self._asked.pop(sysid, ())),
        )

    def leave(self, sysid: int) -> None:
        """Drop what waits of a vehicle that nobody asks for."""
        for waiting in (self._frames, self._commanded, self._asked):
            waiting.pop(sysid, None)

    def _wait(self, waiting: dict[int, list[_T]], found: Mapping[int, list[_T]]) -> None:
        for sysid in found.keys() & self.vehicles.keys():
            waiting.setdefault(sysid, []).extend(found[sysid])

    def _waiting(self) -> set[int]:
        return self._frames.keys() | self._commanded.keys() | self._asked.keys()

    def _uncontested(self, sysid: int, frames: list[Frame]) -> list[Frame]:
        """Without the autopilot's frames that two senders claim by one running number.

        Once that has happened, the latest frame waits for the one that may contest it.
        """
        sender = self._decoder.heard.get(sysid, Component.AUTOPILOT1)
        if sender is None or not sender.clashes:
            return frames
        contested, sender.contested = sender.contested, set()
        frames = [*self._latest.pop(sysid, ()), *frames]
        sound = [frame for frame in frames if frame.compid != Component.AUTOPILOT1 or frame.seq not in contested]
        self._latest[sysid] = sound[-1:]
        return sound[:-1]

    def _enter(self, sysid: int, frames: list[Frame], now_ns: int) -> list[Frame]:
        """Let a vehicle enter if its profile is clear; return the frames that it brings along then."""
        pending = self._pending.setdefault(sysid, Waiting(now_ns))
        kept = min(WAITING_FRAMES, WAITING_IN_ALL // len(self._pending))
        frames = [frame for frame in frames if frame.compid == Component.AUTOPILOT1]
        pending.frames = [*pending.frames, *frames][-kept:]
        pending.note(frames)
        watched = now_ns - pending.since_ns >= WATCH_S * NS_PER_S or len(pending.frames) >= min(kept, CLEAR_FRAMES)
        if pending.beat is None or (self._profile is None and not watched) or not self._may_enter(sysid, pending):
            return []
        if pending.checked_ns is not None and now_ns - pending.checked_ns < RECHECK_S * NS_PER_S:
            return []
        pending.checked_ns = now_ns
        if refused := refusal(mav_type_of(pending.beat)):
            pending.reason, pending.frames = refused, []
            return []
        profile = self._profile
        if profile is None:
            recognised = detect_profile([pending.beat, *pending.frames], self._profiles)
            profile, pending.reason = recognised.profile, recognised.reason
        if profile is None:
            return []
        self.vehicles[sysid] = VehicleStream(profile)
        self._kept.add(sysid << 8 | Component.AUTOPILOT1)
        del self._pending[sysid]
        return pending.frames

    def _may_enter(self, sysid: int, pending: Waiting) -> bool:
        """Whether one that sends a vehicle's heartbeat is taken for a vehicle, and there is room for it."""
        if self._careful:
            sender = self._decoder.heard.get(sysid, Component.AUTOPILOT1)
            if pending.beats < 2 or sender is None or not sender.sound:
                return False
        if len(self.vehicles) >= self._most:
            pending.reason, pending.frames = f"there are {self._most} vehicles already (max_vehicles)", []
            return False
        return True
