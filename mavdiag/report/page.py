"""Pages by Jinja2 templates: values in, HTML out. Every text is escaped, for names and notes of logs are not ours.

What a page says of a verdict is in `decision.words`, what it says of a figure in captions.toml, the rest in templates.
"""

import datetime
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mavdiag import __version__
from mavdiag.baseline import Baseline
from mavdiag.decision import words
from mavdiag.link.wants import LABELS
from mavdiag.printable import printable
from mavdiag.report.campaign import HEALTHY, Campaign, campaign_pictures
from mavdiag.report.flight import FlightReport
from mavdiag.report.style import embedded
from mavdiag.units import NS_PER_S, S_PER_H

EVENTS = 20  # alarms that a page lists of one flight; the rest is counted (our choice)
SHORT = 60  # characters of a path that a heading shows
ORDER = tuple(words.VERDICTS)


@dataclass(frozen=True, slots=True)
class Made:
    """When the page was made: ISO 8601, UTC. baseline_path: as it was given."""

    created: str
    baseline_path: str


def flights_page(flights: Sequence[FlightReport], baseline: Baseline, made: Made) -> str:
    """One page; of several flights it begins with a table of all. What asks for attention comes first."""
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
        made=made,
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
        "utc": lambda t_ns: datetime.datetime.fromtimestamp(t_ns // NS_PER_S, datetime.UTC).isoformat(
            timespec="seconds"
        ),
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
