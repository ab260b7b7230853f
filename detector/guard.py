"""What somebody tries on a link is told, once each: a second sender in a vehicle's name or in ours, stamps that leap,
refused signatures, strangers that take up the connections of a server.

No clock, no socket: the link's counts and `now` in, effects out.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from detector.fleet import Turn
from detector.values import Effect, Note, SendText
from mavdiag.link.messages import Component, Severity
from mavdiag.link.ports import SocketAddress
from mavdiag.link.sequence import PINNED_S, LinkCount, Source
from mavdiag.link.signing import Refusal, Signing
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S

__all__ = ["Guard"]

AGAIN_S = 60.0  # how often refused signatures are told again while they go on (our choice)
RESTARTS = 3  # new beginnings of the running numbers in a second, and
SECONDS = 3  # seconds in a row, that two senders with one name show (our choice)
OURS = int(Component.ONBOARD_COMPUTER)
STALE_ADVICE = "stale: check both clocks; if this one was ahead before, start once with --reset-stamp"
LEAPS = 3  # stamps that leap before they are told: one is a damaged frame (our choice)


@dataclass(slots=True)
class _Known:
    """What is known of one vehicle: its source, new beginnings and clashes of its numbers, disarmed heartbeats amid
    armed ones, for how many looks they went on, how many stamps leapt when that was told, and what was told."""

    source: Source = None
    restarts: int = 0
    clashes: int = 0
    contrary: int = 0
    looks: int = 0
    leaps: int = 0
    told: set[str] = field(default_factory=set)


class Guard:
    """Looks at one link; call `look` once a second. signing: of the link, None without."""

    def __init__(self, link: LinkDecoder, signing: Signing | None) -> None:
        self._link, self._signing = link, signing
        self._known: dict[int, _Known] = {}
        self._told_at: Instant | None = None
        self._told = 0
        self._away_at: Instant | None = None
        self._turned_away = 0

    def sources(self, now: Instant, within_s: float) -> list[SocketAddress]:
        """Where the vehicles are heard from that were heard lately."""
        heard = self._link.heard_since(now.ns - round(within_s * NS_PER_S))
        return [source for source in dict.fromkeys(map(self._link.source, heard)) if isinstance(source, tuple)]

    def look(self, now: Instant, turned_away: int = 0) -> tuple[list[Turn], list[str]]:
        """What is new: what to tell about vehicles, and about the link. turned_away: clients of its server so far."""
        turns, texts = list[Turn](), list[str]()
        for sysid in self._link.vehicles:
            effects = tuple(self._second(sysid, self._known.setdefault(sysid, _Known())))
            turns += [Turn(sysid, effects)] if effects else []
        if turned_away > self._turned_away and (self._away_at is None or now - self._away_at >= AGAIN_S):
            self._turned_away, self._away_at = turned_away, now
            texts.append(f"{turned_away} connections were turned away or ended: too many, idle, or nothing but garbage")
        refused = 0 if self._signing is None else sum(self._signing.refused.values())
        if refused > self._told and (self._told_at is None or now - self._told_at >= AGAIN_S):
            stale = self._signing is not None and self._signing.refused.get(Refusal.STALE)
            self._told, self._told_at = refused, now
            texts.append(self.summary() + (f"; {STALE_ADVICE}" if stale else ""))
        return turns, texts

    @property
    def refused(self) -> tuple[tuple[str, int], ...]:
        """Frames that were not heard so far, by cause."""
        intruders = {sysid: self._link.intruder(sysid) for sysid in self._link.vehicles}
        elsewhere = [
            (f"in the name of vehicle {sysid} from elsewhere", one.frames) for sysid, one in intruders.items() if one
        ]
        ours = {sysid: self._link.impostor(sysid) for sysid in self._link.vehicles}
        elsewhere += [(f"in our own name {sysid}/{OURS}", one.frames) for sysid, one in ours.items() if one]
        counts = {sysid: self._link.count(sysid) for sysid in self._link.vehicles}
        text = "in the name of vehicle {} with the number of another frame"
        elsewhere += [(text.format(sysid), one.clashes) for sysid, one in counts.items() if one and one.clashes]
        leaps = {sysid: stream.state.timeline.leaps for sysid, stream in self._link.vehicles.items()}
        elsewhere += [(f"of vehicle {sysid} whose stamps leap", count) for sysid, count in leaps.items() if count]
        signatures = [] if self._signing is None else [(str(cause), n) for cause, n in self._signing.refused.items()]
        return (*elsewhere, *signatures)

    def summary(self) -> str:
        """What was refused so far, in one line; empty if nothing was."""
        parts = [f"{count} {cause}" for cause, count in self.refused]
        return f"refused: {', '.join(parts)}" if parts else ""

    def _second(self, sysid: int, known: _Known) -> Iterable[Effect]:
        intruder, count = self._link.intruder(sysid), self._link.count(sysid)
        source = self._link.source(sysid)
        if known.source not in (None, source):
            moved = f"{_address(source)} instead of {_address(known.source)}, which was silent for {PINNED_S:g} s"
            yield Note(f"vehicle {sysid} is heard from {moved}")
        known.source = source
        if intruder is not None and "source" not in known.told:
            known.told.add("source")
            where = _address(intruder.source)
            yield Note(f"{where} sends in the name of vehicle {sysid}, which is heard elsewhere; it is not heard")
            yield SendText(Severity.WARNING, f"PROP second source sends as vehicle {sysid}")
        impostor = self._link.impostor(sysid)
        if impostor is not None and "ours" not in known.told:
            known.told.add("ours")
            yield Note(f"{_address(impostor.source)} sends as {sysid}/{OURS}, which is this detector; it is not heard")
            yield SendText(Severity.WARNING, f"PROP another sender as {sysid}/{OURS}, not heard")
        if count is not None:
            yield from self._numbers(sysid, known, count)
        leaps = self._link.vehicles[sysid].state.timeline.leaps
        if leaps >= LEAPS and leaps >= 10 * known.leaps:
            known.leaps = leaps
            yield Note(f"vehicle {sysid}: stamps that leap: {leaps} dropped; another sender?")
            yield SendText(Severity.WARNING, f"PROP stamps leap: {leaps} dropped; two senders?")

    def _numbers(self, sysid: int, known: _Known, count: LinkCount) -> Iterable[Effect]:
        """What a vehicle's running numbers show second after second: new beginnings, or two frames of one number."""
        contrary = self._link.vehicles[sysid].state.contrary
        odd = count.restarts - known.restarts >= RESTARTS or count.clashes > known.clashes or contrary > known.contrary
        known.looks = known.looks + 1 if odd else 0
        known.restarts, known.clashes, known.contrary = count.restarts, count.clashes, contrary
        if known.looks >= SECONDS and "sequence" not in known.told:
            known.told.add("sequence")
            how = "its running numbers keep jumping back"
            if count.clashes or contrary:
                how = f"{count.clashes} times two frames of one number, {contrary} times disarmed amid armed heartbeats"
            yield Note(f"two senders seem to use the name of vehicle {sysid}: {how}")
            yield SendText(Severity.WARNING, f"PROP two senders as vehicle {sysid}?")


def _address(source: Source) -> str:
    return ":".join(map(str, source[:2])) if isinstance(source, tuple) else str(source)
