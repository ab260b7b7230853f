"""Many vehicles into one daemon: what it loses, what it costs, and by how much its verdicts come later.

    python benchmarks/many_vehicles.py [--vehicles 100] [--rate 200] [--seconds 20] [--faulty 5]

A process of its own replays frames that were encoded before, over UDP loopback: each vehicle with its system id, its
sequence numbers and its time since boot. Set-point and IMU come at `rate`, other messages at 10 Hz and below. The last
`--faulty` vehicles get a cracked propeller on rotor 1 at the middle of the flight. The daemon judges all of them by one
baseline of the type. Shares are of one core, by the system's own account; the bare loop in the same run only receives
the same datagrams.
"""

import argparse
import re
import socket
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from detector_load import cpu_s, free_port
from fastcrc.crc16 import mcrf4xx

from mavdiag.airframe.load import airframe_named
from mavdiag.learning import LearnOptions, learn
from mavdiag.link.messages import MessageId
from mavdiag.logs.tlog import read_tlog

SETTLE_S = 6.0  # until every vehicle has entered and is judged
BURST_S = 0.005
EVERY: dict[int, int] = {MessageId.SERVO_OUTPUT_RAW: 5, MessageId.ATTITUDE: 5}  # of 50 Hz
PAIR: dict[int, int] = {
    MessageId.ATTITUDE_TARGET: 1,
    MessageId.RAW_IMU: 1,
    MessageId.HEARTBEAT: 1,
    MessageId.SYS_STATUS: 1,
}
CLOCKS: dict[
    int, tuple[str, float]
] = {  # format of the time since boot at the start of the payload, and its ticks in a second
    MessageId.ATTITUDE_TARGET: ("<I", 1e3),
    MessageId.ATTITUDE: ("<I", 1e3),
    MessageId.RAW_IMU: ("<Q", 1e6),
    MessageId.SERVO_OUTPUT_RAW: ("<I", 1e6),
}
BARE = """
import socket, sys
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
link.bind(("127.0.0.1", int(sys.argv[1])))
while True:
    link.recv(2048)
"""


def record(path: Path, rate: int, seconds: float, *options: str) -> Path:
    """A flight of the emulator as a file."""
    plant = [sys.executable, "-m", "sitl_plant", "record", "-o", str(path), "--rate", str(rate)]
    subprocess.run([*plant, "--duration", str(seconds), *options], check=True, capture_output=True)
    return path


def frames_of(path: Path) -> list[tuple[float, int, bytes]]:
    """Time since the first [s], message and bytes of the frames to send."""
    data, at, seen = path.read_bytes(), 0, dict.fromkeys(EVERY, 0)
    found: list[tuple[float, int, bytes]] = []
    first_us = int.from_bytes(data[:8])
    while at < len(data):
        stop = at + 20 + data[at + 9]
        frame, at_s = data[at + 8 : stop], (int.from_bytes(data[at : at + 8]) - first_us) / 1e6
        msgid = int.from_bytes(frame[7:10], "little")
        if msgid in EVERY:
            seen[msgid] += 1
        if msgid in PAIR or (msgid in EVERY and seen[msgid] % EVERY[msgid] == 0):
            found.append((at_s, msgid, frame))
        at = stop
    return found


def as_vehicle(frames: list[tuple[float, int, bytes]], sysid: int, shift_s: float) -> list[tuple[float, bytes]]:
    """The frames as another vehicle sends them that was booted so much earlier."""
    extras = {msgid: _crc_extra(frame) for _, msgid, frame in frames}
    out = []
    for number, (at_s, msgid, frame) in enumerate(frames):
        payload = bytearray(frame[10:-2])
        if msgid in CLOCKS:
            form, ticks = CLOCKS[msgid]
            payload = payload.ljust(struct.calcsize(form), b"\0")
            struct.pack_into(form, payload, 0, struct.unpack_from(form, payload)[0] + round(shift_s * ticks))
        head = bytes((frame[0], len(payload), 0, 0, number & 0xFF, sysid, 1)) + frame[7:10]
        crc = mcrf4xx(extras[msgid], mcrf4xx(head[1:] + bytes(payload)))
        out.append((at_s, head + bytes(payload) + crc.to_bytes(2, "little")))
    return out


def _crc_extra(frame: bytes) -> bytes:
    """The seed of a message's checksum, found by trying: the frame itself is sound."""
    body, wanted = mcrf4xx(frame[1:-2]), int.from_bytes(frame[-2:], "little")
    return next(bytes((one,)) for one in range(256) if mcrf4xx(bytes((one,)), body) == wanted)


def schedule(healthy: Path, faulty: Path, vehicles: int, faults: int) -> list[list[bytes]]:
    """What is sent in each burst, all vehicles together."""
    bursts: list[list[bytes]] = []
    kinds = [frames_of(healthy), frames_of(faulty)]
    for sysid in range(1, vehicles + 1):
        for at_s, data in as_vehicle(kinds[sysid > vehicles - faults], sysid, 3.7 * sysid):
            number = int(at_s / BURST_S)
            while len(bursts) <= number:
                bursts.append([])
            bursts[number].append(data)
    return bursts


