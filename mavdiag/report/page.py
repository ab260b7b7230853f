"""The page of one or several flights: values in, HTML out."""

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mavdiag import __version__
from mavdiag.baseline import Baseline
from mavdiag.baseline_parts import Refusal
from mavdiag.judging import MonitorSummary, Verdict
from mavdiag.link.wants import LABELS
from mavdiag.report.flight import FlightReport
from mavdiag.report.html import escaped, figure, listed, page, paragraph, table
from mavdiag.report.quality import Quality
from mavdiag.report.words import OBSERVES, advice, evidence_sentence, headline, unjudged
from mavdiag.units import NS_PER_S

__all__ = ["Made", "flights_page"]

WORDS = {
    Verdict.FAULT: "fault",
    Verdict.SUSPECTED: "suspected",
    Verdict.HEALTHY: "healthy",
    Verdict.NOT_JUDGEABLE: "not judgeable",
    Verdict.ERROR: "not readable",
}
ORDER = (Verdict.ERROR, Verdict.FAULT, Verdict.SUSPECTED, Verdict.NOT_JUDGEABLE, Verdict.HEALTHY)
EVENTS = 20  # alarms that a page lists of one flight; the rest is counted (our choice)
SHORT = 60  # characters of a path that a heading shows


@dataclass(frozen=True, slots=True)
class Made:
    """When the page was made: ISO 8601, UTC. baseline_path: as it was given."""

    created: str
    baseline_path: str


def flights_page(flights: Sequence[FlightReport], baseline: Baseline, made: Made) -> str:
    """One page; of several flights it begins with a table of all. What asks for attention comes first."""
    one = len(flights) == 1
    flights = sorted(flights, key=lambda flight: ORDER.index(flight.verdict.verdict))
    title = f"Flight report: {Path(flights[0].verdict.log).name}" if one else f"Flight reports: {len(flights)} logs"
    body = [
        "<header>",
        f"<h1>{escaped(title)}</h1>",
        paragraph(f"Judged by the baseline {made.baseline_path}; made {made.created} by mavdiag {__version__}."),
        "</header>",
        "<main>",
        "" if one else _index(flights),
        *(_flight(flight, number, one, baseline.not_judgeable) for number, flight in enumerate(flights, start=1)),
        _about(baseline, made),
        "</main>",
    ]
    return page(title, body)


def _index(flights: Sequence[FlightReport]) -> str:
    """A row for each log, in the order of the page."""
    rows, links, above = [], [], []
    names = _names([one.verdict.log for one in flights])
    for number, flight in enumerate(flights):
        verdict = flight.verdict
        rotor = verdict.rotor
        words = WORDS[verdict.verdict] if verdict.kind is None else str(verdict.kind)
        sentence = headline(verdict)
        times = f"{verdict.judged_s:.1f}", f"{verdict.flown_s:.1f}"
        rows.append((names[number], words, "" if rotor is None else str(rotor), *times, sentence))
        links.append(f"log-{number + 1}")
        if verdict.verdict in (Verdict.FAULT, Verdict.ERROR):
            above.append(number)
    counts = ", ".join(f"{n} {WORDS[one]}" for one in ORDER if (n := sum(f.verdict.verdict is one for f in flights)))
    heads = ("log", "verdict", "rotor", "judged [s]", "flown [s]", "in one sentence")
    return table(f"All logs: {counts}.", heads, rows, numbers=(2, 3, 4), above=above, links=links)


def _flight(flight: FlightReport, number: int, alone: bool, lacking: Sequence[Refusal]) -> str:
    verdict, prefix = flight.verdict, f"log-{number}"
    heading = "" if alone else f"<h2>{escaped(_short(verdict.log))}</h2>"
    text = "\n".join(
        part
        for part in (
            f'<section id="{prefix}">',
            heading,
            f'<div class="verdict {verdict.verdict.value}">',
            paragraph(headline(verdict), "said"),
            paragraph(evidence_sentence(verdict)),
            paragraph(advice(verdict)),
            "</div>",
            _unjudged(flight, lacking),
            _monitors(verdict.monitors),
            _events(flight),
            "<h3>Figures</h3>" if flight.pictures else _no_figures(flight),
            *(figure(one, prefix, place) for place, one in enumerate(flight.pictures, start=1)),
            _link(flight.link),
            _provenance(flight),
            "</section>",
        )
        if part
    )
    # Parts of the only log stand one level below the page's own title.
    return text.replace("<h3>", '<h2 class="part">').replace("</h3>", "</h2>") if alone else text


def _no_figures(flight: FlightReport) -> str:
    if flight.verdict.verdict is Verdict.ERROR:
        return ""
    return paragraph(
        "No figures are drawn here, to keep the page small; `mavdiag report` of this log alone draws them."
    )


def _unjudged(flight: FlightReport, lacking: Sequence[Refusal]) -> str:
    """What was not judged, and what must be known of the log."""
    verdict = flight.verdict
    told = unjudged(verdict) + tuple(f"{one.monitor}: not in this baseline, {one.reason}" for one in lacking)
    nothing = paragraph("Every monitor judged nearly all of the judged flight; the table has the times.")
    parts = [f"<h3>What was not judged, and why</h3>{listed(told) or nothing}"] if verdict.monitors else []
    if verdict.notes:
        parts.append(f"<h3>What must be known of this log</h3>{listed(verdict.notes)}")
    return "".join(parts)


