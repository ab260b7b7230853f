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
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavdiag import identify, monitors
    from mavdiag.airframe.airframe import Airframe
    from mavdiag.baseline import Baseline
    from mavdiag.decision.diagnosis import Diagnosis, Event
    from mavdiag.errors import BaselineError, IdentificationError, InputError, LinkError, MavdiagError, UsageError
    from mavdiag.face import Watch, judge, learn, rates, read_log, scan
    from mavdiag.judging import Verdict
    from mavdiag.link.link import open_link
    from mavdiag.logs.tlog import vehicle_stream
    from mavdiag.telemetry import Log, Series, Signal, Telemetry

    __version__: str

__all__ = ["Airframe", "Baseline", "BaselineError", "Diagnosis", "Event", "IdentificationError", "InputError"]
__all__ += ["LinkError", "Log", "MavdiagError", "Series", "Signal", "Telemetry", "UsageError", "Verdict", "Watch"]
__all__ += ["identify", "judge", "learn", "monitors", "open_link", "rates", "read_log", "scan", "vehicle_stream"]

_HOME = {
    "mavdiag.airframe.airframe": ("Airframe",),
    "mavdiag.baseline": ("Baseline",),
    "mavdiag.decision.diagnosis": ("Diagnosis", "Event"),
    "mavdiag.errors": ("BaselineError", "IdentificationError", "InputError", "LinkError", "MavdiagError", "UsageError"),
    "mavdiag.face": ("Watch", "judge", "learn", "rates", "read_log", "scan"),
    "mavdiag.judging": ("Verdict",),
    "mavdiag.link.link": ("open_link",),
    "mavdiag.logs.tlog": ("vehicle_stream",),
    "mavdiag.telemetry": ("Log", "Series", "Signal", "Telemetry"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import distributions  # here, for it takes time to load

        return next((one.version for one in distributions(name="mavdiag")), "0+unknown")  # not of a bare checkout
    if name in ("identify", "monitors"):
        return import_module(f"mavdiag.{name}")
    for home, names in _HOME.items():
        if name in names:
            return getattr(import_module(home), name)
    raise AttributeError(f"module 'mavdiag' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted((*__all__, "__doc__", "__version__"))
