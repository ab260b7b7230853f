"""One task of a campaign, in whatever process it runs: learn a baseline, or fly once and judge.

Everything follows from the campaign's seed and the task, so it does not matter where a task runs, or when.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.as_json import event_json
from mavdiag.baseline import dump, parse
from mavdiag.decision.alarm import Change, Stage
from mavdiag.errors import MavdiagError
from mavdiag.judging import JudgedEvent, JudgedFlight, LogVerdict, Verdict, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from mavdiag.units import NS_PER_S, S_PER_H
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry, telemetry_digest
from sitl_plant.campaign.causes import HEALTHY, injections_of
from sitl_plant.campaign.conditions import CONDITIONS, MANOEUVRES, Conditions, parse_link
from sitl_plant.campaign.plan import FlightTask, LearnTask, task_sequence
from sitl_plant.physics.airframe import Airframe, Payload, PickUp, Wear, draw_airframe, in_session, with_propellers
from sitl_plant.physics.faults import Injection
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import Vehicle, airframe_of

__all__ = ["Answer", "FlightResult", "LearnResult", "MonitorResult", "fly_task", "learn_task", "specimen"]

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


@dataclass(frozen=True, slots=True)
class LearnResult:
    """A baseline, as text, or why there is none."""

    key: str
    airframe: int
    link: str
    baseline: str = ""
    error: str = ""
    judged_s: float = 0.0
    record: Literal["learn"] = "learn"


@dataclass(frozen=True, slots=True)
class MonitorResult:
    """One monitor in one flight: its alarms before and after the onset, and the first of these after it [s].

    judged_s: time of the whole flight that it judged.
    """

    name: str
    before: int
    after: int
    latency_s: float | None
    judged_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What the diagnosis answered to the cause.

    kind: the verdict if it is no judgement; else the gravest kind of fault of the alarms after the onset (a value of
        `mavdiag.monitors.base.FaultKind`), "suspicion" if they declared none, "nothing" without an alarm.
    rotor, fault_type, severity: of the most certain alarm after the onset that names one.
    """

    kind: str
    rotor: int | None = None
    fault_type: str | None = None
    severity: int | None = None


@dataclass(frozen=True, slots=True)
class FlightResult:
    """One judged flight.

    healthy_s: judged flight before the onset.
    onset_s: None if the flight was healthy.
    episodes: groups of alarms before the onset.
    latency_s: from the onset to the first alarm after it.
    session: as in the task.
    faults: how often the decision came to "fault" before the onset.
    declared_s: from the onset to the first "fault" after it.
    score_before, score_after: highest statistic over its threshold, of the monitors that decide about propellers,
        before and after the onset; all of a healthy flight is before. None where none of them judged.
    """

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
    healthy_s: float
    onset_s: float | None
    episodes: int
    latency_s: float | None
    answer: Answer
    monitors: tuple[MonitorResult, ...]
    session: int = 0
    faults: int = 0
    declared_s: float | None = None
    score_before: float | None = None
    score_after: float | None = None
    record: Literal["flight"] = "flight"


