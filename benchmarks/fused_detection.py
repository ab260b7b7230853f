"""What the fused detector finds, and its false alarms: `python benchmarks/fused_detection.py [AIRFRAMES] [HOURS]`.

Airframes that the design never saw, drawn by a seed. Each flies fifteen healthy flights of 40 s in mixed conditions,
from which alone its monitors and thresholds come (0.05 alarms an hour, shared by five monitors). Then it flies as many
more healthy ones as make up the hours, and every fault on every rotor at full and half fluctuation, and on one rotor
at none, in wind up to 1 m/s. Printed: false alarms, share found, latency, rotor and type named rightly. About two
minutes an airframe, and half a minute an hour.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mixed_flights import FAULT_CODES, HOVER, Fault, airframe_of, fly

from mavdiag.airframe.layout import layout_named
from mavdiag.decision import fusion, grading
from mavdiag.decision.events import Reading
from mavdiag.decision.fusion import Change, Channel, Finding, FusionSpec
from mavdiag.decision.grading import Assessment
from mavdiag.monitors import rotor_signature, rotor_trim, unbalance
from mavdiag.monitors.base import Monitor, Rows
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, calibrate
from sitl_plant.physics.airframe import Airframe

SEED = 30_000
LEARN, FLIGHT_S, BUDGET_SHARES = 15, 40.0, 5
AFTER_S, LOOK_S = 8.6, 10.0
FRAME = layout_named("qdrone2")


@dataclass(frozen=True, slots=True)
class Detector:
    """The monitors that judge, the one that only grades, and the fusion."""

    judges: tuple[Monitor[Any], ...]
    grader: Monitor[Any]
    fused: FusionSpec


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a flight. peak: highest ratio of each judge."""

    findings: tuple[Finding, ...]
    assessments: tuple[Assessment, ...]
    peak: tuple[float, ...]


def learn(airframe: Airframe, rng: np.random.Generator) -> Detector:
    """A detector from healthy flights alone."""
    flights = [fly(airframe, rng, FLIGHT_S) for _ in range(LEARN)]
    share = BUDGET_PER_HOUR / BUDGET_SHARES
    shaking, at_shaking = calibrate(
        flights, lambda some: unbalance.fit(some, FRAME, HOVER), unbalance.Unbalance, budget_per_hour=share
    )
    moving, at_moving = calibrate(
        flights, lambda some: rotor_signature.fit(some, FRAME), rotor_signature.RotorSignature, budget_per_hour=share
    )
    judges: tuple[Monitor[Any], ...] = (unbalance.Unbalance(shaking), rotor_signature.RotorSignature(moving))
    levels = (at_shaking.value, at_moving.value)
    channels = tuple(Channel(one.name, one.unit, level) for one, level in zip(judges, levels, strict=True))
    return Detector(judges, rotor_trim.RotorTrim(rotor_trim.fit(flights, FRAME)), FusionSpec(channels))


def judge(detector: Detector, rows: Sequence[Rows]) -> Verdict:
    """Everything there is to say about a flight."""
    state, found, peak = fusion.start(detector.fused), list[Finding](), [0.0] * len(detector.judges)
    readings: list[list[Reading]] = []
    states = [one.start() for one in (*detector.judges, detector.grader)]
    for one in rows:
        new = []
        for i, monitor in enumerate((*detector.judges, detector.grader)):
            states[i], reading = monitor.step(states[i], one)
            new.append(reading)
        for i, channel in enumerate(detector.fused.channels):
            high = new[i].statistic[new[i].valid].max(initial=0.0)
            peak[i] = max(peak[i], float(high) / channel.threshold)
        state, more = fusion.step(detector.fused, state, new[:-1])
        found += more
        readings.append(new)
    return Verdict(tuple(found), grade(readings, found), tuple(peak))


def grade(readings: Sequence[Sequence[Reading]], found: Sequence[Finding]) -> tuple[Assessment, ...]:
    """Type and severity 3.1 s and 8.1 s after the first declaration."""
    declared_ns = next((one.t_ns for one in found if one.change is Change.DECLARED), None)
    if declared_ns is None:
        return ()
    rotor = next((one.rotor for one in reversed(found) if one.rotor is not None), None)
    out = []
    for after_s in (3.1, 8.1):
        state, end_ns = grading.start(declared_ns), declared_ns + round(after_s * 1e9)
        for new in readings:
            a, b, c = (replace(one, valid=one.valid & (one.t_ns <= end_ns)) for one in new)
            state = grading.gather(state, vibration=a, energy=b, effort=c, rotor=rotor)
        out.append(grading.assess(replace(state, latest_ns=end_ns), grading.known_fault_types()))
    return tuple(out)


