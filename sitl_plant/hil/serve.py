"""The loops that serve an autopilot (edge): receive, fly, answer, until a signal or the duration ends it."""

import time
from collections.abc import Callable

from sitl_plant.hil.ardupilot import Lockstep
from sitl_plant.hil.datagrams import Datagrams
from sitl_plant.hil.simulation import Simulation

__all__ = ["serve_json"]

POLL_S = 0.2  # how often a signal is looked for


def serve_json(
    port: Datagrams,
    lockstep: Lockstep,
    simulation: Simulation,
    *,
    duration_s: float,
    stop: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Answer ArduPilot until `duration_s` of flight or `stop`. say: is told of the first datagram that is no frame."""
    while simulation.t_s < duration_s and not stop():
        received = port.receive(POLL_S)
        if received is None:
            continue
        data, peer = received
        foreign = lockstep.counts.foreign
        answer = lockstep.feed(data, peer, time.monotonic())
        if answer is not None:
            port.send(answer, peer)
        elif lockstep.counts.foreign == 1 > foreign:
            say(f"ignored {len(data)} bytes that are no servo frame of ArduPilot, and shall ignore others silently")
