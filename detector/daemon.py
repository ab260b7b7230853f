"""The daemon (edge): one loop on one thread that looks at its links every few hundredths of a second.

It lets what arrives wait in the system's buffers between two looks, which costs far less than waking for every
datagram. Heartbeats come from the same loop and ask the session first: a daemon that hangs, or a session that cannot do
its work, falls silent.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from detector.config import Settings
from detector.fitting import Fitter, FittingJob
from detector.fleet import Fleet, Turn
from detector.journal import Journal, Recorder, When, line, mark
from detector.pacing import Pacing
from detector.relay import Relay
from detector.sender import MavlinkSender
from detector.states import State
from detector.values import (
    AskInterval,
    Effect,
    EventOpened,
    Learn,
    Note,
    SendFloat,
    SendText,
    SessionSpec,
    StateChanged,
    TextSuppressed,
)
from mavdiag import __version__
from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change
from mavdiag.errors import UsageError
from mavdiag.link.codec import message_name
from mavdiag.link.ports import Chunk, Endpoint, Kind, parse_address
from mavdiag.link.profiles import PROFILES, Profile
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:
    from detector.metrics import Metrics  # brings prometheus_client with it

__all__ = ["Daemon", "Host"]

BEAT_S = 1.0
DRAINS = 8  # looks at the vehicle's link in one tick, so that a backlog is worked off but cannot hold the loop
FIRST_VEHICLE = 1  # as whose companion we announce ourselves on a link whose other end sends nothing before we do

_DATAGRAMS = (Kind.UDP_IN, Kind.UDP_OUT)
_ANNOUNCING = (Kind.UDP_OUT, Kind.TCP_CLIENT, Kind.SERIAL)


class Host:
    """The machine as the daemon sees it: clocks and a place for log lines. Tests bring their own."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say

    def now_ns(self) -> int:
        """The monotonic clock [ns]."""
        return time.monotonic_ns()

    def utc(self) -> datetime:
        """The wall clock."""
        return datetime.now(UTC)

    def cpu_s(self) -> float:
        """Processor time used so far [s]."""
        return time.process_time()

    def sleep(self, span_s: float) -> None:
        """Wait."""
        time.sleep(span_s)


