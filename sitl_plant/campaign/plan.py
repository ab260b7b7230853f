"""What a Monte Carlo campaign flies: a design with levels for every factor becomes a list of tasks.

Every factor runs through its levels in blocks, each block in a random order of its own: so each level occurs equally
often (rotor and phenomenology with every cause), factors are paired at random, and a longer campaign begins with the
flights of a shorter one.
"""

import hashlib
import json
import math
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.units import S_PER_H
from sitl_plant.campaign.causes import CAUSES, HEALTHY, Group
from sitl_plant.campaign.conditions import CALM, CONDITIONS, USUAL, Conditions, built, built_link
from sitl_plant.vehicle import Vehicle, qdrone2

__all__ = [
    "PRESETS",
    "Design",
    "FlightTask",
    "LearnTask",
    "Plan",
    "balanced",
    "make_plan",
    "task_sequence",
]

Level = TypeVar("Level")

FLIGHTS_A_DAY = 4  # flights of one session, where a condition has other sessions (our choice)


@dataclass(frozen=True, slots=True)
class LearnTask:
    """Learn a baseline for one airframe over one link from healthy flights, one for each of `flights`."""

    vehicle: Vehicle = field(repr=False)
    airframe: int
    aged: bool
    link: str
    flights: tuple[Conditions, ...]
    duration_s: float


@dataclass(frozen=True, slots=True)
class FlightTask:
    """Fly once and judge.

    cause: a name of `causes.CAUSES`, or "healthy".
    rotor: where the cause is, if it has a place.
    session: 0 is that of the healthy flights learnt from, each other a day later.
    """

    index: int
    learnt: LearnTask = field(repr=False)
    cause: str
    rotor: int
    phenomenology: float
    conditions: Conditions
    loss: float
    duration_s: float
    session: int = 0


@dataclass(frozen=True, slots=True)
class Design:
    """Levels of every factor, and how much to fly.

    airframes: how many specimens; every second one is aged.
    learn: "square" learns from T's square in calm air alone, "mixed" draws every other flight from the levels below.
    learn_flights: healthy flights for each baseline.
    flights: with a cause.
    hours: of healthy flight, besides.
    vehicle: the type of all specimens.
    rotor: levels; None for every rotor of the vehicle.
    condition: names of `CONDITIONS`, each with its share of flights and hours.
    """

    seed: int = 0
    airframes: int = 4
    learn: Literal["mixed", "square"] = "mixed"
    learn_flights: int = 8
    flights: int = 138
    hours: float = 0.5
    duration_s: float = 40.0
    cause: tuple[str, ...] = tuple(CAUSES)
    rotor: tuple[int, ...] | None = None
    phenomenology: tuple[float, ...] = (0.0, 0.5, 1.0)
    manoeuvre: tuple[str, ...] = USUAL
    wind: tuple[float, ...] = (0.0, 1.0)
    payload: tuple[float, ...] = (0.0, 100.0)
    link: tuple[str, ...] = ("qdrone2@1000",)
    loss: tuple[float, ...] = (0.0,)
    condition: tuple[str, ...] = (CALM,)
    vehicle: Vehicle = field(default_factory=qdrone2, repr=False)

    def __post_init__(self) -> None:
        for name in ("airframes", "learn_flights"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name.replace('_', '-')} must be 1 or more, not {getattr(self, name)}")
        if self.seed < 0 or self.flights < 0 or not (math.isfinite(self.hours) and self.hours >= 0.0):
            raise UsageError("seed, flights and hours must be zero or more")
        if not 10.0 <= self.duration_s <= 600.0:
            raise UsageError(f"a flight must last 10 to 600 s, not {self.duration_s:g}")


PRESETS: Mapping[str, Design] = {
    "quick": Design(),
    "full": Design(
        airframes=12,
        learn_flights=16,
        flights=2760,
        hours=10.0,
        wind=(0.0, 1.0, 2.0),
        payload=(0.0, 50.0, 100.0),
        link=("qdrone2@1000", "qdrone2@1000", "qdrone2@200", "px4@160", "ardupilot@100"),
        loss=(0.0, 0.0, 0.05, 0.2),
    ),
    # Each condition alone, against a baseline of five flights of T's square.
    "conditions": Design(
        learn="square",
        learn_flights=5,
        flights=27 * len(CONDITIONS),
        hours=2.0 * len(CONDITIONS),
        cause=tuple(name for name, cause in CAUSES.items() if cause.group is Group.FAULT),
        manoeuvre=("square",),
        wind=(0.0,),
        payload=(0.0,),
        condition=tuple(CONDITIONS),
    ),
}


@dataclass(frozen=True, slots=True)
class Plan:
    """The tasks of a campaign: what to learn first, and what to fly then."""

    design: Design
    learning: tuple[LearnTask, ...]
    flights: tuple[FlightTask, ...]


def make_plan(design: Design) -> Plan:
    """All tasks of a design. The same design makes the same plan."""
    names = design.condition
    flights: list[FlightTask] = []
    for number, name in enumerate(names):
        share, left = divmod(design.flights, len(names))
        flights += _flights(design, "cause", share + (number < left), name)
    for name in names:
        duration_s = CONDITIONS[name].duration_s or design.duration_s
        flights += _flights(design, "healthy", math.ceil(design.hours / len(names) * S_PER_H / duration_s), name)
    learning = tuple(dict.fromkeys(flight.learnt for flight in flights))
    return Plan(design, learning, tuple(flights))


