"""Would a verdict on the whole flight find smaller cuts? Candidates, nested on recordings and on emulated sessions.

    python benchmarks/flight_level.py FOLDER/crazypad [--airframes 3] [--seed 4100]

A candidate is one figure for a whole flight:

    rotor's median      max_j of the median over the flight of rotor j's rise (`rotor_trim`), instead of the peak
    mean trim           the rise that explains the mean trim of the flight
    signature, innovation   median over the flight of that monitor's statistic
    residual bands, sensors bands    sum over six bands and all channels of r - 1 - ln r where r > 1: the likelihood
        ratio of a variance that has grown by r, per degree of freedom; of the model residual from 1 Hz on, and of gyro
        and accelerometer from 4 Hz on. A ratio of powers is the same for the innovation, which is a filter of these
    order tracking      highest line, over the median of all speeds, in half seconds of gyro and a_z along a phase that
        turns with the root of the thrust command: 225 to 330 revolutions a second, folded below half the rate

Nested: each of the five healthy E8 flights is left out, the other four fit, and each of these is scored by a fit to the
other three. These four scores set the threshold by the product's rule, with the share of one of eight monitors in the
budget and the prior of `rotor_trim` for the candidates of trim. Flagged means that the product or the candidate flags.
The first recording of each label chooses among candidates; the others, and the healthy flight left out, judge.
Emulated: healthy flights of 30 s, link of 100 Hz, baselines of five flights of one session, thresholds with no
allowance for other sessions; ten flights each of other sessions and of new propellers within 1 %.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from recorded_flights import taught, total_cut_mm
from rich.console import Console
from rich.table import Table
from scipy.signal import welch

from mavdiag.airframe.trim import rises, trim_of
from mavdiag.baseline import Baseline
from mavdiag.chain import front_of
from mavdiag.judging import Verdict, judge
from mavdiag.learning import LearnOptions, airborne, learn
from mavdiag.logs import read_log
from mavdiag.monitors import monitor_of
from mavdiag.monitors.rotor_signature import residuals_of, samples_of
from mavdiag.monitors.rotor_trim import RotorTrim
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray, Log
from mavdiag.thresholds.heldout import Scores
from mavdiag.thresholds.rule import BUDGET_PER_HOUR, USUAL, threshold_of
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.campaign.worker import CREATED, specimen
from sitl_plant.physics.airframe import Airframe, in_session, with_propellers
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

SHARE_PER_H = BUDGET_PER_HOUR / 8
BANDS, FIRST_HZ = 6, {"residual": 1.0, "sensors": 4.0}
SPEEDS_HZ = np.linspace(225.0, 330.0, 400)
SMALL_MM = 5.0
ONE_BLADE = ("_0.5mm_46.5mm", "_1mm_46mm")  # the only labels that say so
TRIM = ("rotor's median", "mean trim")

Values = dict[str, float]
Teacher = Callable[[Sequence[Log]], Baseline]


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A flight: its label, whether it is a first recording, its log and its flying rows."""

    label: str
    first: bool
    log: Log
    rows: Sequence[Rows]

    def blocks(self) -> list[FloatArray]:
        """Gyro, a_z and thrust of the valid rows of each segment, (n, 5)."""
        parts: dict[int, list[FloatArray]] = {}
        for block in (rows.block for rows in self.rows):
            columns = np.column_stack((block.rate, block.force[:, 2], block.thrust))
            parts.setdefault(block.segment, []).append(columns[block.valid])
        return [np.concatenate(found) for found in parts.values() if any(map(len, found))]


def powers(signals: Sequence[FloatArray], rate_hz: float, first_hz: float) -> FloatArray:
    """Power in bands of equal ratio from first_hz to half the rate, (bands, channels), of all that is a second long."""
    found = [(len(x), welch(x, rate_hz, nperseg=round(rate_hz), axis=0)[1]) for x in signals if len(x) > round(rate_hz)]
    density = np.sum([n * p for n, p in found], axis=0) / sum(n for n, _ in found)
    f = np.fft.rfftfreq(round(rate_hz), 1 / rate_hz)
    edges = np.geomspace(first_hz, 0.48 * rate_hz, BANDS + 1)
    return np.array([density[(f >= a) & (f < b)].mean(axis=0) for a, b in pairwise(edges)])


