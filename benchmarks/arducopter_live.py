"""ArduCopter on a live link: a nose that turns, weak motors one after the other, and live against a scan.

    python benchmarks/arducopter_live.py FOLDER      (the folder arducopter_live of the recordings)
    python benchmarks/arducopter_live.py --turning [--seed N]

`--turning`: the recording with a turning nose has no motor outputs, so the emulated QDrone 2 flies it, on the
`ardupilot` link: taught by a healthy flight with the nose along a figure of eight; then every motor at 0.95, 0.90 and
0.80 of its thrust and drag from 15 s on, and healthy flights, all of other seeds.

Weak motors: one rotor at 0.95, 0.90 or 0.80 for 45 s, with 20 s of healthy flight after each. A declared fault is
latched for the flight; each of its episodes ends when the monitors that were over have been calm for 2 s, and the
longest window of a monitor is 5 s, so what changes in the first 7 s after the motor is whole again still belongs to it.
An episode that names no rotor anew is no news: nothing CRITICAL is said of it. What news comes at a repair is counted.
"""

import argparse
import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path

import numpy as np
from chain_speed import blocks
from recorded_flights import STAMP, layout_of, part, taught

from mavdiag.baseline import Baseline
from mavdiag.chain import chain_of
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import MavdiagError
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import read_log
from mavdiag.telemetry import Log, Telemetry
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig

ONSET_S = 15.0
CLEARING_S = 7.0  # window of 5 s, and 2 s until a fault is no longer seen


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a flight between two times of the vehicle's clock [s]. motor: the weak one, 0 if all are whole."""

    name: str
    start_s: float
    end_s: float
    motor: int

    def of(self, changes: Sequence[Change], skip_s: float = 0.0) -> list[Change]:
        """The changes in it, without its first `skip_s`."""
        return [one for one in changes if self.start_s + skip_s <= one.t_ns / NS_PER_S < self.end_s]


def stretches(path: Path) -> list[Stretch]:
    """The flown stretches of a flight, from its .csv; weakness begins with the change of its parameter."""
    with path.open(encoding="utf-8", newline="") as file:
        lines = [one for one in csv.DictReader(file) if one["boot_ms"]]
    starts = [(float(one["boot_ms"]) / 1000, one["name"]) for one in lines if one["kind"] == "segment"]
    weakened = [float(one["boot_ms"]) / 1000 for one in lines if one["name"] == "SIM_ENGINE_MUL"]
    found = []
    for (start_s, name), (end_s, _) in pairwise(starts):
        motor = int(name[1]) if name.startswith("m") else 0
        since_s = next((t_s for t_s in weakened if t_s >= start_s), start_s) if motor else start_s
        found.append(Stretch(name, since_s, end_s, motor))
    return found


def run(baseline: Baseline, pieces: Sequence[Telemetry]) -> tuple[tuple[Event, ...], tuple[Change, ...]]:
    """Events and changes of a flight that comes in pieces."""
    chain = chain_of(baseline)
    state = chain.start()
    outputs = [*(chain.step(state, piece) for piece in pieces), chain.finish(state)]
    return tuple(e for one in outputs for e in one.events), tuple(c for one in outputs for c in one.changes)


def entered(changes: Sequence[Change]) -> list[Change]:
    """The changes with which a stage began, or an episode of a fault, or the fault was no longer seen."""
    before = (None, *changes)
    return [
        one
        for one, old in zip(changes, before, strict=False)
        if old is None or (one.stage, one.seen) != (old.stage, old.seen)
    ]


def news(changes: Sequence[Change]) -> list[Change]:
    """The changes at which something CRITICAL is said: a declaration, and a rotor that was not named before it."""
    out, known = list[Change](), (Stage.NOT_JUDGED, 0)
    for one in changes:
        now = (one.stage, len(one.rotors))
        out += [one] if one.stage is Stage.FAULT and now != known else []
        known = now
    return out


def held(changes: Sequence[Change]) -> bool:
    """Whether nothing withdrew the fault."""
    stages = [one.stage for one in changes]
    return Stage.FAULT in stages and set(stages[stages.index(Stage.FAULT) :]) <= {Stage.FAULT, Stage.INSPECT}


