"""What the live page is told, and when (edge): entries of the journal at once, figures only while somebody looks.

Nothing waits. A server that was started again, or was slow, gets all entries; figures that find no room are left out.
"""

from collections import defaultdict, deque
from collections.abc import Sequence
from itertools import islice

from detector.fleet import DaemonFigures, Fleet, Turn, Vehicle
from detector.web.board import KEPT, is_vehicle
from detector.web.child import ServerProcess
from detector.web.snapshot import BACK_S, Snapshots, Track, fleet_now, strips_of, thesis_traces
from mavdiag.as_json import json_line
from mavdiag.kernel import LOOK_NS
from mavdiag.telemetry import Instant
from mavdiag.traces import SlotTrace
from mavdiag.units import NS_PER_S

SNAPSHOT_S = 0.2  # between two snapshots of a vehicle that is looked at (our choice)
BATCH = 100  # entries that are handed over at once
BACK_MOST = 32  # vehicles whose strips are kept while nobody looks, so that they are filled at once (our choice)
BACK_PIECES = round(BACK_S * NS_PER_S / LOOK_NS)  # of each: one a look
WATCHED_MOST = 8  # vehicles that are shown at a time, so that pages cannot load the daemon (our choice)


class Feed:
    """The daemon's end. child: who serves the page. began: now. where: the page is, for a person."""

    def __init__(self, child: ServerProcess, began: Instant) -> None:
        self._child, self._began, self.where = child, began, child.where
        self._entries: deque[str] = deque(maxlen=KEPT)  # their lines; those that the server was not given yet
        self._due, self._count = self._entries.copy(), 0
        self._watched: dict[int, Snapshots] = {}
        self._back: dict[int, deque[list[SlotTrace]]] = {}  # of the vehicles at which nobody looks
        self._tracks: defaultdict[int, Track] = defaultdict(Track)
        self._shown = began
        self._acknowledged: list[int] = []

    def write(self, text: str, urgent: bool = False) -> None:
        """Take an entry of the journal."""
        self._count += 1
        for lines in (self._entries, self._due):
            lines.append(f"J {self._count} {text}\n")

    def look(self, fleet: Fleet, turns: Sequence[Turn], now: Instant) -> None:
        """After each look of the daemon."""
        fresh, lines = self._child.look(now)
        if fresh:
            self._due, self._watched = self._entries.copy(), {}
        for line in lines:
            self._heard(line)
        for turn in turns:
            sysid, session = turn.vehicle, fleet.vehicles[turn.vehicle].session
            self._tracks[sysid].take(session.came)
            pieces = () if session.judge is None else session.judge.pieces
            if sysid in self._watched:
                self._watched[sysid].pieces.extend(pieces)
            elif pieces and (sysid in self._back or len(self._back) < BACK_MOST):
                self._back.setdefault(sysid, deque(maxlen=BACK_PIECES)).extend(map(thesis_traces, pieces))
        self._give()
        if self._watched and now - self._shown >= SNAPSHOT_S:
            self._shown = now
            for sysid, snapshots in self._watched.items():
                if (vehicle := fleet.vehicles.get(sysid)) is not None:
                    self._snapshot(vehicle, snapshots, now)

    def show(self, figures: DaemonFigures, now: Instant) -> None:
        """The vehicles and links, once a second."""
        self._put("F", json_line(fleet_now(figures, now, self._began)))

    def acknowledged(self) -> list[int]:
        """The vehicles whose inspection was acknowledged on the page since the last call."""
        found, self._acknowledged = self._acknowledged, []
        return found

    def close(self) -> None:
        """Hand over what is left and end the server."""
        self._give()
        self._child.close()

    def _heard(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word == "ack" and is_vehicle(rest) and len(self._acknowledged) < WATCHED_MOST:
            self._acknowledged.append(int(rest))
        if word == "watch":
            named = [int(number) for number in rest.split() if is_vehicle(number)][:WATCHED_MOST]
            self._watched = {sysid: self._watched.get(sysid) or Snapshots() for sysid in named}

    def _put(self, head: str, content: str) -> bool:
        return self._child.put(f"{head} {content}\n".encode())

    def _give(self) -> None:
        while self._due and self._child.put("".join(islice(self._due, BATCH)).encode()):
            for _ in range(min(BATCH, len(self._due))):
                self._due.popleft()

    def _snapshot(self, vehicle: Vehicle, snapshots: Snapshots, now: Instant) -> None:
        sysid = vehicle.sysid
        told, shown = snapshots.next(vehicle, self._tracks[sysid], now)
        if told is not None and not self._put(f"A {sysid}", json_line(told)):
            snapshots.forget()  # it is told once there is room
            return
        back = (trace for traces in self._back.pop(sysid, ()) for trace in traces)
        shown["strips"] = [*strips_of(back), *shown["strips"]]
        self._put(f"N {sysid}", json_line(shown))
