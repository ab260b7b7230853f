"""The least damage that the product finds, beside what a matched filter could find in the same noise.

    python benchmarks/least_damage.py [--flights 12] [--airframes 3] [--seed 700] [--workers 2]

Airframes are drawn, every second one aged. Each teaches a baseline with 5 healthy squares of 30 s, by the defaults.
Fresh flights of 30 s are judged: one rotor is damaged at a drawn time 35 to 45 % through and stays so. For each flight
the size is bisected, with everything else equal, in six steps over the range below, until it is known within
4 %: found means that the decision comes to "fault" after the onset. The least sizes s of the flights are taken to be
log-normal, so with their mean and standard deviation m, sd of ln s,

    found in 50 %:  exp(m),  95 % interval by Student's t
    found in 95 %:  exp(m + 1.645 sd),  95 % interval by the noncentral t (tolerance limits)

The intervals count flights as independent, and there are few airframes. Flights that are declared a fault without any
damage, or not found at the upper end of the range (beyond it a flight may look like another vehicle's, which is not
judged), are counted beside and left out of the fit.

Damage: unbalance alone; thrust alone, its drag kept; thrust and drag lost alike, as with a shorter blade.

The matched filter knows the form of what it looks for, and looks at all T seconds from the onset at once, where the
monitors look at 0.5 s of vibration and 5 s of trim. It alarms as often as the monitor's own share b of the budget
allows, P_F = b T in windows of T. Equations with E the energy of the signal and N0 the one-sided density of the noise:

    d' = sqrt(2 E/N0)                                       Kay, Fundamentals of Statistical Signal Processing II, ch. 4

Unbalance of U g mm is a line in ax and in ay, of known frequency and unknown phase, amplitude A = g U Omega^2/m each,
g what mount, on-chip filter pass of it. Both axes together have E = A^2 T. N0 is that of the accelerometer: what its
filter passes, folded into half the rate, with the steps of 1 mG that the link rounds to. Healthy rotors turn with lines
of their own, of power A_h^2/2 on each axis in the band W over which the speeds of rotors scatter. With them
N0 = N_sensor + sum(A_h^2)/2/max(W, 1/T). The statistic is chi-squared of 2 degrees, noncentral by d'^2:

    P_F = exp(-c/2),    P_D = P(chi^2_2(d'^2) > c)

Below 400 Hz the line is folded; that the flight's own motion shakes there, too, is not in this limit.

Thrust lost, a share e of rotor j's, moves the trim by the vector M = C w, w_j = e/2, for thrust goes with the square of
the speed. Where the drag stays, yaw turns the other rotors, too: w_i = -s_i s_j e/8 in addition, s the sense of
rotation, and yaw shows nothing. With S the covariance of healthy trim means over 5 s about the healthy mean, white:

    d' = sqrt(M' S^-1 M T/5 s),    P_D = Phi(d' - z),    z = Phi^-1(1 - P_F/4),  one of four rotors
"""

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import brentq
from scipy.stats import nct, ncx2, norm, t

from mavdiag.airframe.trim import source_among, sources_of, trim_of
from mavdiag.baseline import Baseline, dump, parse
from mavdiag.chain import front_of
from mavdiag.decision.diagnosis import Stage
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn, rows_of
from mavdiag.telemetry import FloatArray, Log
from mavdiag.units import G_MM_PER_KG_M, NS_PER_S, S_PER_H
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.campaign.plan import CALM, built, parse_link
from sitl_plant.campaign.worker import CREATED, specimen
from sitl_plant.physics.airframe import Airframe
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.physics.parameters import STEP_S
from sitl_plant.physics.sensors import gain_of, mode
from sitl_plant.plant import Plant, PlantConfig
from sitl_plant.vehicle import airframe_of, qdrone2

