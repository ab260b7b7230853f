"""The parts of a baseline file: link, window, fits with their thresholds, refusals, and where all came from."""

from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    field_serializer,
    field_validator,
    model_validator,
)

from mavdiag.monitors import by_name
from mavdiag.rows.align import Grid
from mavdiag.rows.gate import GateSpec
from mavdiag.thresholds.rule import Threshold

__all__ = [
    "Grade",
    "HealthyScores",
    "LeastDamage",
    "Link",
    "MonitorEntry",
    "NotNegative",
    "Part",
    "Provenance",
    "Refusal",
    "SourceLog",
    "Window",
]

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Grade: TypeAlias = Literal["A", "B", "C", "D"]
"""What a baseline is worth, by the least damage that it notices (`mavdiag.learning.damage`)."""


class Part(BaseModel):
    """What all of them share."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Link(Part):
    """How the streams reach us.

    profile: link profile or kind of log.
    dt_s: row period [s].
    grid: how rows are placed.
    max_gap_s: longest gap that is interpolated [s].
    gate: what counts as flying.
    """

    profile: str
    dt_s: Positive
    grid: Grid
    max_gap_s: Positive
    gate: GateSpec


class Window(Part):
    """The Savitzky-Golay window, odd, and its polynomial order."""

    samples: Annotated[int, Field(ge=3)]
    order: Annotated[int, Field(ge=1)]

    @model_validator(mode="after")
    def _fits(self) -> "Window":
        if self.samples % 2 == 0 or self.samples <= self.order:
            raise ValueError("the window must be odd and longer than the polynomial order")
        return self


class HealthyScores(Part):
    """What the statistic reached on healthy flights that its fit did not see; `thresholds.heldout.Scores`, plain."""

    maxima: tuple[float, ...]
    spans_s: tuple[Positive, ...]

    @model_validator(mode="after")
    def _fits(self) -> "HealthyScores":
        if len(self.maxima) != len(self.spans_s):
            raise ValueError("maxima and spans must be equally many")
        return self


class MonitorEntry(Part):
    """A monitor's fit, of the type that its class names, and the threshold of its statistic.

    scores: what the threshold follows from; None in a baseline of an older schema, which cannot be extended.
    """

    spec: Any
    threshold: Threshold
    scores: HealthyScores | None = None

    @field_validator("spec", mode="before")
    @classmethod
    def _known(cls, value: Any) -> Any:
        if is_dataclass(value):
            return value
        if not isinstance(value, dict) or not isinstance(value.get("kind"), str):
            raise ValueError("a monitor's fit must be an object with a kind")
        return _adapter(value["kind"]).validate_python(_checked(value))

    @field_serializer("spec")
    def _plain(self, value: Any) -> Any:
        return _adapter(value.kind).dump_python(value, mode="json")


@cache
def _adapter(kind: str) -> TypeAdapter[Any]:
    return TypeAdapter(by_name(kind).spec_type)


def _checked(value: dict[str, Any]) -> dict[str, Any]:
    """A stored fit with no field that its monitor does not know. Raises ValueError."""
    known = {one.name for one in fields(by_name(value["kind"]).spec_type)}
    if unknown := sorted(set(value) - known):
        raise ValueError(f"{value['kind']} has no field {unknown[0]}")
    return value


class Refusal(Part):
    """A monitor that cannot work on this link, and why."""

    monitor: str
    reason: str


class LeastDamage(Part):
    """The least damage of one rotor that is noticed in 95 % of the time, by any monitor.

    thrust_loss: share of its thrust that rotor 1, 2, ... loses; empty if no monitor sees a trim.
    vibration_m_s2: amplitude of what shakes the airframe [m/s^2], whichever the rotor; None if none feels it.
    unbalance_g_mm: the same as an unbalance; None if mass and rotor speed are not known.
    """

    thrust_loss: tuple[NotNegative, ...] = ()
    vibration_m_s2: NotNegative | None = None
    unbalance_g_mm: NotNegative | None = None

    def __str__(self) -> str:
        """In words, for a person."""
        parts = []
        if self.thrust_loss:
            each = ", ".join(f"{100 * one:.2g} % (motor {j})" for j, one in enumerate(self.thrust_loss, 1))
            parts.append(f"a loss of thrust of {each}")
        if self.unbalance_g_mm is not None:
            parts.append(f"an unbalance of {self.unbalance_g_mm:.2g} g mm on any motor")
        elif self.vibration_m_s2 is not None:
            parts.append(f"a vibration of {self.vibration_m_s2:.2g} m/s^2 more")
        return "; ".join(parts) or "neither a loss of thrust nor an unbalance by itself: it judges by motion"


class SourceLog(Part):
    """One healthy flight that the baseline rests on.

    started_ns: wall-clock time of its beginning, unix epoch [ns]; 0 if it is not known.
    session: number of the session that it was flown in.
    propellers: number of the propeller set, 0 for the first.
    """

    name: str
    sha256: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")]
    judged_s: NotNegative
    started_ns: Annotated[int, Field(ge=0)] = 0
    session: Annotated[int, Field(ge=0)] = 0
    propellers: Annotated[int, Field(ge=0)] = 0


class Provenance(Part):
    """Where the baseline came from.

    created: ISO 8601, UTC.
    vehicle: system id, where it was learnt live; 0 where it was not.
    left_out: parts and logs that were given but not learnt, and why.
    notes: what was odd about the flights though they were learnt.
    """

    logs: Annotated[tuple[SourceLog, ...], Field(min_length=1)]
    created: str
    tool: str
    vehicle: Annotated[int, Field(ge=0, le=255)] = 0
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
