"""One vehicle's session, sans I/O: `session.step(inbox, now) -> effects`; what it remembers is one value, its state.

What may follow what is in `states`, what is said and how often in `alerts`. `now` is the host's clock and rules what is
said and given up; the judgement itself runs on the vehicle's clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

from detector.alerts import Kind, Notice, Presenter, figure, present
from detector.judging import Alert, Judge, alert_after, not_judged, records_of, rescaled, words_of
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
    SessionSpec,
    StateChanged,
)
from mavdiag.baseline import Baseline, check_link
from mavdiag.chain import ChainOutput, chain_of
from mavdiag.errors import BaselineError
from mavdiag.link.parameters import Reading
from mavdiag.link.profiles import Profile
from mavdiag.link.samples import joined
from mavdiag.telemetry import Instant, Telemetry

__all__ = ["Session", "SessionState"]

WAITED_CHUNKS = 256  # kept while the streams are measured: some ten seconds (our choice)
IDLE_S = 3.0  # that nothing is judged is said after so long (our choice)
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
    alert: the alert, while there is one.
    airborne: since when the vehicle flies (host), None on the ground.
    told: monitors that were said not to judge, with the reason.
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
    alert: Alert | None = None
    airborne: Instant | None = None
    told: tuple[tuple[str, str], ...] = ()
    reboots: int = 0


_NEW_LINK: Mapping[str, Any] = {
    "streams": Streams(),
    "negotiation": Negotiation(),
    "reading": Reading(),
    "waited": (),
    "airborne": None,
}


class Session:
    """One vehicle's session; it begins when its first frame comes."""

    def __init__(self, spec: SessionSpec, now: Instant) -> None:
        self.spec: Final = spec
        self._settings = settings = spec.settings
        presenter = Presenter(settings.texts_per_minute)
        values = NamedValues(1.0 / settings.named_values_hz, settings.named_values_axis)
        self.state = SessionState(State.WAITING, "the first frame came", now, spec.baseline, presenter, values)
        self._effects: list[Effect] = []
        self._notices: list[Notice] = []
        self._demanded: tuple[tuple[int, int, int], Demand] | None = None

    @property
    def healthy(self) -> bool:
        """Whether it does its work or still may: only then its heartbeat goes out."""
        return self.state.state is not State.FAULTED

    def step(self, inbox: Inbox, now: Instant) -> tuple[Effect, ...]:
        """Take in what came since the last step. Call it regularly, with an empty inbox too: time changes things."""
        self._effects, self._notices = [], []
        self._link(inbox, now)
        self._reboot(inbox)
        self._observe(inbox, now)
        self.HANDLERS[self.state.state](self, inbox, now)
        presenter, said = present(self.state.presenter, tuple(self._notices), now)
        self._keep(presenter=presenter)
        return (*self._effects, *said)

    def finish(self) -> tuple[Effect, ...]:
        """The daemon stops, or the vehicle started anew: the rows that waited are judged, and events that are still
        open are recorded with the end not seen."""
        judge = self.state.judge
        if judge is None:
            return ()
        _, output = judge.chain.finish(judge.memory)
        latest = {(event.monitor, event.axis, event.start_ns): event for event in output.events}
        return tuple(EventClosed(event) for event in latest.values())

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
            self._stop_judging("link lost")
            self._move(Trigger.LINK_LOST, f"nothing came for {limit_s:g} s", **_NEW_LINK)
            self._say(Kind.LINK_LOST)

    def _reboot(self, inbox: Inbox) -> None:
        """What was measured, collected or judged belongs to the time before; the baseline stays."""
        if inbox.reboots == self.state.reboots or Trigger.REBOOT not in TABLE[self.state.state]:
            return
        self._effects += self.finish()
        new: dict[str, Any] = {"collection": Collection(), "failed": 0, "judge": None, "alert": None, "told": ()}
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
        judging = self.state.state in (State.MONITORING, State.ALERT)
        return self._demand(inbox).lack(self.state.streams, judging=judging)

    def _waiting(self, inbox: Inbox, now: Instant) -> None:
        state = self.state
        if state.baseline is not None and (state.judge is None or state.judge.baseline is not state.baseline):
            try:
                check_link(state.baseline, profile=self.spec.profile.name, dt_s=state.baseline.link.dt_s)
                chain = chain_of(rescaled(state.baseline, self._settings.threshold_scale), self.spec.unix_ns(now))
            except BaselineError as error:
                return self._off(Trigger.REFUSED, str(error))
            self._keep(judge=Judge(state.baseline, chain, chain.start(), now))
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
            why = lack.text if lack else ""
            self._stop_judging(why)
            return self._move(Trigger.STREAMS_LOST, why, waited=())
        judge, output = state.judge.step(inbox.telemetry, now)
        values, floats = named_values(state.named_values, output, now)
        ground = on_ground(state.streams, judge.chain.front.gate)
        airborne = None if ground else state.airborne or now
        alert = alert_after(state.alert, output, judge.memory.diagnosis, frozenset(self._settings.suspect), now)
        if state.alert is None and (airborne is None or now - airborne < self._settings.takeoff_s):
            alert = None
        self._keep(judge=judge, named_values=values, airborne=airborne, alert=alert)
        self._record(judge, output, floats)
        return self._quiet(judge, ground, now) if alert is None else self._alerting(judge, alert, ground, now)

    def _record(self, judge: Judge, output: ChainOutput, floats: Sequence[Effect] = ()) -> None:
        self._effects += [*records_of(output, judge.baseline.airframe.name), *floats]
        self._notices += vehicle_notices(output)

    def _stop_judging(self, why: str) -> None:
        """What is open is closed: it must not come back with the next flight."""
        state = self.state
        if state.judge is not None:
            judge, output = state.judge.end_flight()
            self._keep(judge=judge, alert=None)
            self._record(judge, output)
            if state.alert is not None:
                self._say(Kind.UNSETTLED, why)

    def _alerting(self, judge: Judge, alert: Alert, ground: Hindrance | None, now: Instant) -> None:
        notice = alert.notice
        if self.state.state is State.MONITORING:
            self._move(Trigger.ALARM, notice.text)
        if now - alert.latest < self._settings.clear_s:
            self._keep(reason=notice.text)
            self._notices.append(notice)
            return
        # Cleared if flight was judged since; else it only could not be followed any longer.
        if judge.judged - alert.latest > self._settings.clear_s / 2:
            self._say(Kind.CLEARED, figure(alert.latest - alert.since, 1))
        else:
            self._say(Kind.UNSETTLED, (ground or Hindrance(Reason.GAPS)).text)
        self._move(Trigger.QUIET, self._notices[-1].text, alert=None)

    def _quiet(self, judge: Judge, ground: Hindrance | None, now: Instant) -> None:
        """Nothing found: say why nothing is judged if nothing is, and which monitors do not judge."""
        if self.state.state is State.ALERT:
            self._move(Trigger.QUIET)
        unjudged = not_judged(judge, self.state.streams, now)
        self._effects += [
            Note(f"{label} not judged: {why}") for label, why in unjudged if (label, why) not in self.state.told
        ]
        diagnosis, why, short = judge.memory.diagnosis, "", ""
        if now - judge.judged >= IDLE_S and (ground or not unjudged):
            why = short = f": {ground.text if ground else diagnosis.reason or Reason.GAPS}"
        elif unjudged:
            why, short = words_of(unjudged)
        self._keep(reason=f"monitoring{why}", told=unjudged)
        self._say(Kind.MONITORING, short, key=short)

    def _faulted(self, inbox: Inbox, now: Instant) -> None:
        self._say(Kind.OFF, self.state.reason)

    HANDLERS: ClassVar[Mapping[State, "Callable[[Session, Inbox, Instant], None]"]] = {
        State.WAITING: _waiting,
        State.LEARNING: _learning,
        State.FITTING: _fitting,
        State.MONITORING: _judging,
        State.ALERT: _judging,
        State.LOST: lambda session, inbox, now: None,
        State.FAULTED: _faulted,
    }
