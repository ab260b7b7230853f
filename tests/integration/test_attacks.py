"""What an attacker beside the genuine stream achieves: nothing, and it is told. And what the daemon ever sends."""

import itertools
import json
import socket
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect
import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st
from made_session import baseline_for
from made_vehicle import TICK_S, Bench, FakeFitter, MadeVehicle, VirtualHost, received
from memory_port import MemoryEndpoint

from detector.config import SessionSettings, Settings
from detector.fleet import Fleet, due_turns
from detector.states import State
from detector.values import SendText, SessionSpec
from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.datagrams import Datagrams, as_columns
from mavdiag.link.keys import KeptSigning
from mavdiag.link.messages import Component, MavCmd, MessageId, Severity
from mavdiag.link.ports import SocketAddress, open_endpoint
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import sources
from mavdiag.link.signing import Refusal, Signing, stamp_at
from mavdiag.telemetry import Instant

UDP_IN = "udpin:127.0.0.1:0"
HERE, THERE = ("10.0.0.1", 14550), ("10.0.0.66", 4444)
Forge = Callable[[int, int], tuple[int, list[Any]] | None]
STATION = Encoder(255, 190)
ACTS = "suspected: land; fault: land; gross loss: land"
LOITER = 5
BESIDE = ("another vehicle", "answers", "texts", "commands", "random frames", "damaged flight", "disarmed rows")
LEARNING = Settings(connect=UDP_IN, learn=4.0)
TAKEN = {MessageId.COMMAND_ACK, MessageId.COMMAND_LONG, MessageId.COMMAND_INT}
HEARD = TAKEN | {source.message for profile in PROFILES.values() for source in sources(profile)}
MESSAGES = sorted(int(message) for message in HEARD if message in dialect.mavlink_map)


class Listening(MemoryEndpoint):
    """The daemon's end of a memory link, on which strangers can send too."""

    def mix(self, host: VirtualHost) -> None:
        self.host = host
        self.strange: list[tuple[bytes, SocketAddress]] = []

    def _drain(self) -> Datagrams:
        own = [(data, HERE) for data in self._inbox.take()]
        found, self.strange = [*own, *self.strange], []
        return as_columns([(data, self.host.ns) for data, _ in found], [source for _, source in found])


class Attacked(Bench):
    """A bench whose daemon hears strangers too; `attack` makes the datagrams of each tick."""

    def fly(self, seconds: float, attack: Iterator[list[bytes]] = itertools.repeat([])) -> None:  # noqa: B008
        near = self.open[0]
        assert isinstance(near, MemoryEndpoint)
        if not isinstance(near, Listening):
            near.__class__ = Listening
            assert isinstance(near, Listening)
            near.mix(self.host)
        for _ in range(round(seconds / TICK_S)):
            near.strange = [(data, THERE) for data in next(attack)]
            self.run(TICK_S)

    @property
    def judged_s(self) -> float:
        return self.daemon.fleet.vehicles[1].judged_s


def attacked(vehicle: MadeVehicle, on_fault: str = "", **more: Any) -> Attacked:
    """A daemon that watches a vehicle by its baseline."""
    settings = Settings(connect=UDP_IN, baseline=Path("b.json"), on_fault=on_fault)
    return Attacked(settings, baseline=baseline_for(), vehicles=[vehicle], links_behind=1, **more)


def framed(message: type[dialect.MAVLink_message], payload: bytes, seq: int, sysid: int, compid: int) -> bytes:
    head = struct.pack("<BBBBBBHB", len(payload), 0, 0, seq, sysid, compid, message.id & 0xFFFF, message.id >> 16)
    return b"\xfd" + head + payload + mcrf4xx(bytes([message.crc_extra]), mcrf4xx(head + payload)).to_bytes(2, "little")


def random_frames(seed: int, sender: tuple[int, int] | None) -> Iterator[list[bytes]]:
    """Any message with any content, and a good checksum; of any sender, or of one."""
    rng, messages = np.random.default_rng(seed), list(dialect.mavlink_map.values())
    while True:
        found = []
        for _ in range(20):
            message = messages[int(rng.integers(len(messages)))]
            seq, sysid, compid = rng.integers(0, 256, 3).tolist()
            found.append(framed(message, rng.bytes(message.unpacker.size), seq, *(sender or (sysid, compid))))
        yield found


