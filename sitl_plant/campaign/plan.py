"""What a Monte Carlo campaign flies: causes, conditions and a design with levels for every factor become tasks.

Every factor runs through its levels in blocks, each in a random order of its own: each level occurs equally often
(rotor and phenomenology with every cause), and a longer campaign begins with the flights of a shorter one. Sizes of
causes besides the nine faults, and of conditions, are estimates unless a source is named. A baseline is learnt with the
conditions of the airframe's build (filters, mount, link) and without those of the flight.
"""

import hashlib
import json
import math
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import partial
from itertools import product
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
import pydantic
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError

from mavdiag.errors import UsageError
from mavdiag.monitors.base import FaultKind
from mavdiag.units import S_PER_H
from sitl_plant.autopilot.telemetry import LinkSpec
from sitl_plant.physics.faults import FAULTS, Injection, RotorDamage, SensorFault
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.sensors import isolating_hz
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import SoftMount, Vehicle, qdrone2

Level = TypeVar("Level")

HEALTHY = "healthy"
CALM = "calm"
EVERY = "all"  # every condition, every manoeuvre
FLIGHTS_A_DAY = 4  # flights of one session, where a condition has other sessions (our choice)
MOUNT_DAMPING = 0.1  # of isolators (estimate)


class Group(StrEnum):
    """Kinds of causes, by the answer that is right."""

    FAULT = "fault"  # one of T's nine: a propeller fault
    BLADE = "blade"  # other damage to a propeller: a propeller fault
    MOTOR = "motor"  # a motor at another speed than commanded: the diagnosis does not tell it from its propeller
    LOSS = "loss"  # a propeller gone: a gross loss of thrust
    SENSOR = "sensor"  # a gyro or accelerometer: another fault, or nothing; never a propeller fault

    @property
    def right(self) -> FaultKind:
        """The kind of fault that is the right answer."""
        return {Group.LOSS: FaultKind.GROSS_LOSS, Group.SENSOR: FaultKind.SENSOR}.get(self, FaultKind.PROPELLER)


class Cause(NamedTuple):
    """What goes wrong; a sensor fault acts on a random axis, with a random sign of offset and drift."""

    group: Group
    what: RotorDamage | SensorFault


CAUSES: Mapping[str, Cause] = {
    **{code: Cause(Group.FAULT, damage) for code, damage in FAULTS.items()},
    "chipping": Cause(Group.BLADE, RotorDamage(1.0 - 0.03, 1.03, unbalance_g_mm=0.05 * 60.0)),
    "bending": Cause(Group.BLADE, RotorDamage(1.0 - 0.04, 1.05)),
    "added-mass": Cause(Group.BLADE, RotorDamage(unbalance_g_mm=0.05 * 50.0)),
    "texture": Cause(Group.BLADE, RotorDamage(0.97, 1.06)),
    "motor-speed": Cause(Group.MOTOR, RotorDamage(speed_factor=0.97)),
    "ejection": Cause(Group.LOSS, RotorDamage(0.0, 0.0, ejected=True)),
    "gyro-bias": Cause(Group.SENSOR, SensorFault("gyro", 0, offset=0.05)),
    "gyro-drift": Cause(Group.SENSOR, SensorFault("gyro", 0, drift_per_s=0.002)),
    "gyro-scale": Cause(Group.SENSOR, SensorFault("gyro", 0, scale=1.1)),
    "gyro-noise": Cause(Group.SENSOR, SensorFault("gyro", 0, noise_rms=0.1)),
    "accel-bias": Cause(Group.SENSOR, SensorFault("accel", 0, offset=0.5)),
    "accel-drift": Cause(Group.SENSOR, SensorFault("accel", 0, drift_per_s=0.02)),
    "accel-scale": Cause(Group.SENSOR, SensorFault("accel", 0, scale=1.1)),
    "accel-noise": Cause(Group.SENSOR, SensorFault("accel", 0, noise_rms=1.0)),
}
"""Causes by name (T 1.2, Tables 3.1-3.3). Units: g mm; gyro in rad/s, accelerometer in m/s^2, drifts per second."""


