"""The vehicles of one link and their sessions: bytes and `now` in, effects out. No clock, no socket.

Under load fewer vehicles are judged in each look, and each with more data (`due_turns`): nothing is lost, and verdicts
come later. How much later is told. Each source has one vehicle judged before any source has its second: who makes up
vehicles delays those of his own source.
"""

import traceback
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import TypeAlias

import numpy as np

from detector.figures import VehicleFigures
from detector.session import Session
from detector.streams import METERED
from detector.values import Effect, EventOpened, Inbox, LearningFailed, Note, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.link.codec import Frame
from mavdiag.link.messages import Component
from mavdiag.link.profiles import Profile
from mavdiag.link.sequence import Source
from mavdiag.link.signing import Signing
from mavdiag.link.timesync import Timesync, exchanged
from mavdiag.link.vehicles import VEHICLES_MAX, Command, LinkDecoder, Received
from mavdiag.telemetry import Instant, IntArray, Series, Signal
from mavdiag.units import NS_PER_S

SHARE = 0.5  # of a tick that may be used before the other vehicles wait (our choice: the machine has more to do)
MOST_S = 2.0  # one vehicle a look that has waited so long is judged all the same (our choice: what is kept is bounded)
STOP_S = 5.0  # in which what waits is judged when the daemon stops (our choice: half of what the stop may take)
LEVELS_S = (0.15, 0.3, 0.6, 1.2, 2.4)  # delays that are worth a line in the log (our choice)
QUIET_S = 10.0  # between two such lines (our choice)
AWAITED_MOST = 8192  # samples that may wait for their verdict: several seconds (our choice)
FORGET_NS = NS_PER_S  # a sample without a verdict for so long gets none: nothing is judged (our choice)
NONE: IntArray = np.empty(0, dtype=np.int64)

SpecOf: TypeAlias = Callable[[Profile], SessionSpec]
Adapt: TypeAlias = Callable[[int, SessionSpec], SessionSpec | None]


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
    arrived_ns: IntArray = field(default_factory=lambda: NONE)
    judged_ns: IntArray = field(default_factory=lambda: NONE)


class Awaiting:
    """Gyro samples that came and are not yet judged, by the vehicle's clock and by when they came (host)."""

    def __init__(self) -> None:
        self.t_ns = self.host_ns = NONE

    def step(self, gyro: Series | None, judged_ns: int | None, now_ns: int) -> IntArray:
        """Take in new samples; return when those came that have their verdict now.

        judged_ns: the vehicle's time up to which was judged, None for nothing. now_ns: host clock.
        """
        t_ns, host_ns = self.t_ns, self.host_ns
        if gyro is not None and len(gyro):
            t_ns, host_ns = np.append(t_ns, gyro.t_ns)[-AWAITED_MOST:], np.append(host_ns, gyro.host_ns)[-AWAITED_MOST:]
        fresh = host_ns >= now_ns - FORGET_NS
        judged = np.zeros(len(t_ns), dtype=np.bool_) if judged_ns is None else t_ns <= judged_ns
        self.t_ns, self.host_ns = t_ns[fresh & ~judged], host_ns[fresh & ~judged]
        return host_ns[judged & fresh]


