"""Emulator and detector as processes, and how long to wait for them."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from made_vehicle import MadeVehicle

from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId, Severity
from mavdiag.link.ports import Endpoint, open_endpoint
from sitl_plant.__main__ import main
from sitl_plant.options import STARTING

PATIENCE_S = 120.0  # before a test with processes and sockets gives up: a machine with much to do is slow, not wrong

ALERT = "PROP FAULT r1 F2/SV2 FSD 0.41s>FML 0.12s"


@contextmanager
def process(
    command: Sequence[str], *, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A child with its output in one pipe; ended when the block is left."""
    child = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=cwd, env=env
    )
    try:
        yield child
    finally:
        child.terminate()
        try:
            child.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()


def record(path: Path, *options: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["sitl-plant", "record", "-o", str(path), *options])
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 0


def first_line(plant: subprocess.Popen[str]) -> str:
    """What it says first, but for the word that it compiles, which comes on a slow machine."""
    assert plant.stdout is not None
    line = plant.stdout.readline()
    return plant.stdout.readline() if line.strip() == STARTING else line


@contextmanager
def flying(*options: str, links: int = 1) -> Iterator[list[str]]:
    """A plant in flight; gives the addresses at which a client reaches its links (it waits there as `udpin`)."""
    outs = ["--out", "udpin:127.0.0.1:0"] * links
    with process([sys.executable, "-m", "sitl_plant", "run", "--json", *outs, *options]) as plant:
        line = first_line(plant)
        assert line.startswith("{"), f"the plant did not start: {line}"
        yield [address.replace("udpin", "udpout") for address in json.loads(line)["addresses"]]


class Companion:
    """Something on board that sends `ALERT` when it is told to, and again every so often."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint, self._encoder = endpoint, Encoder(1, Component.ONBOARD_COMPUTER)

    def alert(self) -> None:
        """Hear what came in, say that we are here, and raise the alert."""
        self._endpoint.receive(0.0)
        beat = (MavType.ONBOARD_CONTROLLER, Autopilot.INVALID, 0, 0, 4, 3)
        self._endpoint.send(self._encoder.encode(MessageId.HEARTBEAT, *beat))
        self._endpoint.send(self._encoder.statustext(Severity.CRITICAL, ALERT))


@contextmanager
def companion(address: str) -> Iterator[Companion]:
    """A companion computer, system 1 component 191, that alerts; the detector's process can take its place."""
    with open_endpoint(address) as endpoint:
        yield Companion(endpoint)


COMMAND = [sys.executable, "-m", "detector"]


def ran(*options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *options], capture_output=True, text=True, timeout=PATIENCE_S, check=False)


@contextmanager
def running(
    *options: str, environ: Mapping[str, str] | None = None, before: Callable[[], object] | None = None
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The daemon, once it is ready; with its first line. before: what its process does first."""
    child = subprocess.Popen(
        [*COMMAND, *options],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **(environ or {})},
        preexec_fn=before,
    )
    try:
        assert child.stderr is not None
        first = child.stderr.readline()
        while "compiled" in first:  # on a machine that has much to do
            first = child.stderr.readline()
        yield child, first
    finally:
        if child.poll() is None:
            child.terminate()
        child.communicate(timeout=PATIENCE_S)


def port_of(line: str) -> int:
    found = re.search(r"ready: \w+:127\.0\.0\.1:(\d+)", line)
    assert found, line
    return int(found[1])


def ended(child: subprocess.Popen[str], number: int) -> tuple[int, str]:
    child.send_signal(number)
    code, stderr = child.wait(PATIENCE_S), child.stderr  # `communicate` would lose what came with the first line
    return code, stderr.read() if stderr else ""


def until(endpoint: Endpoint, vehicle: MadeVehicle, words: str, patience_s: float = PATIENCE_S) -> list[str]:
    """Fly in real time until a text with these words comes back, or for that long; all texts that came."""
    decoder, texts = Decoder({MessageId.STATUSTEXT}), list[str]()
    give_up = time.monotonic() + patience_s
    while time.monotonic() < give_up and not any(words in text for text in texts):
        for frame in vehicle.samples(2):
            endpoint.send(frame)
        time.sleep(0.02)
        for data, host_ns in endpoint.receive(0.0):
            texts += [frame.text("text") for frame in decoder.feed(data, host_ns)]
    return texts
