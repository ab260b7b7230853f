"""The vehicles of one link and their sessions: bytes and `now` in, effects out. No clock, no socket."""

import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from detector.latency import Awaiting
from detector.pacing import STOP_S, Delay, Pacing, by_turns
from detector.session import Session
from detector.states import State
from detector.streams import METERED
from detector.values import Effect, EventOpened, Inbox, LearningFailed, Note, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import NOTHING_SEEN, Diagnosis
from mavdiag.link.clock import Timesync, exchanged
from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component
from mavdiag.link.profiles import Profile
from mavdiag.link.sequence import Source
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import VEHICLES_MAX, Command, LinkDecoder, Received, VehicleStream
from mavdiag.telemetry import Instant, IntArray, Signal

__all__ = ["Fleet", "Turn", "Vehicle", "VehicleFigures"]

ALL_IN_EVERY_STEP = Pacing()

SpecOf: TypeAlias = Callable[[Profile], SessionSpec]
Adapt: TypeAlias = Callable[[int, SessionSpec], SessionSpec | None]
NOT_ASKED = Timesync()


def _no_times() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """What came of one vehicle's step.

    vehicle: system id.
    effects: what its session wants done.
    commands: of others to its companion, which we are.
    parameter_requests: of others about its companion's parameters.
    arrived_ns, judged_ns: when the gyro samples came that were taken in this step, and those that have their verdict
        now (host clock); empty if it is not measured.
    """

    vehicle: int
    effects: tuple[Effect, ...]
    commands: tuple[Command, ...] = ()
    parameter_requests: tuple[Frame, ...] = ()
    arrived_ns: IntArray = field(default_factory=_no_times)
    judged_ns: IntArray = field(default_factory=_no_times)


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """One vehicle at a moment.

    vehicle: system id.
    state: of its session.
    diagnosis: what is held of it.
    received, lost: its autopilot's frames, so far.
    gyro_hz: measured rate of the gyro.
    judged_s, events: so far.
    flight_s: flight time so far.
    rates: measured rate of each stream that is metered [Hz].
    ratios: statistic over threshold of each monitor and axis that is valid now.
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
    flight_s: float = 0.0
    rates: tuple[tuple[str, float], ...] = ()
    ratios: tuple[tuple[str, str, float], ...] = ()
    timesync: Timesync = NOT_ASKED
    drift_ppm: float | None = None
    diagnosis: Diagnosis = NOTHING_SEEN

    @property
    def working(self) -> bool:
        """Whether its session does its work or still may."""
        return self.state is not State.FAULTED


@dataclass(slots=True)
class Vehicle:
    """One vehicle.

    session: its session.
    outcome: what came of its last `Learn`, until the session gets it.
    events: that were opened, so far.
    awaiting: samples whose verdict is waited for; None if that is not measured.
    timesync: what is known of its clock by asking; asked and answered where we may negotiate.
    """

    session: Session
    outcome: Baseline | LearningFailed | None = None
    events: int = 0
    awaiting: Awaiting | None = None
    timesync: Timesync = field(default_factory=Timesync)

    def step(self, received: Received, stream: VehicleStream, now: Instant) -> tuple[Effect, ...]:
        """Hand the session what came. stream: the vehicle's."""
        inbox = Inbox(
            received.telemetry,
            received.present,
            stream.state.timeline.reboots,
            received.acks,
            self.outcome,
            received.parameters,
            stream.profile.imu,
        )
        self.outcome = None
        effects = self.session.step(inbox, now)
        self.events += sum(isinstance(effect, EventOpened) for effect in effects)
        if not self.session.spec.settings.negotiate:
            return effects
        self.timesync, messages = exchanged(self.timesync, received.frames, now.ns, alive=received.present)
        return (*effects, *messages)

    def times_ns(self, received: Received, now: Instant) -> tuple[IntArray, IntArray]:
        """When samples came that were taken, and those that have their verdict now; empty if it is not measured."""
        if self.awaiting is None:
            return _no_times(), _no_times()
        gyro, judge = received.telemetry.get(Signal.BODY_RATE), self.session.state.judge
        upto_ns = None if judge is None else judge.memory.now_ns
        self.awaiting, judged_ns = self.awaiting.step(gyro, upto_ns, now.ns)
        return _no_times() if gyro is None else gyro.host_ns, judged_ns

    def restart(self, spec: SessionSpec, now: Instant) -> tuple[Effect, ...]:
        """Begin a new session in place of the present one; return what that leaves to record."""
        left, reboots = self.session.finish(), self.session.state.reboots
        self.session, self.outcome = Session(replace(spec, held=self.session.state.diagnosis), now), None
        self.session.state = replace(self.session.state, reboots=reboots)
        return left


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with a vehicle of a profile.
    profile: of all vehicles, None to go by what each sends.
    only: the one system id to watch, None for all.
    datagrams: whether a chunk of bytes holds whole frames.
    adapt: what is different for the vehicle of a system id; None for one that is left alone.
    most: how many vehicles may enter.
    measured: whether the time from a sample to its verdict is measured.
    pacing: how long one step may take.
    signing, passed: as in `LinkDecoder`.
    vehicles: those that are watched, by system id.
    delay: by how much the pacing puts verdicts off.
    """

    def __init__(
        self,
        spec_of: SpecOf,
        *,
        profile: Profile | None,
        only: int | None,
        datagrams: bool,
        adapt: Adapt = lambda sysid, spec: spec,
        most: int = VEHICLES_MAX,
        measured: bool = False,
        pacing: Pacing = ALL_IN_EVERY_STEP,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
    ) -> None:
        ours = [sysid << 8 | Component.ONBOARD_COMPUTER for sysid in (range(1, 256) if only is None else (only,))]
        self.link = LinkDecoder(
            profile, only, datagrams, careful=True, most=most, signing=signing, passed=passed, ours=ours
        )
        self._spec_of, self._adapt, self._measured, self._pacing = spec_of, adapt, measured, pacing
        self._left: set[int] = set()
        self.vehicles: dict[int, Vehicle] = {}
        self._judged: dict[int, Instant] = {}
        self.delay = Delay()

    def step(
        self,
        chunks: Iterable[tuple[bytes, int]],
        now: Instant,
        sources: Sequence[Source] = (),
        *,
        spent_s: Callable[[], float] = lambda: 0.0,
    ) -> list[Turn]:
        """Take bytes with their time of arrival. Time alone changes things: call it regularly, without bytes too.

        sources: where each chunk comes from; empty for a link with one other end.
        spent_s: time since the look began [s]; vehicles for which there is none left have their turn in a later step.
        """
        self.link.take(chunks, now.ns, sources)
        streams = self.link.vehicles
        for sysid in streams.keys() - self.vehicles.keys() - self._left:
            spec = self._adapt(sysid, self._spec_of(streams[sysid].profile))
            if spec is None:
                self._left.add(sysid)
                self.link.give_up(sysid)
            else:
                awaiting = Awaiting() if self._measured else None
                self.vehicles[sysid] = Vehicle(Session(spec, now), awaiting=awaiting)
                self._judged[sysid] = now
        for sysid in self._left:
            self.link.leave(sysid)
        turns: list[Turn] = []
        for sysid, waited_s in by_turns(self._judged, now, self.link.source):
            if self._pacing.judges(waited_s, spent_s(), not turns):
                turns.append(self._parted(sysid, now, partial(self._turn, sysid, now)))
                self._judged[sysid] = now
                self.delay = self.delay.waited(waited_s)
        return turns

    def finish(self, now: Instant, *, spent_s: Callable[[], float] = lambda: 0.0) -> list[Turn]:
        """Judge what waits, and what is left to say when the daemon stops.

        spent_s: time since the end began [s]; what still waits after `STOP_S` is not judged.
        """
        waiting = (sysid for sysid, _ in by_turns(self._judged, now, self.link.source))
        judged = [self._parted(sysid, now, partial(self._turn, sysid, now)) for sysid in waiting if spent_s() < STOP_S]
        return [*judged, *(self._parted(sysid, now, partial(self._last_turn, sysid)) for sysid in self.vehicles)]

    def _last_turn(self, sysid: int) -> Turn:
        return Turn(sysid, self.vehicles[sysid].session.finish())

    def _turn(self, sysid: int, now: Instant) -> Turn:
        vehicle, one = self.vehicles[sysid], self.link.received(sysid)
        effects = vehicle.step(one, self.link.vehicles[sysid], now)
        return Turn(sysid, effects, one.commands, one.parameter_requests, *vehicle.times_ns(one, now))

    def _parted(self, sysid: int, now: Instant, work: Callable[[], Turn]) -> Turn:
        """What comes of one vehicle's work. An error of the program takes this vehicle off, and no other."""
        try:
            return work()
        except Exception as error:  # noqa: BLE001  # whatever is wrong with one vehicle, the others are watched on
            place = traceback.extract_tb(error.__traceback__)[-1]
            effects = self.vehicles[sysid].session.broken(f"{type(error).__name__}: internal error", now)
            where = f"{Path(place.filename).name}:{place.lineno}"
            note = Note(f"watching vehicle {sysid} ended by an error of the program: {error!r} at {where}")
            return Turn(sysid, (note, *effects) if effects else ())

    def figures(self) -> tuple[VehicleFigures, ...]:
        """Where every vehicle stands."""
        return tuple(self.figures_of(sysid) for sysid in self.vehicles)

    def figures_of(self, sysid: int) -> VehicleFigures:
        """Where one vehicle stands."""
        vehicle, count = self.vehicles[sysid], self.link.count(sysid)
        state, judge = vehicle.session.state, vehicle.session.state.judge
        gauges = () if judge is None else judge.gauges
        return VehicleFigures(
            sysid,
            state.state,
            received=count.received if count else 0,
            lost=count.lost if count else 0,
            gyro_hz=state.streams.gyro.rate_hz,
            judged_s=0.0 if judge is None else judge.judged_s,
            events=vehicle.events,
            flight_s=0.0 if judge is None else judge.flight_s,
            rates=tuple((one.value, state.streams.meter(one).rate_hz) for one in METERED),
            ratios=tuple((one.monitor, one.axis or "", one.statistic / one.threshold) for one in gauges if one.valid),
            timesync=vehicle.timesync,
            drift_ppm=self.link.vehicles[sysid].state.timeline.drift_ppm,
            diagnosis=state.diagnosis,
        )
