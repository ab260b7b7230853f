"""Which vehicles are judged in one look at the link, when there is more to do than a look has time for.

Judging costs some milliseconds a vehicle, however little came from it. So under load fewer vehicles are judged in each
look, and each with more data: nothing is lost, and verdicts come later. How much later is told. Each source has one
vehicle judged before any source has its second: who makes up vehicles delays those of his own source. A pure policy:
the times are given.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import zip_longest

from mavdiag.link.sequence import Source
from mavdiag.telemetry import Instant

__all__ = ["STOP_S", "Delay", "Pacing", "by_turns"]

SHARE = 0.5  # of a tick that may be used before the other vehicles wait (our choice: the machine has more to do)
MOST_S = 2.0  # one vehicle a look that has waited so long is judged all the same (our choice: what is kept is bounded)
STOP_S = 5.0  # in which what waits is judged when the daemon stops (our choice: half of what the stop may take)
LEVELS_S = (0.15, 0.3, 0.6, 1.2, 2.4)  # delays that are worth a line in the log (our choice)
QUIET_S = 10.0  # between two such lines (our choice)


@dataclass(frozen=True, slots=True)
class Pacing:
    """How long a look may take.

    budget_s: time after which no further vehicle is judged in a look; None for all vehicles in every look.
    most_s: one vehicle that has waited longer is judged although the time is used up.
    """

    budget_s: float | None = None
    most_s: float = MOST_S

    @classmethod
    def of(cls, tick_s: float) -> "Pacing":
        """For looks that come every `tick_s`."""
        return cls(SHARE * tick_s)

    def judges(self, waited_s: float, spent_s: float, first: bool) -> bool:
        """Whether a vehicle that has waited so long is judged in a look that took so long by now. first: none was yet.

        >>> pacing = Pacing.of(0.04)
        >>> pacing.judges(0.04, 0.01, False), pacing.judges(0.04, 0.03, True), pacing.judges(2.5, 0.03, True)
        (True, False, True)
        """
        return self.budget_s is None or spent_s < self.budget_s or (first and waited_s > self.most_s)


def by_turns(
    judged: Mapping[int, Instant], now: Instant, source_of: Callable[[int], Source]
) -> list[tuple[int, float]]:
    """System ids with the time since they were judged [s], in rounds: of each source the vehicle that waited longest,
    then of each source the second, and so on. The source that had no turn for the longest time is the first.

    >>> judged = {1: Instant(30), 2: Instant(10), 3: Instant(20)}
    >>> [sysid for sysid, _ in by_turns(judged, Instant(40), lambda sysid: "one" if sysid == 1 else "other")]
    [2, 1, 3]
    """
    queues: defaultdict[Source, list[int]] = defaultdict(list)
    for sysid in sorted(judged, key=lambda sysid: judged[sysid].ns):
        queues[source_of(sysid)].append(sysid)
    rounds = zip_longest(*sorted(queues.values(), key=lambda queue: judged[queue[-1]].ns))
    return [(sysid, now - judged[sysid]) for each in rounds for sysid in each if sysid is not None]


@dataclass(frozen=True, slots=True)
class Delay:
    """By how much verdicts come later than at the tick.

    longest_s: the longest that a vehicle waited lately.
    level: how many of `LEVELS_S` it passed when it was told last.
    told: when that was.
    """

    longest_s: float = 0.0
    level: int = 0
    told: Instant | None = None

    def waited(self, span_s: float) -> "Delay":
        """After a vehicle waited so long."""
        return self if span_s <= self.longest_s else Delay(span_s, self.level, self.told)

    def news(self, now: Instant) -> tuple["Delay", str]:
        """Begin a new measurement; and the line for the log, empty if there is nothing new to tell."""
        level = sum(self.longest_s > one for one in LEVELS_S)
        if level == self.level or (self.told is not None and now - self.told < QUIET_S):
            return Delay(0.0, self.level, self.told), ""
        text = f"much to do: each vehicle is judged every {self.longest_s:.2f} s, so verdicts come that much later"
        return Delay(0.0, level, now), text if level else "every vehicle is judged in every look again"
