"""Servers: the live page's, and those to which hooks deliver every alert's line; what they refuse, how they fail."""

import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import pytest
from made_session import baseline_for
from made_vehicle import Bench, MadeVehicle
from processes import ended, running
from web_page import Reader, asked, give, serving, wait_for

from detector.config import Settings
from detector.hooks import QUEUED, STOP_S, Courier, Hook, close_all
from detector.web.access import HEADERS, Access
from detector.web.child import ServerProcess
from detector.web.server import SERVICE
from mavdiag.link.messages import Autopilot
from mavdiag.telemetry import Instant

pytestmark = pytest.mark.realtime
LEARNING = ("--learn", "50", "--save", "b.json", "--connect", "udpin:127.0.0.1:0")
TOKEN = "a-token-of-24-characters"


def now() -> Instant:
    return Instant(time.monotonic_ns())


@pytest.fixture(scope="module")
def process() -> Iterator[ServerProcess]:
    """A server that several tests only ask."""
    with serving() as one:
        yield one


def test_every_answer_has_the_headers_and_nothing_is_loaded_from_elsewhere(process: ServerProcess) -> None:
    port = process.place.port
    for path in ("/", "/app.js", "/strips.js", "/style.css", "/icon.svg", "/nothing", "/../server.py"):
        answer = asked(port, path)
        body = answer.body
        assert answer.status == (200 if path.count(".") < 2 and path != "/nothing" else 404), path
        assert {name: answer.headers[name] for name in HEADERS} == dict(HEADERS)
        assert "https://" not in body
        assert "http://" not in body.replace("http://www.w3.org/2000/svg", "")
    stream = asked(port, "/stream")
    assert {name: stream.headers[name] for name in HEADERS} == dict(HEADERS)


def test_a_replay_is_moved_by_posts_and_nothing_else_is_taken(process: ServerProcess) -> None:
    port, said = process.place.port, list[str]()
    refused = [(query, 400) for query in ("at=nan", "at=-1", "to=3", "")]
    for query, status in (("at=12.5", 202), ("speed=0", 202), *refused):
        assert asked(port, f"/play?{query}", "POST").status == status, query
    assert asked(port, "/play?at=1").status == 405
    assert asked(port, "/play?at=1", "POST", Origin="http://evil.example").status == 403
    while len(said) < 2:
        said += process.look(now())[1]
    assert said == ["play at 12.5", "play speed 0.0"]


def test_what_is_wrong_in_a_request_is_refused(process: ServerProcess, capfd: pytest.CaptureFixture[str]) -> None:
    port = process.place.port
    assert asked(port, "/stream", Host=f"evil.example:{port}").status == 403
    assert asked(port, "/stream", Origin="http://evil.example").status == 403
    assert (asked(port, "/", "POST").status, asked(port, "/", "HEAD").status) == (405, 405)
    with serving(TOKEN) as guarded:
        port = guarded.place.port
        assert [asked(port, path).status for path in ("/", "/stream", f"/{'a' * 9000}")] == [401, 401, 400]
        answer = asked(port, f"/?token={TOKEN}")
        assert (answer.status, answer.headers["Location"]) == (303, "./")
        cookie = answer.headers["Set-Cookie"]
        assert {"HttpOnly", "SameSite=Strict"} < set(cookie.split("; "))
        assert TOKEN not in cookie
        assert asked(port, Cookie=cookie.split(";")[0]).status == 200
        assert asked(port, Authorization=f"Bearer {TOKEN}").status == 200
        assert capfd.readouterr().err == ""  # whoever asks writes nothing among the detector's messages


def test_the_page_works_behind_a_proxy_under_a_prefix() -> None:
    """As nginx of BlueOS asks: HTTP/1.0, the browser's host without a port, and the prefix taken away."""
    with serving(host="0.0.0.0", names=("blueos.local",)) as process:
        port = process.place.port
        assert not re.search(r"(href|src)=\"/", asked(port, Host="blueos.local").body)  # nothing leaves the prefix
        assert not re.search(r"(EventSource|fetch)\(.\/", asked(port, "/app.js", Host="192.168.2.2").body)
        assert json.loads(asked(port, "/register_service", Host=f"127.0.0.1:{port}").body) == SERVICE
        assert asked(port, Host="evil.example").status == 403
        with socket.create_connection(("127.0.0.1", port), timeout=10) as proxy:
            proxy.sendall(b"GET /stream HTTP/1.0\r\nHost: blueos.local\r\n\r\n")
            answer = b""
            while b"hello" not in answer:
                answer += proxy.recv(4096)
        assert b"X-Accel-Buffering: no" in answer
        acknowledged = asked(port, "/acknowledge?vehicle=1", "POST", Host="blueos.local", Origin="http://blueos.local")
        assert acknowledged.status == 202


