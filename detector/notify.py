"""What systemd is told (edge), by sd_notify(3): readiness, state and the watchdog."""

import contextlib
import os
import socket
from collections.abc import Mapping


class Notifier:
    """Speaks to the service manager, or to nobody if `environ` names none. Nothing here raises or waits."""

    def __init__(self, environ: Mapping[str, str]) -> None:
        place = environ.get("NOTIFY_SOCKET", "")
        # An abstract socket is written with an @ and begins with a zero byte.
        self._place = f"\0{place[1:]}" if place.startswith("@") else place
        for_us = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._watched = for_us and bool(environ.get("WATCHDOG_USEC"))
        self._status = ""
        self._socket: socket.socket | None = None
        if self._place:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def ready(self) -> None:
        """The links are open and the loop begins."""
        self._send("READY=1")

    def status(self, status: str, *, alive: bool) -> None:
        """One line for `systemctl status`. alive: the loop goes on and does its work."""
        if alive and self._watched:
            self._send("WATCHDOG=1")
        if status != self._status:
            self._send(f"STATUS={' '.join(status.split())}")
        self._status = status

    def stopping(self) -> None:
        """The daemon ends."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # the manager is gone or its queue is full
                self._socket.sendto(text.encode(), self._place)
