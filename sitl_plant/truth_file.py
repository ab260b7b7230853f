"""The truth of a flight in a file (edge), line by line as it happens."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from mavdiag.errors import UsageError
from sitl_plant.plant import Change, PlantConfig, PlantSamples
from sitl_plant.truth import Truth


@contextmanager
def truth_file(path: Path | None) -> Iterator[TextIO | None]:
    """The open file, None for no file. Raises UsageError if it cannot be written."""
    if path is None:
        yield None
        return
    try:
        file = path.open("w", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}; choose another --truth file") from error
    with file:
        yield file


class TruthWriter:
    """Writes each block's lines so that a reader sees them at once; nothing without a file.

    A block that begins before the one before it is of a new flight, and gets a first line of its own.
    """

    def __init__(
        self, file: TextIO | None, config: PlantConfig, profile: str, rate_hz: float, started_unix_ns: int | None
    ) -> None:
        self._file = file
        self._start = (config, profile, rate_hz, started_unix_ns)
        self._truth = Truth(*self._start)
        if file is not None:
            file.write(self._truth.head() + "\n")
        self._t_ns = 0

    def write(self, samples: PlantSamples, changes: Sequence[Change] = ()) -> None:
        """The lines of a block (n >= 1). changes: `Plant.take_changes`, made before the block."""
        if self._file is None:
            return
        if int(samples.t_ns[0]) < self._t_ns:
            self._truth = Truth(*self._start)
            self._file.write(self._truth.head() + "\n")
        self._t_ns = int(samples.t_ns[-1])
        lines = self._truth.step(samples, changes)
        if lines:
            self._file.write("\n".join(lines) + "\n")
            self._file.flush()