def replay() -> Iterator[list[bytes]]:
    """An old flight of the same vehicle, over and over."""
    old = MadeVehicle(1)
    old.turning = 3.0
    return itertools.cycle([old.samples(4) for _ in range(250)])


def made_up() -> Iterator[list[bytes]]:
    """A heartbeat of every sender there is, 120 a tick."""
    beat = (2, 3, 128, 0, 4, 3)
    every = itertools.cycle(itertools.product(range(1, 256), range(1, 256)))
    while True:
        yield [Encoder(*sender).encode(MessageId.HEARTBEAT, *beat) for sender in itertools.islice(every, 120)]


ATTACKS: Mapping[str, Callable[[], Iterator[list[bytes]]]] = {
    "replayed flight": replay,
    "random frames of any sender": lambda: random_frames(1, None),
    "random frames as the vehicle": lambda: random_frames(2, (1, 1)),
    "random frames as its camera": lambda: random_frames(3, (1, 100)),
    "made-up senders": made_up,
    "markers without frames": lambda: itertools.repeat([b"\xfd" * 9000] * 5),
    "not MAVLink at all": lambda: itertools.repeat([b"GET / HTTP/1.1\r\n\r\n"] * 50),
}


IN_ITS_NAME = ("replayed flight", "random frames as the vehicle", "made-up senders")


@pytest.fixture(scope="module")
def calm_s() -> float:
    bench = Attacked(LEARNING, fitter=FakeFitter(baseline_for()), vehicles=[MadeVehicle(1)])
    bench.fly(25.0)
    judged_s = bench.judged_s
    bench.close()
    assert judged_s > 10.0
    return judged_s


def test_vehicles_of_one_source_do_not_delay_that_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    strangers = [MadeVehicle(sysid) for sysid in range(2, 6)]
    attack = ([frame for one in strangers for frame in one.samples(4)] for _ in itertools.count())
    bench = attacked(MadeVehicle(1))
    bench.fly(5.0, attack)
    fleet = bench.daemon.fleet
    assert set(fleet.vehicles) == set(range(1, 6))
    monkeypatch.setattr("detector.fleet.due_turns", lambda *given: itertools.islice(due_turns(*given), 1))
    judged = [fleet.vehicles[1].turn]
    for _ in range(40):
        bench.fly(TICK_S, attack)
        judged.append(fleet.vehicles[1].turn)
    assert sum(after != before for before, after in itertools.pairwise(judged)) >= 12  # of 14; 8 by waiting alone


@pytest.mark.parametrize("name", ATTACKS)
def test_the_genuine_stream_is_judged_all_along(name: str, calm_s: float, tmp_path: Path) -> None:
    fitter, journal = FakeFitter(baseline_for()), tmp_path / "j.jsonl"
    bench = Attacked(LEARNING, fitter=fitter, vehicles=[MadeVehicle(1)], journal=journal, links_behind=1)
    bench.fly(3.0)
    bench.fly(22.0, ATTACKS[name]())
    ((sysid, vehicle),) = bench.daemon.fleet.vehicles.items()
    assert bench.judged_s == calm_s
    assert (sysid, vehicle.session.state, vehicle.count.lost, vehicle.alarms.total()) == (1, State.MONITORING, 0, 0)
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == 0
    behind = Decoder()
    behind.take(bench.behind[0].receive(0.0))
    assert behind.senders[1, 1].lost == 0
    bench.close()
    notes = [one["text"] for one in map(json.loads, journal.read_text().splitlines()) if one["kind"] == "note"]
    assert len([text for text in notes if "sends in the name of vehicle 1" in text]) == (name in IN_ITS_NAME)


def test_a_vehicle_that_comes_from_another_address_is_no_second_sender_but_who_uses_its_old_one_is() -> None:
    vehicle = MadeVehicle(1)
    bench = attacked(vehicle)
    bench.fly(5.0)
    for old, told in (([], False), ([MadeVehicle(1)], True)):
        bench.vehicles = old
        bench.fly(8.0, (vehicle.samples(4) for _ in itertools.count()))
        assert any("PROP second source" in line for line in bench.host.lines) is told


