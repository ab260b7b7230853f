"""A monitor fitted to healthy flights, with the threshold that learning would give it."""

from collections.abc import Callable, Sequence
from typing import Any

from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.telemetry import Axis
from mavdiag.thresholds.heldout import BLOCK_S, Scores, by_axis, folds, score
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, Threshold, threshold_of


def held_out_scores(
    flights: Flights,
    fit: Callable[[Flights], Sequence[Monitor[Any]]],
    block_s: float = BLOCK_S,
    sessions: Sequence[int] | None = None,
) -> dict[Axis | None, Scores]:
    """Scores of all flights by axis, each flight scored by a fit that did not see it. fit: the monitors of a fit."""
    numbers = {id(flight): number for number, flight in enumerate(flights)}
    pairs = ((left_out, fit(rest)) for left_out, rest in folds(flights, block_s, sessions))
    return by_axis(
        (one.axis, score(one, flight, block_s, numbers.get(id(flight), 0)))
        for left, found in pairs
        for one in found
        for flight in left
    )


def calibrated(
    kind: type[Monitor[Any]], flights: Flights, context: LearnContext, budget_per_hour: float = BUDGET_PER_HOUR
) -> tuple[Monitor[Any], Threshold]:
    """The monitor fitted to all flights, and its threshold from flights that a fit did not see."""
    scores = held_out_scores(flights, lambda rest: [kind(spec) for spec in kind.fit(rest, context)])
    monitor = kind(kind.fit(flights, context)[0])
    found = scores[monitor.axis]
    sessions = list(range(len(flights)))
    return monitor, threshold_of(found, sessions=sessions, budget_per_hour=budget_per_hour, prior=kind.prior)
