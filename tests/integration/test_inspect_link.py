"""`mavdiag inspect` of a live link whose vehicle is not known."""

import threading
import time

import pytest

from mavdiag.commands.listen import UNKNOWN, listen
from mavdiag.errors import InputError
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Component, MavType, MessageId
from mavdiag.link.ports import open_endpoint
from mavdiag.telemetry import Signal


def free_address() -> str:
    with open_endpoint("udpin:127.0.0.1:0") as endpoint:
        return endpoint.address


def send(address: str, sysids: tuple[int, ...], stop: threading.Event) -> None:
    """Heartbeats of an autopilot that nobody knows, and attitudes, from each of these vehicles."""
    encoders = [Encoder(sysid, Component.AUTOPILOT1) for sysid in sysids]
    with open_endpoint(address.replace("udpin", "udpout")) as endpoint:
        for count in range(10_000):
            for encoder in encoders:
                endpoint.send(encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, 19, 0, 0, 4, 3))
                endpoint.send(encoder.encode(MessageId.ATTITUDE, 20 * count, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
            if stop.wait(0.02):
                return


@pytest.mark.realtime
@pytest.mark.parametrize("sysids", [(1,), (1, 2)])
def test_l10_an_unknown_vehicle_is_called_unknown_and_no_qdrone2(sysids: tuple[int, ...]) -> None:
    address, stop = free_address(), threading.Event()
    sender = threading.Thread(target=send, args=(address, sysids, stop))
    sender.start()
    try:
        time.sleep(0.1)
        if len(sysids) > 1:
            with pytest.raises(InputError, match="the system ids 1, 2 send; choose one with --vehicle"):
                listen(address, 0.5, None)
        log = listen(address, 0.5, sysids[-1])
    finally:
        stop.set()
        sender.join()
    assert log.profile == UNKNOWN
    assert "profile is not clear" in log.notes[0]
    assert len(log[Signal.ATTITUDE]) > 5
    with pytest.raises(InputError, match=r"nothing arrived in 0\.1 s"):
        listen(address, 0.1, None)