class Beset(MadeVehicle):
    """A vehicle beside which somebody sends in its name and from its address.

    forge: what is sent after the frame of this number; None for nothing. ahead: of the running number before it.
    """

    def __init__(self, forge: "Forge", ahead: int) -> None:
        super().__init__(1)
        self._forge, self._ahead, self._frames = forge, ahead, 0

    def samples(self, count: int) -> list[bytes]:
        found = []
        for genuine in super().samples(count):
            found.append(genuine)
            forged = self._forge(self._frames, self.sent)
            self._frames += 1
            if forged is not None and self.sent > 300:
                msgid, fields = forged
                other = Encoder(1, 1)
                other._seq = (genuine[4] + self._ahead) & 0xFF
                found.append(other.encode(msgid, *fields))
        return found


def every(count: int, msgid: int, fields: Callable[[int], list[Any]], first: int = 0) -> Forge:
    """After each such frame of the vehicle, from the first on. fields: by the number of samples that it sent."""
    return lambda number, sent: None if (number - first) % count else (msgid, fields(sent))


def gyro(count: int, ahead_s: float = 0.0, first: int = 0, rate: int = 1) -> Forge:
    """RAW_IMU, stamped so far ahead of the genuine one."""
    ahead_us = round(1e6 * ahead_s)
    return every(
        count, MessageId.RAW_IMU, lambda sent: [5_000_000 + 10_000 * sent + ahead_us, 0, 0, -1000, rate, 2, 3], first
    )


def armed(count: int, mode: int, custom: int = 0) -> Forge:
    return every(count, MessageId.HEARTBEAT, lambda _: [2, 0, mode, custom, 4, 3])


WITHOUT_THRUST = every(
    5, MessageId.ATTITUDE_TARGET, lambda sent: [5000 + 10 * sent, 0, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.0]
)
TILTED = every(20, MessageId.ATTITUDE, lambda sent: [5000 + 10 * sent, 2.5, 0.0, 0.0, 6.0, 0.0, 0.0])
ONCE = 1 << 40


CLASH, LEAP = "two senders seem to use the name of vehicle 1", "stamps that leap"
FORGED: Mapping[str, tuple[Forge, int, str]] = {
    "gyro 1/s stamped 1 h ahead": (gyro(201, 3600.0), 20, LEAP),
    "gyro 10/s stamped 0.3 s ahead": (gyro(20, 0.3), 20, LEAP),
    "one frame stamped 10 s ahead": (gyro(ONCE, 10.0, first=1000), 20, "whose stamps leap"),
    "one frame with a number of the same look": (gyro(ONCE, 120.0, first=1000), 2, "with the number of another frame"),
    "disarmed 3/s": (armed(67, 0), 1, CLASH),
    "disarmed 3/s with other running numbers": (armed(67, 0), 200, "disarmed amid armed heartbeats"),
    "thrust 0 at 40 Hz": (WITHOUT_THRUST, 1, CLASH),
}


@pytest.mark.parametrize("name", FORGED)
def test_forged_frames_from_the_vehicles_own_address_do_not_blind(name: str) -> None:
    forge, ahead, told = FORGED[name]
    vehicle = Beset(forge, ahead)
    bench = attacked(vehicle)
    bench.fly(20.0)
    assert bench.judged_s >= 14.0  # of 15 that can be
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == 0
    assert told in "\n".join([*bench.host.lines, *(cause for cause, _ in bench.daemon.figures().refused)])
    vehicle.turning = 0.5
    bench.fly(3.0)
    assert "PROP FAULT" in "\n".join(bench.host.lines)
    bench.close()


def acting(vehicle: MadeVehicle, **more: Any) -> Attacked:
    vehicle.custom_mode = LOITER
    return attacked(vehicle, on_fault=ACTS, **more)


def actions(bench: Attacked) -> list[tuple[int, int]]:
    """Vehicle and command of what the detector commanded but rates."""
    frames = [one for one in received(bench.far) if one.msgid in (MessageId.COMMAND_LONG, MessageId.COMMAND_INT)]
    asked = (one.numbers("target_system", "command") for one in frames)
    return [(vehicle, command) for vehicle, command in asked if command not in COMMANDS]