LINKS = ("qdrone2@1000", "qdrone2@200", "qdrone2@100")
ISOLATION = "isolation-10"
MOUNTS = {CALM: "bolted on", ISOLATION: "x 1/10"}
DURATION_S, LEARN_FLIGHTS, ONSET = 30.0, 5, (0.35, 0.45)
STEPS = 6
SEEN_S = DURATION_S * (1.0 - sum(ONSET) / 2)  # T
TRIM_S, VIBRATION_S = 5.0, 0.5  # windows of the product's monitors
MG_M_S2 = 9.80665e-3  # a step of RAW_IMU on this link
FILTER_NOISE = math.pi / (2 * math.sqrt(2))  # noise bandwidth of a second-order Butterworth filter over its corner


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of damage: the range of sizes in its unit, and what a size does to a rotor."""

    unit: str
    low: float
    high: float
    damage: Callable[[float], RotorDamage]


KINDS = {
    "unbalance": Kind("g mm", 0.1, 12.8, lambda size: RotorDamage(unbalance_g_mm=size)),
    "thrust alone": Kind("%", 0.5, 32.0, lambda size: RotorDamage(thrust_factor=1 - size / 100)),
    "thrust and drag": Kind(
        "%", 0.5, 32.0, lambda size: RotorDamage(thrust_factor=1 - size / 100, drag_factor=1 - size / 100)
    ),
}


@dataclass(frozen=True, slots=True)
class Setup:
    """An airframe on a link: its number, the seed of the run, link and condition of its mount."""

    seed: int
    number: int
    link: str
    mount: str

    def airframe(self) -> Airframe:
        """The specimen."""
        return specimen(self.seed, self.number, built(qdrone2(), self.mount))

    def flight(self, seed: int, injections: tuple[Injection, ...] = ()) -> Log:
        """One flight over the link."""
        config = PlantConfig(airframe=self.airframe(), seed=seed, injections=injections)
        telemetry, _ = flight_telemetry(config, DURATION_S, parse_link(self.link))
        return Log(f"flight {seed}", telemetry.digest, "qdrone2", telemetry)

    def healthy(self) -> list[Log]:
        """The flights that teach."""
        return [self.flight(self.seed + 10_000 + 100 * self.number + i) for i in range(LEARN_FLIGHTS)]


@dataclass(frozen=True, slots=True)
class Taught:
    """A baseline as text, and the matched filter's limits by kind: at 50 and 95 %, or empty."""

    baseline: str
    limits: dict[str, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Least:
    """The least size found in a flight; infinite if not even the largest was. by: the monitor that found it."""

    size: float
    by: str
    flagged_healthy: bool = False


def teach(setup: Setup) -> Taught:
    """Learn, and work out the limits."""
    flights, airframe = setup.healthy(), setup.airframe()
    options = LearnOptions(airframe=airframe_of(airframe.vehicle, airframe.name))
    baseline = learn(flights, options, created=CREATED)
    limits = {"unbalance": line_limits(setup, airframe, baseline)}
    if setup.mount == CALM:
        covariance = trim_covariance(baseline, flights)
        signs = np.array([rotor.sign for rotor in airframe.vehicle.rotors])
        for kind in ("thrust alone", "thrust and drag"):
            limits[kind] = trim_limits(baseline, covariance, signs if kind == "thrust alone" else 0 * signs)
    return Taught(dump(baseline), limits)


def budget_of(baseline: Baseline, name: str) -> float:
    """A monitor's share of alarms per hour; where there is no such monitor, that of the first which decides."""
    shares = {entry.spec.kind: entry.threshold.budget_per_hour for entry in baseline.monitors}
    return shares.get(name, shares["innovation"])


def line_limits(setup: Setup, airframe: Airframe, baseline: Baseline) -> tuple[float, ...]:
    """Least unbalance [g mm]: against the sensor in 0.5 s and in T, and against sensor and healthy lines in T."""
    imu, vehicle, rate_hz = airframe.vehicle.imu, airframe.vehicle, parse_link(setup.link).rate_hz or 1000.0
    known = airframe_of(vehicle, "")
    assert known.hover_rad_s is not None
    line_hz = known.hover_rad_s / (2 * math.pi)
    passed = 1 / math.sqrt(1 + (line_hz / imu.filter_hz) ** 4)
    if imu.mount is not None:
        mount = mode(imu.mount.resonance_hz, imu.mount.damping_ratio, STEP_S)
        passed *= float(gain_of(mount, line_hz, STEP_S))
    per_g_mm = passed * known.hover_rad_s**2 / (G_MM_PER_KG_M * vehicle.body.mass_kg)
    variance = imu.accel_noise_density**2 * min(FILTER_NOISE * imu.filter_hz, 0.5 / STEP_S) + MG_M_S2**2 / 12
    sensor = variance / (rate_hz / 2)
    speeds = Plant(PlantConfig(airframe=airframe, seed=setup.seed + 9_000)).advance(10_000).rotor_speed
    band_hz = math.sqrt(12) * float(speeds.std()) / (2 * math.pi)  # an even band with this standard deviation
    lines = float(np.square(airframe.unbalance_g_mm).sum()) * per_g_mm**2 / 2 / max(band_hz, 1 / SEEN_S)
    share = budget_of(baseline, "unbalance") / S_PER_H
    cases = ((sensor, VIBRATION_S), (sensor, SEEN_S), (sensor + lines, SEEN_S))
    return tuple(
        power_distance(share * span_s, found) * math.sqrt(noise / (2 * span_s)) / per_g_mm
        for noise, span_s in cases
        for found in (0.5, 0.95)
    )


def power_distance(false_alarm: float, found: float) -> float:
    """d' with which a line of unknown phase is found."""
    c = -2 * math.log(false_alarm)
    return float(brentq(lambda d: ncx2.sf(c, 2, d * d) - found, 1e-3, 20.0))


def trim_covariance(baseline: Baseline, flights: Sequence[Log]) -> FloatArray:
    """S: (3, 3) of means over 5 s that share no row, about the mean of all flights."""
    front, layout, means = front_of(baseline), baseline.airframe.layout, []
    assert layout is not None
    for rows in (rows_of(front, log.telemetry) for log in flights):
        source = source_among([sources_of(rows, layout)], layout)
        trims = [trim_of(one.block, layout, source) for one in rows]
        trim = np.concatenate([values[known] for values, known in trims])
        size = round(TRIM_S / rows[0].block.dt_s)
        means.append(trim[: len(trim) // size * size].reshape(-1, size, 3).mean(axis=1))
    return np.cov(np.concatenate(means).T)


def trim_limits(baseline: Baseline, covariance: FloatArray, signs: FloatArray) -> tuple[float, ...]:
    """Least loss [%] in 5 s and in T, for the mean d' of the rotors. signs: of rotation; zeros where drag is lost."""
    layout = baseline.airframe.layout
    assert layout is not None
    w = np.eye(len(signs)) / 2 - np.outer(signs, signs) / 8
    shifts = layout.unmixing @ w
    distance = float(np.sqrt(np.einsum("ki,kl,li->i", shifts, np.linalg.inv(covariance), shifts)).mean())
    share = budget_of(baseline, "rotor_trim") / S_PER_H
    return tuple(
        100 * (norm.isf(share * span_s / len(signs)) + norm.ppf(found)) / (distance * math.sqrt(span_s / TRIM_S))
        for span_s in (TRIM_S, SEEN_S)
        for found in (0.5, 0.95)
    )


def found_by(setup: Setup, baseline: Baseline, kind: Kind, seed: int, size: float) -> str:
    """The monitor that declares a fault after the onset; empty if none does."""
    rng = np.random.default_rng([setup.seed, seed])
    onset_s, rotor = DURATION_S * float(rng.uniform(*ONSET)), int(rng.integers(1, 5))
    angle = float(rng.uniform(0, 2 * math.pi))
    damage = (Injection(kind.damage(size), rotor, onset_s, angle_rad=angle),) if size else ()
    changes = judge(setup.flight(seed, damage), baseline).changes
    return next(
        (c.monitor or "" for c in changes if c.stage is Stage.FAULT and c.t_ns >= round(onset_s * NS_PER_S)), ""
    )


def least(job: tuple[Setup, str, int], taught: dict[Setup, Taught]) -> Least:
    """Bisect the size in one flight."""
    setup, name, seed = job
    baseline, kind = parse(taught[setup].baseline), KINDS[name]
    find = partial(found_by, setup, baseline, kind, seed)
    if find(0.0):
        return Least(math.inf, "", flagged_healthy=True)
    low, high, by = math.log(kind.low), math.log(kind.high), find(kind.high)
    if not by:
        return Least(math.inf, "")
    for _ in range(STEPS):
        middle = (low + high) / 2
        if monitor := find(math.exp(middle)):
            high, by = middle, monitor
        else:
            low = middle
    return Least(math.exp((low + high) / 2), by)


def interval(sizes: Sequence[float], found: float) -> str:
    """The size found in that share of flights, with its 95 % interval."""
    x, n, z = np.log(sizes), len(sizes), float(norm.ppf(found))
    centre, scale = float(x.mean()), float(x.std(ddof=1)) / math.sqrt(n)
    low, high = (t.ppf(p, n - 1) if z == 0 else nct.ppf(p, n - 1, z * math.sqrt(n)) for p in (0.025, 0.975))
    at = centre + z * scale * math.sqrt(n)
    return f"{math.exp(at):.2g} ({math.exp(centre + low * scale):.2g} to {math.exp(centre + high * scale):.2g})"


def row(name: str, setups: Sequence[Setup], found: Sequence[Least], taught: dict[Setup, Taught]) -> list[str]:
    """A line of the table."""
    sizes = [one.size for one in found if math.isfinite(one.size)]
    flagged = sum(one.flagged_healthy for one in found)
    shares = [interval(sizes, share) for share in (0.5, 0.95)] if len(sizes) > 2 else ["not found"] * 2
    by = Counter(one.by for one in found if one.by).most_common(2)
    limits = np.mean([taught[setup].limits[name] for setup in setups], axis=0).reshape(-1, 2)
    return [
        f"{name} [{KINDS[name].unit}]",
        setups[0].link.partition("@")[2],
        MOUNTS[setups[0].mount],
        *shares,
        ", ".join(f"{monitor} {count}" for monitor, count in by),
        f"{len(found) - len(sizes) - flagged}, {flagged} of {len(found)}",
        *(f"{a:.2g}, {b:.2g}" for a, b in limits),
        *[""] * (3 - len(limits)),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=12, help="for each row, shared by the airframes")
    parser.add_argument("--airframes", type=int, default=3)
    parser.add_argument("--seed", type=int, default=700)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    start_s, seed = time.monotonic(), arguments.seed
    rows = [(kind, link, CALM) for kind in KINDS for link in LINKS]
    rows += [("unbalance", link, ISOLATION) for link in LINKS]
    setups = {
        (link, mount): [Setup(seed, number, link, mount) for number in range(arguments.airframes)]
        for _, link, mount in rows
    }
    every = [setup for group in setups.values() for setup in group]
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        taught = dict(zip(every, pool.map(teach, every), strict=True))
        jobs = [
            (setups[link, mount][i % arguments.airframes], kind, seed + 20_000 + i)
            for kind, link, mount in rows
            for i in range(arguments.flights)
        ]
        found = list(pool.map(partial(least, taught=taught), jobs))
    table = Table(title=f"Least damage: {arguments.flights} flights a row, seed {seed}")
    for heading in ("damage", "link Hz", "IMU", "found in 50 %", "found in 95 %", "found by", "missed, false"):
        table.add_column(heading)
    for span in ("its window", f"{SEEN_S:g} s", f"{SEEN_S:g} s, healthy lines"):
        table.add_column(f"limit 50, 95 %: {span}")
    for i, (kind, link, mount) in enumerate(rows):
        own = found[i * arguments.flights : (i + 1) * arguments.flights]
        table.add_row(*row(kind, setups[link, mount], own, taught))
    Console(width=200, highlight=False).print(table)
    print(f"{arguments.airframes} airframes, {time.monotonic() - start_s:.0f} s")


if __name__ == "__main__":
    main()
