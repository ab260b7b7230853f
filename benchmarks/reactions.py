"""Reactions flown by emulator and daemon on one virtual clock: the thesis's nine faults, three places, some seeds.

    python benchmarks/reactions.py [--seeds 5] [--faults 9] [--healthy-h 10] [--calls 9]

A commanded vehicle (profile qdrone2, 200 Hz) takes off, and hovers, goes to and fro at 1 m/s, or flies a mission. From
ONSET_S on a propeller of rotor 1 to 4 is damaged. The daemon has the table of `TABLE` and a baseline that was learnt
from healthy flights of that kind. Counted are, by the journal, the time from the finding to the command over the delay,
and, by the plant's truth, whether the vehicle stands on the ground, upright and disarmed, before END_S. Then flights in
which the pilot calls it off: by a mode, a stick, an acknowledgement. Then healthy flight: no command at all.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from made_vehicle import Bench
from virtual_flight import GroundStation, VirtualFlight, learnt

from detector.config import Settings
from mavdiag.baseline import Baseline
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.logs.tlog import read_tlog
from sitl_plant.autopilot.dialect import Mode, dialect_named
from sitl_plant.autopilot.stream import to_global
from sitl_plant.physics.faults import FAULTS
from sitl_plant.plant import PlantConfig, PlantSamples

PLACES = ("hover", "cruise", "mission")
WAYS = ("mode", "stick", "ack")
DELAY_S, ONSET_S, END_S = 6.0, 25.0, 90.0
TAUGHT, LEARN_S = 4, 60.0  # flights of each place
TABLE = {
    "hover": f"gross loss: land; fault after {DELAY_S:g} s: land",
    "cruise": f"gross loss: land; fault after {DELAY_S:g} s: rtl",
    "mission": f"gross loss: land; fault after {DELAY_S:g} s: rtl",
}
PROFILE, RATE_HZ = "qdrone2", 200.0
HEIGHT_M, SIDE_M, LEG_S = 2.0, 4.0, 6.0
UPRIGHT_RAD, GROUND_M = math.radians(10.0), 0.15
BLOCK_S, TICK_S = 0.08, 0.01  # of the emulator: longer than usual, so that it is done sooner
AUTOPILOT, DETECTOR = (1, 1), (1, 191)
NAN = float("nan")


def degrees(north: float, east: float) -> tuple[int, int]:
    """Latitude and longitude in 1e-7 degrees."""
    latitude, longitude, _ = to_global(np.array([[north, east, 0.0]]))[0].tolist()
    return round(latitude * 1e7), round(longitude * 1e7)


@dataclass
class Station(GroundStation):
    """Flies the vehicle to its place. calls: (time [s], way) of what calls off."""

    place: str = "hover"
    calls: tuple[float, str] | None = None
    done: int = 0

    def due(self, t_s: float) -> list[bytes]:
        """What it sends at a time."""
        frames: list[bytes] = []
        while self.done < len(self.plan) and t_s >= self.plan[self.done][0]:
            frames += self.plan[self.done][1]
            self.done += 1
        return frames

    @property
    def plan(self) -> list[tuple[float, list[bytes]]]:
        """What it sends, with its time [s]."""
        if not self.times:
            self._plan = self._planned()
            self.times.append(0.0)
        return self._plan

    def _planned(self) -> list[tuple[float, list[bytes]]]:
        order = self._order
        plan = [(1.0, order(MavCmd.COMPONENT_ARM_DISARM, 1.0))]
        if self.place == "mission":
            way = [(SIDE_M * (k % 4 in (1, 2)), SIDE_M * (k % 4 in (2, 3))) for k in range(80)]
            items = [(22, 0.0, 0.0), *((16, *at) for at in way)]
            upload = [self.encoder.encode(MessageId.MISSION_COUNT, *AUTOPILOT, len(items), 0)]
            for seq, (number, north, east) in enumerate(items):
                flat = (0.0, 0.0, 0.0, NAN, *degrees(north, east), HEIGHT_M, 0)
                upload.append(self.encoder.encode(MessageId.MISSION_ITEM_INT, *AUTOPILOT, seq, 6, number, 0, 1, *flat))
            return [(0.5, upload), *plan, (1.5, order(MavCmd.MISSION_START))]
        plan.append((1.5, order(MavCmd.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, HEIGHT_M)))
        if self.place == "cruise":
            for leg in range(150):
                there = degrees(SIDE_M * (1 - leg % 2), 0.0)
                fields = (*AUTOPILOT, 6, MavCmd.DO_REPOSITION, 0, 0, 1.0, 0.0, 0.0, NAN, *there, HEIGHT_M)
                plan.append((8.0 + LEG_S * leg, [self.encoder.encode(MessageId.COMMAND_INT, *fields)]))
        return plan

    def _order(self, command: int, *parameters: float) -> list[bytes]:
        return [self.encoder.encode(MessageId.COMMAND_LONG, *AUTOPILOT, command, 0, *parameters)]

    def call_off(self, way: str) -> tuple[list[bytes], list[bytes]]:
        """What calls off: on the vehicle's link, and on the link behind the detector."""
        if way == "mode":
            manual = dialect_named(PROFILE).shown(Mode.MANUAL)
            return [self.encoder.encode(MessageId.SET_MODE, 1, 1, manual)], []
        if way == "stick":
            return [], [self.encoder.encode(MessageId.MANUAL_CONTROL, 1, 400, 0, 500, 0, 0)]
        return [], [self.encoder.encode(MessageId.COMMAND_LONG, *DETECTOR, MavCmd.USER_1, 0, *[0.0] * 7)]


