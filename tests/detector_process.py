"""The detector as a process: started with options, awaited, stopped, and flown at."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from made_vehicle import MadeVehicle
from patience import PATIENCE_S

from mavdiag.link.codec import Decoder
from mavdiag.link.messages import MessageId
from mavdiag.link.ports import Endpoint

COMMAND = [sys.executable, "-m", "detector"]


def ran(*options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *options], capture_output=True, text=True, timeout=PATIENCE_S, check=False)


@contextmanager
def running(
    *options: str, environ: Mapping[str, str] | None = None, before: Callable[[], None] | None = None
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
        while "compiling" in first:  # on a machine that has much to do
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
    _, rest = child.communicate(timeout=PATIENCE_S)
    return child.returncode, rest


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