def _monitors(monitors: Sequence[MonitorSummary]) -> str:
    rows, above = [], []
    for place, one in enumerate(monitors):
        over = one.maximum is not None and one.maximum > one.threshold
        if over:
            above.append(place)
        rows.append(
            (
                one.name if one.axis is None else f"{one.name} ({one.axis})",
                OBSERVES.get(one.name, ""),
                "-" if one.maximum is None else f"{one.maximum:.4g}",
                f"{one.threshold:.4g}",
                one.unit,
                "above" if over else "not judged" if one.maximum is None else "below",
                f"{one.judged_s:.1f}",
                ("decides" if one.decides else "suspicion only"),
                one.not_judged or "",
            )
        )
    heads = (
        "monitor",
        "what it looks at",
        "maximum",
        "threshold",
        "unit",
        "result",
        "judged [s]",
        "its alarm",
        "not judged: reason",
    )
    caption = "Monitors: the highest statistic of the flight beside the threshold that healthy flights set."
    return table(caption, heads, rows, numbers=(2, 3, 6), above=above)


def _events(flight: FlightReport) -> str:
    events = flight.verdict.events
    rows = []
    for one in events[:EVENTS]:
        event = one.event
        name = event.monitor if event.axis is None else f"{event.monitor} ({event.axis})"
        end = "end of log" if one.end_s is None else f"{one.end_s:.2f}"
        rotor = "" if event.rotor is None else str(event.rotor)
        rows.append((f"{one.t_s:.2f}", end, name, f"{event.statistic:.4g}", f"{event.threshold:.4g}", rotor))
    more = f"; the first {EVENTS} are listed" if len(events) > EVENTS else ""
    heads = ("from [s]", "to [s]", "monitor", "highest", "threshold", "rotor")
    listing = table(f"Alarms of single monitors: {len(events)}{more}.", heads, rows, numbers=(0, 1, 3, 4, 5))
    return f"<h3>Alarms</h3>{listing}" if rows else ""


def _link(link: Sequence[Quality]) -> str:
    def number(value: float | None, places: int) -> str:
        return "-" if value is None else f"{value:.{places}f}"

    rows = [
        (
            LABELS.get(one.signal, one.signal.replace("_", " ")),
            str(one.samples),
            number(one.rate_hz, 1),
            number(one.jitter_ms, 2),
            str(one.gaps),
            number(one.longest_s, 3),
            f"{100 * one.missing:.1f}",
            str(one.repeated),
        )
        for one in link
    ]
    heads = (
        "signal",
        "samples",
        "usual rate [Hz]",
        "jitter [ms]",
        "gaps",
        "longest step [s]",
        "missing [%]",
        "repeated",
    )
    listing = table("Link quality: each signal as it came.", heads, rows, numbers=range(1, len(heads)))
    return f"<h3>Link quality</h3>{listing}" if rows else ""


def _provenance(flight: FlightReport) -> str:
    verdict, source = flight.verdict, flight.source
    started = ""
    if source.started_ns:
        at = datetime.datetime.fromtimestamp(source.started_ns // NS_PER_S, datetime.UTC)
        started = at.isoformat(timespec="seconds")
    rows = [
        ("log", verdict.log),
        ("SHA-256 of the log", source.sha256 or "unknown"),
        ("flown", started or "the log does not say"),
        ("link profile", source.profile or "unknown"),
        ("rate of the gyro", f"{verdict.rate_hz:.2f} Hz" if verdict.rate_hz else "unknown"),
        ("reason as `mavdiag scan` gives it", verdict.reason),
    ]
    return f"<h3>Where the figures come from</h3>{table('This log.', ('what', 'value'), rows)}"


def _about(baseline: Baseline, made: Made) -> str:
    """The baseline and the tool, and how to read the words."""
    provenance = baseline.provenance
    rows = [
        ("baseline", made.baseline_path),
        ("digest of the baseline", baseline.digest),
        ("airframe", f"{baseline.airframe.name} ({baseline.airframe.scope}); {baseline.airframe.layout_statement}"),
        ("learnt from", f"{len(provenance.logs)} healthy flights, {60 * baseline.healthy_hours:.1f} min judged"),
        ("learnt", f"{provenance.created} by {provenance.tool}"),
        *(("monitor that this baseline lacks", f"{one.monitor}: {one.reason}") for one in baseline.not_judgeable),
        ("this page", f"{made.created} by mavdiag {__version__}"),
    ]
    return f'<section id="about"><h2>The baseline, and how to read this page</h2>{"".join(_glossary())}' + (
        table("The baseline and this page.", ("what", "value"), rows) + "</section>"
    )


def _glossary() -> Iterator[str]:
    yield "<dl>"
    for word, meaning in (
        ("Baseline", "what healthy flights of this airframe looked like, with a threshold for each monitor."),
        ("Monitor", "one figure that is computed all the time and compared with its threshold."),
        ("Residual", "the measured rate less the one that the healthy model simulates from the commands alone."),
        ("Margin", "what the residual stayed below in nine tenths of the healthy flight."),
        (
            "FSD, FML",
            "fault signature duration: how long the residual was outside of the margin without a break; fault "
            "minimal latency: how long that may last in a healthy flight. The thesis's rule alarms when FSD > FML.",
        ),
        ("Vehicle time", "seconds of the vehicle's own clock, as in the log."),
        (
            "Thesis",
            "Propeller Fault Diagnosis in Multirotor UAVs: A Data-Driven System Dynamics Approach (2025), whose "
            "figures have the numbers given here.",
        ),
    ):
        yield f"<dt><b>{escaped(word)}</b></dt><dd>{escaped(meaning)}</dd>"
    yield "</dl>"


def _names(paths: Sequence[str]) -> list[str]:
    """The paths without the folder that all of them share."""
    folders = [path.split("/")[:-1] for path in paths]
    shared = 0
    while all(len(one) > shared and one[shared] == folders[0][shared] for one in folders):
        shared += 1
    return ["/".join(path.split("/")[shared:]) for path in paths]


def _short(path: str) -> str:
    """The end of a long path."""
    return path if len(path) <= SHORT else f"…{path[-SHORT:]}"
