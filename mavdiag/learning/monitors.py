"""Every monitor that can work on this link, fitted to the healthy flights and given its threshold."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.baseline import MonitorEntry, Refusal
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors import innovation, rotor_signature, rotor_trim, unbalance, vibration_level
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.thresholds.heldout import Flights
from mavdiag.thresholds.rule import Guard, ThresholdRule, calibrate

__all__ = ["KINDS", "LearnContext", "learn_monitors"]


@dataclass(frozen=True, slots=True)
class LearnContext:
    """What is known beside the flights.

    frame: the rotor layout. imu_corner_hz: of the link's own filter, None if it has none. hover: mass [kg] and the
    rotor speed that carries it [rad/s].
    """

    frame: RotorLayout | None
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


def _frame(context: LearnContext) -> RotorLayout:
    if context.frame is None:
        raise InputError("the rotor layout is not known; name the frame")
    return context.frame


def _accelerometer_refuses(rows: Sequence[Rows], context: LearnContext) -> str | None:
    if not any(np.isfinite(one.block.force[one.block.valid, :2]).any() for one in rows):
        return "the link carries no accelerometer of all axes"
    rotor_hz = context.hover[1] / (2 * np.pi) if context.hover else None
    return unbalance.judgeable(1 / rows[0].block.dt_s, context.imu_corner_hz, rotor_hz)


_ACCELEROMETER = _Kind(
    _accelerometer_refuses,
    lambda flights, context: unbalance.fit(flights, context.frame, context.hover),
    unbalance.Unbalance,
    unbalance.GUARD,
)
_MESSAGE = _Kind(
    lambda rows, context: vibration_level.judgeable(rows),
    lambda flights, context: vibration_level.fit(flights),
    vibration_level.VibrationLevel,
    vibration_level.GUARD,
)
_INNOVATION = _Kind(
    lambda rows, context: innovation.judgeable(rows),
    lambda flights, context: innovation.fit(flights),
    innovation.Innovation,
    innovation.GUARD,
)
_ENERGY = _Kind(
    lambda rows, context: rotor_signature.judgeable(rows, context.frame),
    lambda flights, context: rotor_signature.fit(flights, _frame(context)),
    rotor_signature.RotorSignature,
    rotor_signature.GUARD,
)
_EFFORT = _Kind(
    lambda rows, context: rotor_trim.judgeable(rows, context.frame),
    lambda flights, context: rotor_trim.fit(flights, _frame(context)),
    rotor_trim.RotorTrim,
    rotor_trim.GUARD,
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
