"""Hostile values: glitches of single samples, and signals that freeze, read zero or die, in healthy flight.

    python benchmarks/hostile_values.py --shared FOLDER [--seed N] [--only NAME]... [--glitches N] [--samples 1|3]
        [--no-losses]

FOLDER holds the recordings in its folder `data`. Each recording is judged in its healthy part, by a baseline of its own
other healthy part; five emulated links by three flights of another seed. Demanded: no fault and no suspicion that the
flight has not without them; never a propeller fault; no monitor that needs a dead signal judges later than 1 s after;
told.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from recorded_flights import STAMP, part, taught

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import MavdiagError
from mavdiag.judging import JudgedFlight, judge_in_full
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import read_log
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import FloatArray, IntArray, Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

GYRO_RAD_S, FORCE_M_S2 = 34.9, 160.0  # full scale: 2000 deg/s, 16 g
STAMPS_S = (-3600.0, -10.0, -0.3, -0.03, 0.03, 0.3, 10.0, 3600.0)
STRUCK = (Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ACTUATOR, Signal.ATTITUDE, Signal.ATTITUDE_SETPOINT)
SPOILT = (*STRUCK, Signal.THRUST_SETPOINT, Signal.VIBRATION, Signal.TORQUE_COMMAND)
KNOWN_S = 1.0  # a monitor that judges a dead signal later than this is wrong
LINKS = {
    "qdrone2 1 kHz": (LinkSpec("qdrone2"), 30.0),
    "qdrone2 500 Hz": (LinkSpec("qdrone2", 500.0), 30.0),
    "ardupilot 100 Hz": (LinkSpec("ardupilot", 100.0), 60.0),
    "ardupilot 50 Hz": (LinkSpec("ardupilot", 50.0), 60.0),
    "px4 250 Hz": (LinkSpec("px4", 250.0), 40.0),
}

Change = Callable[[IntArray, FloatArray], tuple[IntArray, FloatArray]]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A healthy flight, and the baseline that judges it."""

    name: str
    flight: Log
    baseline: Baseline


def changed(log: Log, signal: Signal, change: Change) -> Log:
    """The log with other samples of a signal, in the order in which they came."""
    series = []
    for one in log.telemetry:
        if one.signal is signal:
            t_ns, values = change(one.t_ns.copy(), one.values.copy())
            one = Series(signal, t_ns, one.host_ns[: len(t_ns)], values)
        series.append(one)
    return replace(log, telemetry=Telemetry(tuple(series)))


