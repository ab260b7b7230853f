"""The vehicles of one link and their sessions: bytes and `now` in, effects out. No clock, no socket.

What the link brings comes first (`take`); judging has the time that remains (`judge`). A vehicle has its turn when its
data may complete the next look of its monitors, or at once where something waits for an answer. Where there are many
vehicles a turn brings several looks. Under load fewer vehicles have theirs in each look at the link, and each with more
data (`due_turns`): nothing is lost, and verdicts come later, which is told.
"""

import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path

from detector.session import Session
from detector.states import State
from detector.values import Effect, EventOpened, FitOutcome, Note, SessionSpec
from mavdiag.kernel import LOOK_NS
from mavdiag.link.clock import Timesync
from mavdiag.link.codec import Frame
from mavdiag.link.datagrams import Datagrams
from mavdiag.link.messages import Component
from mavdiag.link.ports import Endpoint
from mavdiag.link.profiles import Profile
from mavdiag.link.sequence import LinkCount, Source
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import VEHICLES_MAX, LinkDecoder, VehicleStream
from mavdiag.telemetry import Instant, Series, Signal
from mavdiag.units import NS_PER_MS, NS_PER_S

MOST_S = 2.0  # one vehicle a look that has waited so long is judged all the same (our choice: what is kept is bounded)
SLOW_S = 0.3  # a delay that is worth a line in the log (our choice)
QUIET_S = 10.0  # between two such lines (our choice)
FORGET_NS = NS_PER_S  # a sample without a verdict for so long gets none: nothing is judged (our choice)
TURNS_HZ = 334  # of all vehicles together; where there are more looks than that, turns bring several (our choice)
LOOKS_MOST = 4  # that a turn brings: the verdict on the first of them comes 0.24 s later (our choice)
SHORTEST, NEAR = 0.2, 1.7  # of a tick: the shortest one, and how far data may be off that are waited for (our choice)
SPARE_NS = NS_PER_MS  # a turn comes so much after the data that it waits for ought to have come (our choice)
VAIN_NS = 25 * NS_PER_MS  # ... and where it came in vain twice: a stream does not keep its time (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """What came of one vehicle's step."""

    vehicle: int  # system id
    effects: tuple[Effect, ...]  # what its session wants done
    asked: tuple[Frame, ...] = ()  # of others, of its companion, which we are
    latency_s: float | None = None  # from the arrival of the first gyro sample of what was judged; None if nothing was


class Vehicle:
    """One vehicle and its session. link: that it is on; None for a vehicle of a log."""

    def __init__(self, sysid: int, spec: SessionSpec, now: Instant, link: LinkDecoder | None = None) -> None:
        self.sysid, self._link = sysid, link
        self.session, self.turn = Session(spec, now), now  # turn: when it had its last one
        self.due_ns = now.ns  # when it has the next one, if there is time
        self.judged_ns: int | None = None  # the vehicle's time up to which was judged
        self.vain = 0  # turns in a row that the data ought to have come for, and had not
        self.first_ns: int | None = None  # when the first gyro sample came that was not judged then (host)
        self.outcome: FitOutcome | None = None  # of its last `Learn`, until the session gets it
        self.sticks: dict[tuple[int, str], int] = {}  # told by ground stations behind, until the session gets them
        self.alarms = Counter[str]()  # that were opened, by monitor
        self.timesync = Timesync()  # asked and answered where we may negotiate

    def count_alarms(self, effects: Iterable[Effect]) -> None:
        """Count the alarms that the session opened."""
        self.alarms.update(effect.event.monitor for effect in effects if isinstance(effect, EventOpened))

    @property
    def count(self) -> LinkCount:
        """Frames of its autopilot so far."""
        return LinkCount() if self._link is None else self._link.count(self.sysid)

    @property
    def judged_s(self) -> float:
        """Flight time judged by the present chain."""
        return self.session.judge.judged_s if self.session.judge else 0.0

    @property
    def drift_ppm(self) -> float | None:
        """Drift of the first clock of its messages against another; None if they have one clock."""
        return None if self._link is None else self._link.vehicles[self.sysid].state.timeline.drift_ppm

    def wait(self, gyro: Series | None, now_ns: int, looks: int) -> float | None:
        """Set the next turn, once samples may complete so many looks; return how long those judged now took [s].

        gyro: what came of it.
        """
        latency_s, self.due_ns, judge = None, now_ns, self.session.judge
        if self.first_ns is None or now_ns - self.first_ns > FORGET_NS:
            self.first_ns = int(gyro.host_ns[0]) if gyro is not None and len(gyro) else None
        if judge is None or self.session.state is not State.MONITORING:
            return None
        missing_ns, fresh = judge.chain.missing_ns(judge.memory), judge.memory.now_ns != self.judged_ns
        self.vain = 0 if fresh or missing_ns else self.vain + 1
        self.due_ns += (looks - 1) * LOOK_NS + missing_ns + (VAIN_NS if self.vain > 1 else SPARE_NS)
        if fresh:
            latency_s = None if self.first_ns is None else (now_ns - self.first_ns) / NS_PER_S
            self.first_ns = None
        self.judged_ns = judge.memory.now_ns
        return latency_s


