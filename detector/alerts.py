"""What is said to the operator, how loudly and how often: a table, and a presenter that keeps to it.

A text is one STATUSTEXT of at most 50 bytes. A declared fault is CRITICAL; a suspicion, a fault that is seen again, an
open inspection or a detector that cannot work is a WARNING, everything else INFO. A *lasting* matter is offered at
every step: it is said when it begins, when what it is about changes, and at the times after its beginning that the
table gives. It is over once it was not offered for 5 s. Anything else is offered once and said once. Nothing of a kind
is said twice within 2 s (MAVProxy drops identical texts within that time), and all texts of a vehicle keep to a budget
a minute, half of it for declared faults and half for the rest. What the budget holds back is counted and recorded.

What is said of a fault follows the diagnosis (`told_of`). Nothing is ever called clear: a fault that is not seen any
longer lasts, and after the flight it is an inspection.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

from detector.values import Effect, SendText, TextSuppressed
from mavdiag.decision.diagnosis import Diagnosis, Stage
from mavdiag.decision.words import finding_words, motors_words
from mavdiag.link.messages import Severity
from mavdiag.monitors import BY_NAME
from mavdiag.monitors.base import FaultKind
from mavdiag.telemetry import Instant

__all__ = [
    "GAP_S",
    "POLICY",
    "TEXT_BYTES",
    "Kind",
    "Notice",
    "Policy",
    "Presenter",
    "Told",
    "figure",
    "label_of",
    "present",
    "told_of",
]

TEXT_BYTES = 50  # STATUSTEXT.text; Mission Planner and MAVROS do not put longer ones together
GAP_S = 2.0  # MAVProxy suppresses identical text within 2 s
MINUTE_S = 60.0
LULL_S = 5.0  # a lasting matter that is offered again within so long goes on where it was (our choice)


class Kind(StrEnum):
    """What a text is about."""

    FAULT = "fault"
    SENSOR = "sensor fault"
    CONTROL = "loss of control"
    THRUST = "loss of thrust"
    SUSPECT = "suspect"
    AGAIN = "seen again"
    UNSEEN = "no longer seen"
    INSPECT = "inspect"
    ACKNOWLEDGED = "acknowledged"
    WAITING = "waiting"
    LEARNING = "learning"
    FITTING = "fitting"
    LEARNED = "learned"
    NOT_LEARNED = "not learned"
    MONITORING = "monitoring"
    HIDDEN = "flies, not judged"
    LINK_LOST = "link lost"
    LINK_BACK = "link back"
    REBOOT = "reboot"
    OFF = "off"
    RATES = "rates"
    NO_LAYOUT = "no rotor layout"
    OTHER_LAYOUT = "other rotor layout"
    OTHER_VEHICLE = "other vehicle"


@dataclass(frozen=True, slots=True)
class Policy:
    """How a kind is said.

    severity: of the STATUSTEXT.
    template: takes the notice's words.
    again_s: times after its beginning at which a lasting matter is said again; from the last on it is said again and
        again, as far apart as the last two (or as the only one from the beginning). Empty for what is said once.
    """

    severity: Severity
    template: str
    again_s: tuple[float, ...] = ()

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

# Times are our choices; the severities follow what ground stations do with them (they pop up 0 to 3).
POLICY: Mapping[Kind, Policy] = {
    Kind.FAULT: Policy(Severity.CRITICAL, "PROP FAULT {}", _ALERT_S),  # what was found
    Kind.SENSOR: Policy(Severity.CRITICAL, "PROP SENSOR FAULT {}", _ALERT_S),  # what was found
    Kind.CONTROL: Policy(Severity.CRITICAL, "PROP CONTROL LOST {}", _ALERT_S),  # the rotor that was named before
    Kind.THRUST: Policy(Severity.CRITICAL, "PROP THRUST LOST {}", _ALERT_S),  # the rotor, if it is known
    Kind.SUSPECT: Policy(Severity.WARNING, "PROP suspect {}", _ALERT_S),  # what was found
    Kind.AGAIN: Policy(Severity.WARNING, "PROP seen again: {}", _ALERT_S),  # what was found
    Kind.UNSEEN: Policy(Severity.INFO, "PROP no longer seen: {}", (300.0,)),  # which motors
    Kind.INSPECT: Policy(Severity.WARNING, "PROP {}: inspect before flight", (300.0,)),  # which motors
    Kind.ACKNOWLEDGED: Policy(Severity.INFO, "PROP {}: inspection acknowledged"),  # which motors
    Kind.WAITING: Policy(Severity.INFO, "PROP waiting: {}", (60.0,)),  # reason
    Kind.LEARNING: Policy(Severity.INFO, "PROP learning {}%{}", (60.0,)),  # progress, ": reason"
    Kind.FITTING: Policy(Severity.INFO, "PROP fitting the baseline"),
    Kind.LEARNED: Policy(Severity.INFO, "PROP baseline learned: {} monitors{}"),  # how many, ", N cannot"
    Kind.NOT_LEARNED: Policy(Severity.WARNING, "PROP not learned, goes on: {}"),  # reason
    Kind.MONITORING: Policy(Severity.INFO, "PROP monitoring{}", (300.0,)),  # ": reason" or "; what is not judged"
    Kind.HIDDEN: Policy(Severity.WARNING, "PROP not judged: {}", (60.0,)),  # why, although it flies
    Kind.LINK_LOST: Policy(Severity.INFO, "PROP link lost"),
    Kind.LINK_BACK: Policy(Severity.INFO, "PROP link back after {}s"),  # how long
    Kind.REBOOT: Policy(Severity.INFO, "PROP vehicle rebooted, starting anew"),
    Kind.OFF: Policy(Severity.WARNING, "PROP OFF: {}", (60.0,)),  # reason
    Kind.RATES: Policy(Severity.INFO, "PROP got {}"),  # message and rate, ...
    Kind.NO_LAYOUT: Policy(Severity.WARNING, "PROP rotor layout unknown: {} monitors off"),  # how many
    Kind.OTHER_VEHICLE: Policy(Severity.WARNING, "PROP not the vehicle of the baseline"),
    Kind.OTHER_LAYOUT: Policy(Severity.WARNING, "PROP flights contradict rotor layout {}"),  # its name
}


@dataclass(frozen=True, slots=True)
class Notice:
    """Something to say.

    kind: what it is about.
    words: fill the template.
    key: what a lasting matter is about (another key is news).
    """

    kind: Kind
    words: tuple[str, ...] = ()
    key: str = ""

    @property
    def text(self) -> str:
        """The text, within `TEXT_BYTES`: free text that does not fit is cut, at a whole character."""
        text = POLICY[self.kind].template.format(*self.words).rstrip()
        if len(text.encode()) <= TEXT_BYTES:
            return text
        return text.encode()[: TEXT_BYTES - 2].decode(errors="ignore").rstrip() + ".."


_DECLARED: Mapping[FaultKind | None, Kind] = {
    FaultKind.SENSOR: Kind.SENSOR,
    FaultKind.LOSS_OF_CONTROL: Kind.CONTROL,
    FaultKind.GROSS_LOSS: Kind.THRUST,
}


def label_of(monitor: str) -> str:
    """How a text calls a monitor: by its label, of at most 10 characters."""
    return BY_NAME[monitor].label if monitor in BY_NAME else monitor[:10]


@dataclass(frozen=True, slots=True)
class Told:
    """What was told of a fault.

    stage, kind, motors, seen: of the diagnosis that was told last.
    loud: the present episode of the fault brought news: a declaration, another rotor, a graver kind.
    """

    stage: Stage = Stage.NOT_JUDGED
    kind: FaultKind | None = None
    motors: str = ""
    seen: bool = False
    loud: bool = False


def told_of(told: Told, diagnosis: Diagnosis, arming: int) -> tuple[Told, tuple[Notice, ...]]:
    """What is to be said of a diagnosis now, and what is told then. arming: number of the present one."""
    it, motors = diagnosis, motors_words(diagnosis)
    news = told.stage is not Stage.FAULT or (it.kind, motors) != (told.kind, told.motors)
    loud = it.seen and (news or (told.loud and told.seen))
    after = Told(it.stage, it.kind, motors, it.seen, loud)
    match it.stage:
        case Stage.FAULT if loud:
            kind = _DECLARED.get(it.kind, Kind.FAULT)
            return after, (_notice(kind, it, f"{it.kind} {motors}"),)
        case Stage.FAULT if it.seen:
            return after, (_notice(Kind.AGAIN, it),)
        case Stage.FAULT:
            whose = motors if it.rotor is not None or it.kind is FaultKind.SENSOR else "the fault"
            return after, (Notice(Kind.UNSEEN, (whose,), motors),)
        case Stage.INSPECT:
            return after, (Notice(Kind.INSPECT, (motors,), f"{motors} {arming}"),)
        case Stage.SUSPECTED:
            return after, (_notice(Kind.SUSPECT, it),)
        case _:
            return after, ()


def _notice(kind: Kind, diagnosis: Diagnosis, key: str = "") -> Notice:
    room = TEXT_BYTES - len(POLICY[kind].template.format(""))
    return Notice(kind, (finding_words(diagnosis, room),), key)


def figure(value: float, decimals: int = 2) -> str:
    """A number in at most six characters.

    >>> [figure(x) for x in (0.118, 12.345, 4321.0, 5e6, float("nan"))]
    ['0.12', '12.3', '4321', '>9999', '?']
    """
    if value != value:
        return "?"
    size = abs(value)
    if size >= 9999.5:
        return ">9999" if value > 0 else "<-9999"
    places = decimals if size < 9.995 else min(decimals, 1) if size < 99.95 else 0
    return f"{value:.{places}f}"


@dataclass(frozen=True, slots=True)
class _Said:
    """A matter.

    begun: when it was said first; at: when it was said last; times: how often it was due by then.
    offered: when it was offered last.
    """

    kind: Kind
    key: str
    begun: Instant
    at: Instant
    times: int
    offered: Instant


@dataclass(frozen=True, slots=True)
class Presenter:
    """What was said lately.

    per_minute: the budget.
    sent: texts of the last minute: whether loud, and when.
    said: matters that last.
    held: matters that were held back and counted already.
    suppressed: texts held back so far.
    """

    per_minute: int = 30
    sent: tuple[tuple[bool, Instant], ...] = ()
    said: tuple[_Said, ...] = ()
    held: frozenset[tuple[Kind, str]] = frozenset()
    suppressed: int = 0


def present(presenter: Presenter, notices: tuple[Notice, ...], now: Instant) -> tuple[Presenter, tuple[Effect, ...]]:
    """Say what is to be said of the notices of this step, loudest first."""
    out: list[Effect] = []
    presenter = replace(presenter, sent=tuple(one for one in presenter.sent if now - one[1] < MINUTE_S))
    for notice in sorted(notices, key=lambda notice: POLICY[notice.kind].severity):
        if _to_say(presenter, notice, now):
            presenter, effect = _say(presenter, notice, now)
            out += () if effect is None else (effect,)
    # A lasting matter that was not offered for a while is over: the next one begins anew.
    offered = {notice.kind for notice in notices}
    said = tuple(replace(one, offered=now) if one.kind in offered else one for one in presenter.said)
    said = tuple(one for one in said if now - one.offered < LULL_S)
    held = frozenset(one for one in presenter.held if one[0] in offered)
    return replace(presenter, said=said, held=held), tuple(out)


def _to_say(presenter: Presenter, notice: Notice, now: Instant) -> bool:
    """Whether a lasting matter has something to say; what is offered once always has."""
    policy, last = POLICY[notice.kind], _last(presenter, notice.kind)
    if not policy.again_s or last is None:
        return True
    if last.key != notice.key:
        return now - last.at >= GAP_S
    return policy.times(now - last.begun) > last.times


def _say(presenter: Presenter, notice: Notice, now: Instant) -> tuple[Presenter, Effect | None]:
    policy, last = POLICY[notice.kind], _last(presenter, notice.kind)
    loud = policy.severity <= Severity.CRITICAL
    spent = sum(one == loud for one, _ in presenter.sent) >= presenter.per_minute // 2
    if spent or (last is not None and now - last.at < GAP_S):
        matter = (notice.kind, notice.key)
        if policy.again_s and matter in presenter.held:
            return presenter, None
        held = presenter.held | {matter} if policy.again_s else presenter.held
        count = presenter.suppressed + 1
        return replace(presenter, suppressed=count, held=held), TextSuppressed(notice.text, count)
    begun = now if last is None else last.begun
    fresh = _Said(notice.kind, notice.key, begun, now, policy.times(now - begun), now)
    said = (*(one for one in presenter.said if one.kind is not notice.kind), fresh)
    held = frozenset(one for one in presenter.held if one[0] is not notice.kind)
    return replace(presenter, said=said, held=held, sent=(*presenter.sent, (loud, now))), SendText(
        policy.severity, notice.text
    )


def _last(presenter: Presenter, kind: Kind) -> _Said | None:
    return next((one for one in presenter.said if one.kind is kind), None)
