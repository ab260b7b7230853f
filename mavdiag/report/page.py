"""Pages by Jinja2 templates: values in, HTML out. Every text is escaped, for names and notes of logs are not ours.

What a page says of a verdict is in `decision.words`, what it says of a figure in captions.toml, the rest in templates.
The one script (templates/page.js, with uPlot from vendor/) is allowed by its hash; without it the page says the same.
"""

import base64
import datetime
import hashlib
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mavdiag import __version__
from mavdiag.airframe.airframe import Airframe
from mavdiag.archive.paths import apart
from mavdiag.baseline import Baseline
from mavdiag.decision import words
from mavdiag.history.show import lines_of
from mavdiag.history.warn import Overview, series_of
from mavdiag.judging import JudgedFlight, LogVerdict, judge_in_full
from mavdiag.link.profiles import PROFILES
from mavdiag.link.wants import LABELS
from mavdiag.look.figures import rotor_line, told_hz
from mavdiag.look.inspection import Summary, summaries
from mavdiag.monitors.base import FaultKind
from mavdiag.monitors.run_length import RunLengthSpec
from mavdiag.printable import printable
from mavdiag.report import pictures
from mavdiag.report.campaign import HEALTHY, Campaign, campaign_pictures, confusion
from mavdiag.report.chart import COLUMNS, FOLDER, Chart, Line, Panel, Picture, drawn, embedded
from mavdiag.report.drawing import rotor_places, where
from mavdiag.report.sketch import Sketch
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S, S_PER_H

EVENTS = 20  # alarms that a page lists of one flight; the rest is counted (our choice)
TREND_HEIGHT = 90  # of a panel of a history [px]
SPANS = 12  # stretches that were not judged that a page lists (our choice)
ORDER = tuple(words.VERDICTS)
OF_LOG = ("flight", "attitude")  # pictures that need no judging


@dataclass(frozen=True, slots=True, eq=False)
class FlightReport:
    """What a page says of a flight.

    begin_s: first sample of the gyro, by the vehicle's clock: where the times of a page begin. drawing: the airframe.
    rises: whether it has figures. places: of the rotors, as words. unjudged: flown stretches, times of the flight [s].
    pictures: of the flight, in the order of the page. method: those that are folded away.
    """

    verdict: LogVerdict
    sha256: str = ""
    started_ns: int = 0  # then, unix epoch; 0 if it is not known
    begin_s: float = 0.0
    link: tuple[Summary, ...] = ()
    drawing: str = ""
    rises: bool = False
    places: tuple[str, ...] = ()
    unjudged: tuple[tuple[float, float], ...] = ()
    pictures: tuple[Picture, ...] = ()
    method: tuple[Picture, ...] = ()

    def utc(self, t_s: float) -> str:
        """A time of the flight by the clock, UTC; empty if it is not known."""
        return f"{_clock(self.started_ns / NS_PER_S + t_s):%H:%M:%S} UTC" if self.started_ns else ""

    def named(self, rotor: int) -> str:
        """A rotor and where it is: "2 (front right)"."""
        return f"{rotor} ({self.places[rotor - 1]})" if 0 < rotor <= len(self.places) else str(rotor)


def flight_report(log: Log, baseline: Baseline, columns: int = COLUMNS, *, figures: bool = True) -> FlightReport:
    """Judge a flight and tell all of it. columns: points across a figure. figures: False for words and tables alone."""
    sketch = Sketch(log, columns)
    judged = judge_in_full(log, baseline, keep=False, show=sketch.take if figures else None)
    verdict, layout = judged.verdict, baseline.airframe.layout
    # From when on a damaged propeller shows; None for the whole flight: what follows a loss says nothing of it.
    of_propeller = verdict.since_s is not None and verdict.kind in (None, FaultKind.PROPELLER)
    since_s = verdict.since_s - sketch.begin_ns / NS_PER_S if of_propeller and verdict.since_s is not None else None
    shown, method = _pictures(log, baseline, judged, sketch, since_s) if figures else ((), ())
    return FlightReport(
        verdict,
        log.sha256,
        log.started_ns and log.epoch_ns + sketch.begin_ns,
        sketch.begin_ns / NS_PER_S,
        summaries(log.telemetry),
        "" if layout is None else pictures.airframe_drawing(layout, sketch, words.rotors_of(verdict)),
        pictures.told_rises(sketch) is not None,
        () if layout is None else tuple(where(place) for place in rotor_places(layout)),
        tuple(pictures.unjudged(judged, sketch)),
        shown,
        method,
    )


def _pictures(
    log: Log, baseline: Baseline, judged: JudgedFlight, sketch: Sketch, since_s: float | None
) -> tuple[tuple[Picture, ...], tuple[Picture, ...]]:
    frame, telemetry = baseline.airframe, log.telemetry
    rules = [entry.spec for entry in baseline.monitors if isinstance(entry.spec, RunLengthSpec)]
    modelled, order = {rule.axis: rule.model for rule in rules if sketch.blocks}, baseline.window.order
    sweeps = {a: pictures.sweep_of(sketch.blocks, a, m.order, m.method, order) for a, m in modelled.items()}
    profile = PROFILES.get(log.profile)
    corner_hz = frame.imu_corner_hz or (None if profile is None else profile.imu_corner_hz)
    line = _rotor_line(log, frame, sketch, corner_hz)
    monitors = (pictures.monitor_picture(name, sketch, baseline) for name in pictures.spoken(judged))
    window_s = baseline.window.samples * baseline.link.dt_s
    beginning = (pictures.timeline(log, judged, sketch), pictures.flight_picture(telemetry, sketch))
    flight = (*beginning, *filter(None, monitors))
    method = (
        pictures.evidence_picture(sketch),
        pictures.attitude_picture(telemetry, sketch),
        pictures.rates_picture(sketch),
        pictures.residual_picture(sketch),
        pictures.fsd_picture(sketch),
        pictures.plane_picture(sketch, frame.classifier),
        pictures.severity_picture(sketch, since_s, frame.classifier),
        pictures.spectrum_picture(sketch.spectrum, line, corner_hz, 1 / sketch.dt_s),
        pictures.windows_picture(sweeps, sketch.dt_s, window_s),
    )
    shown, folded = (tuple(_explained(picture, baseline, judged) for picture in part) for part in (flight, method))
    return shown, folded


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


