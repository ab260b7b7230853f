"""The daemon (edge): one loop on one thread that looks at its links every few hundredths of a second.

What arrives waits in the system's buffers between two looks. Heartbeats come from the same loop and ask the session
first: a daemon that hangs, or a session that cannot do its work, falls silent.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
from typing import TYPE_CHECKING

from detector.component import HEALTH, Handled, Requests, Sender
from detector.config import Settings
from detector.fitting import ProcessFitter
from detector.fleet import DaemonFigures, Fleet, Turn
from detector.flights import Flights
from detector.guard import Guard
from detector.hooks import Hook
from detector.journal import Journal, Recorder, Reporter, When
from detector.notify import Notifier
from detector.relay import Relay
from detector.rules import parse_rules
from detector.values import Effect, Learn, Note, SessionSpec, is_working
from mavdiag import __version__
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Change
from mavdiag.inspections import Inspections
from mavdiag.link.datagrams import Datagrams, joined_datagrams
from mavdiag.link.keys import KeptSigning
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.link.ports import PEER_FRESH_S, Endpoint, Kind, parse_address
from mavdiag.link.profiles import PROFILES, Profile
from mavdiag.link.vehicles import PUZZLED_S
from mavdiag.printable import counted
from mavdiag.storage import use_huge_pages
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from detector.metrics import Metrics  # brings prometheus_client with it
    from detector.web.feed import Feed

BEAT_S = 1.0
TIDY_S = 10.0  # from the start until memory is put in order again, then after twice that time each (our choice)
DRAINS = 24  # reads of the vehicle's link in one tick: as many datagrams as the system keeps for us (our choice)
LEAST = 0.3  # of a tick, in processor time, that judging has however much there is to read, and (our choice)
MOST = 0.8  # of a tick, as the clock goes, in which vehicles are judged if there is time (our choice)
STOP_S = 5.0  # in which what waits is judged when the daemon stops (our choice: half of what the stop may take)
UID_TRIES = 3  # a second apart, before a vehicle is judged by what its system id says (our choice)
UNCLEAR_MOST = 32  # lines about vehicles that are not watched, so that made-up ones do not fill the log (our choice)
FIRST_VEHICLE = 1  # as whose companion we announce ourselves on a link whose other end sends nothing before we do

_ANNOUNCING = (Kind.UDP_OUT, Kind.TCP_CLIENT, Kind.SERIAL)


class Host:
    """The machine: its clocks, and a place for log lines. Tests bring their own."""

    now_ns: Callable[[], int] = staticmethod(time.monotonic_ns)
    utc: Callable[[], datetime] = staticmethod(partial(datetime.now, UTC))
    cpu_s: Callable[[], float] = staticmethod(time.process_time)
    sleep: Callable[[float], None] = staticmethod(time.sleep)
    tidy: Callable[[int], int] = staticmethod(use_huge_pages)

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say


class Daemon:
    """Links on one side, sessions (`fleet`) on the other. `run` it, or `tick` it from a test.

    baseline: what every vehicle is judged by that has none of its own in `baselines`, by system id or uid.
    """

    def __init__(
        self,
        settings: Settings,
        host: Host,
        link: Endpoint,
        behind: Sequence[Endpoint],
        *,
        baseline: Baseline | None,
        fitter: ProcessFitter,
        baselines: Mapping[int | str, Baseline] | None = None,
        airframe: Airframe | None = None,
        journal: Journal | None = None,
        recorder: Recorder | None = None,
        hooks: Sequence[Hook] = (),
        flights: Flights | None = None,
        metrics: "Metrics | None" = None,
        web: "Feed | None" = None,
        notifier: Notifier | None = None,
        signing: KeptSigning | None = None,
        inspections: Inspections | None = None,
    ) -> None:
        self._settings, self._host, self._link, self._behind = settings, host, link, tuple(behind)
        self._baseline, self._baselines, self._fitter = baseline, dict(baselines or {}), fitter
        self._by_uid = any(isinstance(whose, str) for whose in self._baselines)
        self._flights, self._uid_asked = flights, dict[int, tuple[int, list[Instant]]]()
        self._airframe, self._notifier, self._metrics, self._web = airframe, notifier or Notifier({}), metrics, web
        self._relay, self._recorder = Relay(link, behind, self._upward), recorder
        self._kept, self._signing = signing, None if signing is None else signing.signing
        self._announces = parse_address(settings.connect).kind in _ANNOUNCING
        self._passed: list[tuple[bytes, int]] = []
        self.fleet = Fleet(
            self._spec,
            profile=None if settings.profile is None else PROFILES[settings.profile],
            only=settings.vehicle,
            datagrams=link.datagrams,
            most=settings.max_vehicles,
            signing=self._signing,
            passed=self._passed if behind or recorder is not None or flights is not None else None,
            knows=self._knows if self._by_uid else None,
        )
        self._guard = Guard(self.fleet.link, self._signing)
        files = {hook.name: hook for hook in hooks} | {"journal": journal, "record": recorder, "history": flights}
        self._files = {name: file for name, file in files.items() if file is not None}
        writers = [file.write for file in (journal, web, *hooks) if file]
        self._reporter = Reporter(writers, host.say, self._when, settings.save)
        self._inspections = inspections or Inspections(None, host.say)
        self._sender = cache(partial(Sender, signing=self._signing))
        self._requests = Requests(self.fleet, settings.keep_rates, self._sender, self._signing)
        self._started = self._beat_at = self._tidy_at = self._now()
        self._tidied = 0  # place up to which memory is in order; 0 if it is all
        self._epoch_ns = 0  # unix time less the host's clock, renewed where the wall clock was set
        self._late, self._latest_s, self._unclear = 0, 0.0, set[tuple[int, str]]()

    def run(self, stop: Callable[[], bool]) -> None:
        """Look at the links until `stop` says so; then look once more and write the summary."""
        self.begin()
        next_at = self._now()
        while not stop():
            self.tick()
            next_at = self.fleet.next_look(next_at, self._settings.tick_s)
            late_s = self._now() - next_at
            if late_s > 0:
                self._late, self._latest_s = self._late + 1, max(self._latest_s, late_s)
                next_at = self._now()  # behind: look again at once, and do not hurry after lost time
            else:
                self._host.sleep(-late_s)
        self._notifier.stopping()
        self.tick()
        self.end()

    def begin(self) -> None:
        """Say that the links are open."""
        learn_s, own = self._settings.learn, len(self._baselines)
        goals = ["watching by its baseline"] if self._baseline else []
        goals += [f"learning from {learn_s:g} s of healthy flight"] if learn_s and not self._baseline else []
        whose = f"{counted(own, 'vehicle')} by baselines of their own"
        goals += [whose if goals else f"watching {whose}"] if own else []
        behind = "".join(f", forwarding to {endpoint.address}" for endpoint in self._behind)
        for rule in parse_rules(self._settings.on_fault):
            self._host.say(f"on fault: {rule}")
        self._reporter.mark("start", {"version": __version__, "connect": self._link.address})
        self._host.say(f"ready: {self._link.address}{behind}, {', '.join(goals)}")
        if self._web is not None:
            self._host.say(f"web page: {self._web.where}")
        self._notifier.ready()
        self._add_left()

    def tick(self) -> None:
        """One look: take what came, let the sessions go on as there is time, do what they want."""
        now, known, host, tick_s = self._now(), len(self.fleet.vehicles), self._host, self._settings.tick_s
        epoch_ns = self._unix_ns() - now.ns
        self._epoch_ns = epoch_ns if abs(epoch_ns - self._epoch_ns) > NS_PER_S else self._epoch_ns
        pieces = list[Datagrams]()
        while len(pieces) < DRAINS and (more := self._link.receive(0.0)):
            pieces.append(more)
        self.fleet.take(joined_datagrams(pieces), now)
        for sysid, outcome in self._fitter.poll():
            self.fleet.vehicles[sysid].outcome = outcome
        since_s, sure = host.cpu_s(), now + MOST * tick_s

        def has_time() -> bool:
            return self._now() - sure < 0 or host.cpu_s() - since_s < LEAST * tick_s

        turns = self.fleet.judge(now, has_time)
        if self._flights is not None:
            self._flights.look(self._passed, self.fleet.vehicles, now, self._epoch_ns)
        if self._recorder is not None:
            self._recorder.write(self._passed, self._epoch_ns)
        self._relay.pass_on(self._passed)
        self._passed.clear()
        self._report_new(known)
        self._carry_out(turns)
        if self._metrics is not None:
            self._metrics.observe(turns)
        if self._web is not None:
            self._web.look(self.fleet, turns, now)
            for sysid in self._web.acknowledged():
                self._acknowledge(sysid, "the live page", calls_off=False)
        if now - self._beat_at >= 0:
            self._beat(now)
            self._watch(now)
            self._beat_at = max(self._beat_at + BEAT_S, now)
        if now - self._tidy_at >= 0:
            self._tidied = self._host.tidy(self._tidied)
            self._tidy_at = now if self._tidied else now + max(TIDY_S, now - self._started)
        self._flush(now)

    def end(self) -> None:
        """Judge what waits, record the open events, write the last line and the summary."""
        now = self._now()
        self._carry_out(self.fleet.finish(now, lambda: self._now() - now < STOP_S))
        self._fitter.close()
        if self._flights is not None:
            self._flights.end(self.fleet.vehicles)
        summary = self._summary()
        self._reporter.mark("stop", {"summary": summary})
        self._flush()
        self._host.say(summary)

    def figures(self) -> DaemonFigures:
        """Where it stands."""
        return DaemonFigures(
            tuple(self.fleet.vehicles.values()),
            (self._link, *self._behind),
            self._late,
            self._host.cpu_s(),
            {name: file.lost for name, file in self._files.items()},
            self._guard.refused,
            self.fleet.longest_s,
        )

    def _now(self) -> Instant:
        return Instant(self._host.now_ns())

    def _when(self, sysid: int | None) -> When:
        timeline = None if sysid is None else self.fleet.link.vehicles[sysid].state.timeline
        return When(self._host.utc(), sysid, None if timeline is None else timeline.t_ns)

    def _unix_ns(self) -> int:
        return round(self._host.utc().timestamp() * NS_PER_S)

    def _flush(self, now: Instant | None = None) -> None:
        self._relay.flush()
        for file in self._files.values():
            file.flush()
        self._inspections.flush(now)

    def _knows(self, sysid: int) -> bool:
        """Whether the uid is known that a baseline may be named by; it is asked for after each start of the vehicle."""
        stream, now = self.fleet.link.vehicles[sysid], self._now()
        reboots, (boot, asked) = stream.state.timeline.reboots, self._uid_asked.get(sysid, (0, []))
        if sysid in self._baselines or (stream.uid and not reboots):
            return True
        self._uid_asked[sysid] = reboots, asked = reboots, asked if boot == reboots else []
        if not asked or now - asked[-1] >= BEAT_S:
            if len(asked) == UID_TRIES:
                return True
            asked.append(now)
            frame = self._sender(sysid).command(MavCmd.REQUEST_MESSAGE, MessageId.AUTOPILOT_VERSION)
            self._relay.send(frame, to_all=False, source=self.fleet.link.source(sysid))
        return stream.uid != ""

    def _own(self, sysid: int) -> Baseline | None:
        stream = self.fleet.link.vehicles.get(sysid)
        return self._baselines.get(sysid) or self._baselines.get("" if stream is None else stream.uid)

    def _spec(self, sysid: int, profile: Profile) -> SessionSpec | None:
        baseline = self._own(sysid) or self._baseline
        before, uid = self.fleet.vehicles.get(sysid), self.fleet.link.vehicles[sysid].uid
        swapped = before is not None and before.session.spec.baseline is not baseline
        if swapped:
            self._reporter.record(sysid, Note(f"its uid is {uid}: it is not judged by the same baseline any more"))
        # The new propellers of another vehicle close no inspection of this one.
        held = self._inspections.held(sysid, None if baseline is None or swapped else baseline.propellers)
        if baseline is None and self._settings.learn is None:
            where = f"; its uid is {uid}" if uid else ""
            self._host.say(f"vehicle {sysid}: not watched: it has no baseline; name one in [vehicles.{sysid}]{where}")
            return None
        return SessionSpec(profile, baseline, self._settings, self._epoch_ns, held)

    def _watch(self, now: Instant) -> None:
        sources = self.fleet.link.sources_since(now.ns - round(PEER_FRESH_S * NS_PER_S))
        trusted = [source for source in sources if isinstance(source, tuple)]
        self._link.trust(trusted, alone=self._signing is not None)
        turns, texts = self._guard.look(now, self._link.traffic.turned_away)
        for sysid, whose in self._inspections.acknowledged():
            self._acknowledge(sysid, whose)
        failure = None if self._kept is None else self._kept.step(self._unix_ns())
        puzzles = [self.fleet.link.babble] if now - self._started >= PUZZLED_S else []
        news = {(0, text) for text in (*puzzles, *(end.absent for end in (self._link, *self._behind))) if text}
        texts += [text for _, text in sorted(news - self._unclear)]
        self._unclear |= news
        self._carry_out(turns)
        for text in filter(None, (*texts, failure)):
            self._reporter.mark("note", {"text": text})
            self._host.say(text)

    def _acknowledge(self, sysid: int, whose: str, *, calls_off: bool = True) -> None:
        vehicle = self.fleet.vehicles.get(sysid)
        if vehicle is not None:
            self._carry_out([Turn(sysid, vehicle.session.acknowledge(whose, calls_off=calls_off))])
        elif self._inspections.close(sysid):
            self._reporter.mark("note", {"text": f"inspection of vehicle {sysid} acknowledged by {whose}"})

    def _report_new(self, known: int) -> None:
        for sysid, reason in self.fleet.link.waiting.items():
            if (sysid, reason) not in self._unclear and len(self._unclear) < UNCLEAR_MOST:
                self._host.say(f"vehicle {sysid}: not watched: {reason}")
                self._unclear.add((sysid, reason))
        if len(self.fleet.vehicles) == known:
            return
        new = list(self.fleet.vehicles.items())[known:]
        for sysid, vehicle in new:
            self._host.say(f"vehicle {sysid}: received, profile {vehicle.session.spec.profile.name}")
        self._add_left()
        shared = sum(self._own(sysid) is None for sysid in self.fleet.vehicles)
        if shared > 1 and self._baseline and self._baseline.airframe.scope == "airframe":
            several = f"the baseline is of one airframe ({self._baseline.airframe.name}), but several fly"
            self._host.say(f"{several}; choose one with --vehicle, or give each its own in [vehicles.N]")

    def _add_left(self) -> None:
        if self._flights is not None:
            self._flights.add_left(lambda sysid: self._own(sysid) or self._baseline)

    def _beat(self, now: Instant) -> None:
        for sysid in self.fleet.link.vehicles if self._by_uid else ():
            self._knows(sysid)
        for sysid, vehicle in self.fleet.vehicles.items():
            vehicle.session.unix_offset_ns = self._epoch_ns
            if vehicle.session.working:
                self._relay.send(self._sender(sysid).heartbeat(HEALTH[vehicle.session.state]))
        if self._announces and not self.fleet.vehicles:
            first = self._sender(self._settings.vehicle or FIRST_VEHICLE)
            self._relay.send(first.heartbeat(), to_all=False)
        if self._metrics is not None:
            self._metrics.show(self.figures(), self._host.now_ns())
        if self._web is not None:
            self._web.show(self.figures(), now)
        if text := self.fleet.delay_news(now):
            self._host.say(text)
        states = Counter(vehicle.session.state for vehicle in self.fleet.vehicles.values())
        judged_s = sum(vehicle.judged_s for vehicle in self.fleet.vehicles.values())
        counts = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
        status = f"{counts}; {judged_s:.0f} s judged" if counts else "no vehicle was received yet"
        self._notifier.status(status, alive=is_working(states))

    def _upward(self, frames: list[bytes], behind: Endpoint) -> Iterable[bytes]:
        handled = self._requests.from_behind(frames, self._now())
        self._answer(handled, behind.send)
        return handled.passed

    def _answer(self, handled: Handled, send: Callable[[bytes], object]) -> None:
        self._relay.flush()
        for frame in handled.answers:
            send(frame)
        self._carry_out(handled.turns)

    def _carry_out(self, turns: Sequence[Turn]) -> None:
        for turn in turns:
            for frame in turn.asked:
                source = self.fleet.link.source(frame.sysid, frame.compid)
                self._requests.ask(frame, turn.vehicle, handled := Handled(), trusted=self._signing is not None)
                self._answer(handled, partial(self._link.answer, source=source))
            for effect in turn.effects:
                self._act(turn.vehicle, effect)

    def _act(self, sysid: int, effect: Effect) -> None:
        frames, for_all = self._sender(sysid).frames(effect)
        for frame in frames:
            self._relay.send(frame, to_all=for_all, source=None if for_all else self.fleet.link.source(sysid))
        match effect:
            case Learn():
                airframe = self._airframe or Airframe(name=f"vehicle {sysid}")
                airframe = replace(airframe, name=self._settings.name or airframe.name)
                self._fitter.begin(sysid, airframe, effect, self._settings.accept)
            case Baseline():
                for told in self._reporter.save(sysid, effect):
                    self._act(sysid, told)
            case Change():
                baseline = self.fleet.vehicles[sysid].session.baseline
                judged_by = ("", 0) if baseline is None else (baseline.digest, baseline.propellers)
                self._inspections.take(sysid, effect, *judged_by, self._host.utc().isoformat(timespec="seconds"))
        self._reporter.record(sysid, effect)

    def _summary(self) -> str:
        ran_s = self._now() - self._started
        vehicles = (
            f"vehicle {sysid} {vehicle.session.state}, {vehicle.count.received} frames, {vehicle.count.lost} lost on "
            f"the way, {vehicle.judged_s:.1f} s judged, {vehicle.alarms.total()} events"
            for sysid, vehicle in self.fleet.vehicles.items()
        )
        late = f", {self._late} looks came late, by {self._latest_s:.2f} s at most" if self._late else ""
        lost = "".join(f", {file.lost} entries lost to the {name}" for name, file in self._files.items() if file.lost)
        cpu = 100.0 * self._host.cpu_s() / max(1e-9, ran_s)
        overflowed = f"{self._link.traffic.overflowed} datagrams overflowed here{late}{lost}, {cpu:.1f} % CPU"
        return "; ".join(filter(None, (f"stopped after {ran_s:.1f} s", *vehicles, self._guard.summary(), overflowed)))
