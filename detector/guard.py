"""What somebody tries on a link is told, once each: a second sender in a vehicle's name or in ours, stamps that leap,
refused signatures, strangers that take up a server's connections; and a clock that is set back. No clock, no socket."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from detector.fleet import Turn
from detector.values import Effect, Note, SendText
from mavdiag.link.clock import LEAPS
from mavdiag.link.messages import Component, Severity
from mavdiag.link.sequence import PINNED_S, LinkCount, Source
from mavdiag.link.signing import Refusal, Signing
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.telemetry import Instant

AGAIN_S = 60.0  # how often refused signatures are told again while they go on (our choice)
RESTARTS = 3  # new beginnings of the running numbers in a second, and
SECONDS = 3  # seconds in a row, that two senders with one name show (our choice)
OURS = int(Component.ONBOARD_COMPUTER)
STALE_ADVICE = "stale: check both clocks; if this one was ahead before, start once with --reset-stamp"


@dataclass(slots=True)
class _Known:
    source: Source = None
    heard_ns: int = 0  # when it was heard there last
    refused: int = 0  # frames of other sources, by the last look
    moved: int = 0  # those by when it came from elsewhere: its own
    restarts: int = 0  # of its running numbers
    clashes: int = 0  # ... two frames of one number
    contrary: int = 0  # disarmed heartbeats amid armed ones
    looks: int = 0  # for how many looks these went on
    leaps: int = 0  # stamps that leapt when that was told
    told: set[str] = field(default_factory=set)

    def news(self, what: str) -> bool:
        new = what not in self.told
        self.told.add(what)
        return new


class Guard:
    """Looks at one link; call `look` once a second. signing: of the link, None without."""

    def __init__(self, link: LinkDecoder, signing: Signing | None) -> None:
        self._link, self._signing = link, signing
        self._known: dict[int, _Known] = {}
        self._counts: dict[str, tuple[int, Instant]] = {}  # what was told of a count last, and when

    def look(self, now: Instant, turned_away: int = 0) -> tuple[list[Turn], list[str]]:
        """What is new: what to tell about vehicles, and about the link. turned_away: clients of its server so far."""
        turns, texts = list[Turn](), list[str]()
        for sysid in self._link.vehicles:
            effects = tuple(self._second(sysid, self._known.setdefault(sysid, _Known())))
            turns += [Turn(sysid, effects)] if effects else []
        if self._grown("turned away", turned_away, now):
            texts.append(f"{turned_away} connections were turned away or ended: too many, idle, or nothing but garbage")
        refused = {} if self._signing is None else self._signing.refused
        if self._grown("refused", sum(refused.values()), now):
            texts.append(self.summary() + (f"; {STALE_ADVICE}" if refused.get(Refusal.STALE) else ""))
        return turns, texts

    def _grown(self, what: str, count: int, now: Instant) -> bool:
        told, at = self._counts.get(what, (0, None))
        if count <= told or (at is not None and now - at < AGAIN_S):
            return False
        self._counts[what] = (count, now)
        return True

    @property
    def refused(self) -> tuple[tuple[str, int], ...]:
        """Frames that were not heard so far, by cause."""
        link, counts = self._link, dict[str, int]()
        for sysid, stream in link.vehicles.items():
            count, own = link.count(sysid), link.count(sysid, OURS)
            counts[f"in the name of vehicle {sysid} from elsewhere"] = count.refused
            counts[f"in our own name {sysid}/{OURS}"] = own.refused if own.ours else 0
            counts[f"in the name of vehicle {sysid} with the number of another frame"] = count.clashes
            counts[f"of vehicle {sysid} whose stamps leap"] = stream.state.timeline.leaps
        signatures = {} if self._signing is None else self._signing.refused
        return (*(entry for entry in counts.items() if entry[1]), *((str(cause), n) for cause, n in signatures.items()))

    def summary(self) -> str:
        """What was refused so far, in one line; empty if nothing was."""
        parts = [f"{count} {cause}" for cause, count in self.refused]
        return f"refused: {', '.join(parts)}" if parts else ""

    def _second(self, sysid: int, known: _Known) -> Iterable[Effect]:
        count, own = self._link.count(sysid), self._link.count(sysid, OURS)
        timeline = self._link.vehicles[sysid].state.timeline
        if count.received:
            yield from self._sources(sysid, known, count)
        if own.ours and own.refused and known.news("ours"):
            yield Note(f"{_address(own.intruder)} sends as {sysid}/{OURS}, which is this detector; it is not heard")
            yield SendText(Severity.WARNING, f"PROP another sender as {sysid}/{OURS}, not heard")
        yield from self._numbers(sysid, known, count)
        if timeline.backs and known.news("clock"):
            yield Note(f"the clock of vehicle {sysid} was set back: its monitors begin anew there")
            yield SendText(Severity.WARNING, "PROP clock of the vehicle was set back")
        if timeline.leaps >= LEAPS and timeline.leaps >= 10 * known.leaps:
            known.leaps = timeline.leaps
            yield Note(f"vehicle {sysid}: stamps that leap: {known.leaps} dropped; another sender?")
            yield SendText(Severity.WARNING, f"PROP stamps leap: {known.leaps} dropped; two senders?")

    def _sources(self, sysid: int, known: _Known, count: LinkCount) -> Iterable[Effect]:
        if known.source not in (None, count.source):
            moved = f"{_address(count.source)} instead of {_address(known.source)}, which was silent for {PINNED_S:g} s"
            yield Note(f"vehicle {sysid} is heard from {moved}")
            known.moved = count.refused
        elif known.refused > known.moved and count.heard_ns > known.heard_ns and known.news("source"):
            where = _address(count.intruder)
            yield Note(f"{where} sends in the name of vehicle {sysid}, which is heard elsewhere; it is not heard")
            yield SendText(Severity.WARNING, f"PROP second source sends as vehicle {sysid}")
        known.source, known.heard_ns, known.refused = count.source, count.heard_ns, count.refused

    def _numbers(self, sysid: int, known: _Known, count: LinkCount) -> Iterable[Effect]:
        contrary = self._link.vehicles[sysid].state.contrary
        odd = count.restarts - known.restarts >= RESTARTS or count.clashes > known.clashes or contrary > known.contrary
        known.looks = known.looks + 1 if odd else 0
        known.restarts, known.clashes, known.contrary = count.restarts, count.clashes, contrary
        if known.looks >= SECONDS and known.news("sequence"):
            how = "its running numbers keep jumping back"
            if count.clashes or contrary:
                how = f"{count.clashes} times two frames of one number, {contrary} times disarmed amid armed heartbeats"
            yield Note(f"two senders seem to use the name of vehicle {sysid}: {how}")
            yield SendText(Severity.WARNING, f"PROP two senders as vehicle {sysid}?")


def _address(source: Source) -> str:
    """Who that is, for a person; a link with one other end has no addresses.

    >>> _address(("10.0.0.1", 14550, 0, 0)), _address(None)
    ('10.0.0.1:14550', 'somebody else')
    """
    return ":".join(map(str, source[:2])) if isinstance(source, tuple) else str(source or "somebody else")
