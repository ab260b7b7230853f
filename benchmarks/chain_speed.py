"""What the streaming chain costs for each pair of set-point and IMU sample, after decoding.

    python benchmarks/chain_speed.py [--seconds 60] [--repeats 5]

The same flight of the emulator goes through the chain in blocks, as the daemon cuts it. The peer in the same run is
the work that no chain can avoid: the Savitzky-Golay filters and a free-run model by scipy, over the flight at once.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from emulated import as_flight
from scipy.signal import lfilter, savgol_filter

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline
from mavdiag.chain import chain_of
from mavdiag.learning import LearnOptions, learn, thesis_options
from mavdiag.telemetry import Axis, IntArray, Signal, Telemetry
from mavdiag.units import NS_PER_S
from sitl_plant.plant import PlantConfig

STAMP = "1970-01-01T00:00:00+00:00"


def blocks(telemetry: Telemetry, edges_ns: IntArray) -> list[Telemetry]:
    """The telemetry in pieces that begin at these times of the receiver's clock, as a live link brings it."""
    cuts = [np.append(np.searchsorted(one.host_ns, edges_ns), len(one)) for one in telemetry]
    pieces = []
    for i in range(len(edges_ns)):
        rows = [
            (one, slice(cut[i], cut[i + 1])) for one, cut in zip(telemetry, cuts, strict=True) if cut[i] < cut[i + 1]
        ]
        pieces.append(Telemetry(tuple(one.where(at) for one, at in rows)))
    return pieces


def chain_seconds(baseline: Baseline, pieces: list[Telemetry]) -> float:
    """CPU time of the whole flight through the chain."""
    chain = chain_of(baseline)
    state, started = chain.start(), time.process_time()
    for piece in pieces:
        chain.step(state, piece)
    return time.process_time() - started


def peer_seconds(baseline: Baseline, telemetry: Telemetry) -> float:
    """CPU time of filters and models by scipy, all at once."""
    setpoint, gyro = telemetry[Signal.ATTITUDE_SETPOINT].values, telemetry[Signal.BODY_RATE].values
    window, model = baseline.window, baseline.monitors[0].spec.model
    started = time.process_time()
    u = savgol_filter(setpoint, window.samples, window.order, deriv=1, delta=baseline.link.dt_s, axis=0)
    y = savgol_filter(gyro, window.samples, window.order, axis=0)
    np.abs(y[:, 0] - lfilter(model.b, model.a, u[:, 0])).max()
    return time.process_time() - started


def best(repeats: int, run: Callable[[], float]) -> float:
    """Median of the runs."""
    return statistics.median(run() for _ in range(repeats))


def main() -> None:
    """Print microseconds for each pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    flights = [as_flight(PlantConfig(seed=seed), 30.0) for seed in range(4)]
    telemetry = as_flight(PlantConfig(seed=99), arguments.seconds).telemetry
    pairs = len(telemetry[Signal.BODY_RATE])
    start, stop = min(int(one.host_ns[0]) for one in telemetry), max(int(one.host_ns[-1]) for one in telemetry)
    everything = LearnOptions(axes=(Axis.ROLL,), airframe=airframe_named("qdrone2"))
    contenders = (("thesis rule", thesis_options()), ("all monitors", everything))
    for name, options in contenders:
        baseline = learn(flights, options, created=STAMP)
        peer = 1e6 * best(arguments.repeats, partial(peer_seconds, baseline, telemetry)) / pairs
        for block_s in (0.04, 0.1, 0.25):
            pieces = blocks(telemetry, np.arange(start, stop + 1, round(block_s * NS_PER_S)))
            cost = 1e6 * best(arguments.repeats, partial(chain_seconds, baseline, pieces)) / pairs
            print(f"{name}, blocks of {1e3 * block_s:.0f} ms: {cost:.2f} us a pair, {cost / peer:.1f} x the peer")


if __name__ == "__main__":
    main()
