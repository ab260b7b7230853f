"""The process of the live page's server, and its pipes (edge). Nothing here waits, but `start` does once.

It is told by lines, and ends when its stdin does: when the daemon closes it, and when the daemon is killed. One that
ends by itself is started again, after a pause.
"""

import contextlib
import json
import os
import select
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

from detector.process import begun
from detector.web.access import Access
from mavdiag.errors import LinkError, UsageError, check_installed
from mavdiag.link.keys import read_secret
from mavdiag.telemetry import Instant

START_S = 20.0  # until it listens, at the start (our choice: an import on a slow companion takes some seconds)
AGAIN_S = 5.0  # pause before it is started again (our choice)
END_S = 1.0
READ_BYTES = 65_536
TOKEN_LEAST = 16  # characters
SERVER = "detector.web.server"  # the module that serves


def read_token(path: Path) -> str:
    """The token in a file. Raises UsageError unless the file keeps the rules of a key file, and the line will do."""
    form = f"{TOKEN_LEAST} or more ASCII characters without blanks"
    text = read_secret(path, "web token", form).decode("ascii", errors="replace")
    if len(text) < TOKEN_LEAST or not all("!" <= character <= "~" for character in text):
        raise UsageError(f"{path}: a web token is one line: {form}")
    return text


class ServerProcess:
    """The process. place: where it listens, port 0 for a free one, and who may read. run: of the daemon.

    say: takes a log line. niceness: of the process, for a daemon's receive loop comes first.
    """

    def __init__(self, place: Access, run: str, say: Callable[[str], None], niceness: int = 5) -> None:
        self.place, self._run, self._say, self._niceness = place, run, say, niceness
        self._process: subprocess.Popen[bytes] | None = None
        self._stdin = self._stdout = -1  # its descriptors, which never block
        self._unsent, self._unread = b"", b""
        self._again = Instant(0)
        self._fresh = self._told = False  # it began anew and knows nothing; that it ended was said

    def start(self) -> None:
        """Start it and wait until it listens. Raises UsageError or LinkError, in one line, if it cannot."""
        check_installed("--web", "aiohttp", "web")
        self._spawn()
        answers = self._read() if select.select([self._stdout], [], [], START_S)[0] else ["silent"]
        word, _, rest = (answers or ["refused its process ended"])[0].partition(" ")
        if word != "listening":
            self.close()
            why = f"{rest}; name another --web HOST:PORT" if rest else "its process does not answer; try again"
            raise LinkError(f"web page on {self.place.url}: {why}")
        self.place = replace(self.place, port=int(rest))

    @property
    def where(self) -> str:
        """Where the page is, for a person; the token itself is not shown."""
        return self.place.url if self.place.token is None else f"{self.place.url}?token=TOKEN"

    def look(self, now: Instant) -> tuple[bool, list[str]]:
        """Whether it began anew since the last call and knows nothing, and what it said. One that ended begins anew."""
        if self._process is None and now - self._again >= 0:
            with contextlib.suppress(LinkError):  # no memory, no process: later
                self._spawn()
        if (process := self._process) is None:
            return False, []
        lines = self._read()
        self._flush()
        if process.poll() is not None:
            self.close()
            self._again = now + AGAIN_S
            if not self._told:  # once until it works again
                code = process.returncode
                self._say(f"web page: its process ended (exit code {code}); it is started again, the watch goes on")
            self._told = True
            return False, []
        if self._told and any(line.startswith("listening") for line in lines):
            self._say(f"web page: {self.place.url} is served again")
            self._told = False
        fresh, self._fresh = self._fresh, False
        return fresh, lines

    def wait(self, timeout_s: float) -> None:
        """Return when it says something, or has room for what it was not given yet, and after that time."""
        if self._process is None:
            time.sleep(timeout_s)
        else:
            select.select([self._stdout], [self._stdin] if self._unsent else [], [], timeout_s)

    def put(self, data: bytes) -> bool:
        """Give it lines; False, and nothing is given, while it has no room."""
        if self._process is None or not self._flush():
            return False
        self._unsent = data
        self._flush()
        return True

    def close(self) -> None:
        """End it: it ends when its stdin does."""
        process, self._process = self._process, None
        if process is None:
            return
        for pipe in filter(None, (process.stdin, process.stdout)):
            with contextlib.suppress(OSError):
                pipe.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _spawn(self) -> None:
        try:
            process = begun(SERVER)
        except OSError as error:
            raise LinkError(f"web page: its process cannot be started ({error.strerror or error})") from error
        self._process, self._unread, self._fresh = process, b"", True
        self._stdin, self._stdout = (stream.fileno() for stream in (process.stdin, process.stdout) if stream)
        for descriptor in (self._stdin, self._stdout):
            os.set_blocking(descriptor, False)
        told = asdict(self.place) | {"run": self._run, "niceness": self._niceness}
        self._unsent = f"{json.dumps(told)}\n".encode()
        self._flush()

    def _flush(self) -> bool:
        try:
            while self._unsent:
                self._unsent = self._unsent[os.write(self._stdin, self._unsent) :]
        except BlockingIOError:
            return False
        except OSError:  # it is gone: `look` sees that
            self._unsent = b""
            return False
        return True

    def _read(self) -> list[str]:
        with contextlib.suppress(BlockingIOError):
            self._unread += os.read(self._stdout, READ_BYTES)
        *lines, self._unread = self._unread.split(b"\n")
        return [line.decode(errors="replace") for line in lines]
