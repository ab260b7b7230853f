"""The rotors of the flights that are learnt from: told, or from the vehicle's parameters, or from what the outputs do.

In this order: what is told wins over the parameters, and these over the flights. Where the flights speak against it,
the airframe carries a warning. The rows come out in the order of the rotors.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.detect import MIN_LIKENESS, LayoutFinding, contradicts, detect_layout
from mavdiag.airframe.layout import LAYOUTS, RotorLayout
from mavdiag.airframe.load import airframe_named
from mavdiag.airframe.parameters import ParameterFinding, layout_from_parameters
from mavdiag.learning.flights import LearntFlight
from mavdiag.logs import airframe_name_for
from mavdiag.rows.block import Block

TOLD = "told"


def of_log_kind(told: Airframe, profile: str) -> Airframe:
    """The airframe with what the kind of log says of it; a link says nothing."""
    name = airframe_name_for(profile)
    if name is None or told.layout is not None:
        return told
    known = airframe_named(name)
    label = known.name if told.name == Airframe().name else told.name
    basis = f"of every vehicle that writes such logs, {profile}"
    return replace(known, name=label, scope=told.scope, gate=told.gate or known.gate, layout_basis=basis)


def with_rotors(told: Airframe, flights: Sequence[LearntFlight]) -> tuple[Airframe, list[LearntFlight]]:
    """The airframe with its rotor layout, its outputs and where they are known from, and the flights in that order.

    told: what the user said of it. A layout that stays unknown has its reason in `Airframe.layout_basis`.
    """
    said = _said(flights)
    layout = said.layout if told.layout is None else told.layout
    outputs = told.outputs or _usable(said, layout)
    found = _look(flights, layout, outputs)
    if found.idle and told.outputs is None:  # the parameters name outputs that the link does not carry by these numbers
        outputs, found = None, _look(flights, layout, None)
    if layout is None:
        return _from_flights(told, said, found, flights, outputs)
    warning = contradicts(found, layout)
    if outputs is None and _moved(found, layout):
        outputs = found.outputs
    airframe = replace(
        told,
        layout=layout,
        outputs=_of_outputs(outputs, flights),
        layout_basis=told.layout_basis or (said.reason if told.layout is None else TOLD),
        layout_warning=f"{warning}; check the layout" if warning else "",
    )
    return airframe, [_ordered(one, outputs) for one in flights]


def _from_flights(
    told: Airframe,
    said: ParameterFinding,
    found: LayoutFinding,
    flights: Sequence[LearntFlight],
    outputs: tuple[int, ...] | None,
) -> tuple[Airframe, list[LearntFlight]]:
    """The airframe with the layout that the flights show; outputs: as the parameters have them."""
    shown = "" if found.outputs == _in_order(len(found.outputs)) else "the motors are not in order"
    if found.layout is None or (shown and _all_in_motor_order(flights)):
        reasons = (said.reason, shown if found.layout is not None else found.reason)
        basis = "; ".join(one for one in reasons if one)
        return replace(told, layout_basis=basis), [_ordered(one, told.outputs) for one in flights]
    if outputs is None and shown:
        outputs = found.outputs
    airframe = replace(
        told, layout=found.layout, outputs=_of_outputs(outputs, flights), layout_basis=found.reason, layout_warning=""
    )
    return airframe, [_ordered(one, outputs) for one in flights]


def _said(flights: Sequence[LearntFlight]) -> ParameterFinding:
    """What the parameters of all flights say; nothing, with a reason, where they differ."""
    findings = [layout_from_parameters(one.label.parameters, one.label.mav_type) for one in flights]
    spoken = [one for one in findings if one.reason or one.outputs]
    if not spoken:
        return ParameterFinding()
    if any((one.layout, one.outputs) != (spoken[0].layout, spoken[0].outputs) for one in spoken):
        return ParameterFinding(reason="the flights' parameters differ in rotors or outputs")
    return spoken[0]


def _usable(said: ParameterFinding, layout: RotorLayout | None) -> tuple[int, ...] | None:
    """The parameters' outputs, if they are as many as the layout's rotors."""
    fits = said.outputs is not None and (layout is None or len(said.outputs) == layout.rotors)
    return said.outputs if fits else None


def _look(
    flights: Sequence[LearntFlight], layout: RotorLayout | None, outputs: tuple[int, ...] | None
) -> LayoutFinding:
    """What the flights show. layout: to be compared with the known ones. outputs: of its rotors, where known."""
    known = tuple(LAYOUTS.values())
    if layout is not None:
        known = (layout, *(one for one in known if one.signs != layout.signs and one.name != layout.name))
    order = None if outputs is None else _in_order(len(outputs))
    return detect_layout(_Blocks([_ordered(one, outputs) for one in flights]), known, order)


class _Blocks(Iterable[Block]):
    """The blocks of flights, as often as they are looked at, so that few of them are in memory."""

    def __init__(self, flights: Sequence[LearntFlight]) -> None:
        self._flights = flights

    def __iter__(self) -> Iterator[Block]:
        return (rows.block for one in self._flights for rows in one.rows)


def _moved(found: LayoutFinding, layout: RotorLayout) -> bool:
    """Whether the flights show the layout on other outputs than 1, 2, ..."""
    if len(found.outputs) != layout.rotors or found.outputs == _in_order(layout.rotors):
        return False
    if found.layout is not None:
        return found.layout.alike(layout)
    return dict(found.likeness).get(layout.name, -1.0) >= MIN_LIKENESS


def _ordered(one: LearntFlight, outputs: tuple[int, ...] | None) -> LearntFlight:
    """The flight with its outputs by rotor; a log that has them by motor already stays as it is."""
    if outputs is None or one.label.motor_order:
        return one
    return replace(one, rows=one.rows.by_rotor(outputs))


def _of_outputs(outputs: tuple[int, ...] | None, flights: Sequence[LearntFlight]) -> tuple[int, ...] | None:
    """What the airframe has to keep: nothing where rotor j is on output j, or the logs are by motor."""
    named = outputs is not None and outputs != _in_order(len(outputs)) and not _all_in_motor_order(flights)
    return outputs if named else None


def _all_in_motor_order(flights: Sequence[LearntFlight]) -> bool:
    return all(flight.label.motor_order for flight in flights)


def _in_order(count: int) -> tuple[int, ...]:
    return tuple(range(1, count + 1))
