"""Context and thresholds as learning makes them, for tests that look at one monitor alone."""

from collections.abc import Callable, Sequence
from typing import Any

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis
from mavdiag.testing import WINDOW
from mavdiag.thresholds.heldout import BLOCK_S, Scores, by_axis, folds, score
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, Threshold, threshold_of


def example_context(
    frame: str | None = None, dt_s: float = 0.01, *, mass_kg: float | None = None, hover_rad_s: float | None = None
) -> LearnContext:
    """What fits need beside such rows. frame: name of the rotor layout, if it is known."""
    layout = None if frame is None else layout_named(frame)
    airframe = Airframe(layout=layout, mass_kg=mass_kg, hover_rad_s=hover_rad_s)
    return LearnContext(airframe, None, dt_s, WINDOW)


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


def read(monitor: Monitor[Any], rows: Rows) -> Statistic:
    """What it makes of rows, from the beginning."""
    return monitor.step(monitor.start(), rows)[1]
