"""Every monitor that can work on this link, fitted to the healthy flights and given its threshold."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavdiag.baseline import MonitorEntry, Refusal
from mavdiag.diagnose.geometry import Frame
from mavdiag.diagnose.heldout import Flights
from mavdiag.diagnose.monitors import effort, energy, innovation, shake, vibration
from mavdiag.diagnose.monitors.base import Monitor, Rows
from mavdiag.diagnose.threshold import Guard, ThresholdRule, calibrate
from mavdiag.errors import IdentificationError, InputError

__all__ = ["KINDS", "LearnContext", "learn_monitors"]


@dataclass(frozen=True, slots=True)
class LearnContext:
    """What is known beside the flights.

    frame: the rotor layout. imu_corner_hz: of the link's own filter, None if it has none. hover: mass [kg] and the
    rotor speed that carries it [rad/s].
    """

    frame: Frame | None
    imu_corner_hz: float | None
    hover: tuple[float, float] | None
    rule: ThresholdRule
    budget_per_hour: float


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of monitor: can it work, how is it fitted, what watches by the fit, what guards its threshold."""

    judgeable: Callable[[Sequence[Rows], LearnContext], str | None]
    fit: Callable[[Flights, LearnContext], Any]
    watch: Callable[[Any], Monitor[Any]]
    guard: Guard


def _frame(context: LearnContext) -> Frame:
    if context.frame is None:
        raise InputError("the rotor layout is not known; name the frame")
    return context.frame


def _accelerometer_refuses(rows: Sequence[Rows], context: LearnContext) -> str | None:
    if not any(np.isfinite(one.block.force[one.block.valid, :2]).any() for one in rows):
        return "the link carries no accelerometer of all axes"
    rotor_hz = context.hover[1] / (2 * np.pi) if context.hover else None
    return vibration.judgeable(1 / rows[0].block.dt_s, context.imu_corner_hz, rotor_hz)


_ACCELEROMETER = _Kind(
    _accelerometer_refuses,
    lambda flights, context: vibration.fit(flights, context.frame, context.hover),
    vibration.Vibration,
    vibration.GUARD,
)
_MESSAGE = _Kind(
    lambda rows, context: shake.judgeable(rows), lambda flights, context: shake.fit(flights), shake.Shake, shake.GUARD
)
_INNOVATION = _Kind(
    lambda rows, context: innovation.judgeable(rows),
    lambda flights, context: innovation.fit(flights),
    innovation.Innovation,
    innovation.GUARD,
)
_ENERGY = _Kind(
    lambda rows, context: energy.judgeable(rows, context.frame),
    lambda flights, context: energy.fit(flights, _frame(context)),
    energy.Energy,
    energy.GUARD,
)
_EFFORT = _Kind(
    lambda rows, context: effort.judgeable(rows, context.frame),
    lambda flights, context: effort.fit(flights, _frame(context)),
    effort.Effort,
    effort.GUARD,
)
# By public name; of several ways to the same evidence the first that the link allows is taken. The thesis's latency
# monitor is not here: its model and margin are learnt with the axis (`learning.latency`).
KINDS = {
    "innovation": (_INNOVATION,),
    "energy": (_ENERGY,),
    "vibration": (_ACCELEROMETER, _MESSAGE),
    "effort": (_EFFORT,),
}


def learn_monitors(
    names: Sequence[str], flights: Flights, context: LearnContext
) -> tuple[list[MonitorEntry], list[Refusal]]:
    """An entry for each named monitor that can work on these flights, and the reason of each that cannot."""
    entries: list[MonitorEntry] = []
    refusals: list[Refusal] = []
    rows = [one for flight in flights for one in flight]
    for name in names:
        reasons: list[str] = []
        for kind in KINDS[name]:
            found = _entry(kind, rows, flights, context)
            if isinstance(found, MonitorEntry):
                entries.append(found)
                break
            reasons.append(found)
        else:
            refusals.append(Refusal(monitor=name, reason="; ".join(reasons)))
    return entries, refusals


def _entry(kind: _Kind, rows: Sequence[Rows], flights: Flights, context: LearnContext) -> MonitorEntry | str:
    """The monitor's entry, or why there is none."""
    reason = kind.judgeable(rows, context)
    if reason is not None:
        return reason
    try:
        spec, threshold = calibrate(
            flights,
            lambda some: kind.fit(some, context),
            kind.watch,
            budget_per_hour=context.budget_per_hour,
            guard=kind.guard,
            rule=context.rule,
        )
    except (InputError, IdentificationError) as error:
        return str(error)
    return MonitorEntry(spec=spec, threshold=threshold)
