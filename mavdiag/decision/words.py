"""A diagnosis and a verdict in words: for a pilot's text, a line of a terminal and a page.

The phrase of a fault is that of the monitor whose evidence leads (`Monitor.phrase`). "2.6x" is times its threshold.
Thrust that is lost is the share of its thrust that a rotor lost which is commanded more to lift the same, if it is one
of four (`airframe.trim.loss_of`); of six it is up to a tenth more, of eight a sixth.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mavdiag.airframe.trim import loss_of
from mavdiag.decision.diagnosis import Change, Diagnosis, Event, Stage, above, graded
from mavdiag.monitors import BY_NAME, MONITORS, by_name
from mavdiag.monitors.base import FaultKind
from mavdiag.printable import counted
from mavdiag.units import NS_PER_S

if TYPE_CHECKING:  # a verdict is made above this module
    from mavdiag.judging import LogVerdict

MOTORS_MOST = 8  # that are listed by number; more do not fit into a text (our choice)
MOSTLY = 0.5  # of what was judged: a monitor that judged more has judged the flight (our choice)
TYPES = {"F1": "an edge cut", "F2": "a crack", "F3": "surface unbalance"}

#: What each monitor looks at.
OBSERVES = {monitor.name: monitor.observes for monitor in MONITORS}

#: The verdicts in short, in the order in which they ask for attention.
VERDICTS = {
    name: name.replace("_", " ").replace("error", "not readable")
    for name in ("error", "fault", "suspected", "not_judgeable", "healthy")
}


def finding_words(finding: Diagnosis, most: int = 80) -> str:
    """What was found, in at most so many characters: "motor 3 lost 19% thrust", "rotor unknown: vibrates 2.6x".

    What does not fit is left out: the type of the fault first, then that the rotor is unknown.
    """
    typed = finding.fault_type or "" if finding.stage is Stage.FAULT else ""
    typed += f"/SV{finding.severity}" if typed and finding.severity is not None else ""
    monitor = BY_NAME.get(finding.monitor or "")
    template, phrase, whose = "" if monitor is None else monitor.phrase, "", ""
    if math.isfinite(finding.statistic) and finding.threshold > 0:
        rise = max(finding.statistic, 0.0)
        times = rise / finding.threshold
        shown = ">99" if times > 99 else f"{times:.0f}" if times >= 9.95 else f"{times:.1f}"
        phrase = template.format(times=shown, lost=f"{100.0 * loss_of(rise):.0f}")
    if finding.rotor is not None:
        whose = f"motor {finding.rotor} "
    elif finding.axis is not None:
        whose = f"{finding.axis} "
    elif finding.kind in (None, FaultKind.PROPELLER) and phrase != template:  # it tells of what a rotor does
        whose = "rotor unknown: "
    told = (whose + ", ".join(part for part in (phrase, typed) if part), whose + phrase, phrase or whose)
    return next((text.strip() for text in told if len(text.strip()) <= most), told[-1].strip()[:most])


def motors_words(finding: Diagnosis) -> str:
    """The rotors that were named: "motor 1", "motors 1,4"; what else is to be looked at where none was."""
    told = (finding.rotor, *(span.rotor for span in finding.rotors))
    rotors = sorted({rotor for rotor in told if rotor is not None})
    if len(rotors) > MOTORS_MOST:
        return f"{len(rotors)} motors"
    if rotors:
        return f"motor{'s' if len(rotors) > 1 else ''} {','.join(map(str, rotors))}"
    if finding.kind is FaultKind.SENSOR:
        return "IMU"
    return "rotor unknown" if finding.kind in (None, FaultKind.PROPELLER) else "all motors"


def inspect_words(rotor: int | None) -> str:
    """What to do after a suspicion that names a rotor; empty if it names none."""
    return "" if rotor is None else f"inspect motor {rotor} before the next flight"


def fault_reason(kind: FaultKind | None, changes: Sequence[Change], events: Sequence[Event]) -> str:
    """Why a fault was declared: the highest evidence, every rotor that was named, and the type that was named last.

    kind: the gravest of the faults, which the reason is about. changes, events: all of the flight.
    """
    declared = [change for change in changes if change.stage is Stage.FAULT]
    spans, faults = declared[-1].rotors, [change for change in declared if change.kind is kind]
    worst = max(faults, key=lambda change: change.statistic / change.threshold if change.threshold else 0.0)
    same = (event.statistic for event in events if (event.monitor, event.axis) == (worst.monitor, worst.axis))
    rotor = f"; rotor {spans[0].rotor}" if len(spans) == 1 else ""
    if len(spans) > 1:
        named = (f"rotor {span.rotor} from {span.since_ns / NS_PER_S:.1f} s" for span in spans[:MOTORS_MOST])
        rotor = f"; {', '.join(named)}" + (f" and {len(spans) - MOTORS_MOST} more" * (len(spans) > MOTORS_MOST))
    typed = graded(changes)
    axis = f" on {worst.axis}" if worst.axis is not None else ""
    evidence = f"{worst.monitor}{axis} {above(max(same, default=worst.statistic), worst.threshold)}"
    doubt = f"; {text}" if (text := _doubt(events)) else ""
    what = "" if kind in (None, FaultKind.PROPELLER) else f"{kind}: "
    likeness = "" if typed is None else f"; {typed.fault_type}"
    return f"{what}{evidence}{rotor}{likeness}{doubt}, {counted(len(events), 'alarm')}"


def headline(verdict: "LogVerdict") -> str:
    """The verdict in one sentence."""
    if verdict.verdict != "fault":
        return {
            "error": f"This file could not be read: {verdict.reason}.",
            "not_judgeable": f"This flight cannot be judged by this baseline: {own_reason(verdict)}.",
            "healthy": "No fault was found.",
            "suspected": "A fault is suspected, none was declared.",
        }[verdict.verdict]
    kind, typed, more = verdict.kind or FaultKind.PROPELLER, graded(verdict.changes), ""
    where = _place(kind, None if verdict.rotor is None else _rotors(verdict))
    if kind is FaultKind.PROPELLER and typed is not None:
        more = _likeness(typed)
    if kind is FaultKind.SENSOR and verdict.rotor is not None:  # a rotor is named of no sensor fault
        more = f", and a {FaultKind.PROPELLER} of {_rotors(verdict)}"
    return f"A {kind}{where} was found{more}."


def rotors_of(verdict: "LogVerdict") -> tuple[int, ...]:
    """Every rotor that was named, in order of number."""
    named = {span.rotor for span in verdict.rotors} | ({verdict.rotor} - {None})
    return tuple(sorted(one for one in named if one is not None))


def _rotors(verdict: "LogVerdict") -> str:
    *others, last = map(str, rotors_of(verdict))
    return f"rotors {', '.join(others)} and {last}" if others else f"rotor {last}"


def held_sentence(held: Diagnosis) -> str:
    """What is held of a vehicle in flight, in a sentence or two: kind, motor, likeliest type, evidence; else empty."""
    motors = motors_words(held)
    if held.stage is Stage.INSPECT:
        return f"A fault was found in an earlier flight ({motors}), and nobody has said yet that it was looked at."
    if held.stage not in (Stage.FAULT, Stage.SUSPECTED):
        return ""
    kind, evidence = held.kind or FaultKind.PROPELLER, ""
    motor = None if held.rotor is None else f"motor {held.rotor}"
    if held.monitor is not None and held.threshold > 0 and math.isfinite(held.statistic):
        seen = OBSERVES.get(held.monitor, held.monitor)
        times = held.statistic / held.threshold
        evidence = f": {seen}, {f'{times:.0f}' if times >= 9.95 else f'{times:.1f}'} times its threshold"
    unknown = ", rotor unknown" if held.rotor is None and kind is FaultKind.PROPELLER else ""
    if held.stage is Stage.SUSPECTED:
        return f"A {kind}{_place(kind, motor)} is suspected, not declared{unknown}{evidence}."
    typed = _likeness(held) if kind is FaultKind.PROPELLER and held.fault_type is not None else ""
    calm = "" if held.seen else " It is not seen at this moment, which does not mean that it is gone."
    return f"A {kind}{_place(kind, motor)} was found{unknown}{typed}{evidence}.{calm}"


def held_advice(held: Diagnosis) -> str:
    """What to do about what is held of a vehicle in flight, one sentence; empty where there is nothing to do."""
    if held.stage is Stage.SUSPECTED:
        where = "the propellers" if held.rotor is None else f"motor {held.rotor}"
        return f"Look at {where} before the next flight; it may also be a manoeuvre that was not learnt."
    if held.stage not in (Stage.FAULT, Stage.INSPECT):
        return ""
    first = "the propellers" if held.rotor is None else f"the propeller of motor {held.rotor} first, then the others"
    todo = {
        FaultKind.PROPELLER: f"look at {first}: nicks, cracks, a bent blade, a loose propeller",
        FaultKind.SENSOR: "check the inertial sensor and its mount; no propeller is blamed",
    }.get(held.kind or FaultKind.PROPELLER, "look at motors, controllers, propellers and their wiring")
    return f"{'Land, then' if held.stage is Stage.FAULT else 'Before the next flight,'} {todo}."


def _place(kind: FaultKind, whose: str | None) -> str:
    near = {FaultKind.PROPELLER: "of", FaultKind.GROSS_LOSS: "at"}.get(kind)
    return f" {near} {whose}" if whose is not None and near else ""


def _likeness(held: Diagnosis) -> str:
    severity = "" if held.severity is None else f", severity {held.severity} of 3"
    return f", most like {TYPES.get(held.fault_type or '', 'type')} ({held.fault_type}{severity})"


def certainty(verdict: "LogVerdict") -> str:
    """How sure the verdict is, and what it rests on: one or two sentences; empty where nothing was judged."""
    told = sorted((one for one in verdict.monitors if one.maximum is not None), key=lambda one: one.ratio, reverse=True)
    if verdict.verdict == "suspected":
        return f"{own_reason(verdict)}."
    nearest = next((one for one in told if one.decides), None)
    if verdict.verdict == "healthy" and nearest is not None:
        share = f"{100 * nearest.ratio:.0f} % of its threshold"
        return f"The deciding monitor that came nearest, {nearest.name.replace('_', ' ')}, came to {share}."
    if verdict.verdict != "fault":
        return ""
    above = [f"{one.name.replace('_', ' ')} {one.ratio:.1f} times" for one in told if one.ratio > 1]
    named = [one for one in verdict.changes if one.confidence]
    text = f"Above their thresholds: {', '.join(above) or 'none at the end'} ({counted(len(verdict.events), 'alarm')})."
    if verdict.rotor is not None and named:
        text += f" The rotor is named with {100 * (named[-1].confidence or 0.0):.0f} % confidence."
    return text + (f" This alone does not tell the cause ({doubt})." if (doubt := _doubt(verdict.events)) else "")


def advice(verdict: "LogVerdict") -> str:
    """What to do now, one sentence."""
    inspect, first = "Look at the propellers", "the propellers"
    if verdict.rotor is not None:
        inspect, several = f"Inspect motor {verdict.rotor} before the next flight", "s" * (len(rotors_of(verdict)) > 1)
        first = f"the propeller{several} of {_rotors(verdict)} first, then the others"
    what = verdict.verdict.value
    if what == "fault" and verdict.kind not in (None, FaultKind.PROPELLER):
        what = ("sensor" if verdict.rotor is None else what) if verdict.kind is FaultKind.SENSOR else "loss"
    return {
        "fault": f"Before the next flight, look at {first}: nicks, cracks, a bent blade, a loose or changed propeller.",
        "sensor": "Before the next flight, check the inertial sensor and its mount; no propeller is blamed.",
        "loss": "Do not fly before the cause is known: look at motors, controllers, propellers and their wiring.",
        "suspected": f"{inspect}, and judge the next flight too: it may be a manoeuvre that was not learnt.",
        "healthy": "Nothing now. Damage that is smaller than the thresholds can find is not excluded.",
        "not_judgeable": "`mavdiag inspect LOG --baseline FILE` says which message or parameter is missing, and what "
        "the log shows by itself.",
        "error": "Check the file; the other logs of this page are not affected.",
    }[what]


def unjudged(verdict: "LogVerdict") -> tuple[str, ...]:
    """The monitors that judged less than half of what was judged, and why: one phrase each."""
    enough = MOSTLY * verdict.judged_s
    few = (one for one in verdict.monitors if one.not_judged and one.judged_s <= enough)
    return tuple(f"{one.name} judged {one.judged_s:.0f} s: {one.not_judged}" for one in few)


def own_reason(verdict: "LogVerdict") -> str:
    """The reason without the notes, which stand by themselves."""
    return verdict.reason.removesuffix("; ".join(("", *verdict.notes)))


def _doubt(events: Sequence[Event]) -> str:
    """What leaves the cause open, where the alarms of all deciding monitors share it; else empty."""
    doubts = {monitor.doubt for event in events if (monitor := by_name(event.monitor)).decides}
    return next(iter(doubts)) if len(doubts) == 1 else ""
