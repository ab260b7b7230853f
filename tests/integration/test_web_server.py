"""The live page's server as a process: what it refuses, what a reconnect gets, and how it lives and dies."""

import json
import re
import signal
import socket
import time

import pytest
from processes import ended, running
from web_page import Reader, asked, give, serving, wait_for

from detector.web.access import HEADERS
from detector.web.child import Place, ServerProcess
from detector.web.server import SERVICE
from mavdiag.telemetry import Instant

pytestmark = pytest.mark.realtime
LEARNING = ("--learn", "50", "--save", "b.json", "--connect", "udpin:127.0.0.1:0")
TOKEN = "a-token-of-24-characters"


def now() -> Instant:
    return Instant(time.monotonic_ns())


def test_every_answer_has_the_headers_and_nothing_is_loaded_from_elsewhere() -> None:
    with serving() as process:
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


def test_a_replay_is_moved_by_posts_and_nothing_else_is_taken() -> None:
    with serving() as process:
        port, said = process.place.port, list[str]()
        for query, status in (
            ("at=12.5", 202),
            ("speed=0", 202),
            ("at=nan", 400),
            ("at=-1", 400),
            ("to=3", 400),
            ("", 400),
        ):
            assert asked(port, f"/play?{query}", "POST").status == status, query
        assert asked(port, "/play?at=1").status == 405
        assert asked(port, "/play?at=1", "POST", Origin="http://evil.example").status == 403
        while len(said) < 2:
            said += process.look(now())[1]
        assert said == ["play at 12.5", "play speed 0.0"]


def test_wrong_hosts_origins_methods_and_tokens_are_refused() -> None:
    with serving() as process:
        port = process.place.port
        assert asked(port, "/stream", Host=f"evil.example:{port}").status == 403
        assert asked(port, "/stream", Origin="http://evil.example").status == 403
        assert asked(port, "/", "POST").status == 405
        assert asked(port, "/", "HEAD").status == 405
    with serving(TOKEN) as process:
        port = process.place.port
        assert asked(port).status == 401
        assert asked(port, "/stream").status == 401
        answer = asked(port, f"/?token={TOKEN}")
        assert (answer.status, answer.headers["Location"]) == (303, "./")
        cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert TOKEN not in cookie
        assert asked(port, Cookie=cookie.split(";")[0]).status == 200
        assert asked(port, Authorization=f"Bearer {TOKEN}").status == 200


def test_the_page_works_behind_a_proxy_under_a_prefix() -> None:
    """As nginx of BlueOS asks: HTTP/1.0, the browser's host without a port, and the prefix taken away."""
    with serving(host="0.0.0.0", names=("blueos.local",)) as process:
        port = process.place.port
        page = asked(port, Host="blueos.local").body
        assert not re.search(r"(href|src)=\"/", page)  # nothing leaves the prefix
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
        other_run = Reader(port, "?after=r0-99")
        other_run.until(lambda one: one.numbers[-1:] == [2100])
        assert other_run.numbers == list(range(1601, 2101))
        for reader in (again, by_query, other_run):
            reader.close()


def test_the_server_is_started_again_and_the_daemon_only_says_so() -> None:
    lines: list[str] = []
    process = ServerProcess(Place("127.0.0.1", 0, None), "r1", lines.append)
    process.start()
    try:
        port, killed = process.place.port, process._process
        assert killed is not None
        assert process.look(now())[0]
        killed.kill()
        wait_for(lambda: process.look(now())[0])
        wait_for(lambda: process.look(now()) and len(lines) == 2, "it says that it serves again")
        assert "its process ended (exit code -9); it is started again, the watch goes on" in lines[0]
        assert lines[1] == f"web page: http://127.0.0.1:{port}/ is served again"
        assert asked(port).status == 200
    finally:
        process.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_server_ends_with_the_daemon_whatever_ends_that(number: signal.Signals) -> None:
    with running(*LEARNING, "--web", "0") as (child, first):
        assert first.startswith("ready: ")
        assert child.stderr is not None
        line = child.stderr.readline()
        port = int(line.rsplit(":", 1)[1].strip("/\n"))
        assert asked(port).status == 200
        code, rest = ended(child, number)
    assert code == (0 if number != signal.SIGKILL else -9)
    assert "Traceback" not in rest

    def gone() -> bool:
        with socket.socket() as one:
            return one.connect_ex(("127.0.0.1", port)) != 0

    wait_for(gone)
