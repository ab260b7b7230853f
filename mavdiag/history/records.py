"""What is kept of a flight, and what is told of an airframe between flights: plain values."""

from dataclasses import dataclass
from enum import StrEnum

from mavdiag.archive.figures import FlightFigures, SlotFigures
from mavdiag.judging import LogVerdict, Verdict


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """One judged flight.

    airframe: the name that the history goes by.
    log: what the log was called when it was added.
    content, started_ns, slots, rotor_trim: as in `FlightFigures`; a flight is kept once.
    added_ns: wall-clock time when it was judged [ns]; it stands for the start where that is not known.
    baseline: digest of the baseline that judged it.
    verdict, reason, judged_s: as in `LogVerdict`.
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


def record_of(
    verdict: LogVerdict, figures: FlightFigures, *, airframe: str, baseline: str, added_ns: int
) -> FlightRecord:
    """What is kept of a flight. baseline: its digest. added_ns: the present time, unix epoch [ns]."""
    return FlightRecord(
        airframe=airframe,
        log=verdict.log,
        content=figures.content,
        started_ns=figures.started_ns,
        added_ns=added_ns,
        baseline=baseline,
        verdict=verdict.verdict,
        reason=verdict.reason,
        judged_s=verdict.judged_s,
        slots=figures.slots,
        rotor_trim=figures.rotor_trim,
    )
