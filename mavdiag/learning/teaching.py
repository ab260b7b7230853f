"""Healthy flights made ready to be learnt: what the guards find is refused with its remedy, or left out."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.learning.findings import Finding
from mavdiag.learning.flights import LearntFlight, airborne_of, front_of_held, odd_rate
from mavdiag.learning.guards import far_blocks, repeated_of, trim_groups, upsets
from mavdiag.learning.held import HeldLog, held
from mavdiag.rows.front import Front
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.quality import learnt_quality
from mavdiag.storage import Shelf
from mavdiag.telemetry import Log, Series, Telemetry
from mavdiag.units import NS_PER_S

__all__ = ["Taught", "believing", "one_vehicle", "refuse", "taught", "taught_of"]

MAX_ROUNDS = 5  # of cutting and looking again; what is far may hide what is less far (our choice)

Guard = Callable[[Sequence[LearntFlight]], tuple[Finding, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """front: what makes the rows. flights: what is learnt. left_out, notes: as in `baseline.Provenance`."""

    front: Front
    flights: tuple[LearntFlight, ...]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def taught(logs: Iterable[Log], window_s: float, gate: GateSpec | None, *, robust: bool) -> Taught:
    """The flying parts of healthy flights, guarded, in memory.

    Raises InputError with file, place and remedy for what a guard refuses; with `robust` it is left out instead, and
    InputError says so only if nothing remains.
    """
    shelf = Shelf(most_bytes=1 << 62)
    return taught_of([held(log, shelf) for log in logs], window_s, gate, shelf, robust=robust)


def taught_of(logs: Sequence[HeldLog], window_s: float, gate: GateSpec | None, shelf: Shelf, *, robust: bool) -> Taught:
    """As `taught`, for logs that are put aside; their rows are as well."""
    left_out: list[str] = []
    while robust and len(logs) > 2 and (odd := odd_rate(logs, window_s)) is not None:
        logs = [log for number, log in enumerate(logs) if number != odd[0]]
        left_out.append(f"all of {odd[1]}")
    front = front_of_held(logs, window_s, gate)
    logs, texts = _without(logs, repeated_of(logs), shelf, robust)
    left_out += texts
    flights = []
    for log in logs:
        try:
            flights.append(airborne_of(front, log, shelf))
        except InputError as error:
            if not robust:
                raise
            left_out.append(str(error))
    for guard in (upsets, far_blocks):
        flights, texts = _guarded(front, flights, guard, shelf, robust)
        left_out += texts
    if not flights:
        raise InputError(f"no healthy flight remains to learn from ({'; '.join(left_out)}); record others")
    return Taught(front, tuple(flights), tuple(left_out))


def believing(found: Taught, shelf: Shelf) -> Taught:
    """The flights with only those samples that they themselves, taken together, make believable, as in judging."""
    quality = learnt_quality((one.flight.telemetry, one.spans_ns) for one in found.flights)
    front = replace(found.front, align=replace(found.front.align, quality=quality))
    return replace(found, front=front, flights=tuple(airborne_of(front, one.held, shelf) for one in found.flights))


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
    front: Front, flights: list[LearntFlight], guard: Guard, shelf: Shelf, robust: bool
) -> tuple[list[LearntFlight], list[str]]:
    """The flights without what a guard finds, and what that was. The guard looks again at what remains."""
    left_out: list[str] = []
    for _ in range(MAX_ROUNDS):
        findings = guard(flights)
        if not findings:
            break
        logs, texts = _without([one.held for one in flights], findings, shelf, robust)
        left_out += texts
        same = {id(one.held): one for one in flights}
        flights = []
        for log in logs:
            try:
                flights.append(same.get(id(log)) or airborne_of(front, log, shelf))
            except InputError as error:
                left_out.append(str(error))
    return flights, left_out


def _without(
    logs: Sequence[HeldLog], findings: Sequence[Finding], shelf: Shelf, robust: bool
) -> tuple[list[HeldLog], list[str]]:
    """The logs without what the findings name, and a sentence for each. Raises InputError unless `robust`."""
    if not robust:
        refuse(findings)
    kept = []
    for number, log in enumerate(logs):
        parts = [one for one in findings if one.number == number]
        if any(one.from_s is None and one.to_s is None for one in parts):
            continue
        for part in parts:
            whole = log.open()
            cut = replace(whole, telemetry=_cut_out(whole.telemetry, part.from_s, part.to_s))
            log = held(cut, shelf, log.measure)
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
