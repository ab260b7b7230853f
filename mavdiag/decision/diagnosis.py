"""What is held of a vehicle (the stage, the evidence, what is known of the fault), and the alarms of its monitors."""

from dataclasses import dataclass, fields
from enum import StrEnum

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
    """A rotor that was named, from 1.

    since_ns: vehicle time since when its fault was seen, as far as it is known; it may have been named later.
    end_ns: since when it is no longer seen; None while it is. A rotor that comes back before another one is named goes
        on with its span.
    """

    rotor: int
    since_ns: int
    end_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What is held of the vehicle now.

    stage, reason: where it stands, and why, as a sentence.
    since_ns: vehicle time since when; 0 before the first look.
    monitor, axis, unit, statistic, threshold: the evidence with the highest ratio at present; of a fault the latest
        that was above its threshold. None and nan without one.
    rotor, fault_type, severity, confidence, kind: as in `Event`; of the latest time that the fault was seen.
    declared_ns: vehicle time at which the fault was declared; None without one, or if it was before a restart.
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

    def __str__(self) -> str:
        """One line for a person."""
        named = f", rotor {self.rotor}" if self.rotor is not None else ""
        fault = f", {self.fault_type}" if self.fault_type is not None else ""
        stage = self.kind if self.stage is Stage.FAULT and self.kind is not None else self.stage
        return f"{stage}: {self.reason}{named}{fault}"


@dataclass(frozen=True, slots=True)
class Change:
    """One line of the decision's log: the diagnosis after it changed. Fields as in `Diagnosis`; t_ns: when."""

    t_ns: int
    stage: Stage
    reason: str
    monitor: str | None
    axis: Axis | None
    unit: str
    statistic: float
    threshold: float
    rotor: int | None
    confidence: float | None
    fault_type: str | None
    severity: int | None
    kind: FaultKind | None = None
    declared_ns: int | None = None
    seen: bool = False
    rotors: tuple[RotorSpan, ...] = ()

    @classmethod
    def of(cls, diagnosis: Diagnosis, t_ns: int) -> "Change":
        """The diagnosis as it became at that time."""
        return cls(t_ns, *(getattr(diagnosis, one.name) for one in fields(cls)[1:]))

    def __str__(self) -> str:
        """One line for a person."""
        where = "" if self.rotor is None else f", rotor {self.rotor}"
        evidence = "" if self.monitor is None else f" ({self.monitor} {self.statistic:.3g} of {self.threshold:.3g})"
        stage = self.kind if self.stage is Stage.FAULT and self.kind is not None else self.stage
        return f"{self.t_ns / NS_PER_S:.2f} s {stage}: {self.reason}{evidence}{where}"


@dataclass(frozen=True, slots=True)
class Event:
    """One alarm of one monitor. Times are of the vehicle's clock.

    monitor, axis: whose alarm it is; axis is None where it concerns the whole vehicle.
    start_ns: first value above the threshold.
    end_ns: last value above it; None while it lasts, or if the data ended first.
    statistic, level: the highest so far.
    threshold: in the statistic's unit.
    rotor: from 1; None while unknown.
    fault_type, severity: "F1" to "F3" and 1 to 3 (T Tables 3.1, 3.2); None while unknown.
    confidence: of the rotor, 0..1.
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

    def __str__(self) -> str:
        """One line for a person.

        >>> print(Event("rotor_trim", None, 19_970_000_000, None, 0.363, 0.145, 0.363, rotor=3))
        rotor_trim 0.363 > 0.145 from 19.97 s, rotor 3
        """
        axis = f" {self.axis}" if self.axis is not None else ""
        end = "" if self.end_ns is None else f" to {self.end_ns / NS_PER_S:.2f} s"
        where = "" if self.rotor is None else f", rotor {self.rotor}"
        start = f"from {self.start_ns / NS_PER_S:.2f} s"
        return f"{self.monitor}{axis} {self.statistic:.3g} > {self.threshold:.3g} {start}{end}{where}"
