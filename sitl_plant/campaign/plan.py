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
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, TypeVar

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.units import S_PER_H
from sitl_plant.autopilot.telemetry import LinkSpec
from sitl_plant.campaign.causes import CAUSES, HEALTHY, causes_named
from sitl_plant.vehicle import Vehicle, qdrone2

__all__ = [
    "MANOEUVRES",
    "PRESETS",
    "USUAL",
    "Conditions",
    "Design",
    "FlightTask",
    "LearnTask",
    "Manoeuvre",
    "Plan",
    "balanced",
    "make_plan",
    "parse_link",
    "task_sequence",
    "with_conditions",
]

Level = TypeVar("Level")

# Factors whose levels are numbers, and their ranges.
RANGES = {"phenomenology": (0.0, 1.0), "wind": (0.0, 10.0), "payload": (0.0, 1000.0), "loss": (0.0, 0.9)}


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A named path.

    speed_m_s: along it.
    heading_rad: how far it is turned.
    nose: where the nose points, see `sitl_plant.physics.trajectory.Nose`.
    takeoff: it begins and ends on the ground.
    """

    shape: str
    speed_m_s: float = 0.5
    heading_rad: float = 0.0
    nose: str = "fixed"
    takeoff: bool = False


MANOEUVRES: Mapping[str, Manoeuvre] = {
    "square": Manoeuvre("square"),  # T 5.2
    "square-fast": Manoeuvre("square", speed_m_s=0.8),
    "square-turned": Manoeuvre("square", heading_rad=math.pi / 4),
    "hover": Manoeuvre("hover"),
    "circle": Manoeuvre("circle"),
    "figure8": Manoeuvre("figure8"),
    "square-nose": Manoeuvre("square", nose="path"),
    "circle-nose": Manoeuvre("circle", nose="path"),
    "figure8-nose": Manoeuvre("figure8", nose="path"),
    "hover-spin": Manoeuvre("hover", nose="spin"),
    "square-spin": Manoeuvre("square", nose="spin"),
    "square-takeoff": Manoeuvre("square", takeoff=True),
}
USUAL = tuple(name for name, one in MANOEUVRES.items() if one.nose == "fixed" and not one.takeoff)


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a flight flies, and in what. payload_g hangs 5 cm below the centre, up to 1 cm beside it."""

    manoeuvre: str = "square"
    wind_m_s: float = 0.0
    payload_g: float = 0.0


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
    """

    index: int
    learnt: LearnTask = field(repr=False)
    cause: str
    rotor: int
    phenomenology: float
    conditions: Conditions
    loss: float
    duration_s: float


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
}


@dataclass(frozen=True, slots=True)
class Plan:
    """The tasks of a campaign: what to learn first, and what to fly then."""

    design: Design
    learning: tuple[LearnTask, ...]
    flights: tuple[FlightTask, ...]


def make_plan(design: Design) -> Plan:
    """All tasks of a design. The same design makes the same plan."""
    healthy = math.ceil(design.hours * S_PER_H / design.duration_s)
    flights = (*_flights(design, "cause", design.flights), *_flights(design, "healthy", healthy))
    learning = tuple(dict.fromkeys(flight.learnt for flight in flights))
    return Plan(design, learning, flights)


def _flights(design: Design, part: str, count: int) -> list[FlightTask]:
    def column(name: str, levels: Sequence[Level]) -> list[Level]:
        return balanced(levels, count, design.seed, f"{part} {name}")

    learning = {
        (airframe, link): _learning(design, airframe, link)
        for airframe in range(design.airframes)
        for link in dict.fromkeys(design.link)
    }
    rotors = design.rotor or tuple(range(1, len(design.vehicle.rotors) + 1))
    causes = [HEALTHY] * count if part == "healthy" else column("cause", design.cause)
    columns = zip(
        causes,
        _within(causes, rotors, design.seed, f"{part} rotor"),
        _within(causes, design.phenomenology, design.seed, f"{part} phenomenology"),
        column("manoeuvre", design.manoeuvre),
        column("wind", design.wind),
        column("payload", design.payload),
        column("link", design.link),
        column("loss", design.loss),
        column("airframe", range(design.airframes)),
        strict=True,
    )
    return [
        FlightTask(
            index=index,
            learnt=learning[airframe, link],
            cause=cause,
            rotor=rotor,
            phenomenology=phenomenology if cause in CAUSES and CAUSES[cause].fitted else 1.0,
            conditions=Conditions(manoeuvre, wind, payload),
            loss=loss,
            duration_s=design.duration_s,
        )
        for index, (cause, rotor, phenomenology, manoeuvre, wind, payload, link, loss, airframe) in enumerate(columns)
    ]


def _learning(design: Design, airframe: int, link: str) -> LearnTask:
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
    return LearnTask(design.vehicle, airframe, airframe % 2 == 1, link, flights, design.duration_s)


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
            flown = ["learn", task.airframe, [asdict(one) for one in task.flights], task.duration_s]
        case FlightTask():
            place = [task.index, task.learnt.airframe, task.cause, task.rotor]
            flown = ["flight", *place, asdict(task.conditions), task.duration_s]
    words = np.frombuffer(hashlib.sha256(json.dumps(flown, sort_keys=True).encode()).digest(), dtype="<u4")
    return np.random.SeedSequence([seed, *words.tolist()])


def parse_link(text: str) -> LinkSpec:
    """A link such as "qdrone2@1000": profile and rate [Hz]. Raises UsageError for what cannot be.

    >>> parse_link("ardupilot@100")
    LinkSpec(profile='ardupilot', rate_hz=100.0, loss=0.0)
    """
    profile, _, rate = text.partition("@")
    return LinkSpec(profile, _number("link", rate) if rate else None)


def with_conditions(design: Design, filters: Sequence[str]) -> Design:
    """The design with the levels of some factors replaced, each given as "factor=level,level".

    Raises UsageError for an unknown factor or level.
    """
    changed: dict[str, Any] = {}
    for text in filters:
        factor, _, levels = (part.strip() for part in text.partition("="))
        wanted = tuple(level.strip() for level in levels.split(",") if level.strip())
        if not wanted:
            raise UsageError(f"--conditions {text}: give it as FACTOR=LEVEL,LEVEL")
        match factor:
            case "cause":
                changed[factor] = causes_named(wanted)
            case "manoeuvre":
                if unknown := set(wanted) - MANOEUVRES.keys():
                    raise UsageError(f"no manoeuvre {min(unknown)!r}: give one of {', '.join(MANOEUVRES)}")
                changed[factor] = wanted
            case "link":
                changed[factor] = wanted
                for one in wanted:
                    parse_link(one)
            case "rotor":
                changed[factor] = _rotors(wanted, len(design.vehicle.rotors))
            case number if number in RANGES:
                changed[factor] = _numbers(factor, wanted, *RANGES[number])
            case other:
                raise UsageError(f"no factor {other!r}: give cause, rotor, manoeuvre, link, {', '.join(RANGES)}")
    return replace(design, **changed)


def _rotors(texts: Sequence[str], rotors: int) -> tuple[int, ...]:
    if not set(texts) <= {str(rotor) for rotor in range(1, rotors + 1)}:
        raise UsageError(f"rotor must be 1 to {rotors}, not {', '.join(texts)}")
    return tuple(int(text) for text in texts)


def _numbers(factor: str, texts: Sequence[str], low: float, high: float) -> tuple[float, ...]:
    values = tuple(_number(factor, text) for text in texts)
    if not all(low <= value <= high for value in values):
        raise UsageError(f"{factor} must be {low:g} to {high:g}, not {', '.join(texts)}")
    return values


def _number(factor: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{factor} must be a number, not {text!r}") from None
