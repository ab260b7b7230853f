"""What the monitors say of recorded flights: thresholds from healthy ones, then everything else.

Usage: python benchmarks/recorded_flights.py [FOLDER]     (else MAVDIAG_SHARED, else ../shared beside the checkout)

FOLDER/data holds crazypad (real Crazyflie flights, propeller M3 cut), ardupilot_real/log171.bin (a real quadcopter
that loses its attitude) and arducopter_sitl (a real autopilot in a simulator, motor 1 weakened). One set of defaults
for all.
"""

import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavdiag.diagnose.geometry import Frame, detect_frame, frame_named
from mavdiag.diagnose.heldout import Flights
from mavdiag.diagnose.monitors import effort, innovation, shake
from mavdiag.diagnose.monitors.base import Monitor, Rows
from mavdiag.diagnose.threshold import BUDGET_PER_HOUR, Threshold, calibrate
from mavdiag.judging import between, origin_ns
from mavdiag.learning import Flight, front_for, rows_of
from mavdiag.logs import Log, read_log
from mavdiag.pipeline import Front
from mavdiag.quantities import NS_PER_S

MONITORS = 4  # that share the budget: these three and the thesis rule
SHARE = BUDGET_PER_HOUR / MONITORS
BINS_MM = ((0.0, 1.6), (1.6, 3.1), (3.1, 5.1), (5.1, 9.0))  # total cut


@dataclass(frozen=True)
class Watched:
    """A calibrated monitor."""

    monitor: Monitor[Any]
    threshold: Threshold


@dataclass(frozen=True)
class Found:
    """One flight under one monitor: highest judged statistic, first alarm (vehicle time), rotor of the maximum."""

    maximum: float
    alarm_s: float | None
    rotor: int | None


Baseline = Mapping[str, Watched]


def front_and_rows(log: Log, from_s: float | None = None, to_s: float | None = None) -> tuple[Front, list[Rows]]:
    """Front of a log, and its airborne rows between two times of the vehicle's clock."""
    zero = origin_ns(log.telemetry) / NS_PER_S
    low, high = (None if s is None else s - zero for s in (from_s, to_s))
    telemetry = between(log.telemetry, low, high)
    front = front_for([Flight(log.name, log.sha256, log.profile, telemetry)], 0.1)
    return front, list(rows_of(front, telemetry))


def baseline(flights: Flights, frame: Frame | None) -> Baseline:
    """All monitors that these flights support."""
    everything = [rows for flight in flights for rows in flight]
    found: dict[str, Watched] = {}

    def add(name: str, reason: str | None, learn: Callable[[], tuple[Monitor[Any], Threshold]]) -> None:
        if reason is None:
            found[name] = Watched(*learn())

    def trim() -> tuple[Monitor[Any], Threshold]:
        def fit(rest: Flights) -> effort.EffortSpec:
            return effort.fit(rest, frame or frame_named("x"))

        spec, threshold = calibrate(flights, fit, effort.Effort, budget_per_hour=SHARE, guard=effort.GUARD)
        return effort.Effort(spec), threshold

    def shaking() -> tuple[Monitor[Any], Threshold]:
        spec, threshold = calibrate(flights, shake.fit, shake.Shake, budget_per_hour=SHARE, guard=shake.GUARD)
        return shake.Shake(spec), threshold

    def newness() -> tuple[Monitor[Any], Threshold]:
        spec, threshold = calibrate(
            flights, innovation.fit, innovation.Innovation, budget_per_hour=SHARE, guard=innovation.GUARD
        )
        return innovation.Innovation(spec), threshold

    add("effort", effort.judgeable(everything, frame), trim)
    add("vibration", shake.judgeable(everything), shaking)
    add("innovation", innovation.judgeable(everything), newness)
    return found


def judge(watched: Watched, flight: Sequence[Rows]) -> Found:
    """Run one monitor over one flight."""
    state, highest, alarm_s, rotor = watched.monitor.start(), 0.0, None, None
    for rows in flight:
        state, reading = watched.monitor.step(state, rows)
        statistic = np.where(reading.valid, reading.statistic, -np.inf)
        if len(statistic) == 0 or not reading.valid.any():
            continue
        above = np.flatnonzero(statistic > watched.threshold.value)
        if alarm_s is None and len(above):
            alarm_s = float(reading.t_ns[above[0]]) / NS_PER_S
        top = int(statistic.argmax())
        if statistic[top] > highest:
            highest = float(statistic[top])
            rotor = int(reading.rotors[top].argmax()) + 1 if reading.rotors.shape[1] else None
    return Found(highest, alarm_s, rotor)


def alarms(base: Baseline, flight: Sequence[Rows]) -> str:
    """One line: each monitor's maximum against its threshold, the alarms and the rotor."""
    parts = []
    for name, watched in base.items():
        found = judge(watched, flight)
        mark = "" if found.alarm_s is None else f" ALARM {found.alarm_s:.1f} s"
        rotor = f" r{found.rotor}" if found.rotor is not None and mark else ""
        parts.append(f"{name} {found.maximum:.3g}/{watched.threshold.value:.3g}{mark}{rotor}")
    return ", ".join(parts)


@dataclass(frozen=True)
class Cut:
    """A Crazyflie flight. kind: healthy, cut, tape or weight; cut_mm: both blades together."""

    name: str
    kind: str
    cut_mm: float
    rows: list[Rows]


