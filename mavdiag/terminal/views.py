"""From what was received and judged to a picture: which strips, bars and lines there are."""

import math
from collections.abc import Sequence

import numpy as np

from mavdiag.decision.diagnosis import Change, Diagnosis, Stage
from mavdiag.link.messages import Severity
from mavdiag.monitors import by_name
from mavdiag.telemetry import Axis, FloatArray
from mavdiag.terminal.ground_station import GroundStation, ReceivedText
from mavdiag.terminal.live_judge import LiveJudge
from mavdiag.terminal.strips import Curve
from mavdiag.terminal.view import Level, Line, StripView
from mavdiag.traces import RateTrace, rate_traces
from mavdiag.units import NS_PER_S

__all__ = [
    "MEASURED",
    "SIMULATED",
    "figure_levels",
    "headline",
    "levels",
    "line_for",
    "link_line",
    "rate_strips",
]

MEASURED, SIMULATED, RESIDUAL, MARGIN = "bright_white", "cyan", "yellow", "red"
POINTS_PER_S = 100.0  # of a strip, at most: more would not be seen
LEAST_RATE = 0.1  # of the scale of rates [rad/s]
OF_MARGIN = 3.0  # least scale of a residual, in margins

_SEVERITY = {Stage.FAULT: Severity.CRITICAL, Stage.SUSPECTED: Severity.WARNING}


def rate_strips(judge: LiveJudge, axes: Sequence[Axis], rows: int = 4) -> tuple[StripView, ...]:
    """For each axis with a model: measured and simulated rate (T Fig 5.6), and the residual with its margin (5.7)."""
    traces = [one for one in rate_traces(judge.chain, judge.pieces) if one.axis in axes and len(one.t_ns)]
    return tuple(strip for one in traces for strip in (_rates(one, rows), _residual(one, rows)))


def levels(judge: LiveJudge) -> tuple[Level, ...]:
    """Every monitor against its threshold; of one on two axes both."""
    found = []
    for monitor, axis, gauge, reason in judge.gauges:
        name = by_name(monitor).label + (f" {axis}" if axis is not None else "")
        if gauge is None:
            found.append(Level(name, 0.0, math.inf, "", reason))
        else:
            found.append(Level(name, gauge.statistic, gauge.threshold, gauge.unit, reason))
    return tuple(found)


def figure_levels(station: GroundStation) -> tuple[Level, ...]:
    """The thesis rule by the figures that a detector sends: residual against margin, FSD against FML."""
    figures = station.figures
    if not {"PF_RES", "PF_MARG", "PF_FSD", "PF_FML"} <= figures.keys():
        return ()
    return (
        Level("|residual|", abs(figures["PF_RES"]), figures["PF_MARG"], "rad/s"),
        Level("FSD", figures["PF_FSD"], figures["PF_FML"], "s"),
    )


def headline(diagnosis: Diagnosis) -> str:
    """What is held of the vehicle, in one sentence."""
    if diagnosis.stage not in (Stage.FAULT, Stage.SUSPECTED) or diagnosis.monitor is None:
        return str(diagnosis)
    unit = f" {diagnosis.unit}" if diagnosis.unit else ""
    evidence = f"{diagnosis.monitor} {diagnosis.statistic:.3g} > {diagnosis.threshold:.3g}{unit}"
    return f"{diagnosis} ({evidence})"


def line_for(news: ReceivedText | Change, text_from: str = "", change_from: str = "") -> Line:
    """A text of a detector, or a change of a decision, as a line. text_from, change_from: say whose they are."""
    if isinstance(news, ReceivedText):
        return Line(news.t_s, Severity(min(news.severity, Severity.DEBUG)), f"{text_from}{news.text}")
    words = str(news).partition(" s ")[2]
    return Line(news.t_ns / NS_PER_S, _SEVERITY.get(news.stage, Severity.INFO), f"{change_from}{words}")


def link_line(judge: LiveJudge) -> str:
    """How the link is."""
    count = judge.count
    if count is None:
        return judge.waiting or "no vehicle yet"
    total = count.received + count.lost
    lost = f"{100 * count.lost / total:.2f} % lost" if total else "nothing received"
    return f"vehicle {judge.vehicle}: {count.received} messages, {lost}"


def _rates(trace: RateTrace, rows: int) -> StripView:
    t_s, measured, simulated = _thinned(trace, trace.measured, trace.simulated)
    reach = max(LEAST_RATE, _highest(measured), _highest(simulated))
    curves = (Curve(t_s, simulated, SIMULATED), Curve(t_s, measured, MEASURED))
    return StripView(f"{trace.axis} rate", "rad/s", curves, -reach, reach, rows)


def _residual(trace: RateTrace, rows: int) -> StripView:
    t_s, residual = _thinned(trace, np.where(trace.judged, trace.residual, np.nan))
    margin = trace.margin_rad_s
    reach = max(OF_MARGIN * margin, _highest(residual))
    lines = [Curve(t_s, np.full(len(t_s), level), MARGIN, dotted=True) for level in (-margin, margin)]
    curves = (*lines, Curve(t_s, residual, RESIDUAL))
    return StripView("residual", "rad/s", curves, -reach, reach, rows)


def _thinned(trace: RateTrace, *columns: FloatArray) -> tuple[FloatArray, ...]:
    """Times and values with no more rows than a strip can show. Every n-th row is kept: what is filtered over 0.1 s
    has nothing between them."""
    t_s: FloatArray = trace.t_ns / NS_PER_S
    period_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    step = max(1, int(1 / (POINTS_PER_S * period_s))) if period_s > 0 else 1
    return tuple(one[::step] for one in (t_s, *columns))


def _highest(values: FloatArray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else 0.0
