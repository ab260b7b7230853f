"""How fast bytes become frames and samples, against pymavlink on the same bytes in the same run.

    python benchmarks/decode.py [--seconds 4] [--repeats 15]

The stream is one emulated QDrone 2 at 1 kHz with its slower messages. The contenders take turns, in changing order; a
figure is the median over the repeats, a ratio the median of the ratios within a repeat.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as dialect

from mavdiag.link.codec import Decoder, Encoder, Frame, frames_of
from mavdiag.link.messages import MessageId
from mavdiag.link.profiles import PROFILES
from mavdiag.link.samples import SampleDecoder, SampleState
from mavdiag.logs.tlog import decode_tlog, tlog_record

CHUNK_BYTES = 1400  # what a UDP datagram carries at most
SEED = 1


def stream(seconds: float) -> list[bytes]:
    """Frames as the plant sends them: setpoint and IMU at 1 kHz, the rest at their own rates."""
    rng, encoder, frames = np.random.default_rng(SEED), Encoder(1, 1), []
    for k in range(round(1000 * seconds)):
        counts = rng.integers(-1000, 1000, 6).tolist()
        q, rates = (1.0, *rng.normal(0, 0.1, 3).tolist()), rng.normal(0, 0.3, 3).tolist()
        frames.append(encoder.encode(MessageId.ATTITUDE_TARGET, k, 0, q, *rates, 0.5))
        frames.append(encoder.encode(MessageId.RAW_IMU, 1000 * k, *counts, 0, 0, 0))
        if k % 20 == 0:
            frames.append(encoder.encode(MessageId.ATTITUDE, k, *q[1:], *rates))
            frames.append(encoder.encode(MessageId.HIGHRES_IMU, 1000 * k, *rates, *rates))
            frames.append(encoder.encode(MessageId.SERVO_OUTPUT_RAW, 1000 * k, 0, 1500, 1510, 1490, 1505))
            frames.append(encoder.encode(MessageId.LOCAL_POSITION_NED, k, *rates, *rates))
        if k % 500 == 0:
            frames.append(encoder.encode(MessageId.SYS_STATUS, 1, 1, 1, 0, 15_200))
            frames.append(encoder.encode(MessageId.HEARTBEAT, 2, 3, 128, 0, 4, 3))
    return frames


def seconds_of(work: Callable[[], object]) -> float:
    """Processor time of one run: another program's share of the machine does not count."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def race(title: str, count: int, unit: str, repeats: int, *contenders: tuple[str, Callable[[], object]]) -> None:
    """Run the contenders in turns and print each one's time, and its ratio to the first, the peer."""
    times: list[list[float]] = [[] for _ in contenders]
    for repeat in range(repeats):
        order = range(len(contenders)) if repeat % 2 else range(len(contenders) - 1, -1, -1)
        for index in order:
            times[index].append(seconds_of(contenders[index][1]))
    print(f"\n{title}")
    for (name, _), own in zip(contenders, times, strict=True):
        ratio = statistics.median(peer / mine for peer, mine in zip(times[0], own, strict=True))
        print(f"  {name:44} {1e6 * statistics.median(own) / count:8.2f} us/{unit}   {ratio:6.2f} x")


def chunks_of(data: bytes) -> list[bytes]:
    """The stream cut as datagrams cut it, at frame borders or not."""
    return [data[k : k + CHUNK_BYTES] for k in range(0, len(data), CHUNK_BYTES)]


def decode_pymavlink(chunks: Sequence[bytes]) -> int:
    """The peer. Robust parsing, as on a real link."""
    mav = dialect.MAVLink(None)
    mav.robust_parsing = True
    return sum(len(mav.parse_buffer(chunk) or ()) for chunk in chunks)


def decode_frames(chunks: Sequence[bytes], wanted: frozenset[int] | None = None) -> list[Frame]:
    """All checked; payloads as bytes."""
    decoder = Decoder(wanted)
    return [frame for chunk in chunks for frame in decoder.feed(chunk, 0)]


def decode_fields(chunks: Sequence[bytes]) -> int:
    """All checked, and every field of every message unpacked, as the peer does."""
    decoder = Decoder()
    return sum(len(frame.fields) for chunk in chunks for frame in decoder.feed(chunk, 0))