class Daemon:
    """Links on one side, sessions (`fleet`) on the other. `run` it, or `tick` it from a test."""

    def __init__(
        self,
        settings: Settings,
        host: Host,
        link: Endpoint,
        behind: Sequence[Endpoint],
        *,
        baseline: Baseline | None,
        fitter: Fitter,
        airframe: Airframe | None = None,
        journal: Journal | None = None,
        recorder: Recorder | None = None,
        metrics: "Metrics | None" = None,
    ) -> None:
        self._settings, self._host, self._link = settings, host, link
        self._baseline, self._fitter, self._journal, self._metrics = baseline, fitter, journal, metrics
        self._airframe = airframe
        kind = parse_address(settings.connect).kind
        self._relay = Relay(link, behind, datagrams=kind in _DATAGRAMS, recorder=recorder)
        self._announces = kind in _ANNOUNCING
        profile = None if settings.profile is None else PROFILES[settings.profile]
        self.fleet = Fleet(
            self._spec,
            profile=profile,
            only=settings.vehicle,
            datagrams=kind in _DATAGRAMS,
            pacing=Pacing.of(settings.tick_s),
        )
        self._senders: dict[int, MavlinkSender] = {}
        self._started = self._now()
        self._beat_at = self._started
        self._late, self._latest_s = 0, 0.0
        self._saved: dict[int, Path] = {}
        self._unclear: dict[int, str] = {}

    def run(self, stop: Callable[[], bool]) -> None:
        """Look at the links until `stop` says so; then write the summary."""
        self.begin()
        next_at = self._now()
        while not stop():
            self.tick()
            next_at = next_at + self._settings.tick_s
            late_s = self._now() - next_at
            if late_s > 0:
                self._late, self._latest_s = self._late + 1, max(self._latest_s, late_s)
                next_at = self._now()  # behind: look again at once, and do not hurry after lost time
            else:
                self._host.sleep(-late_s)
        self.end()

    def begin(self) -> None:
        """Say that the links are open."""
        settings = self._settings
        goal = "watching by its baseline" if self._baseline else f"learning from {settings.learn:g} s of healthy flight"
        behind = "".join(f", forwarding to {address}" for address in self._relay.addresses)
        self._host.say(f"ready: {self._link.address}{behind}, {goal}")
        self._mark("start", {"version": __version__, "connect": self._link.address})

    def tick(self) -> None:
        """One look: take what came, let the sessions go on, do what they want."""
        now = self._now()
        chunks = self._chunks()
        self._relay.pass_on(chunks)
        known = len(self.fleet.vehicles)
        for sysid, outcome in self._fitter.poll():
            self.fleet.vehicles[sysid].outcome = outcome
        turns = self.fleet.step(chunks, now, lambda: self._now() - now)
        self._report_new(known)
        self._carry_out(turns)
        if now - self._beat_at >= 0:
            self._beat()
            self._beat_at = max(self._beat_at + BEAT_S, now)

    def end(self) -> None:
        """Record the open events, write the last line and the summary."""
        self._carry_out(self.fleet.finish())
        self._fitter.close()
        summary = self._summary()
        self._mark("stop", {"summary": summary})
        self._host.say(summary)

    def _now(self) -> Instant:
        return Instant(self._host.now_ns())

    def _spec(self, profile: Profile) -> SessionSpec:
        offset_ns = round(self._host.utc().timestamp() * NS_PER_S) - self._host.now_ns()
        return SessionSpec(profile, self._baseline, self._settings, offset_ns)

    def _chunks(self) -> list[Chunk]:
        chunks: list[Chunk] = []
        for _ in range(DRAINS):
            more = self._link.receive(0.0)
            if not more:
                break
            chunks += more
        return chunks

    def _sender(self, vehicle: int) -> MavlinkSender:
        return self._senders.setdefault(vehicle, MavlinkSender(vehicle))

    def _report_new(self, known: int) -> None:
        """Name the vehicles that are new, and say once why another is not watched."""
        for sysid, reason in self.fleet.link.waiting.items():
            if self._unclear.get(sysid) != reason:
                self._host.say(f"vehicle {sysid}: not watched: {reason}")
            self._unclear[sysid] = reason
        new = list(self.fleet.vehicles.items())[known:]
        for sysid, vehicle in new:
            self._host.say(f"vehicle {sysid}: received, profile {vehicle.session.spec.profile.name}")
        if new and known + len(new) > 1 and self._baseline and self._baseline.airframe.scope == "airframe":
            name = self._baseline.airframe.name
            self._host.say(f"the baseline is of one airframe ({name}), but several fly; choose one with --vehicle")

    def _beat(self) -> None:
        """Heartbeats of the healthy sessions; on a link where we must send first, also before a vehicle."""
        for sysid, vehicle in self.fleet.vehicles.items():
            if vehicle.session.healthy:
                self._relay.send_to_all(self._sender(sysid).heartbeat(vehicle.session.state.state))
        if self._announces and not self.fleet.vehicles:
            self._relay.send_to_vehicle(self._sender(self._settings.vehicle or FIRST_VEHICLE).heartbeat(State.WAITING))
        self.fleet.delay, text = self.fleet.delay.news(self._now())
        if text:
            self._host.say(text)
        if self._metrics is not None:
            overflowed, cpu_s = self._link.traffic.overflowed, self._host.cpu_s()
            self._metrics.show(self.fleet.figures(), overflowed=overflowed, late=self._late, cpu_s=cpu_s)

    def _carry_out(self, turns: Sequence[Turn]) -> None:
        for turn in turns:
            for asked in turn.commands:
                decline = self._sender(turn.vehicle).decline(asked.command, asked.sysid, asked.compid)
                self._relay.send_to_vehicle(decline)
            for effect in turn.effects:
                self._act(turn.vehicle, effect)
                self._record(turn.vehicle, effect)

    def _act(self, sysid: int, effect: Effect) -> None:
        """The effects that do something."""
        sender = self._sender(sysid)
        match effect:
            case SendText():
                self._relay.send_to_all(sender.text(effect))
            case SendFloat():
                self._relay.send_to_all(sender.value(effect))
            case AskInterval(msgid, interval_us):
                self._relay.send_to_vehicle(sender.request(effect))
                self._record(sysid, Note(f"asked for {message_name(msgid)} at {1e6 / interval_us:.0f} Hz"))
            case Learn(profile, telemetry, parameters):
                airframe = self._airframe or Airframe(name=f"vehicle {sysid}")
                airframe = replace(airframe, name=self._settings.name or airframe.name)
                self._fitter.begin(FittingJob(sysid, airframe, profile, telemetry, parameters))
            case Baseline():
                self._save(sysid, effect)
            case EventOpened(event):
                if self._metrics is not None:
                    self._metrics.count_event(sysid, event.monitor)

    def _record(self, sysid: int, effect: Effect) -> None:
        """The effects that are worth a line, in the journal and, most of them, in the log."""
        if isinstance(effect, AskInterval | Learn | SendFloat):
            return
        if self._journal is not None:
            when = When(self._host.utc(), sysid, self.fleet.link.vehicles[sysid].vehicle_ns)
            self._journal.write(line(effect, when))
        for words in _log_lines(effect):
            self._host.say(f"vehicle {sysid}: {words}")

    def _mark(self, kind: str, content: dict[str, object]) -> None:
        if self._journal is not None:
            self._journal.write(mark(kind, When(self._host.utc()), content))

    def _save(self, sysid: int, baseline: Baseline) -> None:
        """Keep a learned baseline: the first vehicle's under the name asked for, another's with its id in it."""
        path = self._settings.save
        if path is None:
            return
        if any(vehicle != sysid and taken == path for vehicle, taken in self._saved.items()):
            path = path.with_stem(f"{path.stem}-{sysid}")
        self._saved[sysid] = path
        try:
            baseline.save(path)
        except UsageError as error:
            self._record(sysid, Note(f"the baseline is not saved: {error}"))
        else:
            self._record(sysid, Note(f"baseline saved to {path}"))

    def _summary(self) -> str:
        ran_s = self._now() - self._started
        parts = [f"stopped after {ran_s:.1f} s"]
        parts += [
            f"vehicle {one.vehicle} {one.state}, {one.received} frames, {one.lost} lost on the way, "
            f"{one.judged_s:.1f} s judged, {one.events} events"
            for one in self.fleet.figures()
        ]
        late = f", {self._late} looks came late, by {self._latest_s:.2f} s at most" if self._late else ""
        cpu = 100.0 * self._host.cpu_s() / max(1e-9, ran_s)
        parts.append(f"{self._link.traffic.overflowed} datagrams overflowed here{late}, {cpu:.1f} % CPU")
        return "; ".join(parts)


def _log_lines(effect: Effect) -> list[str]:
    match effect:
        case StateChanged(old, new, reason):
            return [f"{old} -> {new}: {reason}"]
        case Change(stage=stage, reason=reason):
            return [f"decision: {stage}, {reason}"]
        case SendText(severity, text):
            return [f"{severity.name} {text!r}"]
        case Baseline():
            return str(effect).splitlines()
        case Note(text):
            return [text]
        case TextSuppressed(text, count):
            return [f"held back {text!r} ({count} so far)"]
        case _:
            return []
