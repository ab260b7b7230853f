"""The daemon's session beside the emulator on one virtual clock: ground stations that reset rates, and take-offs.

    python benchmarks/live_sessions.py resets [--seconds 120] [--every 10]
    python benchmarks/live_sessions.py takeoffs [--flights 50] [--profile qdrone2] [--rate 200]

resets: a ground station on the vehicle's own link sets all rates to 4 Hz, by REQUEST_DATA_STREAM or by
SET_MESSAGE_INTERVAL. Printed: the share of the time in which a monitor that decides about propellers judged, from 15 s
of flight on, and how often the detector asked.

takeoffs: flights from the ground and back to it, judged by a baseline of other such flights with the live gate; every
CRITICAL or WARNING text counts.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
from made_vehicle import Bench
from virtual_flight import GroundStation, VirtualFlight, healthy_flights, learnt

from detector.config import Settings
from mavdiag.baseline import Baseline
from mavdiag.link.messages import MessageId
from sitl_plant.plant import PlantConfig

SETTLED_S = 15.0
LANDED_S = 26.0  # of a take-off: 8 s to the path, 12 s of it, and down
LOUD = ("CRITICAL", "WARNING")
STREAMS = (MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET, MessageId.SERVO_OUTPUT_RAW, MessageId.ATTITUDE)
SHAPES, NOSES = ("square", "hover", "circle", "figure8"), ("fixed", "path")


def bench_for(baseline: Baseline) -> Bench:
    """A daemon that judges by it."""
    return Bench(Settings(connect="udpin:127.0.0.1:0", baseline=Path("baseline.json")), baseline=baseline)


def resets(seconds: float, every_s: float) -> None:
    """Both kinds of ground stations, and none."""
    baseline = learnt(healthy_flights(range(3), 40.0))
    stations = {
        "none": None,
        "REQUEST_DATA_STREAM": replace(GroundStation.of(), every_s=every_s),
        "SET_MESSAGE_INTERVAL": replace(GroundStation.of(*STREAMS), every_s=every_s),
    }
    for name, station in stations.items():
        bench = bench_for(baseline)
        flight = VirtualFlight(bench, station)
        flight.fly(PlantConfig(seed=9), seconds)
        asked = sum("asked for RAW_IMU" in line for line in bench.host.lines)
        loud = sum(any(word in line for word in LOUD) for line in bench.host.lines)
        state = bench.daemon.fleet.vehicles[1].session.state
        bench.close()
        changes = len(station.times) if station else 0
        begun = next(one for one in flight.judged_s if one[0] >= SETTLED_S)
        span_s, judged_s = np.subtract(flight.judged_s[-1], begun)
        share = 100 * judged_s / span_s
        print(
            f"{name}: {changes} resets, judged {share:.1f} %, RAW_IMU asked for {asked} times, {loud} alarms; {state}"
        )


def takeoffs(flights: int, first: int, profile: str, rate_hz: float | None) -> None:
    """Healthy flights from the ground to the ground."""
    began = time.monotonic()
    taught = [
        healthy_flights([seed], 40.0, profile, rate_hz, start="ground", landed_s=40.0, trajectory=shape, nose=nose)[0]
        for seed, (shape, nose) in enumerate((shape, nose) for shape in SHAPES for nose in NOSES)
    ]
    baseline = learnt(taught)
    print(f"learnt from {len(taught)} flights, {len(baseline.monitors)} monitors, {time.monotonic() - began:.0f} s")
    suspicions = alarms = 0
    judged_s = 0.0
    for number in range(first, first + flights):
        shape, nose = SHAPES[number % 4], NOSES[number // 4 % 2]
        config = PlantConfig(seed=1000 + number, start="ground", landed_s=LANDED_S, trajectory=shape, nose=nose)
        bench = bench_for(baseline)
        flight = VirtualFlight(bench)
        flight.fly(config, LANDED_S + 1.0, profile, rate_hz)
        bench.close()
        judged_s += flight.judged_s[-1][1]
        print(f"  {number + 1 - first} flown, {judged_s:.0f} s judged", file=sys.stderr, flush=True)
        texts = [line for line in bench.host.lines if any(word in line for word in LOUD)]
        alarms += sum("CRITICAL" in text for text in texts)
        suspicions += sum("WARNING" in text for text in texts)
        for text in texts:
            print(f"  seed {config.seed} {shape} {nose}: {text}", flush=True)
    print(
        f"{profile}, {flights} take-offs and landings, {judged_s:.0f} s judged: "
        f"{alarms} alarms, {suspicions} suspicions"
    )


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("resets", "takeoffs"))
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--every", type=float, default=10.0)
    parser.add_argument("--flights", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="number of the first flight, to share them out")
    parser.add_argument("--profile", default="ardupilot")
    parser.add_argument("--rate", type=float, default=None)
    options = parser.parse_args()
    if options.what == "resets":
        resets(options.seconds, options.every)
    else:
        takeoffs(options.flights, options.first, options.profile, options.rate)


if __name__ == "__main__":
    main()
