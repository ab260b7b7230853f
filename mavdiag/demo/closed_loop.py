"""The closed loop of the demo and the loopback benchmark: vehicle and detector as processes, and a ground station."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mavdiag.demo.subprocesses import Child, child
from mavdiag.errors import LinkError
from mavdiag.link.messages import Severity
from mavdiag.link.ports import open_endpoint
from mavdiag.terminal.ground_station import GroundStation, LiveJudge, ReceivedText

READY_S = 120.0  # the emulator compiles its loop at its first start


@dataclass(frozen=True, slots=True)
class Flight:
    """What the emulator flies. fault: a code, None for a healthy flight; onset_s, duration_s: flight time."""

    duration_s: float
    fault: str | None = None
    rotor: int = 1
    onset_s: float = 0.0
    seed: int = 0

    @property
    def arguments(self) -> tuple[str, ...]:
        """As arguments of the emulator."""
        fault = () if self.fault is None else ("--fault", self.fault, "--rotor", f"{self.rotor}")
        onset = () if self.fault is None else ("--onset", f"{self.onset_s:g}")
        return ("--duration", f"{self.duration_s:g}", "--seed", str(self.seed), *fault, *onset)


@dataclass(frozen=True, slots=True)
class Loop:
    """The running processes and the ground station that receives from them."""

    plant: Child
    detector: Child
    station: GroundStation


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the ground station saw. Times in seconds of flight; detected_s is None if nothing was alerted in time."""

    onset_s: float
    texts: tuple[ReceivedText, ...]

    @property
    def alerts(self) -> tuple[ReceivedText, ...]:
        """Declared faults."""
        return tuple(text for text in self.texts if text.severity <= Severity.CRITICAL)

    @property
    def false_alarms(self) -> int:
        """Faults that were declared before there was one."""
        return sum(text.t_s < self.onset_s for text in self.alerts)

    @property
    def detected_s(self) -> float | None:
        """When the fault was first alerted."""
        return next((text.t_s for text in self.alerts if text.t_s >= self.onset_s), None)

    @property
    def good(self) -> bool:
        """Alerted after the onset, and silent before."""
        return self.detected_s is not None and self.false_alarms == 0


@contextmanager
def closed_loop(
    flight: Flight, baseline: Path, judge: LiveJudge | None = None, record: Path | None = None
) -> Iterator[Loop]:
    """Vehicle, detector and ground station over UDP on loopback, on ports of their own. Raises LinkError."""
    kept = () if record is None else ("--record", str(record))
    with (
        open_endpoint("udpin:127.0.0.1:0") as endpoint,
        child("detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(baseline), *kept) as detector,
    ):
        line = detector.wait_for("ready", READY_S)
        found = re.search(r"udpin:([\d.]+:\d+)", line)
        if found is None:
            raise LinkError(f"the detector did not print where it listens: {line}")
        ground = endpoint.address.replace("udpin", "udpout")
        with child("sitl_plant", "run", "--out", f"udpout:{found[1]}", "--out", ground, *flight.arguments) as plant:
            plant.wait_for("flies", READY_S)
            yield Loop(plant, detector, GroundStation(endpoint, judge))
