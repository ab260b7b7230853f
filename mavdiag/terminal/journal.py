"""The journal of a detector, followed while it is written (edge): what happened to which vehicle.

It holds events and texts, no rates: a display of it has no strips.
"""

import json
import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavdiag.link.messages import Severity
from mavdiag.storage import open_regular
from mavdiag.terminal.view import Line

__all__ = ["Journal", "VehicleStory"]

JOURNAL_BYTES = 1 << 40  # there is no limit: it is read in pieces
READ_BYTES = 1 << 20  # at a time


@dataclass(slots=True)
class VehicleStory:
    """What a journal says of one vehicle.

    state, stage, reason: the latest of the session and of the decision.
    fault: whether the stage is a fault.
    """

    state: str = ""
    stage: str = ""
    reason: str = ""
    fault: bool = False


class Journal:
    """A journal's vehicles, as far as it was read; over rotations, too.

    vehicles: by system id. damaged: lines that could not be read.
    Raises InputError if there is no such file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._begun, self._stack = path, b"", ExitStack()
        self._file = self._stack.enter_context(open_regular(path, JOURNAL_BYTES))
        self.vehicles: dict[int, VehicleStory] = {}
        self.damaged = 0

    def read(self) -> list[tuple[int, Line]]:
        """What was written since the last call, by vehicle, in its order."""
        found = self._rest()
        if self._rotated():
            found += self._rest()  # what came between the two looks
            self.close()
            self._file, self._begun = self._stack.enter_context(open_regular(self._path, JOURNAL_BYTES)), b""
            found += self._rest()
        return found

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _rotated(self) -> bool:
        """Whether another file has the journal's name now; between the two there is none."""
        try:
            return not os.path.samestat(self._path.stat(), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            return False

    def _rest(self) -> list[tuple[int, Line]]:
        found: list[tuple[int, Line]] = []
        while data := self._file.read(READ_BYTES):
            *lines, self._begun = (self._begun + data).split(b"\n")
            found += [one for line in lines for one in self._taken(line)]
        return found

    def _taken(self, line: bytes) -> list[tuple[int, Line]]:
        try:
            content = json.loads(line)
            if content.get("vehicle") is None:
                return []
            number = int(content["vehicle"])
            told = _told(self.vehicles.setdefault(number, VehicleStory()), content)
            return [] if told is None else [(number, told)]
        except (ValueError, TypeError, AttributeError, KeyError):
            self.damaged += bool(line.strip())
            return []


def _told(story: VehicleStory, content: dict[str, Any]) -> Line | None:
    """One line about a vehicle; None if it is of no interest here."""
    t_s = float(content.get("vehicle_s") or 0.0)
    match content["kind"]:
        case "state":
            story.state = str(content["to"])
            return Line(t_s, Severity.INFO, f"{content['from']} -> {content['to']}: {content['reason']}")
        case "stage":
            story.stage, story.reason = str(content["stage"]), str(content["reason"])
            story.fault = story.stage == "fault"
            return Line(t_s, Severity.CRITICAL if story.fault else Severity.NOTICE, _stage(content))
        case "text":
            return Line(t_s, Severity(int(content["severity"])), str(content["text"]))
        case "note":
            return Line(t_s, Severity.INFO, str(content["text"]))
        case _:
            return None


def _stage(content: dict[str, Any]) -> str:
    rotor = f", rotor {content['rotor']}" if content.get("rotor") is not None else ""
    what = content.get("fault_kind") or content["stage"]
    return f"{what}: {content['reason']}{rotor}"
