"""All that a page says of one flight, as a value: words, tables and pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mavdiag.airframe.airframe import Airframe
from mavdiag.baseline import Baseline
from mavdiag.judging import JudgedFlight, LogVerdict
from mavdiag.link.profiles import PROFILES
from mavdiag.look.figures import rotor_line, told_hz
from mavdiag.monitors.base import FaultKind
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.report.evidence import evidence_picture
from mavdiag.report.motion import attitude_picture, height_picture
from mavdiag.report.plane import plane_picture, severity_picture
from mavdiag.report.quality import Quality, qualities_of, quality_picture
from mavdiag.report.rates import NO_MODEL, fsd_picture, rates_picture, residual_picture
from mavdiag.report.rotors import airframe_picture, bars_picture, shift_of, trim_picture
from mavdiag.report.spectrum import RotorLine, spectrum_picture
from mavdiag.report.style import Picture
from mavdiag.report.thinned import COLUMNS
from mavdiag.report.windows import sweep_of, windows_picture
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.telemetry import Log
from mavdiag.traces import Traces, traces_of

__all__ = ["FlightReport", "Source", "flight_report", "unread_report"]

OF_LOG = ("attitude", "height", "link")  # pictures that need no judging


@dataclass(frozen=True, slots=True)
class Source:
    """Where a flight's figures come from.

    sha256: of the log; empty if it has none. profile: of its link. started_ns: unix epoch [ns]; 0 if it is not known.
    """

    sha256: str = ""
    profile: str = ""
    started_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class FlightReport:
    """One flight of a page.

    verdict: with its monitors, events and notes.
    source: where it comes from.
    link: each signal as it came.
    pictures: in the order of the page.
    """

    verdict: LogVerdict
    source: Source
    link: tuple[Quality, ...] = ()
    pictures: tuple[Picture, ...] = ()


def unread_report(verdict: LogVerdict) -> FlightReport:
    """Of a file that could not be read."""
    return FlightReport(verdict, Source())


def flight_report(
    log: Log, baseline: Baseline, judged: JudgedFlight, columns: int = COLUMNS, *, figures: bool = True
) -> FlightReport:
    """All of one flight. columns: points across a figure. figures: False for words and tables alone.

    Raises UsageError if a figure is wanted and matplotlib is not installed.
    """
    source = Source(log.sha256, log.profile, log.started_ns)
    link = qualities_of(log.telemetry)
    pictures = _pictures(log, baseline, judged, columns) if figures else ()
    return FlightReport(judged.verdict, source, link, pictures)


def _pictures(log: Log, baseline: Baseline, judged: JudgedFlight, columns: int) -> tuple[Picture, ...]:
    traces = Traces((), (), ()) if judged.chain is None else traces_of(judged.chain, judged.pieces)
    blocks = [piece.rows.block for piece in judged.pieces if len(piece.rows.block)]
    since_s, frame = _since_s(judged.verdict), baseline.airframe
    airframe, bars, trim = _of_rotors(blocks, baseline, judged.verdict, columns)
    drawn = (
        airframe,
        evidence_picture(traces.slots, columns),
        bars,
        trim,
        rates_picture(traces.rates, columns),
        residual_picture(traces.rates, columns),
        fsd_picture(traces.rates, columns),
        plane_picture(traces.rates, frame.classifier),
        severity_picture(traces.rates, traces.slots, since_s, frame.classifier),
        spectrum_picture(
            blocks, _rotor_line(log, frame, [piece.rows for piece in judged.pieces]), _corner_hz(log, frame)
        ),
        _windows(blocks, baseline),
        attitude_picture(log.telemetry, columns),
        height_picture(log.telemetry, columns),
        quality_picture(log.telemetry, columns),
    )
    return tuple(_explained(one, baseline, judged) for one in drawn)


def _explained(picture: Picture, baseline: Baseline, judged: JudgedFlight) -> Picture:
    """A picture that is not drawn with the reason that lies deepest: the flight's, the fsd monitor's, or its own."""
    if not picture.not_drawn or picture.key in OF_LOG:
        return picture
    if judged.chain is None:
        return replace(picture, not_drawn="this flight could not be judged: the verdict says why")
    if picture.not_drawn != NO_MODEL:
        return picture
    lacking = [one.reason for one in baseline.not_judgeable if one.monitor == "fsd"]
    reasons = [one.not_judged for one in judged.verdict.monitors if one.name == "fsd" and one.not_judged]
    why = next(iter((*reasons, *lacking)), "")
    return replace(picture, not_drawn=f"the fsd monitor did not judge: {why}" if why else NO_MODEL)


def _of_rotors(
    blocks: Sequence[Block], baseline: Baseline, verdict: LogVerdict, columns: int
) -> tuple[Picture, Picture, Picture]:
    """The airframe, the trim over time and by rotor."""
    layout, since_s = baseline.airframe.layout, _since_s(verdict)
    healthy = next((entry.spec for entry in baseline.monitors if isinstance(entry.spec, RotorTrimSpec)), None)
    threshold = next((one.threshold for one in verdict.monitors if one.name == "rotor_trim"), None)
    shift = None if layout is None else shift_of(blocks, layout, healthy, threshold)
    return (
        airframe_picture(layout, shift, since_s, verdict.rotor),
        bars_picture(shift, since_s),
        trim_picture(shift, columns),
    )


def _since_s(verdict: LogVerdict) -> float | None:
    """From when on a damaged propeller shows [s]; None for the whole flight: what follows a loss says nothing of it."""
    return verdict.since_s if verdict.kind in (None, FaultKind.PROPELLER) else None


def _windows(blocks: Sequence[Block], baseline: Baseline) -> Picture:
    """The sweep with the order and the method of the baseline's models."""
    window_s = baseline.window.samples * baseline.link.dt_s
    specs = [entry.spec for entry in baseline.monitors if isinstance(entry.spec, RunLengthSpec)]
    if not blocks:
        return windows_picture((), window_s)
    order = baseline.window.order
    sweeps = [sweep_of(blocks, one.axis, one.model.order, one.model.method, order) for one in specs]
    return windows_picture(sweeps, window_s)


def _rotor_line(log: Log, airframe: Airframe, rows: Sequence[Rows]) -> RotorLine | None:
    """One per revolution: as the speed controllers report it, else of the airframe's hover, else as it is heard."""
    told = told_hz(log.telemetry)
    if math.isfinite(told):
        return RotorLine(told, "the rotor speeds in the log")
    if airframe.hover_rad_s is not None:
        return RotorLine(airframe.hover_rad_s / math.tau, "the airframe's hover speed")
    heard = rotor_line(rows, _corner_hz(log, airframe), told)
    return None if heard.reason else RotorLine(heard.hz, "what is heard, the strongest line above its neighbourhood")


def _corner_hz(log: Log, airframe: Airframe) -> float | None:
    """Of the low-pass in the stream, where it is known."""
    profile = PROFILES.get(log.profile)
    return airframe.imu_corner_hz or (None if profile is None else profile.imu_corner_hz)
