"""The journal of a detector, followed while it is written (edge): what happened to which vehicle.

It holds events and texts, no rates: a display of it has no strips.
"""

import json
import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavdiag.decision.diagnosis import Stage
from mavdiag.decision.words import stage_line
from mavdiag.link.messages import Severity
from mavdiag.storage import open_regular
from mavdiag.terminal.view import Line

JOURNAL_BYTES = 1 << 40  # there is no limit: it is read in pieces
READ_BYTES = 1 << 20  # at a time


@dataclass(slots=True)
class VehicleStory:
    """What a journal says of one vehicle: the latest state of the session, stage of the decision and its reason."""

    state: str = ""
    stage: str = ""
    reason: str = ""


class Journal:
    """A journal's vehicles, as far as it was read; over rotations, too.

    vehicles: by system id. damaged: lines that could not be read.
    Raises InputError if there is no such file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._stack = path, ExitStack()
        self._open()
        self.vehicles: dict[int, VehicleStory] = {}
        self.damaged = 0

    def read(self) -> list[tuple[int, Line]]:
        """What was written since the last call, by vehicle, in its order."""
        found = self._rest()
        if self._rotated():
            found += self._rest()  # what came between the two looks
            self.close()
            self._open()
            found += self._rest()
        return found

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _open(self) -> None:
        self._file, self._begun = self._stack.enter_context(open_regular(self._path, JOURNAL_BYTES)), b""

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
            for line in lines:
                try:
                    content = json.loads(line)
                    if content.get("vehicle") is None:
                        continue
                    number = int(content["vehicle"])
                    told = _told(self.vehicles.setdefault(number, VehicleStory()), content)
                    found += [] if told is None else [(number, told)]
                except (ValueError, TypeError, AttributeError, KeyError):
                    self.damaged += bool(line.strip())
        return found


def _told(story: VehicleStory, content: dict[str, Any]) -> Line | None:
    """One line about a vehicle; None if it is of no interest here."""
    t_s = float(content.get("vehicle_s") or 0.0)
    match content["kind"]:
        case "state":
            story.state = str(content["to"])
            return Line(t_s, Severity.INFO, f"{content['from']} -> {content['to']}: {content['reason']}")
        case "stage":
            story.stage, story.reason = str(content["stage"]), str(content["reason"])
            words = stage_line(story.stage, story.reason, content.get("rotor"), content.get("fault_kind"))
            return Line(t_s, Severity.CRITICAL if story.stage == Stage.FAULT else Severity.NOTICE, words)
        case "text":
            return Line(t_s, Severity(int(content["severity"])), str(content["text"]))
        case "note":
            return Line(t_s, Severity.INFO, str(content["text"]))
        case _:
            return None
