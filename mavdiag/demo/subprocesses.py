"""Child processes of the demo (edge): started from this Python by module name, and always ended."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from mavdiag.errors import LinkError

GRACE_S = 3.0
POLL_S = 0.05


class Child:
    """A running process. What it prints goes to a file, so that it never waits for a reader."""

    def __init__(self, module: str, *arguments: str) -> None:
        self.module, self._printed, self._told = module, b"", 0
        self._output = tempfile.TemporaryFile()  # noqa: SIM115  # closed when the process has ended
        command = [sys.executable, "-m", module, *arguments]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=self._output, stderr=subprocess.STDOUT
        )

    @property
    def lines(self) -> list[str]:
        """The lines that it printed so far, read without moving the place at which it writes."""
        if not self._output.closed:
            self._printed = os.pread(self._output.fileno(), os.fstat(self._output.fileno()).st_size, 0)
        return self._printed.rpartition(b"\n")[0].decode(errors="replace").splitlines()

    @property
    def last(self) -> str:
        """The last line that it printed."""
        return self.lines[-1] if self.lines else "it printed nothing"

    @property
    def running(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def wait_for(self, text: str, timeout_s: float) -> str:
        """Wait for a new line that holds `text`. Raises LinkError with the last line if it ends or takes longer."""
        until = time.monotonic() + timeout_s
        while True:
            ended = not self.running  # looked at before the lines: its last ones still count
            for line in self.lines[self._told :]:
                self._told += 1
                if text in line:
                    return line
            if ended or time.monotonic() >= until:
                raise LinkError(f"{self.module} {'stopped' if ended else 'did not get ready'}: {self.last}")
            time.sleep(POLL_S)

    def finish(self, timeout_s: float | None = None) -> int:
        """Wait for its end and return its exit code; `lines` has all that it printed."""
        code = self._process.wait(timeout_s)
        _ = self.lines
        self._output.close()
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