def specimen(seed: int, number: int, aged: bool, vehicle: Vehicle) -> Airframe:
    """Airframe `number` of the campaign: drawn afresh, none of drones 1 to 3."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xA1F, number]))
    return draw_airframe(vehicle, aged, rng, f"airframe {number}")


def _config(
    airframe: Airframe,
    conditions: Conditions,
    duration_s: float,
    injections: tuple[Injection, ...],
    rng: np.random.Generator,
) -> PlantConfig:
    manoeuvre = MANOEUVRES[conditions.manoeuvre]
    beside = rng.uniform(-PAYLOAD_OFFSET_M, PAYLOAD_OFFSET_M, 2)
    return PlantConfig(
        airframe=airframe,
        trajectory=manoeuvre.shape,
        speed_m_s=manoeuvre.speed_m_s,
        heading_rad=manoeuvre.heading_rad,
        nose=manoeuvre.nose,
        start="ground" if manoeuvre.takeoff else "hover",
        landed_s=duration_s if manoeuvre.takeoff else None,
        wind_m_s=conditions.wind_m_s,
        wind_towards_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        payload=Payload(conditions.payload_g * 1e-3, (float(beside[0]), float(beside[1]), PAYLOAD_BELOW_M)),
        injections=injections,
        seed=int(rng.integers(2**31)),
    )


def _on_the_day(
    seed: int, airframe: Airframe, number: int, session: int, condition: str
) -> tuple[Airframe, Wear | None]:
    """The airframe in a session and how worn it is: the same for all flights of that session."""
    row = CONDITIONS[condition]
    if not session:
        return airframe, None
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5E55, number, session]))
    if row.session:
        airframe = in_session(airframe, rng)
    if row.propellers:
        airframe = with_propellers(airframe, row.propellers, rng)
    if not row.wear_per_h:
        return airframe, None
    losses = np.random.default_rng(np.random.SeedSequence([seed, 0x3EA2, number])).random(len(airframe.vehicle.rotors))
    return airframe, Wear(tuple((row.wear_per_h * losses).tolist()), WEAR_H * float(rng.random()))


def _in_condition(config: PlantConfig, condition: str, duration_s: float, rng: np.random.Generator) -> PlantConfig:
    """The flight in a named condition. The stream is one of its own."""
    row, pickup = CONDITIONS[condition], None
    if row.pickup_g:
        angle, at_s, drop_s = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*PICKUP), rng.uniform(*DROP)
        beside = 1e-3 * row.pickup_offset_mm
        place = (float(beside * np.cos(angle)), float(beside * np.sin(angle)), PAYLOAD_BELOW_M)
        end_s = float(duration_s * drop_s) if rng.random() < 0.5 else np.inf
        pickup = PickUp(Payload(row.pickup_g * 1e-3, place), float(duration_s * at_s), end_s)
    return replace(config, turbulence_m_s=row.turbulence_m_s, outages_per_min=row.outages_per_min, pickup=pickup)


def _started_ns(task: LearnTask, session: int, number: int) -> int:
    """Wall clock of a flight: those of a session follow each other, every session is on a day of its own."""
    return START_NS + round((session * DAY_S + number * (task.duration_s + PAUSE_S)) * NS_PER_S)


def learn_task(key: str, seed: int, task: LearnTask) -> LearnResult:
    """Fly an airframe's healthy flights and learn from them."""
    airframe, link = specimen(seed, task.airframe, task.aged, task.vehicle), parse_link(task.link)
    flights = []
    for number, child in enumerate(task_sequence(seed, task).spawn(len(task.flights))):
        config = _config(airframe, task.flights[number], task.duration_s, (), np.random.default_rng(child))
        telemetry, _ = flight_telemetry(config, task.duration_s, link)
        name = f"{airframe.name} healthy {number}"
        started_ns = _started_ns(task, 0, number)
        flights.append(Log(name, telemetry_digest(telemetry), link.profile, telemetry, started_ns))
    try:
        baseline = learn(flights, LearnOptions(airframe=airframe_of(airframe.vehicle, airframe.name)), created=CREATED)
    except MavdiagError as error:
        return LearnResult(key, task.airframe, task.link, error=str(error))
    return LearnResult(key, task.airframe, task.link, dump(baseline), judged_s=S_PER_H * baseline.healthy_hours)


def fly_task(key: str, seed: int, task: FlightTask, learnt: LearnResult) -> FlightResult:
    """Fly once and judge the flight by what was learnt of the airframe."""
    drawn, condition = task.learnt, task.conditions.condition
    airframe = specimen(seed, drawn.airframe, drawn.aged, drawn.vehicle)
    airframe, wear = _on_the_day(seed, airframe, drawn.airframe, task.session, condition)
    sequence = task_sequence(seed, task)
    rng, own = np.random.default_rng(sequence), np.random.default_rng(sequence.spawn(1)[0])
    onset_s = None if task.cause == HEALTHY else round(task.duration_s * float(rng.uniform(*ONSET)), 3)
    injections = injections_of(task.cause, task.rotor, onset_s or 0.0, task.phenomenology, rng)
    config = _config(airframe, task.conditions, task.duration_s, injections, rng)
    config = replace(_in_condition(config, condition, task.duration_s, own), wear=wear)
    spec = parse_link(task.learnt.link)
    telemetry, flown_s = flight_telemetry(config, task.duration_s, LinkSpec(spec.profile, spec.rate_hz, task.loss))
    started_ns = _started_ns(drawn, task.session, 0 if task.session else len(drawn.flights))
    log = Log(f"flight {task.index}", telemetry_digest(telemetry), spec.profile, telemetry, started_ns)
    if learnt.error:
        reason = f"no baseline: {learnt.error}"
        judged = JudgedFlight(LogVerdict(log.name, Verdict.NOT_JUDGEABLE, reason, profile=log.profile))
    else:
        try:
            judged = judge_in_full(log, parse(learnt.baseline))
        except MavdiagError as error:
            judged = JudgedFlight(LogVerdict(log.name, Verdict.ERROR, str(error), profile=log.profile))
    return _line(key, task, judged, onset_s, flown_s)


