"""A small ground station for the demo (edge): it receives one link and keeps what a pilot would see."""

from dataclasses import dataclass, field

from mavdiag.link.codec import Decoder, Encoder, Frame, decode_statustext, field_index
from mavdiag.link.messages import Component, MavCmd, MessageId
from mavdiag.link.ports import Endpoint, wait
from mavdiag.printable import printable

__all__ = ["GroundStation", "ReceivedText"]

GCS_SYSID = 255
WANTED = (MessageId.STATUSTEXT, MessageId.NAMED_VALUE_FLOAT, MessageId.ATTITUDE)
UNWANTED = (MessageId.RAW_IMU, MessageId.ATTITUDE_TARGET)  # a pilot's display does not need a thousand of them a second

_BOOT_MS = field_index(MessageId.ATTITUDE, "time_boot_ms")
_NAME = field_index(MessageId.NAMED_VALUE_FLOAT, "name")
_VALUE = field_index(MessageId.NAMED_VALUE_FLOAT, "value")


@dataclass(frozen=True, slots=True)
class ReceivedText:
    """A STATUSTEXT of the detector and the vehicle's time [s] when it came."""

    severity: int
    text: str
    t_s: float


@dataclass(slots=True)
class GroundStation:
    """What has been received so far.

    t_s: the vehicle's time [s].
    texts: of the detector, in order.
    figures: the detector's latest NAMED_VALUE_FLOATs by name.
    """

    endpoint: Endpoint
    t_s: float = 0.0
    texts: list[ReceivedText] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    _decoder: Decoder = field(default_factory=lambda: Decoder(WANTED))
    _encoder: Encoder = field(default_factory=lambda: Encoder(GCS_SYSID, Component.MISSIONPLANNER))
    _asked: bool = False

    def listen(self, timeout_s: float) -> None:
        """Take in what comes within `timeout_s`, or sooner."""
        wait([self.endpoint], timeout_s)
        for data, host_ns in self.endpoint.receive(0.0):
            for frame in self._decoder.feed_datagram(data, host_ns):
                self._take(frame)

    def _take(self, frame: Frame) -> None:
        if frame.msgid == MessageId.ATTITUDE:
            self.t_s = float(str(frame.fields[_BOOT_MS])) / 1e3
            self._stop_fast_streams(frame.sysid)
        elif frame.compid == Component.ONBOARD_COMPUTER and frame.msgid == MessageId.STATUSTEXT:
            text = decode_statustext(frame)
            self.texts.append(ReceivedText(text.severity, printable(text.text), self.t_s))
        elif frame.compid == Component.ONBOARD_COMPUTER and frame.msgid == MessageId.NAMED_VALUE_FLOAT:
            name, value = frame.fields[_NAME], frame.fields[_VALUE]
            if isinstance(name, bytes) and isinstance(value, float):
                self.figures[name.rstrip(b"\0").decode(errors="replace")] = value

    def _stop_fast_streams(self, sysid: int) -> None:
        """Ask once that the fast streams are not sent on this link."""
        if not self._asked:
            self._asked = True
            for message in UNWANTED:
                stop = (MavCmd.SET_MESSAGE_INTERVAL, 0, message, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                command = self._encoder.encode(MessageId.COMMAND_LONG, sysid, Component.AUTOPILOT1, *stop)
                self.endpoint.send(command)
