"""What the daemon writes down (edge): lines of the journal, log lines, learned baselines."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from detector.journal import When, is_urgent, line, mark
from detector.values import (
    AskInterval,
    AskParameters,
    Effect,
    Learn,
    Note,
    SendFloat,
    SendText,
    StateChanged,
    TextSuppressed,
)
from mavdiag.baseline import Baseline
from mavdiag.decision.alarm import Change
from mavdiag.errors import UsageError
from mavdiag.link.clock import TimesyncMessage

__all__ = ["Lines", "Reporter", "kept_baselines"]


def kept_baselines(path: Path) -> dict[int, tuple[Path, Baseline]]:
    """What earlier starts learned and kept under this name, by system id; 0 for one that was not learned live.

    Raises BaselineError for a file that is none.
    """
    own = re.compile(rf"{re.escape(path.stem)}-\d+{re.escape(path.suffix)}")
    beside = [one for one in path.parent.iterdir() if own.fullmatch(one.name)] if path.parent.is_dir() else []
    loaded = [(one, Baseline.load(one)) for one in (path, *sorted(beside)) if one.is_file()]
    return {baseline.provenance.vehicle: (one, baseline) for one, baseline in reversed(loaded)}


class Lines(Protocol):
    """Who takes the journal's lines."""

    def write(self, text: str, *, urgent: bool = False) -> None:
        """Take one. urgent: it is about an alert."""


class Reporter:
    """Writes to the log, and to those who take the journal's lines.

    lines: the journal, the live page; either may be missing.
    say: takes a log line.
    when: the time of a line about a vehicle (None: about the daemon).
    save: file for learned baselines, None to keep none.
    """

    def __init__(
        self,
        lines: Sequence[Lines],
        say: Callable[[str], None],
        when: Callable[[int | None], When],
        save: Path | None,
    ) -> None:
        self._lines, self._say, self._when, self._path = tuple(lines), say, when, save
        self._saved: dict[int, Path] = {}

    def record(self, sysid: int, effect: Effect) -> None:
        """The effects that are worth a line, in the journal and, most of them, in the log."""
        if isinstance(effect, AskInterval | AskParameters | Learn | SendFloat | TimesyncMessage):
            return
        if self._lines:
            text, urgent = line(effect, self._when(sysid)), is_urgent(effect)
            for one in self._lines:
                one.write(text, urgent=urgent)
        for words in _log_lines(effect):
            self._say(f"vehicle {sysid}: {words}")

    def mark(self, kind: str, content: dict[str, object]) -> None:
        """A line about the daemon itself."""
        for one in self._lines:
            one.write(mark(kind, self._when(None), content))

    def save(self, sysid: int, baseline: Baseline) -> None:
        """Keep a learned baseline: the first vehicle's under the name asked for, another's with its id in it."""
        path = self._path
        if path is None:
            return
        if path.exists() and self._saved.get(sysid) != path:
            path = path.with_stem(f"{path.stem}-{sysid}")
        self._saved[sysid] = path
        try:
            baseline.save(path)
        except UsageError as error:
            self.record(sysid, Note(f"the baseline is not saved: {error}"))
        else:
            self.record(sysid, Note(f"baseline saved to {path}"))


def _log_lines(effect: Effect) -> list[str]:
    match effect:
        case StateChanged(old, new, reason):
            return [f"{old} -> {new}: {reason}"]
        case Change(stage=stage, reason=reason):
            return [f"decision: {stage}, {reason}"]
        case SendText(severity, text):
            return [f"{severity.name} {text!r}"]
        case Baseline():
            return str(effect).splitlines()
        case Note(text):
            return [text]
        case TextSuppressed(text, count):
            return [f"held back {text!r} ({count} so far)"]
        case _:
            return []