def causes_named(names: Iterable[str]) -> tuple[str, ...]:
    """The causes of some names or groups, each once. Raises UsageError for an unknown one."""
    meaning = {str(group): [name for name, cause in CAUSES.items() if cause.group is group] for group in Group}
    return _known("cause", meaning | {name: [name] for name in CAUSES}, names)


def _known(factor: str, meaning: Mapping[str, Iterable[str]], names: Iterable[str]) -> tuple[str, ...]:
    """What the names mean, each once. Raises UsageError for a name that is not known."""
    if unknown := set(names) - meaning.keys():
        raise UsageError(f"no {factor} {min(unknown)!r}: give one of {', '.join(meaning)}")
    return tuple(dict.fromkeys(chosen for name in names for chosen in meaning[name]))


def injections_of(
    name: str, rotor: int, onset_s: float, phenomenology: float, rng: np.random.Generator
) -> tuple[Injection, ...]:
    """What the plant is to inject from `onset_s` on; nothing for a healthy flight."""
    if name == HEALTHY:
        return ()
    cause = CAUSES[name].what
    if isinstance(cause, RotorDamage):
        cause = cause.fitted(phenomenology)
    else:
        axis, sign = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
        cause = replace(cause, axis=axis, offset=sign * cause.offset, drift_per_s=sign * cause.drift_per_s)
    return (Injection(cause, rotor, onset_s),)


#: Named paths, as a `PlantConfig` says them.
MANOEUVRES: Mapping[str, Mapping[str, Any]] = {
    "square": {"trajectory": "square"},  # T 5.2
    "square-fast": {"trajectory": "square", "speed_m_s": 0.8},
    "square-turned": {"trajectory": "square", "heading_rad": math.pi / 4},
    "hover": {"trajectory": "hover"},
    "circle": {"trajectory": "circle"},
    "figure8": {"trajectory": "figure8"},
    "square-nose": {"trajectory": "square", "nose": "path"},
    "circle-nose": {"trajectory": "circle", "nose": "path"},
    "figure8-nose": {"trajectory": "figure8", "nose": "path"},
    "hover-spin": {"trajectory": "hover", "nose": "spin"},
    "square-spin": {"trajectory": "square", "nose": "spin"},
    "square-takeoff": {"trajectory": "square", "start": "ground"},
}
USUAL = tuple(name for name, path in MANOEUVRES.items() if not path.keys() & {"nose", "start"})


@dataclass(frozen=True, slots=True)
class Condition:
    """One named condition. What is None or empty is left to the other factors of the design."""

    manoeuvres: tuple[str, ...] = ()  # flown in turn
    duration_s: float | None = None  # of each flight
    wind_m_s: float | None = None
    payload_g: float | None = None
    turbulence_m_s: float = 0.0  # wind W20 of Dryden turbulence
    pickup_g: float = 0.0  # taken up early in the flight; half of the flights drop it
    pickup_offset_mm: float = 0.0  # so far beside the centre
    outages_per_min: float = 0.0  # of motion capture
    session: bool = False  # the flight is on another day, with what changes from day to day
    propellers: float = 0.0  # share by which each thrust coefficient of a new set may differ; another day as well
    wear_per_h: float = 0.0  # the largest share that a rotor loses per hour; up to `WEAR_H` hours have passed
    filter_hz: float | None = None  # on-chip corner of the IMU
    resonance_hz: tuple[float, float] | None = None  # of the frame below the IMU, with its damping ratio
    isolation: float | None = None  # share of the rotors' line in hover that a soft mount of the IMU passes
    rate_hz: float | None = None  # of the link


