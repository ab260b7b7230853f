"""What is said to the operator, how loudly and how often: a table, and a presenter that keeps to it.

A *lasting* matter is offered at every step. It is said when it begins, when what it is about changes, and at the times
that the table gives; it is over once it was not offered for 5 s. Anything else is offered and said once. The texts of a
vehicle, but for those of reactions and guards, keep to a budget a minute, half of it for declared faults; what that
holds back is counted and recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

from detector.values import Effect, SendFloat, SendText, TextSuppressed
from mavdiag.chain import ChainOutput
from mavdiag.decision.diagnosis import Diagnosis, Stage
from mavdiag.decision.words import finding_words, motors_words
from mavdiag.link.codec import TEXT_BYTES
from mavdiag.link.messages import Severity
from mavdiag.monitors.base import FaultKind
from mavdiag.rows.block import RESIDUAL, VALUE
from mavdiag.telemetry import Axis, Instant

GAP_S = 2.0  # MAVProxy suppresses identical text within 2 s
MINUTE_S = 60.0
LULL_S = 5.0  # a lasting matter that is offered again within so long goes on where it was (our choice)


@dataclass(frozen=True, slots=True)
class Policy:
    """How a kind is said."""

    severity: Severity  # of the STATUSTEXT
    template: str  # takes the notice's words
    again_s: tuple[float, ...] = ()  # after its beginning; then as far apart as the last two. Empty: said once
    wait_s: float = 0.0  # before it is said first; if something critical comes in its place, it is not said at all

    def times(self, begun_s: float) -> int:
        """How often a matter that began so long ago ought to have been said.

        >>> fault = Policy(Severity.CRITICAL, "", (5.0, 15.0, 60.0, 120.0))
        >>> [fault.times(s) for s in (0.0, 4.9, 5.0, 15.0, 60.0, 120.0, 180.0)]
        [1, 1, 2, 3, 4, 5, 6]
        """
        if not self.again_s or begun_s < self.again_s[-1]:
            return 1 + sum(begun_s >= time_s for time_s in self.again_s)
        *_, period_s = (b - a for a, b in pairwise((0.0, *self.again_s)))
        return 1 + len(self.again_s) + int((begun_s - self.again_s[-1]) / period_s)


_ALERT_S = (5.0, 15.0, 60.0, 120.0)  # then every 60 s


class Kind(Enum):
    """What a text is about. Times are our choices; ground stations pop up the severities 0 to 3."""

    FAULT = Policy(Severity.CRITICAL, "PROP FAULT {}", _ALERT_S)  # what was found
    SENSOR = Policy(Severity.CRITICAL, "PROP SENSOR FAULT {}", _ALERT_S)  # what was found
    CONTROL = Policy(Severity.CRITICAL, "PROP CONTROL LOST {}", _ALERT_S)  # the rotor that was named before
    THRUST = Policy(Severity.CRITICAL, "PROP THRUST LOST {}", _ALERT_S)  # the rotor, if it is known
    # What was found. It is for maintenance; a fault that begins is suspected for some looks before it is declared.
    SUSPECT = Policy(Severity.WARNING, "PROP suspect {}", _ALERT_S, wait_s=1.0)
    AGAIN = Policy(Severity.WARNING, "PROP seen again: {}", _ALERT_S)  # what was found
    UNSEEN = Policy(Severity.INFO, "PROP no longer seen: {}", (300.0,))  # which motors
    INSPECT = Policy(Severity.WARNING, "PROP {}: inspect before flight", (300.0,))  # which motors
    ACKNOWLEDGED = Policy(Severity.INFO, "PROP {}: inspection acknowledged")  # which motors
    WAITING = Policy(Severity.INFO, "PROP waiting: {}", (60.0,))  # reason
    LEARNING = Policy(Severity.INFO, "PROP learning {}%{}", (60.0,))  # progress, ": reason"
    FITTING = Policy(Severity.INFO, "PROP fitting the baseline")
    LEARNED = Policy(Severity.INFO, "PROP baseline learned: {} monitors{}")  # how many, ", N cannot"
    NOT_LEARNED = Policy(Severity.WARNING, "PROP not learned, goes on: {}")  # reason
    MONITORING = Policy(Severity.INFO, "PROP monitoring{}", (300.0,))  # ": reason" or "; what is not judged"
    HIDDEN = Policy(Severity.WARNING, "PROP not judged: {}", (60.0,))  # why, although it flies
    LINK_LOST = Policy(Severity.INFO, "PROP link lost")
    LINK_BACK = Policy(Severity.INFO, "PROP link back after {}s")  # how long
    REBOOT = Policy(Severity.INFO, "PROP vehicle rebooted, starting anew")
    OFF = Policy(Severity.WARNING, "PROP OFF: {}", (60.0,))  # reason
    RATES = Policy(Severity.INFO, "PROP got {}")  # message and rate, ...
    NO_LAYOUT = Policy(Severity.WARNING, "PROP rotor layout unknown: {} monitors off")  # how many
    OTHER_VEHICLE = Policy(Severity.WARNING, "PROP not the vehicle of the baseline")
    OTHER_GYRO = Policy(Severity.WARNING, "PROP another gyro: {}")  # its message
    REACTING = Policy(Severity.CRITICAL, "PROP {} in {}")  # the action, how long and what calls it off
    REACTED = Policy(Severity.CRITICAL, "PROP {} {}")  # the action, what became of it
    ON_FAULT = Policy(Severity.CRITICAL, "PROP on fault: {}")  # what was found
    OTHER_LAYOUT = Policy(Severity.WARNING, "PROP flights contradict rotor layout {}")  # its name


_LOUD = frozenset(kind for kind in Kind if kind.value.severity <= Severity.CRITICAL)
_DECLARED = {FaultKind.SENSOR: Kind.SENSOR, FaultKind.LOSS_OF_CONTROL: Kind.CONTROL, FaultKind.GROSS_LOSS: Kind.THRUST}


@dataclass(frozen=True, slots=True)
class Notice:
    """Something to say."""

    kind: Kind
    words: tuple[str, ...] = ()  # fill the template
    key: str = ""  # what a lasting matter is about: another key is news

    @property
    def text(self) -> str:
        """The text, within `TEXT_BYTES`: free text that does not fit is cut, at a whole character."""
        text = self.kind.value.template.format(*self.words).rstrip()
        if len(text.encode()) <= TEXT_BYTES:
            return text
        return text.encode()[: TEXT_BYTES - 2].decode(errors="ignore").rstrip() + ".."

    @property
    def effect(self) -> SendText:
        """The text as it is sent."""
        return SendText(self.kind.value.severity, self.text)


class Telling:
    """The differences of the diagnosis, as they are told."""

    def __init__(self) -> None:
        self._told = Diagnosis()
        self._loud = False  # the present episode of the fault brought news: a declaration, another rotor, a graver kind

    def step(self, diagnosis: Diagnosis, arming: int) -> list[Notice]:
        """What is to be said of a diagnosis now. arming: number of the present one."""
        if diagnosis.stage not in (Stage.FAULT, Stage.INSPECT, Stage.SUSPECTED):
            self._told, self._loud = diagnosis, diagnosis.seen
            return []
        told, motors = self._told, motors_words(diagnosis)
        news = told.stage is not Stage.FAULT or (diagnosis.kind, motors) != (told.kind, motors_words(told))
        self._loud = diagnosis.seen and (news or (self._loud and told.seen))
        self._told = diagnosis
        if diagnosis.stage is Stage.SUSPECTED:
            return [_finding(Kind.SUSPECT, diagnosis)]
        if diagnosis.stage is Stage.INSPECT:
            return [Notice(Kind.INSPECT, (motors,), f"{motors} {arming}")]
        if self._loud:
            kind = Kind.FAULT if diagnosis.kind is None else _DECLARED.get(diagnosis.kind, Kind.FAULT)
            return [_finding(kind, diagnosis, f"{diagnosis.kind} {motors}")]
        if diagnosis.seen:
            return [_finding(Kind.AGAIN, diagnosis)]
        named = diagnosis.rotor is not None or diagnosis.kind is FaultKind.SENSOR
        return [Notice(Kind.UNSEEN, (motors if named else "the fault",), motors)]


def _finding(kind: Kind, diagnosis: Diagnosis, key: str = "") -> Notice:
    room = TEXT_BYTES - len(kind.value.template.format(""))
    return Notice(kind, (finding_words(diagnosis, room),), key)


@dataclass(slots=True)
class _Matter:
    key: str
    begun: Instant  # when it was said first
    at: Instant  # ... and last
    times: int  # how often it was due by then
    offered: Instant  # when it was offered last

    def due(self, notice: Notice, now: Instant) -> bool:
        policy = notice.kind.value
        if not policy.again_s:
            return True
        return now - self.at >= GAP_S if self.key != notice.key else policy.times(now - self.begun) > self.times


class Presenter:
    """Says what is offered, within its budget, and at once a critical kind that was not said for a minute.

    suppressed: texts held back so far.
    """

    def __init__(self, per_minute: int = 30) -> None:
        self.suppressed = 0
        self.per_minute = per_minute
        self._sent: list[tuple[Kind, Instant]] = []  # texts of the last minute
        self._said: dict[Kind, _Matter] = {}
        self._waiting: dict[Kind, tuple[Notice, Instant]] = {}  # what is not said yet (`wait_s`), and since when
        self._held: set[tuple[Kind, str]] = set()  # matters that were held back and counted already

    def present(self, notices: Sequence[Notice], now: Instant) -> list[Effect]:
        """Say what is to be said of the notices of this step, loudest first."""
        effects: list[Effect] = []
        for notice in sorted(self._ripe(notices, now), key=lambda notice: notice.kind.value.severity):
            before = self._said.get(notice.kind)
            if before is None or before.due(notice, now):
                effects += self._say(notice, before, now)
        # A lasting matter that was not offered for a while is over: the next one begins anew.
        offered = {notice.kind for notice in notices}
        for kind, matter in list(self._said.items()):
            if kind in offered:
                matter.offered = now
            elif now - matter.offered >= LULL_S:
                del self._said[kind]
        self._held = {matter for matter in self._held if matter[0] in offered}
        return effects

    def _ripe(self, notices: Sequence[Notice], now: Instant) -> list[Notice]:
        """The notices but those that wait; and what waited and is offered no more, unless something critical is."""
        offered = {notice.kind: notice for notice in notices}
        critical = not _LOUD.isdisjoint(offered)
        over = [notice for kind, (notice, _) in self._waiting.items() if kind not in offered and not critical]
        self._waiting = {
            kind: (notice, self._waiting.get(kind, (notice, now))[1])
            for kind, notice in offered.items()
            if kind.value.wait_s and kind not in self._said
        }
        waiting = [kind for kind, (_, since) in self._waiting.items() if now - since < kind.value.wait_s]
        return [notice for notice in notices if notice.kind not in waiting] + over

    def _say(self, notice: Notice, before: _Matter | None, now: Instant) -> list[Effect]:
        policy, matter = notice.kind.value, (notice.kind, notice.key)
        self._sent = [(kind, at) for kind, at in self._sent if now - at < MINUTE_S]
        like = [kind for kind, _ in self._sent if (kind in _LOUD) == (notice.kind in _LOUD)]
        spent = len(like) >= self.per_minute // 2 and (notice.kind in like or notice.kind not in _LOUD)
        if spent or (before is not None and now - before.at < GAP_S):
            if policy.again_s and matter in self._held:
                return []
            self._held |= {matter} if policy.again_s else set()
            self.suppressed += 1
            return [TextSuppressed(notice.text, self.suppressed)]
        begun = now if before is None else before.begun
        self._said[notice.kind] = _Matter(notice.key, begun, now, policy.times(now - begun), now)
        self._held = {matter for matter in self._held if matter[0] is not notice.kind}
        self._sent.append((notice.kind, now))
        return [notice.effect]


class NamedValues:
    """The figures of the thesis rule as NAMED_VALUE_FLOAT, a few times a second.

    PF_RES [rad/s] residual of largest magnitude and PF_FSD [s] longest fault signature duration since the last ones
    sent, as sampled once a step; PF_MARG [rad/s] and PF_FML [s] their limits.

    Of roll, or of another axis if roll is not judged. period_s: how often.
    """

    NAMES = ("PF_RES", "PF_MARG", "PF_FSD", "PF_FML")  # at most 10 bytes: NAMED_VALUE_FLOAT.name

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._sent: Instant | None = None
        self._residual = self._fsd_s = 0.0

    def step(self, output: ChainOutput, now: Instant) -> list[SendFloat]:
        """Take in the gauges of a step; return the floats that are to be sent."""
        if output.now_ns is None:
            return []
        piece = output.pieces[-1]
        thesis = [number for number, slot in enumerate(piece.slots) if slot.monitor.name == "fsd"]
        thesis.sort(key=lambda number: piece.slots[number].monitor.axis is not Axis.ROLL)
        found = next(((piece.slots[number], latest) for number in thesis if (latest := piece.latest(number))), None)
        if found is None:
            return []
        slot, latest = found
        self._residual = max(self._residual, latest[RESIDUAL], key=abs)
        self._fsd_s = max(self._fsd_s, latest[VALUE])
        if self._sent is not None and now - self._sent < self._period_s:
            return []
        figures = (self._residual, slot.monitor.reference, self._fsd_s, slot.threshold)
        self._sent, self._residual, self._fsd_s = now, 0.0, 0.0
        return [SendFloat(name, value, output.now_ns) for name, value in zip(self.NAMES, figures, strict=True)]