def _flights(design: Design, kind: str, count: int, name: str) -> list[FlightTask]:
    """`count` flights in the named condition; kind: "cause" or "healthy"."""
    condition, part = CONDITIONS[name], kind if name == CALM else f"{kind} {name}"

    def column(name: str, levels: Sequence[Level]) -> list[Level]:
        return balanced(levels, count, design.seed, f"{part} {name}")

    learning = {
        (airframe, link): _learning(design, airframe, built_link(link, name), built(design.vehicle, name))
        for airframe in range(design.airframes)
        for link in dict.fromkeys(design.link)
    }
    rotors = design.rotor or tuple(range(1, len(design.vehicle.rotors) + 1))
    causes = [HEALTHY] * count if kind == "healthy" else column("cause", design.cause)
    columns = zip(
        causes,
        _within(causes, rotors, design.seed, f"{part} rotor"),
        _within(causes, design.phenomenology, design.seed, f"{part} phenomenology"),
        column("manoeuvre", condition.manoeuvres or design.manoeuvre),
        column("wind", design.wind),
        column("payload", design.payload),
        column("link", design.link),
        column("loss", design.loss),
        airframes := column("airframe", range(design.airframes)),
        _sessions(airframes) if condition.another_day else [0] * count,
        strict=True,
    )
    return [
        FlightTask(
            index=index,
            learnt=learning[airframe, link],
            cause=cause,
            rotor=rotor,
            phenomenology=phenomenology if cause in CAUSES and CAUSES[cause].fitted else 1.0,
            conditions=Conditions(manoeuvre, wind, payload, name).applied(),
            loss=loss,
            duration_s=condition.duration_s or design.duration_s,
            session=session,
        )
        for index, (cause, rotor, phenomenology, manoeuvre, wind, payload, link, loss, airframe, session) in enumerate(
            columns
        )
    ]


def _sessions(airframes: Sequence[int]) -> list[int]:
    """Sessions 1, 2, ... of each airframe, of `FLIGHTS_A_DAY` flights each."""
    flown: Counter[int] = Counter()
    sessions = []
    for airframe in airframes:
        sessions.append(1 + flown[airframe] // FLIGHTS_A_DAY)
        flown[airframe] += 1
    return sessions


def _learning(design: Design, airframe: int, link: str, vehicle: Vehicle) -> LearnTask:
    """Half of the flights, and the first, are T's square in calm air: it excites the model."""
    count = design.learn_flights
    mixed = zip(
        *(
            balanced(levels, count, design.seed, f"learn {airframe} {name}")
            for name, levels in (
                ("manoeuvre", design.manoeuvre),
                ("wind", design.wind),
                ("payload", design.payload),
            )
        ),
        strict=True,
    )
    drawn = [Conditions(str(manoeuvre), float(wind), float(payload)) for manoeuvre, wind, payload in mixed]
    flights = tuple(drawn[i] if design.learn == "mixed" and i % 2 else Conditions() for i in range(count))
    return LearnTask(vehicle, airframe, airframe % 2 == 1, link, flights, design.duration_s)


def balanced(levels: Sequence[Level], count: int, seed: int, factor: str) -> list[Level]:
    """`count` levels in blocks of all of them, each block shuffled by a stream of its own.

    >>> sorted(balanced("ab", 6, seed=1, factor="letter"))
    ['a', 'a', 'a', 'b', 'b', 'b']
    """
    chosen: list[Level] = []
    word = zlib.crc32(factor.encode())
    for block in range(-(-count // len(levels))):
        order = np.random.default_rng([seed, word, block]).permutation(len(levels))
        chosen += [levels[i] for i in order]
    return chosen[:count]


def _within(causes: Sequence[str], levels: Sequence[Level], seed: int, factor: str) -> list[Level]:
    """Levels balanced among the flights of each cause."""
    own = {cause: iter(balanced(levels, count, seed, f"{factor} {cause}")) for cause, count in Counter(causes).items()}
    return [next(own[cause]) for cause in causes]


def task_sequence(seed: int, task: LearnTask | FlightTask) -> np.random.SeedSequence:
    """The random stream of a task, from the campaign's seed and what is flown alone.

    The link, the loss, the scale of the fitted terms and, for a flight, how was learnt are left out: campaigns that
    differ in these only fly the same flights.
    """
    match task:
        case LearnTask():
            flown = ["learn", task.airframe, [_flown(one) for one in task.flights], task.duration_s]
        case FlightTask():
            place = [task.index, task.learnt.airframe, task.cause, task.rotor]
            flown = ["flight", *place, _flown(task.conditions), task.duration_s]
    words = np.frombuffer(hashlib.sha256(json.dumps(flown, sort_keys=True).encode()).digest(), dtype="<u4")
    return np.random.SeedSequence([seed, *words.tolist()])


def _flown(conditions: Conditions) -> dict[str, Any]:
    """What the stream follows from. Calm flights keep the streams that they had before there were conditions."""
    row = asdict(conditions)
    if conditions.condition == CALM:
        del row["condition"]
    return row
