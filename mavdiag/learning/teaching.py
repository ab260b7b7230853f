"""Healthy flights made ready to be learnt: what the guards find is refused with its remedy, or left out."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import InputError
from mavdiag.learning.flights import (
    IN_MEMORY,
    HeldLog,
    LearntFlight,
    airborne,
    front_for,
    give_back,
    hold,
    odd_rate,
)
from mavdiag.learning.guards import Finding, far_blocks, repeated, trim_groups, upsets
from mavdiag.rows.front import Front
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.quality import LinkQuality, learnt_quality
from mavdiag.storage import Shelf
from mavdiag.telemetry import Log, Telemetry

MAX_ROUNDS = 5  # of cutting and looking again; what is far may hide what is less far (our choice)


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """The front that makes the rows, and what is learnt. left_out, notes: as in `baseline.Provenance`."""

    front: Front
    flights: tuple[LearntFlight, ...]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def taught(
    logs: Iterable[Log | HeldLog],
    window_s: float,
    gate: GateSpec | None,
    *,
    robust: bool,
    shelf: Shelf | None = None,
) -> Taught:
    """The flying parts of healthy flights, guarded, put aside as the logs are.

    Raises InputError with file, place and remedy for what a guard refuses; with `robust` it is left out instead, and
    InputError says so only if nothing remains.
    """
    shelf, left_out = shelf or Shelf(IN_MEMORY), list[str]()
    held = [hold(log, shelf) for log in logs]
    while robust and len(held) > 2 and (odd := odd_rate(held, window_s)) is not None:
        left_out.append(f"all of {odd[1]}")
        del held[odd[0]]
    front = front_for(held, window_s, gate)

    def flown(logs: Iterable[HeldLog]) -> list[LearntFlight]:
        flights = []
        for log in logs:
            try:
                flights.append(airborne(front, log, shelf))
            except InputError as error:
                if not robust:
                    raise
                left_out.append(str(error))
        give_back()
        return flights

    flights = flown(_without(held, repeated(held), shelf, robust, left_out))
    for guard in (upsets, far_blocks):
        for _ in range(MAX_ROUNDS):  # the guard looks again at what remains
            findings = guard(flights)
            if not findings:
                break
            kept = _without([flight.held for flight in flights], findings, shelf, robust, left_out)
            same = {id(flight.held): [flight] for flight in flights}
            flights = [one for log in kept for one in same.get(id(log)) or flown([log])]
    if not flights:
        raise InputError(f"no healthy flight remains to learn from ({'; '.join(left_out)}); record others")
    return Taught(front, tuple(flights), tuple(left_out))


def believing(found: Taught, shelf: Shelf) -> Taught:
    """The flights with only those samples that they themselves, taken together, make believable, as in judging."""
    flown = [(flight.held, flight.spans_ns()) for flight in found.flights]
    parts = [  # signal by signal, so that no more of the flights is in memory
        learnt_quality(
            (Telemetry(tuple(one for one in held.open().telemetry if one.signal is signal)), spans)
            for held, spans in flown
        )
        for signal in dict.fromkeys(signal for held, _ in flown for signal in held.signals)
    ]
    quality = LinkQuality(
        habits=tuple(habit for part in parts for habit in part.habits),
        jitter=max(part.jitter for part in parts),
        resolution_rad_s=max(part.resolution_rad_s for part in parts),
    )
    front = replace(found.front, align=replace(found.front.align, quality=quality))
    flights = tuple(airborne(front, held, shelf) for held, _ in flown)
    give_back()
    return replace(found, front=front, flights=flights)


def one_vehicle(found: Taught, layout: RotorLayout | None, *, robust: bool) -> Taught:
    """The flights of one vehicle and set of propellers, by their trims; raises InputError as `taught` does."""
    findings = trim_groups(found.flights, layout)
    odd = {finding.number: finding for finding in findings if finding.refuses}
    if odd and not robust:
        raise InputError(f"{_sentence(list(odd.values()))}; or learn a type with --fleet")
    return replace(
        found,
        flights=tuple(flight for number, flight in enumerate(found.flights) if number not in odd),
        left_out=(*found.left_out, *map(str, odd.values())),
        notes=(*found.notes, *(str(finding) for finding in findings if not finding.refuses)),
    )


def _without(
    logs: Sequence[HeldLog], findings: Sequence[Finding], shelf: Shelf, robust: bool, left_out: list[str]
) -> list[HeldLog]:
    """The logs without what the findings name, of which `left_out` takes a sentence each; refused unless `robust`."""
    if not robust:
        refuse(findings)
    left_out += [f"{finding.log}, {finding.place}: {finding.text}" for finding in findings]
    kept = []
    for number, log in enumerate(logs):
        places = [(finding.from_s, finding.to_s) for finding in findings if finding.number == number]
        if (None, None) not in places:
            for place in places:
                log = log.without(*place, shelf)
            kept.append(log)
    return kept


def refuse(findings: Sequence[Finding]) -> None:
    """Raise InputError for what a guard found, with file, place and remedy; nothing if it found nothing."""
    if findings:
        raise InputError(_sentence(findings))


def _sentence(findings: Sequence[Finding]) -> str:
    first, more = findings[0], len(findings) - 1
    others = f" (and {more} more such finding{'s' if more > 1 else ''})" if more else ""
    return f"{first}{others}; {first.remedy}"
