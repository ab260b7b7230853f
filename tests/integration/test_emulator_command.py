"""`sitl-plant` as its user meets it: files, exit codes, errors of one line, the wall clock, and fleets."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from memory_port import MemoryEndpoint, memory_pair
from processes import PATIENCE_S, process

from mavdiag.link.codec import Decoder, Encoder, Frame, field_index
from mavdiag.link.messages import MessageId, ModeFlag, Severity
from mavdiag.link.ports import Endpoint, open_endpoint
from sitl_plant.__main__ import fleet
from sitl_plant.autopilot.dialect import DIALECTS
from sitl_plant.emulator import FlightReport, Link, fly
from sitl_plant.options import flight_plan
from sitl_plant.plant import Plant, PlantConfig, PlantSamples


def read_lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_the_same_options_give_the_same_file_and_another_seed_another(program: Any, tmp_path: Path) -> None:
    flight = ("--duration", "2", "--fault", "F2/SV2", "--rotor", "3", "--onset", "1", "--rate", "200", "--seed")
    files = {name: tmp_path / f"{name}.tlog" for name in ("one", "same", "other")}
    truth = tmp_path / "truth.jsonl"
    for (name, path), seed in zip(files.items(), ("4", "4", "5"), strict=True):
        code, out, err = program("sitl_plant.__main__", "record", "-o", path, *flight, seed, "--truth", truth)
        assert code == 0, err
        assert str(files[name]) in out
    one, same, other = (path.read_bytes() for path in files.values())
    assert one == same
    assert one != other
    lines = read_lines(truth)
    assert [line["record"] for line in lines] == ["flight", "state", "onset", "state"]
    assert (lines[0]["seed"], lines[0]["started_unix_ns"]) == (5, None)
    assert (lines[2]["t_s"], lines[2]["fault"], lines[2]["rotor"]) == (1.0, "F2/SV2", 3)
    assert [line["fault_present"] for line in lines if line["record"] == "state"] == [False, True]


@pytest.mark.realtime
def test_a_flight_keeps_the_wall_clock_and_no_message_comes_early() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as ear:
        command = ["run", "--json", "--out", ear.address.replace("udpin", "udpout"), "--duration", "3"]
        flight = subprocess.Popen([sys.executable, "-m", "sitl_plant", *command], stdout=subprocess.PIPE, text=True)
        decoder, frames = Decoder(), []
        place = field_index(MessageId.RAW_IMU, "time_usec")
        until = time.monotonic() + PATIENCE_S
        while flight.poll() is None and time.monotonic() < until:
            frames += [frame for data, host_ns in ear.receive(0.1) for frame in decoder.feed(data, host_ns)]
        frames += [frame for data, host_ns in ear.receive(0.1) for frame in decoder.feed(data, host_ns)]
        output, _ = flight.communicate(timeout=PATIENCE_S)
        assert ear.traffic.overflowed == 0
    assert flight.returncode == 0
    report = json.loads(output.splitlines()[-1])
    assert report["event"] == "landed"
    assert report["wall_s"] > 2.9
    imu = [(frame.host_ns, int(frame.fields[place]) * 1000) for frame in frames if frame.msgid == MessageId.RAW_IMU]
    assert len(imu) == 3000
    assert decoder.senders[1, 1].lost == 0
    if report["late_max_ms"] < 100.0:  # else the machine had other things to do, and the report says so
        delay = [host_ns - t_ns for host_ns, t_ns in imu]
        assert report["wall_s"] < 3.5
        assert report["slips"] == 0
        assert sorted(delay)[len(delay) // 2] - min(delay) < 0.1e9


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_flight_in_good_order(number: signal.Signals, tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    command = ["run", "--json", "--out", "udpin:127.0.0.1:0", "--truth", str(truth)]
    flight = subprocess.Popen([sys.executable, "-m", "sitl_plant", *command], stdout=subprocess.PIPE, text=True)
    assert flight.stdout is not None
    assert json.loads(flight.stdout.readline())["event"] == "flying"
    time.sleep(0.3)
    flight.send_signal(number)
    output, _ = flight.communicate(timeout=PATIENCE_S)
    assert flight.returncode == 0
    assert json.loads(output)["event"] == "landed"
    assert [line["record"] for line in read_lines(truth)][:2] == ["flight", "state"]


FLEET = [sys.executable, "-m", "sitl_plant", "fleet", "--profile", "ardupilot", "--rate", "50"]
MODE = field_index(MessageId.HEARTBEAT, "base_mode")


def heard(ends: list[Endpoint], until_disarmed: set[int]) -> list[dict[int, list[bool]]]:
    """For each end, whether each system id was armed, heartbeat by heartbeat, until these landed."""
    found: list[dict[int, list[bool]]] = [{} for _ in ends]
    deadline, decoder = time.monotonic() + PATIENCE_S, Decoder({MessageId.HEARTBEAT})
    landed = set[int]()
    while landed < until_disarmed and time.monotonic() < deadline:
        for end, own in zip(ends, found, strict=True):
            for data, host_ns in end.receive(0.05):
                for frame in decoder.feed_datagram(data, host_ns):
                    armed = bool(int(frame.fields[MODE]) & ModeFlag.SAFETY_ARMED)
                    told = own.setdefault(frame.sysid, [])
                    landed |= {frame.sysid} if told and told[-1] and not armed else set()
                    told.append(armed)
    assert landed == until_disarmed
    return found


@pytest.mark.realtime
def test_a_fleet_takes_off_and_lands_on_one_port() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as end:
        out = end.address.replace("udpin", "udpout")
        options = ["-n", "3", "--system-id", "7", "--out", out, "--takeoff", "--duration", "18"]
        with process([*FLEET, *options]) as plant:
            (found,) = heard([end], {7, 8, 9})
            assert plant.wait(PATIENCE_S) == 0
    assert set(found) == {7, 8, 9}
    assert all(True in told for told in found.values())


def test_only_the_vehicles_that_are_named_get_the_fault() -> None:
    flown: list[tuple[int, str | None, int]] = []

    class Inline:
        """In place of a process."""

        def __init__(self, target: object, args: tuple[object, ...]) -> None:
            plan = args[0]
            flown.append((plan.dialect.sysid, plan.config.fault, plan.config.seed))  # type: ignore[attr-defined]  # a plan

        def start(self) -> None: ...
        def join(self) -> None: ...
        def is_alive(self) -> bool:
            return False

    with patch("multiprocessing.context.ForkContext.Process", Inline):
        fleet.__wrapped__(flight_plan(fault="F2/SV2", seed=5), 4, "2,4", "udpout:127.0.0.1:9")  # type: ignore[attr-defined]  # the command without its options
    assert flown == [(1, None, 5), (2, "F2/SV2", 6), (3, None, 7), (4, "F2/SV2", 8)]


# The run loop over in-memory links, as fast as it goes: what is said, answered and passed on

DIALECT = DIALECTS["qdrone2"]


class Client:
    """The far end of one of the plant's links."""

    def __init__(self, endpoint: MemoryEndpoint, sysid: int, compid: int) -> None:
        self.endpoint = endpoint
        self.encoder = Encoder(sysid, compid)
        self.decoder = Decoder()
        self.frames: list[Frame] = []

    def say(self, *frame: bytes) -> None:
        for one in frame:
            self.endpoint.send(one)

    def heartbeat(self) -> None:
        self.say(self.encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3))

    def hear(self) -> list[Frame]:
        for data, host_ns in self.endpoint.receive(0.0):
            self.frames += self.decoder.feed(data, host_ns)
        return self.frames


