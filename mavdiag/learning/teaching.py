"""Healthy flights made ready to be learnt: what the guards find is refused with its remedy, or left out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.learning.findings import Finding
from mavdiag.learning.flights import LearntFlight, airborne, front_for, odd_rate
from mavdiag.learning.guards import far_blocks, repeated, trim_groups, upsets
from mavdiag.rows.front import Front
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Log, Series, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["Taught", "one_vehicle", "refuse", "taught"]

MAX_ROUNDS = 5  # of cutting and looking again; what is far may hide what is less far (our choice)

Guard = Callable[[Sequence[LearntFlight]], tuple[Finding, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """front: what makes the rows. flights: what is learnt. left_out, notes: as in `baseline.Provenance`."""

    front: Front
    flights: tuple[LearntFlight, ...]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def taught(logs: Sequence[Log], window_s: float, gate: GateSpec | None, *, robust: bool) -> Taught:
    """The flying parts of healthy flights, guarded.

    Raises InputError with file, place and remedy for what a guard refuses; with `robust` it is left out instead, and
    InputError says so only if nothing remains.
    """
    left_out: list[str] = []
    while robust and len(logs) > 2 and (odd := odd_rate(logs, window_s)) is not None:
        logs = [log for number, log in enumerate(logs) if number != odd[0]]
        left_out.append(f"all of {odd[1]}")
    front = front_for(logs, window_s, gate)
    logs, texts = _without(logs, repeated(logs), robust)
    left_out += texts
    flights = []
    for log in logs:
        try:
            flights.append(airborne(front, log))
        except InputError as error:
            if not robust:
                raise
            left_out.append(str(error))
    for guard in (upsets, far_blocks):
        flights, texts = _guarded(front, flights, guard, robust)
        left_out += texts
    if not flights:
        raise InputError(f"no healthy flight remains to learn from ({'; '.join(left_out)}); record others")
    return Taught(front, tuple(flights), tuple(left_out))


def one_vehicle(found: Taught, layout: RotorLayout | None, *, robust: bool) -> Taught:
    """The flights of one vehicle and set of propellers, by their trims; raises InputError as `taught` does."""
    findings = trim_groups(found.flights, layout)
    odd = [one for one in findings if one.refuses]
    if odd and not robust:
        raise InputError(f"{_sentence(odd)}; or learn a type with --fleet")
    away = {one.number for one in odd}
    return replace(
        found,
        flights=tuple(one for number, one in enumerate(found.flights) if number not in away),
        left_out=(*found.left_out, *(str(one) for one in odd)),
        notes=(*found.notes, *(str(one) for one in findings if not one.refuses)),
    )


def _guarded(
    front: Front, flights: list[LearntFlight], guard: Guard, robust: bool
) -> tuple[list[LearntFlight], list[str]]:
    """The flights without what a guard finds, and what that was. The guard looks again at what remains."""
    left_out: list[str] = []
    for _ in range(MAX_ROUNDS):
        findings = guard(flights)
        if not findings:
            break
        logs, texts = _without([one.flight for one in flights], findings, robust)
        left_out += texts
        same = {id(one.flight): one for one in flights}
        flights = []
        for log in logs:
            try:
                flights.append(same.get(id(log)) or airborne(front, log))
            except InputError as error:
                left_out.append(str(error))
    return flights, left_out


def _without(logs: Sequence[Log], findings: Sequence[Finding], robust: bool) -> tuple[list[Log], list[str]]:
    """The logs without what the findings name, and a sentence for each. Raises InputError unless `robust`."""
    if not robust:
        refuse(findings)
    kept = []
    for number, log in enumerate(logs):
        parts = [one for one in findings if one.number == number]
        if any(one.from_s is None and one.to_s is None for one in parts):
            continue
        for part in parts:
            log = replace(log, telemetry=_cut_out(log.telemetry, part.from_s, part.to_s))
        kept.append(log)
    return kept, [f"{one.log}, {one.place}: {one.text}" for one in findings]


def refuse(findings: Sequence[Finding]) -> None:
    """Raise InputError for what a guard found, with file, place and remedy; nothing if it found nothing."""
    if findings:
        raise InputError(_sentence(findings))


def _cut_out(telemetry: Telemetry, from_s: float | None, to_s: float | None) -> Telemetry:
    """The telemetry without what lies between two times [s of the vehicle's clock]."""
    parts = []
    for series in telemetry.series:
        t_s = series.t_ns / NS_PER_S
        away = np.ones(len(series), dtype=np.bool_)
        if from_s is not None:
            away &= t_s >= from_s
        if to_s is not None:
            away &= t_s < to_s
        keep = ~away
        parts.append(Series(series.signal, series.t_ns[keep], series.host_ns[keep], series.values[keep]))
    return Telemetry(tuple(parts))


def _sentence(findings: Sequence[Finding]) -> str:
    first, more = findings[0], len(findings) - 1
    others = f" (and {more} more such finding{'s' if more > 1 else ''})" if more else ""
    return f"{first}{others}; {first.remedy}"
