"""What the detector sends, as MAVLink frames: it is component 191 of the vehicle's system."""

from collections.abc import Mapping

from detector.states import State
from detector.values import AskInterval, AskParameters, SendFloat, SendText
from mavdiag.link.clock import TimesyncMessage
from mavdiag.link.codec import Encoder
from mavdiag.link.layout import Argument
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import Command
from mavdiag.units import NS_PER_MS

__all__ = ["HEALTH", "MavlinkSender"]

MAVLINK_VERSION = 3  # HEARTBEAT.mavlink_version: what pymavlink and the autopilots fill in
_MS_TURN = 1 << 32

# MAV_STATE in the heartbeat; a faulted session has none, because it sends none.
_CALIBRATING, _STANDBY, _ACTIVE = 2, 3, 4
HEALTH: Mapping[State, int] = {
    State.WAITING: _STANDBY,
    State.LEARNING: _CALIBRATING,
    State.FITTING: _CALIBRATING,
    State.MONITORING: _ACTIVE,
    State.LOST: _STANDBY,
}


class MavlinkSender:
    """Encodes for one vehicle, with its own sequence numbers. vehicle: system id. signing: signs what is sent."""

    def __init__(self, vehicle: int, signing: Signing | None = None) -> None:
        self._vehicle = vehicle
        self._encoder = Encoder(vehicle, Component.ONBOARD_COMPUTER, signing)

    def heartbeat(self, state: State) -> bytes:
        """HEARTBEAT of a healthy session. Raises KeyError for a faulted one: it must send none."""
        return self._encoder.encode(
            MessageId.HEARTBEAT, MavType.ONBOARD_CONTROLLER, Autopilot.INVALID, 0, 0, HEALTH[state], MAVLINK_VERSION
        )

    def text(self, effect: SendText) -> bytes:
        """STATUSTEXT."""
        return self._encoder.statustext(effect.severity, effect.text)

    def value(self, effect: SendFloat) -> bytes:
        """NAMED_VALUE_FLOAT, in the vehicle's own milliseconds."""
        time_boot_ms = effect.vehicle_ns // NS_PER_MS % _MS_TURN
        return self._encoder.encode(MessageId.NAMED_VALUE_FLOAT, time_boot_ms, effect.name, effect.value)

    def request(self, effect: AskInterval) -> bytes:
        """COMMAND_LONG with MAV_CMD_SET_MESSAGE_INTERVAL."""
        target = (self._vehicle, Component.AUTOPILOT1)
        return self._encoder.encode(
            MessageId.COMMAND_LONG, *target, MavCmd.SET_MESSAGE_INTERVAL, 0, effect.msgid, effect.interval_us
        )

    def frame(self, msgid: int, *fields: Argument) -> bytes:
        """Any other message, in the same sequence."""
        return self._encoder.encode(msgid, *fields)

    def read(self, effect: AskParameters) -> list[bytes]:
        """PARAM_REQUEST_READ by name, one for each parameter."""
        target = (self._vehicle, Component.AUTOPILOT1)
        by_name = (MessageId.PARAM_REQUEST_READ, *target)
        return [self._encoder.encode(*by_name, name, -1) for name in effect.names]

    def timesync(self, message: TimesyncMessage) -> bytes:
        """TIMESYNC to the vehicle's autopilot."""
        return self._encoder.encode(MessageId.TIMESYNC, message.tc1_ns, message.ts1_ns)

    def answer(self, command: Command, result: MavResult) -> bytes:
        """COMMAND_ACK to who sent a command."""
        to = (command.sysid, command.compid)
        return self._encoder.encode(MessageId.COMMAND_ACK, command.command, result, 0, 0, *to)
