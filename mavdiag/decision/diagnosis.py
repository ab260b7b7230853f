"""What is held of a vehicle (the stage, the evidence, what is known of the fault), and the alarms of its monitors."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from itertools import pairwise

from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Axis
from mavdiag.units import NS_PER_S


class Stage(StrEnum):
    """Where the vehicle stands."""

    NOT_JUDGED = "not judged"
    QUIET = "quiet"
    SUSPECTED = "suspected"
    FAULT = "fault"  # declared: it lasts until the flight ends
    INSPECT = "inspect"  # it was declared in a flight that has ended; it lasts until somebody acknowledges it


@dataclass(frozen=True, slots=True)
class RotorSpan:
    """A rotor that was named, from 1; since when its fault was seen, and no longer is (None while it is) [ns].

    A rotor that comes back before another one is named goes on with its span.
    """

    rotor: int
    since_ns: int
    end_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What is held of the vehicle now.

    stage, reason, since_ns: where it stands, why, as a sentence, and since when; 0 before the first look.
    monitor, axis, unit, statistic, threshold: the evidence with the highest ratio at present; of a fault the latest
        that was above its threshold. None and nan without one.
    rotor, fault_type, severity, confidence, kind: as in `Event`; of the latest time that the fault was seen.
    declared_ns: when the fault was declared; None without one, or if it was before a restart.
    seen: the monitors that declared it are above or near their thresholds, or cannot say.
    rotors: every rotor that was named, in order of naming.
    """

    stage: Stage = Stage.NOT_JUDGED
    reason: str = "nothing judged yet"
    since_ns: int = 0
    monitor: str | None = None
    axis: Axis | None = None
    unit: str = ""
    statistic: float = float("nan")
    threshold: float = float("nan")
    rotor: int | None = None
    confidence: float | None = None
    fault_type: str | None = None
    severity: int | None = None
    kind: FaultKind | None = None
    declared_ns: int | None = None
    seen: bool = False
    rotors: tuple[RotorSpan, ...] = ()

    @property
    def title(self) -> str:
        """The stage, of a fault its kind."""
        return self.kind if self.stage is Stage.FAULT and self.kind is not None else self.stage

    def __str__(self) -> str:
        named = f", rotor {self.rotor}" if self.rotor is not None else ""
        named += f", {self.fault_type}" if self.fault_type is not None else ""
        if self.stage not in (Stage.FAULT, Stage.SUSPECTED) or self.monitor is None:
            return f"{self.title}: {self.reason}{named}"
        figures = f"{self.statistic:.3g} of {self.threshold:.3g} {self.unit}".rstrip()
        return f"{self.title}: {self.reason}{named} ({self.monitor} {figures})"


@dataclass(frozen=True, slots=True)
class Change(Diagnosis):
    """One line of the decision's log: the diagnosis as it became at `t_ns`."""

    t_ns: int = 0

    @classmethod
    def of(cls, diagnosis: Diagnosis, t_ns: int) -> "Change":
        """The diagnosis as it became at that time."""
        return cls(**{one.name: getattr(diagnosis, one.name) for one in fields(Diagnosis)}, t_ns=t_ns)

    def __str__(self) -> str:
        return f"{self.t_ns / NS_PER_S:.2f} s {Diagnosis.__str__(self)}"


def above(value: float, threshold: float) -> str:
    """A value and the threshold that it is above, in as many digits as tell them apart."""
    places = 3
    while places < 9 and f"{value:.{places}g}" == f"{threshold:.{places}g}" != "0":
        places += 1
    return f"{value:.{places}g} > {threshold:.{places}g}"


def graded(changes: Sequence[Change]) -> Change | None:
    """The change that named the type of a fault last; None if that was withdrawn while the same fault was seen."""
    found = None
    for before, change in pairwise(changes):
        if change.fault_type is not None or (before.fault_type is not None and before.seen):
            found = change
    return None if found is None or found.fault_type is None else found


@dataclass(frozen=True, slots=True)
class Event:
    """One alarm of one monitor. Times are of the vehicle's clock.

    axis: None where it concerns the whole vehicle.
    start_ns, end_ns: first and last value above the threshold; no end while it lasts, or if the data ended first.
    statistic, level: the highest so far, in the unit of the threshold and of the monitor's level.
    rotor, confidence: from 1, and 0..1; None while unknown.
    fault_type, severity: "F1" to "F3" and 1 to 3 (T Tables 3.1, 3.2); None while unknown.
    kind: of the fault that the alarm belongs to, None while it belongs to none.
    """

    monitor: str
    axis: Axis | None
    start_ns: int
    end_ns: int | None
    statistic: float
    threshold: float
    level: float
    rotor: int | None = None
    fault_type: str | None = None
    severity: int | None = None
    confidence: float | None = None
    kind: FaultKind | None = None

    @property
    def t_s(self) -> float:
        """`start_ns` in seconds."""
        return self.start_ns / NS_PER_S

    @property
    def end_s(self) -> float | None:
        """`end_ns` in seconds."""
        return None if self.end_ns is None else self.end_ns / NS_PER_S

    def __str__(self) -> str:
        axis = f" {self.axis}" if self.axis is not None else ""
        end = "" if self.end_s is None else f" to {self.end_s:.2f} s"
        where = "" if self.rotor is None else f", rotor {self.rotor}"
        return f"{self.monitor}{axis} {above(self.statistic, self.threshold)} from {self.t_s:.2f} s{end}{where}"
