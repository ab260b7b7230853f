"""The process that serves the live page (edge): lines of the daemon on stdin, HTTP on a port, who looks on stdout.

    python -m detector.web.server      not for people: the daemon starts it

Its first line on stdin is a JSON object with host, port, token, names, niceness and run. It answers `listening PORT`,
or `refused REASON` and ends; later it says `watch VEHICLE ...` whenever that changes, `ack VEHICLE` and, for a replay,
`play at S` and `play speed X`. It ends when stdin does.
"""

import asyncio
import contextlib
import json
import logging
import os
import sys
from collections.abc import Awaitable, Callable
from dataclasses import replace
from math import isfinite
from pathlib import Path

from aiohttp import web
from aiohttp.http import HttpProcessingError

from detector.web.access import ACKNOWLEDGE, HEADERS, PLAY, POSTED, Access, Answer
from detector.web.board import Board, Reader, is_vehicle, parse_last
from mavdiag import __version__

PAGES = 32  # streams at a time
LINE_BYTES = 4_000_000  # of a line on stdin, at most
ALIVE_S = 5.0  # a comment after so much silence, so that a reader that is gone is noticed
STUCK_S = 20.0  # a reader that takes nothing for so long is given up
LAST_S = 0.1  # for the last entries to reach the pages
FILES = {
    "/": ("index.html", "text/html"),
    "/app.js": ("app.js", "text/javascript"),
    "/strips.js": ("strips.js", "text/javascript"),
    "/style.css": ("style.css", "text/css"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
#: How the page presents itself to BlueOS: what its menu shows, and that it works under a prefix, but in no frame.
SERVICE = {
    "name": "Propellers",
    "description": "Hears damaged propellers of a multirotor in its MAVLink stream.",
    "icon": "/icon.svg",
    "company": "mavdiag",
    "version": __version__,
    "webpage": "",
    "api": "",
    "new_page": True,
    "avoid_iframes": True,
    "works_in_relative_paths": True,
}
REFUSALS = {
    Answer.NO_TOKEN: "a token is needed: open /?token=TOKEN, the line in the detector's token file",
    Answer.REFUSED: "this request does not come from the page of this detector",
    Answer.NOT_A_GET: f"only GET, and POST to {' and '.join(POSTED)}",
}
#: nginx passes on what has this header without waiting for more.
STREAM = {"Content-Type": "text/event-stream; charset=utf-8", "X-Accel-Buffering": "no"}
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Server:
    """One port. access: the rules; with port 0 in them every request is refused."""

    def __init__(self, access: Access, board: Board) -> None:
        self.access, self._board, self._told = access, board, tuple[int, ...]()
        self._wake: dict[Reader, asyncio.Event] = {}
        folder = Path(__file__).with_name("page")
        self._files = {path: ((folder / name).read_bytes(), kind) for path, (name, kind) in FILES.items()}

    def application(self) -> web.Application:
        """The routes, behind the rules of access."""
        app = web.Application(middlewares=[self._guarded], client_max_size=0)
        for path in FILES:
            app.router.add_get(path, self._file, allow_head=False)
        app.router.add_get("/register_service", self._service, allow_head=False)
        app.router.add_get("/stream", self._stream, allow_head=False)
        app.router.add_post(ACKNOWLEDGE, self._acknowledge)
        app.router.add_post(PLAY, self._play)
        return app

    async def feed(self, lines: asyncio.StreamReader) -> None:
        """Take the daemon's lines until it ends."""
        while line := await lines.readline():
            self._board.take(line.decode().rstrip("\n"))
            for event in self._wake.values():
                event.set()

    def _answer(self, request: web.Request) -> Answer:
        headers = {name.lower(): value for name, value in request.headers.items()}
        if len(request.headers.getall("Host", [])) != 1:
            return Answer.REFUSED
        cookie, given = request.cookies.get(self.access.cookie), request.query.get("token")
        return self.access.judge(request.method, request.path, headers, cookie, given)

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        answer = self._answer(request)
        if answer is Answer.PASS:
            try:
                response = await handler(request)
            except web.HTTPException as error:
                response = _said(error.status, error.reason)
        elif answer is Answer.SIGN_IN:
            response = web.Response(status=answer, headers={"Location": "./"})
            cookie, value = self.access.cookie, self.access.cookie_value
            response.set_cookie(cookie, value, httponly=True, samesite="Strict", path="/")
        else:
            response = _said(answer, REFUSALS[answer])
            more = {Answer.NO_TOKEN: ("WWW-Authenticate", "Bearer")}
            more[Answer.NOT_A_GET] = ("Allow", "POST" if request.path in POSTED else "GET")
            response.headers.update([more[answer]] if answer in more else [])
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    async def _file(self, request: web.Request) -> web.Response:
        body, kind = self._files[request.path]
        return web.Response(body=body, content_type=kind, charset="utf-8")

    async def _service(self, request: web.Request) -> web.Response:
        return web.json_response(SERVICE)

    async def _acknowledge(self, request: web.Request) -> web.Response:
        vehicle = request.query.get("vehicle", "")
        if not is_vehicle(vehicle):
            raise web.HTTPBadRequest(reason="name a vehicle: ?vehicle=1")
        _to_daemon(f"ack {vehicle}")
        return _said(202, "handed to the detector")

    async def _play(self, request: web.Request) -> web.Response:
        command, figure = next(iter(request.query.items()), ("", ""))
        try:
            if not (command in ("at", "speed") and isfinite(value := float(figure)) and value >= 0):
                raise ValueError
        except ValueError:
            raise web.HTTPBadRequest(reason="say /play?at=SECONDS or /play?speed=TIMES, 0 to pause") from None
        _to_daemon(f"play {command} {value}")
        return _said(202, "handed to the replay")

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        if len(self._wake) >= PAGES:
            raise web.HTTPServiceUnavailable(reason=f"{PAGES} pages are open already")
        vehicle = request.query.get("vehicle", "")
        last = request.headers.get("Last-Event-ID") or request.query.get("after")
        response = web.StreamResponse(headers={**HEADERS, **STREAM})
        await response.prepare(request)
        reader = self._board.enter(int(vehicle) if is_vehicle(vehicle) else None, parse_last(last, self._board.run))
        self._wake[reader] = event = asyncio.Event()
        self._tell()
        try:
            await response.write(b"retry: 1000\n\n")
            while True:
                if not (data := reader.next()):
                    with contextlib.suppress(TimeoutError):
                        await asyncio.wait_for(event.wait(), ALIVE_S)
                    data = b"" if event.is_set() else b":\n\n"
                event.clear()
                if data:
                    await asyncio.wait_for(response.write(data), STUCK_S)
        except (ConnectionError, TimeoutError):
            return response
        finally:
            del self._wake[reader]
            self._board.readers.discard(reader)
            self._tell()

    def _tell(self) -> None:
        if (watched := self._board.watched) != self._told:
            self._told = watched
            _to_daemon(" ".join(("watch", *map(str, watched))))


def _said(status: int, text: str) -> web.Response:
    return web.Response(status=status, text=f"{text}\n")


def _to_daemon(line: str) -> None:
    with contextlib.suppress(OSError):  # the daemon is gone: stdin tells
        os.write(sys.stdout.fileno(), f"{line}\n".encode())


async def _serve() -> None:
    lines = asyncio.StreamReader(LINE_BYTES)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    told = json.loads(await lines.readline())
    os.nice(told["niceness"])
    errors = logging.getLogger("aiohttp.server")  # what is no HTTP is answered with 400, and no error of ours
    errors.addFilter(lambda said: not (said.exc_info and isinstance(said.exc_info[1], HttpProcessingError)))
    server = Server(Access(told["host"], 0, told["token"], tuple(told["names"])), Board(told["run"]))
    runner = web.AppRunner(server.application(), access_log=None, handler_cancellation=True, shutdown_timeout=0.2)
    await runner.setup()
    try:
        await web.TCPSite(runner, told["host"], told["port"]).start()
        port = int(runner.addresses[0][1])
        server.access = replace(server.access, port=port)
        _to_daemon(f"listening {port}")
        await server.feed(lines)
        await asyncio.sleep(LAST_S)
    except (OSError, UnicodeError) as error:
        _to_daemon(f"refused {getattr(error, 'strerror', '') or error}")
    finally:
        await runner.cleanup()


if __name__ == "__main__":
    with contextlib.suppress(ConnectionError, BrokenPipeError):
        asyncio.run(_serve())
