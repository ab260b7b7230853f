"""Frames on their way through the daemon: cut between frames, at most one network packet each."""

from memory_port import memory_pair

from detector.relay import DATAGRAM_BYTES, Relay
from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import MessageId
from mavdiag.link.vehicles import LinkDecoder


def frames(count: int, sysid: int = 1) -> list[bytes]:
    encoder = Encoder(sysid, 1)
    return [encoder.encode(MessageId.RAW_IMU, 1000 * k, 1, 2, -1000, 3, 4, 5) for k in range(count)]


def decoded(messages: list[bytes]) -> int:
    decoder = Decoder()
    return sum(len(decoder.feed_datagram(message, 0)) for message in messages)


def relayed(chunks: list[bytes], datagrams: bool) -> list[bytes]:
    """What a link behind gets of what the vehicle's link brought."""
    near, _ = memory_pair(clock=lambda: 0)
    behind, far = memory_pair(clock=lambda: 0)
    passed: list[tuple[bytes, int]] = []
    link = LinkDecoder(datagrams=datagrams, passed=passed)
    link.feed([(chunk, 0) for chunk in chunks], 0)
    Relay(near, [behind]).pass_on(passed)
    return [data for data, _ in far.receive(0.0)]


def test_l7_what_a_byte_stream_brought_at_once_goes_on_in_packets_of_whole_frames() -> None:
    """Datagrams of up to 4.4 kB went out: a client lost 46 % of the messages behind them."""
    stream = b"".join(frames(200))
    messages = relayed([stream[:4401], stream[4401:]], datagrams=False)
    assert max(map(len, messages)) <= DATAGRAM_BYTES
    assert decoded(messages) == 200


def test_b28_a_truncated_datagram_of_one_peer_does_not_spoil_the_next_of_another() -> None:
    first, second = frames(1, sysid=1)[0], frames(3, sysid=2)
    assert relayed([first[:20], *second], datagrams=True) == [b"".join(second)]


def test_a_byte_stream_is_put_together_wherever_it_was_cut() -> None:
    near, vehicle = memory_pair(clock=lambda: 0)
    behind, far = memory_pair(clock=lambda: 0)
    behind.datagrams = False
    stream, relay = b"".join(frames(20)), Relay(near, [behind])
    for k in range(0, len(stream), 7):
        far.send(stream[k : k + 7])
        relay.pass_on([])
    assert [data for data, _ in vehicle.receive(0.0)] == frames(20)