IN_ITS_PLACE: Mapping[str, Forge] = {
    "turning 10/s": gyro(20, rate=3000),
    "turning 10/s between the genuine": gyro(20, 0.005, rate=3000),
    "turning 100/s": gyro(2, rate=3000),
    "tilted": TILTED,
    "armed in an automatic mode": armed(67, 129, LOITER),
}


@pytest.mark.parametrize("ahead", [1, 20])
@pytest.mark.parametrize("name", IN_ITS_PLACE)
def test_forged_rows_from_the_vehicles_own_address_cause_no_action(name: str, ahead: int) -> None:
    vehicle = Beset(IN_ITS_PLACE[name], ahead)
    bench = acting(vehicle)
    bench.fly(15.0)
    assert actions(bench) == []
    vehicle.turning = 0.5
    bench.fly(3.0)
    blinded = name == "turning 100/s" and ahead == 1  # half of the frames have the number of another: it is told
    assert actions(bench) == ([] if blinded else [(1, MavCmd.NAV_LAND)] * 2)
    bench.close()


def beside(name: str) -> Iterator[list[bytes]]:
    """What somebody sends from another address, in the vehicle's name or in one of his own."""
    own, other = MadeVehicle(1), MadeVehicle(2)
    for vehicle in (own, other):
        vehicle.turning, vehicle.custom_mode = 3.0, LOITER
    if name == "another vehicle":
        return itertools.cycle([other.samples(4) for _ in range(500)])
    if name == "answers":
        acks = [(MavCmd.NAV_LAND, result, 0, 0, 1, 191) for result in (0, 2, 4)]
        return itertools.repeat([own.encoder.encode(MessageId.COMMAND_ACK, *ack) for ack in acks])
    if name == "texts":
        texts = ("PROP FAULT motor 3", "PROP THRUST LOST motor 3", "PROP land commanded")
        return itertools.repeat([own.encoder.statustext(Severity.CRITICAL, text) for text in texts])
    if name == "commands":
        numbers = (MavCmd.USER_1, MavCmd.NAV_LAND, MavCmd.INJECT_FAILURE, 31011)
        orders = [(1, Component.ONBOARD_COMPUTER, number, 0, *[1.0] * 7) for number in numbers]
        senders = (own.encoder, STATION)
        return itertools.repeat([one.encode(MessageId.COMMAND_LONG, *order) for one in senders for order in orders])
    if name == "random frames":
        return random_frames(7, (1, 1))
    own.armed = name == "damaged flight"
    return itertools.cycle([[own.heartbeat(), *own.samples(4)] for _ in range(500)])


@pytest.mark.parametrize("name", BESIDE)
def test_another_address_causes_no_action_and_hinders_none(name: str) -> None:
    vehicle = MadeVehicle(1)
    bench = acting(vehicle)
    bench.fly(15.0, beside(name))
    assert {whose for whose, _ in actions(bench)} <= {2}  # a vehicle that asks for it gets its own
    vehicle.turning = 0.5
    bench.fly(3.0, beside(name))
    assert [one for one in actions(bench) if one[0] == 1] == [(1, MavCmd.NAV_LAND)] * 2


@pytest.mark.parametrize("name", ["not signed", "another key", "replayed"])
def test_on_a_signed_link_frames_of_a_damaged_flight_cause_no_action(name: str, tmp_path: Path) -> None:
    key, host = b"k" * 32, VirtualHost()
    unix_ns = round(host.utc().timestamp() * 1e9)
    genuine, old = MadeVehicle(1), MadeVehicle(1)
    old.turning, old.custom_mode = 3.0, LOITER
    stamps = {"another key": (b"x" * 32, unix_ns), "replayed": (key, unix_ns - 3_600 * 10**9)}
    if name in stamps:
        used, at_ns = stamps[name]
        old.encoder = Encoder(1, Component.AUTOPILOT1, Signing(used, stamp=stamp_at(at_ns)))
    genuine.encoder = Encoder(1, Component.AUTOPILOT1, Signing(key, stamp=stamp_at(unix_ns)))
    bench = acting(genuine, host=host)
    bench.daemon = bench.another(bench.open[:1], KeptSigning(key, tmp_path / "stamp", unix_ns))
    bench.fly(3.0)
    for _ in range(300):  # from its own address
        for frame in old.samples(4):
            bench.far.send(frame)
        bench.fly(TICK_S)
    assert actions(bench) == []
    genuine.turning = 0.5
    bench.fly(3.0)
    assert actions(bench) == [(1, MavCmd.NAV_LAND)] * 2