def glitched(log: Log, count: int, samples: int, rng: np.random.Generator) -> Log:
    """The log with so many glitches of so many samples each, shared by its signals and the stamps of the gyro."""
    there = [signal for signal in STRUCK if log.telemetry.get(signal) is not None]
    share = -(-count // (len(there) + 1))
    for signal in there:

        def strike(t_ns: IntArray, values: FloatArray, signal: Signal = signal) -> tuple[IntArray, FloatArray]:
            columns = values.shape[1] if signal is not Signal.ACTUATOR else min(4, values.shape[1])
            for at in rng.integers(0, len(values) - samples, share).tolist():
                values[at : at + samples, rng.integers(columns)] = wrong(signal, rng)
            return t_ns, values

        log = changed(log, signal, strike)

    def misdate(t_ns: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
        at = rng.choice(np.arange(1, len(t_ns) - 1), min(share, len(t_ns) // 10), replace=False)
        t_ns[at] += np.round(rng.choice(STAMPS_S, len(at)) * NS_PER_S).astype(np.int64)
        return t_ns, values

    return changed(log, Signal.BODY_RATE, misdate)


def wrong(signal: Signal, rng: np.random.Generator) -> float:
    """What a glitch reads."""
    if signal is Signal.ACTUATOR:
        return float(rng.integers(2))
    if signal in (Signal.ATTITUDE, Signal.ATTITUDE_SETPOINT):
        return float(rng.uniform(-np.pi, np.pi))
    return float(rng.choice([-1.0, 1.0])) * (GYRO_RAD_S if signal is Signal.BODY_RATE else FORCE_M_S2)


def spoilt(log: Log, signal: Signal, how: str, since_ns: int) -> Log:
    """The log with a signal that is frozen, zero or dead since then."""

    def change(t_ns: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
        late = t_ns >= since_ns
        if how == "dead":
            return t_ns[~late], values[~late]
        values[late] = 0.0 if how == "zero" else values[late.argmax()]
        return t_ns, values

    return changed(log, signal, change)


def told(judged: JudgedFlight) -> tuple[int, int, bool]:
    """Faults and suspicions that began, and whether a fault was one of the propellers."""
    changes = judged.verdict.changes
    stages = [one.stage for i, one in enumerate(changes) if i == 0 or one.stage is not changes[i - 1].stage]
    faults, suspicions = (sum(one is stage for one in stages) for stage in (Stage.FAULT, Stage.SUSPECTED))
    propeller = any(one.stage is Stage.FAULT and one.kind is FaultKind.PROPELLER for one in changes)
    return faults, suspicions, propeller


def late_judges(judged: JudgedFlight, signal: Signal, since_ns: int) -> dict[str, float]:
    """How long monitors that need a signal judged it later than 1 s after it was lost [s]."""
    found: dict[str, float] = {}
    chain = judged.chain
    for number, slot in enumerate(chain.slots if chain else ()):
        if signal not in slot.monitor.signals:
            continue
        for piece in judged.pieces:
            one = piece.found[number]
            late = int(np.count_nonzero(one.valid & (one.t_ns > since_ns + KNOWN_S * NS_PER_S)))
            if late:
                found[slot.monitor.name] = found.get(slot.monitor.name, 0.0) + late * one.period_s
    return found


def middle_s(log: Log, share: float = 0.5) -> float:
    """A time within a log [s]."""
    t_s = log.telemetry.need(Signal.BODY_RATE).t_s
    return float(t_s.min() + share * (t_s.max() - t_s.min()))


def recorded(folder: Path, only: Sequence[str]) -> Iterator[Case]:
    """Every recording with a healthy part."""

    def wanted(name: str) -> bool:
        return not only or any(one in name for one in only)

    logs = [read_log(path) for path in sorted((folder / "crazypad" / "normal_flight").glob("E8_log*"))]
    for left_out in logs:
        name = f"crazypad {left_out.name}"
        if wanted(name):
            yield Case(name, left_out, taught([one for one in logs if one is not left_out]))
    if wanted("log171"):
        log = read_log(folder / "ardupilot_real" / "log171.bin")
        yield Case("log171", part(log, 146, 215), taught([part(log, 75, 146)]))
    pairs = (("sq1", "sq5"), ("sq5", "sq1"))
    for one, other in pairs:
        if wanted(f"sitl quad3kg_{one}"):
            flight, teacher = (read_log(folder / "arducopter_sitl" / f"healthy_quad3kg_{x}.tlog") for x in (one, other))
            yield Case(f"sitl quad3kg_{one}", flight, taught([teacher]))
    halves = {
        "sitl jsonplant2": "arducopter_sitl/healthy_jsonplant2_sq1.tlog",
        "live locked_yaw": "arducopter_live/locked_yaw_healthy.tlog",
        "live turning_nose": "arducopter_live/turning_nose_healthy.tlog",
        "loop ap463": "autopilots_in_the_loop/ap463_hil_healthy.tlog",
        "loop px4": "autopilots_in_the_loop/px4_hil_healthy.tlog",
    }
    for name, path in halves.items():
        if wanted(name):
            log = read_log(folder / path)
            yield Case(name, part(log, middle_s(log), None), taught([part(log, None, middle_s(log))]))


def emulated(seed: int, only: Sequence[str]) -> Iterator[Case]:
    """The emulated links."""
    for name, (link, span_s) in LINKS.items():
        if only and not any(one in name for one in only):
            continue
        flights = [
            Log(f"seed {number}", "", link.profile, flight_telemetry(PlantConfig(seed=number), span_s, link)[0])
            for number in range(100 * seed, 100 * seed + 4)
        ]
        options = LearnOptions(airframe=airframe_named("qdrone2"))
        yield Case(name, flights[3], learn(flights[:3], options, created=STAMP))


def glitches(case: Case, count: int, samples: int, seed: int) -> str:
    """The row of a case in the first table."""
    own, judged = (
        judge_in_full(log, case.baseline)
        for log in (case.flight, glitched(case.flight, count, samples, np.random.default_rng(seed)))
    )
    (f0, s0, _), (f1, s1, _) = told(own), told(judged)
    spans = f"{own.verdict.judged_s:.0f} | {judged.verdict.judged_s:.0f}"
    return f"| {case.name} | {f0} + {s0} | {f1} + {s1} | {spans} | {judged.verdict.reason[:60] if f1 > f0 else ''} |"


def losses(case: Case) -> Iterator[str]:
    """The rows of a case in the second table."""
    since_ns = round(middle_s(case.flight) * NS_PER_S)
    for signal in SPOILT:
        if case.flight.telemetry.get(signal) is None:
            continue
        cells = []
        for how in ("frozen", "zero", "dead"):
            judged = judge_in_full(spoilt(case.flight, signal, how, since_ns), case.baseline)
            late, (_, _, propeller) = late_judges(judged, signal, since_ns), told(judged)
            said = " ".join(f"{name} {span_s:.1f} s" for name, span_s in late.items())
            cells.append(("PROPELLER FAULT " if propeller else "") + (f"late: {said}" if said else "ok"))
        yield f"| {case.name} | {signal} | {' | '.join(cells)} |"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shared", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="part of a case's name")
    parser.add_argument("--glitches", type=int, default=200)
    parser.add_argument("--samples", type=int, default=1)
    parser.add_argument("--no-losses", action="store_true", help="the first table alone")
    args = parser.parse_args()
    first = ["| flight | without | with glitches | judged s | judged s | |", "|---|---|---|---|---|---|"]
    second = ["| flight | signal | frozen | zero | dead |", "|---|---|---|---|---|"]
    for cases in (recorded(args.shared / "data", args.only), emulated(args.seed, args.only)):
        for case in cases:
            try:
                first.append(glitches(case, args.glitches, args.samples, args.seed))
                second += [] if args.no_losses else losses(case)
            except MavdiagError as error:
                first.append(f"| {case.name} | {error} | | | | |")
            print(first[-1], flush=True)
    print("\n".join(["", *first, "", *second]))


if __name__ == "__main__":
    main()
