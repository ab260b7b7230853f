"""What is to be done about a fault, as the user wrote it: a table of findings, delays and actions.

    gross loss: land; propeller fault after 10 s: rtl; suspected: text

A row is FINDING [after SECONDS s]: ACTION. A finding counts as the first of its names that the table has a row for, see
`names_of`. An action is `text`, one of `ACTIONS`, or a MAV_CMD by name or number with up to seven parameters.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from mavdiag.decision.diagnosis import Diagnosis, Stage
from mavdiag.errors import UsageError
from mavdiag.link.codec import command_numbers
from mavdiag.link.messages import MODES, MavCmd
from mavdiag.monitors.base import FaultKind

DECLARED, SUSPECTED = "fault", "suspected"  # a fault of any kind; a suspicion
FINDINGS = (*reversed([str(kind) for kind in FaultKind]), DECLARED, SUSPECTED)  # the gravest first
LONGEST_S = 600.0  # a longer delay is a mistake (our choice)
TEXT = "text"
ACTIONS: Mapping[str, int] = {
    "hold": MavCmd.NAV_LOITER_UNLIM,
    "rtl": MavCmd.NAV_RETURN_TO_LAUNCH,
    "land": MavCmd.NAV_LAND,
    "pause": MavCmd.DO_PAUSE_CONTINUE,  # with 0, which pauses; PX4 has hold for it
}
BROUGHT = frozenset(("loiter", "hold", "rtl", "return", "land"))  # modes that actions bring, ArduPilot's and PX4's
REFUSED = (MavCmd.COMPONENT_ARM_DISARM, MavCmd.DO_FLIGHTTERMINATION)  # they arm, or stop motors in flight
#: Modes in which the vehicle flies by itself or keeps its place: whoever flies by hand acts himself (our choice).
AUTOMATIC = "auto guided loiter poshold brake circle follow takeoff mission hold offboard position orbit"

_ROW = re.compile(r"(?P<finding>[^:]*?)(?:\s+after\s+(?P<delay>[\d.]+)\s*s?)?\s*:\s*(?P<action>.+)", re.DOTALL)
_EXAMPLE = "write rows as 'propeller fault after 10 s: rtl', parted by ';'"


@dataclass(frozen=True, slots=True)
class Rule:
    """One row. command: MAV_CMD, None for a text alone."""

    finding: str  # one of `FINDINGS`
    delay_s: float
    action: str  # as it is told
    command: int | None = None
    parameters: tuple[float, ...] = ()

    def __str__(self) -> str:
        return f"{self.finding} after {self.delay_s:g} s: {self.action}"


def names_of(held: Diagnosis) -> tuple[str, ...]:
    """What a diagnosis counts as, the most precise name first; none if nothing is suspected or declared in flight."""
    if held.stage is Stage.SUSPECTED:
        return (SUSPECTED,)
    if held.stage is not Stage.FAULT:
        return ()
    kind = held.kind or FaultKind.PROPELLER
    own = (kind,) if kind in (FaultKind.PROPELLER, FaultKind.SENSOR) else (kind, FaultKind.PROPELLER)
    return (*map(str, own), DECLARED, SUSPECTED)


def parse_rules(text: str) -> tuple[Rule, ...]:
    """The rows of a table, the gravest finding first, of one finding the longest delay. Raises UsageError.

    >>> [str(rule) for rule in parse_rules("suspected: text; gross loss: land; propeller fault after 10 s: rtl")]
    ['gross loss of thrust after 0 s: land', 'propeller fault after 10 s: rtl', 'suspected after 0 s: text']
    """
    rules = [_rule(row.strip()) for row in text.split(";") if row.strip()]
    ordered = sorted(rules, key=lambda rule: (FINDINGS.index(rule.finding), -rule.delay_s))
    for rule in ordered:
        if sum((rule.finding, rule.delay_s) == (other.finding, other.delay_s) for other in ordered) > 1:
            raise UsageError(f"two rows for {rule.finding!r} after {rule.delay_s:g} s; leave one out")
    return tuple(ordered)


def parse_modes(text: str) -> frozenset[str]:
    """Names or numbers of flight modes, parted by blanks or commas. Raises UsageError."""
    names = frozenset(text.lower().replace(",", " ").split())
    unknown = sorted(name for name in names if not name.isdecimal() and name not in MODES.values())
    if unknown or not names:
        known = ", ".join(sorted(set(MODES.values())))
        raise UsageError(f"no mode {' '.join(unknown) or 'is named'}; known are {known}, and numbers")
    return names


def _rule(row: str) -> Rule:
    found = _ROW.fullmatch(row)
    if found is None:
        raise UsageError(f"cannot read {row!r}: {_EXAMPLE}")
    said = " ".join(found["finding"].lower().split())
    finding = next((name for name in FINDINGS if name == said or (said and name.startswith(f"{said} "))), None)
    if finding is None:
        raise UsageError(f"no finding {said!r}; known are {', '.join(FINDINGS)}")
    try:
        delay_s = float(found["delay"] or 0.0)
    except ValueError as error:
        raise UsageError(f"no delay {found['delay']!r} in {row!r}; {_EXAMPLE}") from error
    if delay_s > LONGEST_S:
        raise UsageError(f"a delay of {delay_s:g} s in {row!r} is too long; {LONGEST_S:g} s at most")
    return Rule(finding, delay_s, *_action(found["action"].split(), row))


def _action(words: list[str], row: str) -> tuple[str, int | None, tuple[float, ...]]:
    name, *rest = words
    if name.lower() == TEXT and not rest:
        return TEXT, None, ()
    if name.lower() in ACTIONS and not rest:
        return name.lower(), ACTIONS[name.lower()], ()
    numbers = command_numbers()
    try:
        command = int(name) if name.isdecimal() else numbers.get(name.upper().removeprefix("MAV_CMD_"))
        parameters = tuple(map(float, rest))
    except ValueError:
        command = None
    if command not in numbers.values() or len(rest) > 7 or not all(map(math.isfinite, parameters)):
        known = ", ".join((TEXT, *ACTIONS))
        raise UsageError(f"no action {' '.join(words)!r} in {row!r}; known are {known}, a MAV_CMD")
    if command in REFUSED:
        never = "the detector neither arms nor stops motors"
        raise UsageError(f"{name!r} in {row!r}: {never}; choose another action")
    return name.upper().removeprefix("MAV_CMD_"), command, parameters
