"""What is kept of a sender that is not yet taken for a vehicle: its heartbeats and its latest frames."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from mavdiag.link.codec import Frame
from mavdiag.link.evidence import is_autopilot_heartbeat
from mavdiag.units import NS_PER_S

BEATS_S = (0.2, 10.0)  # how far two heartbeats are apart that show a vehicle: it sends one a second (our choice)
_KIND = slice(4, 6)  # type and autopilot in the payload of a HEARTBEAT


@dataclass(slots=True)
class Waiting:
    """A system id that has not entered.

    since_ns: since when it is watched [ns].
    frames: its autopilot's latest.
    beat: its autopilot's latest heartbeat.
    beats: how many like it came, each at its time after the one before.
    checked_ns: when its profile was looked for last [ns].
    reason: why it waits though its autopilot was received.
    """

    since_ns: int
    frames: list[Frame] = field(default_factory=list)
    beat: Frame | None = None
    beats: int = 0
    checked_ns: int | None = None
    reason: str = ""

    def note(self, frames: Iterable[Frame]) -> None:
        """Take in heartbeats."""
        least_s, most_s = BEATS_S
        for frame in filter(is_autopilot_heartbeat, frames):
            before = self.beat
            like = before is not None and frame.payload[_KIND] == before.payload[_KIND]
            span_s = 0.0 if before is None else (frame.host_ns - before.host_ns) / NS_PER_S
            if before is None or not like or span_s > most_s:
                self.beat, self.beats = frame, 1
            elif span_s >= least_s:
                self.beat, self.beats = frame, self.beats + 1
