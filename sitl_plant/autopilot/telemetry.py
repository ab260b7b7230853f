"""A flight as a receiver reads it, without the bytes in between: for studies of many flights.

The records are those that the emulator sends, and the receiver's own conversions read them. Lost messages are missing.
"""

from dataclasses import dataclass

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.link.codec import AUTOPILOT, ROWS, Frames
from mavdiag.link.samples import SampleDecoder, SampleState, joined, sources
from mavdiag.link.sequence import FRAME
from mavdiag.telemetry import Telemetry
from mavdiag.units import NS_PER_MS
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.stream import ImuFilters, records
from sitl_plant.plant import STEP_NS, Plant, PlantConfig, PlantSamples

BLOCK_STEPS = 2000  # fastest: fewer calls, and arrays that still fit the allocator


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """One link. Raises UsageError for an unknown profile, or a rate that it does not grant."""

    profile: str = "qdrone2"
    rate_hz: float | None = None  # of set-point and IMU; None for the profile's own
    loss: float = 0.0  # share of messages that is lost

    def __post_init__(self) -> None:
        dialect_named(self.profile).rates_hz(self.rate_hz)


class TelemetryStream:
    """From samples to telemetry over one link, however it is cut into blocks; equal seeds give equal losses."""

    def __init__(self, link: LinkSpec, seed: int, rotors: int = 4) -> None:
        self._dialect, self._loss = dialect_named(link.profile), link.loss
        self._decoder, self._state = SampleDecoder(self._dialect.profile), SampleState()
        read = sources(self._dialect.profile)
        self._tick_ns = {int(row.message): row.time[1].tick_ns if row.time else NS_PER_MS for row in read}
        self._schedule = self._dialect.schedule(link.rate_hz, rotors)
        self._filters = ImuFilters(self._dialect, seed)
        self._losses = {msgid: np.random.default_rng([seed, msgid]) for msgid in self._tick_ns}

    def step(self, samples: PlantSamples) -> Telemetry:
        """The next block (n >= 1)."""
        filtered = self._filters.step(samples)
        payloads, found, times = [b""], [np.empty(0, FRAME)], [np.empty(0, np.int64)]
        for msgid, due in self._schedule.due(samples.t_ns):
            if msgid not in self._tick_ns:  # the receiver reads nothing from it
                continue
            at, record = records(msgid, filtered, due, self._dialect)
            size, tick_ns = record.itemsize, self._tick_ns[msgid]
            if self._loss:
                kept = np.flatnonzero(self._losses[msgid].random(len(at)) >= self._loss)
                at, record = at[kept], record.view(f"V{size}")[kept].view(record.dtype)
            rows = np.zeros(len(at), FRAME)
            rows["row"], rows["sender"], rows["host_ns"] = ROWS[msgid], 1 << 8 | AUTOPILOT, samples.t_ns[at]
            rows["body"] = sum(map(len, payloads)) + size * np.arange(len(at))
            rows["stop"] = rows["body"] + size
            times.append(filtered.stamp_ns[at] // tick_ns * tick_ns)
            payloads.append(record.tobytes())
            found.append(rows)
        rows, t_ns = np.concatenate(found), np.concatenate(times)
        order = np.argsort(rows["host_ns"], kind="stable")
        frames = Frames(np.frombuffer(b"".join(payloads), np.uint8), rows[order])
        return self._decoder.step(self._state, frames, t_ns[order])


def flight_telemetry(config: PlantConfig, duration_s: float, link: LinkSpec = LinkSpec()) -> tuple[Telemetry, float]:
    """A whole flight over one link, and its length [s]: less than the duration if a vehicle falls to z = 0."""
    plant = Plant(config)
    stream, pieces = TelemetryStream(link, config.seed, plant.rotors), []
    left, flown = round(duration_s * 1e9 / STEP_NS), 0
    while left > 0:
        samples = plant.advance(min(BLOCK_STEPS, left))
        below = np.flatnonzero(samples.position[:, 2] >= 0.0)
        up = len(samples) if config.start == "ground" or not len(below) else int(below[0])  # else there is no ground
        left = left - up if up == len(samples) else 0
        flown += up
        if up:
            pieces.append(stream.step(samples.rows(0, up)))
    if not pieces:
        raise UsageError(f"a flight must last at least 1 ms, not {duration_s:g} s")
    return joined(pieces), flown * STEP_NS * 1e-9
