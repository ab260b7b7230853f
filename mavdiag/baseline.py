"""The baseline artefact `mavdiag.baseline/7`: what a healthy airframe looks like over one link, and at what price.

It is a contract: the airframe, the link profile and rate, each monitor's fit and threshold with the flights that
support it, where the data came from, and a digest over all of it. Loading refuses what does not fit, naming the field.
"""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    PlainSerializer,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.fingerprint import Fingerprint
from mavdiag.errors import BaselineError, InputError, MavdiagError
from mavdiag.monitors import NEED_LAYOUT, by_name, monitor_of
from mavdiag.monitors.spec import NotNegative, Period, Positive
from mavdiag.printable import counted, printable
from mavdiag.rows.align import Grid
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import NATIVE_TOLERANCE, rate_tolerance
from mavdiag.rows.quality import LinkQuality
from mavdiag.storage import read_text, write_atomically
from mavdiag.tabular import Tabular
from mavdiag.telemetry import EARLIEST_NS, Signal, Three, unix_ns
from mavdiag.thresholds.envelope import Covered
from mavdiag.thresholds.rule import GUARANTEE_FLIGHTS, Threshold, ThresholdRule
from mavdiag.units import NS_PER_S

ENOUGH_SESSIONS = 5  # from here on another one teaches little of how sessions differ (our choice)
SESSION_GAP_NS = 3_600 * NS_PER_S  # flights farther apart are of two sessions (our choice)
LEAST_FLIGHTS, LEAST_S = 2, 120.0  # fewer, or so much flight in all, show too little for grade A (our choice)
RATE_TOLERANCE = NATIVE_TOLERANCE
UNREACHED = "cannot be reached"  # said of a threshold
REMEDY = "make the baseline anew with `mavdiag identify`"
Grade: TypeAlias = Literal["A", "B", "C", "D"]  # by the least damage that it notices (`mavdiag.learning.suspicions`)


class Part(BaseModel):
    """What all of them share."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

    @field_validator("*", mode="wrap")
    @classmethod
    def _by_place(cls, value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        """A value that refuses itself is refused with its place."""
        try:
            return handler(value)
        except MavdiagError as error:
            raise ValueError(str(error)) from error


class Link(Part):
    """How the streams reach us: the profile of the link or kind of log, and how rows are made of it."""

    profile: str
    dt_s: Period  # of rows
    grid: Grid
    max_gap_s: Annotated[float, Field(gt=0, le=600)]  # that is interpolated
    gate: GateSpec


class Window(Part):
    """The Savitzky-Golay window, odd, and its polynomial order."""

    samples: Annotated[int, Field(ge=3, le=1_000_001)]
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
    flights: tuple[int, ...]

    @model_validator(mode="after")
    def _fits(self) -> "HealthyScores":
        if not len(self.maxima) == len(self.spans_s) == len(self.flights):
            raise ValueError("maxima, spans and flights must be equally many")
        return self


@cache
def _adapter(kind: str) -> TypeAdapter[Any]:
    return TypeAdapter(by_name(kind).spec_type)


def _spec(value: Any) -> Any:
    if is_dataclass(value):
        return value
    if not isinstance(value, dict) or not isinstance(value.get("kind"), str):
        raise ValueError("a monitor's fit must be an object with a kind")
    return _adapter(value["kind"]).validate_python(value)


def _plain(spec: Any) -> Any:
    return _adapter(spec.kind).dump_python(spec, mode="json")


class MonitorEntry(Part):
    """A monitor's fit, of the type that its class names, the threshold of its statistic, and what it follows from."""

    spec: Annotated[Any, BeforeValidator(_spec), PlainSerializer(_plain)]
    threshold: Threshold
    scores: HealthyScores = HealthyScores(maxima=(), spans_s=(), flights=())


class Refusal(Part):
    """A monitor that cannot work on this link, and why."""

    monitor: str
    reason: str


class LeastDamage(Part):
    """The least damage of one rotor that is noticed in 95 % of the time, by any monitor."""

    thrust_loss: tuple[NotNegative, ...] = ()  # share of its thrust that rotor 1, 2, ... loses; empty if not seen
    vibration_m_s2: NotNegative | None = None  # amplitude of what shakes the airframe; None if none feels it
    unbalance_g_mm: NotNegative | None = None  # the same; None if mass and rotor speed are not known

    def __str__(self) -> str:
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
    """One healthy flight that the baseline rests on."""

    name: str
    sha256: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")]
    judged_s: NotNegative
    started_ns: Annotated[int, Field(ge=0)] = 0  # unix epoch; 0 if it is not known
    session: Annotated[int, Field(ge=0)] = 0
    propellers: Annotated[int, Field(ge=0)] = 0  # number of the set, 0 for the first
    trim: tuple[()] | Three = ()  # of the whole flight, by roll, pitch and yaw [fraction of hover]


