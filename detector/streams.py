"""What comes from a vehicle, and what is missing: the rates of its streams, armed, airborne, and the flight so far.

"Not yet" is an answer, with its reason; see `Reason`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from mavdiag.link.profiles import Profile, scale_doubt
from mavdiag.link.samples import joined
from mavdiag.link.scale import gravity_of
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.grid import NATIVE_TOLERANCE
from mavdiag.telemetry import FloatArray, Instant, IntArray, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

__all__ = [
    "SILENT_S",
    "Collection",
    "Hindrance",
    "Meter",
    "Reason",
    "Streams",
    "Weighing",
    "collect",
    "observe",
    "on_ground",
]

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
_MOST = 100_000  # samples that are kept of one measurement
_PIECES = 64  # chunks that are joined into one, so that a long collection stays a short list


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
    """One stream.

    latest: when a sample came last (host); None if none came, or none for `SILENT_S`.
    t_ns: vehicle times since the last measurement.
    period_s: as measured last; None while unknown.
    before_s: as measured the time before; None if it was not.
    steps: number of steps and their length [s] of the last measurements.
    recent_ns: (up to 3,) vehicle times of the last samples.
    samples: all so far.
    """

    latest: Instant | None = None
    t_ns: IntArray = field(default_factory=_no_times)
    period_s: float | None = None
    before_s: float | None = None
    steps: tuple[tuple[int, float], ...] = ()
    recent_ns: IntArray = field(default_factory=_no_times)
    samples: int = 0

    @property
    def steady_hz(self) -> float:
        """Mean rate over the last measurements, losses included; 0 while unknown."""
        span_s = sum(one for _, one in self.steps)
        return sum(count for count, _ in self.steps) / span_s if span_s else 0.0

    @property
    def rate_hz(self) -> float:
        """Measured rate; 0 while unknown.

        By the vehicle's stamps alone, for a radio or a computer that stalls changes no rate. Two samples of a far lower
        rate tell at once that somebody set it, where a measurement takes a second or two.
        """
        if not self.period_s:
            return 0.0
        steps = np.diff(self.recent_ns) / NS_PER_S
        slow_s = float(steps.min()) if len(steps) == 2 else 0.0
        return 1.0 / (slow_s if slow_s > SLOWER * self.period_s else self.period_s)

    @property
    def periods_s(self) -> tuple[float, ...]:
        """The last two measurements, as far as there are any: one odd second is no change of rate."""
        return tuple(period for period in (self.before_s, self.period_s) if period is not None)


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """What the accelerometer feels, of a vehicle that stands or hovers.

    total, samples, since_ns: sum [m/s^2], number and first vehicle time of the samples so far.
    done: whether the scale is believed.
    doubt: why not, in a few words; empty while unknown.
    """

    total: FloatArray = field(default_factory=lambda: np.zeros(3))
    samples: int = 0
    since_ns: int = 0
    done: bool = False
    doubt: str = ""

    def step(self, force: Series | None, profile: Profile) -> "Weighing":
        """Take in the next samples; what is doubtful is weighed again."""
        if self.done or force is None or len(force) == 0:
            return self
        since_ns = self.since_ns if self.samples else int(force.t_ns[0])
        total, samples = self.total + force.values.sum(axis=0), self.samples + len(force)
        if samples < WEIGH_SAMPLES or force.t_ns[-1] - since_ns < WEIGH_S * NS_PER_S:
            return replace(self, total=total, samples=samples, since_ns=since_ns)
        doubt = scale_doubt(profile, gravity_of(total[None, :] / samples))
        return Weighing(done=not doubt, doubt=doubt)


@dataclass(frozen=True, slots=True, eq=False)
class Streams:
    """The streams of one vehicle.

    began: since when they are observed (host).
    meters: of the signals in `METERED` that came so far.
    armed: 0 or 1 as said last; nan if never said.
    thrust: collective set-point, 0..1; nan if never said.
    weighing: of the accelerometer, until its scale is believed.
    """

    began: Instant | None = None
    meters: Mapping[Signal, Meter] = field(default_factory=dict)
    armed: float = float("nan")
    thrust: float = float("nan")
    weighing: Weighing = field(default_factory=Weighing)

    @property
    def scale_doubt(self) -> str:
        """What the accelerometer feels and the profile that would explain it, if its scale is not the profile's."""
        return self.weighing.doubt

    def meter(self, signal: Signal) -> Meter:
        """The meter of a signal."""
        return self.meters.get(signal, Meter())

    def rate_hz(self, signal: Signal, now: Instant) -> float | None:
        """Measured rate of a stream; 0 if it does not come, None while it is being measured."""
        meter = self.meter(signal)
        if meter.latest is None:
            return 0.0 if self.began is not None and now - self.began > SILENT_S else None
        return None if meter.period_s is None else meter.rate_hz

    @property
    def gyro(self) -> Meter:
        """The gyro's meter."""
        return self.meter(Signal.BODY_RATE)


