"""Rows from plain arrays; context and thresholds as learning makes them, for tests that look at one monitor alone."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import Flights, LearnContext, Monitor
from mavdiag.rows.block import COVERED, OUTPUTS, RATE, VALID, WHOLE, Block, Part, Rows, with_outputs
from mavdiag.rows.rates import RateSpec
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Axis, BoolArray, FloatArray
from mavdiag.thresholds.heldout import Scores, folds, pooled, score
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, Threshold, threshold_of

WINDOW = 5  # samples of the rate filters


def example_rows(
    n: int,
    dt_s: float = 0.01,
    *,
    segment: int = 0,
    setpoint: FloatArray | None = None,
    rate: FloatArray | None = None,
    **columns: FloatArray | BoolArray | None,
) -> Rows:
    """n rows of one segment with the columns of `Block` given, (n, k) each; without a set-point it rests."""
    x, setpoint = np.full((OUTPUTS, n), np.nan), np.zeros((n, 3)) if setpoint is None else setpoint
    x[: WHOLE + 1], x[VALID : VALID + 2], x[COVERED], x[WHOLE : RATE + 3] = 0.0, 1.0, 1.0, 0.0
    if rate is None and n > 1:
        x[RATE + 2] = np.gradient(setpoint[:, 2], dt_s)
    t_ns = round(segment * 1e12) + np.round(np.arange(n) * dt_s * 1e9).astype(np.int64)
    block = changed(Block(segment, dt_s, t_ns, x), setpoint=setpoint, rate=rate, armed=np.ones(n), **columns)
    spec = RateSpec.of(dt_s, WINDOW)
    return spec.step(spec.start(), block)


def changed(block: Block, **columns: FloatArray | BoolArray | None) -> Block:
    """The block with other columns, (n,) or (n, k); None leaves one as it is."""
    given = {name: column for name, column in columns.items() if column is not None}
    sent, speeds = given.pop("actuator", block.actuator).T, given.pop("rotor_speed", block.rotor_speed).T
    made = with_outputs(block, np.asarray(sent, np.float64), np.asarray(speeds, np.float64))
    for name, column in given.items():
        part: Part[np.float64] = Block.__dict__[name]
        made.x[part.at] = column.T
    return made


def example_context(
    frame: str | None = None, dt_s: float = 0.01, *, mass_kg: float | None = None, hover_rad_s: float | None = None
) -> LearnContext:
    """What fits need beside such rows. frame: name of the rotor layout, if it is known."""
    layout = None if frame is None else layout_named(frame)
    return LearnContext(Airframe(layout=layout, mass_kg=mass_kg, hover_rad_s=hover_rad_s), None, dt_s, WINDOW)


def held_out_scores(
    flights: Flights, fit: Callable[[Flights], Sequence[Monitor[Any]]], sessions: Sequence[int] | None = None
) -> dict[Axis | None, Scores]:
    """Scores of all flights by axis, each flight scored by a fit that did not see it. fit: the monitors of a fit."""
    numbers = {id(flight): number for number, flight in enumerate(flights)}
    found = defaultdict[Axis | None, list[Scores]](list)
    for left_out, rest in folds(flights, sessions):
        for one in fit(rest):
            found[one.axis] += [score(one, flight, numbers.get(id(flight), 0)) for flight in left_out]
    return {axis: pooled(scores) for axis, scores in found.items()}


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
    return next(monitor.over([rows]))
