"""Reactions flown by emulator and daemon on one virtual clock: the thesis's nine faults, three places, some seeds.

    python benchmarks/reactions.py [PART...] [--seeds 5] [--faults 9] [--calls 9] [--healthy-h 10] [--rate 1000]
        [--workers 2]

    faults    nine faults x three places x seeds: the emulated vehicle with its own controller
    loop      nine faults, a flight controller in the loop: `loop_plant.py`
    called    flights in which the pilot calls it off: by a mode, a stick, an acknowledgement
    healthy   healthy flight of several vehicles

A commanded vehicle (profile qdrone2) takes off, and hovers, goes to and fro at 1 m/s, or flies a mission. From ONSET_S
on a propeller of rotor 1 to 4 is damaged. The daemon has the table of `TABLE` and a baseline that was learnt from
TAUGHT healthy flights of that vehicle and place; what judges healthy flights learnt from one more that is as long as
they are, for the battery empties. Mean wind and size of the path are drawn by the seed. Counted are, by
the journal, the time from the finding to the command over the delay, and, by the plant's truth, whether the vehicle
stands on the ground, upright and disarmed, before END_S. A healthy flight is right if nothing was commanded.
"""

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from loop_plant import HIL_HZ, LoopPlant
from made_baselines import kept
from made_vehicle import Bench
from virtual_flight import GroundStation, VirtualFlight, learnt

from detector.config import Settings
from mavdiag.archive.pool import run_all
from mavdiag.archive.scan import digest_of_sources
from mavdiag.baseline import Baseline
from mavdiag.link.messages import MavCmd, MessageId
from mavdiag.logs.tlog import read_tlog
from sitl_plant.autopilot.dialect import Mode, dialect_named
from sitl_plant.autopilot.stream import to_global
from sitl_plant.physics.faults import FAULTS
from sitl_plant.plant import Plant, PlantConfig, PlantSamples
from sitl_plant.vehicle import airframe_of, vehicle_from

PARTS = ("faults", "loop", "called", "healthy")
PLACES = ("hover", "cruise", "mission")
WAYS = ("mode", "stick", "ack")
DELAY_S, ONSET_S, END_S = 6.0, 25.0, 90.0
TAUGHT, LEARN_S = 4, 60.0  # flights of each place
TABLE = {
    "hover": f"gross loss: land; fault after {DELAY_S:g} s: land",
    "cruise": f"gross loss: land; fault after {DELAY_S:g} s: rtl",
    "mission": f"gross loss: land; fault after {DELAY_S:g} s: rtl",
}
PROFILE, RATE_HZ = "qdrone2", 1000.0
HEIGHT_M, LEG_S = 2.0, 6.0
SIDE_M, WIND_M_S = (3.0, 5.0), (0.0, 1.0)  # from, to
UPRIGHT_RAD, GROUND_M = math.radians(10.0), 0.15
BLOCK_S, TICK_S = 0.08, 0.01  # of the emulator: longer than usual, so that it is done sooner
HEALTHY_S = 600.0  # of a healthy flight
AUTOPILOT, DETECTOR = (1, 1), (1, 191)
NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Craft:
    """What flies. drone: as of `PlantConfig`. in_loop: by a flight controller in the loop. rate_hz: of its link."""

    vehicle: str = "qdrone2"
    drone: int = 2
    in_loop: bool = False
    rate_hz: float = RATE_HZ

    def config(self, seed: int) -> PlantConfig:
        """A healthy flight."""
        wind = float(np.random.default_rng([seed, 1]).uniform(*WIND_M_S))
        kind = vehicle_from(self.vehicle)
        return PlantConfig(
            vehicle=kind, drone=self.drone, trajectory="commanded", start="ground", seed=seed, wind_m_s=wind
        )


USUAL, IN_LOOP = Craft(), Craft(in_loop=True, rate_hz=HIL_HZ)
CRAFTS = (("qdrone2", 1), ("qdrone2", 2), ("qdrone2", 3), ("quad-plus", 1), ("hexa-x", 1))  # of healthy flight


def degrees(north: float, east: float) -> tuple[int, int]:
    """Latitude and longitude in 1e-7 degrees."""
    latitude, longitude, _ = to_global(np.array([[north, east, 0.0]]))[0].tolist()
    return round(latitude * 1e7), round(longitude * 1e7)