def race_decoders(frames: Sequence[bytes], repeats: int) -> None:
    """pymavlink's parse_buffer against the decoder."""
    chunks = chunks_of(b"".join(frames))
    converter = SampleDecoder(PROFILES["qdrone2"])
    assert decode_pymavlink(chunks) == len(decode_frames(chunks)) == len(frames)
    race(
        f"Decode {len(frames)} messages, {sum(map(len, frames))} bytes",
        len(frames),
        "message",
        repeats,
        ("pymavlink MAVLink.parse_buffer (the peer)", lambda: decode_pymavlink(chunks)),
        ("Decoder, every field unpacked", lambda: decode_fields(chunks)),
        ("Decoder, payloads", lambda: decode_frames(chunks)),
        ("Decoder, payloads the detector wants", lambda: decode_frames(chunks, converter.wanted)),
    )


def race_encoders(repeats: int, n: int = 3000) -> None:
    """pymavlink's pack against the encoder, for the two fast messages."""
    mav, encoder = dialect.MAVLink(None, 1, 1), Encoder(1, 1)
    target, imu = dialect.mavlink_map[83], dialect.mavlink_map[27]
    setpoint = (5, 0, (1.0, 0.1, 0.2, 0.3), 0.1, 0.2, 0.3, 0.5)
    counts = (5_000, 1, 2, -1000, 4, 5, 6, 0, 0, 0, 0, 0)
    tilted = (5_000, 1.4, 2.3, -1000.2, 4.4, 5.1, 6.9, 0, 0, 0, 0, 0)
    race(
        f"Encode {n} x ATTITUDE_TARGET + RAW_IMU",
        2 * n,
        "message",
        repeats,
        (
            "pymavlink message(...).pack (the peer)",
            lambda: [(target(*setpoint).pack(mav), imu(*counts).pack(mav)) for _ in range(n)],
        ),
        ("Encoder.encode", lambda: [(encoder.encode(83, *setpoint), encoder.encode(27, *counts)) for _ in range(n)]),
        (
            "Encoder.encode, counts still to be rounded",
            lambda: [(encoder.encode(83, *setpoint), encoder.encode(27, *tilted)) for _ in range(n)],
        ),
    )


def race_blocks(frames: Sequence[bytes], repeats: int) -> None:
    """Frames to SI samples in blocks of some pairs, against unpacking the same frames one by one."""
    singly = [frame._replace(host_ns=500_000 * k) for k, frame in enumerate(decode_frames([b"".join(frames)]))]
    received = frames_of(singly)  # columns, as a link's decoder hands them out
    pairs = received.counts()[MessageId.RAW_IMU]
    converter = SampleDecoder(PROFILES["qdrone2"])

    def convert(block: int) -> SampleState:
        state = SampleState()
        for k in range(0, len(received), 2 * block):
            converter.step(state, received.where(slice(k, k + 2 * block)))
        return state

    race(
        f"Convert {pairs} pairs of setpoint and IMU sample",
        pairs,
        "pair",
        repeats,
        ("Frame.fields alone (the peer)", lambda: [frame.fields for frame in singly]),
        *((f"SampleDecoder, blocks of {block} pairs", lambda block=block: convert(block)) for block in (20, 50, 200)),
    )


def race_logs(frames: Sequence[bytes], repeats: int) -> None:
    """The same stream as a telemetry log."""
    data = b"".join(tlog_record(1_000 * k, frame) for k, frame in enumerate(frames))
    places = np.cumsum([0, *(len(frame) + 8 for frame in frames)]).tolist()

    def peer() -> int:
        mav = dialect.MAVLink(None)
        return sum(len(mav.parse_buffer(data[a + 8 : b]) or ()) for a, b in pairwise(places))

    assert peer() == decode_tlog([data]).records
    title = f"Decode a telemetry log of {len(data) / 1e6:.1f} MB"
    race(
        title,
        len(data) // 1000,
        "kB",
        repeats,
        ("pymavlink, told the places (the peer)", peer),
        ("decode_tlog", lambda: decode_tlog([data])),
    )


def main() -> None:
    """Run all races."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    frames = stream(options.seconds)
    race_decoders(frames, options.repeats)
    race_encoders(options.repeats)
    race_blocks(frames, options.repeats)
    race_logs(frames, options.repeats)


if __name__ == "__main__":
    main()