def _line(key: str, task: FlightTask, judged: JudgedFlight, onset_s: float | None, flown_s: float) -> FlightResult:
    verdict, border_s = judged.verdict, flown_s if onset_s is None else onset_s
    scores = _score(judged, -np.inf, border_s), None if onset_s is None else _score(judged, border_s, np.inf)
    before = [one for one in verdict.events if one.t_s < border_s]
    after = [] if onset_s is None else [one for one in verdict.events if one.t_s >= border_s]
    declared = _declared_s(verdict.changes)
    late = [] if onset_s is None else [t_s - border_s for t_s in declared if t_s >= border_s]
    return FlightResult(
        key=key,
        index=task.index,
        airframe=task.learnt.airframe,
        cause=task.cause,
        rotor=task.rotor,
        phenomenology=task.phenomenology,
        conditions=task.conditions,
        link=task.learnt.link,
        loss=task.loss,
        flown_s=round(flown_s, 3),
        verdict=verdict.verdict.value,
        reason=verdict.reason,
        judged_s=round(verdict.judged_s, 3),
        healthy_s=round(verdict.judged_s if onset_s is None else _judged_s(judged, onset_s), 3),
        onset_s=onset_s,
        episodes=_episodes(before),
        latency_s=_latency(after, border_s),
        answer=_answer(verdict, after),
        monitors=tuple(
            MonitorResult(
                one.name,
                _episodes([event for event in before if event.event.monitor == one.name]),
                _episodes(own := [event for event in after if event.event.monitor == one.name]),
                _latency(own, border_s),
                round(one.judged_s, 3),
            )
            for one in verdict.monitors
        ),
        session=task.session,
        faults=sum(t_s < border_s for t_s in declared),
        declared_s=round(min(late), 3) if late else None,
        score_before=scores[0],
        score_after=scores[1],
    )


def _score(judged: JudgedFlight, from_s: float, to_s: float) -> float | None:
    """The highest ratio of a monitor that decides about propellers, of the values in a span of vehicle time."""
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
    found = [one for piece in judged.pieces for one in piece.found]
    tick_ns = max((round(one.period_s * NS_PER_S) for one in found), default=1)
    ticks = {tick for one in found for tick in np.unique(one.t_ns[one.valid] // tick_ns).tolist()}
    count = sum(tick * tick_ns < to_s * NS_PER_S for tick in ticks)
    return float(count * tick_ns) / NS_PER_S


def _declared_s(changes: Sequence[Change]) -> list[float]:
    """When the decision came to "fault" from something else [s]."""
    before = (None, *(change.stage for change in changes))
    return [
        change.t_ns / NS_PER_S
        for change, stage in zip(changes, before, strict=False)
        if change.stage is Stage.FAULT and stage is not Stage.FAULT
    ]


def _episodes(events: Sequence[JudgedEvent]) -> int:
    """Alarms that follow each other within EPISODE_S, or overlap, count once."""
    count, until_s = 0, -np.inf
    for one in sorted(events, key=lambda event: event.t_s):
        if one.t_s > until_s + EPISODE_S:
            count += 1
        until_s = max(until_s, one.t_s if one.end_s is None else one.end_s)
        if one.end_s is None:
            until_s = np.inf
    return count


def _latency(events: Sequence[JudgedEvent], onset_s: float) -> float | None:
    return round(min(one.t_s for one in events) - onset_s, 3) if events else None


def _answer(verdict: LogVerdict, after: Sequence[JudgedEvent]) -> Answer:
    """By the most certain alarm that names a rotor, a type or a severity; read from the public report."""
    if verdict.verdict in (Verdict.NOT_JUDGEABLE, Verdict.ERROR):
        return Answer(verdict.verdict.value)
    if not after:
        return Answer("nothing")
    rows = [dict(event_json(one.t_s, one.end_s, one.event)) for one in after]
    rows.sort(key=lambda row: -float(str(row["confidence"] or 0.0)))
    rotor, severity, fault_type = (
        next((row[name] for row in rows if row.get(name) is not None), None)
        for name in ("rotor", "severity", "fault_type")
    )
    kinds = [one.event.kind for one in after if one.event.kind is not None]
    kind = max(kinds, key=lambda one: one.rank, default=None)
    return Answer(
        kind="suspicion" if kind is None else kind.value,
        rotor=int(str(rotor)) if rotor is not None else None,
        fault_type=str(fault_type) if fault_type is not None else None,
        severity=int(str(severity)) if severity is not None else None,
    )
