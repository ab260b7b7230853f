"""Open inspections (edge): what a detector declared and nobody has acknowledged, kept over restarts beside its journal.

    JOURNAL.open     all of them, JSON; the detector alone writes it
    JOURNAL.ack-N    who acknowledges that of vehicle N; `mavdiag ack` writes it, the detector takes it

An inspection is the vehicle's, whatever baseline it is judged by later; only a newer set of propellers closes it.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, ValidationError

from mavdiag.decision.alarm import NOTHING_SEEN, Change, Diagnosis, Stage
from mavdiag.decision.diagnosis import RotorSpan
from mavdiag.decision.words import motors_words
from mavdiag.errors import InputError, UsageError
from mavdiag.link.keys import RETRY_S
from mavdiag.monitors.base import FaultKind
from mavdiag.printable import printable
from mavdiag.storage import read_text, write_atomically
from mavdiag.telemetry import Instant

OPEN_BYTES = 1 << 20
WHOSE_BYTES = 200  # of a name, at most


class Inspection(BaseModel, frozen=True, extra="forbid"):
    """One of them; rotors that were named, in order, and the latest. declared: when it was written first, ISO 8601 UTC.

    baseline, propellers: digest of what the vehicle was judged by, and the number of its propeller set.
    """

    vehicle: Annotated[int, Field(ge=1, le=255)]
    declared: str
    kind: FaultKind
    rotors: Annotated[tuple[int, ...], Field(max_length=64)]
    rotor: int | None
    baseline: str
    propellers: int

    @property
    def diagnosis(self) -> Diagnosis:
        """What a session begins with; the times of its rotors are of a clock that is gone."""
        spans = tuple(RotorSpan(rotor, 0, 0) for rotor in self.rotors)
        why = f"a fault was declared before this start, at {self.declared}"
        return Diagnosis(Stage.INSPECT, why, rotor=self.rotor, kind=self.kind, rotors=spans)

    def __str__(self) -> str:
        return f"vehicle {self.vehicle}: {motors_words(self.diagnosis)} ({self.kind}, declared at {self.declared})"


class _File(BaseModel, frozen=True, extra="forbid"):
    inspections: Annotated[tuple[Inspection, ...], Field(max_length=255)] = ()


def read_open(journal: Path) -> dict[int, Inspection]:
    """The open inspections beside a journal, by system id. Raises InputError if the file is damaged."""
    path = _beside(journal, "open")
    if not path.exists():
        return {}
    try:
        found = _File.model_validate_json(read_text(path, OPEN_BYTES))
    except ValidationError as error:
        raise InputError(f"{path}: no list of open inspections; look at the vehicles and remove the file") from error
    return {inspection.vehicle: inspection for inspection in found.inspections}


def ask(journal: Path, vehicle: int | None, whose: str) -> tuple[Inspection, bool]:
    """Acknowledge an inspection for the detector to take up; return which, and whether an older acknowledgement waits.

    vehicle: None for the only one. Raises UsageError if none is open, or several are and none was named.
    """
    found = read_open(journal)
    if vehicle is None and len(found) > 1:
        listed = "; ".join(str(inspection) for inspection in found.values())
        raise UsageError(f"{journal}: several inspections are open, choose one with --vehicle: {listed}")
    asked = found.get(next(iter(found), 0) if vehicle is None else vehicle)
    if asked is None:
        raise UsageError(f"{journal}: no inspection{'' if vehicle is None else f' of vehicle {vehicle}'} is open")
    path = _beside(journal, f"ack-{asked.vehicle}")
    waits = path.exists()
    write_atomically(path, f"{printable(whose)[:WHOSE_BYTES]}\n")
    return asked, waits


class Inspections:
    """Those of one detector, beside its journal (None keeps none), written by `flush`.

    warn: called once when writing begins to fail and when it works again, and once for each acknowledgement's trouble.
    Raises InputError if the file is damaged.
    """

    def __init__(self, journal: Path | None, warn: Callable[[str], None]) -> None:
        self._journal, self._warn = journal, warn
        self._open = {} if journal is None else read_open(journal)
        self._due = self._failing = False  # whether they are to be written; whether that failed the last time, and
        self._again = Instant(0)  # when it is tried again
        self._troubles = set[str]()  # why an acknowledgement could not be taken up

    def held(self, vehicle: int, propellers: int | None) -> Diagnosis:
        """What is known of a vehicle from before. propellers: number of its present set, if it is known."""
        known = self._open.get(vehicle)
        if known is not None and propellers is not None and propellers > known.propellers:
            self.close(vehicle)
            known = None
        return NOTHING_SEEN if known is None else known.diagnosis

    def take(self, vehicle: int, change: Change, baseline: str, propellers: int, utc: str) -> None:
        """Keep what a change of a vehicle's decision says. utc: now."""
        if change.stage not in (Stage.FAULT, Stage.INSPECT):
            self.close(vehicle)
            return
        old = self._open.get(vehicle)
        rotors = tuple(dict.fromkeys(span.rotor for span in change.rotors))
        new = Inspection(
            vehicle=vehicle,
            declared=utc if old is None else old.declared,
            kind=change.kind or FaultKind.PROPELLER,
            rotors=rotors,
            rotor=change.rotor or (rotors[-1] if rotors else None),
            baseline=baseline,
            propellers=propellers,
        )
        if old is None and self._journal is not None:
            with suppress(OSError):  # then it cannot be taken up either
                _beside(self._journal, f"ack-{vehicle}").unlink(missing_ok=True)  # it was of an inspection before
        if new != old:
            self._open[vehicle], self._due = new, True

    def close(self, vehicle: int) -> bool:
        """It is acknowledged, or over; return whether it was open."""
        known = self._open.pop(vehicle, None) is not None
        self._due |= known
        return known

    def acknowledged(self) -> list[tuple[int, str]]:
        """The vehicles whose inspection somebody acknowledged since the last call, and who it was."""
        if self._journal is None:
            return []
        found = []
        for vehicle in list(self._open):
            path = _beside(self._journal, f"ack-{vehicle}")
            try:
                if path.exists():
                    whose = read_text(path, WHOSE_BYTES * 4 + 1).strip() or "somebody"
                    path.unlink(missing_ok=True)  # one that stayed would close the next inspection, too
                    found.append((vehicle, whose))
            except (InputError, OSError) as error:
                if (trouble := f"{path}: cannot be taken up ({error})") not in self._troubles:
                    self._warn(trouble)
                    self._troubles.add(trouble)
        return found

    def flush(self, now: Instant | None = None) -> None:
        """Write what has changed; what could not be written is tried again RETRY_S later. now: None for in any case."""
        if self._journal is None or not self._due or (now is not None and now - self._again < 0):
            return
        content = _File(inspections=tuple(self._open.values())).model_dump_json(indent=1)
        try:
            write_atomically(_beside(self._journal, "open"), content + "\n")
        except UsageError as error:  # a disk that is full or read-only must not stop the watch
            if not self._failing:
                self._warn(f"open inspections are not kept: {error}")
            self._failing, self._again = True, self._again if now is None else now + RETRY_S
            return
        if self._failing:
            self._warn("open inspections are kept again")
        self._due = self._failing = False


def _beside(journal: Path, what: str) -> Path:
    return journal.with_name(f"{journal.name}.{what}")
