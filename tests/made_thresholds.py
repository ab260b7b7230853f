"""A monitor fitted to healthy flights, with the threshold that learning would give it."""

from typing import Any

from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.thresholds.heldout import held_out_scores
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, Threshold, threshold_of


def calibrated(
    kind: type[Monitor[Any]], flights: Flights, context: LearnContext, budget_per_hour: float = BUDGET_PER_HOUR
) -> tuple[Monitor[Any], Threshold]:
    """The monitor fitted to all flights, and its threshold from flights that a fit did not see."""
    scores = held_out_scores(flights, lambda rest: [kind(spec) for spec in kind.fit(rest, context)])
    monitor = kind(kind.fit(flights, context)[0])
    found = scores[monitor.axis]
    return monitor, threshold_of(found, flights=len(flights), budget_per_hour=budget_per_hour, guard=kind.guard)