def since(change: Change, stretch: Stretch) -> float:
    """How long into the stretch it came [s]."""
    return change.t_ns / NS_PER_S - stretch.start_s


def counted(changes: Sequence[Change]) -> str:
    """Faults and suspicions that began."""
    faults = sum(one.stage is Stage.FAULT and one.seen for one in changes)
    return f"{faults} faults, {sum(one.stage is Stage.SUSPECTED for one in changes)} suspicions"


def turning_nose(turning: Log, healthy: Log, weak: Log, plan: Sequence[Stretch]) -> None:
    """A link with set-point and gyro only, on a vehicle whose nose follows its path."""
    whole = learn([turning], LearnOptions(), created=STAMP)
    fits = ", ".join(
        f"{spec.axis} {spec.model.r2t:.4f}" for spec in (entry.spec for entry in whole.monitors) if spec.kind == "fsd"
    )
    print(f"turning nose, learnt whole: R_T^2 {fits or 'no model'}; layout {layout_of(whole)}")
    for one in whole.not_judgeable:
        print(f"  {one.monitor}: {one.reason}")
    times = turning.telemetry.series[0].t_s
    middle_s = float(times.min() + times.max()) / 2
    half = taught([part(turning, None, middle_s)])
    print(f"  judged by its first half ({', '.join(dict.fromkeys(one.spec.kind for one in half.monitors))})")
    for name, log in (("second half", part(turning, middle_s, None)), ("locked yaw, healthy", healthy)):
        print(f"  {name}: {counted(entered(run(half, [log.telemetry])[1]))}")
    changes = entered(run(half, [weak.telemetry])[1])
    own = [change for stretch in plan if not stretch.motor for change in stretch.of(changes, CLEARING_S)]
    found = sum(
        any(one.stage is Stage.FAULT and one.seen for one in stretch.of(changes)) for stretch in plan if stretch.motor
    )
    print(f"  weak motors' flight, healthy stretches: {counted(own)}; {found} of its 12 weak motors found")


def weak_motors(base: Baseline, weak: Log, plan: Sequence[Stretch]) -> None:
    """Latency and rotor of every weakness, and what changes in the healthy stretches between them."""
    print("weak motors, judged by the whole locked-yaw flight")
    _, changes = run(base, [weak.telemetry])
    starts, loud = entered(changes), news(changes)
    for stretch in plan:
        inside = stretch.of(changes)
        if not stretch.motor:
            late = ", ".join(str(one) for one in stretch.of(starts, CLEARING_S))
            clearing = [one for one in stretch.of(starts) if one.t_ns / NS_PER_S < stretch.start_s + CLEARING_S]
            ended = "".join(
                f"; {'seen again' if one.seen else 'no longer seen'} after {since(one, stretch):.1f} s"
                for one in clearing
            )
            print(f"  {stretch.name:14} healthy: {late or 'nothing'}{ended}; news {len(stretch.of(loud))}")
            continue
        fault = next((one for one in stretch.of(starts) if one.stage is Stage.FAULT and one.seen), None)
        names = [one for i, one in enumerate(inside) if one.rotor and (i == 0 or one.rotor != inside[i - 1].rotor)]
        told = "not named"
        if names:
            told = f"{names[0].rotor} after {since(names[0], stretch):.1f} s, at last {names[-1].rotor}"
            told += f" (changed {len(names) - 1} times)" if len(names) > 1 else ""
        latency = "not found" if fault is None else f"fault after {since(fault, stretch):.1f} s by {fault.monitor}"
        print(f"  {stretch.name:14} {latency}; rotor {told}; {counted(stretch.of(starts))}")
    spans = (f"motor {one.rotor} from {one.since_ns / NS_PER_S:.1f} s" for one in changes[-1].rotors)
    print(f"  {', '.join(spans)}; held from its declaration to the end: {held(changes)}")


def flown(seed: int, seconds: float, motor: int = 0, share: float = 1.0) -> Log:
    """A flight whose nose follows a figure of eight. motor: from ONSET_S on with this share of its thrust and drag."""
    damage = RotorDamage(thrust_factor=share, drag_factor=share)
    weak = (Injection(damage, motor, ONSET_S),) if motor else ()
    config = PlantConfig(drone=2, seed=seed, wind_m_s=1.0, nose="path", trajectory="figure8", injections=weak)
    link = LinkSpec("ardupilot", 100.0)
    return Log(f"motor {motor} at {share:g}, seed {seed}", "", link.profile, flight_telemetry(config, seconds, link)[0])


