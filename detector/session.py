"""One vehicle's session, sans I/O: `session.step(received, now) -> effects`.

`now` is the host's clock and rules what is said and given up; the judgement itself runs on the vehicle's clock.
"""

from dataclasses import replace
from typing import Final

from detector.alerts import Kind, NamedValues, Notice, Presenter, Telling
from detector.judging import Judge, beginning, chain_for, records_of, words_of
from detector.reaction import Reaction
from detector.rules import parse_modes, parse_rules
from detector.states import TABLE, State, Trigger
from detector.streams import Demand, Hindrance, Negotiation, Reason, Streams
from detector.values import AskParameters, Effect, FitOutcome, Learn, Note, SessionSpec, StateChanged
from mavdiag.airframe.fingerprint import Outcome
from mavdiag.baseline import check_link
from mavdiag.chain import ChainOutput
from mavdiag.decision.alarm import NOTHING_SEEN, Change, Diagnosis, Stage
from mavdiag.decision.words import motors_words
from mavdiag.errors import BaselineError
from mavdiag.link.codec import message_name
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import LAST_RESORT, Profile
from mavdiag.link.samples import joined
from mavdiag.link.vehicles import Received
from mavdiag.link.wants import Reading, telling
from mavdiag.telemetry import Instant, Signal, Telemetry

WAITED_CHUNKS = 256  # kept while the streams are measured: some ten seconds (our choice)
LOOK_S = 0.5  # between two looks at what the streams lack (our choice)
IDLE_S = 3.0  # that nothing is judged is said after so long (our choice)
# How often a pilot's sticks are asked for until they are told, and their rate (our choice).
STICKS_S, STICKS_HZ = 60.0, 5.0
ARMED_FROM = 0.5  # of the signal, which is 0 or 1
PROGRESS_STEP = 25  # percent of learning between two texts
FITS = 3  # fits that may fail before learning is given up (our choice)