def crazypad_flights(folder: Path) -> list[Cut]:
    """All flights of the airframe, by folder name."""
    flights = []
    for path in sorted(folder.glob("*/E8_log*")):
        name = path.parent.name
        kind = {"n": "healthy", "c": "cut", "t": "tape", "a": "weight"}[name[0]]
        lengths = [float(x) for x in re.findall(r"([\d.]+)mm", name)]  # cuts, and what remains of the propeller
        cut_mm = sum(x for x in lengths if x <= 20) if kind == "cut" else 0.0
        flights.append(Cut(f"{name}/{path.name}", kind, cut_mm, front_and_rows(read_log(path))[1]))
    return flights


def ranks(x: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Mean ranks, ties shared."""
    values = np.asarray(x)
    return np.array([(np.count_nonzero(values < v) + np.count_nonzero(values <= v) + 1) / 2 for v in values])


def per_bin(cuts: Sequence[Cut], chosen: Sequence[bool]) -> str:
    """Count of chosen flights in each bin of cut."""
    return "/".join(
        str(sum(low < one.cut_mm <= high and yes for one, yes in zip(cuts, chosen, strict=True)))
        for low, high in BINS_MM
    )


def crazypad(folder: Path) -> None:
    """Nested leave-one-out on the healthy flights, then the cuts by size."""
    flights, frame = crazypad_flights(folder), frame_named("crazyflie")
    healthy = [one for one in flights if one.kind == "healthy"]
    cuts = [one for one in flights if one.kind == "cut"]
    print(f"\n## Crazyflie E8, {len(healthy)} healthy flights; nested: each judged by a baseline of the other four")
    flagged = 0
    for one in healthy:
        base = baseline([other.rows for other in healthy if other is not one], frame)
        line = alarms(base, one.rows)
        flagged += "ALARM" in line
        detected = [judge(base["effort"], cut.rows).alarm_s is not None for cut in cuts]
        print(f"{one.name}: {line}; effort finds {per_bin(cuts, detected)} cuts")
    print(f"healthy flights flagged: {flagged} of {len(healthy)}")
    base = baseline([one.rows for one in healthy], frame)
    everything = per_bin(cuts, [True] * len(cuts))
    print(f"\nBaseline of all five; cuts of <=1.5 / 2-3 / 3.5-5 / >5 mm: {everything} flights")
    for name, watched in base.items():
        found = {one.name: judge(watched, one.rows) for one in flights}
        detected = [found[one.name].alarm_s is not None for one in cuts]
        rho = np.corrcoef(ranks([found[one.name].maximum for one in cuts]), ranks([one.cut_mm for one in cuts]))[0, 1]
        others = {
            kind: sum(found[one.name].alarm_s is not None for one in flights if one.kind == kind)
            for kind in ("tape", "weight")
        }
        big = [found[o.name].rotor == 3 for o, yes in zip(cuts, detected, strict=True) if yes and o.cut_mm > 2]
        rotor = f", M3 named in {sum(big)} of {len(big)} above 2 mm" if name == "effort" else ""
        print(
            f"{name}: detected {per_bin(cuts, detected)}{rotor}, Spearman {rho:.3f}, alarms on other changes {others}"
        )
        print(f"    threshold {watched.threshold.value:.3f} {watched.monitor.unit}, {watched.threshold.statement()}")


def log171(folder: Path) -> None:
    """A real quadcopter: first half of its healthy flight teaches, second half and the upset are judged."""
    log = read_log(folder / "log171.bin")
    first = front_and_rows(log, 75, 146)[1]
    frame = detect_frame(first)
    base = baseline([first], frame)
    print(f"\n## log171, frame found: {frame.name if frame else None}; ACRO from 217 s, attitude lost at 239.1 s")
    for name, (low, high) in {"healthy 146-217 s": (146, 217), "upset 217-239.6 s": (217, 239.6)}.items():
        print(f"{name}: {alarms(base, front_and_rows(log, low, high)[1])}")


def arducopter(folder: Path) -> None:
    """A real autopilot in a simulator: each healthy log teaches, all others are judged."""
    logs = {path.stem: front_and_rows(read_log(path))[1] for path in sorted(folder.glob("*quad3kg*.tlog"))}
    for taught in (name for name in logs if name.startswith("healthy")):
        frame = detect_frame(logs[taught])
        base = baseline([logs[taught]], frame)
        print(f"\n## ArduCopter, taught by {taught}, frame found: {frame.name if frame else None}")
        for name, rows in logs.items():
            print(f"{name}: {alarms(base, rows)}")
    healthy, damaged = (
        read_log(folder / f"{x}_sq1.tlog") for x in ("healthy_jsonplant2", "fault_jsonplant2_m1_eff090_imb")
    )
    middle_s = origin_ns(healthy.telemetry) / NS_PER_S + 60
    first = front_and_rows(healthy, None, middle_s)[1]
    frame = detect_frame(first)
    base = baseline([first], frame)
    print(
        f"\n## ArduCopter, external physics, taught by the first minute, frame found: {frame.name if frame else None}"
    )
    print(f"second minute: {alarms(base, front_and_rows(healthy, middle_s, None)[1])}")
    print(f"rotor 1 at 0.90 with unbalance: {alarms(base, front_and_rows(damaged)[1])}")


def main() -> None:
    """Print the tables of what is there."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("MAVDIAG_SHARED", beside)) / "data"
    for name, show in {"crazypad": crazypad, "ardupilot_real": log171, "arducopter_sitl": arducopter}.items():
        if (folder / name).exists():
            show(folder / name)
        else:
            print(f"not present: {folder / name}")


if __name__ == "__main__":
    main()
