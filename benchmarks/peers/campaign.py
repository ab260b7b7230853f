"""Run all contenders over the common campaign and count: who finds what, how soon, and at what price."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

from peers.contender import Contender, Learner, Watch, alarms, calibrated, caught
from peers.flights import (
    FAULTY_S,
    ONSET_S,
    PHENOMENOLOGIES,
    Flown,
    Truth,
    airframe,
    faulty,
    flown,
    healthy,
    other_airframe,
)
from sitl_plant.physics.airframe import Airframe

__all__ = ["DEFAULT", "QUICK", "Catch", "Size", "Tally", "run"]

T = TypeVar("T")

TRAINING, FALSE_ALARMS, DETECTION, LENT = 1, 2, 3, 4  # seeds that never meet


@dataclass(frozen=True, slots=True)
class Size:
    """How much is flown. learn_*: healthy flights to learn from and judge_*: to count false alarms in, per airframe.

    lent_*: of each other airframe, healthy flights, and the length of 27 faulty ones, each fault at each phenomenology.
    """

    airframes: int
    learn_flights: int
    learn_s: float
    judge_flights: int
    judge_s: float
    others: int
    lent_flights: int
    lent_s: float
    lent_faulty_s: float


DEFAULT = Size(4, 12, 40.0, 16, 120.0, 3, 6, 30.0, 8.0)
QUICK = Size(1, 8, 40.0, 8, 60.0, 2, 4, 30.0, 6.0)


@dataclass(frozen=True, slots=True)
class Catch:
    """One faulty flight under one contender. latency_s: None if missed; rotor: the one named, 0 if none."""

    truth: Truth
    latency_s: float | None
    rotor: int


@dataclass(slots=True)
class Tally:
    """What one contender did over the campaign. spent_s: CPU time on `rows` rows, the way
    from telemetry to rows included; fitting_s: to study, learn and calibrate, all airframes."""

    contender: Contender
    catches: list[Catch] = field(default_factory=list)
    false_alarms: int = 0
    healthy_s: float = 0.0
    spent_s: float = 0.0
    rows: int = 0
    fitting_s: float = 0.0

    @property
    def microseconds(self) -> float:
        """CPU time of one row."""
        return 1e6 * self.spent_s / self.rows


def run(contenders: Sequence[Contender], size: Size, seed: int, tell: Callable[[str], None]) -> list[Tally]:
    """The whole campaign. tell: gets one line of progress at a time."""
    tell("flights of other airframes")
    others = [one.forgetting_telemetry() for number in range(size.others) for one in _lent(number, size, seed)]
    tallies = [Tally(contender) for contender in contenders]
    learners = [_timed(tally, partial(tally.contender.study, others)) for tally in tallies]
    for number in range(size.airframes):
        specimen = airframe(number, seed)
        tell(f"airframe {number + 1} of {size.airframes}: learning")
        watches = _learn(tallies, learners, specimen, number, size, seed)
        tell(f"airframe {number + 1} of {size.airframes}: judging")
        _judge(tallies, watches, specimen, number, size, seed)
    return tallies


def _timed(tally: Tally, act: Callable[[], T]) -> T:
    started = time.process_time()
    result = act()
    tally.fitting_s += time.process_time() - started
    return result


def _lent(number: int, size: Size, seed: int) -> Iterable[Flown]:
    """Healthy and faulty flights of an airframe that is not judged, every fault at every phenomenology."""
    specimen, key = other_airframe(number, seed), (seed, LENT, number)
    for config in healthy(specimen, size.lent_flights, key):
        yield flown(config, size.lent_s)
    for turn, scale in enumerate(PHENOMENOLOGIES):
        for config in faulty(specimen, 100 * (turn + 1), key, [scale], onset_s=0.0):
            yield flown(config, size.lent_faulty_s)


def _learn(
    tallies: Sequence[Tally], learners: Sequence[Learner], specimen: Airframe, number: int, size: Size, seed: int
) -> list[Watch]:
    flights = [
        flown(config, size.learn_s) for config in healthy(specimen, size.learn_flights, (seed, TRAINING, number))
    ]
    return [
        _timed(tally, partial(calibrated, tally.contender, learner, flights))
        for tally, learner in zip(tallies, learners, strict=True)
    ]


def _judge(
    tallies: Sequence[Tally], watches: Sequence[Watch], specimen: Airframe, number: int, size: Size, seed: int
) -> None:
    for config in healthy(specimen, size.judge_flights, (seed, FALSE_ALARMS, number)):
        one = flown(config, size.judge_s)
        for tally, watch in zip(tallies, watches, strict=True):
            _count(tally, watch, one)
    for config in faulty(specimen, number, (seed, DETECTION, number), PHENOMENOLOGIES, ONSET_S):
        one = flown(config, FAULTY_S)
        for tally, watch in zip(tallies, watches, strict=True):
            _count(tally, watch, one)


def _count(tally: Tally, watch: Watch, one: Flown) -> None:
    """Judge a flight and book what came of it."""
    started = time.process_time()
    scored = watch.scorer(one)
    tally.spent_s += time.process_time() - started
    if tally.contender.rule is not None:  # else it makes its rows from the telemetry itself
        tally.spent_s += one.front_s
    tally.rows += len(one)
    found = alarms(scored, watch.threshold)
    if one.truth is None:
        tally.false_alarms += len(found)
        tally.healthy_s += float(scored.t_s[-1] - scored.t_s[0])
        return
    alarm = caught(found, one.truth)
    if alarm is None:
        tally.catches.append(Catch(one.truth, None, 0))
    else:
        tally.catches.append(Catch(one.truth, alarm.start_s - one.truth.onset_s, alarm.rotor))
