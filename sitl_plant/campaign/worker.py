"""Run a campaign: its tasks on workers as those of an archive, with results kept as they come (edge).

A task learns a baseline, or flies once and judges. Everything follows from the campaign's seed and the task. A result
is a line of JSON under a key, the digest of all that it follows from, the sources of both packages among it. What is in
the file already is not flown again; lines of other campaigns, or of another version, are not counted.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from mavdiag.archive.pool import died, run_all
from mavdiag.archive.scan import digest_of_sources
from mavdiag.as_json import event_json
from mavdiag.baseline import dump, parse
from mavdiag.commands.progress import shown
from mavdiag.decision.alarm import Event, Stage
from mavdiag.errors import MavdiagError, UsageError
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.storage import begins
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.campaign.plan import (
    CONDITIONS,
    HEALTHY,
    MANOEUVRES,
    Conditions,
    Design,
    FlightTask,
    LearnTask,
    injections_of,
    make_plan,
    parse_link,
    task_sequence,
)
from sitl_plant.physics.airframe import Airframe, Payload, draw_airframe, in_session, with_propellers
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import Vehicle, airframe_of

CREATED = "2026-01-01T00:00:00+00:00"  # fixed, so that equal campaigns learn equal baselines
ONSET = (0.3, 0.5)  # share of the flight; healthy before
PAYLOAD_OFFSET_M = 0.01  # how far beside the centre a payload hangs (estimate)
PAYLOAD_BELOW_M = 0.05
DROP = (0.7, 0.8)  # share of the flight at which half of the picked-up payloads are dropped
PICKUP = (0.2, 0.3)  # share of the flight: before the onset of a cause
WEAR_H = 10.0  # flown between the baseline and a flight with wear, at most (our choice)
START_NS = 1_767_225_600 * NS_PER_S  # 2026-01-01, the first flight learnt from
PAUSE_S, DAY_S = 300.0, 86_400.0  # between flights of one session, and between sessions (our choice)
EPISODE_S = 10.0  # alarms this near to each other count as one (our choice)
# What results follow from, and what of it cannot change one: bytecode, and the edges.
PACKAGES = ("mavdiag", "sitl_plant")
UNRELATED = (
    *("__pycache__", "py.typed", "__main__.py", "mavdiag/cli.py", "mavdiag/commands", "mavdiag/demo"),
    *("sitl_plant/campaign/command.py", "sitl_plant/campaign/summary.py"),
)


@dataclass(frozen=True, slots=True)
class LearnResult:
    """A baseline, as text, or why there is none."""

    key: str
    baseline: str = ""
    error: str = ""
    record: Literal["learn"] = "learn"


@dataclass(frozen=True, slots=True)
class MonitorResult:
    """One monitor in one flight: alarms before and after the onset, time judged [s]."""

    name: str
    before: int
    after: int
    judged_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What the diagnosis answered to the cause; rotor, type and severity by the most certain alarm that names one.

    kind: the verdict if it is no judgement; else the gravest `FaultKind` of the alarms after the onset, "suspicion" if
    they declared none, "nothing" without an alarm.
    """

    kind: str
    rotor: int | None = None
    fault_type: str | None = None
    severity: int | None = None


@dataclass(frozen=True, slots=True)
class FlightResult:
    """One judged flight; all of a healthy one is before the onset."""

    key: str
    index: int
    airframe: int
    cause: str
    rotor: int
    phenomenology: float
    conditions: Conditions
    link: str
    loss: float
    flown_s: float
    verdict: str
    reason: str
    judged_s: float
    healthy_s: float  # judged flight before the onset
    onset_s: float | None  # None if the flight was healthy
    episodes: int  # groups of alarms before it
    latency_s: float | None  # from the onset to the first alarm after it
    answer: Answer
    monitors: tuple[MonitorResult, ...]
    session: int = 0
    faults: int = 0  # how often the decision came to "fault" before the onset
    declared_s: float | None = None  # from it to the first "fault" after it
    score_before: float | None = None  # highest statistic over its threshold, of the monitors of propellers
    score_after: float | None = None
    record: Literal["flight"] = "flight"


Line: TypeAlias = LearnResult | FlightResult
Job = TypeVar("Job", bound=tuple[Any, ...])
_LINE: TypeAdapter[Line] = TypeAdapter(Annotated[Line, Field(discriminator="record")])


