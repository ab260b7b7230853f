"""A log on the live page, as if it were flown now (edge): `mavdiag replay LOG --web` starts this module as its process.

A session judges the log on the log's own clock, as the daemon's judges a link, and what the page would have been told
is kept for every 0.2 s. That goes on as fast as it can, while the page plays, stops and jumps in what is judged.
"""

import time
from bisect import bisect_right
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from detector.config import SessionSettings, page_address
from detector.fleet import DaemonFigures, Vehicle
from detector.journal import Reporter, When
from detector.values import SessionSpec
from detector.web.access import Access
from detector.web.child import ServerProcess, read_token
from detector.web.snapshot import BACK_S, Snapshots, Track, fleet_now
from mavdiag import commandline
from mavdiag.as_json import json_line
from mavdiag.baseline import Baseline
from mavdiag.chain import suited, warm
from mavdiag.judging import playable
from mavdiag.link.profiles import PROFILES
from mavdiag.link.vehicles import Received
from mavdiag.logs import read_log
from mavdiag.rows.front import in_pieces
from mavdiag.telemetry import Instant, Log, Signal, Telemetry
from mavdiag.units import NS_PER_S

STEP_S = 0.2  # of the log between two moments that are kept: as often as a live vehicle is shown
AHEAD_S = 0.05  # of judging between two looks at the page (our choice)
LOOK_S = 0.04  # between them once all is judged, unless the page asks for something (our choice)
TOLD_S = 0.2  # how often the page is told where the replay is
FASTEST = 1000.0  # times the time of the flight
LEAST_HZ = 1.0  # a log is judged at the baseline's rate, however slow that is


@dataclass(frozen=True, slots=True)
class Moment:
    """What the page shows at a time of the log. about: None while it does not change. entries: of the journal, new.

    now: JSON without its strips, which are the items of a list, so that those of several moments can be one.
    """

    t_ns: int
    about: str | None
    fleet: str
    now: str
    strips: str
    entries: tuple[str, ...]
    level: str


def now_of(moments: Sequence[Moment]) -> str:
    """The last of some moments, with the strips of all of them."""
    strips = ", ".join(moment.strips for moment in moments if moment.strips)
    return f'{moments[-1].now[:-1]}, "strips": [{strips}]}}'


class Judged:
    """A log, as far as it is judged by now. moments: of what is judged, in order. vehicle: system id, for the page."""

    def __init__(self, log: Log, baseline: Baseline, vehicle: int) -> None:
        self.name, self.vehicle, self.moments, self.done = log.name, vehicle, list[Moment](), False
        times = log.telemetry.need(Signal.BODY_RATE).t_ns
        self.begin_ns, self.end_ns = int(np.min(times)), int(np.max(times))
        offset_ns = log.epoch_ns
        profile = replace(PROFILES["qdrone2"], name=log.profile or baseline.link.profile)
        settings = SessionSettings(negotiate=False, min_rate_hz=LEAST_HZ)
        spec = SessionSpec(profile, suited(baseline, log), settings, offset_ns)
        self._vehicle = Vehicle(vehicle, spec, Instant(self.begin_ns))
        self._steps = in_pieces(log.telemetry, max(1, round(STEP_S / baseline.link.dt_s)))
        self._snapshots, self._track, self._entries = Snapshots(), Track(), list[str]()
        self._at, self._utc = Instant(self.begin_ns), offset_ns / NS_PER_S
        self._reporter = Reporter([lambda text, _: self._entries.append(text)], lambda _: None, self._when, None)

    def _when(self, sysid: int | None) -> When:
        return When(datetime.fromtimestamp(self._at.ns / NS_PER_S + self._utc, UTC), sysid, self._at.ns)

    def go_on(self) -> None:
        """Judge the next step of the log."""
        telemetry = next(self._steps, None)
        session, self.done = self._vehicle.session, telemetry is None
        ends = [int(series.t_ns[-1]) for series in telemetry or () if len(series)]
        self._at = max(self._at, Instant(max(ends, default=0)))
        self._track.take(telemetry or Telemetry())
        effects = session.finish() if telemetry is None else session.step(Received(telemetry, alive=True), self._at)
        self._vehicle.count_alarms(effects)
        for effect in effects:
            self._reporter.record(self.vehicle, effect)
        self.moments.append(self._moment())

    def _moment(self) -> Moment:
        judge = self._vehicle.session.judge
        self._snapshots.pieces.extend(judge.pieces if judge else ())
        told, shown = self._snapshots.next(self._vehicle, self._track, self._at)
        fleet = fleet_now(DaemonFigures((self._vehicle,), ()), self._at, Instant(self.begin_ns))
        entries, self._entries = tuple(self._entries), []
        strips = json_line(shown.pop("strips"))[1:-1]
        about = None if told is None else json_line(told)
        return Moment(self._at.ns, about, json_line(fleet), json_line(shown), strips, entries, shown["level"])