def test_frames_in_our_own_name_are_refused_and_not_passed_on() -> None:
    bench, fake = acting(MadeVehicle(1)), Encoder(1, Component.ONBOARD_COMPUTER)
    text = fake.statustext(Severity.CRITICAL, "PROP THRUST LOST motor 3")
    order = fake.encode(MessageId.COMMAND_LONG, 1, 1, MavCmd.NAV_LAND, 0, *[0.0] * 7)
    bench.fly(12.0, itertools.repeat([text, order]))
    assert actions(bench) == []
    assert not any(b"motor 3" in data for data, _ in bench.behind[0].receive(0.0))
    assert any("10.0.0.66:4444 sends as 1/191, which is this detector" in line for line in bench.host.lines)
    assert dict(bench.daemon.figures().refused)["in our own name 1/191"] == 600


def test_with_a_key_only_the_genuine_vehicle_is_heard_and_what_is_sent_is_signed(tmp_path: Path) -> None:
    key, host = b"k" * 32, VirtualHost()
    unix_ns = round(host.utc().timestamp() * 1e9)
    genuine, plain = MadeVehicle(1), MadeVehicle(2)
    genuine.encoder = Encoder(1, Component.AUTOPILOT1, Signing(key, stamp=stamp_at(unix_ns)))
    bench = Attacked(Settings(connect=UDP_IN, learn=500.0), vehicles=[genuine, plain], host=host)
    bench.daemon = bench.another(bench.open[:1], KeptSigning(key, tmp_path / "stamp", unix_ns))
    bench.fly(3.0)
    old = genuine.samples(100)
    bench.fly(3.0, itertools.cycle([[frame] for frame in old]))
    assert list(bench.daemon.fleet.vehicles) == [1]
    signing = bench.daemon._signing
    assert signing is not None
    assert signing.refused.keys() == {Refusal.UNSIGNED}
    assert any("sends in the name of vehicle 1" in line for line in host.lines)  # before their stamps are looked at
    verifier = Decoder(signing=Signing(key, stamp=stamp_at(unix_ns)))
    frames = [frame for data, _ in bench.far.receive(0.0) for frame in verifier.feed(data, 0)]
    assert MessageId.HEARTBEAT in {frame.msgid for frame in frames}
    assert any("refused" in text and Refusal.UNSIGNED in text for text in bench.host.lines)


# All that the detector may send to a vehicle, and to those behind. No arming, no mode; parameters are read only.
SENT = {MessageId.PARAM_REQUEST_READ, MessageId.HEARTBEAT, MessageId.STATUSTEXT, MessageId.NAMED_VALUE_FLOAT}
SENT |= {MessageId.COMMAND_LONG, MessageId.COMMAND_ACK, MessageId.TIMESYNC}
COMMANDS = {MavCmd.SET_MESSAGE_INTERVAL}


