"""Attacks on a running detector beside a genuine emulated stream, over loopback.

    python benchmarks/attacks.py [--seconds 16] [--rate 200] [--only NAME]...

Each row is a run of its own: the daemon, one emulated vehicle that flies healthy for so long, and an attacker, from the
fourth second on. He sends from another address; or (`beside`) from the vehicle's own address and with its running
numbers, through a relay between both; or (`tcpin`) as further clients of the daemon's server. `judged` is the flight
time that the daemon judged, of the time flown, and `share` is that of what the row "nothing" of its link has: the first
seconds always go to watching and measuring the new vehicle. At least 0.9 is demanded. `told` says whether the daemon
says, in its log or its summary, that frames or connections were refused. `ended` is the time from SIGTERM, sent while
the attack goes on, to the end of the process; 10 s are allowed. Seed 8.

A row takes its --seconds and the start of three processes. One whose vehicle does not fly `COMPILE_S` after its start,
or that is not done `SPARE_S` after its --seconds, has its processes killed and is printed as NOT DONE. `--only` runs
these rows and "nothing" of their links.
"""

import argparse
import contextlib
import fcntl
import itertools
import json
import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from fastcrc.crc16 import mcrf4xx

from mavdiag.airframe.load import airframe_named
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.codec import Encoder
from mavdiag.link.keys import read_key
from mavdiag.link.messages import MessageId, Severity
from mavdiag.link.signing import STALE, Signing, stamp_at
from mavdiag.logs.tlog import read_tlog

SPARE_S = 40.0  # for the start of the daemon, and for the end of all processes
COMPILE_S = 120.0  # for the start of the vehicle, which is compiled first
START_S = 4.0  # from the vehicle's first message to the attacker's
FLOOD = 300_000
HEARTBEAT = (2, 3, 128, 0, 4, 3)
SEED = 8


@dataclass(frozen=True)
class Attack:
    """One row.

    frames: what is sent, without end.
    rate_hz: how fast; None for as fast as it goes.
    signed: the link.
    told: a pattern of what the daemon says of it; None if nothing is to be said.
    beside: what is sent after this genuine frame, from the vehicle's own address.
    copied: genuine frames are sent from another port first, and delivered 30 ms later.
    clients: bytes that so many clients of a TCP server send, over and over; empty to stay idle.
    early: a made-up vehicle enters before the genuine one.
    options: of the daemon, from a folder of the row's own and a free port.
    work: done from the attack's begin until `stop`, with that folder and port; returns what was heard.
    """

    name: str
    frames: Callable[[Path, Path], Iterator[bytes]] = lambda log, key: iter(())
    rate_hz: float | None = None
    signed: bool = False
    told: str | None = None
    beside: Callable[[bytes, float], bytes] | None = None
    copied: bool = False
    clients: tuple[int, bytes] | None = None
    early: bool = False
    options: Callable[[Path, int], list[str]] = lambda folder, port: []
    work: Callable[[Path, int, threading.Event], str] | None = None

    @property
    def link(self) -> str:
        """The row to compare with."""
        return "tcpin" if self.clients else "signed" if self.signed else "udpin"


def recorded(log: Path) -> list[bytes]:
    """The frames of a .tlog, one after the other."""
    data, at, found = log.read_bytes(), 8, []
    while at + 3 < len(data):
        length = data[at + 1] + (25 if data[at + 2] & 1 else 12)
        found.append(data[at : at + length])
        at += length + 8
    return found


def replayed(log: Path, key: Path) -> Iterator[bytes]:
    """An old flight of the same vehicle, again and again."""
    return itertools.cycle(recorded(log))


def random_frames(log: Path, key: Path) -> Iterator[bytes]:
    """Any message of any sender with any content, and a good checksum."""
    rng = np.random.default_rng(SEED)
    messages = list(dialect.mavlink_map.values())
    while True:
        message = messages[int(rng.integers(len(messages)))]
        yield framed(message, rng.bytes(message.unpacker.size), *rng.integers(0, 256, 3).tolist())


def as_the_vehicle(log: Path, key: Path) -> Iterator[bytes]:
    """Random frames, all in the name of the vehicle that is watched."""
    for frame in random_frames(log, key):
        message = dialect.mavlink_map[int.from_bytes(frame[7:10], "little")]
        yield framed(message, frame[10:-2], frame[4], 1, 1)


