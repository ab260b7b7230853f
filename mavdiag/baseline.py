"""The baseline artefact `mavdiag.baseline/1`: what a healthy airframe looks like over one link, and at what price.

It is a contract: whose it is, over which link profile and rate, the models with their standard errors, the margins
and thresholds with the flights that support them, where the data came from, and a digest over all of it. Loading
validates everything and refuses what does not fit, naming the field; `check_link` refuses another link. Text in, text
out: files are the business of `mavdiag.storage`.
"""

import hashlib
import json
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from mavdiag.errors import BaselineError, InputError
from mavdiag.monitors.innovation import InnovationSpec
from mavdiag.monitors.rotor_signature import RotorSignatureSpec
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.monitors.unbalance import UnbalanceSpec
from mavdiag.monitors.vibration_level import VibrationLevelSpec
from mavdiag.rows.align import Grid
from mavdiag.telemetry import Axis
from mavdiag.thresholds.rule import Threshold

__all__ = [
    "SCHEMA",
    "Airframe",
    "AxisModel",
    "Baseline",
    "GateLimits",
    "Link",
    "MonitorEntry",
    "Provenance",
    "Refusal",
    "Scope",
    "SourceLog",
    "Spec",
    "Window",
    "check_link",
    "dump",
    "parse",
    "sealed",
]

SCHEMA = "mavdiag.baseline/1"
RATE_TOLERANCE = 0.02  # of the sample time; beyond it the model's poles mean another system (our choice)

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Scope: TypeAlias = Literal["airframe", "type"]


class Airframe(_Part):
    """Whose baseline it is: one airframe, or a type from several vehicles (T 4.4.1).

    frame: rotor layout, a key of `mavdiag.airframe.layout.FRAMES`; None if it is not known.
    """

    name: Annotated[str, Field(min_length=1)]
    scope: Scope
    frame: str | None


class GateLimits(_Part):
    """What counts as flying; see `mavdiag.rows.gate`."""

    min_height_m: float | None
    min_thrust: float | None
    need_armed: bool
    trim_start_s: NotNegative
    trim_end_s: NotNegative


class Link(_Part):
    """How the streams reach us. dt_s: row period; max_gap_s: longest gap that is interpolated."""

    profile: str
    dt_s: Positive
    grid: Grid
    max_gap_s: Positive
    gate: GateLimits


class Window(_Part):
    """The Savitzky-Golay window, odd, and its polynomial order."""

    samples: Annotated[int, Field(ge=3)]
    order: Annotated[int, Field(ge=1)]

    @model_validator(mode="after")
    def _fits(self) -> "Window":
        if self.samples % 2 == 0 or self.samples <= self.order:
            raise ValueError("the window must be odd and longer than the polynomial order")
        return self


class AxisModel(_Part):
    """ARX model of one axis, A(z^-1) y = B(z^-1) u, with its figures of merit.

    a, b: coefficients from z^0 on; standard_errors: of a1..a_na, then of the nb estimated b.
    """

    axis: Axis
    order: tuple[int, int, int]
    method: Literal["ls", "sriv"]
    a: tuple[float, ...]
    b: tuple[float, ...]
    standard_errors: tuple[float, ...]
    r2t: float
    nrmse_fit: float
    mse: NotNegative
    rows: Annotated[int, Field(gt=0)]

    @model_validator(mode="after")
    def _fits(self) -> "AxisModel":
        na, nb, nk = self.order
        if len(self.a) != na + 1 or self.a[0] != 1.0 or len(self.b) != nb + nk or len(self.standard_errors) != na + nb:
            raise ValueError(f"coefficients do not fit the order {self.order}")
        return self


Spec = Annotated[
    RunLengthSpec | InnovationSpec | RotorSignatureSpec | UnbalanceSpec | VibrationLevelSpec | RotorTrimSpec,
    Field(discriminator="kind"),
]


class MonitorEntry(_Part):
    """A monitor's healthy reference and the threshold that its statistic is held against."""

    spec: Spec
    threshold: Threshold