CONDITIONS: Mapping[str, Condition] = {
    CALM: Condition(),
    "turbulence-5": Condition(turbulence_m_s=5.0),
    "turbulence-8": Condition(turbulence_m_s=8.0),
    "wind-2": Condition(wind_m_s=2.0),
    "wind-5": Condition(wind_m_s=5.0),
    "battery-10min": Condition(duration_s=600.0),
    "payload-200": Condition(payload_g=200.0),
    "pick-up": Condition(pickup_g=200.0, pickup_offset_mm=20.0),
    "propellers-1": Condition(propellers=0.01),
    "propellers-3": Condition(propellers=0.03),
    "wear": Condition(wear_per_h=0.002),
    "yaw-turns": Condition(manoeuvres=("square-nose", "hover-spin", "circle-nose", "square-spin", "figure8-nose")),
    "mocap-loss": Condition(outages_per_min=2.0),
    "take-off": Condition(manoeuvres=("square-takeoff",)),
    "sessions": Condition(session=True),
    "resonance": Condition(resonance_hz=(165.0, 0.05)),  # on the rotors' line in hover, 167 Hz
    "isolation-10": Condition(isolation=1 / 10),
    "isolation-30": Condition(isolation=1 / 30),
    **{f"imu-{hz:g}hz": Condition(filter_hz=hz) for hz in (20.0, 42.0, 98.0, 188.0)},
    **{f"link-{hz:g}hz": Condition(rate_hz=hz) for hz in (100.0, 200.0, 400.0)},
}
"""Conditions by name."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a flight flies, and in what. payload_g hangs 5 cm below the centre, up to 1 cm beside it."""

    manoeuvre: str = "square"
    wind_m_s: float = 0.0
    payload_g: float = 0.0
    condition: str = CALM  # a name of `CONDITIONS`


def built(vehicle: Vehicle, condition: str) -> Vehicle:
    """The vehicle as a condition has it built: filter and mount of its IMU."""
    row, imu = CONDITIONS[condition], vehicle.imu
    if row.filter_hz is not None:
        imu = replace(imu, filter_hz=row.filter_hz)
    if row.resonance_hz is not None:
        imu = replace(imu, mount=SoftMount(*row.resonance_hz))
    if row.isolation is not None:
        line_hz = vehicle.hover_rad_s / (2.0 * math.pi)
        imu = replace(imu, mount=SoftMount(isolating_hz(line_hz, row.isolation, MOUNT_DAMPING, STEP_S), MOUNT_DAMPING))
    return vehicle if imu == vehicle.imu else replace(vehicle, imu=imu)


def parse_link(text: str) -> LinkSpec:
    """A link such as "qdrone2@1000": profile and rate [Hz]. Raises UsageError for what cannot be.

    >>> parse_link("ardupilot@100")
    LinkSpec(profile='ardupilot', rate_hz=100.0, loss=0.0)
    """
    profile, _, rate = text.partition("@")
    try:
        return LinkSpec(profile, float(rate) if rate else None)
    except ValueError:
        raise UsageError(f"link must be like qdrone2@1000, not {text!r}") from None


@dataclass(frozen=True, slots=True)
class LearnTask:
    """Learn a baseline for one airframe over one link from healthy flights, one for each of `flights`."""

    vehicle: Vehicle = field(repr=False)
    airframe: int
    link: str
    flights: tuple[Conditions, ...]
    duration_s: float


@dataclass(frozen=True, slots=True)
class FlightTask:
    """Fly once and judge."""

    index: int
    learnt: LearnTask = field(repr=False)
    cause: str  # a name of `CAUSES`, or "healthy"
    rotor: int  # where the cause is, if it has a place
    phenomenology: float
    conditions: Conditions
    loss: float
    duration_s: float
    session: int = 0  # 0 is that of the healthy flights learnt from, each other a day later


def _one_or_every(factor: str, table: Iterable[str]) -> AfterValidator:
    return AfterValidator(partial(_known, factor, {**{name: [name] for name in table}, EVERY: list(table)}))


_Count: TypeAlias = Annotated[int, Field(ge=1)]