@dataclass
class Station(GroundStation):
    """Flies the vehicle to its place. side_m: of its path. done: how much of its plan was sent."""

    place: str = "hover"
    side_m: float = SIDE_M[0]
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
            way = [(self.side_m * (k % 4 in (1, 2)), self.side_m * (k % 4 in (2, 3))) for k in range(160)]
            items = [(22, 0.0, 0.0), *((16, *at) for at in way)]
            upload = [self.encoder.encode(MessageId.MISSION_COUNT, *AUTOPILOT, len(items), 0)]
            for seq, (number, north, east) in enumerate(items):
                flat = (0.0, 0.0, 0.0, NAN, *degrees(north, east), HEIGHT_M, 0)
                upload.append(self.encoder.encode(MessageId.MISSION_ITEM_INT, *AUTOPILOT, seq, 6, number, 0, 1, *flat))
            return [(0.5, upload), *plan, (1.5, order(MavCmd.MISSION_START))]
        plan.append((1.5, order(MavCmd.NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, HEIGHT_M)))
        if self.place == "cruise":
            for leg in range(150):
                there = degrees(self.side_m * (1 - leg % 2), 0.0)
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
def baseline(place: str, craft: Craft = USUAL, longest_s: float = LEARN_S) -> Baseline:
    """Learnt from healthy flights of this kind, as the link brings them; they are flown where it is not kept yet."""
    flying = [path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.py"))]
    spans_s = [LEARN_S] * TAUGHT + [longest_s] * (longest_s > LEARN_S)

    def taught() -> Baseline:
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / f"{seed}.tlog" for seed in range(len(spans_s))]
            for seed, (path, span_s) in enumerate(zip(paths, spans_s, strict=True)):
                fly(place, seed, craft=craft, until_s=span_s, record=path)
            known = airframe_of(vehicle_from(craft.vehicle), craft.vehicle)
            return learnt([read_tlog(path) for path in paths], known)

    return kept(f"{place} {craft} {spans_s} {flying} {digest_of_sources(('detector',))}", taught)


def fly(
    place: str,
    seed: int,
    fault: str | None = None,
    *,
    craft: Craft = USUAL,
    call: str | None = None,
    until_s: float = END_S,
    record: Path | None = None,
) -> Flown:
    """One flight. call: how it is called off, 2 s after it was announced. record: a flight to learn from."""
    goal: dict[str, object] = {"learn": 3600.0} if record else {"baseline": Path("-"), "on_fault": TABLE[place]}
    settings, longest_s = Settings.model_validate(goal), until_s if until_s > END_S else LEARN_S
    known = None if record else baseline(place, craft, longest_s)
    config = craft.config(seed)
    if fault is not None:
        config = replace(config, fault=fault, rotor=1 + seed % 4, onset_s=ONSET_S)
    side_m = float(np.random.default_rng([seed, 2]).uniform(*SIDE_M))
    flown, station = Flown(), Station(lambda one: [], place=place, side_m=side_m)
    last = list[PlantSamples]()
    with tempfile.TemporaryDirectory() as folder:
        journal = Path(folder) / "journal.jsonl"
        bench = Bench(settings, known, journal=journal, record=record, links_behind=1)
        flight = VirtualFlight(bench, station)
        armed, called_s = False, math.inf

        def watch(samples: PlantSamples) -> None:
            nonlocal armed, called_s
            last[:] = [samples]
            armed = armed or bool(samples.motors[-1])
            announced = any("on fault" in line and "-> announced" in line for line in bench.host.lines[-20:])
            if announced:
                station.done = len(station.plan)  # who flies it lets it go
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

        plant_of = (lambda config: cast(Plant, LoopPlant(config))) if craft.in_loop else Plant
        with patch("sitl_plant.emulator.BLOCK_S", BLOCK_S), patch("sitl_plant.emulator.TICK_S", TICK_S):
            flight.fly(config, until_s, PROFILE, craft.rate_hz, stop=landed, watch=watch, plant_of=plant_of)
        judged_s = sum(vehicle.judged_s for vehicle in bench.daemon.fleet.vehicles.values())
        bench.close()
        _read(flown, journal)
    end = last[0]
    tilt = max(abs(angle) for angle in end.attitude[-1, :2].tolist())
    flown.down = landed() and -end.position[-1, 2] < GROUND_M and tilt < UPRIGHT_RAD
    flown.flown_s = flight.t_s
    flown.judged = judged_s / max(flight.t_s, 1.0)
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


def tell(title: str, found: list[Flown]) -> None:
    """What came of flights with faults."""
    late = [one.late_s for one in found if one.late_s is not None]
    for what, right in (
        ("declared", [one.declared_s is not None for one in found]),
        ("announced", [one.announced for one in found]),
        ("acted within its delay + 0.5 s", [s <= 0.5 for s in late]),
        ("on the ground upright", [one.down for one in found]),
        ("one command at most", [len(one.commands) <= 1 for one in found]),
    ):
        print(f"{title}: {what} {sum(right)} of {len(right)}", flush=True)
    print(f"{title}: the latest action {max(late, default=NAN):.2f} s after its delay", flush=True)


