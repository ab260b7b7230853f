"""Bytes of a link become vehicles: who is heard from where, who enters, and what passes to the links behind."""

import struct
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_logs import IMU, PARM, SENSORS, STAMP, DataFlashMessage, ULogTopic, dataflash, ulog, ulog_message
from made_telemetry import body_rates
from made_vehicle import MadeVehicle
from memory_port import memory_pair

import mavdiag as md
from detector import component
from detector.component import Handled, Requests
from detector.relay import DATAGRAM_BYTES, Relay
from mavdiag.airframe.vehicle_type import MULTIROTORS
from mavdiag.errors import InputError
from mavdiag.link.clock import Timesync, TimesyncMessage
from mavdiag.link.codec import Decoder, Encoder, message_name
from mavdiag.link.datagrams import as_columns
from mavdiag.link.link import Link
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId, ModeFlag
from mavdiag.link.parameters import parameters_in
from mavdiag.link.profiles import PROFILES, scale_doubt
from mavdiag.link.scale import gyro_checks
from mavdiag.link.sequence import FRAME, HEARD, SENDERS_MAX, Senders, Source
from mavdiag.link.vehicles import Ack, Command, LinkDecoder, command_in
from mavdiag.logs.tlog import read_tlog, tlog_record, vehicle_stream
from mavdiag.telemetry import FloatArray, Instant, Series, Signal
from mavdiag.units import DEG, NS_PER_S

S = 1_000_000_000
INT32, REAL32 = 6, 9  # MAV_PARAM_TYPE
LEVEL = (1.0, 0.0, 0.0, 0.0)
HERE, THERE = ("10.0.0.1", 14550), ("10.0.0.66", 4444)
KEY = 1 << 8 | 1
BOAT = "a boat (MAV_TYPE 11): mavdiag judges multirotors only"
START_US = 1_763_000_000_000_000

MSG = DataFlashMessage(33, "MSG", "QZ", "TimeUS,Message")
STATUS = ULogTopic(7, "vehicle_status", (STAMP, ("uint8_t", "arming_state"), ("uint8_t", "system_type")))
SECONDS = 30
STATION = Encoder(255, Component.MISSIONPLANNER)
BY_INT = STATION.encode(MessageId.COMMAND_INT, 1, 1, 0, MavCmd.SET_MESSAGE_INTERVAL, 0, 0, MessageId.RAW_IMU, 250_000)


