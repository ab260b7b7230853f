"""The process of the live page's server, and its pipes (edge). Nothing here waits, but `start` does once.

It is started with the daemon's own interpreter and path, and is told by lines. It ends when its stdin does: when the
daemon closes it, and when the daemon is killed. One that ends by itself is started again, after a pause that doubles.
"""

import contextlib
import importlib.util
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mavdiag.errors import LinkError, UsageError, missing_extra
from mavdiag.link.keys import read_secret
from mavdiag.telemetry import Instant

START_S = 20.0  # until it listens, at the start (our choice: an import on a slow companion takes some seconds)
AGAIN_S, AGAIN_MOST_S = 1.0, 60.0  # pause before it is started again, the first and the longest (our choice)
STEADY_S = 60.0  # after so long the pause begins anew
END_S = 1.0
READ_BYTES = 65_536
TOKEN_LEAST = 16  # characters
COMMAND = ("-P", "-m", "detector.web.server")  # -P: not what lies in the present folder


@dataclass(frozen=True, slots=True)
class Place:
    """Where the page is served. token: that it asks for; None for none."""

    host: str
    port: int
    token: str | None

    @property
    def url(self) -> str:
        """Where to open it."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}/"


def read_token(path: Path) -> str:
    """The token in a file. Raises UsageError unless the file keeps the rules of a key file, and the line will do."""
    form = f"{TOKEN_LEAST} or more ASCII characters without blanks"
    text = read_secret(path, "web token", form).decode("ascii", errors="replace")
    if len(text) < TOKEN_LEAST or not all("!" <= character <= "~" for character in text):
        raise UsageError(f"{path}: a web token is one line: {form}")
    return text


def check_installed() -> None:
    """Raise UsageError, saying what to install, unless the server's library is there."""
    if importlib.util.find_spec("aiohttp") is None:
        raise missing_extra("--web", "aiohttp", "web")


class ServerProcess:
    """The process. `start` it; it is started again by `look`.

    place: port 0 takes a free one, and keeps it. run: of the daemon. say: takes a log line.
    """

    def __init__(self, place: Place, run: str, say: Callable[[str], None]) -> None:
        self.place, self._run, self._say = place, run, say
        self._process: subprocess.Popen[bytes] | None = None
        self._unsent, self._unread = b"", b""
        self._begun: Instant | None = None
        self._pause_s, self._again = AGAIN_S, Instant(0)
        self._fresh, self._told = True, False

    def start(self) -> None:
        """Start it and wait until it listens. Raises UsageError or LinkError, in one line, if it cannot."""
        check_installed()
        self._spawn()
        process = self._process
        if process is None or process.stdout is None or not select.select([process.stdout], [], [], START_S)[0]:
            self.close()
            raise LinkError(f"web page on {self.place.url}: its process does not answer; try again")
        [answer, *_] = self._read() or ["refused its process ended"]
        word, _, rest = answer.partition(" ")
        if word != "listening":
            self.close()
            raise LinkError(f"web page on {self.place.url}: {rest}; name another --web HOST:PORT")
        self.place = Place(self.place.host, int(rest), self.place.token)

    @property
    def pid(self) -> int | None:
        """Of the process; None while there is none."""
        return None if self._process is None else self._process.pid

    @property
    def where(self) -> str:
        """Where the page is, for a person; the token itself is not shown."""
        return self.place.url if self.place.token is None else f"{self.place.url}?token=TOKEN"

    def look(self, now: Instant) -> tuple[bool, list[str]]:
        """Whether it began anew since the last call and knows nothing, and what it said. One that ended begins anew."""
        if self._process is None:
            if now - self._again < 0:
                return False, []
            try:
                self._spawn()
            except LinkError:  # no memory, no process: later
                self._ended(now)
                return False, []
        self._begun = self._begun or now
        lines = self._read()
        if self._process is not None and self._process.stdin is not None:
            self._flushed(self._process.stdin.fileno())
        if self._process is not None and self._process.poll() is not None:
            lines = []
            self._ended(now)
        elif self._told and any(one.startswith("listening") for one in lines):
            self._say(f"web page: {self.place.url} is served again")
            self._told = False
        fresh, self._fresh = self._fresh and self._process is not None, self._fresh and self._process is None
        return fresh, lines

    def put(self, data: bytes) -> bool:
        """Give it lines; False, and nothing is given, while it has no room."""
        process = self._process
        if process is None or process.stdin is None or not self._flushed(process.stdin.fileno()):
            return False
        self._unsent = data
        self._flushed(process.stdin.fileno())
        return True

    def close(self) -> None:
        """End it: it ends when its stdin does."""
        process, self._process = self._process, None
        if process is None:
            return
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _spawn(self) -> None:
        environ = {**os.environ, "PYTHONPATH": os.pathsep.join(one for one in sys.path if one)}
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen([sys.executable, *COMMAND], stdin=pipe, stdout=pipe, bufsize=0, env=environ)
        except OSError as error:
            raise LinkError(f"web page: its process cannot be started ({error.strerror or error})") from error
        self._process, self._begun, self._unread, self._fresh = process, None, b"", True
        for one in (process.stdin, process.stdout):
            if one is not None:
                os.set_blocking(one.fileno(), False)
        told = {"host": self.place.host, "port": self.place.port, "token": self.place.token, "run": self._run}
        self._unsent = f"{json.dumps(told)}\n".encode()
        if process.stdin is not None:
            self._flushed(process.stdin.fileno())

    def _ended(self, now: Instant) -> None:
        """It ended by itself: said once until it works again."""
        code = self._process.returncode if self._process is not None else 0
        lasted_s = now - self._begun if self._begun is not None else 0.0
        self.close()
        self._pause_s = AGAIN_S if lasted_s > STEADY_S else min(AGAIN_MOST_S, 2.0 * self._pause_s)
        self._again, self._fresh = now + self._pause_s, True
        if not self._told:
            self._say(f"web page: its process ended (exit code {code}); it is started again, the watch goes on")
        self._told = True

    def _flushed(self, descriptor: int) -> bool:
        """Whether all that was given is written."""
        try:
            while self._unsent:
                self._unsent = self._unsent[os.write(descriptor, self._unsent) :]
        except BlockingIOError:
            return False
        except OSError:  # it is gone: `look` sees that
            self._unsent = b""
            return False
        return True

    def _read(self) -> list[str]:
        """Whole lines that it said since the last call."""
        process = self._process
        if process is None or process.stdout is None:
            return []
        with contextlib.suppress(BlockingIOError):
            self._unread += os.read(process.stdout.fileno(), READ_BYTES)
        *lines, self._unread = self._unread.split(b"\n")
        return [one.decode(errors="replace") for one in lines]
