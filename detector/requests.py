"""What ground stations ask of the detector: its own parameters, commands, and rates that it keeps. No clock, no socket.

Frames go in with `now`; what is passed on, what is answered and what the daemon has to do come out.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from detector.config import Settings
from detector.fleet import Fleet, Turn
from detector.own_parameters import PARAMETERS, REAL32, Answer, View, answer
from detector.rate_guard import GUARDED, RateGuard
from detector.sender import MavlinkSender
from detector.values import Effect, Note
from mavdiag.baseline import Baseline
from mavdiag.decision.diagnosis import Stage
from mavdiag.link.codec import Decoder, Frame, message_name
from mavdiag.link.messages import Component, MavCmd, MavResult, MessageId
from mavdiag.link.signing import Signing
from mavdiag.link.vehicles import PARAMETER_REQUESTS, Command, command_in, parameters_asked
from mavdiag.link.wants import messages_of
from mavdiag.telemetry import Instant

__all__ = ["Handled", "Requests"]

NOTED_MOST = 64  # requests that were kept back are named once each, as long as they are so few (our choice)
NOTHING_TO_JUDGE_BY = "there is no baseline to go back to"
WHILE_LEARNING = "it can be set when learning is over"


@dataclass(frozen=True, slots=True)
class Handled:
    """What became of frames.

    passed: what goes to the vehicle.
    answers: what goes back to who sent them.
    turns: effects for the daemon.
    """

    passed: tuple[bytes, ...] = ()
    answers: tuple[bytes, ...] = ()
    turns: tuple[Turn, ...] = ()


class Requests:
    """Answers for all vehicles of a fleet.

    sender: encodes for a vehicle's detector, by system id.
    signing: of the vehicle's link, None without; frames from behind are trusted as they are.
    """

    def __init__(
        self,
        fleet: Fleet,
        settings: Settings,
        sender: Callable[[int], MavlinkSender],
        signing: Signing | None = None,
    ) -> None:
        self._fleet, self._settings, self._sender = fleet, settings, sender
        self._guard = RateGuard(signing)
        self._decoder = Decoder(GUARDED | PARAMETER_REQUESTS)
        self._noted: set[tuple[int, ...]] = set()
        self._before: dict[int, Baseline] = {}  # what was judged by before learning anew

    def from_behind(self, messages: Iterable[bytes], now: Instant) -> Handled:
        """Frames of a link behind, one in each message; all pass but requests for rates that are kept."""
        passed, answers, turns = list[bytes](), list[bytes](), list[Turn]()
        for message in messages:
            frames = self._decoder.feed_datagram(message, now.ns)
            handled = self._one(frames[0], message, now) if frames else Handled((message,))
            passed += handled.passed
            answers += handled.answers
            turns += handled.turns
        return Handled(tuple(passed), tuple(answers), tuple(turns))

    def parameters(self, sysid: int, frames: Iterable[Frame], now: Instant) -> Handled:
        """Requests about the parameters of a vehicle's detector."""
        if not self._settings.parameters or sysid not in self._fleet.vehicles:
            return Handled()
        answers, effects = list[bytes](), list[Effect]()
        for frame in frames:
            found = answer(frame)
            effects += self._change(sysid, found, now)
            view = self._view(sysid)
            for one in found.show:
                fields = (one.name, one.value(view), REAL32, len(PARAMETERS), PARAMETERS.index(one))
                answers.append(self._sender(sysid).frame(MessageId.PARAM_VALUE, *fields))
        return Handled((), tuple(answers), (Turn(sysid, tuple(effects)),) if effects else ())

    def _one(self, frame: Frame, message: bytes, now: Instant) -> Handled:
        to = parameters_asked(frame)
        if to is not None:
            return replace(self.parameters(to, (frame,), now), passed=(message,))
        if self._settings.keep_rates:
            profiles = {sysid: self._fleet.link.vehicles[sysid].profile for sysid in self._fleet.vehicles}
            needed = {sysid: frozenset(messages_of(profile).values()) for sysid, profile in profiles.items()}
            verdict = self._guard.verdict(frame, needed)
            if verdict is not None:
                asked = [
                    self._sender(one.vehicle).frame(
                        MessageId.REQUEST_DATA_STREAM,
                        one.vehicle,
                        Component.AUTOPILOT1,
                        one.group,
                        one.rate_hz,
                        one.start,
                    )
                    for one in verdict.instead
                ]
                return Handled(tuple(asked), (verdict.answer,) if verdict.answer else (), self._kept_back(frame))
        asked_of = command_in(frame)
        handled = Handled() if asked_of is None else self.command(asked_of[1], asked_of[0])
        return replace(handled, passed=(message,))

    def command(self, command: Command, sysid: int, *, trusted: bool = True) -> Handled:
        """A command for a vehicle's detector. It takes one: an inspection is acknowledged.

        trusted: it comes from a link behind, or it is signed; any other sender may be forged.
        """
        if sysid not in self._fleet.vehicles:
            return Handled()
        whose, effects, result = f"{command.sysid}/{command.compid}", tuple[Effect, ...](), MavResult.UNSUPPORTED
        if command.command == MavCmd.USER_1 and trusted:
            session = self._fleet.vehicles[sysid].session
            was_open = session.state.diagnosis.stage is Stage.INSPECT
            effects, result = session.acknowledge(whose), MavResult.ACCEPTED if was_open else MavResult.FAILED
        elif command.command == MavCmd.USER_1:
            result = MavResult.DENIED
            if (sysid, command.sysid, command.compid) not in self._noted and len(self._noted) < NOTED_MOST:
                self._noted.add((sysid, command.sysid, command.compid))
                effects = (Note(f"acknowledged by {whose} on a link that is not signed: refused, it may be forged"),)
        turns = (Turn(sysid, effects),) if effects else ()
        return Handled((), (self._sender(sysid).answer(command, result),), turns)

    def _kept_back(self, frame: Frame) -> tuple[Turn, ...]:
        """What is recorded of a request that was kept back: the first of a kind from each sender."""
        kind = (frame.sysid, frame.compid, frame.msgid)
        if kind in self._noted or len(self._noted) >= NOTED_MOST:
            return ()
        self._noted.add(kind)
        text = (
            f"{message_name(frame.msgid)} of {frame.sysid}/{frame.compid} would change rates that are needed; kept back"
        )
        return tuple(Turn(sysid, (Note(text),)) for sysid in list(self._fleet.vehicles)[:1])

    def _view(self, sysid: int) -> View:
        session = self._fleet.vehicles[sysid].session
        return View(session.spec.settings, session.state.baseline is None, self._fleet.figures_of(sysid))

    def _change(self, sysid: int, found: Answer, now: Instant) -> tuple[Effect, ...]:
        """Set a parameter: the session begins anew with what is left of the old one. A refusal is recorded."""
        if found.change is None:
            return (Note(found.refused),) if found.refused else ()
        parameter, value = found.change
        vehicle, before = self._fleet.vehicles[sysid], self._view(sysid)
        if parameter.value(before) == value:
            return ()
        spec, present = vehicle.session.spec, vehicle.session.state.baseline
        refused = ""
        if parameter.name == "MD_THR_SCALE":
            settings = spec.settings.model_copy(update={"threshold_scale": value})
            baseline, refused = present, WHILE_LEARNING if present is None else ""
        elif value > 0:
            settings = spec.settings.model_copy(update={"learn": value})
            baseline = None
        else:
            settings, baseline = spec.settings, self._before.get(sysid)
            refused = "" if baseline else NOTHING_TO_JUDGE_BY
        if refused:
            return (Note(f"{parameter.name} {value:g} refused: {refused}"),)
        if present is not None:
            self._before[sysid] = present
        left = vehicle.restart(replace(spec, baseline=baseline, settings=settings), now)
        return (*left, Note(f"{parameter.name} set from {parameter.value(before):g} to {value:g}"))
