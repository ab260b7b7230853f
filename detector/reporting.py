"""What the daemon writes down (edge): lines of the journal, log lines, learned baselines."""

from collections.abc import Callable
from pathlib import Path

from detector.journal import Journal, When, is_urgent, line, mark
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
from mavdiag.link.timesync import TimesyncMessage

__all__ = ["Reporter"]


class Reporter:
    """Writes to the journal, if there is one, and to the log.

    say: takes a log line.
    when: the time of a line about a vehicle (None: about the daemon).
    save: file for learned baselines, None to keep none.
    """

    def __init__(
        self,
        journal: Journal | None,
        say: Callable[[str], None],
        when: Callable[[int | None], When],
        save: Path | None,
    ) -> None:
        self._journal, self._say, self._when, self._path = journal, say, when, save
        self._saved: dict[int, Path] = {}

    def record(self, sysid: int, effect: Effect) -> None:
        """The effects that are worth a line, in the journal and, most of them, in the log."""
        if isinstance(effect, AskInterval | AskParameters | Learn | SendFloat | TimesyncMessage):
            return
        if self._journal is not None:
            self._journal.write(line(effect, self._when(sysid)), urgent=is_urgent(effect))
        for words in _log_lines(effect):
            self._say(f"vehicle {sysid}: {words}")

    def mark(self, kind: str, content: dict[str, object]) -> None:
        """A line about the daemon itself."""
        if self._journal is not None:
            self._journal.write(mark(kind, self._when(None), content))

    def save(self, sysid: int, baseline: Baseline) -> None:
        """Keep a learned baseline: the first vehicle's under the name asked for, another's with its id in it."""
        path = self._path
        if path is None:
            return
        if any(vehicle != sysid and taken == path for vehicle, taken in self._saved.items()):
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