def test_a_reconnect_loses_nothing_and_gets_nothing_twice() -> None:
    with serving() as process:
        port = process.place.port
        give(process, *(f'J {k} {{"k":{k}}}' for k in range(1, 51)))
        first = Reader(port)
        first.until(lambda one: len(one.numbers) == 50)
        first.close()
        give(process, *(f'J {k} {{"k":{k}}}' for k in range(51, 2101)))
        last = f"r1-{first.numbers[-1]}"
        again = Reader(port, Last_Event_ID=last)
        again.until(lambda one: one.numbers[-1:] == [2100])
        assert again.numbers == list(range(51, 2101))
        by_query = Reader(port, f"?after={last}")
        by_query.until(lambda one: one.numbers[-1:] == [2100])
        assert by_query.numbers == again.numbers
        for reader in (again, by_query):
            reader.close()


def test_the_server_is_started_again_and_the_daemon_only_says_so() -> None:
    lines: list[str] = []
    process = ServerProcess(Access("127.0.0.1", 0, None), "r1", lines.append)
    process.start()
    try:
        port, killed = process.place.port, process._process
        assert killed is not None
        assert process.look(now())[0]
        killed.kill()
        wait_for(lambda: process.look(now())[0])
        wait_for(lambda: process.look(now()) and len(lines) == 2, "it says that it serves again")
        assert "its process ended (exit code -9); it is started again, the watch goes on" in lines[0]
        assert (lines[1], asked(port).status) == (f"web page: http://127.0.0.1:{port}/ is served again", 200)
    finally:
        process.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_server_ends_with_the_daemon_whatever_ends_that(number: signal.Signals) -> None:
    with running(*LEARNING, "--web", "0") as (child, first):
        assert first.startswith("ready: ")
        assert child.stderr is not None
        port = int(child.stderr.readline().rsplit(":", 1)[1].strip("/\n"))
        assert asked(port).status == 200
        code, rest = ended(child, number)
    assert code == (0 if number != signal.SIGKILL else -9)
    assert "Traceback" not in rest

    def gone() -> bool:
        with socket.socket() as one:
            return one.connect_ex(("127.0.0.1", port)) != 0

    wait_for(gone)


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
    with patch("detector.hooks.PAUSE_S", 0.01), closing(Hook(address, said.append)) as hook:
        yield hook, said


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
    assert ({line["vehicle"] for line in lines}, server.kinds) == ({1}, {"application/json"})
    assert (hook.lost, said) == (0, [])


def test_a_failing_server_is_tried_again_and_a_redirect_is_no_delivery(server: Server) -> None:
    server.statuses += [500, 302]
    with hooked(f"http://127.0.0.1:{server.port}/") as (hook, _):
        hook.write('{"kind": "text"}', urgent=True)
        wait_for(lambda: len(server.bodies) == 3)
    assert (server.bodies, hook.lost) == ([b'{"kind": "text"}'] * 3, 0)


@pytest.mark.parametrize(("scheme", "resets"), [("http", False), ("mqtt", False), ("mqtt", True)])
def test_a_server_that_speaks_another_language_is_told_and_the_next_line_is_tried(scheme: str, resets: bool) -> None:
    def answer() -> None:
        while True:
            try:
                connection, _ = other.accept()
            except OSError:
                return
            with connection:
                connection.recv(4096)
                if resets:  # SO_LINGER of 0 s
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                else:
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
    (slow := tmp_path / "slow.py").write_text("import time; time.sleep(5)\n")
    with hooked(f"exec:{sys.executable} {slow}") as (hook, said):
        for _ in range(QUEUED + 50):
            hook.write("{}", urgent=True)  # comes back though no line was taken
        assert 48 <= hook.lost <= 50  # one or two may be in the program's hands
        hook.flush()
        assert f"{QUEUED} lines wait" in said[0]
    assert hook.lost == QUEUED + 50
    assert "were not delivered" in said[-1]


def test_dead_hooks_hold_up_the_end_for_no_longer_than_one(monkeypatch: pytest.MonkeyPatch) -> None:
    dead = [Courier[bytes](f"hook {number}", lambda _: threading.Event().wait(), print) for number in range(4)]
    for hook in dead:
        hook.put(b"{}")
    at_s = [0.0]
    clock = SimpleNamespace(monotonic=lambda: at_s[-1], sleep=lambda s: at_s.append(at_s[-1] + s))
    monkeypatch.setattr("detector.hooks.time", clock)
    close_all(dead)
    assert ([hook.lost for hook in dead], round(at_s[-1], 1)) == ([1] * 4, STOP_S)


def test_a_program_gets_each_line_on_its_standard_input(tmp_path: Path) -> None:
    target, program = tmp_path / "lines", tmp_path / "append.py"
    program.write_text("import sys; open(sys.argv[1], 'a').write(sys.stdin.read())\n")
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
    (config := tmp_path / "broker.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
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
        assert (got, hook.lost) == ([b'{"kind": "opened"}'], 0)
    finally:
        listener.loop_stop()
        broker.terminate()
        broker.wait(WAIT_S)