def flown_each(flights: Iterable[dict[str, Any]], workers: int) -> Iterator[Flown]:
    """What comes of each flight, in their order. flights: what `fly` is given."""
    ended, following = dict[int, Flown](), 0
    for (number, _), future in run_all(_numbered, enumerate(flights), workers):
        ended[number] = future.result()
        while following in ended:
            yield ended.pop(following)
            following += 1


def _numbered(flight: tuple[int, dict[str, Any]]) -> Flown:
    return fly(**flight[1])


def judged(flights: list[dict[str, Any]], workers: int) -> list[Flown]:
    """Flights with a fault; each one is printed that is not as it should be."""
    found = []
    for flight, flown in zip(flights, flown_each(flights, workers), strict=True):
        if not flown.down or flown.late_s is None or flown.late_s > 0.5:
            print(f"  {flight['place']} {flight['fault']} seed {flight['seed']}: {flown}", flush=True)
        found.append(flown)
    return found


def faults(options: argparse.Namespace, codes: list[str]) -> None:
    """The emulated vehicle with damaged propellers."""
    craft = replace(USUAL, rate_hz=options.rate)
    for place in options.place or PLACES:
        print(f"{place}: taught, grade {baseline(place, craft).grade}", flush=True)
        seeds = [(100 + 10 * n + k, code) for n, code in enumerate(codes) for k in range(options.seeds)]
        flights = [{"place": place, "seed": seed, "fault": code, "craft": craft} for seed, code in seeds]
        tell(place, judged(flights, options.workers))


def loop(options: argparse.Namespace, codes: list[str]) -> None:
    """The same with a flight controller in the loop, each fault in one of the places."""
    each = [{"place": PLACES[n % 3], "seed": 200 + n, "fault": code, "craft": IN_LOOP} for n, code in enumerate(codes)]
    flown = judged(each, options.workers)
    tell("in the loop", flown)
    print(f"in the loop: commanded {', '.join(one for each in flown for one in each.commands)}")


def called(options: argparse.Namespace, codes: list[str]) -> None:
    """Flights in which it is called off."""
    each = {"craft": replace(USUAL, rate_hz=options.rate), "until_s": 60.0}
    tries = [{"place": PLACES[n % 3], "seed": 300 + n, "fault": codes[n % len(codes)]} for n in range(options.calls)]
    found = list(flown_each([{**one, **each, "call": way} for way in WAYS for one in tries], options.workers))
    for number, way in enumerate(WAYS):
        tried = [one for one in found[number * len(tries) : (number + 1) * len(tries)] if one.announced]
        off = sum(one.called_off and not one.commands for one in tried)
        print(f"called off by {way}: {off} of {len(tried)}", flush=True)


def healthy(options: argparse.Namespace, codes: list[str]) -> None:
    """Healthy flight of several vehicles in turn; what was flown so far is printed after each."""

    def flight(number: int) -> dict[str, Any]:
        vehicle, drone = CRAFTS[number % len(CRAFTS)]
        craft = Craft(vehicle, drone, rate_hz=options.rate)
        return {"place": PLACES[number % len(PLACES)], "seed": 1000 + number, "craft": craft, "until_s": HEALTHY_S}

    flown_s, acted = 0.0, 0
    for number, one in enumerate(flown_each(map(flight, count(options.first)), options.workers), options.first):
        what, (vehicle, drone) = flight(number), CRAFTS[number % len(CRAFTS)]
        flown_s, acted = flown_s + one.flown_s, acted + len(one.commands)
        told = f"{flown_s / 3600:.2f} h, {acted} actions"
        told += f": {one}" if one.commands or one.declared_s is not None else ""
        print(f"  {vehicle} {drone}, {what['place']}, seed {what['seed']}: {told}", flush=True)
        if flown_s >= 3600.0 * options.healthy_h:
            return


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="all without any")
    parser.add_argument("--place", action="append", choices=PLACES, help="of `faults`; all without it")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--faults", type=int, default=len(FAULTS))
    parser.add_argument("--healthy-h", type=float, default=10.0)
    parser.add_argument("--first", type=int, default=0, help="number of the first healthy flight, to go on with")
    parser.add_argument("--calls", type=int, default=9, help="flights of each way in which a pilot calls it off")
    parser.add_argument("--rate", type=float, default=RATE_HZ, help="of gyro and set-points on the link")
    parser.add_argument("--workers", type=int, default=2, help="processes that fly; no answer depends on them")
    options = parser.parse_args()
    began_s = time.monotonic()
    for part in options.parts or PARTS:
        {"faults": faults, "loop": loop, "called": called, "healthy": healthy}[part](
            options, list(FAULTS)[: options.faults]
        )
    print(f"{time.monotonic() - began_s:.0f} s, {sum(os.times()[:4]):.0f} s of processor time")


if __name__ == "__main__":
    main()
