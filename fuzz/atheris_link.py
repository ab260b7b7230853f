"""Coverage-guided fuzzing of the way from datagrams to a session's effects.

    PYTHONPATH=tests python fuzz/atheris_link.py fuzz/corpus -max_total_time=600

The input is a little program: each operation is one byte and what it needs. It sends raw bytes, or a frame with a valid
checksum and a payload of its own choice, as any sender, or a piece of genuine flight, or lets time pass. Whatever is
sent, nothing may raise. Needs `atheris` (dependency group `fuzz`).
"""

import sys

import atheris

with atheris.instrument_imports(include=["mavdiag.link", "detector"]):
    from detector.config import SessionSettings
    from detector.fleet import Fleet
    from detector.values import SessionSpec
    from mavdiag.link.codec import Encoder
    from mavdiag.link.datagrams import as_columns
    from mavdiag.link.messages import MessageId
    from mavdiag.link.samples import SOURCES

from made_session import baseline_for
from made_vehicle import START_NS, MadeVehicle

from mavdiag.telemetry import Instant

IDS = sorted({int(one) for one in MessageId} | {source.message for source in SOURCES})
BASELINE = baseline_for()
FLIGHT = MadeVehicle(1).samples(8000)
SETTINGS = SessionSettings()
MOST = 64  # operations of one input
STEPS_NS = [0, 1_000_000, 40_000_000, 1_000_000_000, 11_000_000_000, 1 << 45]


def one_input(data: bytes) -> None:
    """Run one program."""
    wire = atheris.FuzzedDataProvider(data)
    datagrams = wire.ConsumeBool()
    only = 1 if wire.ConsumeBool() else None
    fleet = Fleet(
        lambda sysid, profile: SessionSpec(profile, BASELINE, SETTINGS), profile=None, only=only, datagrams=datagrams
    )
    flown, now_ns, chunks = 0, START_NS, list[tuple[bytes, int]]()
    for _ in range(MOST):
        if not wire.remaining_bytes():
            break
        match wire.ConsumeIntInRange(0, 3):
            case 0:
                chunks.append((wire.ConsumeBytes(wire.ConsumeIntInRange(0, 300)), now_ns))
            case 1:
                encoder = Encoder(wire.ConsumeIntInRange(1, 4), wire.PickValueInList([1, 2, 190, 191]))
                msgid = wire.PickValueInList(IDS)
                chunks.append((encoder.encode_payload(msgid, wire.ConsumeBytes(wire.ConsumeIntInRange(0, 64))), now_ns))
            case 2:
                before, flown = flown, flown + wire.ConsumeIntInRange(1, 240)
                chunks += [(frame, now_ns) for frame in FLIGHT[before:flown]]
            case _:
                now_ns += wire.PickValueInList(STEPS_NS)
                fleet.take(as_columns(chunks), Instant(now_ns))
                fleet.judge(Instant(now_ns))
                sum(vehicle.count.received for vehicle in fleet.vehicles.values())
                chunks = []
    fleet.take(as_columns(chunks), Instant(now_ns))
    fleet.judge(Instant(now_ns))
    fleet.finish(Instant(now_ns))


def main() -> None:
    """Run until the time that the options of libFuzzer give is over."""
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
