"""Hardware in the loop: a small autopilot flies the plant over ArduPilot's bytes, and the library watches it.

    python benchmarks/hil.py [--healthy-s 600] [--exchanges 20000]

Exchanges: the command `sitl-plant serve-ardupilot` in a process of its own, over UDP on this machine, frames of 1 ms.
Detection: the same bytes without sockets, frames of 2.5 ms. The baseline is learnt from five flights of about 40 s with
squares and turns of the nose. Then each of the thesis's nine faults comes 15 s after a take-off, on rotors 1 to 4 in
turn, and a healthy flight is judged as long as asked. Telemetry is what the emulator's stream makes of the plant's
samples and the autopilot's set-points (profile qdrone2, 1 kHz).
"""

import argparse
import json
import socket
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, fields, replace

import numpy as np
from reference_pilot import Commanded, Course, Pilot, Sensed

from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change, Stage
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.samples import joined
from mavdiag.telemetry import Log, Telemetry
from sitl_plant.autopilot.telemetry import LinkSpec, TelemetryStream
from sitl_plant.hil.ardupilot import Lockstep
from sitl_plant.hil.simulation import Simulation, output_map
from sitl_plant.physics.faults import FAULTS, Injection, fault_injection
from sitl_plant.plant import PlantConfig, PlantSamples
from sitl_plant.vehicle import airframe_of, qdrone2

BLOCK = 1000  # frames
ONSET_S, WITHIN_S = 15.0, 5.0
PILOT_HZ = 400  # as ArduCopter's loop


def frame(count: int, duties: tuple[float, ...], rate_hz: int) -> bytes:
    """A servo frame of ArduPilot with 16 channels."""
    pwm = [round(1000 + 1000 * duty) for duty in duties] + [0] * (16 - len(duties))
    return struct.pack("<HHI16H", 18458, rate_hz, count, *pwm)


def sensed(answer: bytes) -> Sensed:
    """What ArduPilot reads in an answer."""
    found = json.loads(answer)
    return Sensed(found["timestamp"], found["imu"]["gyro"], found["position"], found["velocity"], found["quaternion"])


