"""The daemon's verdicts over a bad link against those of the same flights over a perfect one, on a virtual clock.

    python benchmarks/bad_link.py [--seed 9100] [--healthy 10] [--rates 1000 100]

The emulated quadrotor sends everything that its profile has; its messages go through `mavdiag.link.shim` (loss 5 %,
duplicates 1 %, reorder depth 3, jitter of 10 ms up and down, which at 1 kHz alone reorders by up to 45 places) into the
daemon's fleet. Nine thesis faults, each on the rotors in turn, begin at 12 s; healthy flights are of the same specimen.
For each rate: when each fault was declared first and with which rotor, the loss that the sequence numbers show against
the true one, and events and declared faults of the healthy flights.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

from virtual_link import Heard, heard

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.shim import Impairment, Shim
from mavdiag.telemetry import Log
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.emulator import recorded
from sitl_plant.options import FlightPlan
from sitl_plant.plant import PlantConfig

BAD = Impairment(loss=0.05, jitter_s=0.010, reorder=3, duplicate=0.01)
FAULTS = tuple(f"F{kind}/SV{severity}" for kind in (1, 2, 3) for severity in (1, 2, 3))
SHAPES = ("square", "hover", "circle", "figure8")
ONSET_S, FAULTY_S, HEALTHY_S, TAUGHT_S = 12.0, 24.0, 60.0, 60.0
DRONE = 2


@dataclass(frozen=True, slots=True)
class Pair:
    """One flight over both links. true_loss: share of messages that did not come at all, of those that were sent."""

    good: Heard
    bad: Heard
    sent: int
    true_lost: int

    @property
    def counted_error(self) -> float:
        """Loss by sequence numbers less true loss, as a share of the messages sent."""
        assert self.bad.count is not None
        return (self.bad.count.lost - self.true_lost) / self.sent


def taught(rate_hz: float, seed: int) -> Baseline:
    """A baseline from four healthy flights over a perfect link."""
    logs = []
    for k, shape in enumerate(SHAPES):
        config = PlantConfig(drone=DRONE, trajectory=shape, seed=seed + k)
        telemetry, _ = flight_telemetry(config, TAUGHT_S, LinkSpec("qdrone2", rate_hz))
        logs.append(Log(f"healthy {shape}", telemetry.digest, "qdrone2", telemetry))
    options = LearnOptions(airframe=airframe_named("qdrone2"))
    return learn(logs, options, created="2026-01-01T00:00:00Z")


def flown(config: PlantConfig, rate_hz: float, seconds: float, baseline: Baseline, seed: int) -> Pair:
    """One flight over both links."""
    plan = FlightPlan(config, dialect_named("qdrone2"), rate_hz)
    frames = list(recorded(plan, seconds, lambda samples: None))
    shim = Shim(BAD, seed)
    good, bad = heard(frames, baseline), heard(frames, baseline, shim)
    return Pair(good, bad, len(frames), shim.count.lost)


def fml_s(baseline: Baseline) -> float:
    """The longest fault measuring limit of its axes: the threshold of the thesis's monitor is a multiple of it."""
    return max(entry.threshold.value for entry in baseline.monitors if entry.spec.kind == "fsd")


def first_after(found: Heard, onset_s: float) -> tuple[float | None, int | None]:
    """When a fault was declared first after its onset, and with which rotor."""
    return next(((t_s - onset_s, rotor) for t_s, rotor in found.declared if t_s >= onset_s), (None, None))


def report(rate_hz: float, seed: int, healthy: int, faults: Sequence[str] = FAULTS) -> None:
    """Print the table of one rate."""
    baseline = taught(rate_hz, seed)
    limit_s = fml_s(baseline)
    print(f"{rate_hz:g} Hz, seed {seed}, FML {limit_s:.2f} s")
    print("  fault    rotor   declared after s, motor      lost        counted less true")
    for k, fault in enumerate(faults):
        rotor = 1 + (seed + k) % 4
        config = PlantConfig(drone=DRONE, seed=seed + 100 + k, fault=fault, rotor=rotor, onset_s=ONSET_S)
        pair = flown(config, rate_hz, FAULTY_S, baseline, seed + k)
        good, bad = (first_after(found, ONSET_S) for found in (pair.good, pair.bad))
        same = (good[0] is None) == (bad[0] is None) and abs((good[0] or 0.0) - (bad[0] or 0.0)) <= limit_s
        words = [f"{'-' if late is None else f'{late:.1f}'} m{named}" for late, named in (good, bad)]
        print(
            f"  {fault}   {rotor}       {words[0]:10} bad: {words[1]:10}"
            f"  {pair.true_lost / pair.sent:6.2%}     {pair.counted_error:+.3%}   {'same' if same else 'DIFFERS'}"
        )
    pairs = []
    for k in range(healthy):
        config = PlantConfig(drone=DRONE, trajectory=SHAPES[k % 4], seed=seed + 500 + k, wind_m_s=k % 3)
        pairs.append(flown(config, rate_hz, HEALTHY_S, baseline, seed + 500 + k))
    judged = [sum(found.judged_s for found in some) / 60 for some in ([p.good for p in pairs], [p.bad for p in pairs])]
    for name, some, minutes in (
        ("perfect", [p.good for p in pairs], judged[0]),
        ("bad", [p.bad for p in pairs], judged[1]),
    ):
        alarms, events = sum(len(one.declared) for one in some), sum(one.events for one in some)
        print(f"  healthy, {name:7} link: {minutes:.1f} min judged, {alarms} declared faults, {events} events")
    worst = max(abs(pair.counted_error) for pair in pairs) if pairs else 0.0
    print(f"  healthy, loss counted within {worst:.3%} of the messages sent", flush=True)


def main() -> None:
    """Print a table for each rate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=9100)
    parser.add_argument("--healthy", type=int, default=10)
    parser.add_argument("--rates", type=float, nargs="+", default=[1000.0, 100.0])
    options = parser.parse_args()
    for rate_hz in options.rates:
        report(rate_hz, options.seed, options.healthy)


if __name__ == "__main__":
    main()
