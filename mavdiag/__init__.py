"""Find a damaged propeller over MAVLink, from a model of the healthy airframe.

    import mavdiag as md

    baseline = md.learn("healthy/*.tlog", airframe="qdrone2")   # healthy flights: a baseline
    verdict = md.judge("suspect.tlog", baseline)                # one more flight: a verdict
    for verdict in md.scan("flights", baseline):                # all logs of a folder
        print(verdict)
    u, y, dt = md.rates(md.read_log("flight.ulg"), "roll")      # commanded and measured rate, for models of your own
    model = md.identify(u, y, order=(2, 2, 1), dt=dt)           # an ARX model; typed code calls md.identify.fit
    with md.open_link("udpin:127.0.0.1:14550") as link:         # a live vehicle
        watch = md.Watch(baseline)
        for telemetry in link:
            print(*watch.step(telemetry))

Every name is imported at its first use, so that `import mavdiag` costs nothing.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavdiag import identify
    from mavdiag.airframe.airframe import Airframe
    from mavdiag.baseline import Baseline
    from mavdiag.face import Watch, judge, learn, rates, read_log, scan
    from mavdiag.link.link import open_link
    from mavdiag.logs.tlog import vehicle_stream
    from mavdiag.telemetry import Log

try:
    __version__ = version("mavdiag")
except PackageNotFoundError:  # a bare checkout on the path, not installed
    __version__ = "0+unknown"

__all__ = ["Airframe", "Baseline", "Log", "Watch", "__version__", "identify", "judge", "learn", "open_link"]
__all__ += ["rates", "read_log", "scan", "vehicle_stream"]

_HOME = {
    **dict.fromkeys(("Watch", "judge", "learn", "rates", "read_log", "scan"), "mavdiag.face"),
    "Airframe": "mavdiag.airframe.airframe",
    "Baseline": "mavdiag.baseline",
    "Log": "mavdiag.telemetry",
    "open_link": "mavdiag.link.link",
    "vehicle_stream": "mavdiag.logs.tlog",
}


def __getattr__(name: str) -> Any:
    if name == "identify":
        return import_module("mavdiag.identify")
    if name not in _HOME:
        raise AttributeError(f"module 'mavdiag' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
