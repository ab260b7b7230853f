"""Baselines of the made vehicles, learnt once."""

from functools import cache

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
    """A log of a made flight."""
    return Log(name, "", profile, telemetry)


def healthy(count: int, n: int = 3000) -> list[Log]:
    """Flights of `flying`, 100 Hz, with every signal."""
    return [Log(f"flight{i}", f"{i:064x}", "px4", flying(n, seed=100 + i)) for i in range(count)]


def plain(count: int, n: int = 8000) -> list[Log]:
    """Flights of the linear airframe at 1 kHz: gyro and set-point only."""
    return [Log(f"flight{i}", f"{i:064x}", "qdrone2", flight(n, seed=100 + i)) for i in range(count)]


@cache
def whole() -> Baseline:
    """All monitors that can work on `flying`."""
    return learn(healthy(3), LearnOptions(airframe=FRAME), created=NOW)


@cache
def trim() -> Baseline:
    """The trim monitor alone."""
    return learn(healthy(2), LearnOptions(airframe=FRAME, monitors=("rotor_trim",)), created=NOW)


@cache
def thesis() -> Baseline:
    """The thesis's monitor alone, roll and pitch."""
    return learn(plain(3), thesis_options(Airframe(gate=ALWAYS), BOTH), created=NOW)
