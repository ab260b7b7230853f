"""A flight as a .tlog file, as fast as it goes: each message after its own time."""

from collections.abc import Callable, Iterator
from pathlib import Path

from mavdiag.errors import UsageError
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import Component
from mavdiag.logs.tlog import tlog_record
from sitl_plant.autopilot.imu_filters import ImuFilters
from sitl_plant.autopilot.stream import Streamer
from sitl_plant.options import FlightPlan
from sitl_plant.plant import STEP_NS, Plant, PlantSamples

EPOCH_US = 1_767_225_600_000_000  # 2026-01-01T00:00:00Z: a fixed start, so that equal options give equal files
BLOCK_STEPS = 1000


def recorded(plan: FlightPlan, duration_s: float, watch: Callable[[PlantSamples], None]) -> Iterator[tuple[int, bytes]]:
    """Every frame of a flight in order, with its flight time [ns]. watch: is shown every block's truth."""
    plant, filters = Plant(plan.config), ImuFilters(plan.dialect, plan.config.seed)
    schedule = plan.dialect.schedule(plan.rate_hz, plant.rotors)
    streamer, encode = (
        Streamer(plan.dialect, schedule),
        Encoder(plan.dialect.sysid, Component.AUTOPILOT1).encode_payload,
    )
    left = max(1, round(duration_s * 1e9 / STEP_NS))
    while left > 0:
        samples = plant.advance(min(BLOCK_STEPS, left))
        left -= len(samples)
        watch(samples)
        for t_ns, msgid, payload in streamer.step(filters.step(samples)):
            yield t_ns, encode(msgid, payload)


def record_flight(path: Path, plan: FlightPlan, duration_s: float, watch: Callable[[PlantSamples], None]) -> int:
    """Write a flight to a .tlog file; returns its message count.

    Raises UsageError if the file cannot be written.
    """
    messages = 0
    try:
        with path.open("wb") as file:
            for t_ns, frame in recorded(plan, duration_s, watch):
                file.write(tlog_record(EPOCH_US + t_ns // 1000, frame))
                messages += 1
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}; choose another file") from error
    return messages
