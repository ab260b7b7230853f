"""The rotors of the flights that are learnt from: told, or from the vehicle's parameters, or from what the outputs do.

What is told wins over the parameters, and these over the flights; where the flights speak against it, the airframe
carries a warning. The rows come out in the order of the rotors.
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

Outputs = tuple[int, ...] | None


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
    fits = said.outputs is not None and (layout is None or len(said.outputs) == layout.rotors)
    outputs = told.outputs or (said.outputs if fits else None)
    found = _look(flights, layout, outputs)
    if found.idle and told.outputs is None:  # the parameters name outputs that the link does not carry by these numbers
        outputs, found = None, _look(flights, layout, None)
    basis, warning, by_motor = "", "", all(flight.label.motor_order for flight in flights)
    if layout is not None:
        basis = told.layout_basis or (said.reason if told.layout is None else "told")
        warning = contradicts(found, layout)
        if outputs is None and _moved(found, layout):
            outputs = found.outputs
    else:
        shown = "" if _in_order(found.outputs) else "the motors are not in order"
        if found.layout is None or (shown and by_motor):
            reasons = (said.reason, found.reason if found.layout is None else shown)
            told = replace(told, layout_basis="; ".join(one for one in reasons if one))
            return told, [one.by_rotor(told.outputs) for one in flights]
        layout, basis = found.layout, found.reason
        if outputs is None and shown:
            outputs = found.outputs
    airframe = replace(
        told,
        layout=layout,
        outputs=None if outputs is None or _in_order(outputs) or by_motor else outputs,
        layout_basis=basis,
        layout_warning=f"{warning}; check the layout" if warning else "",
    )
    return airframe, [one.by_rotor(outputs) for one in flights]


def _said(flights: Sequence[LearntFlight]) -> ParameterFinding:
    """What the parameters of all flights say; nothing, with a reason, where they differ."""
    findings = [layout_from_parameters(one.label.parameters, one.label.mav_type) for one in flights]
    spoken = [one for one in findings if one.reason or one.outputs]
    if any((one.layout, one.outputs) != (spoken[0].layout, spoken[0].outputs) for one in spoken):
        return ParameterFinding(reason="the flights' parameters differ in rotors or outputs")
    return spoken[0] if spoken else ParameterFinding()


def _look(flights: Sequence[LearntFlight], layout: RotorLayout | None, outputs: Outputs) -> LayoutFinding:
    """What the flights show. layout: to be compared with the known ones. outputs: of its rotors, where known."""
    known = tuple(LAYOUTS.values())
    if layout is not None:
        known = (layout, *(one for one in known if one.signs != layout.signs and one.name != layout.name))
    order = None if outputs is None else range(1, len(outputs) + 1)
    return detect_layout(_Blocks([one.by_rotor(outputs) for one in flights]), known, order)


class _Blocks(Iterable[Block]):
    """The blocks of flights, made anew each time that they are gone through, so that few of them are in memory."""

    def __init__(self, flights: Sequence[LearntFlight]) -> None:
        self._flights = flights

    def __iter__(self) -> Iterator[Block]:
        return (rows.block for one in self._flights for rows in one.rows)


def _moved(found: LayoutFinding, layout: RotorLayout) -> bool:
    """Whether the flights show the layout on other outputs than 1, 2, ..."""
    if len(found.outputs) != layout.rotors or _in_order(found.outputs):
        return False
    if found.layout is not None:
        return found.layout.alike(layout)
    return dict(found.likeness).get(layout.name, -1.0) >= MIN_LIKENESS


def _in_order(outputs: Sequence[int]) -> bool:
    return list(outputs) == list(range(1, len(outputs) + 1))