def bands(flight: Flown, baseline: Baseline, what: str) -> FloatArray:
    """Powers of the residual or of the sensors."""
    if what == "sensors":
        signals = [x[:, :4] for x in flight.blocks()]
        return powers(signals, 1 / flight.rows[0].block.dt_s, FIRST_HZ[what])
    motion = next(entry.spec.motion for entry in baseline.monitors if entry.spec.kind == "rotor_signature")
    samples = samples_of(flight.rows, motion.stride, motion.window)
    signals = [found.n[found.valid] for found in (residuals_of(motion, part) for part in samples)]
    return powers([np.concatenate(signals)], 1 / motion.period_s, FIRST_HZ[what])


def grown(power: FloatArray, healthy: Sequence[FloatArray]) -> float:
    """The likelihood ratio of bands that have grown."""
    r = np.maximum(power / np.exp(np.mean(np.log(healthy), axis=0)), 1.0)
    return float((r - 1.0 - np.log(r)).sum())


def tracked(flight: Flown) -> float:
    """The highest line along the phase of the rotors."""
    total, dt_s = np.zeros((len(SPEEDS_HZ), 4)), flight.rows[0].block.dt_s
    half = round(0.5 / dt_s)
    for x in flight.blocks():
        speed = np.sqrt(np.maximum(x[:, 4], 0.05))
        turns = np.exp(-2j * np.pi * np.outer(SPEEDS_HZ, np.cumsum(speed / speed.mean()) * dt_s))
        for at in range(0, len(x) - half + 1, half):
            piece = x[at : at + half, :4] - x[at : at + half, :4].mean(axis=0)
            total += np.square(np.abs(turns[:, at : at + half] @ piece))
    return float((total.max(axis=0) / np.median(total, axis=0)).max())


def values(flight: Flown, baseline: Baseline, healthy: Sequence[Flown], *, crazyflie: bool) -> Values:
    """Every candidate for one flight."""
    specs = {entry.spec.kind: entry.spec for entry in baseline.monitors}
    trim, found = specs["rotor_trim"], {}
    rotors = np.concatenate([one.rotors[one.valid] for one in RotorTrim(trim).over(flight.rows)])
    found["rotor's median"] = float(np.median(rotors, axis=0).max())
    trims = [trim_of(rows.block, trim.layout, trim.source) for rows in flight.rows]
    shift = np.concatenate([m[known] for m, known in trims]).mean(axis=0) - np.array(trim.mean)
    found["mean trim"] = float(rises(shift[None], trim.layout, trim.spread).max())
    for name in ("rotor_signature", "innovation"):
        statistic = np.concatenate([one.value[one.valid] for one in monitor_of(specs[name]).over(flight.rows)])
        found[name] = float(np.median(statistic))
    for what in FIRST_HZ:
        own = [bands(one, baseline, what) for one in healthy]
        found[f"{what} bands"] = grown(bands(flight, baseline, what), own)
    return {**found, "order tracking": tracked(flight)} if crazyflie else found


def thresholds(healthy: Sequence[Flown], teach: Teacher, sessions: int, *, crazyflie: bool) -> Values:
    """Of every candidate, by flights that the fits did not see."""
    scores = []
    for one in healthy:
        others = [other for other in healthy if other is not one]
        scores.append(values(one, teach([other.log for other in others]), others, crazyflie=crazyflie))
    spans = np.array([sum(len(rows.block) * rows.block.dt_s for rows in one.rows) for one in healthy])
    return {
        name: threshold_of(
            Scores(np.array([one[name] for one in scores]), spans, np.arange(len(healthy))),
            sessions=[number % sessions for number in range(len(healthy))],
            budget_per_hour=SHARE_PER_H,
            prior=RotorTrim.prior if name in TRIM else USUAL,
        ).value
        for name in scores[0]
    }


