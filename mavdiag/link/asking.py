"""Asking a vehicle, as its companion: heartbeats, streams by SET_MESSAGE_INTERVAL, parameters by PARAM_REQUEST_READ.

Sans-I/O: what came and `now` in, frames to send out. Nothing is ever set or armed. The rates that were asked for stay
until the autopilot starts anew or somebody else sets them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavType, MessageId
from mavdiag.link.parameters import Reading
from mavdiag.link.signing import Signing
from mavdiag.link.wants import Want
from mavdiag.telemetry import Instant

BEAT_S = 1.0
AGAIN_S = 1.5  # a stream that has not come by then is asked for once more (our choice)
TRIES = 2
STANDBY = 3  # MAV_STATE
MAVLINK_VERSION = 3


@dataclass(frozen=True, slots=True)
class Asked:
    """What was asked so far.

    beat: when the last heartbeat went out.
    reading: the parameters.
    streams: tries and the time of the last one, by message.
    """

    beat: Instant | None = None
    reading: Reading = field(default_factory=Reading)
    streams: Mapping[int, tuple[int, Instant]] = field(default_factory=dict)


class Asker:
    """Asks one vehicle. vehicle: its system id, whose on-board computer we are. signing: signs what is sent."""

    def __init__(self, vehicle: int, signing: Signing | None = None) -> None:
        self._encoder = Encoder(vehicle, Component.ONBOARD_COMPUTER, signing)
        self._target = (vehicle, Component.AUTOPILOT1)

    def beat(self, asked: Asked, now: Instant) -> tuple[Asked, list[bytes]]:
        """A heartbeat each second."""
        if asked.beat is not None and now - asked.beat < BEAT_S:
            return asked, []
        kind = (MavType.ONBOARD_CONTROLLER, Autopilot.INVALID, 0, 0, STANDBY, MAVLINK_VERSION)
        return replace(asked, beat=now), [self._encoder.encode(MessageId.HEARTBEAT, *kind)]

    def read(self, asked: Asked, autopilot: int, known: Mapping[str, float], now: Instant) -> tuple[Asked, list[bytes]]:
        """The parameters that tell rotors and filter, until they are known. known: those that came."""
        reading, names = asked.reading.step(autopilot, known, now)
        request = (MessageId.PARAM_REQUEST_READ, *self._target)
        return replace(asked, reading=reading), [self._encoder.encode(*request, name, -1) for name in names]

    def stream(
        self, asked: Asked, wants: Sequence[Want], rates_hz: Mapping[int, float], now: Instant
    ) -> tuple[Asked, list[bytes]]:
        """The streams that do not come, or too slowly. rates_hz: of what comes, by message."""
        frames = []
        for want in wants:
            tries, at = asked.streams.get(want.msgid, (0, now))
            due = tries == 0 or (tries < TRIES and now - at >= AGAIN_S)
            if rates_hz.get(want.msgid, 0.0) < want.least_hz and due:
                asked = replace(asked, streams={**asked.streams, want.msgid: (tries + 1, now)})
                interval = (MavCmd.SET_MESSAGE_INTERVAL, 0, want.msgid, round(1e6 / want.ask_hz))
                frames.append(self._encoder.encode(MessageId.COMMAND_LONG, *self._target, *interval))
        return asked, frames
