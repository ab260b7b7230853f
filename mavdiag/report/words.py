"""The verdict as sentences for somebody who is new to it."""

from mavdiag.decision.alarm import Change, Stage
from mavdiag.judging import LogVerdict, MonitorSummary, Verdict
from mavdiag.monitors import by_name
from mavdiag.monitors.base import FaultKind

__all__ = ["OBSERVES", "advice", "evidence_sentence", "headline", "own_reason", "unjudged"]

#: What each monitor looks at, for a reader who meets its name for the first time.
OBSERVES = {
    "fsd": "how long the body rate differs from the model's (the thesis's rule)",
    "innovation": "motion that is predicted badly one step ahead",
    "rotor_signature": "unexplained motion along the arm of one rotor",
    "unbalance": "vibration that turns with a rotor",
    "vibration_level": "the autopilot's own vibration level",
    "rotor_trim": "one rotor commanded more than in health",
    "trim_step": "one rotor commanded more than a minute ago",
    "sensor_noise": "noise of one sensor axis alone",
    "sensor_drift": "gyro and attitude that do not agree",
    "control_loss": "a body rate that nobody commanded",
    "thrust_loss": "thrust that is missing while the vehicle turns",
}
MOSTLY = 0.9  # of what was judged: a monitor that judged more has judged the flight (our choice)
_TYPES = {"F1": "an edge cut", "F2": "a crack", "F3": "surface unbalance"}


def headline(verdict: LogVerdict) -> str:
    """The verdict in one sentence."""
    if verdict.verdict is Verdict.ERROR:
        return f"This file could not be read: {verdict.reason}."
    if verdict.verdict is Verdict.NOT_JUDGEABLE:
        return f"This flight cannot be judged by this baseline: {own_reason(verdict)}."
    if verdict.verdict is Verdict.HEALTHY:
        return f"No fault was found; {_judged(verdict)}."
    if verdict.verdict is Verdict.SUSPECTED:
        return f"A fault is suspected, none was declared; {_judged(verdict)}."
    kind = verdict.kind or FaultKind.PROPELLER
    last = _last_fault(verdict)
    rotor = verdict.rotor
    near = {FaultKind.PROPELLER: "of", FaultKind.GROSS_LOSS: "at"}.get(kind)
    where = f" {near} rotor {rotor}" if rotor is not None and near else ""
    graded = ""
    if kind is FaultKind.PROPELLER and last is not None and last.fault_type is not None:
        severity = "" if last.severity is None else f", severity {last.severity} of 3"
        graded = f", most like {_TYPES.get(last.fault_type, 'type')} ({last.fault_type}{severity})"
    since = verdict.since_s
    at = "" if since is None else f", declared first at {since:.1f} s of the vehicle's clock"
    return f"A {kind}{where} was found{graded}{at}; {_judged(verdict)}."


def _judged(verdict: LogVerdict) -> str:
    return f"{verdict.judged_s:.0f} s of {verdict.flown_s:.0f} s of flight were judged"


def evidence_sentence(verdict: LogVerdict) -> str:
    """What the verdict rests on, one sentence; empty where nothing was judged."""
    if verdict.verdict is Verdict.SUSPECTED:
        return f"What was suspected: {own_reason(verdict)}."
    if verdict.verdict is Verdict.HEALTHY:
        nearest = max(_decided(verdict), key=_ratio, default=None)
        if nearest is None:
            return ""
        share = 100 * _ratio(nearest)
        return f"The deciding monitor that came nearest to its threshold is {nearest.name}, with {share:.0f} % of it."
    if verdict.verdict is Verdict.FAULT:
        above = sorted((one for one in verdict.monitors if _ratio(one) > 1), key=_ratio, reverse=True)
        told = ", ".join(f"{one.name} {_ratio(one):.1f} times" for one in above)
        count = len(verdict.events)
        alarms = f"{count} alarm{'s' if count != 1 else ''} of single monitors"
        doubts = {by_name(one.event.monitor).doubt for one in verdict.events if by_name(one.event.monitor).decides}
        doubt = next((f" This alone does not tell the cause ({text})." for text in doubts if text), "")
        return f"Above their thresholds: {told or 'none at the end'} ({alarms}).{doubt if len(doubts) == 1 else ''}"
    return ""


def unjudged(verdict: LogVerdict) -> tuple[str, ...]:
    """The monitors that did not judge a good part of the flight, and why: one phrase each."""
    enough = MOSTLY * verdict.judged_s
    lacking = [one for one in verdict.monitors if one.not_judged and one.judged_s <= enough]
    return tuple(f"{one.name}: {one.not_judged}" for one in lacking)


def advice(verdict: LogVerdict) -> str:
    """What to do now, one sentence."""
    rotor = verdict.rotor
    if verdict.verdict is Verdict.FAULT:
        if verdict.kind in (None, FaultKind.PROPELLER):
            first = "the propellers" if rotor is None else f"the propeller of rotor {rotor} first, then the others"
            return (
                f"Before the next flight, look at {first}: nicks, cracks, a bent blade, a loose or changed propeller."
            )
        if verdict.kind is FaultKind.SENSOR:
            return "Before the next flight, check the inertial sensor and its mount; no propeller is blamed."
        return "Do not fly before the cause is known: look at motors, controllers, propellers and their wiring."
    if verdict.verdict is Verdict.SUSPECTED:
        return "Look at the propellers and judge the next flight, too: it may be a manoeuvre that was not learnt."
    if verdict.verdict is Verdict.HEALTHY:
        return "Damage that is smaller than the thresholds can find is not excluded; this is no proof of health."
    if verdict.verdict is Verdict.NOT_JUDGEABLE:
        missing = "`mavdiag inspect LOG --baseline FILE` says which message or parameter is missing"
        return f"{missing}, and `mavdiag look LOG` what the log shows by itself."
    return "Check the file; the other logs of this page are not affected."


def own_reason(verdict: LogVerdict) -> str:
    """The reason without the notes, which stand by themselves."""
    return verdict.reason.removesuffix("; ".join(("", *verdict.notes)))


def _last_fault(verdict: LogVerdict) -> Change | None:
    """The last word on the fault that has a type."""
    faults = [one for one in verdict.changes if one.stage is Stage.FAULT and one.kind is verdict.kind]
    return next((one for one in reversed(faults) if one.fault_type is not None), None)


def _decided(verdict: LogVerdict) -> list[MonitorSummary]:
    return [one for one in verdict.monitors if one.decides and one.maximum is not None]


def _ratio(one: MonitorSummary) -> float:
    return 0.0 if one.maximum is None or not one.threshold else one.maximum / one.threshold
