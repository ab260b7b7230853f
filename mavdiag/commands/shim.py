"""`mavdiag shim`: a bad link between two endpoints, to see what a link does to a verdict."""

import time
from dataclasses import asdict
from functools import partial
from typing import Annotated

import typer
from typer import Argument, Option

from mavdiag.commandline import stop_signals
from mavdiag.link.codec import split_frames
from mavdiag.link.ports import Endpoint, open_endpoint, wait
from mavdiag.link.shim import Impairment, Shim

LOOK_S = 0.001  # how often it looks whether a message is due
PROBABILITY = partial(Option, metavar="P", min=0.0, max=1.0)
SPAN = partial(Option, metavar="MS", min=0.0, max=60_000.0)


class Passage:
    """One direction: what is received at one end goes through a shim to the other. Byte streams are cut into frames.

    A datagram is taken to have come when the system says. The frames of a piece of a byte stream are taken to have come
    evenly since the piece before, for a busy machine reads hundreds at once.
    """

    def __init__(self, source: Endpoint, target: Endpoint, through: Shim) -> None:
        self._source, self._target, self.shim = source, target, through
        self._begun = b""
        self._before_ns: int | None = None

    def step(self, now_ns: int) -> None:
        """Take what came, send what is due."""
        for data, at_ns in self._source.receive(0.0):
            messages = [data]
            if not self._source.datagrams:
                messages, self._begun = split_frames(self._begun + data)
            before_ns = at_ns if self._before_ns is None else self._before_ns
            self._before_ns = max(at_ns, before_ns)
            for number, message in enumerate(messages, 1):
                self.shim.offer(message, before_ns + (self._before_ns - before_ns) * number // len(messages))
        for message in self.shim.due(now_ns):
            self._target.send(message)


def shim(
    vehicle: Annotated[str, Argument(metavar="IN", help="The vehicle's side: udpin:127.0.0.1:14550, ...")],
    daemon: Annotated[str, Argument(metavar="OUT", help="The other side: udpout:127.0.0.1:14551, ...")],
    loss: Annotated[float, PROBABILITY(help="Probability that a message is lost.")] = 0.0,
    jitter: Annotated[float, SPAN(help="The delay varies by so much, up and down.")] = 0.0,
    reorder: Annotated[int, Option(metavar="DEPTH", min=0, max=1000, help="Messages that may overtake one.")] = 0,
    duplicate: Annotated[float, PROBABILITY(help="Probability that a message comes twice.")] = 0.0,
    corrupt: Annotated[float, PROBABILITY(help="Probability that one bit of it is changed.")] = 0.0,
    rate: Annotated[
        float | None, Option(metavar="BYTES_PER_S", min=1.0, max=1e12, help="What the line carries.")
    ] = None,
    delay: Annotated[float, SPAN(help="How long a message takes.")] = 0.0,
    seed: Annotated[int, Option(metavar="N", help="The same seed gives the same fate to the same messages.")] = 0,
    both: Annotated[bool, Option("--both", help="Impair the way back to the vehicle as well.")] = False,
) -> None:
    """Pass messages between two endpoints both ways, and impair those that come from IN. Ctrl-C ends it."""
    bad = Impairment(loss, jitter / 1e3, reorder, duplicate, corrupt, rate, delay / 1e3)
    back = bad if both else Impairment()
    with open_endpoint(vehicle) as near, open_endpoint(daemon) as far, stop_signals() as stopped:
        ways = (Passage(near, far, Shim(bad, seed)), Passage(far, near, Shim(back, seed + 1)))
        typer.echo(f"ready: {near.address} to {far.address}", err=True)
        while not stopped():
            for way in ways:
                way.step(time.monotonic_ns())
            wait((near, far), LOOK_S)
    for name, way in zip(("from IN to OUT", "from OUT to IN"), ways, strict=True):
        typer.echo(f"{name}: {', '.join(f'{count} {what}' for what, count in asdict(way.shim.count).items())}")