def framed(message: type[dialect.MAVLink_message], payload: bytes, seq: int, sysid: int, compid: int) -> bytes:
    """One MAVLink 2 frame."""
    head = struct.pack("<BBBBBBHB", len(payload), 0, 0, seq, sysid, compid, message.id & 0xFFFF, message.id >> 16)
    return b"\xfd" + head + payload + mcrf4xx(bytes([message.crc_extra]), mcrf4xx(head + payload)).to_bytes(2, "little")


def made_up(log: Path, key: Path) -> Iterator[bytes]:
    """A heartbeat of every system and component id there is, over and over."""
    senders = itertools.product(range(1, 256), range(1, 256))
    frames = [Encoder(sysid, compid).encode(MessageId.HEARTBEAT, *HEARTBEAT) for sysid, compid in senders]
    return itertools.cycle(frames)


def vehicles(log: Path, key: Path) -> Iterator[bytes]:
    """255 whole vehicles, each with heartbeats and both streams."""
    encoders = [Encoder(sysid, 1) for sysid in range(2, 256)]
    for k in itertools.count():
        for encoder in encoders:
            yield encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT)
            yield encoder.encode(MessageId.ATTITUDE_TARGET, 5 * k, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5)
            yield encoder.encode(MessageId.RAW_IMU, 5000 * k, 0, 0, -1000, 1, 2, 3)


def unknown(log: Path, key: Path) -> Iterator[bytes]:
    """Every message id outside of the dialect."""
    for msgid in itertools.cycle(range(20_000, 1 << 24)):
        yield b"\xfd" + struct.pack("<BBBBBBHB", 9, 0, 0, msgid & 0xFF, 9, 1, msgid & 0xFFFF, msgid >> 16) + bytes(11)


def flood(log: Path, key: Path) -> Iterator[bytes]:
    """So many datagrams of one stranger, as fast as they go."""
    frame = Encoder(77, 1).encode(MessageId.ATTITUDE, 1)
    return itertools.repeat(frame, FLOOD)


def large(log: Path, key: Path) -> Iterator[bytes]:
    """Datagrams of 60 kB: markers without a frame, and the shortest frames there are."""
    short = framed(dialect.mavlink_map[0], b"\0", 0, 5, 1)
    return itertools.cycle([b"\xfd" * 60_000, short * (60_000 // len(short))])


def forged(log: Path, key: Path) -> Iterator[bytes]:
    """The vehicle's frames, signed with another key and a stamp far ahead."""
    encoder = Encoder(1, 1, Signing(b"x" * 32, stamp=(1 << 48) - (1 << 30)))
    while True:
        yield encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT)


def stale(log: Path, key: Path) -> Iterator[bytes]:
    """Signed with the right key an hour ago, of a companion that is not heard now."""
    signing = Signing(read_key(key), link_id=9, stamp=stamp_at(time.time_ns()) - 60 * STALE)
    encoder = Encoder(1, 100, signing)
    while True:
        yield encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT)


def overheard(log: Path, key: Path) -> Iterator[bytes]:
    """Signed with the right key a moment ago, and sent over and over."""
    encoder = Encoder(1, 1, Signing(read_key(key), link_id=8, stamp=stamp_at(time.time_ns())))
    return itertools.cycle([encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT) for _ in range(100)])


def numbered(genuine: bytes, msgid: int, *fields: Any) -> bytes:
    """A frame in the vehicle's name with the running number behind a genuine one."""
    encoder = Encoder(1, 1)
    encoder._seq = (genuine[4] + 1) & 0xFF  # noqa: SLF001
    return encoder.encode(msgid, *fields)


