"""Attacks on a running detector beside a genuine emulated stream, over UDP loopback.

    python benchmarks/attacks.py [--seconds 12] [--rate 200] [--only NAME]...

Each row is a run of its own: the daemon, one emulated vehicle that flies healthy for so long, and an attacker that
sends from another address, from the fourth second on. `judged` is the flight time that the daemon judged, of the time
flown; the first seconds always go to watching and measuring the new vehicle, so the row "nothing" is what to compare
with. `ended` is the time from SIGTERM, sent while the attack goes on, to the end of the process.
"""

import argparse
import itertools
import json
import re
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

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
from fastcrc.crc16 import mcrf4xx

from mavdiag.airframe.load import airframe_named
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.codec import Encoder
from mavdiag.link.keys import read_key
from mavdiag.link.messages import MessageId
from mavdiag.link.signing import STALE, Signing, stamp_at
from mavdiag.logs.tlog import read_tlog

START_S = 4.0  # from the vehicle's first message to the attacker's
FLOOD = 300_000
HEARTBEAT = (2, 3, 128, 0, 4, 3)
SEED = 8


@dataclass(frozen=True)
class Attack:
    """One row. frames: what is sent, without end. rate_hz: how fast; None for as fast as it goes. signed: the link."""

    name: str
    frames: Callable[[Path, Path], Iterator[bytes]]
    rate_hz: float | None = None
    signed: bool = False


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
    """Signed with the right key, on a link of its own, an hour ago."""
    signing = Signing(read_key(key), link_id=9, stamp=stamp_at(time.time_ns()) - 60 * STALE)
    encoder = Encoder(1, 1, signing)
    while True:
        yield encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT)


def overheard(log: Path, key: Path) -> Iterator[bytes]:
    """Signed with the right key a moment ago, and sent over and over."""
    encoder = Encoder(1, 1, Signing(read_key(key), link_id=8, stamp=stamp_at(time.time_ns())))
    return itertools.cycle([encoder.encode(MessageId.HEARTBEAT, *HEARTBEAT) for _ in range(100)])


ATTACKS = (
    Attack("nothing", lambda log, key: iter(())),
    Attack("replay of an old flight", replayed, 4000.0),
    Attack("random frames, any sender", random_frames, 4000.0),
    Attack("random frames as the vehicle", as_the_vehicle, 4000.0),
    Attack("65,025 made-up senders", made_up),
    Attack("255 made-up vehicles", vehicles, 15_000.0),
    Attack("unknown message ids", unknown),
    Attack("flood of 300,000 datagrams", flood),
    Attack("datagrams of 60 kB", large, 2000.0),
    Attack("signed: nothing", lambda log, key: iter(()), signed=True),
    Attack("signed: forged, stamp far ahead", forged, 4000.0, signed=True),
    Attack("signed: replayed", overheard, 4000.0, signed=True),
    Attack("signed: stale", stale, 4000.0, signed=True),
    Attack("signed: downgraded (not signed)", replayed, 4000.0, signed=True),
)


def send(frames: Iterator[bytes], port: int, rate_hz: float | None, stop: threading.Event) -> int:
    """Send until told to stop; returns how many datagrams went out."""
    sent, began = 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        for frame in frames:
            if stop.is_set():
                break
            try:
                link.send(frame)
            except OSError:
                continue
            sent += 1
            if rate_hz is not None and sent % 20 == 0:
                time.sleep(max(0.0, began + sent / rate_hz - time.monotonic()))
    return sent


def run(attack: Attack, files: tuple[Path, Path, Path], seconds: float, rate: int) -> str:
    """One row of the table. files: baseline, old flight, key."""
    baseline, log, key = files
    signing = ["--signing-key", str(key)] if attack.signed else []
    detector = subprocess.Popen(
        [sys.executable, "-m", "detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(baseline), *signing],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert detector.stderr is not None
    port = int(re.findall(r"\d+", detector.stderr.readline().split(",")[0])[-1])
    out = ["--out", f"udpout:127.0.0.1:{port}", "--rate", str(rate), "--json", *signing]
    plant = subprocess.Popen(
        [sys.executable, "-m", "sitl_plant", "run", *out], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert plant.stdout is not None
    plant.stdout.readline()
    time.sleep(START_S)
    stop, sent = threading.Event(), list[int]()
    attacker = threading.Thread(target=lambda: sent.append(send(attack.frames(log, key), port, attack.rate_hz, stop)))
    attacker.start()
    time.sleep(seconds - START_S)
    told = time.monotonic()
    detector.send_signal(signal.SIGTERM)
    lines = detector.communicate(timeout=60.0)[1].splitlines()
    ended_s = time.monotonic() - told
    stop.set()
    attacker.join()
    plant.terminate()
    flown_s = json.loads(plant.communicate()[0].splitlines()[-1])["flown_s"]
    return row(attack, lines, sent[0], flown_s - ended_s, ended_s)


def row(attack: Attack, lines: list[str], sent: int, flown_s: float, ended_s: float) -> str:
    """The daemon's own summary, and what it said, in one line."""
    summary, text = lines[-1], "\n".join(lines)
    own = re.search(r"vehicle 1 (\w+), (\d+) frames, (\d+) lost on the way, ([\d.]+) s judged, (\d+) events", summary)
    state, lost, judged_s, events = (own[1], own[3], float(own[4]), own[5]) if own else ("absent", "-", 0.0, "-")
    others = len(set(re.findall(r"vehicle (\d+): received", text)) - {"1"})
    reboots = text.count("rebooted")
    overflowed = re.search(r"(\d+) datagrams overflowed", summary)
    refused = re.search(r"refused: ([^;]*)", summary)
    return (
        f"{attack.name:32} {sent:8} {judged_s:5.1f}/{flown_s:4.1f} {lost:>5} {events:>3} {reboots:3} {others:4} "
        f"{overflowed[1] if overflowed else '-':>8} {ended_s:5.2f} {state:10} {refused[1] if refused else ''}"
    )


def main() -> None:
    """Run the attacks and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=12.0)
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
            f"{'attack':32} {'sent':>8} {'judged/s':>10} {'lost':>5} {'ev':>3} {'reb':>3} {'made':>4} {'overflow':>8} "
            f"{'ended':>5} state      refused"
        )
        for attack in ATTACKS:
            if not options.only or any(part in attack.name for part in options.only):
                print(run(attack, (baseline, log, key), options.seconds, options.rate), flush=True)


if __name__ == "__main__":
    main()
