"""`mavdiag inspect` of a live link whose vehicle is not known."""

import threading

import pytest

from mavdiag.commands.inspect import inspect
from mavdiag.errors import InputError
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Component, MavType, MessageId
from mavdiag.link.ports import open_endpoint


def free_address() -> str:
    with open_endpoint("udpin:127.0.0.1:0") as endpoint:
        return endpoint.address


def send(address: str, autopilot: int, stop: threading.Event) -> None:
    """Heartbeats and attitudes of a vehicle that nobody has asked for more yet."""
    encoder = Encoder(1, Component.AUTOPILOT1)
    with open_endpoint(address.replace("udpin", "udpout")) as endpoint:
        for count in range(10_000):
            endpoint.send(encoder.encode(MessageId.HEARTBEAT, MavType.QUADROTOR, autopilot, 0, 0, 4, 3))
            endpoint.send(encoder.encode(MessageId.ATTITUDE, 20 * count, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
            if stop.wait(0.02):
                return


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("autopilot", "words"),
    [(19, "profile is not clear: it sends no IMU message and its autopilot is not known"), (3, "")],
)
def test_l10_a_vehicle_without_imu_is_never_called_a_qdrone2(
    autopilot: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    address, stop = free_address(), threading.Event()
    sender = threading.Thread(target=send, args=(address, autopilot, stop))
    sender.start()
    try:
        if words:
            with pytest.raises(InputError, match=words):
                inspect(address, duration=1.5)
        else:
            inspect(address, duration=1.5)
    finally:
        stop.set()
        sender.join()
    shown = capsys.readouterr().out
    assert "qdrone2" not in shown
    assert ("profile ardupilot" in shown) == (not words)


@pytest.mark.realtime
def test_a_link_on_which_nothing_comes_is_a_line_that_says_so() -> None:
    with pytest.raises(InputError, match="nothing was received; is the vehicle sending"):
        inspect(free_address(), duration=0.1)
