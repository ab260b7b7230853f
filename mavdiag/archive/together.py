"""What flights of one airframe say together: by what odds a rotor has changed since the flights of the baseline. Pure.

The law is in `mavdiag.thresholds.evidence`. Here stand its inputs: which flights count, and in which session each was
flown. A new flight within an hour of one that taught, with its propellers, is of that session, one within an hour of
the flight before it of that flight's. Where either has no clock, both may be: the lower odds of all such flights in one
session, and of each in one of its own, are told. The lower of two e-processes is one if either is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavdiag.airframe.trim import LEVEL_RATIO
from mavdiag.archive.figures import FlightRecord
from mavdiag.baseline import SESSION_GAP_NS, Baseline, SourceLog
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.evidence import SURE, Evidence, Flown, evidence_of
from mavdiag.thresholds.rule import Prior

# Of hover, what a payload or a battery moves the level trims between sessions: a tenth of the weight at half an arm
# (our choice; CrazyPAD E8 has 0.05).
LEVEL_SD = 0.05
NAMED = 0.9  # share of the evidence that the rotors have together which are named (our choice)


@dataclass(frozen=True, slots=True)
class Reference:
    """What flights are compared with, of the baseline with this digest.

    columns: of the layout's unmixing C, (3, rotors). flights: those that taught and have a trim.
    """

    baseline: str
    columns: tuple[tuple[float, ...], ...]
    flights: tuple[SourceLog, ...]


@dataclass(frozen=True, slots=True)
class Together:
    """What flights say. evidence: None for want of trims, and then nothing is. since: first flight of the change."""

    flights: int
    evidence: Evidence | None = None
    since: FlightRecord | None = None

    @property
    def changed(self) -> bool:
        """Whether a change is to be told."""
        return self.evidence is not None and self.evidence.odds >= SURE

    def __str__(self) -> str:
        count = f"{self.flights} flight{'s' * (self.flights != 1)} together"
        if self.evidence is None or self.since is None:
            return f"{count}: nothing can be said of the rotors, for want of their trim"
        odds = f"{self.evidence.odds:.2g}" if self.evidence.odds < 10 else f"{float(f'{self.evidence.odds:.2g}'):,.0f}"
        if not self.changed:
            return f"{count}: no rotor's trim is known to have changed, {odds} to 1"
        return f"{count}: rotor {' or '.join(map(str, self.rotors))} has changed, {odds} to 1, since {self.since.log}"

    @property
    def rotors(self) -> tuple[int, ...]:
        """The likeliest, from 1, that have `NAMED` of the evidence together."""
        shares = np.array(() if self.evidence is None else self.evidence.shares)
        order = np.argsort(-shares)
        needed = 1 + int(np.searchsorted(np.cumsum(shares[order]), NAMED)) if len(shares) else 0
        return tuple((order[:needed] + 1).tolist())

    def as_json(self) -> dict[str, Any]:
        """Flights and odds; of a change the rotors that may be it, and the log of its first flight."""
        odds, since = self.evidence and float(f"{self.evidence.odds:.3g}"), self.since and self.since.log
        of_change = {"rotors": list(self.rotors), "since": since} if self.changed else {"rotors": [], "since": None}
        return {"flights": self.flights, "odds": odds, "changed": self.changed, **of_change}


def reference_of(baseline: Baseline) -> Reference:
    """What its flights may be compared with."""
    layout = baseline.airframe.layout
    flights = tuple(one for one in baseline.provenance.logs if one.trim)
    return Reference(baseline.digest, () if layout is None else tuple(map(tuple, layout.unmixing.tolist())), flights)


def together(reference: Reference, records: Sequence[FlightRecord], *, new_propellers: bool = False) -> Together:
    """What the flights say, in their order. new_propellers: they flew a set that the baseline does not know.

    Flights that taught, and those without a trim, are left out.
    """
    taught, known = reference.flights, {one.sha256 for one in reference.flights}
    flights = [one for one in records if one.trim and one.content.partition(":")[0] not in known]
    if not (flights and taught and reference.columns):
        return Together(len(flights))
    last, C = max(one.propellers for one in taught), np.array(reference.columns)
    common = (
        np.array([*(one.propellers for one in taught), *[last + new_propellers] * len(flights)]),
        np.array([*(one.judged_s for one in taught), *(one.judged_s for one in flights)]),
        len(taught),
    )
    trims = np.array([*(one.trim for one in taught), *(one.trim for one in flights)])
    alike = [one for one in taught if one.propellers == last and not new_propellers]
    own = tuple(one.session for one in taught)
    sessions = {(*own, *_sessions(taught, alike, flights, unknown)) for unknown in (False, True)}
    found = (evidence_of(Flown(trims, np.array(each), *common), C, priors_of(C)) for each in sorted(sessions))
    evidence = min(found, key=lambda one: one.odds)
    return Together(len(flights), evidence, flights[evidence.since])


def _sessions(
    taught: Sequence[SourceLog], alike: Sequence[SourceLog], flights: Sequence[FlightRecord], if_unknown: bool
) -> list[int]:
    """The session of each flight. alike: those that taught with its propellers. if_unknown: said without clocks."""
    found, number, before_ns = list[int](), max(one.session for one in taught), -1
    for at_ns in (flight.started_ns for flight in flights):
        near = [one.session for one in alike if _together(one.started_ns, at_ns, False)]
        if before_ns < 0 or not _together(before_ns, at_ns, if_unknown):
            number += 1
            found.append(near[0] if near else number)
        else:
            found.append(found[-1])
        before_ns = at_ns
    return found


def _together(one_ns: int, other_ns: int, if_unknown: bool) -> bool:
    return abs(one_ns - other_ns) <= SESSION_GAP_NS if one_ns and other_ns else if_unknown


def priors_of(columns: FloatArray) -> tuple[Prior, Prior, Prior]:
    """Of roll, pitch and yaw trim. The monitor's own is of a rotor's rise, which is seen in yaw."""
    yaw = float(np.abs(columns[2]).max())
    session, flight = yaw * RotorTrim.prior.session, yaw * RotorTrim.prior.flight
    level = Prior(LEVEL_SD, LEVEL_RATIO * flight, shares=False)
    return level, level, Prior(session, flight, shares=False)
