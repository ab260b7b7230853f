"""What a contender is, and the one rule that sets every contender's threshold and reads its alarms.

A contender studies flights of *other* airframes (faulty ones too, if it needs them) and returns a learner; the learner
turns healthy flights of the judged airframe into a scorer; the scorer turns a flight into a score.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import FloatArray, IntArray
from mavdiag.thresholds.heldout import Scores, pooled, score
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, ThresholdRule, threshold_of
from peers.flights import Flown, Truth

__all__ = [
    "Alarm",
    "Contender",
    "Learner",
    "Scored",
    "Scorer",
    "Watch",
    "alarms",
    "block_scores",
    "calibrated",
    "caught",
]

CLEAR_S = 2.0  # alarms nearer than that are one
NAMING_S = 2.0  # of an alarm, within which its highest score names the rotor
FOLDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """t_s: (k,) when each score is known. score: (k,). rotor: (k,) the suspect 1..4, 0 if the method names none."""

    t_s: FloatArray
    score: FloatArray
    rotor: IntArray

    @staticmethod
    def anonymous(t_s: FloatArray, score: FloatArray) -> "Scored":
        """Scores that say nothing of rotors."""
        return Scored(t_s, score, np.zeros(len(t_s), dtype=np.int64))


Scorer: TypeAlias = Callable[[Flown], Scored]
Learner: TypeAlias = Callable[[Sequence[Flown]], Scorer]


@dataclass(frozen=True, slots=True)
class Contender:
    """One method. needs_faults: it studies faulty flights of other airframes.

    names_rotor: it says which. rule: of the threshold; None if the method decides by itself, its score then being 1
    while it alarms and 0 otherwise.
    """

    name: str
    study: Callable[[Sequence[Flown]], Learner]
    needs_faults: bool = False
    names_rotor: bool = False
    rule: ThresholdRule | None = ThresholdRule.GUMBEL


@dataclass(frozen=True, slots=True)
class Watch:
    """A scorer and its threshold."""

    scorer: Scorer
    threshold: float


@dataclass(frozen=True, slots=True)
class Alarm:
    """A stretch above the threshold. rotor: 0 if none is named."""

    start_s: float
    end_s: float
    rotor: int


def calibrated(contender: Contender, learner: Learner, flights: Sequence[Flown]) -> Watch:
    """Learn from all healthy flights; set the threshold on scores of flights that the fit did not see, in 3 folds."""
    if contender.rule is None:
        return Watch(learner(flights), 0.5)
    parts: list[Scores] = []
    for fold in range(FOLDS):
        scorer = learner([one for i, one in enumerate(flights) if i % FOLDS != fold])
        parts += [block_scores(scorer(one), number) for number, one in list(enumerate(flights))[fold::FOLDS]]
    sessions = [0] * len(flights)
    found = threshold_of(pooled(parts), sessions=sessions, budget_per_hour=BUDGET_PER_HOUR, rule=contender.rule)
    return Watch(learner(flights), found.value)


@dataclass(frozen=True, slots=True)
class _Judged:
    """Scores as the product's own block maxima read them."""

    scored: Scored
    axis: None = None

    def over(self, _flight: Sequence[Rows]) -> Iterator[Statistic]:
        t_s, x = self.scored.t_s, self.scored.score
        yield Statistic(np.round(1e9 * t_s).astype(np.int64), float(t_s[1] - t_s[0]), x, np.isfinite(x), x, x)


def block_scores(scored: Scored, number: int) -> Scores:
    """The maximum of every 10 s of the flight of that number, by the product's own rule."""
    return score(_Judged(scored), (), number=number)


def alarms(scored: Scored, threshold: float) -> tuple[Alarm, ...]:
    """Stretches strictly above the threshold; gaps shorter than 2 s do not end one."""
    above = np.flatnonzero(scored.score > threshold)
    if len(above) == 0:
        return ()
    t_s = scored.t_s[above]
    found = []
    for stretch in np.split(above, np.flatnonzero(np.diff(t_s) > CLEAR_S) + 1):
        start_s = float(scored.t_s[stretch[0]])
        early = stretch[scored.t_s[stretch] <= start_s + NAMING_S]
        rotor = int(scored.rotor[early[np.argmax(scored.score[early])]])
        found.append(Alarm(start_s, float(scored.t_s[stretch[-1]]), rotor))
    return tuple(found)


def caught(found: Sequence[Alarm], truth: Truth) -> Alarm | None:
    """The first alarm that began after the onset. One that already stood there is no detection."""
    return next((alarm for alarm in found if alarm.start_s >= truth.onset_s), None)
