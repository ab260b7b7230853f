"""What is held of a vehicle: the stage, the evidence, and what is known of the fault."""

from dataclasses import dataclass, fields
from enum import StrEnum

from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Axis
from mavdiag.units import NS_PER_S

__all__ = ["Change", "Diagnosis", "Stage"]


class Stage(StrEnum):
    """Where the vehicle stands."""

    NOT_JUDGED = "not judged"
    QUIET = "quiet"
    SUSPECTED = "suspected"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What is held of the vehicle now.

    stage, reason: where it stands, and why, as a sentence.
    since_ns: vehicle time since when; 0 before the first look.
    monitor, axis, unit, statistic, threshold: the evidence with the highest ratio at present; None and nan without one.
    rotor, fault_type, severity, confidence, kind: as in `Event`.
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

    def __str__(self) -> str:
        """One line for a person."""
        named = f", rotor {self.rotor}" if self.rotor is not None else ""
        fault = f", {self.fault_type}" if self.fault_type is not None else ""
        stage = self.stage if self.kind is None else self.kind
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

    @classmethod
    def of(cls, diagnosis: Diagnosis, t_ns: int) -> "Change":
        """The diagnosis as it became at that time."""
        names = [one.name for one in fields(cls)[1:]]
        return cls(t_ns, *(getattr(diagnosis, name) for name in names))

    def __str__(self) -> str:
        """One line for a person."""
        where = "" if self.rotor is None else f", rotor {self.rotor}"
        evidence = "" if self.monitor is None else f" ({self.monitor} {self.statistic:.3g} of {self.threshold:.3g})"
        stage = self.stage if self.kind is None else self.kind
        return f"{self.t_ns / NS_PER_S:.2f} s {stage}: {self.reason}{evidence}{where}"
