"""What the detector sends, as MAVLink frames: it is component 191 of the vehicle's system."""

from detector.states import State
from detector.values import AskInterval, AskParameters, Effect, SendCommand, SendFloat, SendText
from mavdiag.link.clock import TimesyncMessage
from mavdiag.link.codec import Encoder
from mavdiag.link.layout import Argument
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import Command
from mavdiag.units import NS_PER_MS

MAVLINK_VERSION = 3  # HEARTBEAT.mavlink_version: what pymavlink and the autopilots fill in
_MS_TURN = 1 << 32

# MAV_STATE in the heartbeat: 2 calibrating, 3 standby, 4 active; a faulted session has none, because it sends none.
HEALTH = {State.WAITING: 3, State.LEARNING: 2, State.FITTING: 2, State.MONITORING: 4, State.LOST: 3}


class MavlinkSender:
    """Encodes for one vehicle, with its own sequence numbers. vehicle: system id."""

    def __init__(self, vehicle: int, signing: Signing | None = None) -> None:
        self._autopilot = (vehicle, Component.AUTOPILOT1)
        self._encoder = Encoder(vehicle, Component.ONBOARD_COMPUTER, signing)

    def frame(self, msgid: int, *fields: Argument) -> bytes:
        """Any message."""
        return self._encoder.encode(msgid, *fields)

    def heartbeat(self, state: State) -> bytes:
        """HEARTBEAT of a session that works. Raises KeyError for a faulted one: it must send none."""
        kinds = (MavType.ONBOARD_CONTROLLER, Autopilot.INVALID)
        return self.frame(MessageId.HEARTBEAT, *kinds, 0, 0, HEALTH[state], MAVLINK_VERSION)

    def answer(self, command: Command, result: MavResult) -> bytes:
        """COMMAND_ACK to who sent a command."""
        return self.frame(MessageId.COMMAND_ACK, command.command, result, 0, 0, command.sysid, command.compid)

    def ask(self, msgid: int) -> bytes:
        """REQUEST_MESSAGE to the vehicle's autopilot."""
        return self.frame(MessageId.COMMAND_LONG, *self._autopilot, MavCmd.REQUEST_MESSAGE, 0, msgid)

    def frames(self, effect: Effect) -> tuple[list[bytes], bool]:
        """What an effect sends, and whether everybody may read it: else it is for the vehicle's autopilot alone."""
        match effect:
            case SendText(severity, text):
                return [self._encoder.statustext(severity, text)], True
            case SendFloat(name, value, vehicle_ns):  # in the vehicle's own milliseconds
                return [
                    self.frame(MessageId.NAMED_VALUE_FLOAT, vehicle_ns // NS_PER_MS % _MS_TURN, name.encode(), value)
                ], True
            case AskInterval(msgid, interval_us):
                command = (*self._autopilot, MavCmd.SET_MESSAGE_INTERVAL, 0)
                return [self.frame(MessageId.COMMAND_LONG, *command, msgid, interval_us)], False
            case SendCommand(number, parameters, confirmation):
                order = (*self._autopilot, number, confirmation, *parameters)
                return [self.frame(MessageId.COMMAND_LONG, *order)], False
            case AskParameters(names):
                ask = MessageId.PARAM_REQUEST_READ
                return [self.frame(ask, *self._autopilot, name, -1) for name in names], False
            case TimesyncMessage(tc1_ns, ts1_ns):
                return [self.frame(MessageId.TIMESYNC, tc1_ns, ts1_ns)], False
        return [], False
