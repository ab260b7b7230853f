"""The vehicles of one link and their sessions: bytes and `now` in, effects out. No clock, no socket."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

from detector.pacing import Delay, Pacing, by_waiting
from detector.session import Session
from detector.states import State
from detector.values import Effect, EventOpened, Inbox, LearningFailed, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.link.profiles import Profile
from mavdiag.link.vehicles import Command, LinkDecoder, Received
from mavdiag.telemetry import Instant

__all__ = ["Fleet", "Turn", "Vehicle", "VehicleFigures"]

ALL_IN_EVERY_STEP = Pacing()

SpecOf: TypeAlias = Callable[[Profile], SessionSpec]


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
    """

    vehicle: int
    state: State
    received: int
    lost: int
    gyro_hz: float
    judged_s: float
    events: int


@dataclass(slots=True)
class Vehicle:
    """One vehicle.

    session: its session.
    outcome: what came of its last `Learn`, until the session gets it.
    events: that were opened, so far.
    """

    session: Session
    outcome: Baseline | LearningFailed | None = None
    events: int = 0

    def step(self, received: Received, reboots: int, now: Instant) -> tuple[Effect, ...]:
        """Hand the session what came."""
        inbox = Inbox(received.telemetry, received.present, reboots, received.acks, self.outcome, received.parameters)
        self.outcome = None
        effects = self.session.step(inbox, now)
        self.events += sum(isinstance(effect, EventOpened) for effect in effects)
        return effects


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with a vehicle of a profile.
    profile: of all vehicles, None to go by what each sends.
    only: the one system id to watch, None for all.
    datagrams: whether a chunk of bytes holds whole frames.
    pacing: how long one step may take.
    delay: by how much that puts verdicts off.
    """

    def __init__(
        self,
        spec_of: SpecOf,
        *,
        profile: Profile | None,
        only: int | None,
        datagrams: bool,
        pacing: Pacing = ALL_IN_EVERY_STEP,
    ) -> None:
        self.link = LinkDecoder(profile, only, datagrams)
        self._spec_of, self._pacing = spec_of, pacing
        self.vehicles: dict[int, Vehicle] = {}
        self._judged: dict[int, Instant] = {}
        self.delay = Delay()

    def step(
        self, chunks: Iterable[tuple[bytes, int]], now: Instant, spent_s: Callable[[], float] = lambda: 0.0
    ) -> list[Turn]:
        """Take bytes with their time of arrival. Time alone changes things: call it regularly, without bytes too.

        spent_s: time since the look began [s]; vehicles for which there is none left have their turn in a later step.
        """
        self.link.take(chunks, now.ns)
        streams = self.link.vehicles
        for sysid in streams.keys() - self.vehicles.keys():
            self.vehicles[sysid] = Vehicle(Session(self._spec_of(streams[sysid].profile), now))
            self._judged[sysid] = now
        turns: list[Turn] = []
        for sysid, waited_s in by_waiting(self._judged, now):
            if self._pacing.judges(waited_s, spent_s(), not turns):
                one = self.link.received(sysid)
                turns.append(Turn(sysid, self.vehicles[sysid].step(one, streams[sysid].reboots, now), one.commands))
                self._judged[sysid] = now
                self.delay = self.delay.waited(waited_s)
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
        return VehicleFigures(sysid, state.state, received, lost, state.streams.gyro.rate_hz, judged_s, vehicle.events)
