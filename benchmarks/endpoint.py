"""What a UDP datagram costs to receive: the endpoint against a bare socket and against mavutil, in the same run.

python benchmarks/endpoint.py
"""

import socket
import time
from collections.abc import Callable
from contextlib import closing

from pymavlink import mavutil

from mavdiag.link.codec import Decoder, Encoder
from mavdiag.link.messages import MessageId
from mavdiag.link.ports import open_endpoint

BURST, REPEATS = 100, 100  # a burst fits the default buffer of a socket, which mavutil keeps


def microseconds(send: Callable[[bytes], object], receive: Callable[[], int]) -> float:
    """Least cost of one datagram over the repeats: what is sent first is received in one go."""
    encoder, best = Encoder(1, 1), float("inf")
    for _ in range(REPEATS):
        for k in range(BURST):
            send(encoder.encode(MessageId.RAW_IMU, 1000 * k, 1, 2, -1000, 4, 5, 6))
        begin, n = time.perf_counter(), 0
        while n < BURST:
            n += receive()
        best = min(best, (time.perf_counter() - begin) / BURST)
    return 1e6 * best


def bare() -> float:
    """A socket read in a loop."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        return microseconds(sender.send, lambda: bool(receiver.recvfrom(65_535)))


def ours(decode: bool) -> float:
    """The endpoint, and the decoder behind it."""
    decoder = Decoder()
    with (
        open_endpoint("udpin:127.0.0.1:0") as receiver,
        open_endpoint(receiver.address.replace("udpin", "udpout")) as sender,
    ):

        def receive() -> int:
            chunks = receiver.receive(1.0)
            if decode:
                return sum(len(decoder.feed(data, host_ns)) for data, host_ns in chunks)
            return len(chunks)

        return microseconds(sender.send, receive)


def theirs() -> float:
    """mavutil, which cannot receive without decoding."""
    with closing(mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")) as receiver:
        port = receiver.port.getsockname()[1]
        with open_endpoint(f"udpout:127.0.0.1:{port}") as sender:
            return microseconds(sender.send, lambda: receiver.recv_match(blocking=False) is not None)


def main() -> None:
    """Print the table."""
    reference = bare()
    rows = (
        ("bare socket, bytes only", reference),
        ("endpoint, bytes only", ours(decode=False)),
        ("endpoint and decoder, frames", ours(decode=True)),
        ("mavutil, messages", theirs()),
    )
    for name, cost in rows:
        print(f"{name:30} {cost:7.2f} us per datagram   {cost / reference:5.1f} x")


if __name__ == "__main__":
    main()