@pytest.fixture
def table() -> Iterator[tuple[list[Link], list[Client]]]:
    """Two links with a client at the far end of each: a ground station and a companion computer."""
    with ExitStack() as stack:
        pairs = [memory_pair() for _ in range(2)]
        for near, far in pairs:
            stack.enter_context(near)
            stack.enter_context(far)
        links = [Link(near, DIALECT, 200.0) for near, _ in pairs]
        yield links, [Client(pairs[0][1], 255, 190), Client(pairs[1][1], 1, 191)]


def flown(
    links: list[Link],
    duration_s: float | None,
    watch: Callable[[PlantSamples], None] = lambda samples: None,
    stop: Callable[[], bool] = lambda: False,
) -> FlightReport:
    plant = Plant(PlantConfig(seed=11))
    return fly(plant, DIALECT, links, duration_s=duration_s, speed=None, stop=stop, watch=watch)


def test_an_alert_is_passed_on_in_its_senders_name(table: tuple[list[Link], list[Client]]) -> None:
    links, (station, companion) = table
    station.heartbeat()
    companion.say(*(companion.encoder.statustext(Severity.CRITICAL, f"PROP FAULT r{rotor}") for rotor in (1, 2)))
    flown(links, 0.5)
    passed = [frame for frame in station.hear() if frame.compid == 191]
    assert [frame.text("text") for frame in passed] == ["PROP FAULT r1", "PROP FAULT r2"]
    assert station.decoder.senders[1, 191].lost == 0
    assert not [frame for frame in companion.hear() if frame.compid == 191]
    assert [frame.sysid for frame in companion.frames if frame.sysid == 255] == []  # heard before the companion was


def test_b28_a_cut_off_datagram_of_one_peer_does_not_spoil_the_next_ones() -> None:
    with ExitStack() as stack:
        near, far = (stack.enter_context(end) for end in memory_pair())
        near.datagrams = True  # as a udpin endpoint has several peers
        link, encoder = Link(near, DIALECT, None), Encoder(255, 190)
        whole = encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3)
        far.send(whole[:-5])
        far.send(encoder.encode(MessageId.HEARTBEAT, 6, 8, 0, 0, 4, 3))
        assert [frame.seq for frame in link.receive()] == [1]