def _dated(text: str) -> str:
    unix_ns(text)  # which refuses what is no time
    return text


class Provenance(Part):
    """Where the baseline came from."""

    logs: Annotated[tuple[SourceLog, ...], Field(min_length=1)]
    created: Annotated[str, AfterValidator(_dated)]  # ISO 8601, UTC
    tool: str
    vehicle: Annotated[int, Field(ge=0, le=255)] = 0  # system id, where it was learnt live
    left_out: tuple[str, ...] = ()  # parts and logs that were given but not learnt, and why
    notes: tuple[str, ...] = ()  # what was odd about the flights though they were learnt


class Baseline(Part, Tabular):
    """The whole artefact."""

    schema_id: Literal["mavdiag.baseline/7"] = Field(alias="schema", default="mavdiag.baseline/7")
    airframe: Airframe
    link: Link
    window: Window
    link_quality: LinkQuality = LinkQuality()  # which samples of the link are believed
    monitors: Annotated[tuple[MonitorEntry, ...], Field(min_length=1), FailFast()]
    not_judgeable: tuple[Refusal, ...]
    envelope: tuple[Covered, ...] = ()
    healthy_hours: NotNegative
    provenance: Provenance
    fingerprint: Fingerprint | None = None
    least_damage: LeastDamage | None = None
    grade: Grade | None = None
    weak: str = ""  # what its own flights say against it, such as a propeller that broke in one of them
    digest: str = ""  # over all the rest

    if not TYPE_CHECKING:  # mypy takes the arguments from the fields

        def __init__(self, **given: Any) -> None:
            """Raises BaselineError, naming the first field that does not fit."""
            try:
                super().__init__(**given)
            except ValidationError as error:
                first = error.errors(include_url=False, include_context=False, include_input=False)[0]
                where = ".".join(str(step) for step in first["loc"]) or "baseline"
                raise BaselineError(f"{where}: {first['msg'].removeprefix('Value error, ')}; {REMEDY}") from error

    @model_validator(mode="after")
    def _fits(self) -> "Baseline":
        known = self.airframe.layout
        for number, entry in enumerate(self.monitors):
            if not all(0 <= one < len(self.provenance.logs) for one in entry.scores.flights):
                raise ValueError(f"monitors.{number}.scores.flights: they are no numbers of its flights")
            layout = getattr(entry.spec, "layout", None)
            known = known or layout
            if layout not in (None, known):
                raise ValueError(f"monitors.{number}.spec.layout: it is not the airframe's")
        return self

    @property
    def propellers(self) -> int:
        """Number of the present propeller set, 0 for the first."""
        return max(one.propellers for one in self.provenance.logs)

    def same_session(self, started_ns: int) -> bool:
        """Whether a flight that began then [ns, unix epoch; 0, or a clock that was never set: no] is of a session with
        the present propellers."""
        times = [one.started_ns for one in self.provenance.logs if one.propellers == self.propellers]
        return started_ns > EARLIEST_NS and any(abs(started_ns - t_ns) <= SESSION_GAP_NS for t_ns in times)

    @property
    def supported(self) -> bool:
        """Whether so much flight taught it that grade A can be believed."""
        logs = self.provenance.logs
        return len(logs) >= LEAST_FLIGHTS and sum(one.judged_s for one in logs) >= LEAST_S

    @property
    def promised(self) -> tuple[float, float]:
        """Alarms per hour of the monitors that decide, and flights of which one is suspected by any."""
        told = [one.threshold for one in self.monitors]
        deciding = [one.threshold for one in self.monitors if monitor_of(one.spec).decides] or told
        return sum(one.budget_per_hour for one in deciding), 1.0 / sum(1.0 / one.flights_per_suspicion for one in told)

    @property
    def promises(self) -> str:
        """What its thresholds promise of healthy flights, beside what these show without any law: 1/(n + 1)."""
        shown = f"one healthy flight in {len(self.provenance.logs) + 1}"
        if all(one.threshold.rule is ThresholdRule.MAXIMUM for one in self.monitors):
            return f"fault: {shown}, by the largest healthy maximum"
        alarms, flights = self.promised
        law = f"fault: {alarms:.2g} alarms/h; suspected: one healthy flight in {flights:.3g}"
        return f"{law}; without any law its flights show {shown} above their largest"

    @property
    def layout_statement(self) -> str:
        """The rotor layout and where it is known from; or that it is unknown, what does not judge, the remedy."""
        if self.airframe.layout is not None:
            return self.airframe.layout_statement
        lost = f"{', '.join(NEED_LAYOUT)} do not judge, and no rotor is named; name it with --layout or --airframe"
        return f"{self.airframe.layout_statement}; {lost}"

    @property
    def layout_doubt(self) -> str:
        """What must be said of a rotor layout that is unknown, though a monitor wants it, or doubtful; else empty."""
        wanted = self.airframe.layout is None and any(one.monitor in NEED_LAYOUT for one in self.not_judgeable)
        return self.layout_statement if wanted or self.airframe.layout_warning else ""

    def needs(self) -> frozenset[Signal]:
        """The signals that its monitors rest on."""
        return frozenset[Signal]().union(*(monitor_of(entry.spec).signals for entry in self.monitors))

    @classmethod
    def load(cls, path: str | Path) -> "Baseline":
        """Read and validate a file. Raises BaselineError: what is wrong with it, in one line."""
        try:
            return parse(read_text(Path(path)))
        except BaselineError as error:
            raise BaselineError(f"{path}: {error}") from error
        except InputError as error:
            raise BaselineError(f"{error}; make a baseline with `mavdiag identify`") from error

    def save(self, path: str | Path) -> None:
        """Write it; the old file stays whole until the new one is. Raises UsageError if it cannot be written."""
        write_atomically(Path(path), dump(self))

    def columns(self) -> dict[str, list[Any]]:
        """Its monitors."""
        monitors = [(monitor_of(entry.spec), entry.threshold) for entry in self.monitors]
        return {
            "monitor": [f"{one.name} {one.axis or ''}".strip() for one, _ in monitors],
            "threshold": [threshold.value for _, threshold in monitors],
            "healthy mean": [threshold.mean for _, threshold in monitors],
            "suspected from": [threshold.suspected[0] * threshold.value for _, threshold in monitors],
            "unit": [one.unit for one, _ in monitors],
        }

    def __str__(self) -> str:
        frame, link = self.airframe, self.link
        lines = [
            f"airframe   {frame.name} ({frame.scope})",
            self.layout_statement,
            f"link       {link.profile}, {1 / link.dt_s:.2f} Hz, {link.grid} grid",
            f"window     {self.window.samples} samples, order {self.window.order}",
        ]
        for entry in self.monitors:
            monitor, threshold = monitor_of(entry.spec), entry.threshold
            name = monitor.name if monitor.axis is None else f"{monitor.name} {monitor.axis}"
            over = f" of |r| above {monitor.reference:.4f} rad/s" if monitor.reference else ""
            lines.append(f"{name:<15} threshold {threshold.value:.4g} {monitor.unit}{over}")
            lines.append(f"{'':<15} {threshold.statement()}")
            if blind := monitor.blindness(threshold.value):
                lines.append(f"{'':<15} {blind}")
            if threshold.session_allowance > 0:
                within = threshold.within(same_session=True)
                lines.append(f"{'':<15} {within:.4g} in a session of these flights; another may differ")
        for covered in self.envelope:
            advice = covered.advice()
            lines.append(f"{'envelope':<15} {covered}" + (f"; {advice} to widen it" if advice else ""))
        lines += [f"{one.monitor:<15} not judgeable: {one.reason}" for one in self.not_judgeable]
        lines.append(f"promises   {self.promises}")
        lines.append(f"support    {counted(len(self.provenance.logs), 'flight')}, {self.healthy_hours:.3f} h of flight")
        lines.append(f"made       {self.provenance.created} by {self.provenance.tool}")
        return "\n".join([*map(printable, lines), self.conclusion])

    @property
    def conclusion(self) -> str:
        """What was odd about its flights; then, by line, its grade, what it would notice, what would make it better."""
        lines = [f"left out   {one}" for one in self.provenance.left_out]
        lines += [f"note       {one}" for one in self.provenance.notes]
        if self.grade is not None:
            lines.append(f"grade      {self.grade}" + (f": {self.weak}" if self.weak else ""))
            lines.append(f"notices    {self.least_damage}; in 95 % of the time")
            lines.append(f"better     with {self._advice()}")
        return "\n".join(map(printable, lines or [f"promises   {self.promises}"]))

    def _advice(self) -> str:
        if self.weak:
            return "flights whose propellers are sound and whose air is calm: look at what is named above"
        names, flights, advice = {entry.spec.kind for entry in self.monitors}, len(self.provenance.logs), list[str]()
        days = ENOUGH_SESSIONS - len({one.session for one in self.provenance.logs})
        by_maximum = any(entry.threshold.rule is ThresholdRule.MAXIMUM for entry in self.monitors)
        if by_maximum and (missing := GUARANTEE_FLIGHTS - flights) > 0:
            advice.append(f"{counted(missing, 'more flight')}, for a 95/95 guarantee by the longest healthy run")
        elif not self.supported:
            advice.append(f"{LEAST_FLIGHTS} flights or more, of {LEAST_S / 60:g} min in all")
        elif days > 0:
            advice.append(f"healthy flights of {counted(days, 'more day')} (`mavdiag baseline extend`)")
        if not names & {"rotor_trim", "trim_step"}:
            advice.append("the motors' outputs, calmly flown" if names - {"fsd"} else "all monitors")
        if not names & {"unbalance", "vibration_level"}:
            advice.append("an IMU stream of 400 Hz or the VIBRATION message")
        return " and ".join(advice) or "flights of other weather and load, which widen the envelope"

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(entry.spec.kind for entry in self.monitors))
        return f"<Baseline of {self.airframe.name}: {names}>"


