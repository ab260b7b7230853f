"""What comes from a vehicle, and what is missing: the rates of its streams, armed, airborne.

The gyro is mandatory, and so are set-points where nothing can be done without them. The lack of others is told only.
"""

from collections import deque
from collections.abc import Container, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from detector.config import SessionSettings
from mavdiag.baseline import RATE_TOLERANCE, Baseline
from mavdiag.link.profiles import Profile, scale_doubt
from mavdiag.link.scale import gravity_of
from mavdiag.link.wants import Want, wants_of
from mavdiag.monitors import MONITORS
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import steps_of, usual_step
from mavdiag.telemetry import FloatArray, Instant, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

SILENT_S = 2.0  # without a sample for so long, a stream has stopped (our choice)
MEASURE_S = 1.0  # vehicle time over which a rate is measured (our choice: a change is known within 2 s)
METERED = (
    Signal.BODY_RATE,
    Signal.ATTITUDE_SETPOINT,
    Signal.ACTUATOR,
    Signal.VIBRATION,
    Signal.ROTOR_SPEED,
    Signal.ATTITUDE,
)
STEADY = 5  # measurements that the steady rate is the mean of
SLOWER = 8.0  # two steps in a row so many times the period are another rate: losses hardly make them (our choice)
WEIGH_S, WEIGH_SAMPLES = 1.0, 20  # of the accelerometer, before its scale is believed (our choice)
CHANGED = 0.05  # of a rate that is a change of it: less is told by the next look, a second later at most (our choice)
_MOST = 100_000  # samples that are kept of one measurement


class Reason(StrEnum):
    """Why learning or judging cannot go on, as the operator reads it (short: it shares a text of 50 bytes)."""

    NO_SETPOINTS = "no attitude set-points"
    NO_GYRO = "no gyro"
    SCALE = "IMU scale"
    MEASURING = "measuring the rates"
    SLOW_GYRO = "gyro rate too low"
    SLOW_SETPOINTS = "set-point rate too low"
    OTHER_RATE = "rate not the baseline's"
    NOT_ARMED = "not armed"
    NOT_AIRBORNE = "not airborne"
    GAPS = "gaps in the data"


class Hindrance:
    """A reason, and the same with the figure that goes with it."""

    def __init__(self, reason: Reason, figure: str = "") -> None:
        self.reason, self.text = reason, f"{reason} {figure}".rstrip()


class Meter:
    """The rate of one stream, by the vehicle's stamps alone: a radio or a computer that stalls changes no rate."""

    def __init__(self, samples: int = 0) -> None:
        self.samples = samples  # all so far
        self.latest: Instant | None = None  # when one came last (host); None if none came, or none for `SILENT_S`
        self.periods_s: tuple[float, ...] = ()  # the last two measurements: one odd second is no change of rate
        self.rate_hz = 0.0  # 0 while unknown
        self._t_ns: list[IntArray] = []  # since the last measurement
        self._first_ns = self._waiting = 0  # the first of them, and how many they are
        self._recent_ns: list[int] = []  # vehicle times of the last three samples
        self._steps: deque[tuple[int, float]] = deque(maxlen=STEADY)  # number and length [s] of the last measurements'

    @property
    def steady_hz(self) -> float:
        """Mean rate over the last measurements, losses included; 0 while unknown."""
        span_s = sum(span_s for _, span_s in self._steps)
        return sum(count for count, _ in self._steps) / span_s if span_s else 0.0

    def take(self, series: Series, now: Instant) -> bool:
        """Measure the next samples; returns whether the rate has changed."""
        t_ns, before_hz, first = series.t_ns, self.rate_hz, self.latest is None
        count, recent_ns = len(t_ns), t_ns[-3:].tolist()
        self.latest, self.samples, self._waiting = now, self.samples + count, self._waiting + count
        self._recent_ns = recent_ns if count > 2 else [*self._recent_ns, *recent_ns][-3:]
        if not self._t_ns:
            self._first_ns = int(t_ns[0])
        self._t_ns.append(t_ns)
        span_ns = recent_ns[-1] - self._first_ns
        if span_ns >= MEASURE_S * NS_PER_S:
            measured_ns = np.concatenate(self._t_ns)
            self._steps.append((len(measured_ns) - 1, span_ns / NS_PER_S))
            steps = steps_of(measured_ns)
            self.periods_s = (*self.periods_s, usual_step(steps) / NS_PER_S)[-2:] if len(steps) else ()
        # Measured; or a clock that jumped back, or stands still, starts the measurement anew.
        if not (0 <= span_ns < MEASURE_S * NS_PER_S and self._waiting <= _MOST):
            self._t_ns, self._first_ns, self._waiting = [t_ns[-1:]], recent_ns[-1], 1
        self.rate_hz = self._rate_hz()
        return first or abs(self.rate_hz - before_hz) > CHANGED * before_hz

    def _rate_hz(self) -> float:
        """Measured rate. Two samples of a far lower rate tell at once that somebody set it."""
        if not self.periods_s:
            return 0.0
        period_s = self.periods_s[-1]
        if len(self._recent_ns) == 3:
            before_ns, at_ns, after_ns = self._recent_ns
            slow_s = min(at_ns - before_ns, after_ns - at_ns) / NS_PER_S
            period_s = slow_s if slow_s > SLOWER * period_s else period_s
        return 1.0 / period_s


