"""Bytes of a link become vehicles: who enters, what is told of those who do not, and what is kept of made-up ones."""

import numpy as np
import pytest
from memory_port import memory_pair

from mavdiag.errors import InputError, UsageError
from mavdiag.link.codec import Encoder, message_name
from mavdiag.link.link import Link, open_link
from mavdiag.link.messages import Autopilot, Component, MavCmd, MavResult, MavType, MessageId, ModeFlag
from mavdiag.link.profiles import PROFILES, with_imu
from mavdiag.link.vehicles import WAITING_FRAMES, Ack, Command, LinkDecoder, VehicleStream
from mavdiag.telemetry import Signal

S = 1_000_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)


class Sender:
    """A vehicle at 100 Hz, in frames."""

    def __init__(self, sysid: int = 1, autopilot: int = Autopilot.ARDUPILOTMEGA, weight: int = 1000) -> None:
        self.encoder = Encoder(sysid, Component.AUTOPILOT1)
        self._autopilot, self._weight = autopilot, weight
        self.k = 0

    def heartbeat(self, kind: MavType = MavType.QUADROTOR) -> bytes:
        return self.encoder.encode(MessageId.HEARTBEAT, kind, self._autopilot, ModeFlag.SAFETY_ARMED, 0, 4, 3)

    def chunks(self, n: int, imu: int = MessageId.RAW_IMU) -> list[tuple[bytes, int]]:
        """A datagram for each of the next n samples."""
        found = []
        for k in range(self.k, self.k + n):
            data = self.heartbeat() if k % 100 == 0 else b""
            stamp = 1000 * (5000 + 10 * k) if imu in (MessageId.RAW_IMU, MessageId.HIGHRES_IMU) else 5000 + 10 * k
            data += self.encoder.encode(MessageId.ATTITUDE_TARGET, 5000 + 10 * k, 0, LEVEL, 0, 0, 0, 0.5)
            data += self.encoder.encode(imu, stamp, 0, 0, -self._weight, 1, 2, 3)
            found.append((data, (k + 1) * S // 100))
        self.k += n
        return found


def run(decoder: LinkDecoder, chunks: list[tuple[bytes, int]]) -> int:
    """Feed chunk by chunk; how many gyro samples came out."""
    found = 0
    for chunk in chunks:
        for received in decoder.feed([chunk], chunk[1]).values():
            rate = received.telemetry.get(Signal.BODY_RATE)
            found += 0 if rate is None else len(rate)
    return found


def test_a_vehicle_enters_when_its_profile_is_clear_and_brings_its_frames_along() -> None:
    decoder, sender = LinkDecoder(), Sender()
    assert run(decoder, sender.chunks(90)) == 0
    assert not decoder.vehicles
    assert run(decoder, sender.chunks(210)) == 300
    stream = decoder.vehicles[1]
    assert stream.profile is PROFILES["ardupilot"]
    assert (stream.vehicle_ns, stream.reboots, stream.dropped) == (7_990_000_000, 0, 0)
    assert stream.timeline.t_ns == stream.vehicle_ns
    assert decoder.waiting == {}
    count = decoder.count(1)
    assert count is not None
    assert (count.received, count.lost, decoder.count(7)) == (603, 0, None)
    told = LinkDecoder(PROFILES["spec"])  # then there is no wait
    assert run(told, Sender().chunks(10)) == 10
    assert told.vehicles[1].profile is PROFILES["spec"]


def test_b18_a_vehicle_of_unknown_profile_waits_and_says_why() -> None:
    decoder = LinkDecoder()
    assert run(decoder, Sender(autopilot=Autopilot.GENERIC, weight=16_384).chunks(300)) == 0
    assert not decoder.vehicles
    assert all(words in decoder.waiting[1] for words in ("RAW_IMU counts 16384", "give --profile"))


def test_b19_a_vehicle_without_its_profiles_imu_is_read_by_the_one_it_sends() -> None:
    decoder = LinkDecoder()
    assert run(decoder, Sender(autopilot=Autopilot.PX4).chunks(300, MessageId.SCALED_IMU)) == 300
    assert decoder.vehicles[1].profile.name == "px4"
    assert decoder.vehicles[1].profile.imu is MessageId.SCALED_IMU


@pytest.mark.parametrize("size", [1, 7, 600])
def test_one_frame_of_a_slow_imu_message_does_not_settle_the_choice(size: int) -> None:
    """RAW_IMU comes once a second and SCALED_IMU2 at 100 Hz: the log reader takes the second, and so does the link."""
    sender, decoder = Sender(), LinkDecoder(PROFILES["ardupilot"])
    chunks = []
    for k in range(5):
        chunks += sender.chunks(2 if k else 1)
        chunks += sender.chunks(100, MessageId.SCALED_IMU2)
    frames = [frame for chunk in chunks for frame in decoder.decoder.feed(*chunk)]
    stream, samples = VehicleStream(PROFILES["ardupilot"]), 0
    for at in range(0, len(frames), size):
        gyro = stream.step(frames[at : at + size]).get(Signal.BODY_RATE)
        samples += 0 if gyro is None else len(gyro)
    assert stream.profile.imu is with_imu(PROFILES["ardupilot"], frames).imu is MessageId.SCALED_IMU2
    assert samples >= 470  # of 500


def test_only_vehicles_enter_and_of_them_the_one_wanted() -> None:
    decoder, computer = LinkDecoder(PROFILES["ardupilot"]), Encoder(1, Component.ONBOARD_COMPUTER)
    beat = computer.encode(MessageId.HEARTBEAT, MavType.ONBOARD_CONTROLLER, Autopilot.INVALID, 0, 0, 4, 3)
    station = Sender(255, autopilot=Autopilot.INVALID).heartbeat(MavType.GCS)
    assert run(decoder, [(station, 0), (beat, 0), *Sender(255, Autopilot.INVALID).chunks(5)]) == 0
    assert not decoder.vehicles
    wanted = LinkDecoder(only=7)
    chunks = [pair for both in zip(Sender(1).chunks(200), Sender(7).chunks(200), strict=True) for pair in both]
    assert run(wanted, chunks) == 200
    assert list(wanted.vehicles) == [7]


def test_a_fast_vehicle_enters_though_its_heartbeat_is_long_past() -> None:
    decoder, sender = LinkDecoder(), Sender()
    chunks = [(data, k * S // 1000) for k, (data, _) in enumerate(sender.chunks(90))]
    frames = [(sender.encoder.encode(MessageId.ATTITUDE, 5900), S // 10)] * 600
    decoder.feed([*chunks, *frames], S // 10)
    assert list(decoder.vehicles) == [1]


def test_acknowledgements_and_commands_are_handed_out() -> None:
    decoder, sender, station = LinkDecoder(PROFILES["ardupilot"]), Sender(), Encoder(255, 190)
    run(decoder, sender.chunks(5))
    ack = (MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED, 0, 0, 1)
    ours = sender.encoder.encode(MessageId.COMMAND_ACK, *ack, Component.ONBOARD_COMPUTER)
    other = sender.encoder.encode(MessageId.COMMAND_ACK, *ack, Component.MISSIONPLANNER)
    computer = Component.ONBOARD_COMPUTER
    targets = ((1, computer), (1, Component.AUTOPILOT1), (9, computer))
    ask = [station.encode(MessageId.COMMAND_LONG, *target, MavCmd.REQUEST_MESSAGE) for target in targets]
    received = decoder.feed([(b"".join([ours, other, *ask]), S)], S)
    assert list(received) == [1]
    assert received[1].acks == (Ack(MavCmd.SET_MESSAGE_INTERVAL, MavResult.DENIED),)
    assert received[1].commands == (Command(MavCmd.REQUEST_MESSAGE, 255, 190),)
    assert received[1].present
    assert not decoder.feed([(b"".join(ask), S)], S)[1].present


def test_b28_a_truncated_datagram_is_not_joined_to_the_next() -> None:
    decoder, one, other = LinkDecoder(PROFILES["ardupilot"]), Sender(1), Sender(2)
    run(decoder, [*one.chunks(2), *other.chunks(2)])
    (whole, at), (cut, _) = other.chunks(1)[0], one.chunks(1)[0]
    assert run(decoder, [(cut[:-20], at), (whole, at)]) == 1
    assert decoder.decoder.count.bad_crc == 0


def test_made_up_senders_cost_a_bounded_amount() -> None:
    decoder, rng = LinkDecoder(), np.random.default_rng(0)
    encoders = {sysid: Encoder(sysid, 1) for sysid in range(1, 256)}
    for k in range(3000):
        frames = [encoders[int(sysid)].encode(MessageId.ATTITUDE, k) for sysid in rng.integers(1, 4, 20)]
        decoder.feed([(b"".join(frames), k)], k)
    for sysid in encoders:
        decoder.feed([(encoders[sysid].encode(MessageId.ATTITUDE, 1), 1)], 1)
    assert not decoder.vehicles
    pending = decoder._pending
    assert len(pending) == 255
    assert max(len(one.frames) for one in pending.values()) == WAITING_FRAMES


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
        vehicle = link.vehicle
        assert (vehicle, found) == (1, 50)
        assert link.stream is not None
    assert not near.connected
    far.close()


def test_a_link_without_a_vehicle_says_why() -> None:
    near, far = memory_pair()
    link = Link(near)
    with pytest.raises(InputError, match="nothing was received"):
        link.record(0.01)
    far.send(Encoder(255, 190).encode(MessageId.ATTITUDE, 1))
    with pytest.raises(InputError, match="system ids 255 send"):
        link.record(0.01)
    for sender in (Sender(1), Sender(2)):
        for data, _ in sender.chunks(300):
            far.send(data)
    with pytest.raises(InputError, match="vehicles 1, 2; choose one"):
        link.record(2.0)
    far.close()
    link.close()


def test_a_link_of_an_unknown_profile_is_refused() -> None:
    with pytest.raises(UsageError, match="betaflight"):
        open_link("udpin:127.0.0.1:0", profile="betaflight")
    with open_link("udpin:127.0.0.1:0") as link:
        assert link.address.startswith("udpin:127.0.0.1:")


def attitudes(sender: Sender, n: int) -> list[tuple[bytes, int]]:
    """A heartbeat a second and ATTITUDE at 10 Hz, with body rates, and no IMU message."""
    found = []
    for k in range(n):
        data = sender.heartbeat() if k % 10 == 0 else b""
        t_ms = 5000 + 100 * k
        data += sender.encoder.encode(MessageId.ATTITUDE, t_ms, 0.1, 0.2, 0.3, 0.01, 0.02, 0.03)
        found.append((data, (k + 1) * S // 10))
    return found


def test_the_rates_of_attitude_are_read_only_where_no_imu_message_comes_for_long_and_only_until_one_comes() -> None:
    decoder, sender = LinkDecoder(), Sender()
    assert run(decoder, attitudes(sender, 290)) == 0
    assert decoder.vehicles[1].profile.imu == MessageId.RAW_IMU
    sender = Sender()
    decoder = LinkDecoder()
    rows = attitudes(sender, 400)
    assert run(decoder, rows[:-1]) == pytest.approx(100, abs=12)
    stream = decoder.vehicles[1]
    assert message_name(stream.profile.imu) == "ATTITUDE"
    received = decoder.feed(rows[-1:], rows[-1][1])
    assert received[1].telemetry[Signal.BODY_RATE].values.tolist() == [pytest.approx([0.01, 0.02, 0.03])]
    sender.k = 4000
    raw = [(data, at_ns) for data, at_ns in sender.chunks(50)]
    assert run(decoder, raw) == 50
    assert message_name(stream.profile.imu) == "RAW_IMU"