class Session:
    """One vehicle's session; it begins when its first frame comes."""

    def __init__(self, spec: SessionSpec, now: Instant) -> None:
        self.spec: Final = spec
        self.settings = settings = spec.settings
        self.state, self.reason = State.WAITING, "the first frame came"  # where it is and why, and what the pilot
        self._short = ""  # is told of it where it is off
        self.unix_offset_ns = spec.unix_offset_ns  # renewed, for a wall clock may be set late
        self.latest, self.reboots = now, 0  # when anything came from the vehicle last (host)
        self.baseline = spec.baseline  # what it judges by, None until it is learned
        self.judge: Judge | None = None  # the chain at work, and whether it is of the session that taught its baseline
        self._same = False
        self._held = spec.held  # what is known of the vehicle while there is no chain: an open inspection
        self._presenter, self._telling = Presenter(settings.texts_per_minute), Telling()
        modes, autopilot = parse_modes(settings.on_fault_modes), spec.profile.autopilot
        self.reaction = Reaction(parse_rules(settings.on_fault), modes, autopilot)
        self._sticks_asked: Instant | None = None
        self._named_values = NamedValues(1.0 / settings.named_values_hz)
        self.armed, self._armings = False, 0
        self.came = Telemetry()  # with the last step
        self._gyro = message_name(spec.profile.imu)  # what its gyro is read from, as told last
        self._outcome: FitOutcome | None = None
        self._looked = Instant(0)  # when it was asked what the streams lack
        self._unjudged: dict[str, str] = {}  # monitors that were said not to judge, with the reason
        self._effects: list[Effect] = []
        self._notices: list[Notice] = []
        self._demanded: tuple[tuple[int, int, int], Demand] | None = None
        self._begin_link()
        self._begin_learning()

    def _begin_link(self) -> None:
        self.streams, self._negotiation, self._reading = Streams(), Negotiation(self.spec.profile.autopilot), Reading()
        # The first telemetry, while its rates are measured: judging begins with it, as a scan of the recording does.
        self._waited: list[Telemetry] = []

    def _begin_learning(self) -> None:
        self._flight, self.flight_s, self._failed = list[Telemetry](), 0.0, 0  # healthy flight; fits that failed

    @property
    def diagnosis(self) -> Diagnosis:
        """What is held of the vehicle now."""
        return self._held if self.judge is None else self.judge.memory.diagnosis

    @property
    def working(self) -> bool:
        """Whether it does its work or still may: only then its heartbeat goes out."""
        return self.state is not State.FAULTED

    def step(self, received: Received, now: Instant, outcome: FitOutcome | None = None) -> tuple[Effect, ...]:
        """Take in what came since the last step. Call it regularly, though nothing came: time changes things.

        outcome: of the last `Learn`.
        """
        self._effects, self._notices, self.came, self._outcome = [], [], received.telemetry, outcome
        self._link(received, now)
        self._reboot(received)
        self._observe(received, now)
        if self.state is not State.LOST:
            getattr(self, f"_{self.state}")(received, now)
        armed = received.telemetry.get(Signal.ARMED)
        if armed is not None and len(armed):
            was_armed, self.armed = self.armed, bool(armed.values[-1, 0] >= ARMED_FROM)
            self._armings += self.armed and not was_armed
            if self.armed and not was_armed and self.judge and self._same_session(now) is not self._same:
                self._judge_anew("another session, by the wall clock")
        held = self.diagnosis
        self._effects += self.reaction.step(held, self.armed, received, now)
        self._notices += self._telling.step(held, self._armings)
        return (*self._effects, *self._presenter.present(self._notices, now))

    def broken(self, reason: str, now: Instant) -> tuple[Effect, ...]:
        """An error of the program ends this session's work until the vehicle starts anew."""
        self._effects, self._notices = [], []
        if self.working:
            self._off(Trigger.BROKEN, reason)
        return (*self._effects, *self._presenter.present(self._notices, now))

    def finish(self) -> tuple[Effect, ...]:
        """The daemon stops, or the vehicle started anew: as `Judge.finish`."""
        return () if self.judge is None else self.judge.finish()

    def acknowledge(self, whose: str, *, calls_off: bool = True) -> tuple[Effect, ...]:
        """Close an open inspection, or call off what is about to be done; a fault in flight cannot be acknowledged.

        whose: who says so, for the journal. calls_off: whether that one may call off anything.
        """
        held = self.diagnosis
        if calls_off and (called_off := self.reaction.acknowledge(whose)):
            return tuple(called_off)
        if held.stage is not Stage.INSPECT:
            why = "the vehicle flies with the fault" if held.stage is Stage.FAULT else "no inspection is open"
            return (Note(f"acknowledged by {whose}, without effect: {why}"),)
        if self.judge is not None:
            changes = self.judge.acknowledge()
        else:
            self._held = Diagnosis(reason="the inspection is acknowledged")
            changes = (Change.of(self._held, 0),)
        motors = motors_words(held)
        told = Notice(Kind.ACKNOWLEDGED, (motors,)).effect
        return (Note(f"inspection of {motors} acknowledged by {whose}"), *changes, told)

    @property
    def acknowledgeable(self) -> bool:
        """Whether `acknowledge` has an effect."""
        return self.diagnosis.stage is Stage.INSPECT or bool(self.reaction.pending)

    def tune(self, **settings: float) -> tuple[Effect, ...]:
        """Go on with other valid `texts_per_minute`, `threshold_scale` (on the ground). Raises as `chain_for`."""
        tuned = self.settings.model_copy(update=settings)
        if "threshold_scale" in settings and self.baseline is not None:
            chain_for(self.baseline, tuned, 0)
        self._presenter.per_minute, self.settings = tuned.texts_per_minute, tuned
        if "threshold_scale" not in settings or self.judge is None:
            return ()
        self._effects = []
        self._judge_anew("the scale of the thresholds was set")
        return tuple(self._effects)

    def _judge_anew(self, why: str) -> None:
        """Let a chain with other thresholds be made from the streams."""
        self._effects += self.finish()
        self._held, self.judge = self._landed(), None
        if self.state is State.MONITORING:
            self._move(Trigger.STREAMS_LOST, why)

    def _same_session(self, now: Instant) -> bool:
        """Whether the baseline was taught in this session, by the wall clock, which may be set late."""
        return self.baseline is not None and self.baseline.same_session(self._unix_ns(now))

    def _unix_ns(self, now: Instant) -> int:
        return now.ns + self.unix_offset_ns if self.unix_offset_ns else 0

    def _landed(self) -> Diagnosis:
        if self.judge is not None:
            return self.judge.landed()
        return self._held if self._held.stage is Stage.INSPECT else NOTHING_SEEN

    def _move(self, trigger: Trigger, reason: str = "") -> None:
        old, self.state, self.reason = self.state, TABLE[self.state][trigger], reason or trigger.value
        self._effects.append(StateChanged(old, self.state, self.reason))

    def _say(self, kind: Kind, *words: str, key: str = "") -> None:
        self._notices.append(Notice(kind, words, key))

    def _off(self, trigger: Trigger, reason: str, short: str = "") -> None:
        if self.judge is not None:
            self._held, self.judge = self._landed(), None
        self._move(trigger, reason)
        self._short = short or reason
        self._say(Kind.OFF, self._short)

    def _link(self, received: Received, now: Instant) -> None:
        limit_s = self.settings.link_lost_s
        if received.alive:
            silent_s, self.latest = now - self.latest, now
            if self.state is State.LOST:
                self._move(Trigger.LINK_BACK)
                self._say(Kind.LINK_BACK, f"{silent_s:.0f}" if silent_s >= 99.95 else f"{silent_s:.1f}")
        elif now - self.latest > limit_s and Trigger.LINK_LOST in TABLE[self.state]:
            self._stop_judging(landed=True)
            self._move(Trigger.LINK_LOST, f"nothing came for {limit_s:g} s")
            self._begin_link()
            self._say(Kind.LINK_LOST)

    def _reboot(self, received: Received) -> None:
        if received.reboots == self.reboots or Trigger.REBOOT not in TABLE[self.state]:
            return
        self._effects += self.finish()
        self._held, self.judge, self.reboots, self._unjudged = self.diagnosis, None, received.reboots, {}
        self._begin_link()
        self._begin_learning()
        self._move(Trigger.REBOOT)
        self._say(Kind.REBOOT)

    def _observe(self, received: Received, now: Instant) -> None:
        if self.state is State.LOST:
            return
        streams, profile, own = self.streams, self._profile(received), self.spec.profile
        had_gyro, had_doubt = streams.gyro.samples > 0, streams.scale_doubt
        streams.observe(received.telemetry, now, profile)
        gyro = message_name(profile.imu) + f" of sensor {received.sensor}" * bool(received.sensor)
        if streams.gyro.latest is not None and gyro != self._gyro:
            missing = self._gyro + " of sensor 0" * bool(received.sensor)
            back = gyro == message_name(own.imu)
            text = f"the gyro is read from {gyro}" + (" again" if back else f", for {missing} does not come")
            poor = ": the estimator's rates, filtered, at a low rate and without accelerometer"
            self._gyro, other = gyro, "; what was learnt may not suit another sensor" * (had_gyro and not back)
            self._effects.append(Note(text + poor * (profile.imu == LAST_RESORT) + other))
            self._notices += [Notice(Kind.OTHER_GYRO, (gyro,))] * had_gyro
            self._begin_learning()  # a flight of two gyros teaches neither
        if streams.scale_doubt and not had_doubt:
            felt = f"but {streams.scale_doubt}"
            self._effects.append(Note(f"the vehicle does not feel 1 g by the scale of the profile {own.name}, {felt}"))
        looked = now - self._looked < LOOK_S and not received.acks
        if looked or not self.settings.negotiate or self.state in (State.FITTING, State.FAULTED):
            return
        self._looked = now
        effects, notices = self._negotiation.step(self._demand(received).wants, streams, received.acks, now)
        self._effects += effects
        self._notices += notices
        asked = self._sticks_asked is not None and now - self._sticks_asked < STICKS_S
        if self.state is State.MONITORING and self.reaction.blind and not asked and self._negotiation.free:
            self._sticks_asked = now
            self._effects += self._negotiation.ask_for(MessageId.RC_CHANNELS, STICKS_HZ, now)
        due = telling(own.autopilot, received.parameters, learns=self.baseline is None)
        names = self._reading.step(due, received.parameters, now)
        self._effects += [AskParameters(names)] if names else []

    def _demand(self, received: Received) -> Demand:
        judge, profile = self.judge, self._profile(received)
        rests_on = (id(self.baseline), id(judge and judge.chain), profile.imu)
        if self._demanded is None or self._demanded[0] != rests_on:
            judged = [slot.monitor.signals for slot in judge.chain.slots] if judge else []
            self._looked = Instant(0)
            self._demanded = (rests_on, Demand.of(self.settings, profile, self.baseline, judged))
        return self._demanded[1]

    def _profile(self, received: Received) -> Profile:  # of the link, with the IMU message that is read
        profile = self.spec.profile
        return profile if received.imu in (None, profile.imu) else replace(profile, imu=received.imu)

    def _lack(self, received: Received) -> Hindrance | None:
        return self._demand(received).lack(self.streams, judging=self.state is State.MONITORING)

    def _waiting(self, received: Received, now: Instant) -> None:
        if not self.armed and self.diagnosis.stage is Stage.FAULT:
            self._stop_judging(landed=True)
        if self.baseline is not None and (self.judge is None or self.judge.baseline is not self.baseline):
            try:
                check_link(self.baseline, profile=self.spec.profile.name, dt_s=self.baseline.link.dt_s)
                chain = chain_for(self.baseline, self.settings, self._unix_ns(now))
            except BaselineError as error:
                return self._off(Trigger.REFUSED, str(error), error.short)
            self.judge, self._same = Judge(self.baseline, chain, now, self._landed()), self._same_session(now)
            notes, notices = beginning(self.baseline, chain, self.settings)
            self._effects, self._notices = [*self._effects, *notes], [*self._notices, *notices]
        lack = self._lack(received)
        if lack is None or lack.reason in (Reason.MEASURING, Reason.NO_GYRO, Reason.NO_SETPOINTS):
            self._waited = [*self._waited, received.telemetry][-WAITED_CHUNKS:]
        else:
            self._waited = []  # no wrong rate later
        if lack is not None:
            self.reason = lack.text
            return self._say(Kind.WAITING, lack.text, key=lack.reason)
        waited, self._waited = self._waited, []
        if self.judge is None:
            return self._move(Trigger.READY_TO_LEARN)
        self.judge.judged = now
        self._move(Trigger.READY_TO_JUDGE)
        return self._record(self.judge, self.judge.step(joined(waited), now))

    def _learning(self, received: Received, now: Instant) -> None:
        lack = self._lack(received)
        if lack is not None:
            return self._move(Trigger.STREAMS_LOST, lack.text)
        profile, goal_s = self.spec.profile, (self.settings.learn or 0.0) * (1 + self._failed)
        ground = self.streams.on_ground(profile.gate)
        gyro = received.telemetry.get(Signal.BODY_RATE)
        if ground is None:
            self._flight.append(received.telemetry)
            self.flight_s += (0 if gyro is None else len(gyro)) * (self.streams.gyro.periods_s or (0.0,))[-1]
        if self.flight_s >= goal_s:
            self._move(Trigger.COLLECTED)
            self._flight = [joined(self._flight)]
            self._effects.append(Learn(profile.name, self._flight[0], received.parameters))
            return self._say(Kind.FITTING)
        percent = int(100 * self.flight_s / goal_s)
        shown, why = percent - percent % PROGRESS_STEP, f": {ground.text}" if ground else ""
        self.reason = f"{percent} % of {goal_s:g} s{why}"
        return self._say(Kind.LEARNING, str(percent), why, key=f"{shown}{why}")

    def _fitting(self, received: Received, now: Instant) -> None:
        """A fit that failed is tried again with more flight: what was collected stays."""
        outcome = self._outcome
        if outcome is None:
            return None
        if isinstance(outcome, str):
            self._failed += 1
            if self._failed >= FITS:
                return self._off(Trigger.GIVEN_UP, f"cannot learn: {outcome}")
            self._move(Trigger.NOT_FITTED, outcome)
            return self._say(Kind.NOT_LEARNED, outcome)
        self.baseline = outcome
        self._begin_learning()
        self._move(Trigger.FITTED)
        self._effects.append(outcome)
        judging, refused = len({entry.spec.kind for entry in outcome.monitors}), len(outcome.not_judgeable)
        return self._say(Kind.LEARNED, str(judging), f", {refused} cannot" if refused else "")

    def _monitoring(self, received: Received, now: Instant) -> None:
        judge, lack = self.judge, self._lack(received)
        if judge is None or lack is not None:
            self._stop_judging(landed=not self.armed)
            self._waited = []
            return self._move(Trigger.STREAMS_LOST, lack.text if lack else "")
        output = judge.step(received.telemetry, now)
        self._record(judge, output)
        if self.state is State.FAULTED:
            return None
        self._effects += self._named_values.step(output, now)
        if not (why := judge.sight.hidden):
            return self._idle(judge, now)
        if (reason := f"not judged: {why}") != self.reason:
            self._effects.append(Note(reason))
        self.reason = reason
        return self._say(Kind.HIDDEN, why, key=why)

    def _record(self, judge: Judge, output: ChainOutput) -> None:
        self._effects += records_of(output, judge.baseline.airframe.name)
        if output.likeness is None or output.likeness.outcome is not Outcome.FAR:
            return None
        if refused := judge.memory.refused:
            return self._off(Trigger.REFUSED, refused, output.likeness.differing[0])
        return self._say(Kind.OTHER_VEHICLE)

    def _stop_judging(self, *, landed: bool) -> None:
        if self.judge is not None:
            self._record(self.judge, self.judge.end_flight(landed=landed))

    def _idle(self, judge: Judge, now: Instant) -> None:
        ground, unjudged = self.streams.on_ground(judge.chain.front.gate), judge.not_judged(self.streams, now)
        if unjudged != self._unjudged:
            news = [one for one in unjudged.items() if one not in self._unjudged.items()]
            self._effects += [Note(f"{label} not judged: {why}") for label, why in news]
        why, short = words_of(unjudged) if unjudged else ("", "")
        if now - judge.judged >= IDLE_S and (ground or not unjudged):
            why = short = f": {ground.text if ground else 'propellers not judged'}"
        self.reason, self._unjudged = f"monitoring{why}", unjudged
        if judge.memory.decision.diagnosis.stage not in (Stage.FAULT, Stage.INSPECT) or unjudged:
            self._say(Kind.MONITORING, short, key=short)

    def _faulted(self, received: Received, now: Instant) -> None:
        self._say(Kind.OFF, self._short)
