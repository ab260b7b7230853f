"""Rotor layouts: found on recorded flights and on emulated vehicles under vibration, from the outputs alone.

    python benchmarks/layouts.py [--shared FOLDER] [--seeds N] [--seconds S]

Emulated: the shipped quad x, quad plus, hexa x and octo x, as a new and an aged specimen, with unbalances of 3 and of
10 g mm on every rotor (the thesis's worst propeller has 5.5, T Table 3.2), on links of 1 kHz and 100 Hz. The outputs
are also moved: behind four idle ones, between servos of a camera, and, in a figure of eight with the nose along the
path, into another order, which needs yaw. Round a square with the nose along the path roll and pitch move together.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from mavdiag.airframe.detect import LayoutFinding, detect_layout
from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.errors import InputError
from mavdiag.learning import front_for, rows_of
from mavdiag.logs import read_log
from mavdiag.telemetry import FloatArray, Log, Series, Signal, Telemetry
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.physics.faults import Injection, RotorDamage
from sitl_plant.plant import PlantConfig
from sitl_plant.vehicle import Vehicle, vehicle_named

VEHICLES = {"qdrone2": "qdrone2", "quad-plus": "plus", "hexa-x": "hexa-x", "octo-x": "octo-x"}
LINKS = {"1 kHz": LinkSpec("qdrone2"), "100 Hz": LinkSpec("ardupilot", 100.0)}
TURNING = "as they are, nose along the path"
ARRANGEMENTS = ("as they are", TURNING, "behind 4 idle", "between servos", "another order")
WINDOW_S = 0.1


@dataclass(frozen=True, slots=True)
class Case:
    """One column of the table. aged: the specimen. unbalance_g_mm: of every rotor, beside its own."""

    label: str
    aged: bool
    unbalance_g_mm: float


CASES = (Case("new", False, 0.0), Case("aged", True, 0.0), Case("3 g mm", True, 3.0), Case("10 g mm", True, 10.0))


def flight(vehicle: Vehicle, link: LinkSpec, case: Case, seed: int, seconds: float, nose: str, trajectory: str) -> Log:
    """A flight in some wind. nose: "fixed", or along the "path", which moves yaw."""
    damage = RotorDamage(unbalance_g_mm=case.unbalance_g_mm)
    shaken = tuple(Injection(damage, rotor) for rotor in range(1, len(vehicle.rotors) + 1))
    config = PlantConfig(
        drone=1 if case.aged else 2 + seed % 2, vehicle=vehicle, seed=seed, wind_m_s=1.0,
        nose=nose, trajectory=trajectory, injections=shaken if case.unbalance_g_mm else (),
    )  # fmt: skip
    telemetry, _ = flight_telemetry(config, seconds, link)
    return Log(f"{vehicle.name} seed {seed}", "", link.profile, telemetry)


def rearranged(log: Log, arrangement: str, rotors: int) -> tuple[Log, tuple[int, ...]]:
    """The log with its motors on other outputs, and those outputs, by rotor."""
    if arrangement in ("as they are", TURNING):
        return log, tuple(range(1, rotors + 1))
    series = log.telemetry.need(Signal.ACTUATOR)
    motors, n = series.values[:, :rotors], len(series)
    rng = np.random.default_rng(1)
    if arrangement == "behind 4 idle":
        places = tuple(range(5, 5 + rotors))
        values = np.hstack([np.tile([0.0, 0.5, 0.0, 0.45], (n, 1)), motors])
    elif arrangement == "between servos":
        places = (1, 2, *range(4, 2 + rotors))
        servo = np.clip(np.cumsum(rng.normal(0, 0.01, (n, 2)), axis=0) + 0.5, 0, 1)
        values = np.hstack([motors[:, :2], servo[:, :1], motors[:, 2:], servo[:, 1:]])
    else:
        order = np.roll(rng.permutation(rotors), 1)
        places = tuple(int(one) + 1 for one in order)
        values = np.empty((n, rotors))
        values[:, order] = motors
    return replaced(log, series, values), places


def replaced(log: Log, series: Series, values: FloatArray) -> Log:
    """The log with these outputs."""
    others = tuple(one for one in log.telemetry if one.signal is not Signal.ACTUATOR)
    return replace(log, telemetry=Telemetry((*others, replace(series, values=values))))


def finding(log: Log) -> LayoutFinding:
    """What one flight shows."""
    front = front_for([log], WINDOW_S)
    return detect_layout(rows.block for rows in rows_of(front, log.telemetry))


def recorded(folder: Path) -> Iterator[Path]:
    """Every recorded flight of an autopilot that logs outputs, and the bench log."""
    for name in ("arducopter_live", "arducopter_sitl", "ardupilot_real", "px4_real"):
        yield from sorted(path for path in (folder / name).glob("*") if path.suffix in (".tlog", ".bin", ".ulg"))


def recordings(console: Console, folder: Path) -> None:
    """The layout of each recording, by its outputs."""
    table = Table("recording", "layout", "why")
    for path in recorded(folder):
        try:
            found = finding(read_log(path))
        except InputError as error:
            table.add_row(path.name, "none", str(error))
            continue
        table.add_row(path.name, found.layout.name if found.layout else "unknown", found.reason)
    console.print(table)


def emulated(console: Console, seeds: int, seconds: float) -> None:
    """Found of flown, by vehicle, link and condition."""
    for arrangement in ARRANGEMENTS:
        table = Table("vehicle", "link", *(case.label for case in CASES), title=f"outputs {arrangement}")
        for name, expected in VEHICLES.items():
            vehicle = vehicle_named(name)
            for link_name, link in LINKS.items():
                cells = [cell(vehicle, expected, link, case, arrangement, range(seeds), seconds) for case in CASES]
                table.add_row(name, link_name, *cells)
        console.print(table)


def cell(
    vehicle: Vehicle, expected: str, link: LinkSpec, case: Case, arrangement: str, seeds: range, seconds: float
) -> str:
    """Right of all; in brackets how many were wrong instead of unknown, and the least likeness of the right ones."""
    right, wrong, least = 0, 0, 1.0
    nose = "path" if arrangement in (TURNING, ARRANGEMENTS[-1]) else "fixed"
    trajectory = "figure8" if arrangement == ARRANGEMENTS[-1] else "square"
    for seed in seeds:
        flown = flight(vehicle, link, case, seed, seconds, nose, trajectory)
        log, places = rearranged(flown, arrangement, len(vehicle.rotors))
        found = finding(log)
        if is_right(found, layout_named(expected), places, name=arrangement != ARRANGEMENTS[-1]):
            right, least = right + 1, min(least, found.likeness[0][1])
        else:
            wrong += found.layout is not None
    note = f" ({wrong} wrong)" if wrong else ""
    return f"{right}/{len(seeds)}{note}" + (f", {least:.2f}" if right else "")


def is_right(found: LayoutFinding, flown: RotorLayout, places: tuple[int, ...], *, name: bool) -> bool:
    """Whether each output drives a rotor with the effects that it has. name: and the layout is called so."""
    if found.layout is None or (name and found.layout.name != flown.name):
        return False
    truth = dict(zip(places, flown.signs, strict=True))
    said = dict(zip(found.outputs, found.layout.signs, strict=True))
    return truth.keys() == said.keys() and all(np.allclose(truth[one], said[one], atol=0.01) for one in truth)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shared", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0)
    asked = parser.parse_args()
    console = Console(width=150, highlight=False)
    if asked.shared is not None:
        recordings(console, asked.shared)
    emulated(console, asked.seeds, asked.seconds)


if __name__ == "__main__":
    main()