class Vehicle:
    """One vehicle and its session.

    outcome: what came of its last `Learn`, until the session gets it.
    events: that were opened, so far.
    timesync: what is known of its clock by asking; asked and answered where we may negotiate.
    turn: when it had its last turn.
    measured: whether the time from a sample to its verdict is measured.
    """

    def __init__(self, spec: SessionSpec, now: Instant, *, measured: bool) -> None:
        self.session, self.turn = Session(spec, now), now
        self.outcome: Baseline | LearningFailed | None = None
        self.events = 0
        self.timesync = Timesync()
        self._awaiting = Awaiting() if measured else None

    def step(self, received: Received, reboots: int, profile: Profile, now: Instant) -> tuple[Effect, ...]:
        """Hand the session what came. profile: with the IMU message that is read."""
        outcome, self.outcome = self.outcome, None
        came = (received.telemetry, received.present, reboots, received.acks, outcome, received.parameters)
        effects = self.session.step(Inbox(*came, profile.imu), now)
        self.events += sum(isinstance(effect, EventOpened) for effect in effects)
        if not self.session.spec.settings.negotiate:
            return effects
        self.timesync, messages = exchanged(self.timesync, received.frames, now.ns, alive=received.present)
        return (*effects, *messages)

    def times_ns(self, received: Received, now: Instant) -> tuple[IntArray, IntArray]:
        """When samples came that were taken, and those that have their verdict now; empty if it is not measured."""
        if self._awaiting is None:
            return NONE, NONE
        gyro, judge = received.telemetry.get(Signal.BODY_RATE), self.session.judge
        judged_ns = self._awaiting.step(gyro, None if judge is None else judge.now_ns, now.ns)
        return NONE if gyro is None else gyro.host_ns, judged_ns

    def restart(self, spec: SessionSpec, now: Instant) -> tuple[Effect, ...]:
        """Begin a new session in place of the present one; return what that leaves to record."""
        left, before = self.session.finish(), self.session
        self.session, self.outcome = Session(replace(spec, held=before.diagnosis), now), None
        self.session.reboots = before.reboots
        return left


def due_turns(
    judged: Mapping[int, Instant],
    now: Instant,
    source_of: Callable[[int], Source],
    has_time: Callable[[], bool] = lambda: True,
) -> Iterator[tuple[int, float]]:
    """System ids with the time since they were judged [s], in rounds: of each source the vehicle that waited longest,
    then of each source the second, and so on. The source that had no turn for the longest time is the first.

    has_time: whether a look has time for another vehicle; one that waited for `MOST_S` has its turn all the same.

    >>> judged = {1: Instant(30), 2: Instant(10), 3: Instant(20)}
    >>> [sysid for sysid, _ in due_turns(judged, Instant(40), lambda sysid: "one" if sysid == 1 else "other")]
    [2, 1, 3]
    """
    queues: defaultdict[Source, list[int]] = defaultdict(list)
    for sysid in sorted(judged, key=lambda sysid: judged[sysid].ns):
        queues[source_of(sysid)].append(sysid)
    rounds = zip_longest(*sorted(queues.values(), key=lambda queue: judged[queue[-1]].ns))
    waited_s = [(sysid, now - judged[sysid]) for each in rounds for sysid in each if sysid is not None]
    for number, (sysid, span_s) in enumerate(waited_s):
        if has_time() or (number == 0 and span_s > MOST_S):
            yield sysid, span_s