def turning_motors(seed: int) -> None:
    """Latency, rotor, and what trim says, of every motor and share."""
    base = taught([flown(seed, 120.0)])
    for entry in base.monitors:
        if entry.spec.kind in ("rotor_trim", "trim_step"):
            print(f"{entry.spec.kind}: threshold {entry.threshold.value:.3g}; turn {entry.spec.turn}")
    for one in base.not_judgeable:
        print(f"  {one.monitor}: {one.reason}")
    for number in range(3):
        print(f"  healthy: {counted(entered(run(base, [flown(seed + 50 + number, 60.0).telemetry])[1]))}")
    for motor in (1, 2, 3, 4):
        for share in (0.95, 0.90, 0.80):
            log = flown(seed + 10 * motor + round(100 * share), 35.0, motor, share)
            events, changes = run(base, [log.telemetry])
            since_s = int(log.telemetry.series[0].t_ns[0]) / NS_PER_S + ONSET_S
            faults = [one for one in changes if one.stage is Stage.FAULT and one.seen]
            names = [one for one in faults if one.rotor]
            trims = [one for one in events if one.monitor in ("rotor_trim", "trim_step")]
            told = f"fault after {faults[0].t_ns / NS_PER_S - since_s:.1f} s" if faults else "not found"
            told += f", rotor {names[-1].rotor} after {names[0].t_ns / NS_PER_S - since_s:.1f} s" if names else ""
            told += f", trim after {trims[0].start_ns / NS_PER_S - since_s:.1f} s" if trims else ", no trim"
            print(f"  motor {motor} at {share:.2f}: {told}")


def same_live(name: str, base: Baseline, log: Log, seed: int) -> None:
    """The same flight cut at random, as a live link brings it."""
    rng = np.random.default_rng(seed)
    since = min(int(one.host_ns[0]) for one in log.telemetry)
    until = max(int(one.host_ns[-1]) for one in log.telemetry)
    spans_s = np.exp(rng.uniform(np.log(0.04), np.log(10.0), 4 * (until - since) // NS_PER_S))
    edges = since + np.round(np.cumsum(spans_s) * NS_PER_S).astype(np.int64)
    pieces = blocks(log.telemetry, np.concatenate([[since], edges[edges < until]]))
    whole, live = run(base, [log.telemetry]), run(base, pieces)
    print(
        f"  {name}, {len(pieces)} pieces, seed {seed}: {len(whole[0])} events {alike(whole[0], live[0])}, "
        f"{len(whole[1])} changes {alike(whole[1], live[1])}"
    )


def alike(whole: Sequence[Event | Change], live: Sequence[Event | Change]) -> str:
    """Whether all fields are equal, figures within 1e-9 of each other: sums of other pieces round differently."""
    if len(whole) != len(live):
        return "DIFFERENT"
    for one, other in zip(whole, live, strict=True):
        for field in fields(one):
            a, b = getattr(one, field.name), getattr(other, field.name)
            same = math.isclose(a, b, rel_tol=1e-9) if isinstance(a, float) and isinstance(b, float) else a == b
            if not same and repr(a) != repr(b):  # nan equals nan
                return "DIFFERENT"
    return "equal"


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--turning", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    if asked.turning or asked.folder is None:
        turning_motors(asked.seed)
        return
    folder: Path = asked.folder
    names = ("turning_nose_healthy", "locked_yaw_healthy", "locked_yaw_weak_motors")
    turning, healthy, weak = (read_log(folder / f"{name}.tlog") for name in names)
    plan = stretches(folder / f"{names[2]}.csv")
    try:
        turning_nose(turning, healthy, weak, plan)
    except MavdiagError as error:
        print(f"turning nose: {error}")
    base = taught([healthy])
    weak_motors(base, weak, plan)
    print("scan = live, cut into 0.04 to 10 s")
    for seed in (1, 2, 3):
        same_live(names[2], base, weak, seed)
    same_live(names[0], base, turning, 4)


if __name__ == "__main__":
    main()