@dataclass
class Flown:
    """What came of a flight. late_s: from the end of the delay to the command; None if none came."""

    declared_s: float | None = None
    late_s: float | None = None
    announced: bool = False
    called_off: bool = False
    commands: list[str] = field(default_factory=list)
    down: bool = False  # on the ground, upright, disarmed
    flown_s: float = 0.0
    judged: float = 0.0  # share


@cache
def baseline(place: str) -> Baseline:
    """Learnt from healthy flights of this kind, as the link brings them."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{seed}.tlog" for seed in range(TAUGHT)]
        for seed, path in enumerate(paths):
            fly(place, seed, until_s=LEARN_S, record=path)
        return learnt([read_tlog(path) for path in paths])


def fly(
    place: str,
    seed: int,
    fault: str | None = None,
    *,
    call: str | None = None,
    until_s: float = END_S,
    record: Path | None = None,
) -> Flown:
    """One flight. call: how it is called off, 2 s after it was announced. record: a flight to learn from."""
    goal: dict[str, object] = {"learn": 1e6} if record else {"baseline": Path("-"), "on_fault": TABLE[place]}
    settings, known = Settings.model_validate(goal), None if record else baseline(place)
    onset = {} if fault is None else {"fault": fault, "rotor": 1 + seed % 4, "onset_s": ONSET_S}
    config = PlantConfig(drone=2, trajectory="commanded", start="ground", seed=seed, wind_m_s=0.5, **onset)  # type: ignore[arg-type]  # of several types
    flown, station, last = Flown(), Station(lambda one: [], place=place), list[PlantSamples]()
    with tempfile.TemporaryDirectory() as folder:
        journal = Path(folder) / "journal.jsonl"
        bench = Bench(settings, known, journal=journal, record=record, links_behind=1)
        flight = VirtualFlight(bench, station)
        armed, called_s = False, math.inf

        def watch(samples: PlantSamples) -> None:
            nonlocal armed, called_s
            last[:] = [samples]
            armed = armed or bool(samples.motors[-1])
            if any("-> asked" in line for line in bench.host.lines[-20:]):
                station.done = len(station.plan)  # who flies it lets it go
            announced = any("on fault" in line and "-> announced" in line for line in bench.host.lines[-20:])
            if call is not None and announced and called_s == math.inf:
                called_s = flight.t_s + 2.0
                if call == "stick":  # where it is before it is moved
                    bench.behind[0].send(station.encoder.encode(MessageId.MANUAL_CONTROL, 1, 0, 0, 500, 0, 0))
            if call is not None and flight.t_s >= called_s:
                called_s = -1.0
                near, behind = station.call_off(call)
                for frame in near:
                    bench.open[0].send(frame)
                for frame in behind:
                    bench.behind[0].send(frame)

        def landed() -> bool:
            return armed and bool(last) and not last[0].motors[-1]

        with patch("sitl_plant.emulator.BLOCK_S", BLOCK_S), patch("sitl_plant.emulator.TICK_S", TICK_S):
            flight.fly(config, until_s, PROFILE, RATE_HZ, stop=landed, watch=watch)
        figures = bench.daemon.fleet.figures()
        bench.close()
        _read(flown, journal)
    end = last[0]
    tilt = max(abs(angle) for angle in end.attitude[-1, :2].tolist())
    flown.down = landed() and -end.position[-1, 2] < GROUND_M and tilt < UPRIGHT_RAD
    flown.flown_s = flight.t_s
    flown.judged = sum(one.judged_s for one in figures) / max(flight.t_s, 1.0)
    return flown


def _read(flown: Flown, journal: Path) -> None:
    """What the journal says."""
    began = 0.0
    for line in map(json.loads, journal.read_text().splitlines()):
        minute, second = line["utc"].rstrip("Z").split(":")[1:]
        s = 60.0 * int(minute) + float(second)
        text = line.get("text", "")
        if line["kind"] == "stage" and line["stage"] == "fault" and flown.declared_s is None:
            flown.declared_s = s
        if line["kind"] != "note" or not text.startswith("on fault: "):
            continue
        flown.announced |= "-> announced" in text
        flown.called_off |= "called off" in text
        if "->" not in text:
            began = s
        if "-> asked" in text and "again" not in text:
            delay_s = float(text.split(" after ")[1].split(" s")[0])
            flown.commands.append(text.removeprefix("on fault: ").split(": ")[1])
            flown.late_s = s - began - delay_s


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--faults", type=int, default=len(FAULTS))
    parser.add_argument("--healthy-h", type=float, default=10.0)
    parser.add_argument("--calls", type=int, default=9, help="flights of each way in which a pilot calls it off")
    options = parser.parse_args()
    began_s = time.monotonic()
    for place in PLACES:
        print(f"{place}: taught, grade {baseline(place).grade}", flush=True)
        found = []
        for number, fault in enumerate(FAULTS[: options.faults]):
            for seed in range(options.seeds):
                flown = fly(place, 100 + 10 * number + seed, fault.code)
                found.append(flown)
                if not flown.down or flown.late_s is None or flown.late_s > 0.5:
                    print(f"  {place} {fault.code} seed {100 + 10 * number + seed}: {flown}", flush=True)
        late = [one.late_s for one in found if one.late_s is not None]
        for what, right in (
            ("declared", [one.declared_s is not None for one in found]),
            ("announced", [one.announced for one in found]),
            ("acted within its delay + 0.5 s", [s <= 0.5 for s in late]),
            ("on the ground upright", [one.down for one in found]),
            ("one command at most", [len(one.commands) <= 1 for one in found]),
        ):
            print(f"{place}: {what} {sum(right)} of {len(right)}", flush=True)
        print(f"{place}: the latest action {max(late, default=NAN):.2f} s after its delay", flush=True)
    for way in WAYS:
        found = [
            fly(PLACES[n % 3], 300 + n, FAULTS[n % len(FAULTS)].code, call=way, until_s=60.0)
            for n in range(options.calls)
        ]
        tried = [one for one in found if one.announced]
        off = sum(one.called_off and not one.commands for one in tried)
        print(f"called off by {way}: {off} of {len(tried)}", flush=True)
    flown_s = acted = 0.0
    number = 0
    while flown_s < 3600.0 * options.healthy_h:
        one = fly(PLACES[number % 3], 1000 + number, until_s=600.0)
        flown_s, acted, number = flown_s + one.flown_s, acted + len(one.commands), number + 1
        if one.commands or one.declared_s is not None:
            print(f"  healthy {PLACES[(number - 1) % 3]} seed {999 + number}: {one}", flush=True)
    print(f"healthy flight: {flown_s / 3600.0:.2f} h, {acted:g} actions")
    print(f"{time.monotonic() - began_s:.0f} s")


if __name__ == "__main__":
    main()