class Streams:
    """The streams of one vehicle."""

    def __init__(self) -> None:
        self.began: Instant | None = None  # since when they are observed (host)
        self.armed = self.thrust = float("nan")  # 0 or 1; collective set-point, 0..1: as said last; nan if never said
        self.changes = 0  # of rates, so far
        self.scale_doubt = ""  # what the accelerometer feels and the profile that would explain it, if it is not 1 g
        self._meters = {signal: Meter() for signal in METERED}
        self._weighed: list[FloatArray] = []  # of the accelerometer, until its scale is believed
        self._weighed_since_ns = 0
        self._scale_believed = False

    def observe(self, telemetry: Telemetry, now: Instant, profile: Profile) -> None:
        """Take in what came. profile: of the link, with the IMU message that is read."""
        self.began = self.began or now
        came = {series.signal: series for series in telemetry.series if series.t_ns.size}
        for signal, meter in self._meters.items():
            if (series := came.get(signal)) is not None:
                self.changes += meter.take(series, now)
            elif meter.latest is not None and now - meter.latest > SILENT_S:
                self._meters[signal], self.changes = Meter(meter.samples), self.changes + 1
        self.armed = _latest(self.armed, came.get(Signal.ARMED))
        self.thrust = _latest(self.thrust, came.get(Signal.THRUST_SETPOINT))
        if not self._scale_believed and (force := came.get(Signal.SPECIFIC_FORCE)) is not None:
            self._weigh(force, profile)

    def _weigh(self, force: Series, profile: Profile) -> None:
        known = np.isfinite(force.values).all(axis=1)  # a log may lack an axis
        if not known.any():
            return
        if not self._weighed:
            self._weighed_since_ns = int(force.t_ns[0])
        self._weighed.append(force.values[known][:_MOST])
        span_ns, samples = int(force.t_ns[-1]) - self._weighed_since_ns, sum(map(len, self._weighed))
        if (samples >= WEIGH_SAMPLES and span_ns >= WEIGH_S * NS_PER_S) or samples > _MOST:
            felt = np.concatenate(self._weighed).mean(axis=0)
            self.scale_doubt = scale_doubt(profile, gravity_of(felt[None, :]))
            self._scale_believed, self._weighed = not self.scale_doubt, []

    def meter(self, signal: Signal) -> Meter:
        """The meter of a signal."""
        return self._meters.get(signal) or Meter()

    @property
    def gyro(self) -> Meter:
        """The gyro's meter."""
        return self._meters[Signal.BODY_RATE]

    def rate_hz(self, signal: Signal, now: Instant) -> float | None:
        """Measured rate of a stream; 0 if it does not come, None while it is being measured."""
        meter = self.meter(signal)
        if meter.latest is None:
            return 0.0 if self.began is not None and now - self.began > SILENT_S else None
        return meter.rate_hz if meter.periods_s else None

    def missing(self, signals: Container[Signal]) -> Signal | None:
        """The first of some signals that is metered and does not come."""
        return next((signal for signal in METERED if signal in signals and self._meters[signal].latest is None), None)

    def on_ground(self, gate: GateSpec) -> Hindrance | None:
        """Why the vehicle does not count as flying; None if it does, or never says."""
        if gate.need_armed and self.armed < 0.5:
            return Hindrance(Reason.NOT_ARMED)
        if gate.min_thrust is not None and self.thrust < gate.min_thrust:
            return Hindrance(Reason.NOT_AIRBORNE)
        return None


