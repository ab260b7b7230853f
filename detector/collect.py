"""Collecting healthy flight to learn from: only chunks that fly, their length counted, joined as they come."""

from dataclasses import dataclass

from mavdiag.link.samples import joined
from mavdiag.telemetry import Signal, Telemetry

__all__ = ["Collection", "collect"]

_RUN = 64  # chunks that are joined into one, so that a long collection stays a short list


@dataclass(frozen=True, slots=True, eq=False)
class Collection:
    """Flight so far. seconds: its length, by the gyro samples."""

    whole: tuple[Telemetry, ...] = ()
    recent: tuple[Telemetry, ...] = ()
    seconds: float = 0.0

    @property
    def telemetry(self) -> Telemetry:
        """All of it as one."""
        return joined((*self.whole, *self.recent))


def collect(collection: Collection, telemetry: Telemetry, period_s: float) -> Collection:
    """Add a chunk of flight. period_s: of the gyro."""
    gyro = telemetry.get(Signal.BODY_RATE)
    seconds = collection.seconds + (0 if gyro is None else len(gyro)) * period_s
    recent = (*collection.recent, telemetry)
    if len(recent) < _RUN:
        return Collection(collection.whole, recent, seconds)
    return Collection((*collection.whole, joined(recent)), (), seconds)