class Refusal(_Part):
    """A monitor that cannot work on this link, and why."""

    monitor: str
    reason: str


class SourceLog(_Part):
    """One healthy flight that the baseline rests on."""

    name: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    judged_s: NotNegative


class Provenance(_Part):
    """Where the baseline came from. created: ISO 8601, UTC."""

    logs: Annotated[tuple[SourceLog, ...], Field(min_length=1)]
    created: str
    tool: str


class Baseline(_Part):
    """The whole artefact. healthy_hours: judged time of all logs."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

    schema_id: Literal["mavdiag.baseline/1"] = Field(alias="schema", default="mavdiag.baseline/1")
    airframe: Airframe
    link: Link
    window: Window
    models: Annotated[tuple[AxisModel, ...], Field(min_length=1)]
    monitors: Annotated[tuple[MonitorEntry, ...], Field(min_length=1)]
    not_judgeable: tuple[Refusal, ...]
    healthy_hours: NotNegative
    provenance: Provenance
    digest: str = ""

    @model_validator(mode="after")
    def _each_monitor_has_its_model(self) -> "Baseline":
        axes = {model.axis for model in self.models}
        for spec, _ in self.latency:
            if spec.axis not in axes:
                raise ValueError(f"monitor {spec.kind} needs a model of the {spec.axis} axis")
        return self

    @property
    def latency(self) -> tuple[tuple[RunLengthSpec, Threshold], ...]:
        """The thesis's monitors, one an axis; each threshold is the FML [s] of its axis."""
        found = ((entry.spec, entry.threshold) for entry in self.monitors)
        return tuple((spec, threshold) for spec, threshold in found if isinstance(spec, RunLengthSpec))

    def model_of(self, axis: Axis) -> AxisModel:
        """The model of an axis. Raises BaselineError if there is none."""
        for model in self.models:
            if model.axis is axis:
                return model
        raise BaselineError(f"the baseline has no model of the {axis} axis")


def sealed(baseline: Baseline) -> Baseline:
    """The same baseline with its digest filled in."""
    return baseline.model_copy(update={"digest": _digest(baseline)})


def dump(baseline: Baseline) -> str:
    """JSON text of a baseline, sealed, ending in a newline."""
    return json.dumps(sealed(baseline).model_dump(mode="json", by_alias=True), indent=1) + "\n"


def parse(text: str) -> Baseline:
    """A baseline from its JSON text. Raises BaselineError, naming the field that does not fit."""
    try:
        raw = json.loads(text)
    except ValueError as error:
        raise BaselineError(
            f"not a baseline: the text is no JSON ({error}); make one with `mavdiag identify`"
        ) from error
    found = raw.get("schema") if isinstance(raw, dict) else None
    if found != SCHEMA:
        raise BaselineError(f"schema: {found!r} instead of {SCHEMA!r}; make the baseline anew with `mavdiag identify`")
    try:
        baseline = Baseline.model_validate(raw)
    except InputError as error:  # from a specification that checks itself
        raise BaselineError(f"monitors: {error}; make the baseline anew with `mavdiag identify`") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"]) or "baseline"
        raise BaselineError(f"{where}: {first['msg']}; make the baseline anew with `mavdiag identify`") from error
    if baseline.digest != _digest(baseline):
        raise BaselineError("digest: the file was changed after it was made; make it anew with `mavdiag identify`")
    return baseline


def check_link(baseline: Baseline, *, profile: str, dt_s: float) -> None:
    """Refuse a link that the baseline was not made for. Raises BaselineError with the differing field."""
    link = baseline.link
    if profile != link.profile:
        raise BaselineError(f"link.profile: the baseline is for {link.profile!r}, the data are {profile!r}")
    if abs(dt_s / link.dt_s - 1.0) > RATE_TOLERANCE:
        raise BaselineError(f"link.dt_s: the baseline is for {1 / link.dt_s:.1f} Hz, the data have {1 / dt_s:.1f} Hz")


def _digest(baseline: Baseline) -> str:
    content: dict[str, Any] = baseline.model_dump(mode="json", by_alias=True, exclude={"digest"})
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
