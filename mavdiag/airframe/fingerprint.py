"""Does a flight look like the vehicle that a baseline was learnt from? The answer comes before any judgement.

A fingerprint is what the healthy flights showed of the vehicle: of each trait (`mavdiag.airframe.traits`) its mean and
its spread between flights. A flight that is far from it is of another vehicle. The difficulty is a damaged rotor, which
must not be taken for another vehicle. So only that counts which damage to one rotor does not do:

- Damage shifts the trim along the rotor's own pattern: the best rise of one rotor is taken out of the shift. A rise of
  less than 0.025 shows no damage, and then the whole shift counts, unless vibration is higher: a blade may drag more.
- Damage raises vibration: only lower noise counts.
- Damage costs thrust: a lower hover throttle counts, a higher one is only noted.
- Damage hardly changes how the vehicle follows its commands, nor how many motors it has.
- Trim and throttle of a vehicle that tumbles say nothing: only calm seconds count.

Sessions of one vehicle differ as well, in battery, payload and propellers. What is far (`FAR`) is beyond all that they
were seen to do, and the flight is refused. What is near (`NEAR`) is significant against the learnt flights alone: it is
judged, with a note, and may be another specimen of the type, new propellers or a new load.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mavdiag.airframe.airframe import UNNAMED
from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.traits import TRAITS, beginning, traits, traits_of_parts
from mavdiag.airframe.trim import LEVEL_RATIO, rises
from mavdiag.errors import InputError
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray

__all__ = ["FIRST_S", "Figure", "Fingerprint", "Likeness", "Outcome", "compare", "fingerprint_of", "merged"]

FIRST_S = 20.0  # of judged flight that is compared (our choice)
PART_S = 10.0  # of a learnt flight, by which its spread is measured: half of that, so that 30 s have three (our choice)
SIGNIFICANT = 5.0  # spreads (our choice)
FAR_SPREADS = 8.0  # spreads (our choice)
FAR_TRIM = 0.04  # of the hover command, roll and pitch counting a third; recorded sessions and weights stay below 0.03
DAMAGE_RISE = 0.025  # of the hover command: about what the rotor-trim monitor takes for a rise (our choice)
RAISED = math.log(1.5)  # of a noise: vibration that damage may have made (our choice)
OTHER_MOTORS = 2  # a quadrotor is no hexarotor

TRIM = slice(0, 3)


@dataclass(frozen=True, slots=True)
class _Limit:
    """Of a trait: the floor of its spread between flights, and how much lower or higher is near and far."""

    floor: float
    near_low: float
    near_high: float
    far_low: float
    far_high: float


_NEVER = math.inf
_NOISE = _Limit(0.1, math.log(2.0), _NEVER, math.log(20.0), _NEVER)  # better balanced propellers are quieter by 7
# Floors: what healthy flights of one emulated airframe differ by, trims in payload and wind among them (estimates).
_LIMITS: tuple[_Limit, ...] = (
    *(_Limit(floor, _NEVER, _NEVER, _NEVER, _NEVER) for floor in (0.01, 0.01, 0.002)),
    *(_NOISE,) * 6,
    *(_Limit(0.1, math.log(1.5), math.log(1.5), math.log(2.0), math.log(2.0)),) * 2,
    *(_Limit(0.2, _NEVER, math.log(2.0), math.log(4.0), math.log(4.0)),) * 2,
    _Limit(0.03, math.log(1.15), math.log(1.4), math.log(1.5), _NEVER),
    _Limit(0.1, OTHER_MOTORS, OTHER_MOTORS, _NEVER, OTHER_MOTORS),  # a motor that hangs follows no command
)
"""Of TRAITS, in the same order; choices of ours, held against recorded sessions, cuts, tape and weights."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One trait of a vehicle: a name of `traits.TRAITS`, its mean over the flights, and its spread between them.

    Raises InputError if they cannot be.
    """

    name: str
    mean: float
    spread: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean) and 0.0 < self.spread < math.inf):
            raise InputError(f"fingerprint: {self.name} needs a finite mean and a positive, finite spread")


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """What healthy flights showed of their vehicle: the traits that at least one of them showed; how many flights."""

    figures: tuple[Figure, ...]
    flights: int


class Outcome(StrEnum):
    """What a comparison says."""

    ALIKE = "alike"
    NEAR = "near"  # judged, with a note
    FAR = "far"  # another vehicle


@dataclass(frozen=True, slots=True)
class Likeness:
    """How a flight compares with a fingerprint.

    outcome: what follows.
    differing: a phrase with figures for each trait that differs.
    """

    outcome: Outcome
    differing: tuple[str, ...] = ()

    def sentence(self, whose: str) -> str:
        """For a report; empty if the flight looks like that vehicle. whose: its name."""
        if self.outcome is Outcome.ALIKE:
            return ""
        figures = ", ".join(self.differing)
        whose = "the baseline's" if whose == UNNAMED else whose
        if self.outcome is Outcome.FAR:
            return f"does not look like {whose}: {figures}; judge it by a baseline of its own flights"
        return f"may be another vehicle than {whose}, or have new propellers or another load: {figures}"


def fingerprint_of(flights: Sequence[Sequence[Rows]], layout: RotorLayout | None) -> Fingerprint | None:
    """The fingerprint of the vehicle of some healthy flights; None if they show no trait.

    spread^2 = (floor^2 + sum over flights of (x - mean)^2)/n + within^2 for n flights: the floor stands for one more
    flight, so few flights have a spread that is not smaller than it ought to be. within^2: the variance of the trait
    between parts of one flight, for what is compared is a part, and some traits follow what is flown in it.
    """
    found = np.array([traits(flight, layout) for flight in flights])
    parts = [traits_of_parts(flight, layout, PART_S) for flight in flights]
    figures = []
    for i, (trait, limit, column) in enumerate(zip(TRAITS, _LIMITS, found.T, strict=True)):
        known = column[np.isfinite(column)]
        if len(known):
            mean = float(known.mean())
            between = (limit.floor**2 + float(np.square(known - mean).sum())) / len(known)
            figures.append(Figure(trait.name, mean, math.sqrt(between + _within([one[:, i] for one in parts]))))
    return Fingerprint(tuple(figures), len(flights)) if figures else None


def _within(parts: Sequence[FloatArray]) -> float:
    """The variance of a trait within a flight, from its values in the parts of each; 0 where none has two."""
    known = [one[np.isfinite(one)] for one in parts]
    freedom = sum(max(0, len(one) - 1) for one in known)
    squares = sum(float(np.square(one - one.mean()).sum()) for one in known if len(one))
    return squares / freedom if freedom else 0.0


def merged(one: Fingerprint, other: Fingerprint | None) -> Fingerprint:
    """The fingerprint of the flights of both; sums of squares add, and the distance of the means counts as spread."""
    if other is None:
        return one
    theirs = {figure.name: figure for figure in other.figures}
    n, m = one.flights, other.flights
    figures = []
    for figure in one.figures:
        fresh = theirs.pop(figure.name, figure)
        apart = fresh.mean - figure.mean
        mean = figure.mean + apart * m / (n + m)
        square = (n * figure.spread**2 + m * fresh.spread**2) / (n + m) + n * m * (apart / (n + m)) ** 2
        figures.append(Figure(figure.name, mean, math.sqrt(square)))
    return Fingerprint((*figures, *theirs.values()), n + m)


def compare(fingerprint: Fingerprint, flight: Sequence[Rows], layout: RotorLayout | None) -> Likeness:
    """Compare the first 20 s of judged flight, in chunks of any size, with a fingerprint.

    A flight that shows none of the traits is alike: nothing speaks against it.
    """
    first = beginning(flight, FIRST_S)
    if not any(len(rows.block) for rows in first):
        return Likeness(Outcome.ALIKE)
    return _compared(fingerprint, traits(first, layout), layout)


def _compared(fingerprint: Fingerprint, seen: FloatArray, layout: RotorLayout | None) -> Likeness:
    known = {figure.name: (figure.mean, figure.spread) for figure in fingerprint.figures}
    learnt = np.array([known.get(trait.name, (math.nan, 1.0)) for trait in TRAITS])
    shift, spread = seen - learnt[:, 0], learnt[:, 1]
    raised = bool(np.nanmax(np.append(shift[3:9], -np.inf)) > RAISED)
    far, near = _trim(shift[TRIM], spread[TRIM], layout, raised)
    far_words = _trim_words(learnt, seen) if far else []
    near_words = _trim_words(learnt, seen) if near and not far else []
    for i in range(TRIM.stop, len(TRAITS)):
        limit, size = _LIMITS[i], abs(float(shift[i]))
        lower = shift[i] < 0
        if size >= max(limit.far_low if lower else limit.far_high, SIGNIFICANT * spread[i]):
            far_words.append(_words(i, learnt[i], float(seen[i])))
        elif size >= max(limit.near_low if lower else limit.near_high, SIGNIFICANT * spread[i]):
            near_words.append(_words(i, learnt[i], float(seen[i])))
    outcome = Outcome.FAR if far_words else Outcome.NEAR if near_words else Outcome.ALIKE
    return Likeness(outcome, (*far_words, *near_words))


def _trim(shift: FloatArray, spread: FloatArray, layout: RotorLayout | None, raised: bool) -> tuple[bool, bool]:
    """Whether the trim is far, and whether it is near."""
    if layout is None or not np.isfinite(shift).all():
        return False, False
    level = np.array([LEVEL_RATIO, LEVEL_RATIO, 1.0])
    _, rest = _without_rotor(shift, level, layout)
    far = float(np.linalg.norm(rest / level)) > FAR_TRIM and float(np.linalg.norm(rest / spread)) > FAR_SPREADS
    rise, rest = _without_rotor(shift, spread, layout)
    if rise >= DAMAGE_RISE or raised:
        return far, float(np.linalg.norm(rest / spread)) > FAR_SPREADS
    return far, float(np.linalg.norm(shift / spread)) > SIGNIFICANT


def _without_rotor(shift: FloatArray, spread: FloatArray, layout: RotorLayout) -> tuple[float, FloatArray]:
    """The rise of one rotor, not below 0, that explains a shift of the trim best, and what it leaves of it, (3,)."""
    rise = np.maximum(rises(shift[None], layout, spread)[0], 0.0)
    rests = shift[:, None] - layout.unmixing * rise
    best = int(np.linalg.norm(rests / spread[:, None], axis=0).argmin())
    return float(rise[best]), rests[:, best]


def _trim_words(learnt: FloatArray, seen: FloatArray) -> list[str]:
    """The axis of the trim that differs most, in its own spread."""
    worst = int(np.argmax(np.abs(seen[TRIM] - learnt[TRIM, 0]) / learnt[TRIM, 1]))
    return [_words(worst, learnt[worst], float(seen[worst]))]


def _words(i: int, learnt: FloatArray, seen: float) -> str:
    name, (mean, spread) = TRAITS[i].name, learnt.tolist()
    if TRAITS[i].log:
        return f"{name} {math.exp(seen - mean):.2g} times the learnt"
    if name == "motors":
        return f"{seen:.0f} motors (learnt {mean:.0f})"
    return f"{name} {seen:+.3f} (learnt {mean:+.3f} +- {spread:.3f})"
