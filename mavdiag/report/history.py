"""The page of a history: the trend of each statistic of each airframe, in shares of its threshold."""

from collections.abc import Sequence

import numpy as np

from mavdiag.history.warn import WARNS, Overview, series_of
from mavdiag.report.chart import Chart, Line, Panel, Picture, drawn
from mavdiag.report.pictures import name_of
from mavdiag.telemetry import FloatArray

HEIGHT = 90  # of a panel [px]


def trends(overview: Overview) -> Picture | None:
    """A panel for each statistic, over the number of the flight; None where nothing was judged yet."""
    parts = [(stretch, series) for stretch in overview.stretches for series in series_of(stretch)]
    warned = {found.series.name for found in overview.warned}
    marks = [
        (stretch.first - 0.5, stretch.began) for stretch in overview.stretches if stretch.began and stretch.flights
    ]
    panels = []
    for monitor, axis in dict.fromkeys((series.monitor, series.axis) for _, series in parts):
        own = [(stretch, series) for stretch, series in parts if (series.monitor, series.axis) == (monitor, axis)]
        number = _apart([series.number.astype(np.float64) + stretch.first - 1 for stretch, series in own])
        share = _apart([series.share for _, series in own])
        name = own[0][1].name
        look = "measured" if name not in warned else "fault"
        label = f"{name_of(name)}{': warned of' if name in warned else ''}"
        level = Panel(
            label, [Line(number, share, look=look)], [(1.0, "threshold")], marks, y=(0.0, None), height=HEIGHT
        )
        panels.append(level)
    if not panels or len(overview.flights) < 2:
        return None
    flights = overview.flights
    words = f"{overview.airframe}: statistics of {len(flights)} flights in shares of their thresholds"
    span = (0.5, len(flights) + 0.5)
    chart = Chart(panels, span, words, x_label="flight", kind="still")
    return drawn("trends", chart, overview.airframe)


def asks(overview: Overview) -> bool:
    """Whether the airframe asks for attention."""
    changed = overview.together is not None and overview.together.changed
    return changed or overview.faulty or any(found.outlook in WARNS for found in overview.found)


def _apart(parts: Sequence[FloatArray]) -> FloatArray:
    """One after the other, with a gap between them."""
    return np.concatenate([np.append(part, np.nan) for part in parts])[:-1]
