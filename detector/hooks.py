"""Hooks (edge): programs, web servers and brokers that get the journal's lines about alerts, each from its own thread.

    exec:PROGRAM ARGUMENT...      runs it, the line on its standard input; exit code 0 within RUN_S is success
    http://..., https://...       POST of the line as application/json; a 2xx within ANSWER_S is success
    mqtt://HOST[:PORT]/TOPIC      publishes it with quality of service 1, confirmed within ANSWER_S (extra `mqtt`)

A line waits in a bounded queue and is tried TRIES times; what is lost is counted and told. The daemon never waits.
"""

import queue
import shlex
import shutil
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Generic, TypeVar
from urllib.parse import urlsplit

from mavdiag.errors import UsageError, check_installed

QUEUED = 1000  # lines that wait (our choice: an alert a second for a quarter of an hour)
TRIES, PAUSE_S = 3, 1.0  # of a line; the pause doubles after each (our choice)
ANSWER_S, RUN_S = 5.0, 10.0  # that one try may take (our choice)
STOP_S = 3.0  # in which the daemon's end waits for lines that were not delivered (our choice)
MQTT_PORT = 1883

T = TypeVar("T")


def parse_hook(text: str) -> Callable[[bytes], object]:
    """Say how a line is delivered to a hook. Raises UsageError for a malformed one, or a program that is not there."""
    scheme, _, rest = text.partition(":")
    program, address = (rest, "") if scheme == "exec" else ("", text)
    try:
        words, parts = shlex.split(program), urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise UsageError(f"{text!r}: {error}") from error
    if scheme == "exec":
        if not words or shutil.which(words[0]) is None:
            raise UsageError(f"{text!r}: there is no program {(words or [''])[0]!r}")
        return lambda line: _run(words, line)
    if parts.username is not None or parts.password is not None:
        raise UsageError("a hook's address has no room for a user or password: others would see it in the process list")
    if scheme in ("http", "https") and host:
        return lambda line: _post(text, line)
    if scheme == "mqtt" and host and parts.path.strip("/") and not set("+#?").intersection(address):
        check_installed(repr(text), "paho", "mqtt")
        return lambda line: _publish(host, port or MQTT_PORT, parts.path.strip("/"), line)
    raise UsageError(f"{text!r}: write exec:PROGRAM, http://HOST/PATH, https://HOST/PATH or mqtt://HOST/TOPIC")


def _run(words: list[str], line: bytes) -> None:
    try:
        subprocess.run(words, input=line + b"\n", stdout=subprocess.DEVNULL, timeout=RUN_S, check=True)
    except subprocess.SubprocessError as error:
        raise OSError(str(error)) from error


def _post(address: str, line: bytes) -> None:
    import urllib.request  # only if asked for: the import takes its time
    from http.client import HTTPException

    class NoRedirect(urllib.request.HTTPRedirectHandler):  # a redirected POST would become a GET without the line
        def redirect_request(self, *_: object) -> None:
            return None

    request = urllib.request.Request(address, line, {"Content-Type": "application/json"}, method="POST")
    try:
        with urllib.request.build_opener(NoRedirect).open(request, timeout=ANSWER_S):
            pass
    except HTTPException as error:
        raise OSError(f"no answer of a web server: {error}") from error


def _publish(host: str, port: int, topic: str, line: bytes) -> None:
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode

    client = Client(CallbackAPIVersion.VERSION2)
    client.connect(host, port)
    deadline = time.monotonic() + ANSWER_S
    sent = client.publish(topic, line, qos=1)
    try:
        while not sent.is_published():
            left_s = deadline - time.monotonic()
            if left_s <= 0 or client.loop(left_s) != MQTTErrorCode.MQTT_ERR_SUCCESS:
                raise OSError("the broker did not confirm it")
    except RuntimeError as error:
        raise OSError(f"the broker did not take it: {error}") from error
    client.disconnect()


class Courier(Generic[T]):
    """Delivers lines, or jobs, from a thread of its own. name: in messages.

    deliver: raises OSError or ValueError if the other side did not take it. warn: told when that fails, or works again.
    """

    def __init__(self, name: str, deliver: Callable[[T], object], warn: Callable[[str], None]) -> None:
        self.name, self._deliver, self._warn = name, deliver, warn
        self._lines: queue.Queue[T] = queue.Queue(QUEUED)
        self._news: deque[str] = deque(maxlen=QUEUED)
        self._failing = False
        self._stopping = threading.Event()
        self.lost = 0  # lines that were not delivered, so far
        self._thread = threading.Thread(target=self._work, name=self.name, daemon=True)
        self._thread.start()

    def put(self, line: T) -> None:
        """Queue a line."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self._lose(f"{QUEUED} lines wait")

    def flush(self) -> None:
        """Say what happened since the last call, on the caller's thread."""
        while self._news:
            self._warn(self._news.popleft())

    def close(self, deadline: float | None = None) -> None:
        """Deliver what waits until then, by `time.monotonic`, by default for STOP_S; the rest is lost."""
        deadline = time.monotonic() + STOP_S if deadline is None else deadline
        while self._lines.unfinished_tasks and self._thread.is_alive() and time.monotonic() < deadline:
            time.sleep(0.01)
        waiting = self._lines.unfinished_tasks
        self._stopping.set()
        if waiting:
            self.lost += waiting
            self._news.append(f"{self.name}: {waiting} lines were not delivered")
        self.flush()

    def _work(self) -> None:
        while not self._stopping.is_set():
            try:
                line = self._lines.get(timeout=0.2)
            except queue.Empty:
                continue
            self._try(line)
            self._lines.task_done()

    def _try(self, line: T) -> None:
        for number in range(TRIES):
            try:
                self._deliver(line)
            except (OSError, ValueError) as error:
                reason = str(error)
            else:
                if self._failing:
                    self._news.append(f"{self.name}: delivers again; {self.lost} lines were lost so far")
                self._failing = False
                return
            if number < TRIES - 1 and self._stopping.wait(PAUSE_S * 2**number):
                return  # `close` has counted it
        self._lose(reason)

    def _lose(self, reason: str) -> None:
        self.lost += 1
        if not self._failing:
            self._news.append(f"{self.name}: not delivered ({reason}); watching goes on without it")
        self._failing = True


def close_all(couriers: Iterable[Courier[Any]]) -> None:
    """Deliver what waits with all of them if that takes no longer than STOP_S together; the rest is lost."""
    deadline = time.monotonic() + STOP_S
    for courier in couriers:
        courier.close(deadline)


class Hook(Courier[bytes]):
    """Takes lines as a journal does, and delivers those about alerts. Raises UsageError as `parse_hook`."""

    def __init__(self, text: str, warn: Callable[[str], None]) -> None:
        super().__init__(f"hook {text}", parse_hook(text), warn)

    def write(self, text: str, urgent: bool = False) -> None:
        """Queue a line that is about an alert; others are not for hooks."""
        if urgent:
            self.put(text.encode())
