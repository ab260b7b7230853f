"""A flight as a receiver reads it, without the bytes in between: for studies of many flights.

The records are those that the emulator sends, and the receiver's own conversions read them. Lost messages are missing.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.link.conversion import sources
from mavdiag.link.samples import filled, joined, merged
from mavdiag.telemetry import FloatArray, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_MS
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.schedule import Schedule
from sitl_plant.autopilot.stream import ImuFilters, records
from sitl_plant.plant import STEP_NS, Plant, PlantConfig, PlantSamples

BLOCK_STEPS = 2000  # fastest: fewer calls, and arrays that still fit the allocator


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """One link. Raises UsageError for an unknown profile, a rate that it does not grant, or a loss outside 0 to 0.9."""

    profile: str = "qdrone2"
    rate_hz: float | None = None  # of set-point and IMU; None for the profile's own
    loss: float = 0.0  # share of messages that is lost

    def __post_init__(self) -> None:
        dialect_named(self.profile).rates_hz(self.rate_hz)
        if not 0.0 <= self.loss <= 0.9:
            raise UsageError(f"loss must be 0 to 0.9 of the messages, not {self.loss:g}")


class TelemetryStream:
    """From samples to telemetry over one link, block by block. Equal seeds give equal stamps and losses.

    How a flight is cut into blocks changes nothing.
    """

    def __init__(self, link: LinkSpec, seed: int, rotors: int = 4) -> None:
        self._dialect, self._loss = dialect_named(link.profile), link.loss
        self._sources = {int(source.message): source for source in sources(self._dialect.profile)}
        rates = self._dialect.rates_hz(link.rate_hz, rotors)
        self._schedule = Schedule(
            {m: rate for m, rate in rates.items() if m in self._sources}, self._dialect.ceiling_hz
        )
        self._filters = ImuFilters(self._dialect, seed)
        self._held: dict[Signal, FloatArray] = {}
        self._losses = {msgid: np.random.default_rng([seed, msgid]) for msgid in self._sources}

    def step(self, samples: PlantSamples) -> Telemetry:
        """The next block (n >= 1)."""
        filtered = self._filters.step(samples)
        found: dict[Signal, list[tuple[Series, IntArray]]] = {}
        held = set()
        for order, (msgid, due) in enumerate(self._schedule.due(samples.t_ns)):
            source = self._sources[msgid]
            rows, record = records(msgid, filtered, due, self._dialect)
            seen = record.view(source.dtype)
            if self._loss:
                kept = self._losses[msgid].random(len(rows)) >= self._loss
                rows, seen = rows[kept], seen[kept]
            if source.counter is None:  # a message without a time of its own
                t_ns = filtered.stamp_ns[rows] // NS_PER_MS * NS_PER_MS
            else:
                t_ns = seen[source.time].astype(np.int64) * source.counter.tick_ns
            for part in source.convert(self._dialect.profile, seen):
                at = np.arange(len(rows)) if part.meant is None else np.flatnonzero(part.meant)
                series = Series(part.signal, t_ns[at], samples.t_ns[rows[at]], part.values[at])
                found.setdefault(part.signal, []).append((series, rows[at] * len(self._sources) + order))
                held |= {part.signal} if part.held else set()
        return Telemetry(tuple(self._whole(signal, parts, signal in held) for signal, parts in found.items()))

    def _whole(self, signal: Signal, parts: list[tuple[Series, IntArray]], held: bool) -> Series:
        series = parts[0][0] if len(parts) == 1 else merged(signal, parts)
        if held and len(series):
            series = replace(series, values=filled(series.values, self._held.get(signal)))
            self._held[signal] = series.values[-1]
        return series


def until_ground(samples: PlantSamples) -> int:
    """How many of the samples are above z = 0: a flight that starts in hover has no ground to fall on."""
    below = np.flatnonzero(samples.position[:, 2] >= 0.0)
    return int(below[0]) if len(below) else len(samples)


def flight_telemetry(config: PlantConfig, duration_s: float, link: LinkSpec = LinkSpec()) -> tuple[Telemetry, float]:
    """A whole flight over one link, and its length [s]: less than the duration if a vehicle falls to z = 0."""
    plant = Plant(config)
    stream, pieces = TelemetryStream(link, config.seed, plant.rotors), []
    left, flown = round(duration_s * 1e9 / STEP_NS), 0
    while left > 0:
        samples = plant.advance(min(BLOCK_STEPS, left))
        up = len(samples) if config.start == "ground" else until_ground(samples)
        left = left - up if up == len(samples) else 0
        flown += up
        if up:
            pieces.append(stream.step(samples.rows(0, up)))
    if not pieces:
        raise UsageError(f"a flight must last at least 1 ms, not {duration_s:g} s")
    return joined(pieces), flown * STEP_NS * 1e-9


def telemetry_digest(telemetry: Telemetry) -> str:
    """SHA-256 (hex) of all times and values: the identity of a flight that never was a file."""
    digest = hashlib.sha256()
    for series in telemetry.series:
        digest.update(series.signal.encode())
        digest.update(np.ascontiguousarray(series.t_ns).tobytes())
        digest.update(np.ascontiguousarray(series.values).tobytes())
    return digest.hexdigest()
