"""The daemon (edge): one loop on one thread that looks at its links every few hundredths of a second.

It lets what arrives wait in the system's buffers between two looks, which costs far less than waking for every
datagram. Heartbeats come from the same loop and ask the session first: a daemon that hangs, or a session that cannot do
its work, falls silent.
"""

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from detector.config import Settings
from detector.effects import (
    AskInterval,
    BaselineLearned,
    Effect,
    EventOpened,
    Learn,
    Note,
    SendFloat,
    SendText,
    StateChanged,
    TextSuppressed,
)
from detector.fitting import Fitter, FittingJob
from detector.fleet import Fleet, Turn
from detector.journal import Journal, When, line, mark
from detector.relay import Relay
from detector.session import healthy
from detector.values import SessionSpec
from detector.voice import Voice
from mavdiag import __version__
from mavdiag.baseline import Baseline
from mavdiag.errors import UsageError
from mavdiag.link.codec import message_name
from mavdiag.link.ports import Chunk, Endpoint, Kind, parse_address
from mavdiag.link.profiles import PROFILES, Profile
from mavdiag.storage import save_baseline
from mavdiag.telemetry import NS_PER_S, Instant

if TYPE_CHECKING:
    from detector.metrics import Metrics  # brings prometheus_client with it

__all__ = ["Daemon", "Host"]

BEAT_S = 1.0
DRAINS = 8  # looks at the vehicle's link in one tick, so that a backlog is worked off but cannot hold the loop
FIRST_VEHICLE = 1  # as whose companion we knock on a link whose other end must be spoken to first