class Sender:
    """A vehicle at 100 Hz, in frames."""

    def __init__(self, sysid: int = 1, autopilot: int = Autopilot.ARDUPILOTMEGA, weight: int = 1000) -> None:
        self.encoder = Encoder(sysid, Component.AUTOPILOT1)
        self._autopilot, self._weight = autopilot, weight
        self.k = 0

    def heartbeat(self, kind: MavType = MavType.QUADROTOR) -> bytes:
        return self.encoder.encode(MessageId.HEARTBEAT, kind, self._autopilot, ModeFlag.SAFETY_ARMED, 0, 4, 3)

    def chunks(self, n: int, imu: int = MessageId.RAW_IMU, *more: int) -> list[tuple[bytes, int]]:
        """A datagram for each of the next n samples."""
        found = []
        for k in range(self.k, self.k + n):
            data = self.heartbeat() if k % 100 == 0 else b""
            stamp = 1000 * (5000 + 10 * k) if imu in (MessageId.RAW_IMU, MessageId.HIGHRES_IMU) else 5000 + 10 * k
            data += self.encoder.encode(MessageId.ATTITUDE_TARGET, 5000 + 10 * k, 0, LEVEL, 0, 0, 0, 0.5)
            data += self.encoder.encode(imu, stamp, 0, 0, -self._weight, 1, 2, 3, *more)
            found.append((data, (k + 1) * S // 100))
        self.k += n
        return found


def run(decoder: LinkDecoder, chunks: list[tuple[bytes, int]]) -> int:
    """Feed chunk by chunk; how many gyro samples came out."""
    answers = [one for chunk in chunks for one in decoder.feed(as_columns([chunk]), chunk[1]).values()]
    rates = [one.telemetry.get(Signal.BODY_RATE) for one in answers]
    return sum(len(rate) for rate in rates if rate is not None)


def test_a_vehicle_enters_when_its_profile_is_clear_and_brings_its_frames_along() -> None:
    decoder = LinkDecoder()
    assert run(decoder, Sender().chunks(90)) == 0
    assert not decoder.vehicles
    sender, decoder = Sender(), LinkDecoder()
    assert run(decoder, sender.chunks(300)) == 300
    stream = decoder.vehicles[1]
    assert stream.profile is PROFILES["ardupilot"]
    assert (stream.state.timeline.t_ns, stream.state.timeline.reboots) == (7_990_000_000, 0)
    assert decoder.waiting == {}
    count = decoder.count(1)
    assert (count.received, count.lost) == (603, 0)
    assert decoder.count(7).received == 0


def test_b18_a_vehicle_of_unknown_profile_waits_and_says_why() -> None:
    decoder = LinkDecoder()
    assert run(decoder, Sender(autopilot=Autopilot.GENERIC, weight=16_384).chunks(300)) == 0
    assert not decoder.vehicles
    assert "RAW_IMU counts 16384" in decoder.waiting[1]
    assert "give --profile" in decoder.waiting[1]
    run(decoder := LinkDecoder(), [(one, k * S // 100) for k, one in enumerate(frames(600))])
    assert decoder.waiting[1].startswith("no heartbeat of its autopilot comes")


def test_acknowledgements_and_commands_are_handed_out() -> None:
    decoder, sender, station = LinkDecoder(PROFILES["ardupilot"]), Sender(), Encoder(255, 190)
    run(decoder, sender.chunks(5))
    ack = (MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED, 0, 0, 1)
    ours = sender.encoder.encode(MessageId.COMMAND_ACK, *ack, Component.ONBOARD_COMPUTER)
    other = sender.encoder.encode(MessageId.COMMAND_ACK, *ack, Component.MISSIONPLANNER)
    other += Encoder(1, 190).encode(MessageId.COMMAND_ACK, *ack, Component.ONBOARD_COMPUTER)
    computer = Component.ONBOARD_COMPUTER
    targets = ((1, computer), (1, Component.AUTOPILOT1), (9, computer))
    ask = [station.encode(MessageId.COMMAND_LONG, *target, MavCmd.REQUEST_MESSAGE) for target in targets]
    received = decoder.feed(as_columns([(b"".join([ours, other, *ask]), S)]), S)
    assert (list(received), received[1].acks) == ([1], (Ack(MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED),))
    assert [command_in(frame) for frame in received[1].asked] == [Command(MavCmd.REQUEST_MESSAGE, 255, 190)]
    assert received[1].alive
    assert not decoder.feed(as_columns([(b"".join(ask), 2 * S)]), 2 * S)[1].alive


def test_b28_a_truncated_datagram_is_not_joined_to_the_next() -> None:
    decoder, one, other = LinkDecoder(PROFILES["ardupilot"]), Sender(1), Sender(2)
    run(decoder, [*one.chunks(2), *other.chunks(2)])
    (whole, at), (cut, _) = other.chunks(1)[0], one.chunks(1)[0]
    assert run(decoder, [(cut[:-20], at), (whole, at)]) == 1
    assert 0 < decoder.decoder.garbage_bytes < 20


def test_a_link_is_iterated() -> None:
    near, far = memory_pair()
    sender = Sender()
    with Link(near, profile=PROFILES["ardupilot"]) as link:
        assert link.stream is None
        found = 0
        for data, _ in sender.chunks(50):
            far.send(data)
        for telemetry in link:
            found += len(telemetry["body_rate"])
            if found >= 50:
                break
        assert (link.vehicle, found) == (1, 50)
        assert link.stream is not None
    assert not near.connected
    far.close()


def attitudes(sender: Sender, n: int) -> list[tuple[bytes, int]]:
    """A heartbeat a second and ATTITUDE at 10 Hz, with body rates, and no IMU message."""
    found = []
    for k in range(n):
        data = sender.heartbeat() if k % 10 == 0 else b""
        data += sender.encoder.encode(MessageId.ATTITUDE, 5000 + 100 * k, 0.1, 0.2, 0.3, 0.01, 0.02, 0.03)
        found.append((data, (k + 1) * S // 10))
    return found


def logged(path: Path, passed: list[tuple[bytes, int]]) -> int:
    """How many gyro samples a log of such frames has."""
    path.write_bytes(b"".join(tlog_record(ns // 1000, frame) for frame, ns in passed))
    return len(read_tlog(path)[Signal.BODY_RATE])


def test_the_rates_of_attitude_are_read_where_no_imu_message_comes_for_long_until_one_comes(tmp_path: Path) -> None:
    live = run(LinkDecoder(passed=(passed := list[tuple[bytes, int]]())), attitudes(Sender(), 11_000))
    assert live == pytest.approx(10_700, abs=12) == logged(tmp_path / "a.tlog", passed)
    decoder, sender = LinkDecoder(), Sender()
    assert (run(decoder, attitudes(sender, 290)), decoder.vehicles[1].profile.imu) == (0, MessageId.RAW_IMU)
    rows, decoder = attitudes(sender := Sender(), 400), LinkDecoder()
    assert run(decoder, rows[:-1]) == pytest.approx(100, abs=12)
    assert message_name((stream := decoder.vehicles[1]).profile.imu) == "ATTITUDE"
    received = decoder.feed(as_columns(rows[-1:]), rows[-1][1])
    assert received[1].telemetry[Signal.BODY_RATE].values.tolist() == [pytest.approx([0.01, 0.02, 0.03])]
    sender.k = 4000
    assert run(decoder, [(data, at_ns) for data, at_ns in sender.chunks(50)]) == 50
    assert (message_name(stream.profile.imu), message_name(-1), message_name(8)) == ("RAW_IMU", "UNKNOWN", "UNKNOWN_8")


@pytest.mark.parametrize(("imu", "more"), [(MessageId.SCALED_IMU2, ()), (MessageId.RAW_IMU, (0, 0, 0, 1))])
def test_another_gyro_is_read_while_the_first_stops(imu: MessageId, more: tuple[int, ...], tmp_path: Path) -> None:
    passed = list[tuple[bytes, int]]()
    decoder, sender = LinkDecoder(passed=passed), Sender()
    assert run(decoder, sender.chunks(300)) == 300
    run(decoder, sender.chunks(1, imu, *more))
    sender.k += 400  # an outage of the link has stopped none of them
    assert [run(decoder, sender.chunks(1, imu, *more)), run(decoder, sender.chunks(100))] == [0, 100]
    assert run(decoder, sender.chunks(300, imu, *more)) == 0
    assert run(decoder, sender.chunks(200, imu, *more)) > 190
    assert (decoder.vehicles[1].profile.imu, decoder.vehicles[1].sensor) == (imu, sum(more))
    assert run(decoder, sender.chunks(200)) == 0  # the two are never mixed
    assert run(decoder, sender.chunks(200)) == pytest.approx(100, abs=12)
    run(decoder, sender.chunks(600, imu, *more))
    for _ in range(200):  # both come now, in turn
        run(decoder, [*sender.chunks(1), *sender.chunks(1, imu, *more)])
    assert (decoder.vehicles[1].profile.imu, decoder.vehicles[1].sensor) == (MessageId.RAW_IMU, 0)
    assert logged(tmp_path / "a.tlog", passed) == pytest.approx(run(LinkDecoder(), passed), abs=25)


def told(encoder: Encoder, name: str, number: float, kind: int = REAL32) -> bytes:
    return encoder.encode(MessageId.PARAM_VALUE, name.encode(), number, kind, 100, 0xFFFF)


@pytest.mark.parametrize("autopilot", [Autopilot.ARDUPILOTMEGA, Autopilot.PX4])
def test_integers_are_cast_by_ardupilot_and_copied_by_px4(autopilot: Autopilot) -> None:
    encoder, whole = Encoder(1, 1), {"FRAME_CLASS": 2.0, "A_NAME_OF_SIXTEE": 1_000_003.0, "SMALL": 0.0}
    copied = {name: struct.unpack("<f", struct.pack("<i", int(number)))[0] for name, number in whole.items()}
    sent = copied if autopilot is Autopilot.PX4 else whole
    frames = [told(encoder, name, number, INT32) for name, number in sent.items()]
    frames += [told(encoder, "REAL", 0.25), told(encoder, "BROKEN", float("nan"))]
    frames.append(told(Encoder(1, 191), "FRAME_CLASS", 7.0))  # of another component
    assert parameters_in(Decoder().feed(b"".join(frames), 0), autopilot) == {**whole, "REAL": 0.25}


def heard(senders: Senders, key: int, seq: int, host_ns: int, source: Source) -> bool:
    """Whether a frame of a sender is heard."""
    row = np.zeros(1, FRAME)
    row["sender"], row["seq"], row["host_ns"], row["source"] = key, seq, host_ns, senders.numbers([source])[0]
    senders.hear(np.frombuffer(bytes(2), np.uint8), row)
    return bool(row["heard"][0] == HEARD)


def beat(encoder: Encoder, kind: MavType = MavType.QUADROTOR) -> bytes:
    return encoder.encode(MessageId.HEARTBEAT, kind, Autopilot.ARDUPILOTMEGA, 128, 0, 4, 3)


def test_a_second_source_is_not_heard_while_the_first_is_alive() -> None:
    senders = Senders()
    for seq, at_s, source in ((0, 0, HERE), (1, 1, THERE), (1, 2, HERE), (2, 4, THERE)):
        assert heard(senders, KEY, seq, at_s * S, source) is (source == HERE)
    (count,) = senders.counts().values()
    assert (count.source, count.received, count.intruder, count.refused, count.ours) == (HERE, 2, THERE, 2, False)
    senders.claim([KEY])  # also of one that was heard before
    assert not heard(senders, KEY, 3, 3 * S, HERE)
    assert [(one.intruder, one.refused, one.ours) for one in senders.counts().values()] == [(HERE, 3, True)]
    senders.claim([KEY], ours=False)
    assert heard(senders, KEY, 3, 3 * S, HERE)


def test_running_numbers_of_one_sender_follow_on() -> None:
    follow, others = ([255, 0, 1], [5, 7, *range(8, 16)]), ([0], [0, 1], [0, 0, 0], [5, 7, 8, 9], [9, 3, 200, 77, 78])
    for numbers in (*follow, *others):
        senders = Senders()
        assert all(heard(senders, KEY, seq, k * S, HERE) for k, seq in enumerate(numbers))
        assert senders.sound(KEY) is (numbers in follow)


def test_made_up_senders_and_unknown_ids_cost_bounded_memory() -> None:
    decoder, link = Decoder(), LinkDecoder(careful=True)
    frames = [beat(Encoder(sysid, compid)) for sysid in range(1, 256) for compid in range(1, 256)]
    ids = [(70_000 + k).to_bytes(3, "little") for k in range(20_000)]
    unknown = [b"\xfd\x01\x00\x00" + bytes([k & 0xFF, 9, 1]) + one + b"xyz" for k, one in enumerate(ids)]
    for warm in (frames[:2000], unknown[:2000]):
        for frame in warm:
            decoder.take(as_columns([(frame, 0)]))
            link.feed(as_columns([(frame, 0)], [THERE]), 0)
    flood = [(frame, k) for k, frame in enumerate((*frames, *unknown))]
    tracemalloc.start()
    for k in range(0, len(flood), 100):
        decoder.take(as_columns(flood[k : k + 100]))
    link.feed(as_columns([(frame, 0) for frame in frames], [THERE] * len(frames)), S)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (grown < 3e6, len(decoder.senders) <= SENDERS_MAX, len(link.vehicles)) == (True, True, 0)
    assert decoder.records == 22_000 + len(frames) + 2000


def test_a_careful_decoder_wants_two_heartbeats_of_one_sender() -> None:
    link, sender = LinkDecoder(careful=True), Sender()
    for k in range(3):
        chunks = sender.chunks(100)
        link.feed(as_columns(chunks, [HERE] * len(chunks)), chunks[-1][1])
        assert bool(link.vehicles) is (k > 0)
    assert (link.source(1), link.sources_since(2 * S), link.sources_since(30 * S)) == (HERE, [HERE], [])


def test_why_a_vehicle_waits_is_told_after_seconds() -> None:
    link, one, other = LinkDecoder(careful=True), *(MadeVehicle(1, Autopilot.ARDUPILOTMEGA) for _ in range(2))
    told: list[bool] = []
    for _ in range(100):
        beat(other.encoder)  # so their numbers are 100 apart
    for k in range(9):
        frames = [frame for pair in zip(one.samples(100), other.samples(100), strict=True) for frame in pair]
        at_ns = [k * S + n * S // len(frames) for n in range(len(frames))]
        link.feed(as_columns(list(zip(frames, at_ns, strict=True)), [HERE] * len(frames)), at_ns[-1])
        told.append(link.waiting.get(1, "").startswith("its frames are numbered as of two senders"))
    assert told == [False] * 5 + [True] * 4
    assert not link.vehicles


def stream(kind: int, sysid: int = 1, n: int = 300) -> list[tuple[int, bytes]]:
    """Frames of a vehicle of this MAV_TYPE at 100 Hz, a heartbeat a second, with their times since the start [us]."""
    vehicle = MadeVehicle(sysid, Autopilot.ARDUPILOTMEGA, kind)
    return [(10_000 * k, frame) for k in range(n) for frame in vehicle.samples(1)]


def tlog(path: Path, *streams: list[tuple[int, bytes]]) -> Path:
    frames = sorted((one for some in streams for one in some), key=lambda one: one[0])
    path.write_bytes(b"".join(tlog_record(START_US + t_us, frame) for t_us, frame in frames))
    return path


@pytest.mark.parametrize("kind", [0, 2, 13, 43, 1, 4, 11, 22])
def test_a_multirotor_of_a_telemetry_log_is_read_and_any_other_vehicle_refused(kind: int, tmp_path: Path) -> None:
    path = tlog(tmp_path / "a.tlog", stream(kind))
    if kind in MULTIROTORS:
        assert md.read_log(path).mav_type == kind
        return
    with pytest.raises(InputError, match=rf"a\.tlog: .*\(MAV_TYPE {kind}\): mavdiag judges multirotors only"):
        md.read_log(path)


def test_a_multirotor_beside_a_boat_is_read_and_the_boat_is_told(tmp_path: Path) -> None:
    path = tlog(tmp_path / "both.tlog", stream(11, sysid=1), stream(2, sysid=7))
    assert md.read_log(path).notes == (f"vehicle 1 is left out: {BOAT}",)
    assert [one.vehicle for one in vehicle_stream(path)] == [7]
    with pytest.raises(InputError, match=r"MAV_TYPE 11"):
        md.read_log(path, vehicle=1)


@pytest.mark.parametrize(
    ("texts", "parameters", "kind"),
    [
        (["ArduCopter V4.5.6 (bbf0b066)"], {"FRAME_CLASS": 1.0}, 2),
        (["ArduCopter V4.3.6 (0c5e999c)"], {"FRAME_CLASS": 4.0}, 14),
        (["APM:Copter V3.3-dev (ae3192b8)", "PX4: 6013 NuttX: 1e53", "Frame: QUAD"], {"FRAME": 1.0}, 2),
        (["APM:Copter V3.4.6 (1)", "Frame: Y6"], {"FRAME": 10.0}, 13),
        (["Rover is a word"], {}, None),
        (["ArduRover V4.2.3 (3fc3011a)"], {"FRAME_CLASS": 2.0}, "a boat (MAV_TYPE 11)"),
        (["ArduPlane V4.5.1 (1)"], {"Q_ENABLE": 1.0}, "a plane (MAV_TYPE 1)"),
        (["ArduCopter V4.4.0 (1)"], {"FRAME_CLASS": 6.0}, "a helicopter (MAV_TYPE 4)"),
    ],
)
def test_a_dataflash_log_tells_it_by_firmware_and_frame(
    texts: list[str], parameters: dict[str, float], kind: int | str | None, tmp_path: Path
) -> None:
    path = binary(tmp_path, texts, parameters)
    if not isinstance(kind, str):
        assert md.read_log(path).mav_type == kind
        return
    with pytest.raises(InputError) as caught:
        md.read_log(path)
    assert str(caught.value).endswith(f"{kind}: mavdiag judges multirotors only")


def binary(folder: Path, texts: list[str], parameters: dict[str, float]) -> Path:
    records = [PARM.record(1, name.encode(), value) for name, value in parameters.items()]
    records += [MSG.record(2, text.encode()) for text in texts]
    records += [IMU.record(3 + k, 0, 0, 0, 0, 0, 0, -9.8) for k in range(30)]
    path = folder / "log.bin"
    path.write_bytes(dataflash([PARM, MSG, IMU], records))
    return path


@pytest.mark.parametrize(
    ("types", "name"), [([2, 2], ""), ([10, 10], "a rover"), ([22], "a VTOL"), ([2, 2, 1], ""), ([], "a submarine")]
)
def test_a_ulog_tells_it_by_the_vehicle_s_state_or_a_parameter(types: list[int], name: str, tmp_path: Path) -> None:
    records = [STATUS.record(10 + k, 2, kind) for k, kind in enumerate(types)]
    key, path = b"int32_t MAV_TYPE", tmp_path / "log.ulg"
    records += [] if types else [ulog_message("P", bytes([len(key)]) + key + (12).to_bytes(4, "little"))]
    path.write_bytes(ulog([SENSORS, STATUS], [*records, SENSORS.record(9, *[0.0] * 6)]))
    if not name:
        assert md.read_log(path).mav_type == 2
        return
    with pytest.raises(InputError, match=rf"{name} \(MAV_TYPE"):
        md.read_log(path)


@pytest.mark.parametrize("careful", [False, True])
def test_on_a_link_only_a_multirotor_enters(careful: bool) -> None:
    decoder = LinkDecoder(careful=careful)
    wrong = Encoder(7, 1).encode(MessageId.HEARTBEAT, 11, 3, 128, 0, 4, 3)  # made up or damaged: it keeps nobody out
    decoder.feed(as_columns([(wrong, 0)]), 0)
    for t_us, frame in sorted([*stream(11, sysid=1, n=600), *stream(2, sysid=7, n=600)], key=lambda one: one[0]):
        decoder.feed(as_columns([(frame, 1_000 * t_us)]), 1_000 * t_us)
    assert (list(decoder.vehicles), decoder.waiting) == ([7], {1: BOAT})


def series(signal: Signal, t_s: FloatArray, values: FloatArray, late_s: float = 0.0) -> Series:
    t_ns = np.round((t_s + late_s) * NS_PER_S).astype(np.int64)
    return Series(signal, t_ns, t_ns, values)


def angles(t: FloatArray) -> FloatArray:
    """Of a vehicle that rolls, pitches and turns its nose."""
    return np.stack((0.3 * np.sin(2 * t), 0.2 * np.sin(3 * t + 1), 0.5 * t + 0.4 * np.sin(t)), axis=1)


def pair(scale: FloatArray, late_s: float, seed: int = 1) -> tuple[Series, Series]:
    """Gyro at 100 Hz with noise, in other units and stamped late, and the attitude at 25 Hz, wrapped."""
    t, slow = np.arange(0, SECONDS, 0.01), np.arange(0, SECONDS, 0.04)
    noise = np.random.default_rng(seed).normal(0, 0.02, (len(t), 3))
    wrapped = (angles(slow) + np.pi) % (2 * np.pi) - np.pi
    gyro = series(Signal.BODY_RATE, t, (body_rates(angles(t), 0.01) + noise) * scale, late_s)
    return gyro, series(Signal.ATTITUDE, slow, wrapped)


@pytest.mark.parametrize("late_s", [0.0, 0.03, -0.05])
def test_the_attitudes_slope_gives_scale_sign_and_delay_of_the_gyro(late_s: float) -> None:
    gyro, attitude = pair(np.array([1.0, -1.0, 1.0 / DEG]), late_s)
    roll, pitch, yaw = gyro_checks(gyro, attitude)
    assert (roll.scale, pitch.scale) == pytest.approx((1.0, -1.0), abs=0.03)
    assert yaw.scale == pytest.approx(1.0 / DEG, rel=0.03)
    assert (roll.delay_s, pitch.delay_s, yaw.delay_s) == pytest.approx((late_s,) * 3, abs=0.006)
    assert roll.verdict == "right"
    assert (pitch.verdict, yaw.verdict) == ("turns the wrong way; scale right", "wrong scale: deg/s")


def test_rounding_damage_and_a_tumble_do_not_hide_that_the_gyro_is_right_and_a_slow_one_is_not_compared() -> None:
    t = np.arange(0, SECONDS, 0.0025)
    calm, step = 0.1 * angles(t), 0.01 * DEG  # ArduPilot logs hundredths of a degree, at up to 400 Hz
    rates, rounded = body_rates(calm, 0.0025), np.round(calm / step) * step
    rates[4000], rounded[5000] = 1e25, 1.7  # damaged
    rounded[-400:] = np.random.default_rng(1).uniform(1.5, 2.5, (400, 3))
    gyro, attitude = series(Signal.BODY_RATE, t, rates), series(Signal.ATTITUDE, t, rounded)
    assert [one.verdict for one in gyro_checks(gyro, attitude)] == ["right"] * 3
    assert gyro_checks(gyro.where(slice(None, None, 100)), attitude) == ()


@pytest.mark.parametrize(
    ("profile", "felt_g", "said"),
    [("qdrone2", 1.3, ""), ("qdrone2", 2.05, "2.0 g: --profile spec"),
        ("spec", 0.49, "0.5 g: --profile ardupilot"), ("px4", 9.8, "9.8 g")],
)  # fmt: skip
def test_a_profile_against_gravity_is_told_with_the_one_that_fits(profile: str, felt_g: float, said: str) -> None:
    assert scale_doubt(PROFILES[profile], felt_g) == said


def frames(count: int, sysid: int = 1) -> list[bytes]:
    encoder = Encoder(sysid, 1)
    return [encoder.encode(MessageId.RAW_IMU, 1000 * k, 1, 2, -1000, 3, 4, 5) for k in range(count)]


def test_l7_what_a_byte_stream_brought_at_once_goes_on_in_packets_of_whole_frames() -> None:
    """Datagrams of up to 4.4 kB went out: a client lost 46 % of the messages behind them."""
    (near, _), (behind, far) = (memory_pair(clock=lambda: 0) for _ in range(2))
    stream, passed, decoder = b"".join(frames(200)), list[tuple[bytes, int]](), Decoder()
    LinkDecoder(datagrams=False, passed=passed).feed(as_columns([(stream[:4401], 0), (stream[4401:], 0)]), 0)
    Relay(near, [behind]).pass_on(passed)
    messages = far.receive(0.0)
    assert messages.sizes.max() <= DATAGRAM_BYTES
    assert len(decoder.take(messages)) == 200


def test_a_byte_stream_is_put_together_wherever_it_was_cut() -> None:
    near, vehicle = memory_pair(clock=lambda: 0)
    behind, far = memory_pair(clock=lambda: 0)
    behind.datagrams = False
    stream, relay = b"".join(frames(20)), Relay(near, [behind])
    for k in range(0, len(stream), 7):
        far.send(stream[k : k + 7])
        relay.pass_on([])
    assert [data for data, _ in vehicle.receive(0.0)] == frames(20)


def test_what_is_for_one_vehicle_goes_to_where_it_is_heard_from_alone() -> None:
    """A drone with the same system id on the same port was told to land, too."""
    told: list[tuple[object, bytes]] = []
    near: Any = SimpleNamespace(send=lambda data: told.append(("all", data)), answer=lambda *to: told.append(to[::-1]))
    relay = Relay(near, [])
    relay.send(b"text")
    relay.send(b"land", to_all=False, source="there")
    relay.flush()
    assert told == [("all", b"text"), ("there", b"land")]


def handled(message: bytes, *vehicles: int) -> Handled:
    streams = {sysid: SimpleNamespace(profile=PROFILES["ardupilot"]) for sysid in vehicles}
    fleet: Any = SimpleNamespace(vehicles=dict.fromkeys(vehicles), link=SimpleNamespace(vehicles=streams))
    return Requests(fleet, True, component.Sender).from_behind([message], Instant(0))


def interval(target: tuple[int, int], msgid: int, command: int = MavCmd.SET_MESSAGE_INTERVAL) -> bytes:
    return STATION.encode(MessageId.COMMAND_LONG, *target, command, 0, msgid, 250_000)


def group(number: int, target: tuple[int, int] = (1, 1)) -> bytes:
    return STATION.encode(MessageId.REQUEST_DATA_STREAM, *target, number, 4, 1)


@pytest.mark.parametrize("message", [interval((1, 1), MessageId.RAW_IMU), BY_INT])
def test_an_interval_of_a_message_that_is_needed_is_denied_in_the_autopilots_name(message: bytes) -> None:
    found = handled(message, 1)
    assert found.passed == []
    [ack] = Decoder().feed(found.answers[0])
    assert (ack.sysid, ack.compid, ack.msgid) == (1, 1, MessageId.COMMAND_ACK)
    told = ack.numbers("command", "result", "target_system", "target_component")
    assert told == (MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED, 255, Component.MISSIONPLANNER)


@pytest.mark.parametrize(
    ("message", "vehicles"),
    [
        (interval((1, 1), MessageId.SYS_STATUS), (1,)),
        (interval((2, 1), MessageId.RAW_IMU), (1,)),  # another vehicle
        (interval((1, 100), MessageId.RAW_IMU), (1,)),  # a camera
        (interval((1, 1), MessageId.RAW_IMU, MavCmd.REQUEST_MESSAGE), (1,)),
        (group(6), (1,)),
        (group(1, (2, 1)), (1,)),
        (group(1, (1, 100)), (1,)),
        (group(1, (0, 0)), (1, 2)),
        (STATION.encode(MessageId.PARAM_REQUEST_LIST, 1, 1), (1,)),
        (group(0, (0, 0)), ()),
        (interval((0, 0), MessageId.RAW_IMU), ()),
    ],
)
def test_everything_else_passes(message: bytes, vehicles: tuple[int, ...]) -> None:
    assert handled(message, *vehicles) == Handled([message])


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0)])
def test_a_group_that_holds_what_is_needed_is_kept_back_and_noted(target: tuple[int, int]) -> None:
    for number in (1, 12):
        found = handled(group(number, target), 1)
        assert (found.passed, found.answers, len(found.turns)) == ([], [], 1)


def test_the_first_answer_to_a_timesync_tells_the_round_trip_and_requests_are_answered() -> None:
    timesync, encoder = Timesync(), Encoder(1, 1)
    assert timesync.step((), NS_PER_S, alive=True) == [TimesyncMessage(0, NS_PER_S)]
    for host_ns in (1_040_000_000, 3 * NS_PER_S):  # a copy comes later
        answer = Decoder().feed(encoder.encode(MessageId.TIMESYNC, 5, NS_PER_S), host_ns)
        assert timesync.step(answer, host_ns, alive=True) == []
        assert timesync.round_trip_s == pytest.approx(0.04)
    asked = Decoder().feed(encoder.encode(MessageId.TIMESYNC, 0, 77), 4 * NS_PER_S)
    assert timesync.step(asked, 4 * NS_PER_S, alive=True) == [TimesyncMessage(4 * NS_PER_S, 77)]
