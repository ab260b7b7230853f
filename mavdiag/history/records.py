"""What is kept of a flight, and what is told of an airframe between flights: plain values."""

from dataclasses import dataclass
from enum import StrEnum

from mavdiag.judging import Verdict
from mavdiag.telemetry import Axis

__all__ = ["FlightRecord", "Mark", "MarkKind", "SlotFigures"]


@dataclass(frozen=True, slots=True)
class SlotFigures:
    """One monitor on one axis over a flight.

    monitor, axis: whose figures they are; axis is None where the monitor is about the whole vehicle.
    unit: of statistic and threshold.
    threshold: that the flight was judged by.
    median, peak: of the statistic where it is valid; None if it never was. The peak of `fsd` is the longest run [s].
    judged_s: time that it judged [s].
    """

    monitor: str
    axis: Axis | None
    unit: str
    threshold: float
    median: float | None
    peak: float | None
    judged_s: float


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """One judged flight.

    airframe: the name that the history goes by.
    log: what the log was called when it was added.
    content: hash of what was judged; a flight is kept once.
    started_ns: wall-clock time of its first record, unix epoch [ns]; 0 if the log does not say.
    added_ns: wall-clock time when it was judged [ns]; it stands for the start where that is not known.
    baseline: digest of the baseline that judged it.
    verdict, reason, judged_s: as in `LogVerdict`.
    slots: the monitors' figures.
    rotor_trim: by how much each rotor's command rose against the baseline, median over the flight [fraction of hover];
        empty where the trim was not judged.
    """

    airframe: str
    log: str
    content: str
    started_ns: int
    added_ns: int
    baseline: str
    verdict: Verdict
    reason: str
    judged_s: float
    slots: tuple[SlotFigures, ...] = ()
    rotor_trim: tuple[float, ...] = ()

    @property
    def t_ns(self) -> int:
        """When it is taken to have been flown, unix epoch [ns]."""
        return self.started_ns or self.added_ns


class MarkKind(StrEnum):
    """What was done to an airframe between flights. No trend goes on over it."""

    NEW_PROPELLERS = "new propellers"
    REPAIR = "repair"


@dataclass(frozen=True, slots=True)
class Mark:
    """A maintenance mark. t_ns: when it was done, unix epoch [ns]. note: what else there is to say."""

    airframe: str
    t_ns: int
    kind: MarkKind
    note: str = ""