@dataclass(frozen=True, slots=True)
class Trial:
    """A fault flight and what came of it. early: declared before the onset."""

    fault: Fault
    verdict: Verdict

    @property
    def early(self) -> bool:
        """Declared before there was a fault."""
        onset_ns = self.fault.onset_s * 1e9
        return any(one.change is Change.DECLARED and one.t_ns < onset_ns for one in self.verdict.findings)

    @property
    def latency_s(self) -> float:
        """From onset to declaration, infinite if there was none."""
        times = [one.t_ns / 1e9 - self.fault.onset_s for one in self.verdict.findings if one.change is Change.DECLARED]
        return min((t for t in times if t >= 0), default=np.inf)

    def rotor(self, first: bool) -> int | None:
        """The first name that was given, or the last."""
        names = [one.rotor for one in self.verdict.findings if one.rotor is not None]
        return (names[0] if first else names[-1]) if names else None


def trials(detector: Detector, airframe: Airframe, rng: np.random.Generator) -> list[Trial]:
    """Every fault on every rotor at full and half strength, on one rotor at none."""
    out = []
    for strength, rotors in ((1.0, (1, 2, 3, 4)), (0.5, (1, 2, 3, 4)), (0.0, (int(rng.integers(4)) + 1,))):
        for code in FAULT_CODES:
            for rotor in rotors:
                fault = Fault(code, rotor, float(rng.uniform(7.0, 9.0)), strength)
                out.append(
                    Trial(fault, judge(detector, fly(airframe, rng, fault.onset_s + LOOK_S, wind_m_s=1.0, fault=fault)))
                )
    return out


def show(found: Sequence[Trial]) -> None:
    """A line a fault and strength."""
    for strength in (1.0, 0.5, 0.0):
        for code in FAULT_CODES:
            some = [one for one in found if one.fault.code == code and one.fault.strength == strength]
            late = np.array([one.latency_s for one in some])
            names = [(one.rotor(True), one.rotor(False), one.fault.rotor) for one in some if np.isfinite(one.latency_s)]
            wrong = [sum(name[k] not in (None, name[2]) for name in names) for k in (0, 1)]
            unknown = sum(name[1] is None for name in names)
            p50, p95 = np.percentile(np.minimum(late, 99.0), [50, 95])
            print(
                f"{code} x{strength:g}: {len(some)} flown, found {np.isfinite(late).mean():.3f}, "
                f"latency {p50:.2f} s, 95 % {p95:.2f} s, worst {late.max():.2f} s; "
                f"rotor wrong {wrong[0]} at first, {wrong[1]} at last, unknown {unknown}"
            )
        show_types([one for one in found if one.fault.strength == strength and np.isfinite(one.latency_s)])


def show_types(found: Sequence[Trial]) -> None:
    """Type and severity, over all faults that were found."""
    for k, after in enumerate(("3 s", "8 s")):
        right = np.zeros(4)
        for one in found:
            said = one.verdict.assessments[k]
            kind = said.fault_type is not None and said.fault_type.value == one.fault.code[:2]
            apart = 9 if said.severity is None else abs(said.severity - int(one.fault.code[-1]))
            right += (kind, kind and apart == 0, apart <= 1, said.fault_type is None)
        kinds, classes, near, unnamed = right / max(len(found), 1)
        print(f"  {after} later: type {kinds:.3f}, class {classes:.3f}, within one {near:.3f}, unnamed {unnamed:.3f}")


def main() -> None:
    """Fly and print."""
    airframes, hours = (float(one) for one in (*sys.argv[1:3], *("3", "1")[len(sys.argv) - 1 :]))
    found: list[Trial] = []
    peaks, alarms, early = [], 0, 0
    each = max(1, round(hours * 3600 / FLIGHT_S / airframes))
    for i in range(round(airframes)):
        airframe, rng = airframe_of(SEED + i), np.random.default_rng([SEED + i, 3])
        detector = learn(airframe, rng)
        for _ in range(each):
            verdict = judge(detector, fly(airframe, rng, FLIGHT_S))
            peaks.append(verdict.peak)
            alarms += any(one.change is Change.DECLARED for one in verdict.findings)
        new = trials(detector, airframe, rng)
        found += new
        early += sum(one.early for one in new)
        print(f"airframe {i}: alarms {alarms}, peaks {np.max(peaks, axis=0).round(2)}", file=sys.stderr, flush=True)
    flown = len(peaks) * FLIGHT_S / 3600
    print(f"healthy: {flown:.1f} h on {airframes:g} airframes, {alarms} alarms; before an onset: {early}")
    print(f"highest share of the threshold (vibration, energy): {np.max(peaks, axis=0).round(2)}")
    show(found)


if __name__ == "__main__":
    main()
