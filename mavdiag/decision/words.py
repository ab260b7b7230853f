"""A diagnosis in a pilot's words: which rotor, and what it does. The figures behind them are in the journal.

The phrase is that of the monitor whose evidence leads (`Monitor.phrase`). "2.6x" is times its threshold. Thrust that is
lost is the share of its thrust that a rotor lost which is commanded more to lift the same (`airframe.trim.loss_of`).
"""

import math

from mavdiag.airframe.trim import loss_of
from mavdiag.decision.diagnosis import Change, Diagnosis, Stage
from mavdiag.monitors import BY_NAME
from mavdiag.monitors.base import FaultKind

MOTORS_MOST = 8  # that are listed by number; more do not fit into a text (our choice)


def finding_words(finding: Change | Diagnosis, most: int = 80) -> str:
    """What was found, in at most so many characters: "motor 3 lost 19% thrust", "rotor unknown: vibrates 2.6x".

    What does not fit is left out: the type of the fault first, then that the rotor is unknown.

    >>> print(finding_words(Diagnosis(Stage.FAULT, monitor="rotor_trim", statistic=0.235, threshold=0.1, rotor=3)))
    motor 3 lost 19% thrust
    """
    graded = finding.fault_type or "" if finding.stage is Stage.FAULT else ""
    graded += f"/SV{finding.severity}" if graded and finding.severity is not None else ""
    phrase, whose = _phrase(finding), ""
    if finding.rotor is not None:
        whose = f"motor {finding.rotor} "
    elif finding.axis is not None:
        whose = f"{finding.axis} "
    elif finding.kind in (None, FaultKind.PROPELLER) and phrase != _template(finding):  # it tells of what a rotor does
        whose = "rotor unknown: "
    told = (whose + ", ".join(part for part in (phrase, graded) if part), whose + phrase, phrase or whose)
    return next((one.strip() for one in told if len(one.strip()) <= most), told[-1].strip()[:most])


def motors_words(finding: Change | Diagnosis) -> str:
    """The rotors that were named: "motor 1", "motors 1,4"; what else is to be looked at where none was."""
    rotors = sorted({span.rotor for span in finding.rotors})
    if len(rotors) > MOTORS_MOST:
        return f"{len(rotors)} motors"
    if rotors:
        return f"motor{'s' if len(rotors) > 1 else ''} {','.join(map(str, rotors))}"
    if finding.kind is FaultKind.SENSOR:
        return "IMU"
    return "rotor unknown" if finding.kind in (None, FaultKind.PROPELLER) else "all motors"


def _template(finding: Change | Diagnosis) -> str:
    """The phrase of the leading monitor."""
    monitor = BY_NAME.get(finding.monitor or "")
    return "" if monitor is None else monitor.phrase


def _phrase(finding: Change | Diagnosis) -> str:
    """The same with its figure; empty where it is not known."""
    if not (math.isfinite(finding.statistic) and finding.threshold > 0):
        return ""
    rise = max(finding.statistic, 0.0)
    times = rise / finding.threshold
    shown = ">99" if times > 99 else f"{times:.0f}" if times >= 9.95 else f"{times:.1f}"
    return _template(finding).format(times=shown, lost=f"{100.0 * loss_of(rise):.0f}")
