"""What a session needs of a vehicle's streams, and what they lack of it.

The gyro is mandatory, and so are set-points where nothing can be done without them. All other streams are optional:
their lack is told and hinders nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from detector.config import SessionSettings
from detector.judging import Judge
from detector.streams import Hindrance, Reason, Streams
from mavdiag.baseline import RATE_TOLERANCE, Baseline
from mavdiag.link.profiles import Profile
from mavdiag.link.wants import Want, wants_of
from mavdiag.monitors import MONITORS
from mavdiag.telemetry import Signal

__all__ = ["Demand", "demand_of"]


@dataclass(frozen=True, slots=True)
class Demand:
    """What is needed.

    wants: the streams to ask for.
    least_hz: slowest gyro and set-points.
    dt_s: row period of the baseline; None without one.
    setpoints: whether nothing can be done without set-points.
    profile: of the link.
    """

    wants: tuple[Want, ...]
    least_hz: float
    dt_s: float | None
    setpoints: bool
    profile: Profile

    def lack(self, streams: Streams, *, judging: bool) -> Hindrance | None:
        """What the streams lack, None if they will do. judging: a rate must be wrong twice before it has changed."""
        gyro, setpoint = streams.gyro, streams.meter(Signal.ATTITUDE_SETPOINT)
        if gyro.latest is None:
            return Hindrance(Reason.NO_GYRO)
        if streams.scale_doubt:
            return Hindrance(Reason.SCALE, streams.scale_doubt)
        if self.setpoints and setpoint.latest is None:
            return Hindrance(Reason.NO_SETPOINTS)
        if gyro.period_s is None or (self.setpoints and setpoint.period_s is None):
            return Hindrance(Reason.MEASURING)
        periods = gyro.periods_s if judging else (gyro.period_s,)
        if self._slow(periods):
            return Hindrance(Reason.SLOW_GYRO, f"({gyro.rate_hz:.0f} Hz)")
        if self.dt_s is not None:
            tolerance = (2.0 if judging else 1.0) * RATE_TOLERANCE
            if all(abs(period / self.dt_s - 1.0) > tolerance for period in periods):
                return Hindrance(Reason.OTHER_RATE, f"({gyro.rate_hz:.0f} Hz)")
        if self.setpoints and self._slow(setpoint.periods_s):
            return Hindrance(Reason.SLOW_SETPOINTS, f"({setpoint.rate_hz:.0f} Hz)")
        return None

    def _slow(self, periods_s: Sequence[float]) -> bool:
        return all(period * self.least_hz > 1.0 for period in periods_s)


def demand_of(settings: SessionSettings, profile: Profile, baseline: Baseline | None, judge: Judge | None) -> Demand:
    """What learning needs, or judging by a baseline: the rates of its rows and the signals of its monitors."""
    least_hz, ask_hz = settings.min_rate_hz, settings.ask_hz or profile.rate_hz
    if baseline is None:
        needs = frozenset[Signal]().union(*(monitor.needs for monitor in MONITORS))
        wants = wants_of(profile, needs, (ask_hz, least_hz, float("inf")), least_hz)
        return Demand(wants, least_hz, None, True, profile)
    dt_s = baseline.link.dt_s
    slowest_hz, fastest_hz = 1.0 / dt_s / (1.0 + RATE_TOLERANCE), 1.0 / dt_s / (1.0 - RATE_TOLERANCE)
    slots = () if judge is None else judge.chain.slots
    setpoints = bool(slots) and all(Signal.ATTITUDE_SETPOINT in slot.monitor.signals for slot in slots)
    imu_hz = (1.0 / dt_s, slowest_hz, fastest_hz)
    wants = wants_of(profile, baseline.needs(), imu_hz, min(least_hz, slowest_hz), setpoints)
    return Demand(wants, least_hz, dt_s, setpoints, profile)
