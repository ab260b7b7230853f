"""What a log or a link shows without a judgement: signals, clock, units, rotors, flight, what each monitor lacks."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import moving_outputs
from mavdiag.airframe.fingerprint import joined
from mavdiag.airframe.parameters import layout_from_parameters
from mavdiag.airframe.trim import SIGNALS
from mavdiag.baseline import Baseline, check_link
from mavdiag.errors import BaselineError, InputError
from mavdiag.learning.flights import LearntFlight, airborne, front_for
from mavdiag.learning.rotors import of_log_kind, with_rotors
from mavdiag.learning.teaching import upsets
from mavdiag.link.codec import message_name
from mavdiag.link.profiles import PROFILES, scale_doubt
from mavdiag.link.scale import CONTRARY, AxisCheck, gravity_of, gyro_checks
from mavdiag.link.sequence import LinkCount
from mavdiag.link.wants import LABELS, log_remedy, messages_of, remedy
from mavdiag.look import figures
from mavdiag.monitors import MONITORS, monitor_of
from mavdiag.monitors.base import Monitor
from mavdiag.rows.grid import distinct, mean_step, steps_of
from mavdiag.telemetry import FloatArray, IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_MS, NS_PER_S

USUAL = 3.0  # steps above this multiple of the median are gaps, and no jitter (our choice)
GAP_S = 0.035  # of the gyro: a longer one is not interpolated (METHOD section 4)
RIGHT = "right"  # what is said of a scale by which gravity is 1 g
WINDOW_S = 0.1  # of the rate filters, as `mavdiag identify` has it by default
LATE_SHARE = 95.0  # percentile of the transport delay that is called its spread
DRIFT_S = 10  # within fewer seconds the drift of a clock is lost in the transport (our choice)
LEAST_CLOCK = 20  # samples that a clock is seen by (our choice)


@dataclass(frozen=True, slots=True)
class Summary:
    """One signal as it arrives; rate, jitter and longest gap are None with fewer than two times."""

    signal: str
    unit: str
    samples: int
    rate_hz: float | None  # mean but for pauses
    jitter_ms: float | None  # standard deviation of the steps that are no gaps
    longest_gap_s: float | None
    gaps: int  # steps of three usual ones or more
    missing: float  # share of the samples that the usual step would have brought, 0..1
    repeated: int  # samples with the time of another one
    lowest: tuple[float | None, ...]  # of each column; None where it holds no number
    highest: tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class Clock:
    """The vehicle's clock beside the receiver's."""

    behind_s: float  # receiver's time less the vehicle's, at the fastest transport
    drift_ppm: float | None  # by how much that grows
    spread_ms: float  # how much later than the fastest a sample may come (95 %)
    signals_ms: Mapping[str, float]  # by how much later than the gyro each comes, at the fastest


@dataclass(frozen=True, slots=True)
class Units:
    """What the vehicle feels by the accelerometer's scale, in one phrase too; the gyro beside the attitude's slope."""

    gravity_g: float | None
    gravity: str
    gyro: tuple[AxisCheck, ...]


@dataclass(frozen=True, slots=True)
class MonitorState:
    """One monitor, by its names in a baseline and in a text; what it lacks and what gives it."""

    monitor: str
    label: str
    works: bool
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MessageRate:
    """A message of a link, and how often it came."""

    id: int
    name: str
    rate_hz: float


@dataclass(frozen=True, slots=True)
class Inspection:
    """All that is told of a log or a link; its fields are those of the JSON."""

    log: str
    source: str
    profile: str
    span_s: float
    flight_s: float  # valid time in flight
    no_flight: str  # why there is none
    upset: str  # when and how it fell or tumbled
    notes: tuple[str, ...]
    signals: tuple[Summary, ...]
    gyro_gaps: int  # of more than 35 ms
    lost_s: float  # in them
    messages: tuple[MessageRate, ...]
    link: Mapping[str, int] | None  # frames received, lost, reordered and duplicated
    asked: tuple[str, ...]  # what the autopilot answered to our requests, one sentence each
    clock: Clock | None  # None where nothing came with a time of arrival of its own
    units: Units
    rotors: str
    loads: tuple[figures.OutputLoad, ...]
    trim: Mapping[str, float] | None
    vibration: figures.Vibration | None
    line: figures.RotorLine | None
    baseline: str
    monitors: tuple[MonitorState, ...]

    @property
    def gyro(self) -> Summary | None:
        """The gyro as it arrives."""
        return next((signal for signal in self.signals if signal.signal == Signal.BODY_RATE), None)


def inspection_of(
    log: Log,
    told: Airframe,
    source: str = "",
    baseline: Baseline | None = None,
    count: LinkCount | None = None,
    rates_hz: Mapping[int, float] | None = None,
    asked: tuple[str, ...] = (),
) -> Inspection:
    """Look at a log, or at what came of a link. told: what is known of its vehicle. baseline: its monitors are told."""
    airframe, learnt, no_flight = rotors_of(log, told)
    signals = summaries(log.telemetry)
    flight, layout = [] if learnt is None else joined(learnt.rows), airframe.layout
    motors = moving_outputs(flight) if layout is None else range(layout.rotors)
    profile, gaps = PROFILES.get(log.profile), _gyro_gaps(log.telemetry)
    corner_hz = airframe.imu_corner_hz if profile is None else profile.corner_hz(log.parameters)
    counted = ("received", "lost", "reordered", "duplicated")
    times = [series.t_ns for series in log.telemetry.series if len(series)]
    return Inspection(
        log=log.name,
        source=source or log.name,
        profile=log.profile,
        span_s=float(np.ptp(np.concatenate(times))) / NS_PER_S if times else 0.0,
        flight_s=sum(float(np.count_nonzero(block.valid)) * block.dt_s for block in flight),
        no_flight=no_flight,
        upset="" if learnt is None else "; ".join(finding.text for finding in upsets([learnt])),
        notes=log.notes,
        signals=signals,
        gyro_gaps=len(gaps),
        lost_s=float(gaps.sum()),
        messages=tuple(MessageRate(m, message_name(m), hz) for m, hz in sorted((rates_hz or {}).items())),
        link=None if count is None else {name: getattr(count, name) for name in counted},
        asked=asked,
        clock=clock_of(log.telemetry) if profile is not None else None,
        units=units_of(log),
        rotors=airframe.layout_statement,
        loads=figures.output_loads(flight, motors),
        trim=None if layout is None else figures.trim(flight, layout),
        vibration=figures.vibration(flight),
        line=figures.rotor_line(flight, corner_hz, figures.told_hz(log.telemetry), log.batches) if flight else None,
        baseline="" if baseline is None else baseline_statement(baseline, log, signals),
        monitors=monitor_states(log, signals, airframe, baseline),
    )


def summaries(telemetry: Telemetry) -> tuple[Summary, ...]:
    """Figures of all signals that have samples, but of the flight mode, which is no measurement."""
    return tuple(summary(series) for series in telemetry if len(series) and series.signal is not Signal.MODE)


def summary(series: Series) -> Summary:
    """Figures of one signal, which has samples."""
    t_ns = distinct(series.t_ns)
    steps = steps_of(t_ns)
    rate = jitter = longest = None
    gaps, missing = 0, 0.0
    if len(steps):
        usual = float(np.median(steps))
        rate, longest = NS_PER_S / mean_step(steps), float(steps.max()) / NS_PER_S
        jitter = float(steps[steps < USUAL * usual].std()) / NS_PER_MS
        gaps = int(np.count_nonzero(steps >= USUAL * usual))
        missing = max(0.0, 1.0 - len(t_ns) / (float(t_ns[-1] - t_ns[0]) / usual + 1.0))
    known = [column[np.isfinite(column)] for column in series.values.T]
    lowest, highest = (tuple(float(of(column)) if len(column) else None for column in known) for of in (np.min, np.max))
    timing = (rate, jitter, longest, gaps, missing, len(series) - len(t_ns))
    return Summary(series.signal, series.unit, len(series), *timing, lowest, highest)


def clock_of(telemetry: Telemetry) -> Clock | None:
    """The clock by the gyro's samples; None where none came with a time of arrival of its own."""
    gyro = telemetry.get(Signal.BODY_RATE)
    if gyro is None or len(gyro) < LEAST_CLOCK or np.array_equal(gyro.t_ns, gyro.host_ns):
        return None
    behind = (gyro.host_ns - gyro.t_ns) / NS_PER_S
    seconds, order, starts = _by_second(gyro.t_ns)
    least = np.minimum.reduceat(behind[order], starts)
    known = len(least) >= DRIFT_S
    slope, start = np.polyfit(seconds, least, 1) if known else (0.0, float(least.min()))
    late = behind - (start + slope * ((gyro.t_ns - gyro.t_ns[0]) // NS_PER_S))
    others = (series for series in telemetry.series if len(series) >= LEAST_CLOCK and series is not gyro)
    return Clock(
        float(behind.min()),
        1e6 * float(slope) if known else None,
        1e3 * float(np.percentile(late - late.min(), LATE_SHARE)),
        {one.signal.value: float((one.host_ns - one.t_ns).min() / NS_PER_MS - 1e3 * behind.min()) for one in others},
    )


def units_of(log: Log) -> Units:
    """Gravity is 1 g, at rest and in the mean of a flight; the gyro is the slope of the attitude."""
    get = log.telemetry.get
    force, gyro, attitude = get(Signal.SPECIFIC_FORCE), get(Signal.BODY_RATE), get(Signal.ATTITUDE)
    checks = () if gyro is None or attitude is None else gyro_checks(gyro, attitude)
    if force is None or not len(force) or not np.isfinite(force.values).all():
        return Units(None, "no accelerometer along three axes", checks)
    _, order, starts = _by_second(force.t_ns)
    felt_g = float(np.median([gravity_of(part) for part in np.split(force.values[order], starts[1:])]))
    if 1.0 / CONTRARY < felt_g < CONTRARY:
        return Units(felt_g, RIGHT, checks)
    named = scale_doubt(PROFILES[log.profile], felt_g) if log.profile in PROFILES else ""
    remedy_of = f"; try {named.partition(': ')[2]}" if ": " in named else ""
    return Units(felt_g, f"wrong scale, or never at rest{remedy_of}", checks)


def rotors_of(log: Log, told: Airframe) -> tuple[Airframe, LearntFlight | None, str]:
    """The airframe with its rotors as `learn` finds them, the flight by rotor, and why there is none."""
    told = of_log_kind(told, log.profile)
    try:
        airframe, flights = with_rotors(told, [airborne(front_for([log], WINDOW_S, told.gate), log)])
        return airframe, flights[0], ""
    except InputError as error:
        said, why = layout_from_parameters(log.parameters, log.mav_type), str(error).removeprefix(f"{log.name}: ")
        basis = said.reason or why if told.layout is None else told.layout_basis or "told"
        return replace(told, layout=told.layout or said.layout, layout_basis=basis), None, why


def monitor_states(
    log: Log, found: Iterable[Summary], airframe: Airframe, baseline: Baseline | None = None
) -> tuple[MonitorState, ...]:
    """Each monitor of the registry, or of a baseline: whether it can work, else what is missing."""
    rates = {one.signal: one.rate_hz or 0.0 for one in found if any(v is not None for v in one.highest)}
    rows: dict[str, tuple[type[Monitor[Any]], frozenset[Signal]]] = {m.name: (m, m.needs) for m in MONITORS}
    if baseline is not None:
        fits = (monitor_of(entry.spec) for entry in baseline.monitors)
        rows = {monitor.name: (type(monitor), monitor.signals) for monitor in fits}
    states = []
    for kind, needs in rows.values():
        missing = (*_signals(log, _choice(needs, rates), rates), *_stream(log, kind, rates, airframe))
        if kind.needs_layout and airframe.layout is None and baseline is None:
            missing += ("rotor layout: give --layout, or let the vehicle tell FRAME_CLASS and FRAME_TYPE or CA_ROTORn",)
        states.append(MonitorState(kind.name, kind.label, not missing, missing))
    refused = () if baseline is None else baseline.not_judgeable
    refusals = {refusal.monitor: refusal.reason for refusal in refused if refusal.monitor not in rows}
    return (*states, *(MonitorState(name, name, works=False, missing=(why,)) for name, why in refusals.items()))


def baseline_statement(baseline: Baseline, log: Log, found: Sequence[Summary]) -> str:
    """Whether the baseline is of this link, and if not, which field differs."""
    rate_hz = next((one.rate_hz for one in found if one.signal == Signal.BODY_RATE), None)
    try:
        check_link(baseline, profile=log.profile, dt_s=1.0 / rate_hz if rate_hz else baseline.link.dt_s)
    except BaselineError as error:
        return str(error)
    return "of this link" if rate_hz else "of this profile; no gyro came to compare the rate"


def _by_second(t_ns: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """The seconds since the first sample that have any, the samples' order by second, and where each begins in it."""
    second = (t_ns - t_ns[0]) // NS_PER_S
    order = np.argsort(second, kind="stable")
    seconds, starts = np.unique(second[order], return_index=True)
    return seconds, order, starts


def _gyro_gaps(telemetry: Telemetry) -> FloatArray:
    gyro = telemetry.get(Signal.BODY_RATE)
    if gyro is None or len(gyro) < 2:
        return np.empty(0)
    steps = steps_of(gyro.t_ns) / NS_PER_S
    return steps[steps > max(GAP_S, 1.5 * float(np.median(steps)))] if len(steps) else steps


def _choice(needs: frozenset[Signal], rates: Mapping[str, float]) -> frozenset[Signal]:
    """What a monitor needs; of the sources of a trim the one that comes, else the outputs."""
    sources = tuple(SIGNALS.values())
    if not all(source <= needs for source in sources):
        return needs
    rest = needs - frozenset[Signal]().union(*sources)
    return rest | next((source for source in sources if all(rates.get(signal) for signal in source)), sources[0])


def _signals(log: Log, needs: Iterable[Signal], rates: Mapping[str, float]) -> tuple[str, ...]:
    profile = PROFILES.get(log.profile)
    missing: dict[str, str] = {}
    for signal in sorted(signal for signal in needs if not rates.get(signal)):
        name = LABELS.get(signal, signal.replace("_", " "))
        message = None if profile is None else messages_of(profile).get(signal)
        if profile is None:
            gives = log_remedy(log.profile, signal)
            end = f": set {gives}" if gives else " in the log"
        elif message is None:
            end = f" to judge on a link of the profile {profile.name}"
        else:
            gives, label, name = remedy(profile.autopilot, message), name, message_name(message)
            end = f": {gives}" if gives else f" ({label})"
        missing[name] = f"no {name}{end}"
    return tuple(missing.values())


def _stream(log: Log, kind: type[Monitor[Any]], rates: Mapping[str, float], airframe: Airframe) -> tuple[str, ...]:
    rate_hz, profile = rates.get(Signal.BODY_RATE, 0.0), PROFILES.get(log.profile)
    if not rate_hz or Signal.BODY_RATE not in kind.needs:
        return ()
    try:
        kind.need_stream(rate_hz, None if profile is None else profile.corner_hz(log.parameters), airframe.hover_rad_s)
    except InputError as error:
        return (str(error),)
    return ()