class Recorder:
    """Telemetry of a flight: the plant's samples, with the set-points of the autopilot that commanded them."""

    def __init__(self, seed: int, rotors: int) -> None:
        self.commanded = Commanded((0.0,) * rotors, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
        self._stream = TelemetryStream(LinkSpec("qdrone2"), seed, rotors)
        self._rows: list[PlantSamples] = []
        self._pieces: list[Telemetry] = []

    def watch(self, samples: PlantSamples, changes: object) -> None:
        """Take the samples of one frame."""
        n, one = len(samples), self.commanded
        self._rows.append(
            replace(
                samples,
                setpoint=np.tile(one.setpoint, (n, 1)),
                rate_setpoint=np.tile(one.rates, (n, 1)),
                thrust_setpoint=np.full(n, one.thrust),
            )
        )
        if len(self._rows) == BLOCK:
            self._send()

    def telemetry(self) -> Telemetry:
        """All of it."""
        if self._rows:
            self._send()
        return joined(self._pieces)

    def _send(self) -> None:
        columns = (np.concatenate([getattr(row, name.name) for row in self._rows]) for name in fields(PlantSamples))
        self._pieces.append(self._stream.step(PlantSamples(*columns)))
        self._rows.clear()


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight that was recorded. takeoff_s: when it left the ground."""

    log: Log
    takeoff_s: float


def fly(course: Course, seed: int, faults: tuple[Injection, ...] = (), until_s: float | None = None) -> Flight:
    """Fly a course over the bytes of ArduPilot's protocol."""
    vehicle = qdrone2()
    recorder = Recorder(seed, len(vehicle.rotors))
    simulation = Simulation(PlantConfig(drone=2, seed=seed, wind_m_s=0.5), faults, recorder.watch)
    outputs = output_map(vehicle, "ardupilot")
    lockstep = Lockstep(simulation, outputs)
    pilot = Pilot(vehicle, [int(rotor) + 1 for rotor in np.argsort(outputs.places)], course.at)
    count, end_s = 0, course.end_s if until_s is None else until_s
    while simulation.t_s < end_s:
        answer = lockstep.feed(frame(count, recorder.commanded.duties, PILOT_HZ), "here", 0.0)
        assert answer is not None
        recorder.commanded = pilot.step(sensed(answer))
        count += 1
    assert simulation.takeoff_s is not None
    telemetry = recorder.telemetry()
    return Flight(Log(f"seed {seed}", telemetry.digest, "qdrone2", telemetry), simulation.takeoff_s)


def taught() -> Baseline:
    """The baseline of five healthy flights."""
    shapes = ((2.0, 0.8), (1.5, 0.6), (1.0, 0.5), (2.0, 1.0), (1.5, 0.8))
    flights = [fly(Course(side_m=side, speed_m_s=speed, loops=2), seed) for seed, (side, speed) in enumerate(shapes)]
    return learn(
        [one.log for one in flights], LearnOptions(airframe=airframe_of(qdrone2(), "qdrone2")), created="1970-01-01"
    )


def first_fault(changes: tuple[Change, ...]) -> Change | None:
    """The first declared fault."""
    return next((one for one in changes if one.stage is Stage.FAULT), None)


def detection(base: Baseline) -> None:
    """The nine faults."""
    right = 0
    for number, code in enumerate(FAULTS):
        rotor = 1 + number % 4
        cause = fault_injection(code, rotor, ONSET_S)
        flight = fly(Course(side_m=1.5, loops=4), 100 + number, (cause,), until_s=ONSET_S + 12.0)
        verdict, onset_s = judge(flight.log, base), flight.takeoff_s + ONSET_S
        early = [one for one in verdict.changes if one.t_ns * 1e-9 < onset_s and one.stage is not Stage.QUIET]
        named = [
            (one.t_ns * 1e-9 - onset_s, one.rotor)
            for one in verdict.changes
            if one.stage is Stage.FAULT and onset_s <= one.t_ns * 1e-9 <= onset_s + WITHIN_S and one.rotor
        ]
        first = first_fault(verdict.changes)
        ok = bool(named) and named[-1][1] == rotor
        right += ok
        told = f"{named[0][1]} after {named[0][0]:.2f} s, at 5 s {named[-1][1]}" if named else "not named"
        since = "never" if first is None else f"{first.t_ns * 1e-9 - onset_s:.2f} s by {first.monitor}"
        print(f"  {code} on rotor {rotor}: fault {since}; rotor {told}{'' if ok else '  WRONG'}"
              f"{f'; {len(early)} changes before the onset' if early else ''}", flush=True)  # fmt: skip
    print(f"right rotor within {WITHIN_S:g} s: {right} of {len(FAULTS)}")


def healthy(base: Baseline, span_s: float) -> None:
    """A healthy flight."""
    loops = round(span_s / (Course().leg_s * 4 + Course().turn_s)) + 1
    verdict = judge(fly(Course(loops=loops), 200).log, base)
    told = [one for one in verdict.changes if one.stage in (Stage.FAULT, Stage.SUSPECTED)]
    print(f"healthy: {verdict.judged_s:.0f} s judged, {len(told)} faults and suspicions; {verdict.verdict.value}")


def exchanges(wanted: int) -> None:
    """How fast a served plant answers."""
    command = [sys.executable, "-m", "sitl_plant", "serve-ardupilot", "--listen", "udpin:127.0.0.1:0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        port = int(server.stdout.readline().rpartition(":")[2])
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.connect(("127.0.0.1", port))
        link.settimeout(5.0)
        took = np.empty(wanted)
        for count in range(wanted):
            start_s = time.perf_counter()
            link.send(frame(count, (0.5, 0.5, 0.5, 0.5), 1000))
            link.recv(2048)
            took[count] = time.perf_counter() - start_s
        link.close()
    finally:
        server.terminate()
        server.wait(10.0)
    half, most = 1e3 * np.quantile(took, [0.5, 0.99])
    print(f"exchanges: {len(took) / took.sum():.0f}/s over UDP; {half:.2f} ms (half), {most:.2f} ms (99 %)")


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--healthy-s", type=float, default=600.0)
    parser.add_argument("--exchanges", type=int, default=20_000)
    options = parser.parse_args()
    exchanges(options.exchanges)
    base = taught()
    print(f"learnt: {', '.join(dict.fromkeys(one.spec.kind for one in base.monitors))}")
    for one in base.not_judgeable:
        print(f"  not {one.monitor}: {one.reason}")
    detection(base)
    healthy(base, options.healthy_s)


if __name__ == "__main__":
    main()