_DATAGRAMS = (Kind.UDP_IN, Kind.UDP_OUT)
_KNOCKING = (Kind.UDP_OUT, Kind.TCP_CLIENT, Kind.SERIAL)


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
    """Links on one side, sessions on the other. `run` it, or `tick` it from a test."""

    def __init__(
        self,
        settings: Settings,
        host: Host,
        link: Endpoint,
        behind: Sequence[Endpoint],
        *,
        baseline: Baseline | None,
        fitter: Fitter,
        journal: Journal | None = None,
        metrics: "Metrics | None" = None,
    ) -> None:
        self._settings, self._host, self._link = settings, host, link
        self._relay = Relay(link, behind)
        self._baseline, self._fitter, self._journal, self._metrics = baseline, fitter, journal, metrics
        kind = parse_address(settings.connect).kind
        self._knocks = kind in _KNOCKING
        profile = None if settings.profile is None else PROFILES[settings.profile]
        self._fleet = Fleet(self._spec, profile=profile, only=settings.vehicle, datagrams=kind in _DATAGRAMS)
        self._voices: dict[int, Voice] = {}
        self._started = self._now()
        self._beat_at = self._started
        self._saved: dict[int, Path] = {}

    @property
    def fleet(self) -> Fleet:
        """The vehicles."""
        return self._fleet

    def run(self, stop: Callable[[], bool]) -> None:
        """Look, again and again, until told to stop; then say what was done."""
        self.begin()
        due_s = self._now()
        while not stop():
            self.tick()
            due_s = due_s + self._settings.tick_s
            late_s = self._now() - due_s
            if late_s > 0:
                due_s = self._now()  # behind: look again at once, and do not hurry after lost time
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
        known = len(self._fleet.vehicles)
        for asked in self._fleet.feed(chunks, now):
            self._relay.ask(self._voice(asked.vehicle).decline(asked.command, asked.sysid, asked.compid))
        self._greet(known)
        for vehicle, outcome in self._fitter.poll():
            self._fleet.vehicles[vehicle].answer(outcome)
        self._do(self._fleet.step(now))
        if now - self._beat_at >= 0:
            self._beat()
            self._beat_at = max(self._beat_at + BEAT_S, now)

    def end(self) -> None:
        """Close the books: open events, a last line, a summary."""
        self._do(self._fleet.finish())
        self._fitter.close()
        summary = self._summary()
        self._mark("stop", {"summary": summary})
        self._host.say(summary)

    def _now(self) -> Instant:
        return Instant(self._host.now_ns())

    def _spec(self, profile: Profile) -> SessionSpec:
        settings = self._settings
        return SessionSpec(
            profile,
            self._baseline,
            learn_s=settings.learn or 0.0,
            min_rate_hz=settings.min_rate_hz,
            ask_hz=settings.ask_hz,
            negotiate=settings.negotiate,
            link_lost_s=settings.link_lost_s,
            clear_s=settings.clear_s,
            suspect=settings.suspect,
            texts_per_minute=settings.texts_per_minute,
            twins_hz=settings.twins_hz,
            twins_axis=settings.twins_axis,
        )

    def _chunks(self) -> list[Chunk]:
        chunks: list[Chunk] = []
        for _ in range(DRAINS):
            more = self._link.receive(0.0)
            if not more:
                break
            chunks += more
        return chunks

    def _voice(self, vehicle: int) -> Voice:
        return self._voices.setdefault(vehicle, Voice(vehicle))

    def _greet(self, known: int) -> None:
        """Name the vehicles that are new."""
        newcomers = list(self._fleet.vehicles.items())[known:]
        for sysid, vehicle in newcomers:
            self._host.say(f"vehicle {sysid}: heard, profile {vehicle.spec.profile.name}")
        if newcomers and known + len(newcomers) > 1 and self._baseline and self._baseline.airframe.scope == "airframe":
            name = self._baseline.airframe.name
            self._host.say(f"the baseline is of one airframe ({name}), but several fly; choose one with --vehicle")

    def _beat(self) -> None:
        """Heartbeats of the healthy sessions; on a link that must be spoken to first, also before anyone is heard."""
        for sysid, vehicle in self._fleet.vehicles.items():
            if healthy(vehicle.state):
                self._relay.say(self._voice(sysid).heartbeat(vehicle.state.state))
        if self._knocks and not self._fleet.vehicles:
            self._relay.ask(self._voice(self._settings.vehicle or FIRST_VEHICLE).knock())
        if self._metrics is not None:
            figures = self._fleet.figures()
            self._metrics.show(figures, overflowed=self._link.traffic.overflowed, cpu_s=self._host.cpu_s())

    def _do(self, turns: Sequence[Turn]) -> None:
        for turn in turns:
            for effect in turn.effects:
                self._send(turn.vehicle, effect)
                self._record(turn.vehicle, effect)

    def _send(self, sysid: int, effect: Effect) -> None:
        """The effects that do something."""
        voice = self._voice(sysid)
        match effect:
            case SendText():
                self._relay.say(voice.text(effect))
            case SendFloat():
                self._relay.say(voice.value(effect))
            case AskInterval(msgid, interval_us):
                self._relay.ask(voice.request(effect))
                self._record(sysid, Note(f"asked for {message_name(msgid)} at {1e6 / interval_us:.0f} Hz"))
            case Learn(profile, telemetry):
                name = self._settings.airframe or f"vehicle {sysid}"
                self._fitter.begin(FittingJob(sysid, name, profile, telemetry))
            case BaselineLearned(baseline):
                self._save(sysid, baseline)
            case EventOpened(event):
                if self._metrics is not None:
                    self._metrics.count_event(sysid, event.monitor)

    def _record(self, sysid: int, effect: Effect) -> None:
        """The effects that are worth a line, in the journal and, most of them, in the log."""
        if isinstance(effect, AskInterval | Learn | SendFloat):
            return
        if self._journal is not None:
            when = When(self._host.utc(), sysid, self._fleet.vehicles[sysid].vehicle_ns)
            self._journal.write(line(effect, when))
        words = _words(effect)
        if words:
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
            save_baseline(path, baseline)
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
            for one in self._fleet.figures()
        ]
        cpu = 100.0 * self._host.cpu_s() * NS_PER_S / max(1, round(ran_s * NS_PER_S))
        parts.append(f"{self._link.traffic.overflowed} datagrams overflowed here, {cpu:.1f} % CPU")
        return "; ".join(parts)


def _words(effect: Effect) -> str:
    match effect:
        case StateChanged(old, new, reason):
            return f"{old} -> {new}: {reason}"
        case SendText(severity, text):
            return f"{severity.name} {text!r}"
        case BaselineLearned(baseline):
            fml = ", ".join(f"{spec.axis} FML {limit.value:.3f} s" for spec, limit in baseline.latency)
            return f"baseline of {baseline.airframe.name} at {1 / baseline.link.dt_s:.1f} Hz: {fml}"
        case Note(text):
            return text
        case TextSuppressed(text, count):
            return f"held back {text!r} ({count} so far)"
        case _:
            return ""