def specimen(seed: int, number: int, vehicle: Vehicle) -> Airframe:
    """Airframe `number` of the campaign: drawn afresh, none of drones 1 to 3; every second one is aged."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xA1F, number]))
    return draw_airframe(vehicle, number % 2 == 1, rng, f"airframe {number}")


def _config(airframe: Airframe, flown: Conditions, duration_s: float, rng: np.random.Generator) -> PlantConfig:
    beside = rng.uniform(-PAYLOAD_OFFSET_M, PAYLOAD_OFFSET_M, 2).tolist()
    return PlantConfig(
        airframe=airframe,
        **MANOEUVRES[flown.manoeuvre],
        landed_s=duration_s,
        wind_m_s=flown.wind_m_s,
        wind_towards_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        payload=Payload(flown.payload_g * 1e-3, (beside[0], beside[1], PAYLOAD_BELOW_M)),
        seed=int(rng.integers(2**31)),
    )


def _on_the_day(seed: int, airframe: Airframe, task: FlightTask) -> tuple[Airframe, tuple[float, ...], float]:
    row, number = CONDITIONS[task.conditions.condition], task.learnt.airframe
    if not task.session:
        return airframe, (), 0.0
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5E55, number, task.session]))
    if row.session:
        airframe = in_session(airframe, rng)
    if row.propellers:
        airframe = with_propellers(airframe, row.propellers, rng)
    if not row.wear_per_h:
        return airframe, (), 0.0
    losses = np.random.default_rng(np.random.SeedSequence([seed, 0x3EA2, number])).random(len(airframe.vehicle.rotors))
    return airframe, tuple((row.wear_per_h * losses).tolist()), WEAR_H * float(rng.random())


def _pickup(task: FlightTask, rng: np.random.Generator) -> dict[str, Any]:
    row = CONDITIONS[task.conditions.condition]
    if not row.pickup_g:
        return {}
    angle, at_s, drop_s = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*PICKUP), rng.uniform(*DROP)
    beside = 1e-3 * row.pickup_offset_mm
    place = (float(beside * np.cos(angle)), float(beside * np.sin(angle)), PAYLOAD_BELOW_M)
    end_s = float(task.duration_s * drop_s) if rng.random() < 0.5 else np.inf
    return {"pickup": Payload(row.pickup_g * 1e-3, place), "pickup_s": (float(task.duration_s * at_s), end_s)}


def _flown(
    config: PlantConfig, task: LearnTask, duration_s: float, loss: float, name: str, session: int, number: int
) -> tuple[Log, float]:
    link = replace(parse_link(task.link), loss=loss)
    telemetry, flown_s = flight_telemetry(config, duration_s, link)
    started_ns = START_NS + round((session * DAY_S + number * (task.duration_s + PAUSE_S)) * NS_PER_S)
    return Log(name, telemetry.digest, link.profile, telemetry, started_ns), flown_s


def learn_task(job: tuple[str, LearnTask], seed: int) -> LearnResult:
    """Fly an airframe's healthy flights and learn from them. job: key and task."""
    key, task = job
    airframe, flights = specimen(seed, task.airframe, task.vehicle), []
    for number, child in enumerate(task_sequence(seed, task).spawn(len(task.flights))):
        config = _config(airframe, task.flights[number], task.duration_s, np.random.default_rng(child))
        flights.append(_flown(config, task, task.duration_s, 0.0, f"{airframe.name} healthy {number}", 0, number)[0])
    try:
        baseline = learn(flights, LearnOptions(airframe=airframe_of(airframe.vehicle, airframe.name)), created=CREATED)
    except MavdiagError as error:
        return LearnResult(key, error=str(error))
    return LearnResult(key, dump(baseline))