@pydantic.dataclasses.dataclass(frozen=True, slots=True)
class Design:
    """Levels of every factor, and how much to fly. Raises UsageError or ValidationError for what cannot be."""

    seed: Annotated[int, Field(ge=0)] = 0
    airframes: _Count = 4  # how many specimens; every second one is aged
    learn: Literal["mixed", "square"] = "mixed"  # every other flight from the levels below, or T's square in calm air
    learn_flights: _Count = 8  # healthy flights for each baseline
    flights: Annotated[int, Field(ge=0)] = 138  # with a cause
    hours: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.5  # of healthy flight, besides
    duration_s: Annotated[float, Field(ge=10, le=600)] = 40.0
    cause: Annotated[tuple[str, ...], BeforeValidator(causes_named)] = tuple(CAUSES)
    rotor: tuple[_Count, ...] | None = None  # None for every rotor of the vehicle
    phenomenology: tuple[Annotated[float, Field(ge=0, le=1)], ...] = (0.0, 0.5, 1.0)
    manoeuvre: Annotated[tuple[str, ...], _one_or_every("manoeuvre", MANOEUVRES)] = USUAL
    wind: tuple[Annotated[float, Field(ge=0, le=10)], ...] = (0.0, 1.0)
    payload: tuple[Annotated[float, Field(ge=0, le=1000)], ...] = (0.0, 100.0)
    link: tuple[str, ...] = ("qdrone2@1000",)
    loss: tuple[Annotated[float, Field(ge=0, le=0.9)], ...] = (0.0,)
    # each with its share of flights and hours
    condition: Annotated[tuple[str, ...], _one_or_every("condition", CONDITIONS)] = (CALM,)
    vehicle: Vehicle = field(default_factory=qdrone2, repr=False)

    def __post_init__(self) -> None:
        if max(self.rotors) > len(self.vehicle.rotors):
            raise UsageError(f"rotor must be 1 to {len(self.vehicle.rotors)}, not {max(self.rotors)}")
        for name in self.condition + (CALM,) * (self.learn == "mixed"):
            row = CONDITIONS[name]
            for link in self.link:
                LinkSpec(parse_link(link).profile, row.rate_hz)
            for path in row.manoeuvres or self.manoeuvre:
                flown = {**MANOEUVRES[path], "landed_s": row.duration_s or self.duration_s}
                PlantConfig(vehicle=self.vehicle, outages_per_min=row.outages_per_min, **flown)

    @property
    def rotors(self) -> tuple[int, ...]:
        """Those to damage."""
        return self.rotor or tuple(range(1, len(self.vehicle.rotors) + 1))


FACTORS = ("cause", "rotor", "manoeuvre", "condition", "link", "phenomenology", "wind", "payload", "loss")
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
        cause=causes_named([Group.FAULT]),
        manoeuvre=("square",),
        wind=(0.0,),
        payload=(0.0,),
        condition=tuple(CONDITIONS),
    ),
}


def with_conditions(design: Design, filters: Sequence[str], **changed: Any) -> Design:
    """The design with other sizes, and other levels of some factors, each given as "factor=level,level".

    Raises UsageError for an unknown factor or level, or a size that cannot be.
    """
    for text in filters:
        factor, _, levels = (part.strip() for part in text.partition("="))
        if factor not in FACTORS:
            raise UsageError(f"no factor {factor!r}: give {', '.join(FACTORS)}")
        changed[factor] = tuple(level.strip() for level in levels.split(",") if level.strip())
        if not changed[factor]:
            raise UsageError(f"--conditions {text}: give it as FACTOR=LEVEL,LEVEL")
    try:
        return replace(design, **changed)
    except ValidationError as error:
        first = error.errors()[0]
        raise UsageError(f"{first['loc'][0]}: {first['msg']}, not {first['input']}") from error


def make_plan(design: Design) -> list[FlightTask]:
    """All flights of a design, each with what is to be learnt before. The same design makes the same plan."""
    names, flights = design.condition, list[FlightTask]()
    for number, name in enumerate(names):
        share, left = divmod(design.flights, len(names))
        flights += _flights(design, "cause", share + (number < left), name)
    for name in names:
        duration_s = CONDITIONS[name].duration_s or design.duration_s
        flights += _flights(design, HEALTHY, math.ceil(design.hours / len(names) * S_PER_H / duration_s), name)
    return flights