class Forger:
    """Sends something after genuine frames of one message, so many times a second; its stamps go on with theirs."""

    def __init__(self, rate_hz: float, msgid: int, ahead_s: float = 0.0, number: int = 1, once: bool = False) -> None:
        self._every_s, self._msgid, self._ahead_s = 1.0 / rate_hz, msgid, ahead_s
        self._due_s, self._number, self._once = 0.0, number, once
        self._stamp_us = 0

    def __call__(self, genuine: bytes, now_s: float) -> bytes:
        """What is sent after a genuine frame; empty for nothing."""
        if int.from_bytes(genuine[7:10], "little") == MessageId.RAW_IMU:
            self._stamp_us = int.from_bytes(genuine[10:18], "little")
        if now_s < self._due_s or not self._stamp_us:
            return b""
        self._due_s = float("inf") if self._once else max(self._due_s + self._every_s, now_s)
        stamp_us = self._stamp_us + round(1e6 * self._ahead_s)
        before = genuine[:4] + bytes([(genuine[4] + self._number - 1) & 0xFF])
        if self._msgid == MessageId.RAW_IMU:
            return numbered(before, self._msgid, stamp_us, 0, 0, -1000, 1, 2, 3)
        if self._msgid == MessageId.HEARTBEAT:
            return numbered(before, self._msgid, 2, 3, 0, 0, 4, 3)
        return numbered(before, self._msgid, stamp_us // 1000, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.0)


def leaping(rate_hz: float, ahead_s: float, number: int = 20, once: bool = False) -> Forger:
    """Gyro samples with stamps ahead."""
    return Forger(rate_hz, MessageId.RAW_IMU, ahead_s, number, once)


def our_own_name(log: Path, key: Path) -> Iterator[bytes]:
    """Texts of the detector itself."""
    encoder = Encoder(1, 191)
    while True:
        yield encoder.statustext(Severity.CRITICAL, "PROP FAULT motor 3")


def commands(log: Path, key: Path) -> Iterator[bytes]:
    """Commands to the detector of 40 ground stations."""
    encoders = [Encoder(sysid, 190) for sysid in range(200, 240)]
    for encoder in itertools.cycle(encoders):
        yield encoder.encode(MessageId.COMMAND_LONG, 1, 191, 400)


def garbage(log: Path, key: Path) -> Iterator[bytes]:
    """Bytes without any frame."""
    return itertools.repeat(b"GET / HTTP/1.1\r\n\r\n" * 2)


def second_daemon(folder: Path, port: int, stop: threading.Event) -> str:
    """A daemon that is told to write the same journal; what it says."""
    command = [sys.executable, "-m", "detector", "--connect", "udpin:127.0.0.1:0", "--learn", "30"]
    found = subprocess.run([*command, "--journal", str(folder / "j.jsonl")], capture_output=True, text=True, timeout=30)
    return f"second daemon: exit code {found.returncode}, {found.stderr.strip()}"


def unread_pipe(folder: Path, port: int) -> list[str]:
    """A recording to a pipe of 4 KiB; it has a reader, who reads nothing."""
    pipe = folder / "pipe.tlog"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # until the benchmark ends
    fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, 4096)
    return ["--record", str(pipe)]


