"""The vehicles of one link and their sessions: bytes and `now` in, effects out. No clock, no socket."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TypeAlias

from detector.session import Session
from detector.states import State
from detector.values import Effect, EventOpened, Inbox, LearningFailed, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.link.profiles import Profile
from mavdiag.link.timesync import Timesync, exchanged
from mavdiag.link.vehicles import Command, LinkDecoder, Received
from mavdiag.telemetry import Instant

__all__ = ["Fleet", "Turn", "Vehicle", "VehicleFigures"]

SpecOf: TypeAlias = Callable[[Profile], SessionSpec]
NOT_ASKED = Timesync()


@dataclass(frozen=True, slots=True)
class Turn:
    """What came of one vehicle's step.

    vehicle: system id.
    effects: what its session wants done.
    commands: of others to its companion, which we are.
    """

    vehicle: int
    effects: tuple[Effect, ...]
    commands: tuple[Command, ...] = ()


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """One vehicle at a moment.

    vehicle: system id.
    state: of its session.
    received, lost: its autopilot's frames, so far.
    gyro_hz: measured rate of the gyro.
    judged_s, events: so far.
    timesync: round trip and offset of the vehicle's clock, as asked last.
    drift_ppm: of the first clock of its messages against another one; None if they have one clock.
    """

    vehicle: int
    state: State
    received: int
    lost: int
    gyro_hz: float
    judged_s: float
    events: int
    timesync: Timesync = NOT_ASKED
    drift_ppm: float | None = None


@dataclass(slots=True)
class Vehicle:
    """One vehicle.

    session: its session.
    outcome: what came of its last `Learn`, until the session gets it.
    events: that were opened, so far.
    timesync: what is known of its clock by asking; asked and answered where we may negotiate.
    """

    session: Session
    outcome: Baseline | LearningFailed | None = None
    events: int = 0
    timesync: Timesync = field(default_factory=Timesync)

    def step(self, received: Received, reboots: int, now: Instant) -> tuple[Effect, ...]:
        """Hand the session what came."""
        inbox = Inbox(received.telemetry, received.present, reboots, received.acks, self.outcome, received.parameters)
        self.outcome = None
        effects = self.session.step(inbox, now)
        self.events += sum(isinstance(effect, EventOpened) for effect in effects)
        if not self.session.spec.settings.negotiate:
            return effects
        self.timesync, messages = exchanged(self.timesync, received.frames, now.ns, alive=received.present)
        return (*effects, *messages)


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with a vehicle of a profile.
    profile: of all vehicles, None to go by what each sends.
    only: the one system id to watch, None for all.
    datagrams: whether a chunk of bytes holds whole frames.
    """

    def __init__(self, spec_of: SpecOf, *, profile: Profile | None, only: int | None, datagrams: bool) -> None:
        self.link = LinkDecoder(profile, only, datagrams)
        self._spec_of = spec_of
        self.vehicles: dict[int, Vehicle] = {}

    def step(self, chunks: Iterable[tuple[bytes, int]], now: Instant) -> list[Turn]:
        """Take bytes with their time of arrival. Time alone changes things: call it regularly, without bytes too."""
        received, streams = self.link.feed(chunks, now.ns), self.link.vehicles
        for sysid in streams.keys() - self.vehicles.keys():
            self.vehicles[sysid] = Vehicle(Session(self._spec_of(streams[sysid].profile), now))
        turns: list[Turn] = []
        for sysid, vehicle in self.vehicles.items():
            one = received.get(sysid, Received())
            turns.append(Turn(sysid, vehicle.step(one, streams[sysid].reboots, now), one.commands))
        return turns

    def finish(self) -> list[Turn]:
        """What is left to say when the daemon stops."""
        return [Turn(sysid, vehicle.session.finish()) for sysid, vehicle in self.vehicles.items()]

    def figures(self) -> tuple[VehicleFigures, ...]:
        """Where every vehicle stands."""
        return tuple(self._figures(sysid) for sysid in self.vehicles)

    def _figures(self, sysid: int) -> VehicleFigures:
        vehicle, count = self.vehicles[sysid], self.link.count(sysid)
        state = vehicle.session.state
        received, lost = (count.received, count.lost) if count else (0, 0)
        judged_s = 0.0 if state.judge is None else state.judge.judged_s
        gyro_hz, drift_ppm = state.streams.gyro.rate_hz, self.link.vehicles[sysid].timeline.drift_ppm
        figures = (sysid, state.state, received, lost, gyro_hz, judged_s, vehicle.events)
        return VehicleFigures(*figures, vehicle.timesync, drift_ppm)
