"""What the service manager is told: a datagram for each fact, and no sign of life while nothing is done."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import Bench, FakeFitter, MadeVehicle

from detector.config import Settings
from detector.notify import Notifier
from mavdiag.link.messages import Autopilot


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "notify"))
        one.setblocking(False)
        yield one


def told(manager: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(manager.recv(4096).decode())
        except BlockingIOError:
            return found


def environ(manager: socket.socket, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": str(manager.getsockname()), **more}


def test_the_daemon_gives_no_sign_of_life_while_all_sessions_are_off(manager: socket.socket) -> None:
    """The baseline is of another profile."""
    notifier = Notifier(environ(manager, WATCHDOG_USEC="30000000"))
    settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
    vehicle = MadeVehicle(1, Autopilot.ARDUPILOTMEGA)
    bench = Bench(settings, baseline_for(), FakeFitter(), vehicles=[vehicle], notifier=notifier)
    bench.run(5.0)
    told(manager)
    for _ in range(10):
        bench.run(1.0)
        assert "WATCHDOG=1" not in told(manager)
    bench.close()
    notifier.close()
