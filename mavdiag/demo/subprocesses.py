"""Child processes of the demo (edge): started from this Python by module name, and always ended."""

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from queue import Empty, Queue

from mavdiag.errors import LinkError

GRACE_S = 3.0
POLL_S = 0.1


class Child:
    """A running process and the lines that it printed."""

    def __init__(self, module: str, *arguments: str) -> None:
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

    def wait_for(self, text: str, timeout_s: float) -> str:
        """The first new line that holds `text`.

        Raises LinkError with the last line if none comes within `timeout_s` in all, or as soon as the process ended.
        """
        until = time.monotonic() + timeout_s
        while True:
            ended = not self.running  # looked at before the queue: its last lines still count
            left = until - time.monotonic()
            try:
                line = self._fresh.get(timeout=min(max(left, 0.0), POLL_S))
            except Empty:
                if ended or left <= 0:
                    why = "stopped" if ended else "did not get ready"
                    raise LinkError(f"{self.module} {why}: {self.last}") from None
            else:
                if text in line:
                    return line

    @property
    def last(self) -> str:
        """The last line that it printed."""
        return self.lines[-1] if self.lines else "it printed nothing"

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

    def _read(self) -> None:
        for line in self._process.stdout or ():
            self.lines.append(line.rstrip())
            self._fresh.put(line.rstrip())


@contextlib.contextmanager
def child(module: str, *arguments: str) -> Iterator[Child]:
    """A process that ends with the block."""
    process = Child(module, *arguments)
    try:
        yield process
    finally:
        process.end()


def run_child(module: str, *arguments: str) -> None:
    """Run a process to its end. Raises LinkError with its last line if it fails."""
    with child(module, *arguments) as process:
        if process.finish() != 0:
            raise LinkError(f"{module} failed: {process.last}")