@dataclass(frozen=True, slots=True)
class DaemonFigures:
    """The daemon at a moment; counts so far."""

    vehicles: Sequence[Vehicle]
    links: Sequence[Endpoint]  # the vehicle's, then those behind
    late: int = 0  # looks at the links that came too late
    cpu_s: float = 0.0
    lost_entries: Mapping[str, int] = field(default_factory=dict)  # what could not be written to each file, by option
    refused: tuple[tuple[str, int], ...] = ()  # frames of the vehicle's link that were not heard, by cause
    delay_s: float = 0.0  # longest that a vehicle waited for its turn lately, because there was much to do


def due_turns(
    judged: Mapping[int, Instant],
    now: Instant,
    source_of: Callable[[int], Source],
    has_time: Callable[[], bool] = lambda: True,
) -> Iterator[int]:
    """System ids in rounds: of each source the vehicle that waited longest, then of each source the second, and so on:
    who makes up vehicles delays those of his own source.

    has_time: whether a look has time for another vehicle; one that waited for `MOST_S` has its turn all the same.

    >>> judged = {1: Instant(30), 2: Instant(10), 3: Instant(20)}
    >>> list(due_turns(judged, Instant(40), lambda sysid: "one" if sysid == 1 else "other"))
    [2, 1, 3]
    """
    queues: defaultdict[Source, list[int]] = defaultdict(list)
    for sysid in sorted(judged, key=lambda sysid: judged[sysid].ns):
        queues[source_of(sysid)].append(sysid)
    rounds = zip_longest(*sorted(queues.values(), key=lambda queue: judged[queue[-1]].ns))
    time_left, none_yet = True, True
    for sysid in (sysid for each in rounds for sysid in each if sysid is not None):
        time_left = time_left and has_time()  # asking takes time, too
        if time_left or (none_yet and now - judged[sysid] > MOST_S):
            none_yet = False
            yield sysid


