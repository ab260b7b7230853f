"""Hostile baselines whose digest is right: each is refused in one line, or judges; nothing else may come of it.

    python fuzz/baselines.py [--count 1000] [--seed 1]

Somebody may change a baseline and seal it again. In a copy of a sound one, one or two fields of airframe, link, window,
envelope or a monitor's fit are changed: figures by many decades and in sign, tables longer and shorter, names; in one
of eight all rotor layouts have other rotors. What loads judges a flight. With NUMBA_BOUNDSCHECK=1, in a copy of the
project that was never compiled and with a NUMBA_CACHE_DIR of its own, an index beyond an array is an error, too.
"""

import argparse
import contextlib
import json
import random
import signal
from collections import Counter
from collections.abc import Iterator
from typing import Any

from mavdiag.airframe.load import airframe_named
from mavdiag.baseline import Baseline, dump, parse, sealed
from mavdiag.errors import MavdiagError
from mavdiag.judging import judge
from mavdiag.learning import LearnOptions, learn
from mavdiag.telemetry import Log
from sitl_plant.autopilot.telemetry import LinkSpec, flight_telemetry
from sitl_plant.plant import PlantConfig

LONGEST_S = 20  # that one may take to load and judge 20 s of flight; more is a failure
KEPT = {"scores", "provenance", "digest", "schema", "least_damage"}  # fields that are left as they are
Path = tuple[str | int, ...]


def flown(seed: int) -> Log:
    """A healthy flight of 20 s at 200 Hz."""
    telemetry, _ = flight_telemetry(PlantConfig(seed=seed), 20.0, LinkSpec(rate_hz=200.0))
    return Log(f"seed {seed}", telemetry.digest, "qdrone2", telemetry)


def places(part: Any, path: Path = ()) -> Iterator[Path]:
    """Where there is a figure, a text or a table, but for long tables, of which the first twelve count."""
    inner: list[tuple[str | int, Any]] = list(part.items()) if isinstance(part, dict) else []
    if isinstance(part, list):
        inner = list(enumerate(part[:12]))
    if path and not isinstance(part, dict):
        yield path
    for key, value in inner:
        if key not in KEPT:
            yield from places(value, (*path, key))


def changed(value: Any, rng: random.Random) -> Any:
    """Something else in its place."""
    if isinstance(value, list):
        more = [rng.choice(value)] * rng.choice((1, 5, 40)) if value else [0.0]
        return rng.choice((value[:-1], value[1:], [*value, *more], []))
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((0, -1, value + 1, value - 1, 2 * value, 2**31, 10**6))
    if isinstance(value, float):
        return rng.choice((0.0, -value, 1e6 * value, 1e-6 * value, 3 * value, 1e300, 1e-300))
    return rng.choice(("", f"{value}x", "roll", "yaw", 1.0))


def put(raw: Any, path: Path, rng: random.Random) -> None:
    """Change what stands at a place, if it is still there."""
    with contextlib.suppress(KeyError, IndexError, TypeError):
        for step in path[:-1]:
            raw = raw[step]
        raw[path[-1]] = changed(raw[path[-1]], rng)


def with_rotors(part: Any, rotors: int) -> None:
    """Give every layout in it so many rotors more or fewer, and what stands beside it for each of them."""
    if isinstance(part, dict) and isinstance(signs := part.get("signs"), list):
        part["signs"] = [*signs, *[[1.0, 1.0, 1.0]] * rotors] if rotors > 0 else signs[:rotors]
    for value in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        with_rotors(value, rotors)
    if isinstance(part, dict) and isinstance(part.get("layout"), dict):
        count = len(part["layout"]["signs"])
        for name in {"mean", "about"} & part.keys() if part.get("kind") == "rotor_speed" else ():
            part[name] = (part[name] * 30)[:count]


def outcome(raw: Any, log: Log) -> str:
    """What becomes of a baseline: `refused`, or a verdict."""
    try:
        baseline = parse(dump(sealed(Baseline.model_validate(raw))))
        return str(judge(log, baseline).verdict)
    except MavdiagError:
        return "refused"


def main() -> None:
    """Run it and print what came of them; the exit code is 1 if one was neither refused nor judged."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    flights = [flown(seed) for seed in range(5)]
    sound = learn(flights, LearnOptions(airframe=airframe_named("qdrone2")), created="2026-01-01T00:00:00Z")
    text, log, found, failed = dump(sound), flown(99), Counter[str](), 0
    every = list(places(json.loads(text)))
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    for number in range(options.seed, options.seed + options.count):
        rng, raw = random.Random(number), json.loads(text)
        for path in rng.sample(every, rng.choice((1, 1, 1, 2))):
            put(raw, path, rng)
        if rng.random() < 0.125:
            with_rotors(raw, rng.choice((-1, 1, 2, 20, 60)))
        signal.alarm(LONGEST_S)
        try:
            found[outcome(raw, log)] += 1
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  # whatever it is, it is what is looked for
            failed += 1
            print(f"seed {number}: {type(error).__name__}: {error}", flush=True)
        signal.alarm(0)
    told = ", ".join(f"{count} {name}" for name, count in sorted(found.items()))
    print(f"seed {options.seed}: {options.count} baselines, {failed} failed; {told}")
    raise SystemExit(1 if failed else 0)


if __name__ == "__main__":
    main()
