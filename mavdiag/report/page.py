"""Pages by Jinja2 templates: values in, HTML out. Every text is escaped, for names and notes of logs are not ours.

What a page says of a verdict is in `decision.words`, what it says of a figure in captions.toml, the rest in templates.
"""

import datetime
import itertools
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mavdiag import __version__
from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.fingerprint import joined
from mavdiag.baseline import Baseline
from mavdiag.decision import words
from mavdiag.judging import JudgedFlight, LogVerdict
from mavdiag.link.profiles import PROFILES
from mavdiag.link.wants import LABELS
from mavdiag.look.figures import rotor_line, spectrum_of, told_hz
from mavdiag.look.inspection import Summary, summary
from mavdiag.monitors.base import FaultKind
from mavdiag.monitors.rotor_trim import RotorTrimSpec
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.printable import printable
from mavdiag.report import pictures
from mavdiag.report.campaign import HEALTHY, Campaign, campaign_pictures
from mavdiag.report.style import COLUMNS, Picture, embedded
from mavdiag.rows.block import Block
from mavdiag.telemetry import Log
from mavdiag.traces import rate_traces, slot_traces
from mavdiag.units import NS_PER_S, S_PER_H

EVENTS = 20  # alarms that a page lists of one flight; the rest is counted (our choice)
SHORT = 60  # characters of a path that a heading shows
ORDER = tuple(words.VERDICTS)
OF_LOG = ("attitude", "height")  # pictures that need no judging


@dataclass(frozen=True, slots=True, eq=False)
class FlightReport:
    """What a page says of a flight; its pictures in the order of the page."""

    verdict: LogVerdict
    sha256: str = ""
    profile: str = ""
    started_ns: int = 0  # unix epoch; 0 if it is not known
    link: tuple[Summary, ...] = ()
    pictures: tuple[Picture, ...] = ()


def flight_report(
    log: Log, baseline: Baseline, judged: JudgedFlight, columns: int = COLUMNS, *, figures: bool = True
) -> FlightReport:
    """All of one flight. columns: points across a figure. figures: False for words and tables alone."""
    link = tuple(summary(series) for series in log.telemetry.series if len(series))
    pictures = _pictures(log, baseline, judged, columns) if figures else ()
    return FlightReport(judged.verdict, log.sha256, log.profile, log.started_ns, link, pictures)


def _pictures(log: Log, baseline: Baseline, judged: JudgedFlight, columns: int) -> tuple[Picture, ...]:
    rates = () if judged.chain is None else rate_traces(judged.chain, judged.pieces)
    slots = () if judged.chain is None else slot_traces(judged.chain, judged.pieces)
    blocks = joined([piece.rows for piece in judged.pieces if len(piece.rows.block)])
    frame, verdict, telemetry = baseline.airframe, judged.verdict, log.telemetry
    # From when on a damaged propeller shows; None for the whole flight: what follows a loss says nothing of it.
    since_s = verdict.since_s if verdict.kind in (None, FaultKind.PROPELLER) else None
    specs = [entry.spec for entry in baseline.monitors]
    healthy = next((spec for spec in specs if isinstance(spec, RotorTrimSpec)), None)
    threshold = next((one.threshold for one in verdict.monitors if one.name == "rotor_trim"), None)
    shift = None if frame.layout is None else pictures.shift_of(blocks, frame.layout, healthy, threshold)
    sweeps = {
        spec.axis: pictures.sweep_of(blocks, spec.axis, spec.model.order, spec.model.method, baseline.window.order)
        for spec in specs
        if isinstance(spec, RunLengthSpec) and blocks
    }
    dt_s = blocks[0].dt_s if blocks else math.nan
    profile = PROFILES.get(log.profile)
    corner_hz = frame.imu_corner_hz or (None if profile is None else profile.imu_corner_hz)
    line = _rotor_line(log, frame, blocks, corner_hz)
    drawn = (
        pictures.airframe_picture(frame.layout, shift, since_s, verdict.rotor),
        pictures.evidence_picture(slots, columns),
        pictures.trim_picture(shift, columns),
        pictures.rates_picture(rates, columns),
        pictures.residual_picture(rates, columns),
        pictures.fsd_picture(rates, columns),
        pictures.plane_picture(rates, frame.classifier),
        pictures.severity_picture(rates, slots, since_s, frame.classifier),
        pictures.spectrum_picture(spectrum_of(blocks), line, corner_hz, 1 / dt_s),
        pictures.windows_picture(sweeps, dt_s, baseline.window.samples * baseline.link.dt_s),
        pictures.attitude_picture(telemetry, columns),
        pictures.height_picture(telemetry, columns),
    )
    return tuple(_explained(picture, baseline, judged) for picture in drawn)


