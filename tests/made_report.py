"""The emulated flight of the README's pictures, flown once: a QDrone 2 at 400 Hz, whose propeller 1 cracks at 10 s."""

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

from mavdiag.judging import JudgedFlight
from mavdiag.telemetry import Log

DOCS = Path(__file__).resolve().parents[1] / "docs"
ROTOR, ONSET_S, RATE_HZ = 1, 10.0, 400.0


@cache
def script() -> ModuleType:
    """docs/draw_report.py."""
    spec = importlib.util.spec_from_file_location("draw_report", DOCS / "draw_report.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert (module.ROTOR, module.ONSET_S, module.LINK.rate_hz) == (ROTOR, ONSET_S, RATE_HZ)
    return module


def cracked() -> tuple[Log, JudgedFlight]:
    """The flight."""
    found: tuple[Log, JudgedFlight] = script().cracked()
    return found
