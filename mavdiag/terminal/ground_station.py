"""A small ground station (edge): it receives one link and keeps what a pilot would see."""

import time
from dataclasses import dataclass, field

from mavdiag.decision.diagnosis import Change
from mavdiag.link.codec import Decoder, Encoder, Frame, decode_statustext, field_index
from mavdiag.link.messages import Autopilot, Component, MavType, MessageId
from mavdiag.link.ports import Endpoint, wait
from mavdiag.link.signing import Signing
from mavdiag.printable import printable
from mavdiag.terminal.live_judge import LiveJudge

GCS_SYSID = 255
BEAT_S = 1.0  # between our heartbeats
MAV_STATE_ACTIVE, MAVLINK_VERSION = 4, 3  # in HEARTBEAT
WANTED = (MessageId.STATUSTEXT, MessageId.NAMED_VALUE_FLOAT, MessageId.ATTITUDE)
TEXTS = 10_000  # that are kept (our choice)

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
    """What has been received so far."""

    endpoint: Endpoint
    judge: LiveJudge | None = None  # judges the vehicle here, too
    speak: bool = True  # send heartbeats, so that autopilots pass on texts to this link
    vehicle: int | None = None  # the system id that is listened to; None for all
    signing: Signing | None = None  # lets only genuine frames pass
    texts: list[ReceivedText] = field(default_factory=list)  # of the detectors, each with its own vehicle's time
    figures: dict[str, float] = field(default_factory=dict)  # latest NAMED_VALUE_FLOATs of the vehicle that is shown
    _times: dict[int, float] = field(default_factory=dict)
    _decoder: Decoder = field(init=False)
    _encoder: Encoder = field(default_factory=lambda: Encoder(GCS_SYSID, Component.MISSIONPLANNER))
    _beat_s: float = 0.0

    def __post_init__(self) -> None:
        self._decoder = Decoder(WANTED, signing=self.signing)

    def listen(self, timeout_s: float) -> list[ReceivedText | Change]:
        """Take in what comes within `timeout_s`, or sooner; return new texts, and changes of the judge's decision."""
        fresh: list[ReceivedText | Change] = []
        if self.speak and time.monotonic() >= self._beat_s:
            self._beat_s = time.monotonic() + BEAT_S
            beat = (MavType.GCS, Autopilot.INVALID, 0, 0, MAV_STATE_ACTIVE, MAVLINK_VERSION)
            self.endpoint.send(self._encoder.encode(MessageId.HEARTBEAT, *beat))
        wait([self.endpoint], timeout_s)
        chunks = self.endpoint.receive(0.0)
        decode = self._decoder.feed_datagram if self.endpoint.datagrams else self._decoder.feed
        for data, host_ns in chunks:
            for frame in decode(data, host_ns):
                self._take(frame, fresh)
        if self.judge is not None:
            fresh += self.judge.take(chunks, time.monotonic_ns(), self.endpoint.sources)
        return fresh

    @property
    def heard(self) -> bool:
        """Whether any sound frame has come."""
        return bool(self._decoder.senders)

    @property
    def shown(self) -> int | None:
        """The vehicle whose time and figures are told: the one that was asked for, or the first that was heard."""
        return next(iter(self._times), None) if self.vehicle is None else self.vehicle

    @property
    def t_s(self) -> float:
        """The time of the vehicle that is shown [s]; 0 before it is heard."""
        return 0.0 if self.shown is None else self._times.get(self.shown, 0.0)

    def _take(self, frame: Frame, fresh: list[ReceivedText | Change]) -> None:
        if self.vehicle not in (None, frame.sysid):
            return
        match frame.compid, frame.msgid:
            case Component.AUTOPILOT1, MessageId.ATTITUDE:
                self._times[frame.sysid] = float(str(frame.fields[_BOOT_MS])) / 1e3
            case Component.ONBOARD_COMPUTER, MessageId.STATUSTEXT:
                text = decode_statustext(frame)
                t_s = self._times.get(frame.sysid, 0.0)
                self.texts.append(ReceivedText(text.severity, printable(text.text), t_s))
                fresh.append(self.texts[-1])
                del self.texts[:-TEXTS]
            case Component.ONBOARD_COMPUTER, MessageId.NAMED_VALUE_FLOAT if self.shown in (None, frame.sysid):
                name, value = frame.fields[_NAME], frame.fields[_VALUE]
                if isinstance(name, bytes) and isinstance(value, float):
                    self.figures[name.rstrip(b"\0").decode(errors="replace")] = value
