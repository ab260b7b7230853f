"""Every monitor that can work on this link, fitted to the healthy flights and given its threshold."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mavdiag.baseline import MonitorEntry, Refusal
from mavdiag.diagnose.geometry import Frame
from mavdiag.diagnose.heldout import Flights
from mavdiag.diagnose.monitors import effort, innovation, shake
from mavdiag.diagnose.monitors.base import Monitor, Rows
from mavdiag.diagnose.threshold import Guard, ThresholdRule, calibrate
from mavdiag.errors import IdentificationError, InputError

__all__ = ["KINDS", "LearnContext", "learn_monitors"]


@dataclass(frozen=True, slots=True)
class LearnContext:
    """What is known beside the flights. frame: the rotor layout, if known; imu_corner_hz: of the link's own filter."""

    frame: Frame | None
    imu_corner_hz: float | None
    rule: ThresholdRule
    budget_per_hour: float


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of monitor: can it work, how is it fitted, what watches by the fit, what guards its threshold."""

    judgeable: Callable[[Sequence[Rows], LearnContext], str | None]
    fit: Callable[[Flights, LearnContext], Any]
    watch: Callable[[Any], Monitor[Any]]
    guard: Guard


def _fit_effort(flights: Flights, context: LearnContext) -> effort.EffortSpec:
    if context.frame is None:
        raise InputError("effort: the rotor layout is not known; name the frame")
    return effort.fit(flights, context.frame)


# The thesis's latency monitor is not here: its model and margin are learnt with the axis (`learning.latency`).
KINDS = {
    "innovation": _Kind(
        lambda rows, context: innovation.judgeable(rows),
        lambda flights, context: innovation.fit(flights),
        innovation.Innovation,
        innovation.GUARD,
    ),
    "effort": _Kind(
        lambda rows, context: effort.judgeable(rows, context.frame), _fit_effort, effort.Effort, effort.GUARD
    ),
    "shake": _Kind(
        lambda rows, context: shake.judgeable(rows),
        lambda flights, context: shake.fit(flights),
        shake.Shake,
        shake.GUARD,
    ),
}


def learn_monitors(
    names: Sequence[str], flights: Flights, context: LearnContext
) -> tuple[list[MonitorEntry], list[Refusal]]:
    """An entry for each named kind that can work on these flights, and the reason of each that cannot."""
    entries, refusals = [], []
    rows = [one for flight in flights for one in flight]
    for name in names:
        kind = KINDS[name]
        reason = kind.judgeable(rows, context)
        if reason is None:
            try:
                entries.append(_entry(kind, flights, context))
            except (InputError, IdentificationError) as error:
                reason = str(error)
        if reason is not None:
            refusals.append(Refusal(monitor=name, reason=reason))
    return entries, refusals


def _entry(kind: _Kind, flights: Flights, context: LearnContext) -> MonitorEntry:
    spec, threshold = calibrate(
        flights,
        lambda some: kind.fit(some, context),
        kind.watch,
        budget_per_hour=context.budget_per_hour,
        guard=kind.guard,
        rule=context.rule,
    )
    return MonitorEntry(spec=spec, threshold=threshold)
