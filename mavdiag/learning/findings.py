"""What a guard of teaching finds: the file, the place and the remedy."""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Finding", "Kind"]


class Kind(StrEnum):
    """What a finding is about."""

    REPEATED = "repeated"
    UPSET = "upset"
    FAR = "far"
    GROUPS = "groups"
    CHANGE = "change"
    PHYSICS = "physics"


@dataclass(frozen=True, slots=True)
class Finding:
    """Something among the healthy flights that should not be learnt.

    number: of the flight among those given, from 0: two may have one name.
    log: its name.
    kind: what it is about.
    text: what was seen, with figures, without the name.
    from_s, to_s: the part to leave out [s of the vehicle's clock]; None for the start or the end of the log.
    refuses: it must not be learnt; else it is only noted.
    """

    number: int
    log: str
    kind: Kind
    text: str
    from_s: float | None = None
    to_s: float | None = None
    refuses: bool = True

    @property
    def place(self) -> str:
        """The part to leave out, in words."""
        if self.from_s is None and self.to_s is None:
            return "the whole log"
        if self.from_s is None:
            return f"all before {self.to_s:.1f} s"
        return f"all from {self.from_s:.1f} s on" if self.to_s is None else f"{self.from_s:.1f} to {self.to_s:.1f} s"

    @property
    def remedy(self) -> str:
        """What to do about it."""
        if self.from_s is None and self.to_s is None:
            return "take this log out, or leave it out with --robust"
        if self.to_s is None:
            return f"cut the log before {self.from_s:.1f} s, or leave this part out with --robust"
        return f"cut {self.place} out of the log, or leave this part out with --robust"

    def __str__(self) -> str:
        return f"{self.log}: {self.text}"
