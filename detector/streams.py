"""What comes from a vehicle, and what hinders: presence and rates of the two main streams, armed, airborne.

"Not yet" is an answer, with its reason; see `Reason`.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from mavdiag.rows.align import NATIVE_TOLERANCE
from mavdiag.rows.gate import GateSpec
from mavdiag.telemetry import NS_PER_S, Instant, IntArray, Series, Signal, Telemetry

__all__ = [
    "MEASURE_S",
    "SILENT_S",
    "Hindrance",
    "Meter",
    "Reason",
    "Streams",
    "hindrance",
    "observe",
    "on_ground",
    "rate_hz",
]

SILENT_S = 2.0  # without a sample for so long, a stream is gone (our choice)
MEASURE_S = 2.0  # vehicle time over which a rate is measured (our choice)
_MOST = 100_000  # samples that are kept of one measurement


class Reason(StrEnum):
    """Why learning or judging cannot go on, as the operator reads it (short: it shares a text of 50 bytes)."""

    NO_SETPOINTS = "no attitude set-points"
    NO_GYRO = "no gyro"
    MEASURING = "measuring the rates"
    SLOW_GYRO = "gyro rate too low"
    SLOW_SETPOINTS = "set-point rate too low"
    OTHER_RATE = "rate not the baseline's"
    NOT_ARMED = "not armed"
    NOT_AIRBORNE = "not airborne"
    GAPS = "gaps in the data"


@dataclass(frozen=True, slots=True)
class Hindrance:
    """A reason and the figure that goes with it."""

    reason: Reason
    figure: str = ""

    @property
    def text(self) -> str:
        """Reason and figure, as one phrase."""
        return f"{self.reason} {self.figure}".rstrip()


def _no_times() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Meter:
    """One stream. seen: when it was last heard (host); t_ns: vehicle times since the last measurement;
    period_s: as measured last, None while unknown; samples: all so far."""

    seen: Instant | None = None
    t_ns: IntArray = field(default_factory=_no_times)
    period_s: float | None = None
    samples: int = 0

    @property
    def rate_hz(self) -> float:
        """Measured rate, 0 while unknown."""
        return 1.0 / self.period_s if self.period_s else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Streams:
    """The two main streams and the latest word on armed (0 or 1) and thrust (0..1); nan where never said.

    began: since when they are watched (host).
    """

    began: Instant | None = None
    gyro: Meter = field(default_factory=Meter)
    setpoint: Meter = field(default_factory=Meter)
    armed: float = float("nan")
    thrust: float = float("nan")


def observe(streams: Streams, telemetry: Telemetry, now: Instant) -> Streams:
    """Take in what came."""
    return Streams(
        now if streams.began is None else streams.began,
        _metered(streams.gyro, telemetry.get(Signal.BODY_RATE), now),
        _metered(streams.setpoint, telemetry.get(Signal.ATTITUDE_SETPOINT), now),
        _latest(streams.armed, telemetry.get(Signal.ARMED)),
        _latest(streams.thrust, telemetry.get(Signal.THRUST_SETPOINT)),
    )


def rate_hz(streams: Streams, meter: Meter, now: Instant) -> float | None:
    """Measured rate of a stream; 0 if it does not come, None while it is being measured."""
    if meter.seen is None:
        return 0.0 if streams.began is not None and now - streams.began > SILENT_S else None
    return meter.rate_hz if meter.period_s is not None else None


def hindrance(streams: Streams, min_rate_hz: float) -> Hindrance | None:
    """What the streams lack, None if they will do."""
    if streams.setpoint.seen is None:
        return Hindrance(Reason.NO_SETPOINTS)
    if streams.gyro.seen is None:
        return Hindrance(Reason.NO_GYRO)
    if streams.gyro.period_s is None or streams.setpoint.period_s is None:
        return Hindrance(Reason.MEASURING)
    if streams.gyro.rate_hz < min_rate_hz:
        return Hindrance(Reason.SLOW_GYRO, f"({streams.gyro.rate_hz:.0f} Hz)")
    if streams.setpoint.rate_hz < min_rate_hz:
        return Hindrance(Reason.SLOW_SETPOINTS, f"({streams.setpoint.rate_hz:.0f} Hz)")
    return None


def on_ground(streams: Streams, gate: GateSpec) -> Hindrance | None:
    """Why the vehicle does not count as flying, None if it does. What it never says passes, as in the gate."""
    if gate.need_armed and streams.armed < 0.5:
        return Hindrance(Reason.NOT_ARMED)
    if gate.min_thrust is not None and streams.thrust < gate.min_thrust:
        return Hindrance(Reason.NOT_AIRBORNE)
    return None


def _latest(old: float, series: Series | None) -> float:
    return float(series.values[-1, 0]) if series is not None and len(series) else old


def _metered(meter: Meter, series: Series | None, now: Instant) -> Meter:
    if series is None or len(series) == 0:
        silent = meter.seen is not None and now - meter.seen > SILENT_S
        return Meter(samples=meter.samples) if silent else meter
    t_ns = np.concatenate((meter.t_ns, series.t_ns))
    meter = replace(meter, seen=now, t_ns=t_ns, samples=meter.samples + len(series))
    if t_ns[-1] - t_ns[0] < MEASURE_S * NS_PER_S:
        # A clock that jumps back starts the measurement anew; so does one that stands still.
        return replace(meter, t_ns=t_ns[-1:]) if t_ns[-1] < t_ns[0] or len(t_ns) > _MOST else meter
    return replace(meter, t_ns=t_ns[-1:], period_s=_period_s(t_ns))


def _period_s(t_ns: IntArray) -> float | None:
    """Period of a stream: the mean of its regular steps, as `measure_grid` takes it, so that losses do not stretch it.

    A stream without regular steps has at least a median one.
    """
    steps = np.diff(np.unique(t_ns)).astype(np.float64)
    if len(steps) == 0:
        return None
    median = float(np.median(steps))
    regular = steps[np.abs(steps - median) <= NATIVE_TOLERANCE * median]
    return float(np.mean(regular) if len(regular) else median) / NS_PER_S