def test_nothing_else_is_ever_sent_over_a_long_story(tmp_path: Path) -> None:
    """Two vehicles, learning, judging, a fault, landings, reboots, lost links, random frames and commands of others."""
    vehicles = [MadeVehicle(1), MadeVehicle(2)]
    bench = Attacked(LEARNING, fitter=FakeFitter(baseline_for()), vehicles=vehicles)
    sent, commands = Counter[int](), Counter[int]()
    station, rng = Encoder(255, 190), np.random.default_rng(11)
    wild = random_frames(12, None)
    for number in range(16):
        vehicles[0].turning = float(rng.choice([0.0, 0.0, 2.0]))
        vehicles[1].armed = bool(rng.random() < 0.7)
        if rng.random() < 0.1:
            vehicles[0].sent = 0  # rebooted
        bench.vehicles = [one for one in vehicles if rng.random() < 0.9]
        asked = [station.encode(MessageId.COMMAND_LONG, 1, compid, int(rng.integers(0, 600))) for compid in (1, 191)]
        bench.fly(5.0, itertools.chain([asked], wild if number % 3 == 0 else itertools.repeat([])))
        for frame in received(bench.far):
            sent[frame.msgid] += 1
            assert frame.compid == Component.ONBOARD_COMPUTER
            if frame.msgid in (MessageId.COMMAND_LONG, MessageId.COMMAND_INT):
                commands[frame.value("command")] += 1
    assert sent.keys() == SENT
    assert commands.keys() == COMMANDS
    told = "\n".join(bench.host.lines)
    assert all(words in told for words in ("PROP FAULT", "inspect before flight", "link lost", "link back", "rebooted"))
    bench.close()


@pytest.mark.realtime
def test_a_flood_hides_no_trusted_peer_and_moves_no_answer() -> None:
    with (
        open_endpoint(UDP_IN) as near,
        open_endpoint(near.address.replace("udpin", "udpout")) as peer,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        peer.send(b"0")
        (source,) = near.receive(5.0).sources
        place = ("127.0.0.1", int(near.address.rpartition(":")[2]))
        got: list[int] = []
        for k in range(1, 500):  # promoted amid its stream, which keeps its order
            peer.send(b"%d" % k)
            if k == 250:
                near.trust([source], alone=True)
        while chunks := near.receive(0.05):
            got += [int(data) for data, _ in chunks]
        assert got == list(range(1, 500))
        for _ in range(60_000):
            stranger.sendto(b"x" * 40, place)
        for k in range(2000):
            peer.send(b"%d" % k)
        own, before = 0, time.monotonic()
        for _ in range(20):
            own += near.receive(0.0).sources.count(source)
        assert own == 2000
        assert near.traffic.received < 20_000 + 30_000 * (time.monotonic() - before)
        near.send(b"answer")
        assert [data for data, _ in peer.receive(5.0)] == [b"answer"]
        stranger.setblocking(False)
        with pytest.raises(BlockingIOError):
            stranger.recv(100)


def wild(sysid: int, compid: int, rng: np.random.Generator) -> bytes:
    """A frame with a good checksum and any content: noise, or all bytes alike (zeros, -1, NaN, infinities, ...)."""
    message = dialect.mavlink_map[int(rng.choice(MESSAGES))]
    size = message.unpacker.size
    alike = bytes([int(rng.choice([0x00, 0x01, 0x7F, 0x80, 0xFF]))]) * size
    payload = rng.bytes(size) if rng.random() < 0.5 else alike
    return framed(message, payload, int(rng.integers(256)), sysid, compid)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), datagrams=st.booleans(), learning=st.booleans())
def test_wild_frames_and_garbage_are_survived(seed: int, datagrams: bool, learning: bool) -> None:
    rng = np.random.default_rng(seed)
    baseline = None if learning else baseline_for()
    settings = SessionSettings(learn=2.0)
    one = Fleet(
        lambda _, profile: SessionSpec(profile, baseline, settings), profile=None, only=None, datagrams=datagrams
    )
    vehicle, other = MadeVehicle(1), (int(rng.integers(0, 256)), int(rng.choice([1, 191])))
    now = Instant(10**12)
    for _ in range(150):
        frames = vehicle.samples(4)
        for _ in range(int(rng.integers(0, 3))):
            sender = (1, 1) if rng.random() < 0.3 else other
            frames.insert(int(rng.integers(0, 5)), wild(*sender, rng))
        if rng.random() < 0.3:
            frames.insert(int(rng.integers(0, 5)), rng.bytes(int(rng.integers(0, 300))))
        now += TICK_S
        one.take(as_columns([(frame, now.ns) for frame in frames]), now)
        for turn in one.judge(now):
            for effect in turn.effects:
                assert not isinstance(effect, SendText) or 0 < len(effect.text.encode()) <= 50
    one.finish(now)
    if 1 not in one.vehicles:  # wild heartbeats of its own id came between all of its own
        assert "does another vehicle use this system id" in one.link.waiting[1]