def _latest(old: float, series: Series | None) -> float:
    return old if series is None else float(series.values[-1, 0])


@dataclass(frozen=True, slots=True)
class Demand:
    """What a session needs of a vehicle's streams."""

    wants: tuple[Want, ...]  # the streams to ask for
    least_hz: float  # slowest gyro and set-points
    dt_s: float | None  # row period of the baseline; None without one
    setpoints: bool  # whether nothing can be done without set-points

    @classmethod
    def of(
        cls, settings: SessionSettings, profile: Profile, baseline: Baseline | None, judged: Sequence[Container[Signal]]
    ) -> "Demand":
        """What learning needs, or judging by a baseline. judged: the signals of each monitor at work."""
        least_hz, ask_hz = settings.min_rate_hz, settings.ask_hz or profile.rate_hz
        if baseline is None:
            needs = frozenset[Signal]().union(*(monitor.needs for monitor in MONITORS))
            return cls(wants_of(profile, needs, (ask_hz, least_hz, float("inf")), least_hz), least_hz, None, True)
        dt_s = baseline.link.dt_s
        slowest_hz, fastest_hz = 1.0 / dt_s / (1.0 + RATE_TOLERANCE), 1.0 / dt_s / (1.0 - RATE_TOLERANCE)
        setpoints = bool(judged) and all(Signal.ATTITUDE_SETPOINT in signals for signals in judged)
        imu_hz = (1.0 / dt_s, slowest_hz, fastest_hz)
        wants = wants_of(profile, baseline.needs(), imu_hz, min(least_hz, slowest_hz), setpoints)
        return cls(wants, least_hz, dt_s, setpoints)

    def lack(self, streams: Streams, *, judging: bool) -> Hindrance | None:
        """What the streams lack, None if they will do. judging: a rate must be wrong twice before it has changed."""
        gyro, setpoint = streams.gyro, streams.meter(Signal.ATTITUDE_SETPOINT)
        if gyro.latest is None:
            return Hindrance(Reason.NO_GYRO)
        if streams.scale_doubt:
            return Hindrance(Reason.SCALE, streams.scale_doubt)
        if self.setpoints and setpoint.latest is None:
            return Hindrance(Reason.NO_SETPOINTS)
        if not gyro.periods_s or (self.setpoints and not setpoint.periods_s):
            return Hindrance(Reason.MEASURING)
        periods_s = gyro.periods_s if judging else gyro.periods_s[-1:]
        if self._slow(periods_s):
            return Hindrance(Reason.SLOW_GYRO, f"({gyro.rate_hz:.0f} Hz)")
        if self.dt_s is not None:
            tolerance = (2.0 if judging else 1.0) * RATE_TOLERANCE
            if all(abs(period_s / self.dt_s - 1.0) > tolerance for period_s in periods_s):
                return Hindrance(Reason.OTHER_RATE, f"({gyro.rate_hz:.0f} Hz)")
        if self.setpoints and self._slow(setpoint.periods_s):
            return Hindrance(Reason.SLOW_SETPOINTS, f"({setpoint.rate_hz:.0f} Hz)")
        return None

    def _slow(self, periods_s: Sequence[float]) -> bool:
        return all(period_s * self.least_hz > 1.0 for period_s in periods_s)