def observe(streams: Streams, telemetry: Telemetry, now: Instant, profile: Profile) -> Streams:
    """Take in what came. profile: of the link, with the IMU message that is read."""
    return Streams(
        now if streams.began is None else streams.began,
        {signal: _metered(streams.meter(signal), telemetry.get(signal), now) for signal in METERED},
        _latest(streams.armed, telemetry.get(Signal.ARMED)),
        _latest(streams.thrust, telemetry.get(Signal.THRUST_SETPOINT)),
        streams.weighing.step(telemetry.get(Signal.SPECIFIC_FORCE), profile),
    )


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
        silent = meter.latest is not None and now - meter.latest > SILENT_S
        return Meter(samples=meter.samples) if silent else meter
    t_ns = np.concatenate((meter.t_ns, series.t_ns))
    recent_ns = np.concatenate((meter.recent_ns, series.t_ns))[-3:]
    meter = replace(meter, latest=now, t_ns=t_ns, recent_ns=recent_ns, samples=meter.samples + len(series))
    if t_ns[-1] - t_ns[0] < MEASURE_S * NS_PER_S:
        # A clock that jumps back starts the measurement anew; so does one that stands still.
        return replace(meter, t_ns=t_ns[-1:]) if t_ns[-1] < t_ns[0] or len(t_ns) > _MOST else meter
    steps = (*meter.steps, (len(t_ns) - 1, float(t_ns[-1] - t_ns[0]) / NS_PER_S))[-STEADY:]
    return replace(meter, t_ns=t_ns[-1:], period_s=_period_s(t_ns), before_s=meter.period_s, steps=steps)


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


@dataclass(frozen=True, slots=True, eq=False)
class Collection:
    """Healthy flight to learn from, so far.

    whole: chunks joined, each with its length [s].
    recent: the latest chunks, not yet joined.
    recent_s: their length [s].
    """

    whole: tuple[tuple[Telemetry, float], ...] = ()
    recent: tuple[Telemetry, ...] = ()
    recent_s: float = 0.0

    @property
    def seconds(self) -> float:
        """Length by the gyro samples [s]."""
        return sum(seconds for _, seconds in self.whole) + self.recent_s

    @property
    def telemetry(self) -> Telemetry:
        """All of it as one."""
        return joined((*(piece for piece, _ in self.whole), *self.recent))


def collect(collection: Collection, telemetry: Telemetry, period_s: float, keep_s: float) -> Collection:
    """Add a chunk of flight. period_s: of the gyro. keep_s: what is older than the latest so many seconds goes."""
    gyro = telemetry.get(Signal.BODY_RATE)
    seconds = collection.recent_s + (0 if gyro is None else len(gyro)) * period_s
    recent = (*collection.recent, telemetry)
    if len(recent) < _PIECES:
        return Collection(collection.whole, recent, seconds)
    whole = (*collection.whole, (joined(recent), seconds))
    while sum(one for _, one in whole[1:]) > keep_s:
        whole = whole[1:]
    return Collection(whole, (), 0.0)