def replay(bursts: list[list[bytes]], ports: list[int]) -> None:
    """Send in real time; what is late is sent at once."""
    links = []
    for port in ports:
        links.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        links[-1].connect(("127.0.0.1", port))
    begun = time.monotonic()
    for number, burst in enumerate(bursts):
        time.sleep(max(0.0, begun + number * BURST_S - time.monotonic()))
        for link in links:
            for data in burst:
                link.send(data)


def peak_mb(pid: int) -> float:
    """Most memory that a process held [MB]."""
    return int(re.findall(r"VmHWM:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[0]) / 1024


def baseline_file(folder: Path, rate: int) -> Path:
    """A baseline of the type, of four flights."""
    logs = [read_tlog(record(folder / f"h{i}.tlog", rate, 30, "--seed", str(i))) for i in range(4)]
    airframe = replace(airframe_named("qdrone2"), scope="type")
    learn(logs, LearnOptions(airframe=airframe), created="2026-01-01T00:00:00Z").save(folder / "baseline.json")
    return folder / "baseline.json"


def main() -> None:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--rate", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--faulty", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, span_s = Path(name), SETTLE_S + options.seconds
        onset_s = SETTLE_S + options.seconds / 2
        fault = ("--fault", "F2/SV2", "--rotor", "1", "--onset", str(onset_s), "--seed", "78")
        healthy = record(folder / "healthy.tlog", options.rate, span_s, "--seed", "77")
        bursts = schedule(
            healthy, record(folder / "faulty.tlog", options.rate, span_s, *fault), options.vehicles, options.faulty
        )
        baseline = baseline_file(folder, options.rate)
        log = (folder / "detector.log").open("w+")
        detector = subprocess.Popen(
            [sys.executable, "-m", "detector", "--connect", "udpin:127.0.0.1:0", "--baseline", str(baseline)],
            stderr=log,
        )
        port = wait_for_port(folder / "detector.log")
        bare_port = free_port()
        bare = subprocess.Popen([sys.executable, "-c", BARE, str(bare_port)])
        time.sleep(0.5)
        begun = [cpu_s(one.pid) for one in (detector, bare)]
        sender = get_context("fork").Process(target=replay, args=(bursts, [port, bare_port]))
        sender.start()
        time.sleep(SETTLE_S)
        before, since = [cpu_s(one.pid) for one in (detector, bare)], time.monotonic()
        sender.join()
        spent, real_s = [cpu_s(one.pid) for one in (detector, bare)], time.monotonic() - since
        time.sleep(2.5)
        memory = peak_mb(detector.pid)
        bare.kill()
        detector.terminate()
        detector.wait()
        log.seek(0)
        lines = log.read().splitlines()
    report(lines, options.vehicles, options.faulty)
    messages = sum(map(len, bursts))
    print(f"  sent {messages} datagrams in {span_s:.0f} s: {messages / span_s:.0f} a second")
    shares = [100 * (b - a) / real_s for a, b in zip(before, spent, strict=True)]
    print(f"  a bare loop that receives   {shares[1]:6.1f} % of a core")
    print(f"  daemon, all judged          {shares[0]:6.1f} % of a core   {shares[0] / max(shares[1], 0.1):.1f} x")
    print(f"  daemon, while they enter    {100 * (before[0] - begun[0]) / SETTLE_S:6.1f} % of a core")
    print(f"  memory                      {memory:6.0f} MB at most")


def wait_for_port(log: Path) -> int:
    """The port that the detector says it listens on."""
    while not (found := re.findall(r"ready: udpin:[\d.]+:(\d+)", log.read_text())):
        time.sleep(0.1)
    return int(found[0])


def report(lines: list[str], vehicles: int, faulty: int) -> None:
    """What the daemon said of itself."""
    summary = lines[-1]
    figures = re.findall(
        r"vehicle (\d+) [^,]+, (\d+) frames, (\d+) lost on the way, ([\d.]+) s judged, (\d+) ev", summary
    )
    alerted = {int(one) for line in lines for one in re.findall(r"vehicle (\d+): decision: fault", line)}
    wanted = set(range(vehicles - faulty + 1, vehicles + 1))
    print(f"{len(figures)} of {vehicles} vehicles, {sum(int(one[1]) for one in figures)} frames received")
    print(f"  lost on the way {sum(int(one[2]) for one in figures)}; {summary.rpartition('; ')[2]}")
    judged = [float(one[3]) for one in figures] or [0.0]
    print(f"  judged {min(judged):.1f} to {max(judged):.1f} s of each; alerts {len(alerted & wanted)} of {faulty}, "
          f"{len(alerted - wanted)} of the healthy {vehicles - faulty}")  # fmt: skip
    for line in lines:
        if "judged" in line and ("much to do" in line or "in time again" in line):
            print(f"  said: {line}")


if __name__ == "__main__":
    main()