def fly_task(job: tuple[str, FlightTask, LearnResult], seed: int) -> FlightResult:
    """Fly once and judge the flight by what was learnt of the airframe. job: key, task, and that."""
    key, task, learnt = job
    drawn, row, sequence = task.learnt, CONDITIONS[task.conditions.condition], task_sequence(seed, task)
    airframe, wear_per_h, worn_h = _on_the_day(seed, specimen(seed, drawn.airframe, drawn.vehicle), task)
    rng, own = np.random.default_rng(sequence), np.random.default_rng(sequence.spawn(1)[0])
    onset_s = None if task.cause == HEALTHY else round(task.duration_s * float(rng.uniform(*ONSET)), 3)
    injections = injections_of(task.cause, task.rotor, onset_s or 0.0, task.phenomenology, rng)
    config = replace(
        _config(airframe, task.conditions, task.duration_s, rng),
        injections=injections,
        turbulence_m_s=row.turbulence_m_s,
        outages_per_min=row.outages_per_min,
        wear_per_h=wear_per_h,
        worn_h=worn_h,
        **_pickup(task, own),
    )
    number = 0 if task.session else len(drawn.flights)
    log, flown_s = _flown(config, drawn, task.duration_s, task.loss, f"flight {task.index}", task.session, number)
    verdict, reason = Verdict.NOT_JUDGEABLE, f"no baseline: {learnt.error}"
    if not learnt.error:
        try:
            return _line(key, task, judge_in_full(log, parse(learnt.baseline)), onset_s, flown_s)
        except MavdiagError as error:
            verdict, reason = Verdict.ERROR, str(error)
    unjudged = JudgedFlight(LogVerdict(log.name, verdict, reason, profile=log.profile))
    return _line(key, task, unjudged, onset_s, flown_s)


def _line(key: str, task: FlightTask, judged: JudgedFlight, onset_s: float | None, flown_s: float) -> FlightResult:
    verdict, border_s = judged.verdict, np.inf if onset_s is None else onset_s
    before = [event for event in verdict.events if event.t_s < border_s]
    after = [event for event in verdict.events if event.t_s >= border_s]
    stages = [None, *(change.stage for change in verdict.changes)]
    came = (change for before, change in zip(stages, verdict.changes, strict=False) if before is not Stage.FAULT)
    declared = [change.t_ns / NS_PER_S for change in came if change.stage is Stage.FAULT]
    late = [t_s - border_s for t_s in declared if t_s >= border_s]
    monitors = []
    for monitor in verdict.monitors:
        early, own = ([event for event in part if event.monitor == monitor.name] for part in (before, after))
        monitors.append(MonitorResult(monitor.name, _episodes(early), _episodes(own), round(monitor.judged_s, 3)))
    names = ("index", "cause", "rotor", "phenomenology", "conditions", "loss", "session")
    asked: dict[str, Any] = {name: getattr(task, name) for name in names}
    return FlightResult(
        key=key,
        airframe=task.learnt.airframe,
        link=task.learnt.link,
        flown_s=round(flown_s, 3),
        verdict=verdict.verdict.value,
        reason=verdict.reason,
        judged_s=round(verdict.judged_s, 3),
        healthy_s=round(verdict.judged_s if onset_s is None else _judged_s(judged, onset_s), 3),
        onset_s=onset_s,
        episodes=_episodes(before),
        latency_s=round(min(event.t_s for event in after) - border_s, 3) if after else None,
        answer=_answer(verdict, after),
        monitors=tuple(monitors),
        faults=sum(t_s < border_s for t_s in declared),
        declared_s=round(min(late), 3) if late else None,
        score_before=_score(judged, -np.inf, border_s),
        score_after=_score(judged, border_s, np.inf),
        **asked,
    )


def _score(judged: JudgedFlight, from_s: float, to_s: float) -> float | None:
    highest = []
    for piece in judged.pieces:
        for slot, found in zip(judged.chain.slots if judged.chain else (), piece.found, strict=True):
            t_s = found.t_ns / NS_PER_S
            use = found.valid & (t_s >= from_s) & (t_s < to_s)
            if slot.of_propellers and use.any():
                highest.append(float(found.value[use].max()) / slot.threshold)
    return round(max(highest), 6) if highest else None