def fold(
    healthy: Sequence[Flown], judged: Sequence[Flown], teach: Teacher, sessions: int, *, crazyflie: bool
) -> list[tuple[Flown, dict[str, bool]]]:
    """What is flagged of the judged flights: by the product, and by it or a candidate."""
    baseline = teach([one.log for one in healthy])
    limits, found = thresholds(healthy, teach, sessions, crazyflie=crazyflie), []
    for one in judged:
        product = judge(one.log, baseline).verdict is Verdict.FAULT
        figures = values(one, baseline, healthy, crazyflie=crazyflie)
        found.append((one, {"product": product, **{k: product or v > limits[k] for k, v in figures.items()}}))
    return found


def recorded(folder: Path) -> Table:
    """The nested table on E8."""
    paths = sorted(folder.glob("*/E8_log*"))
    logs = [(path.parent.name, read_log(path)) for path in paths]
    front = front_of(taught([log for label, log in logs if label == "normal_flight"]))
    flights, seen = [], set()
    for label, log in logs:
        flights.append(Flown(label, label not in seen, log, airborne(front, log).rows))
        seen.add(label)
    healthy = [one for one in flights if one.label == "normal_flight"]
    hits: dict[str, Counter[str]] = {}
    of: Counter[str] = Counter()
    for left_out in healthy:
        others = [one for one in healthy if one is not left_out]
        judged = [one for one in flights if one.label != "normal_flight" or one is left_out]
        for one, flagged in fold(others, judged, taught, len(others), crazyflie=True):
            for key in columns(one):
                of[key] += 1
                for name, yes in flagged.items():
                    hits.setdefault(name, Counter())[key] += yes
    table = Table("flagged by it or the product", *of, title="CrazyPAD E8, nested: flights of all five folds")
    for name, count in hits.items():
        table.add_row(name, *(f"{count[key]}/{of[key]}" for key in of))
    return table


def columns(one: Flown) -> list[str]:
    """Where a flight counts."""
    cut_mm = total_cut_mm(one.label)
    if cut_mm is None:
        return [one.label.split("_")[0]]
    if cut_mm > SMALL_MM:
        return ["cut > 5 mm"]
    one_blade = ["all on one blade"] if one.label.endswith(ONE_BLADE) else []
    return ["cut <= 5 mm, chooses" if one.first else "judges", *one_blade]


def emulated(airframes: int, seed: int) -> Table:
    """Healthy flights of other sessions and with other propellers."""
    options = LearnOptions(airframe=airframe_of(qdrone2(), "emulated"))
    table = Table("false alarms of healthy flights", "sessions", "propellers within 1 %", title="Emulated, 100 Hz")
    count: dict[str, Counter[str]] = {}

    def flight(airframe: Airframe, number: int, label: str) -> Log:
        telemetry, _ = flight_telemetry(PlantConfig(airframe=airframe, seed=number), 30.0, LinkSpec("qdrone2", 100.0))
        return Log(f"{label} {number}", telemetry.digest, "qdrone2", telemetry)

    def teach(logs: Sequence[Log]) -> Baseline:
        return learn(logs, options, created=CREATED)

    for number in range(airframes):
        airframe, rng = specimen(seed, number, qdrone2()), np.random.default_rng([seed, number])
        first = 10 * seed + 1000 * number
        healthy = [flight(airframe, first + i, "healthy") for i in range(5)]
        others = [flight(in_session(airframe, rng), first + 100 + i, "session") for i in range(10)]
        others += [flight(with_propellers(airframe, 0.01, rng), first + 200 + i, "propellers") for i in range(10)]
        front = front_of(teach(healthy))
        own, judged = (
            [Flown(log.name.split()[0], False, log, airborne(front, log).rows) for log in logs]
            for logs in (healthy, others)
        )
        for one, flagged in fold(own, judged, teach, len(own), crazyflie=False):
            for name, yes in flagged.items():
                count.setdefault(name, Counter())[one.label] += yes
    for name, found in count.items():
        table.add_row(name, *(f"{found[label]}/{10 * airframes}" for label in ("session", "propellers")))
    return table


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--airframes", type=int, default=3)
    parser.add_argument("--seed", type=int, default=4100)
    arguments = parser.parse_args()
    console = Console(width=150, highlight=False)
    console.print(recorded(arguments.folder))
    console.print(emulated(arguments.airframes, arguments.seed))


if __name__ == "__main__":
    main()
