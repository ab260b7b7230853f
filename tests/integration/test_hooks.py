"""Hooks deliver every alert's line to real programs, web servers and brokers, and hold up nothing when they fail."""

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle
from web_page import wait_for

from detector.config import Settings
from detector.hooks import QUEUED, Hook
from mavdiag.link.messages import Autopilot

pytestmark = pytest.mark.realtime
WAIT_S = 20.0
BROKER = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")


class Server:
    """A web server that keeps what is posted, and answers with the status that it was given."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.kinds: set[str | None] = set()
        self.statuses: list[int] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                outer.bodies.append(self.rfile.read(int(self.headers["Content-Length"])))
                outer.kinds.add(self.headers["Content-Type"])
                status = outer.statuses.pop(0) if outer.statuses else 204
                self.send_response(status)
                if status == 302:
                    self.send_header("Location", f"http://127.0.0.1:{outer.port}/elsewhere")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def server() -> Iterator[Server]:
    with closing(Server()) as one:
        yield one


@contextmanager
def hooked(address: str) -> Iterator[tuple[Hook, list[str]]]:
    said: list[str] = []
    hook = Hook(address, said.append, pause_s=0.01)
    try:
        yield hook, said
    finally:
        hook.close()


def test_an_alert_of_the_daemon_reaches_a_web_server(server: Server) -> None:
    with hooked(f"http://127.0.0.1:{server.port}/alerts") as (hook, said):
        settings = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
        vehicle = MadeVehicle(1, Autopilot.GENERIC)
        bench = Bench(settings, baseline_for(), vehicles=[vehicle], hooks=(hook,))
        bench.run(8.0)
        assert server.bodies == []  # the journal's other lines are not for hooks
        vehicle.turning = 1.5
        bench.run(4.0)
        bench.close()
        wait_for(lambda: len(server.bodies) >= 3)
    lines = [json.loads(body) for body in server.bodies]
    assert {"opened", "text"} <= {line["kind"] for line in lines}
    assert {line["vehicle"] for line in lines} == {1}
    assert server.kinds == {"application/json"}
    assert (hook.lost, said) == (0, [])


def test_a_failing_server_is_tried_again_and_a_redirect_is_no_delivery(server: Server) -> None:
    server.statuses += [500, 302]
    with hooked(f"http://127.0.0.1:{server.port}/") as (hook, _):
        hook.write('{"kind": "text"}', urgent=True)
        wait_for(lambda: len(server.bodies) == 3)
    assert server.bodies == [b'{"kind": "text"}'] * 3
    assert hook.lost == 0


@pytest.mark.parametrize("scheme", ["http", "mqtt"])
def test_a_server_that_speaks_another_language_is_told_and_the_next_line_is_tried(scheme: str) -> None:
    def answer() -> None:
        while True:
            try:
                connection, _ = other.accept()
            except OSError:
                return
            with connection:
                connection.recv(4096)
                connection.sendall(b"no such protocol\r\n" * 4)

    with socket.create_server(("127.0.0.1", 0)) as other:
        threading.Thread(target=answer, daemon=True).start()
        with hooked(f"{scheme}://127.0.0.1:{other.getsockname()[1]}/alerts") as (hook, said):
            for number in (1, 2):
                hook.write("{}", urgent=True)
                deadline = time.monotonic() + 4 * WAIT_S
                while hook.lost < number:
                    assert time.monotonic() < deadline
                    time.sleep(0.01)
            hook.flush()
        other.shutdown(socket.SHUT_RDWR)
    assert len(said) == 1
    assert "not delivered" in said[0]


def test_nothing_waits_for_a_slow_program_and_what_the_queue_cannot_hold_is_told(tmp_path: Path) -> None:
    slow = tmp_path / "slow.py"
    slow.write_text("import time; time.sleep(5)\n")
    with hooked(f"exec:{sys.executable} {slow}") as (hook, said):
        for _ in range(QUEUED + 50):
            hook.write("{}", urgent=True)  # comes back though no line was taken
        assert 48 <= hook.lost <= 50  # one or two may be in the program's hands
        hook.flush()
        assert f"{QUEUED} lines wait" in said[0]
    assert hook.lost == QUEUED + 50
    assert "were not delivered" in said[-1]


def test_a_program_gets_each_line_on_its_standard_input(tmp_path: Path) -> None:
    target, program = tmp_path / "lines", tmp_path / "append.py"
    program.write_text("import sys; open(sys.argv[1], 'a').write(sys.stdin.read() + '\\n')\n")
    with hooked(f"exec:{sys.executable} {program} {target}") as (hook, said):
        for number in range(3):
            hook.write(json.dumps({"number": number}), urgent=True)
        wait_for(lambda: target.exists() and len(target.read_text().splitlines()) == 3)
    assert [json.loads(line)["number"] for line in target.read_text().splitlines()] == [0, 1, 2]
    assert (hook.lost, said) == (0, [])


@pytest.mark.skipif(BROKER is None, reason="there is no Mosquitto broker on this machine")
def test_a_broker_gets_each_line(tmp_path: Path) -> None:
    from paho.mqtt.client import Client, MQTTMessage
    from paho.mqtt.enums import CallbackAPIVersion

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    config = tmp_path / "broker.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    assert BROKER is not None
    broker = subprocess.Popen([BROKER, "-c", str(config)], stderr=subprocess.DEVNULL)
    got: list[bytes] = []
    listener = Client(CallbackAPIVersion.VERSION2)

    def keep(_client: Client, _data: object, message: MQTTMessage) -> None:
        got.append(bytes(message.payload))

    def listens() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    try:
        wait_for(listens)
        listener.on_message = keep
        listener.connect("127.0.0.1", port)
        ready = threading.Event()
        listener.on_subscribe = lambda *_: ready.set()
        listener.subscribe("vehicles/#", qos=1)
        listener.loop_start()
        assert ready.wait(WAIT_S)
        with hooked(f"mqtt://127.0.0.1:{port}/vehicles/propellers") as (hook, _):
            hook.write('{"kind": "opened"}', urgent=True)
            wait_for(lambda: got)
        assert got == [b'{"kind": "opened"}']
        assert hook.lost == 0
    finally:
        listener.loop_stop()
        broker.terminate()
        broker.wait(WAIT_S)
