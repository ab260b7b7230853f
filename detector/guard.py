"""What somebody tries on a link is told, once each: a second sender in a vehicle's name, refused signatures.

No clock, no socket: the link's counts and `now` in, effects out.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from detector.values import Effect, Note, SendText
from mavdiag.link.messages import Severity
from mavdiag.link.ports import SocketAddress
from mavdiag.link.sequence import Source
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.telemetry import Instant

__all__ = ["Guard"]

AGAIN_S = 60.0  # how often refused signatures are told again while they go on (our choice)
RESTARTS = 3  # new beginnings of the running numbers in a second, and
SECONDS = 3  # seconds in a row, that two senders with one name show (our choice)


@dataclass(slots=True)
class _Known:
    """What is known of one vehicle: its new beginnings, for how many looks they went on, and what was told."""

    restarts: int = 0
    looks: int = 0
    told: set[str] = field(default_factory=set)


class Guard:
    """Looks at one link; call `look` once a second. signing: of the link, None without."""

    def __init__(self, link: LinkDecoder, signing: Signing | None) -> None:
        self._link, self._signing = link, signing
        self._known: dict[int, _Known] = {}
        self._told_at: Instant | None = None
        self._told = 0

    def sources(self, now: Instant, within_s: float) -> list[SocketAddress]:
        """Where the vehicles are heard from that were heard lately."""
        found = (self._link.source(sysid, now.ns, within_s) for sysid in self._link.vehicles)
        return [source for source in dict.fromkeys(found) if isinstance(source, tuple)]

    def look(self, now: Instant) -> list[tuple[int | None, Effect]]:
        """What is new: the vehicle that it is about (None for the link) and what to tell."""
        found: list[tuple[int | None, Effect]] = []
        for sysid in self._link.vehicles:
            known = self._known.setdefault(sysid, _Known())
            found += [(sysid, effect) for effect in self._second(sysid, known)]
        refused = 0 if self._signing is None else sum(self._signing.refused.values())
        if refused > self._told and (self._told_at is None or now - self._told_at >= AGAIN_S):
            self._told, self._told_at = refused, now
            found.append((None, Note(self.summary())))
        return found

    def summary(self) -> str:
        """What was refused so far, in one line; empty if nothing was."""
        parts = []
        for sysid in self._link.vehicles:
            intruder = self._link.intruder(sysid)
            if intruder is not None:
                parts.append(f"{intruder.frames} frames in the name of vehicle {sysid} from elsewhere")
        if self._signing is not None:
            parts += [f"{count} {cause}" for cause, count in self._signing.refused.items()]
        return f"refused: {', '.join(parts)}" if parts else ""

    def _second(self, sysid: int, known: _Known) -> Iterable[Effect]:
        intruder, count = self._link.intruder(sysid), self._link.count(sysid)
        if intruder is not None and "source" not in known.told:
            known.told.add("source")
            where = _address(intruder.source)
            yield Note(f"{where} sends in the name of vehicle {sysid}, which is heard elsewhere; it is not heard")
            yield SendText(Severity.WARNING, f"PROP second source sends as vehicle {sysid}")
        if count is not None:
            known.looks = known.looks + 1 if count.restarts - known.restarts >= RESTARTS else 0
            known.restarts = count.restarts
            if known.looks >= SECONDS and "sequence" not in known.told:
                known.told.add("sequence")
                yield Note(
                    f"two senders seem to use the name of vehicle {sysid}: its running numbers keep jumping back"
                )
                yield SendText(Severity.WARNING, f"PROP two senders as vehicle {sysid}?")


def _address(source: Source) -> str:
    return ":".join(map(str, source[:2])) if isinstance(source, tuple) else str(source)
