"""`mavdiag inspect` of a live link: a vehicle that is not known, one that must be asked, none at all."""

import json
import threading
import time
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from mavdiag.commands.inspect import inspect
from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId, ModeFlag
from mavdiag.link.ports import open_endpoint


def free_address() -> str:
    with open_endpoint("udpin:127.0.0.1:0") as endpoint:
        return endpoint.address


class FreshArduPilot:
    """Sends heartbeats until it is asked for more, and knows some parameters: ArduPilot after a start.

    heard: every frame that came.
    """

    PARAMETERS: ClassVar = {
        "FRAME_CLASS": 1.0,
        "FRAME_TYPE": 1.0,
        "INS_GYRO_FILTER": 18.0,
    }  # clearly below a fifth of 100 Hz
    COUNTS = 1000

    def __init__(self) -> None:
        self.heard: list[Frame] = []
        self._encoder, self._rates = Encoder(1, Component.AUTOPILOT1), dict[int, float]()

    def answer(self, frame: Frame) -> list[bytes]:
        self.heard.append(frame)
        encode = self._encoder.encode
        if frame.msgid == MessageId.COMMAND_LONG:
            names = ("command", "param1", "param2")
            command, msgid, interval = (frame.fields[field_index(frame.msgid, name)] for name in names)
            known = msgid in (MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET, MessageId.ATTITUDE)
            self._rates |= {int(msgid): 1e6 / float(interval)} if known else {}
            result = MavResult.ACCEPTED if known else MavResult.DENIED
            return [encode(MessageId.COMMAND_ACK, command, result, 0, 0, frame.sysid, frame.compid)]
        if frame.msgid == MessageId.PARAM_REQUEST_READ:
            raw = frame.fields[field_index(frame.msgid, "param_id")]
            name = raw.partition(b"\0")[0].decode() if isinstance(raw, bytes) else ""
            found = self.PARAMETERS.get(name)
            return [] if found is None else [encode(MessageId.PARAM_VALUE, name, found, 9, 3, 0)]
        return []

    def messages(self, k: int) -> list[bytes]:
        """What it sends in the hundredth of a second number k."""
        encode, t_ms = self._encoder.encode, 5000 + 10 * k
        beat = (MavType.QUADROTOR, Autopilot.ARDUPILOTMEGA, ModeFlag.SAFETY_ARMED, 0, 4, 3)
        frames = [encode(MessageId.HEARTBEAT, *beat)] if k % 100 == 0 else []
        for msgid, rate_hz in self._rates.items():
            if k % max(1, round(100 / rate_hz)):
                continue
            if msgid == MessageId.RAW_IMU:
                frames.append(encode(msgid, 1000 * t_ms, 0, 0, -self.COUNTS, 1, 2, 3))
            elif msgid == MessageId.ATTITUDE_TARGET:
                frames.append(encode(msgid, t_ms, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5))
            else:
                frames.append(encode(msgid, t_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        return frames

    def run(self, address: str, stop: threading.Event) -> None:
        """By the clock: every message is sent, however seldom this runs; maybe the first before anybody listens."""
        decoder, began_s, k = Decoder(), time.monotonic(), 0
        with open_endpoint(address.replace("udpin", "udpout")) as endpoint:
            while not stop.wait(0.01):
                chunks = endpoint.receive(0.0)
                heard = [frame for data, host_ns in chunks for frame in decoder.feed_datagram(data, host_ns)]
                answers = [answer for frame in heard for answer in self.answer(frame)]
                first, k = k, 1 + int(100 * (time.monotonic() - began_s))
                for sent in (*answers, *(message for step in range(first, k) for message in self.messages(step))):
                    endpoint.send(sent)


def beside(vehicle: FreshArduPilot, look: Callable[[str], None]) -> None:
    address, stop = free_address(), threading.Event()
    sender = threading.Thread(target=vehicle.run, args=(address, stop))
    sender.start()
    try:
        look(address)
    finally:
        stop.set()
        sender.join()


@pytest.mark.realtime
def test_l10_a_fresh_ardupilot_link_is_told_what_gives_each_monitor_its_streams(
    capsys: pytest.CaptureFixture[str],
) -> None:
    vehicle = FreshArduPilot()
    beside(vehicle, lambda address: inspect([address], duration=3.0))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "profile ardupilot" in shown
    for words in ("no RAW_IMU: SRn_RAW_SENS", "no VIBRATION: SRn_EXTRA3", "no ATTITUDE: SRn_EXTRA1", "--ask"):
        assert words in shown, words
    assert "works" not in shown
    assert vehicle.heard == []  # it listens only


@pytest.mark.realtime
def test_a_fresh_ardupilot_link_is_asked_for_streams_and_rotors_and_nothing_is_set(
    capsys: pytest.CaptureFixture[str],
) -> None:
    vehicle = FreshArduPilot()
    beside(vehicle, lambda address: inspect([address], duration=3.0, ask=True, as_json=True))
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    works = {one["monitor"] for one in found["monitors"] if one["works"]}
    assert {"fsd", "innovation", "rotor_signature", "sensor_drift", "control_loss", "thrust_loss"} == works
    missing = {one["monitor"]: " ".join(one["missing"]) for one in found["monitors"]}
    assert "no SERVO_OUTPUT_RAW: SRn_RC_CHAN" in missing["rotor_trim"]
    assert "low-passed at 18 Hz" in missing["unbalance"]
    assert "FRAME_CLASS 1, FRAME_TYPE 1" in found["rotors"]
    assert found["units"]["gravity_g"] == pytest.approx(1.0, abs=0.03)
    assert any("ACCEPTED, DENIED" in one or "DENIED, ACCEPTED" in one for one in found["asked"])
    sent = {frame.msgid for frame in vehicle.heard}
    assert sent == {MessageId.HEARTBEAT, MessageId.COMMAND_LONG, MessageId.PARAM_REQUEST_READ}
    place = field_index(MessageId.COMMAND_LONG, "command")
    commands = {frame.fields[place] for frame in vehicle.heard if frame.msgid == MessageId.COMMAND_LONG}
    assert commands == {MavCmd.SET_MESSAGE_INTERVAL}