def _judged_s(judged: JudgedFlight, to_s: float) -> float:
    """Time before that at which any monitor judged [s], to one period of the slowest."""
    found = [statistic for piece in judged.pieces for statistic in piece.found]
    tick_ns = max((round(statistic.period_s * NS_PER_S) for statistic in found), default=1)
    ticks = {tick for part in found for tick in np.unique(part.t_ns[part.valid] // tick_ns).tolist()}
    return float(sum(tick * tick_ns < to_s * NS_PER_S for tick in ticks) * tick_ns) / NS_PER_S


def _episodes(events: Sequence[Event]) -> int:
    count, until_s = 0, -np.inf
    for event in sorted(events, key=lambda event: event.t_s):
        count += event.t_s > until_s + EPISODE_S
        until_s = max(until_s, np.inf if event.end_s is None else event.end_s)
    return count


def _answer(verdict: LogVerdict, after: Sequence[Event]) -> Answer:
    if verdict.verdict in (Verdict.NOT_JUDGEABLE, Verdict.ERROR):
        return Answer(verdict.verdict.value)
    if not after:
        return Answer("nothing")
    rows = sorted(map(event_json, after), key=lambda row: -float(row["confidence"] or 0.0))
    names = ("rotor", "fault_type", "severity")
    named = {name: next((row[name] for row in rows if row[name] is not None), None) for name in names}
    kinds = [event.kind for event in after if event.kind is not None]
    kind = max(kinds, key=lambda kind: kind.rank, default=None)
    return Answer("suspicion" if kind is None else kind.value, **named)


def task_key(seed: int, task: LearnTask | FlightTask) -> str:
    """What a result is kept under."""
    sources = digest_of_sources(PACKAGES, UNRELATED)
    content = json.dumps([sources, seed, type(task).__name__, asdict(task)], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:20]


class Journal:
    """The file of results, one JSON object a line, in order of completion. A torn last line is no result.

    lines: results by key. Raises UsageError if the file cannot be used.
    """

    def __init__(self, path: Path, fresh: bool = False) -> None:
        self.lines: dict[str, Line] = {}
        self.unread, self._fresh = 0, fresh  # what is in the file goes with the first result, not before there is one
        if not begins(path, rb'\{"key"'):
            raise UsageError(f"{path}: holds something else than results; choose another --output")
        try:
            text = "" if fresh or not path.exists() else path.read_text(encoding="utf-8")
            self._file = path.open("a", encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"cannot use {path} for results ({error}); choose another --output") from error
        for row in text.splitlines():
            try:
                line = _LINE.validate_json(row)
                self.lines[line.key] = line
            except ValidationError:
                self.unread += 1
        if text and not text.endswith("\n"):
            self._file.write("\n")

    def add(self, line: Line) -> None:
        """Keep a result, on disk at once."""
        if self._fresh:
            self._file.truncate(0)
            self._fresh = False
        self.lines[line.key] = line
        self._file.write(json.dumps(asdict(line)) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@dataclass(frozen=True, slots=True)
class Results:
    """The results of a design, in the order of its plan."""

    design: Design
    flights: tuple[FlightResult, ...]
    reused: int  # results that were in the file already
    others: int  # lines of other campaigns, or of another version


def run_campaign(design: Design, journal: Journal, workers: int | str) -> Results:
    """Learn what is to be learnt, then fly. Only the order of the lines in the file depends on the workers.

    workers: as of `run_all`. Raises UsageError if one of them died, LinkError if there is none.
    """
    seed, planned = design.seed, make_plan(design)
    learning = {task_key(seed, task): task for task in dict.fromkeys(flight.learnt for flight in planned)}
    flights = {task_key(seed, task): task for task in planned}
    reused = len({*learning, *flights} & journal.lines.keys())
    others = len(journal.lines) - reused + journal.unread

    def work(stage: str, function: Callable[[Job], Line], jobs: Sequence[Job]) -> None:
        left = [job for job in jobs if job[0] not in journal.lines]
        needed = workers if isinstance(workers, str) else min(workers, len(left))
        with shown(stage, (1.0,) * len(left)) as bar:
            for _, future in run_all(function, left, needed, warn=partial(bar.say, err=True)):
                if (error := future.exception()) is not None and died(error):
                    raise UsageError(
                        "a worker process died, perhaps for want of memory; run again with fewer --workers"
                    ) from error
                journal.add(future.result())
                bar.add(1.0)

    work("learning", partial(learn_task, seed=seed), list(learning.items()))
    found = {task: line for key, task in learning.items() if isinstance(line := journal.lines[key], LearnResult)}
    work("flying", partial(fly_task, seed=seed), [(key, task, found[task.learnt]) for key, task in flights.items()])
    flown = tuple(line for key in flights if isinstance(line := journal.lines[key], FlightResult))
    return Results(design, flown, reused, others)
