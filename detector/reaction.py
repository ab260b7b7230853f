"""What the detector does about a fault, if the table of `detector.rules` asks for it. No clock, no socket.

Every row of the table that a diagnosis calls for has a life of its own, `TABLE`. It counts from the finding on, is
announced `NOTICE_S` before it acts, or as long as its delay, and may be called off from then on: by another flight
mode, a stick, an acknowledgement. A row that acted or was called off is over for this flight, and so are all rows of
findings that are less grave. Only the session's own diagnosis calls for a row, and only while the vehicle is armed and
in one of the modes named, or that an action brought. The answer must be the vehicle's own autopilot's, to us.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from detector.alerts import Kind, Notice
from detector.rules import BROUGHT, Rule, names_of
from detector.values import Effect, Note, SendCommand
from mavdiag.decision.diagnosis import Diagnosis
from mavdiag.decision.words import motors_words
from mavdiag.link.messages import Autopilot, MavCmd, MavResult, mode_name
from mavdiag.link.vehicles import Received
from mavdiag.telemetry import Instant

NOTICE_S = 5.0  # an action is announced so long before (our choice: time to look up and touch a stick)
ANSWER_S = 1.0  # without an acknowledgement for so long the command is sent once more, or given up (our choice)
OWN_S = 3.0  # after a command of ours another mode is its effect: heartbeats come once a second (our choice)
STICK = 100  # a stick is moved by so much: of 1000 us of a channel, of 1000 of MANUAL_CONTROL (our choice)
_TAKEN = (MavResult.ACCEPTED, MavResult.IN_PROGRESS)


class Step(StrEnum):
    """Where a row stands."""

    COUNTING = "counting"  # its finding is there
    ANNOUNCED = "announced"
    ASKED = "asked"  # the command was sent
    ASKED_AGAIN = "asked again"
    OVER = "over"


class Trigger(StrEnum):
    """What moves a row."""

    NEAR = "its time is near"
    DUE = "its time has come"
    TAKEN = "the autopilot took it"
    NOT_TAKEN = "the autopilot did not take it"
    TOLD = "the text was sent"
    CALLED_OFF = "called off"
    GONE = "no longer called for"


_ENDS = {Trigger.CALLED_OFF: Step.OVER, Trigger.GONE: Step.OVER}
TABLE: Mapping[Step, Mapping[Trigger, Step]] = {
    Step.COUNTING: {Trigger.NEAR: Step.ANNOUNCED, Trigger.DUE: Step.ASKED, Trigger.TOLD: Step.OVER, **_ENDS},
    Step.ANNOUNCED: {Trigger.DUE: Step.ASKED, **_ENDS},
    Step.ASKED: {Trigger.TAKEN: Step.OVER, Trigger.NOT_TAKEN: Step.ASKED_AGAIN, Trigger.GONE: Step.OVER},
    Step.ASKED_AGAIN: {Trigger.TAKEN: Step.OVER, Trigger.NOT_TAKEN: Step.OVER, Trigger.GONE: Step.OVER},
    Step.OVER: {},
}
_ASKED = (Step.ASKED, Step.ASKED_AGAIN)


@dataclass(slots=True)
class _Row:
    since: Instant
    asked: Instant  # when its command was sent last
    step: Step = Step.COUNTING
    mode: int | None = None  # when it was announced
    sticks: dict[tuple[int, str], int] = field(default_factory=dict)


class Reaction:
    """That of one vehicle. modes: names or numbers of flight modes. autopilot: MAV_AUTOPILOT."""

    def __init__(self, rules: Sequence[Rule], modes: Collection[str] = (), autopilot: int = 0) -> None:
        self._rules, self._modes, self._autopilot = tuple(rules), frozenset(modes), autopilot
        self._rows: dict[int, _Row] = {}
        self._holds_in = self._modes  # and, once it has commanded anything in this flight, `BROUGHT`
        self._open = len(self._rules)  # rows from this one on are over for this flight
        self._mode: int | None = None
        self._sticks: dict[tuple[int, str], int] = {}
        self._own_until: Instant | None = None
        self._effects: list[Effect] = []

    @property
    def blind(self) -> bool:
        """Whether the table has more than texts, and it was never told where the sticks are."""
        return not self._sticks and any(rule.command is not None for rule in self._rules)

    @property
    def pending(self) -> list[int]:
        """The rows that are about to do something, and may be called off."""
        return [n for n, row in self._rows.items() if row.step not in _ASKED and self._rules[n].command is not None]

    def step(self, held: Diagnosis, armed: bool, received: Received, now: Instant) -> list[Effect]:
        """Take in what came and what is held of the vehicle now; return what to do and to say."""
        if not self._rules:
            return []
        self._effects = []
        self._mode = self._mode if received.mode is None else received.mode
        ready = armed and not self._holds_in.isdisjoint({mode_name(self._mode), str(self._mode)})
        self._watch(received, now)
        names = names_of(held) if ready else ()
        name = next((name for name in names if any(rule.finding == name for rule in self._rules)), None)
        for number, rule in enumerate(self._rules):
            row = self._rows.get(number)
            if rule.finding != name or number >= self._open:
                # What was sent is answered in another mode too, which it brings
                if row is not None and not (row.step in _ASKED and armed and names_of(held)):
                    where = f"mode {mode_name(self._mode)}" if armed else "disarmed"
                    self._move(number, Trigger.GONE, held.title if ready else where)
            elif row is None:
                self._rows[number] = _Row(now, now)
                self._effects.append(Note(f"on fault: {rule}: {held}"))
        for number in sorted(self._rows):
            if number in self._rows:
                self._wait(number, held, received, now)
        if not armed:
            self._open, self._rows, self._holds_in = len(self._rules), {}, self._modes
        return self._effects

    def acknowledge(self, whose: str) -> list[Effect]:
        """Call off what is pending. whose: who says so."""
        self._effects = []
        if pending := self.pending:
            self._call_off(min(pending), f"acknowledged by {whose}")
        return self._effects

    def _watch(self, received: Received, now: Instant) -> None:
        self._sticks |= received.sticks
        own = self._own_until is not None and now.ns < self._own_until.ns
        for number, row in sorted(self._rows.items()):
            changed = f"mode {mode_name(self._mode)}" if self._mode != row.mode else ""
            if row.step in _ASKED and changed:
                self._move(number, Trigger.TAKEN, changed)
            elif row.step is Step.ANNOUNCED and (changed or _moved(received.sticks, row.sticks)):
                if own and changed:
                    row.mode = self._mode
                else:
                    return self._call_off(number, changed or "a stick was moved")
        return None

    def _wait(self, number: int, held: Diagnosis, received: Received, now: Instant) -> None:
        rule, row = self._rules[number], self._rows[number]
        waited_s = now - row.since
        match row.step:
            case Step.COUNTING if waited_s < rule.delay_s and rule.command is not None:
                if waited_s >= rule.delay_s - min(NOTICE_S, rule.delay_s):
                    left = f"{rule.delay_s - waited_s:.0f} s unless stick/mode/ack"
                    self._effects.append(Notice(Kind.REACTING, (rule.action, left)).effect)
                    self._move(number, Trigger.NEAR)
            case Step.COUNTING | Step.ANNOUNCED if waited_s >= rule.delay_s:
                motors = f"{rule.finding}, {motors_words(held)}"
                if rule.command is None:
                    self._effects.append(Notice(Kind.ON_FAULT, (motors,)).effect)
                    self._move(number, Trigger.TOLD)
                else:
                    self._effects.append(Notice(Kind.REACTED, (rule.action, f"commanded: {motors}")).effect)
                    self._move(number, Trigger.DUE)
                    self._ask(number, now)
                self._close(number)
            case Step.ASKED | Step.ASKED_AGAIN:
                command = self._command(rule)
                results = [ack.result for ack in received.acks if ack.command == command]
                if results and results[-1] in _TAKEN:
                    self._own_until = now + OWN_S
                    self._move(number, Trigger.TAKEN)
                elif results or now - row.asked >= ANSWER_S:
                    why = next((result.name for result in MavResult if result in results[-1:]), "no answer")
                    again = row.step is Step.ASKED
                    self._move(number, Trigger.NOT_TAKEN, why)
                    if again:
                        self._ask(number, now)
                    else:
                        self._effects.append(Notice(Kind.REACTED, (rule.action, f"not taken, {why}")).effect)

    def _ask(self, number: int, now: Instant) -> None:
        rule, row = self._rules[number], self._rows[number]
        row.asked, self._own_until = now, now + OWN_S
        self._holds_in |= BROUGHT
        self._effects.append(SendCommand(self._command(rule), rule.parameters, int(row.step is Step.ASKED_AGAIN)))

    def _command(self, rule: Rule) -> int:
        """The command of a row; PX4 has no pause of a mission but its hold mode, from which the mission goes on."""
        pauses = rule.command == MavCmd.DO_PAUSE_CONTINUE and self._autopilot == Autopilot.PX4
        return MavCmd.NAV_LOITER_UNLIM if pauses else rule.command or 0

    def _close(self, number: int) -> None:
        """Let this row and those that are less grave be over for this flight."""
        self._open = min(self._open, number)
        for other in [other for other in self._rows if other > number]:
            self._move(other, Trigger.GONE, f"{self._rules[number].action} goes before")

    def _call_off(self, number: int, why: str) -> None:
        """Call off all rows of a row's finding, and those that are less grave."""
        rule = self._rules[number]
        number = next(n for n, other in enumerate(self._rules) if other.finding == rule.finding)
        for other in [other for other, row in self._rows.items() if other >= number and row.step not in _ASKED]:
            self._move(other, Trigger.CALLED_OFF, why)
        self._close(number)
        self._effects.append(Notice(Kind.REACTED, (rule.action, f"called off: {why}")).effect)

    def _move(self, number: int, trigger: Trigger, why: str = "") -> None:
        row = self._rows[number]
        old, row.step = row.step, TABLE[row.step][trigger]
        if trigger in (Trigger.NEAR, Trigger.DUE):
            row.mode, row.sticks = self._mode, dict(self._sticks)
        told = f"{trigger}: {why}" if why else str(trigger)
        self._effects.append(Note(f"on fault: {self._rules[number]}: {old} -> {row.step}: {told}"))
        if row.step is Step.OVER:
            del self._rows[number]


def _moved(sticks: Mapping[tuple[int, str], int], before: dict[tuple[int, str], int]) -> bool:
    """Whether sticks are elsewhere than before; those told for the first time are noted there."""
    return any(abs(at - before.setdefault(stick, at)) >= STICK for stick, at in sticks.items())