class Fleet:
    """All vehicles on one link.

    spec_of: what to do with the vehicle of a system id and profile; None for one that is left alone.
    knows: whether the uid is known that the spec of a system id rests on; a vehicle waits until it is, and is another
    one once it tells another. None where none rests on it.
    profile: of all vehicles, None to go by what each sends. only: the one system id to watch, None for all.
    datagrams: whether a chunk of bytes holds whole frames. most: how many vehicles may enter.
    signing, passed: as in `LinkDecoder`.
    """

    def __init__(
        self,
        spec_of: Callable[[int, Profile], SessionSpec | None],
        *,
        profile: Profile | None,
        only: int | None,
        datagrams: bool,
        most: int = VEHICLES_MAX,
        signing: Signing | None = None,
        passed: list[tuple[bytes, int]] | None = None,
        knows: Callable[[int], bool] | None = None,
    ) -> None:
        ours = [sysid << 8 | Component.ONBOARD_COMPUTER for sysid in (range(1, 256) if only is None else (only,))]
        self.link = LinkDecoder(
            profile, only, datagrams, careful=True, most=most, signing=signing, passed=passed, ours=ours
        )
        self.vehicles: dict[int, Vehicle] = {}  # those that are watched, by system id
        self.longest_s = 0.0  # longest that a vehicle waited lately for a turn that was due
        self._slow: tuple[bool, Instant] | None = None  # what was told of that last, and when
        self._spec_of, self._knows = spec_of, knows
        self._uids: dict[int, str] = {}  # by which it was decided whether and how a system id is watched

    def take(self, some: Datagrams, now: Instant) -> None:
        """Take what the link brought."""
        self.link.take(some, now.ns)
        for sysid, stream in self.link.vehicles.items():
            uid = stream.uid if self._knows else ""
            if self._uids.get(sysid) != uid and (self._knows is None or self._knows(sysid)):
                self._uids[sysid] = uid
                self._begin(sysid, stream, now)
            elif sysid not in self.vehicles:  # what it tells of itself is in the stream once it is received
                (self.link.received if self._knows else self.link.leave)(sysid)

    def _begin(self, sysid: int, stream: VehicleStream, now: Instant) -> None:
        spec, old = self._spec_of(sysid, stream.profile), self.vehicles.get(sysid)
        self.link.claim(sysid, ours=spec is not None)
        if spec is None:
            self.vehicles.pop(sysid, None)
        elif old is None or old.session.spec.baseline is not spec.baseline:
            self.vehicles[sysid] = Vehicle(sysid, spec, now, self.link)
            self.vehicles[sysid].session.reboots = stream.state.timeline.reboots

    def judge(self, now: Instant, has_time: Callable[[], bool] = lambda: True) -> list[Turn]:
        """Give those their turn that are due, as in `due_turns`. Time alone changes things: call it regularly."""
        urgent, turns, all_of = self.link.urgent(), list[Turn](), self.vehicles.items()
        due = {n: one.turn for n, one in all_of if one.due_ns <= now.ns or one.outcome is not None or n in urgent}
        for sysid in due_turns(due, now, self.link.source, has_time):
            self.longest_s = max(self.longest_s, (now.ns - self.vehicles[sysid].due_ns) / NS_PER_S)
            turns.append(self._parted(sysid, now, self._turn))
        return turns

    def next_look(self, last: Instant, tick_s: float) -> Instant:
        """When to look at the link again: in a tick, or when the data of the next vehicle are due, if that is near.

        Where turns bring several looks nobody waits for a moment. last: when it was looked at last.
        """
        soon = [vehicle.due_ns for vehicle in self.vehicles.values() if vehicle.due_ns > last.ns]
        if not soon or self.looks > 1 or (due := Instant(min(soon))) - last > NEAR * tick_s:
            return last + tick_s
        return max(due, last + SHORTEST * tick_s, key=lambda at: at.ns)

    @property
    def looks(self) -> int:
        """How many looks of its monitors a vehicle's turn brings."""
        return min(LOOKS_MOST, -(-max(1, len(self.vehicles)) * NS_PER_S // (TURNS_HZ * LOOK_NS)))

    def delay_news(self, now: Instant) -> str:
        """Measure anew how late verdicts come; return a line for the log, empty if there is nothing new to tell."""
        (was_slow, told), longest_s = self._slow or (False, None), self.longest_s
        self.longest_s, slow = 0.0, longest_s > SLOW_S
        if slow == was_slow or (told is not None and now - told < QUIET_S):
            return ""
        self._slow = (slow, now)
        text = f"much to do: a vehicle waits {longest_s:.2f} s until it is judged, so verdicts come that much later"
        return text if slow else "every vehicle is judged in time again"

    def finish(self, now: Instant, has_time: Callable[[], bool] = lambda: True) -> list[Turn]:
        """Judge what waits, while there is time, and what is left to say when the daemon stops."""
        waiting = {sysid: vehicle.turn for sysid, vehicle in self.vehicles.items()}
        due = due_turns(waiting, now, self.link.source, has_time)
        turns = [self._parted(sysid, now, self._turn) for sysid in due]
        ends = {sysid: vehicle.session.finish for sysid, vehicle in self.vehicles.items()}
        return [*turns, *(self._parted(sysid, now, lambda sysid, _: Turn(sysid, ends[sysid]())) for sysid in ends)]

    def _turn(self, sysid: int, now: Instant) -> Turn:
        vehicle, received = self.vehicles[sysid], self.link.received(sysid)
        session, outcome = vehicle.session, vehicle.outcome
        if vehicle.sticks:
            received = replace(received, sticks={**received.sticks, **vehicle.sticks})
        vehicle.outcome, vehicle.sticks = None, {}
        effects = session.step(received, now, outcome)
        vehicle.count_alarms(effects)
        if session.spec.settings.negotiate:
            effects = (*effects, *vehicle.timesync.step(received.frames, now.ns, alive=received.alive))
        latency_s = vehicle.wait(received.telemetry.get(Signal.BODY_RATE), now.ns, self.looks)
        return Turn(sysid, effects, received.asked, latency_s)

    def _parted(self, sysid: int, now: Instant, work: Callable[[int, Instant], Turn]) -> Turn:
        """What comes of one vehicle's work. An error of the program takes this vehicle off, and no other."""
        vehicle = self.vehicles[sysid]
        vehicle.turn, vehicle.due_ns = now, now.ns
        try:
            return work(sysid, now)
        except Exception as error:  # noqa: BLE001  # whatever is wrong with one vehicle, the others are watched on
            place = traceback.extract_tb(error.__traceback__)[-1]
            effects = vehicle.session.broken(f"{type(error).__name__}: internal error", now)
            where = f"{Path(place.filename).name}:{place.lineno}"
            note = Note(f"watching vehicle {sysid} ended by an error of the program: {error!r} at {where}")
            return Turn(sysid, (note, *effects) if effects else ())