class Player:
    """Where a replay is, and what the page is told of it. It begins as soon as somebody looks. at_s: of the log [s]."""

    def __init__(self, child: ServerProcess, judged: Judged, speed: float, at_s: float) -> None:
        self._child, self._judged, self.speed, self.at_s = child, judged, speed, at_s
        self._wanted: float | None = at_s  # where it jumps to as soon as that is judged
        self._shown = self._jumps = self._number = 0  # moments that were handed over; jumps; entries since the last
        self._watched, self._before, self._told = False, Instant(0), Instant(0)
        self._lines: list[str] = []

    @property
    def judged_s(self) -> float:
        """How much of the log is judged [s]."""
        moments = self._judged.moments
        return (moments[-1].t_ns - self._judged.begin_ns) / NS_PER_S if moments else 0.0

    def look(self, now: Instant) -> None:
        """Hear the page, move on, and tell the page what is due."""
        fresh, heard = self._child.look(now)
        for command, *words in (line.split() for line in heard):
            self._watched = self._watched or (command == "watch" and bool(words))
            if command == "play" and words[0] == "at":
                self._wanted = float(words[1])
            elif command == "play":
                self.speed = min(float(words[1]), FASTEST)
        if fresh and self._wanted is None:
            self._wanted = self.at_s
        if self._wanted is not None and (self._judged.done or self._wanted < self.judged_s):
            self._jump(min(self._wanted, self.judged_s))
        elif self._watched and self._wanted is None:
            self.at_s = min(self.at_s + self.speed * (now - self._before), self.judged_s)
            due = max(self._shown, self._due(self.at_s))
            for moment in self._judged.moments[self._shown : due]:
                if moment.about is not None:
                    self._lines.append(f"A {self._judged.vehicle} {moment.about}\n")
                self._lines += [f"F {moment.fleet}\n", f"N {self._judged.vehicle} {now_of([moment])}\n"]
            self._enter(self._judged.moments[self._shown : due])
            self._shown = due
        self._before = now
        if now - self._told >= TOLD_S:
            self._told = now
            self._lines.append(f"P {json_line(self._state())}\n")
        if self._lines and self._child.put("".join(self._lines).encode()):
            self._lines.clear()

    def _jump(self, to_s: float) -> None:
        self.at_s, self._wanted, self._told, self._number, self._jumps = to_s, None, Instant(0), 0, self._jumps + 1
        self._shown, recent = max(1, self._due(to_s)), self._due(to_s - BACK_S)
        past = self._judged.moments[: self._shown]
        self._lines = [f"C {self._judged.begin_ns:x}-{self._jumps}\n"]
        known = [moment.about for moment in past if moment.about is not None]
        self._lines += [f"A {self._judged.vehicle} {about}\n" for about in known[-1:]]
        self._enter(past)
        if past:
            now = now_of(past[min(recent, self._shown - 1) :])
            self._lines += [f"N {self._judged.vehicle} {now}\n", f"F {past[-1].fleet}\n"]

    def _due(self, at_s: float) -> int:
        at_ns = self._judged.begin_ns + round(at_s * NS_PER_S)
        return bisect_right(self._judged.moments, at_ns, key=lambda moment: moment.t_ns)

    def _enter(self, moments: Sequence[Moment]) -> None:
        entries = [entry for moment in moments for entry in moment.entries]
        self._lines += [f"J {number} {entry}\n" for number, entry in enumerate(entries, start=self._number + 1)]
        self._number += len(entries)

    def _state(self) -> dict[str, Any]:
        judged, spans = self._judged, list[tuple[float, str]]()
        for moment in judged.moments:
            if not spans or spans[-1][1] != moment.level:
                spans.append((round((moment.t_ns - judged.begin_ns) / NS_PER_S, 1), moment.level))
        span_s, begin_s = (judged.end_ns - judged.begin_ns) / NS_PER_S, judged.begin_ns / NS_PER_S
        told = {"log": judged.name, "at_s": self.at_s, "speed": self.speed, "wanted_s": self._wanted, "spans": spans}
        return told | {"span_s": span_s, "begin_s": begin_s, "judged_s": self.judged_s, "done": judged.done}


def serve(
    log: Path,
    baseline: Path,
    web: str,
    web_token_file: Path | None = None,
    vehicle: int | None = None,
    speed: float = 1.0,
    from_s: float = 0.0,
) -> None:
    """Play a log on the live page until a signal comes. The options are those of `mavdiag replay`."""
    token = None if web_token_file is None else read_token(web_token_file)
    place = Access(*page_address(web, web_token_file), token)
    with commandline.stop_signals() as stopped:
        known, read = Baseline.load(baseline), read_log(log, vehicle)
        playable(known, read, from_s)
        judged = Judged(read, known, read.vehicle or vehicle or 1)
        warm()
        child = ServerProcess(place, f"{judged.begin_ns:x}-0", partial(commandline.say, err=True), niceness=0)
        with closing(child):
            child.start()
            commandline.say(f"replay: {log.name} on {child.where}; Ctrl-C ends it")
            player = Player(child, judged, min(speed, FASTEST), from_s)
            while not stopped():
                began = time.monotonic()
                while not judged.done and time.monotonic() - began < AHEAD_S:
                    judged.go_on()
                player.look(Instant(time.monotonic_ns()))
                child.wait(LOOK_S if judged.done else 0.0)


if __name__ == "__main__":
    app = commandline.application("Play a log on the live page.", alone=True)
    app.command()(serve)
    commandline.run(app, "mavdiag replay")
