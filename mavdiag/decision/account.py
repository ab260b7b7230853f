"""How long a slot judged, and why it did not."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mavdiag.rows.conditions import Condition
from mavdiag.rows.statistic import Statistic
from mavdiag.telemetry import Signal
from mavdiag.thresholds.envelope import Outside

__all__ = ["WAITING", "Account", "reason_of"]

WAITING = "waiting for enough unbroken flight"  # why a monitor does not judge although its signals are known


def reason_of(missing: str) -> str:
    """What is said of a signal that is unknown; a doubt of the gyro is said as it is."""
    return f"no {missing.replace('_', ' ')}" if missing in tuple(Signal) else missing


@dataclass(frozen=True, slots=True)
class Account:
    """How long a slot judged, and why it did not.

    flight_s: flight time so far.
    judged_s: time that its valid values stand for.
    peak: highest valid statistic; None if there was none.
    missing: flight time with a valid gyro in which what it takes of a signal was unknown, by signal; and flight time
        in which the gyro is there but must not be judged, by the reason (`rows.quality.Doubt`) [s].
    outside: time that it did not judge because a condition was outside of the envelope, and how far that was.
    """

    flight_s: float = 0.0
    judged_s: float = 0.0
    peak: float | None = None
    missing: Mapping[str, float] = field(default_factory=dict)
    outside: Mapping[Condition, Outside] = field(default_factory=dict)

    @property
    def outside_s(self) -> float:
        """Time outside of the envelope [s]."""
        return sum((one.span_s for one in self.outside.values()), 0.0)

    @property
    def not_judged(self) -> Mapping[str, float]:
        """Reasons with their seconds: a signal that is unknown, or waiting for unbroken flight."""
        found: dict[str, float] = {}
        idle_s = max(0.0, self.flight_s - self.judged_s - self.outside_s)
        for signal, span_s in self.missing.items():
            found[reason_of(signal)] = min(span_s, max(0.0, idle_s))
            idle_s -= span_s
        return {**found, WAITING: idle_s} if idle_s > 0 else found

    def add(
        self, found: Statistic, flight_s: float, missing: Mapping[str, float], outside: Mapping[Condition, Outside]
    ) -> "Account":
        """The account after the next rows."""
        beside, lacking = self.outside, self.missing
        if outside:
            beside = dict(beside)
            for condition, one in outside.items():
                beside[condition] = beside[condition].plus(one) if condition in beside else one
        if missing:
            lacking = {**lacking, **{signal: lacking.get(signal, 0.0) + span_s for signal, span_s in missing.items()}}
        count, peak = int(np.count_nonzero(found.valid)), self.peak
        if count:
            highest = float(np.maximum.reduce(found.value if count == len(found) else found.value[found.valid]))
            peak = highest if peak is None else max(peak, highest)
        return Account(self.flight_s + flight_s, self.judged_s + count * found.period_s, peak, lacking, beside)
