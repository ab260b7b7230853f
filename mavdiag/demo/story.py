"""What the demo shows of its flight: the rates, the threshold being crossed, and what detector and thesis rule say."""

from collections.abc import Sequence

from mavdiag.decision.diagnosis import Change, Stage
from mavdiag.demo.closed_loop import Flight
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Axis
from mavdiag.terminal.ground_station import GroundStation
from mavdiag.terminal.view import Line, View
from mavdiag.terminal.views import figure_levels, levels, link_line, rate_strips
from mavdiag.units import NS_PER_S

__all__ = ["DETECTOR", "SPAN_S", "THESIS", "first_crossing", "flight_view"]

DETECTOR, THESIS = "detector: ", "thesis rule: "
SPAN_S = 12.0
LEGEND = "white: measured, cyan: simulated, yellow: residual, red: margin"  # as `terminal.views` draws them


def flight_view(station: GroundStation, flight: Flight, events: Sequence[Line]) -> View:
    """The picture of a moment. events: so far."""
    now_s = station.t_s
    fault = f"{flight.fault} on rotor {flight.rotor}"
    damaged = now_s >= flight.onset_s
    phase = f"damaged: {fault} since" if damaged else f"healthy; {fault} comes at"
    alerts = [one for one in events if one.severity <= Severity.CRITICAL and one.text.startswith(DETECTOR)]
    judge = station.judge
    return View(
        title=f"flight {now_s:.1f} of {flight.duration_s:g} s, {phase} {flight.onset_s:g} s",
        headline=alerts[-1].text.removeprefix(DETECTOR) if alerts else "no alert",
        alert=bool(alerts),
        from_s=now_s - SPAN_S,
        to_s=now_s,
        strips=() if judge is None else rate_strips(judge, (Axis.ROLL,)),
        levels=figure_levels(station) if judge is None else levels(judge),
        events=tuple(events),
        foot="" if judge is None else f"{LEGEND}; {link_line(judge)}",
    )


def first_crossing(changes: Sequence[Change], onset_s: float) -> Change | None:
    """When the thesis rule first declared a fault after the onset; None if it did not."""
    return next((one for one in changes if one.stage is Stage.FAULT and one.t_ns / NS_PER_S >= onset_s), None)
