"""The closed loop of the demo and the loopback benchmark (edge): vehicle and detector as processes, a ground station.

A process is started from this Python by module name, and always ended.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from mavdiag.commandline import own_environ
from mavdiag.errors import LinkError
from mavdiag.link.ports import open_endpoint
from mavdiag.terminal.ground_station import GroundStation, Line, LiveJudge

Outcome: TypeAlias = Literal["detected", "false alarm", "missed"]
GRACE_S = 3.0
POLL_S = 0.05
READY_S = 120.0  # the emulator compiles its loop at its first start


class Child(contextlib.AbstractContextManager["Child"]):
    """A process that ends with the block. What it prints goes to a file, so that it never waits for a reader."""

    def __init__(self, module: str, *arguments: str) -> None:
        self.module, self._told = module, 0
        self._output = tempfile.TemporaryFile()  # noqa: SIM115  # closed with the block
        command, null, env = [sys.executable, "-m", module, *arguments], subprocess.DEVNULL, own_environ()
        self._process = subprocess.Popen(command, stdin=null, stdout=self._output, stderr=subprocess.STDOUT, env=env)

    @property
    def lines(self) -> list[str]:
        """The lines that it printed so far, read without moving the place at which it writes."""
        printed = os.pread(self._output.fileno(), os.fstat(self._output.fileno()).st_size, 0)
        return printed.rpartition(b"\n")[0].decode(errors="replace").splitlines()

    @property
    def running(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def wait_for(self, text: str, timeout_s: float) -> str:
        """Wait for a new line that holds `text`. Raises LinkError with the last line if it ends or takes longer."""
        until = time.monotonic() + timeout_s
        while True:
            ended = not self.running  # looked at before the lines: its last ones still count
            lines = self.lines
            for line in lines[self._told :]:
                self._told += 1
                if text in line:
                    return line
            if ended or time.monotonic() >= until:
                raise LinkError(f"{self.module} {'stopped' if ended else 'did not get ready'}: {_last(lines)}")
            time.sleep(POLL_S)

    def end(self) -> None:
        """Ask it to stop, and insist after a while."""
        self._process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE_S)
        self._process.kill()
        self._process.wait()

    def __exit__(self, *_: object) -> None:
        self.end()
        self._output.close()


def run_child(module: str, *arguments: str) -> None:
    """Run a process to its end. Raises LinkError with its last line if it fails."""
    command, pipe, env = [sys.executable, "-m", module, *arguments], subprocess.PIPE, own_environ()
    done = subprocess.run(command, input=b"", stdout=pipe, stderr=subprocess.STDOUT, env=env, check=False)
    if done.returncode:
        raise LinkError(f"{module} failed: {_last(done.stdout.decode(errors='replace').splitlines())}")


def _last(lines: Sequence[str]) -> str:
    return lines[-1] if lines else "it printed nothing"


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
        flight = ("--duration", f"{self.duration_s:g}", "--seed", str(self.seed))
        fault = ("--fault", self.fault or "", "--rotor", f"{self.rotor}", "--onset", f"{self.onset_s:g}")
        return flight if self.fault is None else flight + fault


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the ground station saw, as `demo --json` has it. Times in seconds; None if nothing was alerted in time."""

    verdict: Outcome
    onset_s: float
    detected_s: float | None  # of the flight, when the fault was first alerted
    latency_s: float | None
    alerts: tuple[Line, ...]
    false_alarms: int  # before the onset

    @classmethod
    def of(cls, onset_s: float, texts: Sequence[Line]) -> "DemoResult":
        """The result of a flight with its fault from `onset_s` on."""
        alerts = tuple(text for text in texts if text.alert)
        early = sum(text.t_s < onset_s for text in alerts)
        detected_s = next((text.t_s for text in alerts if text.t_s >= onset_s), None)
        latency_s = None if detected_s is None else round(detected_s - onset_s, 3)
        verdict: Outcome = "false alarm" if early else "missed" if detected_s is None else "detected"
        return cls(verdict, onset_s, detected_s, latency_s, alerts, early)


@contextlib.contextmanager
def closed_loop(
    flight: Flight, baseline: Path, judge: LiveJudge | None = None, record: Path | None = None
) -> Iterator[tuple[Child, Child, GroundStation]]:
    """Vehicle, detector and a ground station that hears both, over UDP on ports of their own. Raises LinkError."""
    kept = () if record is None else ("--record", str(record))
    with (
        open_endpoint("udpin:127.0.0.1:0") as endpoint,
        Child("detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(baseline), *kept) as detector,
    ):
        line = detector.wait_for("ready", READY_S)
        found = re.search(r"udpin:([\d.]+:\d+)", line)
        if found is None:
            raise LinkError(f"the detector did not print where it listens: {line}")
        ground = endpoint.address.replace("udpin", "udpout")
        with Child("sitl_plant", "run", "--out", f"udpout:{found[1]}", "--out", ground, *flight.arguments) as plant:
            plant.wait_for("flies", READY_S)
            yield plant, detector, GroundStation(endpoint, judge)