def _rotor_line(log: Log, airframe: Airframe, sketch: Sketch, corner_hz: float | None) -> tuple[float, str] | None:
    """One per revolution [Hz]: as the speed controllers report it, else of the airframe's hover, else as heard."""
    told = told_hz(log.telemetry)
    if math.isfinite(told):
        return told, "the rotor speeds in the log"
    if airframe.hover_rad_s is not None:
        return airframe.hover_rad_s / math.tau, "the airframe's hover speed"
    heard = rotor_line(sketch.blocks, corner_hz, told)
    return None if heard.reason else (heard.hz, "what is heard, the strongest line above its neighbourhood")


def flights_page(flights: Sequence[FlightReport], baseline: Baseline, path: str, created: str) -> str:
    """One page, what asks for attention first. path: of the baseline, as it was given. created: ISO 8601, UTC."""
    flights = sorted(flights, key=lambda flight: ORDER.index(flight.verdict.verdict))
    counts = Counter(flight.verdict.verdict.value for flight in flights)
    alone, names = len(flights) == 1, apart([flight.verdict.log for flight in flights])
    title = Path(flights[0].verdict.log).name if alone else f"{len(flights)} flights"
    told = ", ".join(f"{counts[verdict]} {short}" for verdict, short in words.VERDICTS.items() if counts[verdict])
    whose = {"baseline": baseline, "baseline_path": path, "created": created}
    return _page("flights.html", title=title, flights=flights, alone=alone, counts=told, names=names, **whose)


def campaign_page(campaign: Campaign, path: str, created: str) -> str:
    """One page. path: of the results, as it was given. created: ISO 8601, UTC."""
    judged = [flight for flight in campaign.flights if flight.judged]
    healthy = [flight for flight in judged if flight.cause == HEALTHY]
    return _page(
        "campaign.html",
        title=f"Campaign: {Path(path).name}",
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
        confusion=confusion(campaign),
    )


def history_page(overviews: Sequence[Overview], created: str) -> str:
    """One page, what asks for attention first. created: ISO 8601, UTC."""
    first = sorted(overviews, key=lambda one: one.asks, reverse=True)
    airframes = [{"asks": one.asks, "lines": lines_of(one), "picture": _trends(one)} for one in first]
    return _page("history.html", title="History", airframes=airframes, created=created)


def _trends(overview: Overview) -> Picture | None:
    """A panel for each statistic, in shares of its threshold; None where nothing was judged yet."""
    lines, warned = dict[str, list[Line]](), {found.series.name for found in overview.warned}
    for stretch in overview.stretches:
        for series in series_of(stretch):
            number = np.arange(len(series.peak), dtype=np.float64) + stretch.first
            look = "fault" if series.name in warned else "measured"
            lines.setdefault(series.name, []).append(Line(number, series.share, look=look))
    marks = [(one.first - 0.5, one.began) for one in overview.stretches if one.began and one.flights]
    panels = []
    for name, own in lines.items():
        label = f"{pictures.name_of(name)}{': warned of' if name in warned else ''}"
        panels.append(Panel(label, own, [(1.0, "threshold")], marks, y=(0.0, None), height=TREND_HEIGHT))
    if not panels or len(overview.flights) < 2:
        return None
    count = len(overview.flights)
    chart = Chart(panels, (0.5, count + 0.5), x_label="flight", kind="still")
    return drawn("trends", chart, overview.airframe)


def _page(template: str, **values: object) -> str:
    parts = (FOLDER / "vendor" / "uPlot.iife.min.js", FOLDER / "templates" / "page.js")
    script = "\n".join(path.read_text(encoding="utf-8").strip() for path in parts)
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    told = {"version": __version__, "script": Markup(script), "allowed": f"sha256-{allowed}"}
    return _templates().get_template(template).render(**told, **values)


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
    styles = (FOLDER / "vendor" / "uPlot.min.css", FOLDER / "chart.css", FOLDER / "templates" / "style.css")
    found.filters |= {
        "code": lambda text: Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(printable(text))))),
        "fixed": lambda value, places: "-" if value is None else f"{value:.{places}f}",
        "above": lambda monitor: monitor.maximum is not None and monitor.maximum > monitor.threshold,
        "shown": lambda value, unit: "-" if value is None else f"{pictures.scaled(unit)[0] * value:.3g}",
        "unit": lambda unit: pictures.scaled(unit)[1],
        "name": pictures.name_of,
        "rotor": lambda rotor, flight: flight.named(rotor),
        "signal": lambda name: LABELS.get(name, name.replace("_", " ")),
        "day": lambda created: f"{datetime.datetime.fromisoformat(created):%Y-%m-%d %H:%M} UTC",
        "moment": lambda t_ns: f"{_clock(t_ns / NS_PER_S):%Y-%m-%d %H:%M:%S} UTC",
    }
    found.globals |= {
        "words": words,
        "drawing": lambda svg, prefix: Markup(embedded(svg, prefix)),
        "style": Markup("\n".join(path.read_text(encoding="utf-8").strip() for path in styles)),
        "EVENTS": EVENTS,
        "SPANS": SPANS,
    }
    return found


def _clock(t_s: float) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(t_s, datetime.UTC)
