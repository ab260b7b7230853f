"""Child processes of the demo (edge): started from this Python, heard, and always ended."""

import contextlib
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from queue import Empty, Queue

from mavdiag.errors import LinkError

__all__ = ["Child", "child", "run_child"]

GRACE_S = 3.0


class Child:
    """A running process and the lines that it printed."""

    def __init__(self, module: str, arguments: Sequence[str]) -> None:
        self.module = module
        self.lines: list[str] = []
        self._fresh: Queue[str] = Queue()
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        if self._process.stdout is not None:
            for line in self._process.stdout:
                self.lines.append(line.rstrip())
                self._fresh.put(line.rstrip())

    def wait_for(self, word: str, timeout_s: float) -> str:
        """The first new line that holds `word`. Raises LinkError with the last line if none comes in time."""
        while True:
            try:
                line = self._fresh.get(timeout=timeout_s)
            except Empty:
                last = self.lines[-1] if self.lines else "it said nothing"
                raise LinkError(f"{self.module} did not get ready: {last}") from None
            if word in line:
                return line
            if self._process.poll() is not None and self._fresh.empty():
                raise LinkError(f"{self.module} stopped: {line}")

    @property
    def running(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def finish(self, timeout_s: float | None = None) -> int:
        """Wait for its end and return its exit code."""
        code = self._process.wait(timeout_s)
        self._reader.join(GRACE_S)
        if self._process.stdout is not None and not self._reader.is_alive():
            self._process.stdout.close()
        return code

    def end(self) -> None:
        """Ask it to stop, and insist after a while."""
        if self.running:
            self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE_S)
        if self.running:
            self._process.kill()
        self.finish(GRACE_S)


@contextlib.contextmanager
def child(module: str, *arguments: str) -> Iterator[Child]:
    """A process that ends with the block."""
    one = Child(module, arguments)
    try:
        yield one
    finally:
        one.end()


def run_child(module: str, *arguments: str) -> None:
    """Run a process to its end. Raises LinkError with its last line if it fails."""
    with child(module, *arguments) as one:
        if one.finish() != 0:
            raise LinkError(f"{module} failed: {one.lines[-1] if one.lines else 'it said nothing'}")