def sealed(baseline: Baseline) -> Baseline:
    """The same baseline with its digest filled in."""
    return baseline.model_copy(update={"digest": _digest(baseline)})


def dump(baseline: Baseline) -> str:
    """JSON text of a baseline, sealed, ending in a newline."""
    return json.dumps(sealed(baseline).model_dump(mode="json", by_alias=True), indent=1) + "\n"


def parse(text: str) -> Baseline:
    """A baseline from its JSON text. Raises BaselineError, naming the field that does not fit."""
    try:
        baseline = Baseline(**dict(json.loads(text)))
    except (TypeError, ValueError, RecursionError) as error:
        raise BaselineError(f"not a baseline: the text is no JSON object ({error}); {REMEDY}") from error
    if baseline.digest != _digest(baseline):
        raise BaselineError("digest: the file was changed after it was made; make it anew with `mavdiag identify`")
    return baseline


def without_mute(monitors: Iterable[MonitorEntry], remedy: str) -> tuple[tuple[MonitorEntry, ...], tuple[Refusal, ...]]:
    """Those whose statistic can pass its threshold, and a refusal of each other. remedy: what would help."""
    judging, refusals = list[MonitorEntry](), list[Refusal]()
    for entry in monitors:
        monitor, limit = monitor_of(entry.spec), entry.threshold.value
        if limit < monitor.reach:
            judging.append(entry)
        else:
            text = f"its threshold {limit:.3g} {monitor.unit} {UNREACHED} ({monitor.reach:.3g} at most)"
            text += f", {blind}; {remedy}" if (blind := monitor.blindness(limit)) else f"; {remedy}"
            refusals.append(Refusal(monitor=monitor.name, reason=text))
    return tuple(judging), tuple(refusals)


def check_link(baseline: Baseline, *, profile: str, dt_s: float) -> None:
    """Refuse a link that the baseline was not made for. Raises BaselineError with the differing field."""
    link = baseline.link
    if profile != link.profile:  # a log and a live link of one vehicle differ too: in filters, rates and stamps
        differ = f"the baseline is for {link.profile!r}, the data are {profile!r}"
        advice, short = "learn one from healthy flights of this kind", f"baseline for {link.profile}, not {profile}"
        raise BaselineError(f"link.profile: {differ}; {advice}", short)
    if abs(dt_s / link.dt_s - 1.0) > rate_tolerance(link.grid, link.dt_s, baseline.window.samples * link.dt_s):
        differ = f"the baseline is for {1 / link.dt_s:.1f} Hz, the data have {1 / dt_s:.1f} Hz"
        raise BaselineError(f"link.dt_s: {differ}; set that rate, or learn one from healthy flights of this kind")


def _digest(baseline: Baseline) -> str:
    content = baseline.model_dump(mode="json", by_alias=True, exclude={"digest"})
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
