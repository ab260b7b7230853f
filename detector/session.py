"""One vehicle's session, sans I/O: `session.step(inbox, now) -> effects`; what it remembers is one value, its state.

What may follow what is in `states`, what is said and how often in `alerts`. `now` is the host's clock and rules what is
said and given up; the judgement itself runs on the vehicle's clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

from detector.alerts import POLICY, Kind, Notice, Presenter, Told, figure, present, told_of
from detector.judging import Judge, chain_for, not_judged, records_of, rescaled, words_of
from detector.judging_notices import imu_notes, layout_notices, notes_on, vehicle_notices
from detector.named_values import NamedValues, named_values
from detector.needs import Demand, demand_of
from detector.negotiate import Negotiation, Seen, negotiate
from detector.states import TABLE, State, Trigger, advance
from detector.streams import Collection, Hindrance, Reason, Streams, collect, observe, on_ground
from detector.values import (
    AskParameters,
    Effect,
    EventClosed,
    Inbox,
    Learn,
    LearningFailed,
    Note,
    SendText,
    SessionSpec,
    StateChanged,
)
from mavdiag.baseline import Baseline, check_link
from mavdiag.chain import ChainOutput
from mavdiag.decision.alarm import NOTHING_SEEN, Change, Diagnosis, Stage, landed
from mavdiag.decision.words import motors_words
from mavdiag.errors import BaselineError
from mavdiag.link.parameters import Reading
from mavdiag.link.profiles import Profile
from mavdiag.link.samples import joined
from mavdiag.telemetry import Instant, Signal, Telemetry

__all__ = ["Session", "SessionState"]

WAITED_CHUNKS = 256  # kept while the streams are measured: some ten seconds (our choice)
IDLE_S = 3.0  # that nothing is judged is said after so long (our choice)
ARMED_FROM = 0.5  # of the signal, which is 0 or 1
PROGRESS_STEP = 25  # percent of learning between two texts
FITS = 3  # fits that may fail before learning is given up (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class SessionState:
    """All that a session remembers.

    state, reason: where it is and why.
    latest: when anything came from the vehicle last (host).
    baseline: what it judges by, None until it is learned.
    presenter, named_values: what was said lately.
    streams, negotiation, reading: what comes, and which streams and parameters were asked for.
    collection: healthy flight to learn from.
    failed: fits in vain.
    waited: the first telemetry, while its rates are measured; judging begins with it, as a scan of the recording does.
    judge: the chain at work.
    held: what is known of the vehicle while there is no chain: an open inspection.
    told: what was told of a fault.
    armed, armings: whether the vehicle was armed last, and how often it became so.
    unjudged: monitors that were said not to judge, with the reason.
    reboots: of the vehicle.
    """

    state: State
    reason: str
    latest: Instant
    baseline: Baseline | None
    presenter: Presenter
    named_values: NamedValues
    streams: Streams = field(default_factory=Streams)
    negotiation: Negotiation = field(default_factory=Negotiation)
    reading: Reading = field(default_factory=Reading)
    collection: Collection = field(default_factory=Collection)
    failed: int = 0
    waited: tuple[Telemetry, ...] = ()
    judge: Judge | None = None
    held: Diagnosis = NOTHING_SEEN
    told: Told = field(default_factory=Told)
    armed: bool = False
    armings: int = 0
    unjudged: tuple[tuple[str, str], ...] = ()
    reboots: int = 0

    @property
    def diagnosis(self) -> Diagnosis:
        """What is held of the vehicle now."""
        return self.held if self.judge is None else self.judge.memory.diagnosis


_NEW_LINK: Mapping[str, Any] = {
    "streams": Streams(),
    "negotiation": Negotiation(),
    "reading": Reading(),
    "waited": (),
}


class Session:
    """One vehicle's session; it begins when its first frame comes."""

    def __init__(self, spec: SessionSpec, now: Instant) -> None:
        self.spec: Final = spec
        self._settings = settings = spec.settings
        presenter = Presenter(settings.texts_per_minute)
        values = NamedValues(1.0 / settings.named_values_hz, settings.named_values_axis)
        begun = (State.WAITING, "the first frame came", now, spec.baseline, presenter, values)
        self.state = SessionState(*begun, held=spec.held)
        self._effects: list[Effect] = []
        self._notices: list[Notice] = []
        self._demanded: tuple[tuple[int, int, int], Demand] | None = None

    @property
    def working(self) -> bool:
        """Whether it does its work or still may: only then its heartbeat goes out."""
        return self.state.state is not State.FAULTED

    def step(self, inbox: Inbox, now: Instant) -> tuple[Effect, ...]:
        """Take in what came since the last step. Call it regularly, with an empty inbox too: time changes things."""
        self._effects, self._notices = [], []
        self._link(inbox, now)
        self._reboot(inbox)
        self._observe(inbox, now)
        self.HANDLERS[self.state.state](self, inbox, now)
        self._tell(inbox)
        presenter, said = present(self.state.presenter, tuple(self._notices), now)
        self._keep(presenter=presenter)
        return (*self._effects, *said)

    def broken(self, reason: str, now: Instant) -> tuple[Effect, ...]:
        """An error of the program ends this session's work until the vehicle starts anew."""
        self._effects, self._notices = [], []
        if self.state.state is not State.FAULTED:
            self._keep(judge=None, held=self._held())
            self._off(Trigger.BROKEN, reason)
        presenter, said = present(self.state.presenter, tuple(self._notices), now)
        self._keep(presenter=presenter)
        return (*self._effects, *said)

    def finish(self) -> tuple[Effect, ...]:
        """The daemon stops, or the vehicle started anew: the rows that waited are judged, and events that are still
        open are recorded with the end not seen. What was declared stays, as an open inspection."""
        judge = self.state.judge
        if judge is None:
            return ()
        memory, output = judge.chain.finish(judge.memory)
        self._keep(judge=replace(judge, memory=memory))
        held, changes = self._held(), output.changes
        if memory.diagnosis.stage is Stage.FAULT:
            changes = (*changes, Change.of(held, memory.now_ns or 0))
        memory = judge.chain.renewed(memory, held)
        counts = judge.judged_s + output.judged_s, judge.flight_s + output.flight_s
        self._keep(judge=replace(judge, memory=memory, judged_s=counts[0], flight_s=counts[1]))
        latest = {(event.monitor, event.axis, event.start_ns): event for event in output.events}
        return (*(EventClosed(event) for event in latest.values()), *changes)

    def _held(self) -> Diagnosis:
        """What outlasts a chain: an open inspection."""
        held, judge = self.state.diagnosis, self.state.judge
        open_ = held.stage in (Stage.FAULT, Stage.INSPECT)
        return landed(held, judge.memory.now_ns or 0 if judge else 0) if open_ else NOTHING_SEEN

    def acknowledge(self, whose: str) -> tuple[Effect, ...]:
        """Somebody has looked at the vehicle: an open inspection is closed. whose: who says so, for the journal.

        Nothing but a note comes of it where none is open: a fault in flight cannot be acknowledged.
        """
        held, judge = self.state.diagnosis, self.state.judge
        if held.stage is not Stage.INSPECT:
            why = "the vehicle flies with the fault" if held.stage is Stage.FAULT else "no inspection is open"
            return (Note(f"acknowledged by {whose}, without effect: {why}"),)
        changes: tuple[Change, ...] = ()
        if judge is not None:
            memory, output = judge.chain.acknowledge(judge.memory)
            changes = output.changes
            self._keep(judge=replace(judge, memory=memory))
        else:
            self._keep(held=Diagnosis(reason="the inspection is acknowledged"))
            changes = (Change.of(self.state.held, 0),)
        text = SendText(POLICY[Kind.ACKNOWLEDGED].severity, Notice(Kind.ACKNOWLEDGED, (motors_words(held),)).text)
        return (Note(f"inspection of {motors_words(held)} acknowledged by {whose}"), *changes, text)

    def _tell(self, inbox: Inbox) -> None:
        """Say what changed in the diagnosis, and what lasts of it, whatever the session's state."""
        armed = inbox.telemetry.get(Signal.ARMED)
        if armed is not None and len(armed):
            now_armed = bool(armed.values[-1, 0] >= ARMED_FROM)
            began = now_armed and not self.state.armed
            self._keep(armed=now_armed, armings=self.state.armings + began)
        told, notices = told_of(self.state.told, self.state.diagnosis, self.state.armings)
        self._keep(told=told)
        self._notices += notices

    def _keep(self, **changes: Any) -> None:
        self.state = replace(self.state, **changes)

    def _move(self, trigger: Trigger, reason: str = "", **changes: Any) -> None:
        """Go where the table says. reason: in place of the trigger's own text. changes: to the rest of the state."""
        old, new, reason = self.state.state, advance(self.state.state, trigger), reason or trigger.value
        self._keep(state=new, reason=reason, **changes)
        self._effects.append(StateChanged(old, new, reason))

    def _say(self, kind: Kind, *words: str, key: str = "") -> None:
        self._notices.append(Notice(kind, words, key))

    def _off(self, trigger: Trigger, reason: str) -> None:
        self._move(trigger, reason)
        self._say(Kind.OFF, reason)

    def _link(self, inbox: Inbox, now: Instant) -> None:
        state, limit_s = self.state, self._settings.link_lost_s
        if inbox.alive:
            self._keep(latest=now)
            if state.state is State.LOST:
                self._move(Trigger.LINK_BACK)
                self._say(Kind.LINK_BACK, figure(now - state.latest, 1))
        elif now - state.latest > limit_s and Trigger.LINK_LOST in TABLE[state.state]:
            self._stop_judging()
            self._move(Trigger.LINK_LOST, f"nothing came for {limit_s:g} s", **_NEW_LINK)
            self._say(Kind.LINK_LOST)

    def _reboot(self, inbox: Inbox) -> None:
        """What was measured, collected or judged belongs to the time before; the baseline stays."""
        if inbox.reboots == self.state.reboots or Trigger.REBOOT not in TABLE[self.state.state]:
            return
        self._effects += self.finish()
        new: dict[str, Any] = {"collection": Collection(), "failed": 0, "unjudged": ()}
        new |= {"judge": None, "held": self.state.diagnosis}
        self._move(Trigger.REBOOT, reboots=inbox.reboots, **_NEW_LINK, **new)
        self._say(Kind.REBOOT)

    def _observe(self, inbox: Inbox, now: Instant) -> None:
        """Measure the streams, and ask for what they lack."""
        if self.state.state is State.LOST:
            return
        before = self.state.streams
        streams = observe(before, inbox.telemetry, now, self._profile(inbox))
        self._keep(streams=streams)
        self._effects += imu_notes(self._profile(inbox), self.spec.profile, before, streams)
        if not self._settings.negotiate or self.state.state in (State.FITTING, State.FAULTED):
            return
        seen = (
            Seen(want, streams.rate_hz(want.signal, now), streams.meter(want.signal).steady_hz)
            for want in self._demand(inbox).wants
        )
        negotiation, effects, notices = negotiate(
            self.state.negotiation, tuple(seen), inbox.acks, now, self.spec.profile.autopilot
        )
        self._keep(negotiation=negotiation)
        self._effects += effects
        self._notices += notices
        if self.state.baseline is None:  # what they tell of rotors and filter is learnt with the flight
            reading, names = self.state.reading.step(self.spec.profile.autopilot, inbox.parameters, now)
            self._keep(reading=reading)
            self._effects += [AskParameters(names)] if names else []

    def _demand(self, inbox: Inbox) -> Demand:
        """What is needed of the streams now."""
        baseline, judge, profile = self.state.baseline, self.state.judge, self._profile(inbox)
        rests_on = (id(baseline), id(judge and judge.chain), profile.imu)
        if self._demanded is None or self._demanded[0] != rests_on:
            self._demanded = (rests_on, demand_of(self._settings, profile, baseline, judge))
        return self._demanded[1]

    def _profile(self, inbox: Inbox) -> Profile:
        """The link's profile, with the IMU message that is read."""
        profile = self.spec.profile
        return profile if inbox.imu in (None, profile.imu) else replace(profile, imu=inbox.imu)

    def _lack(self, inbox: Inbox) -> Hindrance | None:
        """What the streams lack, None if they will do."""
        return self._demand(inbox).lack(self.state.streams, judging=self.state.state is State.MONITORING)

    def _waiting(self, inbox: Inbox, now: Instant) -> None:
        state = self.state
        if state.baseline is not None and (state.judge is None or state.judge.baseline is not state.baseline):
            try:
                check_link(state.baseline, profile=self.spec.profile.name, dt_s=state.baseline.link.dt_s)
                chain = chain_for(state.baseline, self._settings, self.spec.unix_ns(now))
            except BaselineError as error:
                return self._off(Trigger.REFUSED, str(error))
            self._keep(judge=Judge(state.baseline, chain, chain.start(self._held()), now))
            scaled = rescaled(state.baseline, self._settings.threshold_scale)
            lost = scaled.not_judgeable[len(state.baseline.not_judgeable) :]
            self._effects += [Note(f"{one.monitor} not judged: {one.reason}") for one in lost]
            self._effects += notes_on(state.baseline, chain, self._settings.suspect)
            self._notices += layout_notices(state.baseline)
        lack = self._lack(inbox)
        measuring = lack is None or lack.reason in (Reason.MEASURING, Reason.NO_GYRO, Reason.NO_SETPOINTS)
        self._keep(waited=(*state.waited, inbox.telemetry)[-WAITED_CHUNKS:] if measuring else ())  # no wrong rate later
        if lack is not None:
            self._keep(reason=lack.text)
            return self._say(Kind.WAITING, lack.text, key=lack.reason)
        if state.baseline is None:
            return self._move(Trigger.READY_TO_LEARN, waited=())
        if (judge := self.state.judge) is None:
            return None
        judge, output = replace(judge, judged=now).step(joined(self.state.waited), now)
        self._record(judge, output)
        return self._move(Trigger.READY_TO_JUDGE, judge=judge, waited=())

    def _learning(self, inbox: Inbox, now: Instant) -> None:
        lack = self._lack(inbox)
        if lack is not None:
            return self._move(Trigger.STREAMS_LOST, lack.text)
        state, learn_s, profile = self.state, self._settings.learn or 0.0, self.spec.profile
        goal_s = learn_s * (1 + state.failed)
        ground = on_ground(state.streams, profile.gate)
        collection = state.collection
        if ground is None:
            collection = collect(collection, inbox.telemetry, state.streams.gyro.period_s or 0.0, FITS * learn_s)
        self._keep(collection=collection)
        if collection.seconds >= goal_s:
            self._move(Trigger.COLLECTED)
            self._effects.append(Learn(profile.name, collection.telemetry, inbox.parameters))
            return self._say(Kind.FITTING)
        percent = int(100 * collection.seconds / goal_s)
        shown, why = percent - percent % PROGRESS_STEP, f": {ground.text}" if ground else ""
        self._keep(reason=f"{percent} % of {goal_s:g} s{why}")
        return self._say(Kind.LEARNING, str(percent), why, key=f"{shown}{why}")

    def _fitting(self, inbox: Inbox, now: Instant) -> None:
        """A fit that failed is tried again with more flight: what was collected stays."""
        outcome = inbox.outcome
        if outcome is None:
            return None
        if isinstance(outcome, LearningFailed):
            failed = self.state.failed + 1
            if failed >= FITS:
                return self._off(Trigger.GIVEN_UP, f"cannot learn: {outcome.reason}")
            self._move(Trigger.NOT_FITTED, outcome.reason, failed=failed)
            return self._say(Kind.NOT_LEARNED, outcome.reason)
        self._move(Trigger.FITTED, baseline=outcome, collection=Collection(), failed=0)
        self._effects.append(outcome)
        refused = len(outcome.not_judgeable)
        return self._say(Kind.LEARNED, str(len(outcome.monitors)), f", {refused} cannot" if refused else "")

    def _judging(self, inbox: Inbox, now: Instant) -> None:
        state, lack = self.state, self._lack(inbox)
        if state.judge is None or lack is not None:
            self._stop_judging()
            return self._move(Trigger.STREAMS_LOST, lack.text if lack else "", waited=())
        judge, output = state.judge.step(inbox.telemetry, now)
        values, floats = named_values(state.named_values, output, now)
        self._keep(judge=judge, named_values=values)
        self._record(judge, output, floats)
        return self._idle(judge, on_ground(state.streams, judge.chain.front.gate), now)

    def _record(self, judge: Judge, output: ChainOutput, floats: Sequence[Effect] = ()) -> None:
        self._effects += [*records_of(output, judge.baseline.airframe.name), *floats]
        self._notices += vehicle_notices(output)

    def _stop_judging(self) -> None:
        """What is open is closed: it must not come back with the next flight. A fault becomes an open inspection."""
        if self.state.judge is not None:
            judge, output = self.state.judge.end_flight()
            self._keep(judge=judge)
            self._record(judge, output)

    def _idle(self, judge: Judge, ground: Hindrance | None, now: Instant) -> None:
        """Say why nothing is judged if nothing is, and which monitors do not judge; what is found is said elsewhere."""
        if hidden := judge.sight.hidden:
            reason = f"not judged: {hidden}"
            self._effects += [Note(reason)] if reason != self.state.reason else []
            self._keep(reason=reason)
            return self._say(Kind.HIDDEN, hidden, key=hidden)
        unjudged = not_judged(judge, self.state.streams, now)
        self._effects += [
            Note(f"{label} not judged: {why}") for label, why in unjudged if (label, why) not in self.state.unjudged
        ]
        diagnosis, why, short = judge.memory.diagnosis, "", ""
        if now - judge.judged >= IDLE_S and (ground or not unjudged):
            why = short = f": {ground.text if ground else diagnosis.reason or Reason.GAPS}"
        elif unjudged:
            why, short = words_of(unjudged)
        self._keep(reason=f"monitoring{why}", unjudged=unjudged)
        if diagnosis.stage not in (Stage.FAULT, Stage.INSPECT) or unjudged:
            self._say(Kind.MONITORING, short, key=short)
        return None

    def _faulted(self, inbox: Inbox, now: Instant) -> None:
        self._say(Kind.OFF, self.state.reason)

    HANDLERS: ClassVar[Mapping[State, "Callable[[Session, Inbox, Instant], None]"]] = {
        State.WAITING: _waiting,
        State.LEARNING: _learning,
        State.FITTING: _fitting,
        State.MONITORING: _judging,
        State.LOST: lambda session, inbox, now: None,
        State.FAULTED: _faulted,
    }