def metrics_flood(folder: Path, port: int, stop: threading.Event) -> str:
    """Requests for the figures one after the other, beside 40 connections that begin one and never end it."""
    idle, answers = list[socket.socket](), 0
    while not stop.is_set():
        with contextlib.suppress(OSError):
            if len(idle) < 40:
                idle.append(socket.create_connection(("127.0.0.1", port), 1.0))
                idle[-1].sendall(b"GET /metrics HTTP/1.1\r\n")
            with socket.create_connection(("127.0.0.1", port), 1.0) as link:
                link.sendall(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n")
                while part := link.recv(65_536):
                    answers += part.startswith(b"HTTP/1.")
    for one in idle:
        one.close()
    return f"{answers} requests answered"


ELSEWHERE, LEAPS, CLASHES = "sends in the name of vehicle 1", "whose stamps leap", "with the number of another frame"
LEAPS_OR_CLASHES = f"{LEAPS}|{CLASHES}"  # the genuine frame of the forged one's number comes in the same look, or later
NOT_NEWER = "not above the stream's last"
ATTACKS = (
    Attack("nothing"),
    Attack("replay of an old flight", replayed, 4000.0, told=ELSEWHERE),
    Attack("random frames, any sender", random_frames, 4000.0),
    Attack("random frames as the vehicle", as_the_vehicle, 4000.0, told=ELSEWHERE),
    Attack("65,025 made-up senders", made_up, told=ELSEWHERE),
    Attack("255 made-up vehicles", vehicles, 15_000.0),
    Attack("unknown message ids", unknown),
    Attack("flood of 300,000 datagrams", flood),
    Attack("datagrams of 60 kB", large, 2000.0),
    Attack("O garbage after a made-up vehicle", garbage, early=True),
    Attack("A frames in our own name", our_own_name, 100.0, told="in our own name 1/191"),
    Attack("Q commands of 40 strangers", commands, 50.0),
    Attack("L gyro 1/s stamped 1 h ahead", beside=leaping(1.0, 3600.0, 1), told=CLASHES),
    Attack("L same, other running numbers", beside=leaping(1.0, 3600.0), told=LEAPS),
    Attack("L gyro 10/s stamped 0.3 s ahead", beside=leaping(10.0, 0.3), told=LEAPS),
    Attack("L one frame stamped 10 s ahead", beside=leaping(1.0, 10.0, once=True), told=LEAPS_OR_CLASHES),
    Attack("L one frame stamped 25 s ahead", beside=leaping(1.0, 25.0, once=True), told=LEAPS_OR_CLASHES),
    Attack("L one frame stamped 120 s ahead", beside=leaping(1.0, 120.0, once=True), told=LEAPS_OR_CLASHES),
    Attack("L disarmed heartbeats 3/s", beside=Forger(3.0, MessageId.HEARTBEAT), told=CLASHES),
    Attack("L thrust 0 at 50 Hz", beside=Forger(50.0, MessageId.ATTITUDE_TARGET), told=CLASHES),
    Attack("signed: nothing", signed=True),
    Attack("signed: forged, stamp far ahead", forged, 4000.0, signed=True, told="signature wrong"),
    Attack("signed: replayed", overheard, 4000.0, signed=True, told=ELSEWHERE),
    Attack("signed: replayed beside", signed=True, beside=lambda genuine, now_s: genuine, told=NOT_NEWER),
    Attack("signed: stale", stale, 4000.0, signed=True, told="over a minute old"),
    Attack("signed: downgraded (not signed)", replayed, 4000.0, signed=True, told="unsigned"),
    Attack("F signed: copies come first", signed=True, copied=True, told=ELSEWHERE),
    Attack("tcpin: nothing", clients=(0, b"")),
    Attack("G1 tcpin: 16 idle strangers first", clients=(16, b""), early=True, told="connections were turned away"),
    Attack(
        "G2 tcpin: 15 clients, random bytes",
        clients=(15, np.random.default_rng(SEED).bytes(1 << 16)),
        told="connections were turned away",
    ),
    Attack("G2 tcpin: 15 clients, markers", clients=(15, b"\xfd" * (1 << 16)), told="connections were turned away"),
    Attack(
        "J a second daemon on one journal",
        options=lambda folder, port: ["--journal", str(folder / "j.jsonl")],
        work=second_daemon,
        told="exit code 2",
    ),
    Attack("J a recording to an unread pipe", options=unread_pipe, told="entries lost to the"),
    Attack(
        "M flood of requests for the figures",
        options=lambda folder, port: ["--metrics", f"127.0.0.1:{port}"],
        work=metrics_flood,
        told="requests answered",
    ),
)


def send(frames: Iterator[bytes], port: int, rate_hz: float | None, stop: threading.Event) -> int:
    """Send until told to stop; returns how many datagrams went out."""
    tried, sent, began = 0, 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        for frame in frames:
            if stop.is_set():
                break
            tried += 1
            with contextlib.suppress(OSError):
                link.send(frame)
                sent += 1
            if rate_hz is not None and tried % 20 == 0:
                time.sleep(max(0.0, began + tried / rate_hz - time.monotonic()))
    return sent


class Between:
    """A relay between vehicle and daemon: one address for the genuine frames and the forged ones."""

    def __init__(self, attack: Attack, port: int, stop: threading.Event) -> None:
        self._attack, self._stop, self._begin_s, self.sent = attack, stop, time.monotonic() + START_S, 0
        self._near, self._far, self._other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3))
        self._near.bind(("127.0.0.1", 0))
        self.port = self._near.getsockname()[1]
        for one in (self._far, self._other):
            one.connect(("127.0.0.1", port))
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        waiting: list[tuple[float, bytes]] = []
        vehicle = None
        while not self._stop.is_set():
            ready, _, _ = select.select([self._near, self._far], [], [], 0.005)
            now_s = time.monotonic()
            if self._near in ready:
                data, vehicle = self._near.recvfrom(65_535)
                if self._attack.copied and now_s > self._begin_s:
                    self._send(self._other, data)
                    self.sent += 1
                waiting.append((now_s + 0.03 * self._attack.copied, data))
            if self._far in ready and vehicle is not None:
                with contextlib.suppress(OSError):
                    self._near.sendto(self._far.recv(65_535), vehicle)
            while waiting and waiting[0][0] <= now_s:
                _, data = waiting.pop(0)
                self._send(self._far, data)
                if (
                    self._attack.beside is not None
                    and now_s > self._begin_s
                    and (extra := self._attack.beside(data, now_s))
                ):
                    self._send(self._far, extra)
                    self.sent += 1

    def _send(self, link: socket.socket, data: bytes) -> None:
        with contextlib.suppress(OSError):
            link.send(data)

    def close(self) -> None:
        """Wait for its end, once `stop` is set."""
        self._thread.join()
        for one in (self._near, self._far, self._other):
            one.close()


