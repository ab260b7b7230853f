"""Baselines of the made vehicles, learnt once: kept on disk by the digest of all sources and the key of `kept`."""

import hashlib
import platform
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

from flying_telemetry import flying
from made_telemetry import flight

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.baseline import Baseline
from mavdiag.learning import LearnOptions, learn, thesis_options
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import Axis, Log, Telemetry

NOW = "2026-01-01T00:00:00+00:00"
ALWAYS = GateSpec()  # armed is flying
FRAME = Airframe(
    name="made", layout=layout_named("x"), mass_kg=1.5, hover_rad_s=600.0, gate=ALWAYS, classifier="qdrone2-emulated"
)
BOTH = (Axis.ROLL, Axis.PITCH)


def logged(telemetry: Telemetry, profile: str = "px4", name: str = "log") -> Log:
    return Log(name, "", profile, telemetry)


def healthy(count: int, n: int = 3000) -> list[Log]:
    """Flights of `flying`, 100 Hz, with every signal."""
    return [Log(f"flight{i}", f"{i:064x}", "px4", flying(n, seed=100 + i)) for i in range(count)]


def plain(count: int, n: int = 8000) -> list[Log]:
    """Flights of the linear airframe at 1 kHz: gyro and set-point only."""
    return [Log(f"flight{i}", f"{i:064x}", "qdrone2", flight(n, seed=100 + i)) for i in range(count)]


ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".cache" / "baselines"


@cache
def _sources() -> str:
    """Digest of what a baseline of made flights depends on."""
    digest = hashlib.sha256(" ".join([platform.python_version(), *map(version, ("numpy", "numba", "scipy"))]).encode())
    made = [path for name in ("flying_*", "made_*", "virtual_*") for path in (ROOT / "tests").glob(f"{name}.py")]
    packages = [path for name in ("mavdiag", "sitl_plant") for path in (ROOT / name).rglob("*.*")]
    for path in sorted(path for path in (*made, *packages) if path.suffix in (".py", ".toml", ".json")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def kept(key: str, make: Callable[[], Baseline]) -> Baseline:
    """What `make` learns, once for all test runs. key: of what it depends on beside the sources."""
    path = KEPT / f"{hashlib.sha256(f'{key} {_sources()}'.encode()).hexdigest()}.json"
    if path.exists():
        return Baseline.load(path)
    made = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    made.save(path)
    return made


@cache
def whole() -> Baseline:
    return kept("whole", lambda: learn(healthy(3), LearnOptions(airframe=FRAME), created=NOW))


@cache
def trim() -> Baseline:
    options = LearnOptions(airframe=FRAME, monitors=("rotor_trim",))
    return kept("trim", lambda: learn(healthy(2), options, created=NOW))


@cache
def thesis() -> Baseline:
    """The thesis's monitor alone, roll and pitch."""
    options = replace(thesis_options(), airframe=Airframe(gate=ALWAYS), axes=BOTH)
    return kept("thesis", lambda: learn(plain(3), options, created=NOW))
