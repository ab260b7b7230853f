"""All monitors fitted to healthy flights, and scored on flights that a fit did not see.

    each flight, once        -> a summary for each monitor (`Monitor.gather`), put aside
    all summaries            -> the fits that the baseline holds, and one fit without each fold (`Monitor.settle`)
    each flight, once more   -> its block maxima by the fits that did not see it (`thresholds.heldout`)

So no fit goes back to rows, and one flight's rows are in memory at a time. A single flight is cut into pieces, and each
rest is gathered anew: what is beside a piece is no flight that was seen before.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, overload

from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Flights, LearnContext, Monitor, Rows, Summary
from mavdiag.storage import Kept, Shelf
from mavdiag.telemetry import Axis
from mavdiag.thresholds.heldout import Scores, by_axis, folds, scored

__all__ = ["Fitted", "fits"]

Kind = type[Monitor[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A monitor's fits to all flights, and what its statistic reached on flights that a fit did not see, by axis.

    refusal: why it cannot work on such flights; empty if it can.
    """

    kind: Kind
    specs: tuple[Any, ...] = ()
    scores: Mapping[Axis | None, Scores] = field(default_factory=dict)
    refusal: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _HeldSummaries(Sequence[Summary]):
    """Summaries on a shelf, of which each look takes the memory that it touches."""

    kept: tuple[Kept, ...]

    def __len__(self) -> int:
        return len(self.kept)

    @overload
    def __getitem__(self, at: int) -> Summary: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Summary]: ...

    def __getitem__(self, at: int | slice) -> Summary | Sequence[Summary]:
        return _HeldSummaries(self.kept[at]) if isinstance(at, slice) else self.kept[at].get()


class _Gathered:
    """The summaries of flights, each made once. errors: of the monitors that cannot work by the context alone."""

    def __init__(self, kinds: Sequence[Kind], context: LearnContext, shelf: Shelf) -> None:
        self._context, self._shelf = context, shelf
        self._kinds = list(kinds)
        self._found: dict[int, dict[Kind, Kept]] = {}
        self.errors: dict[Kind, str] = {}

    def add(self, flight: Sequence[Rows]) -> None:
        """Look at a flight, for all monitors that are left."""
        look = tuple(flight)
        found = self._found[id(flight)] = {}
        for kind in self._kinds:
            if kind not in self.errors:
                try:
                    found[kind] = self._shelf.put(kind.gather(look, self._context))
                except (InputError, IdentificationError) as error:
                    self.errors[kind] = str(error)

    def of(self, kind: Kind, flights: Flights) -> _HeldSummaries:
        """What a monitor gathered of these flights."""
        return _HeldSummaries(tuple(self._found[id(flight)][kind] for flight in flights))


def fits(
    kinds: Iterable[Kind], flights: Flights, sessions: Sequence[int], context: LearnContext, shelf: Shelf
) -> Iterator[Fitted]:
    """Each monitor fitted and scored, in the order of the kinds. sessions: of each flight."""
    kinds = tuple(kinds)
    gathered = _Gathered(kinds, context, shelf)
    pairs = list(folds(flights, sessions=sessions))
    for flight in (*flights, *(rest[0] for _, rest in pairs if len(flights) == 1)):
        gathered.add(flight)
    found = {kind: _settled(kind, gathered, flights, [rest for _, rest in pairs], context) for kind in kinds}
    able = [kind for kind in kinds if not found[kind][0].refusal]
    scores = scored([left_out for left_out, _ in pairs], [found[kind][1] for kind in able])
    parts = dict(zip(able, scores, strict=True))
    for kind in kinds:
        one = found[kind][0]
        if one.refusal:
            yield one
            continue
        try:
            yield replace(one, scores=by_axis(parts[kind]))
        except IdentificationError as error:
            yield Fitted(kind, refusal=str(error))


def _settled(
    kind: Kind, gathered: _Gathered, flights: Flights, rests: Sequence[Flights], context: LearnContext
) -> tuple[Fitted, list[list[Monitor[Any]]]]:
    """The fits of a monitor to all flights, and its monitors by a fit to the rest of each fold."""
    try:
        if kind in gathered.errors:
            raise InputError(gathered.errors[kind])
        specs = kind.settle(gathered.of(kind, flights), context)
        plain = replace(context, figures=False, near=specs)
        return Fitted(kind, specs), [
            [kind(spec) for spec in kind.settle(gathered.of(kind, rest), plain)] for rest in rests
        ]
    except (InputError, IdentificationError) as error:
        return Fitted(kind, refusal=str(error)), []