def crowd(port: int, content: bytes, stop: threading.Event) -> int:
    """One client that sends this over and over, and comes again when it is hung up on; how many times it came."""
    times = 0
    while not stop.is_set():
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0) as link:
            times += 1
            link.settimeout(0.2)
            while not stop.is_set():
                with contextlib.suppress(TimeoutError):
                    if content:
                        link.send(content)
                    elif not link.recv(4096):
                        break
        stop.wait(0.02)
    return times


def lone_vehicle(port: int, stop: threading.Event) -> None:
    """A made-up vehicle that behaves as one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        encoder = Encoder(9, 1)
        for k in itertools.count():
            if stop.wait(0.01):
                return
            with contextlib.suppress(OSError):
                if k % 100 == 0:
                    link.send(encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT))
                link.send(encoder.encode(MessageId.ATTITUDE_TARGET, 10 * k, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.5))
                link.send(encoder.encode(MessageId.RAW_IMU, 10_000 * k, 0, 0, -1000, 1, 2, 3))


def free_port() -> int:
    """A port of loopback that nobody has."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextlib.contextmanager
def process(*command: str, said: Path) -> Iterator[subprocess.Popen[str]]:
    """A module of Python at work, killed at the end of the block. said: where its errors go."""
    with said.open("w") as errors:
        one = subprocess.Popen([sys.executable, "-m", *command], stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        yield one
    finally:
        one.kill()
        one.wait()


@contextlib.contextmanager
def within(limit_s: float, *processes: subprocess.Popen[str]) -> Iterator[None]:
    """Kill these processes if the block takes longer."""

    def end_all() -> None:
        for one in processes:
            one.kill()

    bound = threading.Timer(limit_s, end_all)
    bound.start()
    try:
        yield
    finally:
        bound.cancel()


def first_line(said: Path, limit_s: float) -> str:
    """What a process said first. Raises TimeoutError if it says nothing."""
    until = time.monotonic() + limit_s
    while "\n" not in (text := said.read_text()):
        if time.monotonic() > until:
            raise TimeoutError("the daemon did not start")
        time.sleep(0.05)
    return text.splitlines()[0]


class Attackers:
    """The threads of a row. heard: what they heard; sent: how much each of them sent."""

    def __init__(self, attack: Attack, port: int, files: tuple[Path, Path], work: tuple[Path, int]) -> None:
        self.stop, self.sent, self.heard = threading.Event(), list[int](), list[str]()
        self.between = Between(attack, port, self.stop) if attack.beside or attack.copied else None
        stop, client = self.stop, attack.clients
        if client is not None:
            tasks = [lambda: self.sent.append(crowd(port, client[1], stop))] * client[0]
        else:
            tasks = [lambda: self.sent.append(send(attack.frames(*files), port, attack.rate_hz, stop))]
        if (job := attack.work) is not None:
            tasks.append(lambda: self.heard.append(job(*work, stop)))
        self._later = [threading.Thread(target=one) for one in tasks]
        self._begun: list[threading.Thread] = []
        if attack.early and client is not None:
            self.begin()
        elif attack.early:
            self._begun = [threading.Thread(target=lone_vehicle, args=(port, stop))]
            self._begun[0].start()

    def begin(self) -> None:
        """All that have not begun."""
        for one in self._later:
            one.start()
        self._begun, self._later = [*self._begun, *self._later], []

    def end(self) -> None:
        """Stop them all."""
        self.stop.set()
        for one in self._begun:
            one.join()
        if self.between is not None:
            self.between.close()
            self.sent.append(self.between.sent)
            self.between = None


def run(attack: Attack, files: tuple[Path, Path, Path], seconds: float, rate: int, calm: dict[str, float]) -> str:
    """One row of the table. files: baseline, old flight, key. calm: share judged without attack, by link."""
    baseline, log, key = files
    signing = ["--signing-key", str(key)] if attack.signed else []
    kind, figures_port = "tcpin" if attack.clients else "udpin", free_port()
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        options = ["--baseline", str(baseline), *signing, *attack.options(folder, figures_port)]
        address = f"{kind}:127.0.0.1:0"
        detector = stack.enter_context(process("detector", "--connect", address, *options, said=folder / "said"))
        port = int(re.findall(r"\d+", first_line(folder / "said", SPARE_S).split(",")[0])[-1])
        attackers = Attackers(attack, port, (log, key), (folder, figures_port))
        stack.callback(attackers.end)
        time.sleep(3.0 * attack.early)
        near = attackers.between.port if attackers.between else port
        out = f"tcp:127.0.0.1:{port}" if attack.clients else f"udpout:127.0.0.1:{near}"
        command = ("sitl_plant", "run", "--out", out, "--rate", str(rate), "--json", *signing)
        plant = stack.enter_context(process(*command, said=folder / "plant"))
        assert plant.stdout is not None
        with within(COMPILE_S, plant):
            flies = bool(plant.stdout.readline())
        if not flies:
            return f"{attack.name:36} NOT DONE: the vehicle did not start in {COMPILE_S:g} s"
        stack.enter_context(within(seconds + SPARE_S, plant, detector))
        time.sleep(START_S)
        attackers.begin()
        time.sleep(seconds - START_S)
        told = time.monotonic()
        detector.send_signal(signal.SIGTERM)
        code = detector.wait()
        ended_s = time.monotonic() - told
        plant.terminate()
        landed = plant.communicate()[0].splitlines()
        attackers.end()
        if code or plant.returncode < 0 or not landed:
            return f"{attack.name:36} NOT DONE: exit codes {code} and {plant.returncode}, ended in {ended_s:.2f} s"
        lines = [*attackers.heard, *(folder / "said").read_text().splitlines()]
        flown_s = json.loads(landed[-1])["flown_s"]
        return row(attack, lines, sum(attackers.sent), flown_s - ended_s, ended_s, calm)


def row(attack: Attack, lines: list[str], sent: int, flown_s: float, ended_s: float, calm: dict[str, float]) -> str:
    """The daemon's own summary, and what it said, in one line."""
    summary, text = lines[-1], "\n".join(lines)
    own = re.search(r"vehicle 1 (\w+), (\d+) frames, (\d+) lost on the way, ([\d.]+) s judged, (\d+) events", summary)
    state, lost, judged_s, events = (own[1], own[3], float(own[4]), own[5]) if own else ("absent", "-", 0.0, "-")
    share = judged_s / flown_s / calm.setdefault(attack.link, judged_s / flown_s) if judged_s else 0.0
    others = len(set(re.findall(r"vehicle (\d+): received", text)) - {"1"})
    reboots = text.count("rebooted")
    overflowed = re.search(r"(\d+) datagrams overflowed", summary)
    told = "-" if attack.told is None else "yes" if re.search(attack.told, text) else "NO"
    return (
        f"{attack.name:36} {sent:8} {told:>4} {share:5.2f} {judged_s:5.1f}/{flown_s:4.1f} {ended_s:5.2f} {lost:>5} "
        f"{events:>3} {reboots:3} {others:4} {overflowed[1] if overflowed else '-':>8} {state}"
    )


def main() -> None:
    """Run the attacks and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=16.0)
    parser.add_argument("--rate", type=int, default=200)
    parser.add_argument("--only", action="append", help="Rows whose name has this in it.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        baseline, log, key = folder / "baseline.json", folder / "old.tlog", folder / "key"
        key.write_text("correct horse battery staple\n")
        key.chmod(0o600)
        record = [sys.executable, "-m", "sitl_plant", "record", "-o", str(log), "--duration", "30"]
        subprocess.run([*record, "--rate", str(options.rate)], check=True, capture_output=True)
        known = LearnOptions(airframe=airframe_named("qdrone2"))
        learn([read_tlog(log)], known, created="2026-01-01T00:00:00Z").save(baseline)
        print(
            f"{'attack':36} {'sent':>8} {'told':>4} {'share':>5} {'judged/s':>10} {'ended':>5} {'lost':>5} {'ev':>3} "
            f"{'reb':>3} {'made':>4} {'overflow':>8} state"
        )
        calm: dict[str, float] = {}
        asked = [one for one in ATTACKS if not options.only or any(part in one.name for part in options.only)]
        links = {one.link for one in asked}
        for attack in ATTACKS:
            if attack in asked or ("nothing" in attack.name and attack.link in links):
                print(run(attack, (baseline, log, key), options.seconds, options.rate, calm), flush=True)


if __name__ == "__main__":
    main()
