"""The loops that serve an autopilot (edge): receive, fly, answer, until a signal or the duration ends it."""

import time
from collections.abc import Callable

from mavdiag.link.codec import Decoder
from mavdiag.link.ports import Endpoint
from sitl_plant.hil.ardupilot import Lockstep
from sitl_plant.hil.datagrams import Datagrams
from sitl_plant.hil.px4 import WANTED, Bridge
from sitl_plant.hil.simulation import Simulation

POLL_S = 0.2  # how often a signal is looked for
PATIENCE_S = 1.0  # wall clock: a sensor message that was not answered for so long is followed by the next (our choice)
SLIP_S = 0.1  # wall clock: what is later than this is not caught up


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


def serve_frames(
    endpoint: Endpoint,
    bridge: Bridge,
    *,
    period_s: float,
    lockstep: bool,
    duration_s: float,
    stop: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Fly PX4 over MAVLink until `duration_s` of flight or `stop`.

    period_s: wall clock from one sensor message to the next in lockstep, 0 for as fast as it goes; else real time.
    lockstep: wait for the controls where they ask for it; else say if an autopilot is not in HIL mode.
    """
    decoder, pace, flying, told = Decoder(WANTED), _Pace(), False, False
    feed = decoder.feed_datagram if endpoint.datagrams else decoder.feed
    while bridge.simulation.t_s < duration_s and not stop():
        flying = flying and endpoint.connected
        waits = lockstep and bridge.lockstep and not bridge.answered
        for data, host_ns in endpoint.receive(pace.left_s(waits) if flying else POLL_S):
            for frame in feed(data, host_ns):
                bridge.hear(frame)
        if not flying and endpoint.connected:
            if pace.begun:
                bridge.restart()
            flying = True
            pace.begin()
        if flying and not pace.left_s(lockstep and bridge.lockstep and not bridge.answered):
            for message in bridge.advance():
                endpoint.send(message)
            pace.note_sent(period_s if lockstep and bridge.lockstep else bridge.period_s)
        if not (lockstep or told) and bridge.in_hil is False:
            told = True
            say("the flight controller is not in HIL mode: load the file of --print-parameters px4 and restart it")


class _Pace:
    """When the next sensor message goes out."""

    def __init__(self) -> None:
        self.begun = False
        self._sent_s = self._next_s = 0.0

    def begin(self) -> None:
        """The first goes out now."""
        self.begun = True
        self._sent_s = self._next_s = time.monotonic()

    def left_s(self, waits: bool) -> float:
        """How long until then, at most `POLL_S`. waits: for the answer to the last one, as long as patience goes."""
        until_s = max(self._next_s, self._sent_s + PATIENCE_S) if waits else self._next_s
        return min(POLL_S, max(0.0, until_s - time.monotonic()))

    def note_sent(self, period_s: float) -> None:
        """One has gone out; the next is due after `period_s`."""
        self._sent_s = time.monotonic()
        self._next_s = max(self._next_s + period_s, self._sent_s - SLIP_S)