def _explained(picture: Picture, baseline: Baseline, judged: JudgedFlight) -> Picture:
    """A picture that is not drawn with the reason that lies deepest: the flight's, the fsd monitor's, or its own."""
    if not picture.not_drawn or picture.key in OF_LOG:
        return picture
    if judged.chain is None:
        return replace(picture, not_drawn="this flight could not be judged: the verdict says why")
    reasons = [one.not_judged for one in judged.verdict.monitors if one.name == "fsd" and one.not_judged]
    reasons += [one.reason for one in baseline.not_judgeable if one.monitor == "fsd"]
    if picture.not_drawn != pictures.NO_MODEL or not reasons:
        return picture
    return replace(picture, not_drawn=f"the fsd monitor did not judge: {reasons[0]}")


def _rotor_line(
    log: Log, airframe: Airframe, blocks: Sequence[Block], corner_hz: float | None
) -> tuple[float, str] | None:
    """One per revolution [Hz]: as the speed controllers report it, else of the airframe's hover, else as heard."""
    told = told_hz(log.telemetry)
    if math.isfinite(told):
        return told, "the rotor speeds in the log"
    if airframe.hover_rad_s is not None:
        return airframe.hover_rad_s / math.tau, "the airframe's hover speed"
    heard = rotor_line(blocks, corner_hz, told)
    return None if heard.reason else (heard.hz, "what is heard, the strongest line above its neighbourhood")


def flights_page(flights: Sequence[FlightReport], baseline: Baseline, path: str, created: str) -> str:
    """One page, what asks for attention first. path: of the baseline, as it was given. created: ISO 8601, UTC."""
    flights = sorted(flights, key=lambda flight: ORDER.index(flight.verdict.verdict))
    alone = len(flights) == 1
    name = Path(flights[0].verdict.log).name
    counts = Counter(flight.verdict.verdict.value for flight in flights)
    return _page(
        "flights.html",
        title=f"Flight report{f': {name}' if alone else f's: {len(flights)} logs'}",
        flights=flights,
        alone=alone,
        counts=", ".join(f"{counts[verdict]} {short}" for verdict, short in words.VERDICTS.items() if counts[verdict]),
        names=_names([flight.verdict.log for flight in flights]),
        baseline=baseline,
        baseline_path=path,
        created=created,
    )


def campaign_page(campaign: Campaign, path: str, created: str) -> str:
    """One page. path: of the results, as it was given. created: ISO 8601, UTC."""
    judged = [flight for flight in campaign.flights if flight.judged]
    healthy = [flight for flight in judged if flight.cause == HEALTHY]
    return _page(
        "campaign.html",
        title=f"Campaign report: {path}",
        created=created,
        campaign=campaign,
        found=sum(flight.latency_s is not None for flight in campaign.faulty),
        hours=sum(flight.healthy_s for flight in judged) / S_PER_H,
        episodes=sum(flight.episodes for flight in judged),
        flagged=sum(flight.faults > 0 for flight in healthy),
        healthy=len(healthy),
        flown=sorted(Counter(flight.cause for flight in campaign.flights).items()),
        judged=Counter(flight.cause for flight in judged),
        noticed=Counter(flight.cause for flight in judged if flight.latency_s is not None),
        pictures=campaign_pictures(campaign),
    )


def _page(template: str, **values: object) -> str:
    return _templates().get_template(template).render(version=__version__, **values)


@cache
def _templates() -> Environment:
    """Every value that a template prints is escaped: none can steer, move the reading direction or hide."""
    found = Environment(
        loader=PackageLoader("mavdiag.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=lambda value: value if isinstance(value, Markup) else printable(str(value)),
    )
    found.filters |= {
        "code": _with_code,
        "fixed": lambda value, places: "-" if value is None else f"{value:.{places}f}",
        "ratio": lambda monitor: monitor.maximum is not None and monitor.maximum > monitor.threshold,
        "short": lambda path: path if len(path) <= SHORT else f"…{path[-SHORT:]}",
        "signal": lambda name: LABELS.get(name, name.replace("_", " ")),
        "utc": lambda t_ns: datetime.datetime.fromtimestamp(t_ns // NS_PER_S, datetime.UTC).isoformat(),
    }
    found.globals |= {"words": words, "drawing": lambda svg, prefix: Markup(embedded(svg, prefix)), "EVENTS": EVENTS}
    return found


def _with_code(text: str) -> Markup:
    """The text with what stands between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(printable(text)))))


def _names(paths: Sequence[str]) -> list[str]:
    """The paths without the folder that all of them share."""
    folders = [path.split("/")[:-1] for path in paths]
    alike = (len(set(parts)) == 1 for parts in zip(*folders, strict=False))
    shared = sum(1 for _ in itertools.takewhile(bool, alike))
    return ["/".join(path.split("/")[shared:]) for path in paths]