class Delay:
    """By how much verdicts come later than at the tick. longest_s: the longest that a vehicle waited lately."""

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._level = 0  # how many of `LEVELS_S` it passed when it was told last
        self._told: Instant | None = None

    def news(self, now: Instant) -> str:
        """Begin a new measurement; return the line for the log, empty if there is nothing new to tell."""
        longest_s, self.longest_s = self.longest_s, 0.0
        level = sum(longest_s > level_s for level_s in LEVELS_S)
        if level == self._level or (self._told is not None and now - self._told < QUIET_S):
            return ""
        self._level, self._told = level, now
        text = f"much to do: each vehicle is judged every {longest_s:.2f} s, so verdicts come that much later"
        return text if level else "every vehicle is judged in every look again"


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with a vehicle of a profile.
    profile: of all vehicles, None to go by what each sends.
    only: the one system id to watch, None for all.
    datagrams: whether a chunk of bytes holds whole frames.
    adapt: what is different for the vehicle of a system id; None for one that is left alone.
    most: how many vehicles may enter.
    measured: whether the time from a sample to its verdict is measured.
    budget_s: time after which no further vehicle is judged in a look; None for all vehicles in every look.
    signing, passed: as in `LinkDecoder`.
    vehicles: those that are watched, by system id.
    delay: by how much verdicts are put off.
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
        budget_s: float | None = None,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
    ) -> None:
        ours = [sysid << 8 | Component.ONBOARD_COMPUTER for sysid in (range(1, 256) if only is None else (only,))]
        self.link = LinkDecoder(
            profile, only, datagrams, careful=True, most=most, signing=signing, passed=passed, ours=ours
        )
        self._spec_of, self._adapt, self._measured, self.budget_s = spec_of, adapt, measured, budget_s
        self._left: set[int] = set()
        self.vehicles: dict[int, Vehicle] = {}
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
        spent_s: time since the look began [s]; vehicles for which there is none left have their turn in a later step,
            but for one that has waited for `MOST_S`.
        """
        self.link.take(chunks, now.ns, sources)
        streams = self.link.vehicles
        for sysid in streams.keys() - self.vehicles.keys() - self._left:
            spec = self._adapt(sysid, self._spec_of(streams[sysid].profile))
            if spec is None:
                self._left.add(sysid)
                self.link.give_up(sysid)
            else:
                self.vehicles[sysid] = Vehicle(spec, now, measured=self._measured)
        for sysid in self._left:
            self.link.leave(sysid)
        turns: list[Turn] = []
        for sysid, waited_s in self._due(now, lambda: self.budget_s is None or spent_s() < self.budget_s):
            turns.append(self._parted(sysid, now, self._turn))
            self.delay.longest_s = max(self.delay.longest_s, waited_s)
        return turns

    def finish(self, now: Instant, *, spent_s: Callable[[], float] = lambda: 0.0) -> list[Turn]:
        """Judge what waits, and what is left to say when the daemon stops.

        spent_s: time since the end began [s]; what still waits after `STOP_S` is not judged.
        """
        due = self._due(now, lambda: spent_s() < STOP_S)
        turns = [self._parted(sysid, now, self._turn) for sysid, _ in due]
        return [*turns, *(self._parted(sysid, now, self._last_turn) for sysid in self.vehicles)]

    def _due(self, now: Instant, has_time: Callable[[], bool]) -> Iterator[tuple[int, float]]:
        judged = {sysid: vehicle.turn for sysid, vehicle in self.vehicles.items()}
        return due_turns(judged, now, self.link.source, has_time)

    def _last_turn(self, sysid: int, now: Instant) -> Turn:
        return Turn(sysid, self.vehicles[sysid].session.finish())

    def _turn(self, sysid: int, now: Instant) -> Turn:
        vehicle, stream, received = self.vehicles[sysid], self.link.vehicles[sysid], self.link.received(sysid)
        effects = vehicle.step(received, stream.reboots, stream.profile, now)
        times_ns = vehicle.times_ns(received, now)
        return Turn(sysid, effects, received.commands, received.parameter_requests, *times_ns)

    def _parted(self, sysid: int, now: Instant, work: Callable[[int, Instant], Turn]) -> Turn:
        """What comes of one vehicle's work. An error of the program takes this vehicle off, and no other."""
        self.vehicles[sysid].turn = now
        try:
            return work(sysid, now)
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
        session, judge = vehicle.session, vehicle.session.judge
        valid = [gauge for gauge in judge.gauges if gauge.valid] if judge else []
        return VehicleFigures(
            sysid,
            session.state,
            received=count.received if count else 0,
            lost=count.lost if count else 0,
            gyro_hz=session.streams.gyro.rate_hz,
            judged_s=judge.judged_s if judge else 0.0,
            events=vehicle.events,
            flight_s=judge.flight_s if judge else 0.0,
            rates=tuple((signal.value, session.streams.meter(signal).rate_hz) for signal in METERED),
            ratios=tuple((gauge.monitor, gauge.axis or "", gauge.statistic / gauge.threshold) for gauge in valid),
            timesync=vehicle.timesync,
            drift_ppm=self.link.vehicles[sysid].timeline.drift_ppm,
            diagnosis=session.diagnosis,
        )