def _flights(design: Design, kind: str, count: int, name: str) -> list[FlightTask]:
    condition, part = CONDITIONS[name], kind if name == CALM else f"{kind} {name}"

    def column(name: str, levels: Sequence[Level]) -> list[Level]:
        return balanced(levels, count, design.seed, f"{part} {name}")

    def within_causes(name: str, levels: Sequence[Level]) -> list[Level]:
        own = {cause: iter(balanced(levels, n, design.seed, f"{part} {name} {cause}")) for cause, n in met.items()}
        return [next(own[cause]) for cause in causes]

    vehicle, days = built(design.vehicle, name), Counter[int]()
    another_day = condition.session or condition.propellers > 0.0 or condition.wear_per_h > 0.0
    learning = {}
    for link, airframe in product(design.link, range(design.airframes)):
        rated = link if condition.rate_hz is None else f"{parse_link(link).profile}@{condition.rate_hz:g}"
        learning[airframe, link] = _learning(design, airframe, rated, vehicle)
    causes = [HEALTHY] * count if kind == HEALTHY else column("cause", design.cause)
    met = Counter(causes)
    rotors, scales = within_causes("rotor", design.rotors), within_causes("phenomenology", design.phenomenology)
    manoeuvres = column("manoeuvre", condition.manoeuvres or design.manoeuvre)
    winds, payloads, losses = (column(axis, getattr(design, axis)) for axis in ("wind", "payload", "loss"))
    airframes, links = column("airframe", range(design.airframes)), column("link", design.link)
    flights = []
    for index, (cause, airframe) in enumerate(zip(causes, airframes, strict=True)):
        wind = winds[index] if condition.wind_m_s is None else condition.wind_m_s
        payload = payloads[index] if condition.payload_g is None else condition.payload_g
        fitted = cause in CAUSES and CAUSES[cause].group is Group.FAULT
        flights.append(
            FlightTask(
                index=index,
                learnt=learning[airframe, links[index]],
                cause=cause,
                rotor=rotors[index],
                phenomenology=scales[index] if fitted else 1.0,
                conditions=Conditions(manoeuvres[index], wind, payload, name),
                loss=losses[index],
                duration_s=condition.duration_s or design.duration_s,
                session=1 + days[airframe] // FLIGHTS_A_DAY if another_day else 0,
            )
        )
        days[airframe] += 1
    return flights


def _learning(design: Design, airframe: int, link: str, vehicle: Vehicle) -> LearnTask:
    """Half of the flights, and the first, are T's square in calm air: it excites the model."""
    count, axes = design.learn_flights, ("manoeuvre", "wind", "payload")
    drawn = [balanced(getattr(design, axis), count, design.seed, f"learn {airframe} {axis}") for axis in axes]
    mixed = [Conditions(*levels) for levels in zip(*drawn, strict=True)]
    flights = tuple(mixed[i] if design.learn == "mixed" and i % 2 else Conditions() for i in range(count))
    return LearnTask(vehicle, airframe, link, flights, design.duration_s)


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


def task_sequence(seed: int, task: LearnTask | FlightTask) -> np.random.SeedSequence:
    """The random stream of a task, from the campaign's seed and what is flown alone.

    The link, the loss, the scale of the fitted terms and, for a flight, how was learnt are left out: campaigns that
    differ in these only fly the same flights.
    """

    def flown(conditions: Conditions) -> dict[str, Any]:
        return {name: level for name, level in asdict(conditions).items() if (name, level) != ("condition", CALM)}

    if isinstance(task, LearnTask):
        content = ["learn", task.airframe, [flown(conditions) for conditions in task.flights], task.duration_s]
    else:
        place = [task.index, task.learnt.airframe, task.cause, task.rotor]
        content = ["flight", *place, flown(task.conditions), task.duration_s]
    words = np.frombuffer(hashlib.sha256(json.dumps(content, sort_keys=True).encode()).digest(), dtype="<u4")
    return np.random.SeedSequence([seed, *words.tolist()])
