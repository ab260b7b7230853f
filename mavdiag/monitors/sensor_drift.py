"""The sensor-drift monitor: gyro, accelerometer and estimated attitude contradict each other.

Three facts of kinematics hold whatever the propellers, the wind and the payload do. The integral of the gyro is the
change of the attitude. A vehicle that goes on flying is not accelerated for long, so along the vertical the
accelerometer reads g on average. And an estimator that must correct the attitude against its gyro, by accelerometer or
cameras, again and again to the same side, has two sensors that disagree.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import FaultKind, LearnContext, Monitor, Summaries, Summary, segments
from mavdiag.monitors.healthy import Three, joined_moments, moments, three
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import row_max, window_mean
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal
from mavdiag.thresholds.guard import Guard

__all__ = ["SensorDrift", "SensorDriftSpec", "SensorDriftState"]

TICK_S = 0.1  # our choice
MEAN_S = 2.0  # of the attitude that the gyro does not explain, now and then (our choice)
LAG_S = 15.0  # between the two; less while the flight is young (our choice: twice a usual time constant of estimators)
VERTICAL_S = 4.0  # of each of two means of the vertical acceleration (our choice)
TURN_SHARE = 0.01  # of a turn that a healthy gyro may be wrong by, scale and cross-axis (IIM-42652 data sheet: 1 %)
# rad/s: change of a gyro's bias between flights that is no fault. The IIM-42652's data sheet has 0.005 deg/s a kelvin,
# and electronics warm up by some 45 K after the power is on: 0.225 deg/s. At the threshold of 2.5 a bias of 0.01 rad/s,
# which the data sheet allows at power-on (0.5 deg/s), is no fault. (Read from the data sheet; 45 K is an estimate.)
USUAL_BIAS = 0.004
LEAST_ANGLE = 0.01  # rad: smallest healthy disagreement that is believed (our choice)
LEAST_VERTICAL = 0.08  # m/s^2 (our choice)
STEEP_RAD, FAST_RAD_S = 0.7, 6.0  # beyond it small angles do not hold, and an upset begins (our choice)
LIMIT = 1e6  # a value is cut here
GRAVITY = 9.80665
ANGLES = np.array([1.0, 1.0, 0.0])  # which of the three disagreements are angles
COLUMNS = 5  # of the history: tilt about two axes, heading, vertical acceleration, turned angle
MIN_RATE_HZ = 20.0  # below it turns are not followed from sample to sample (our choice)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDriftSpec:
    """Healthy agreement.

    dt_s: row period [s].
    bias: healthy mean of gyro less attitude rate [rad/s].
    vertical: healthy mean of the vertical specific force beyond -g [m/s^2].
    tilt, heading: healthy rms of the disagreement over 15 s [rad].
    lift: healthy rms of the 4 s means of the vertical specific force [m/s^2].
    Raises InputError if they are not finite and positive.
    """

    kind: Literal["sensor_drift"] = "sensor_drift"
    dt_s: float
    bias: Three
    vertical: float
    tilt: float
    heading: float
    lift: float

    def __post_init__(self) -> None:
        if not all(math.isfinite(x) for x in (*self.bias, self.vertical, self.tilt, self.heading, self.lift)):
            raise InputError("sensor_drift: the healthy figures must be finite numbers")
        if min(self.dt_s, self.tilt, self.heading, self.lift) <= 0:
            raise InputError("sensor_drift: the period and the healthy spreads must be positive")

    @property
    def tick(self) -> int:
        """Rows per value."""
        return max(1, round(TICK_S / self.dt_s))

    def ticks(self, span_s: float) -> int:
        """Values in a span."""
        return max(1, round(span_s / (self.tick * self.dt_s)))


@dataclass(frozen=True, slots=True, eq=False)
class SensorDriftState:
    """What the next rows need.

    rows: (r, 9) gyro, accelerometer and attitude of rows that wait for their tick; t_ns, valid: (r,) of them.
    angle: (4,) integrals since the last gap: of the gyro about north and east, of its turning, and of |its turning|.
    history: (h, COLUMNS) of the last ticks without a gap.
    """

    rows: FloatArray
    t_ns: IntArray
    valid: BoolArray
    angle: FloatArray
    history: FloatArray


class SensorDrift(Monitor[SensorDriftSpec, SensorDriftState]):
    """Statistic: the greatest of three disagreements of the inertial sensors [times healthy rms].

        E = (phi + i theta) e^(i psi) - integral (p + i q) e^(i psi) dt           tilt that the gyro does not explain
        Y = psi - integral (q sin phi + r cos phi)/cos theta dt                   the same of the heading
        V = g + specific force along the vertical of the attitude phi, theta, psi
        s = max( |dE|/(tilt + e), |dY|/(heading + e), |V|/lift ),    e = 0.01 R + 0.004 rad/s L

    dE, dY: change of their 2 s means over L = 15 s, or over as much as there is since the last gap; R: angle that the
    vehicle turned in it, of which a healthy gyro may be wrong by 1 %; and its bias may be wrong by 4 mrad/s. |V|: the
    smaller of two 4 s means, one after the other, where both have the same sign, so that the start of a climb does not
    count. Propellers, wind and payload do not enter. `level` equals the statistic, `signal` is |dE| [rad].

    Warm-up: 4 s without a gap, 8 s for V. Latency: where the estimator's time constant is 8 s, a gyro bias of
    0.05 rad/s takes 6 s and a drift of 0.002 rad/s^2 15 s; a vertical bias of 0.5 m/s^2 takes 6 s.
    False alarms: see `thresholds`; the threshold is never less than 2.5, which is 0.18 rad in 15 s or 0.2 m/s^2. A
    mount that slips or cameras that jump raise it too. Blind spots: a gyro's scale, unless the vehicle turns; a
    horizontal accelerometer bias below 1 m/s^2 (to a filter it is tilt, and a flight against wind looks the same);
    an accelerometer's horizontal scale; what was there when the flight began; attitudes beyond 40 degrees.

    >>> from mavdiag.testing import example_context, example_rows
    >>> rng, still = np.random.default_rng(9), np.tile([0.0, 0.0, -GRAVITY], (3000, 1))
    >>> rate, attitude = rng.normal(0, 0.003, (3000, 3)), np.zeros((3000, 3))
    >>> healthy = example_rows(3000, rate=rate, force=still, attitude=attitude)
    >>> monitor = SensorDrift(*SensorDrift.fit([[healthy]], example_context()))
    >>> rate[2000:, 0] += 0.05
    >>> _, found = monitor.step(monitor.start(), example_rows(3000, rate=rate, force=still, attitude=attitude))
    >>> bool(found.value[190] < 2.0), bool(found.value[-1] > 5.0)
    (True, True)
    """

    name = "sensor_drift"
    label = "IMU drift"
    phrase = "gyro and attitude disagree"
    needs = frozenset({Signal.BODY_RATE, Signal.SPECIFIC_FORCE, Signal.ATTITUDE})
    kind = FaultKind.SENSOR
    guard = Guard(least=2.5)
    spec_type = SensorDriftSpec
    unit = "x healthy rms"

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """Moments of the biases of the usable ticks, then the ticks (k, 14) and rows (k tick, 3) of `_gathered`."""
        parts = [_gathered(_before(context), segment, number) for number, segment in enumerate(segments(flight))]
        if not parts:
            return (*moments(np.empty((0, 4))), np.empty((0, 14)), np.empty((0, 3)))
        biases, ticks, turns = (np.concatenate(column) for column in zip(*parts, strict=True))
        return (*moments(biases), ticks, turns)

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[SensorDriftSpec, ...]:
        """Healthy biases and spreads. Raises InputError if the vehicle sends no attitude."""
        context.need_rate(MIN_RATE_HZ)
        first = _before(context)
        if not any(one[0][0] for one in summaries):
            raise InputError("no flight with a gyro, an accelerometer and an attitude estimate")
        mean = joined_moments([one[:3] for one in summaries]).mean
        spec = replace(first, bias=three(mean[:3]), vertical=float(mean[3]))
        found = [_squares(spec, *one[3:]) for one in summaries]
        count = sum(number for number, _ in found)
        if not count:
            raise IdentificationError(f"no unbroken {2 * MEAN_S:g} s of flight; fly longer")
        rms = np.sqrt(np.sum([squares for _, squares in found], axis=0) / count)
        tilt, heading, lift = np.maximum(rms, (LEAST_ANGLE, LEAST_ANGLE, LEAST_VERTICAL)).tolist()
        return (replace(spec, tilt=tilt, heading=heading, lift=lift),)

    def __init__(self, spec: SensorDriftSpec) -> None:
        super().__init__(spec)
        self._spreads = np.array([spec.tilt, spec.heading, spec.lift])

    @property
    def reach(self) -> float:
        """Where a value is cut."""
        return LIMIT

    def start(self) -> SensorDriftState:
        """No row yet."""
        return _fresh()

    def step(self, state: SensorDriftState, rows: Rows) -> tuple[SensorDriftState, Statistic]:
        """The greatest disagreement every 0.1 s, at the time of the newest row that it rests on."""
        spec = self.spec
        state, t_ns, parts, excused, full = _advance(spec, state, rows.block)
        value = np.minimum(row_max(parts / (self._spreads + excused[:, None] * ANGLES)), LIMIT)
        return state, Statistic(t_ns, spec.tick * spec.dt_s, value, full, value, parts[:, 0])


def _fresh() -> SensorDriftState:
    t_ns, valid = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.bool_)
    return SensorDriftState(np.empty((0, 9)), t_ns, valid, np.zeros(4), np.empty((0, COLUMNS)))


def _joined(state: SensorDriftState, block: Block) -> tuple[FloatArray, IntArray, BoolArray]:
    """The rows that wait and the next ones: values, times, and whether they may be used."""
    fresh = np.concatenate((block.rate, block.force, block.attitude), axis=1)
    known = block.valid & block.known(Signal.SPECIFIC_FORCE) & block.known(Signal.ATTITUDE)
    lean, turn = np.abs(block.attitude[:, :2]), np.abs(block.rate)
    if not (np.maximum.reduce(lean, axis=None) < STEEP_RAD and np.maximum.reduce(turn, axis=None) < FAST_RAD_S):
        known = known & (lean < STEEP_RAD).all(axis=1) & (turn < FAST_RAD_S).all(axis=1)
    if np.count_nonzero(known) < len(known):
        fresh = np.where(known[:, None], fresh, 0.0)
    rows = np.concatenate((state.rows, fresh))
    return rows, np.concatenate((state.t_ns, block.t_ns)), np.concatenate((state.valid, known))


def _advance(
    spec: SensorDriftSpec, state: SensorDriftState, block: Block
) -> tuple[SensorDriftState, IntArray, FloatArray, FloatArray, BoolArray]:
    """The ticks that the next rows complete: times, (n, 3) |dE|, |dY| and |V|, e [rad], and whether they count."""
    tick = spec.tick
    rows, t_ns, valid = _joined(state, block)
    n = len(rows) // tick
    used = n * tick
    whole: BoolArray = np.logical_and.reduce(valid[:used].reshape(n, tick), axis=1)
    steps, seen = _ticks(spec, rows[:used], n)
    (angle, history), parts, excused, full = _walked(spec, (state.angle, state.history), steps, seen, whole)
    state = SensorDriftState(rows[used:], t_ns[used:], valid[used:], angle, history)
    return state, t_ns[tick - 1 : used : tick], parts, excused, full


def _walked(
    spec: SensorDriftSpec, memory: tuple[FloatArray, FloatArray], steps: FloatArray, seen: FloatArray, whole: BoolArray
) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray, BoolArray]:
    """Angle and history after the next ticks, and of each tick what `_advance` gives."""
    n, least = len(whole), 2 * spec.ticks(MEAN_S)
    parts, excused, full = np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.bool_)
    angle, history = memory
    for first, stop, good in _stretches(whole):
        if not good:
            angle, history = np.zeros(4), np.empty((0, COLUMNS))
            continue
        sums = np.add.accumulate(np.concatenate((angle[None], steps[first:stop])), axis=0)
        fresh = np.concatenate((seen[first:stop], sums[1:, 3:]), axis=1)
        fresh[:, :3] -= sums[1:, :3]
        angle, past = sums[-1], len(history)
        history = np.concatenate((history, fresh))
        found = _disagreements(spec, history, past)
        parts[first:stop], excused[first:stop] = found[:, :3], found[:, 3]
        full[first + max(0, least - 1 - past) : stop] = True
        history = history[-(spec.ticks(LAG_S) + least) :]
    return (angle, history), parts, excused, full


def _stretches(flags: BoolArray) -> list[tuple[int, int, bool]]:
    """Spans of equal flags: first, stop, flag."""
    same = np.count_nonzero(flags)
    if same in (0, len(flags)):
        return [(0, len(flags), bool(same))] if len(flags) else []
    edges = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
    return [(a, b, bool(flags[a])) for a, b in itertools.pairwise(edges)]


def _ticks(spec: SensorDriftSpec, rows: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Of each tick what the gyro turns, (n, 4), and what is seen: tilt to north and east, heading, V, (n, 4)."""
    p, q, r = (rows[:, :3] - spec.bias).T
    phi, theta, psi = rows[:, 6:].T
    x, y, z = rows[:, 3:6].T
    c, s, cos_theta = np.cos(psi), np.sin(psi), np.cos(theta)
    sin_phi, cos_phi = np.sin(phi), np.cos(phi)
    turn = (q * sin_phi + r * cos_phi) / cos_theta
    down = cos_theta * (sin_phi * y + cos_phi * z) - np.sin(theta) * x
    each = np.empty((8, len(rows)))
    each[0], each[1], each[2] = p * c - q * s, p * s + q * c, turn
    each[3], each[4], each[5], each[6] = np.abs(turn), phi * c - theta * s, phi * s + theta * c, psi
    each[7] = down + (GRAVITY - spec.vertical)
    tick = spec.tick
    means = np.add.reduce(each.reshape(8, n, tick), axis=2).T / tick
    return means[:, :4] * (tick * spec.dt_s), means[:, 4:]


def _disagreements(spec: SensorDriftSpec, history: FloatArray, past: int) -> FloatArray:
    """|dE|, |dY|, |V| and e at the ticks from `past` on of an unbroken history, (h, 4); zero where it is too short."""
    h, mean, lag, lift = len(history), spec.ticks(MEAN_S), spec.ticks(LAG_S), spec.ticks(VERTICAL_S)
    out = np.zeros((h - past, 4))
    first = max(past - mean + 1, mean)  # windows are counted by their first tick
    if first <= h - mean:
        now = np.arange(first, h - mean + 1)
        then = np.maximum(now - lag, 0)
        change = window_mean(history[first:], mean)
        change -= window_mean(history[then[0] : then[-1] + mean], mean)[then - then[0]]
        late = out[first + mean - 1 - past :]
        late[:, 0] = np.hypot(change[:, 0], change[:, 1])
        late[:, 1] = np.abs(change[:, 2])
        late[:, 3] = TURN_SHARE * change[:, 4] + (now - then) * (USUAL_BIAS * spec.tick * spec.dt_s)
    first = max(past - lift + 1, lift)
    if first <= h - lift:
        means = window_mean(history[first - lift :, 3:4], lift)[:, 0]
        late, early = means[lift:], means[: len(means) - lift]
        least = np.minimum(np.abs(late), np.abs(early))
        out[first + lift - 1 - past :, 2] = np.where(late * early > 0, least, 0.0)
    return out


def _before(context: LearnContext) -> SensorDriftSpec:
    """What is known before any flight: no bias."""
    return SensorDriftSpec(dt_s=context.dt_s, bias=(0.0, 0.0, 0.0), vertical=0.0, tilt=1.0, heading=1.0, lift=1.0)


def _gathered(spec: SensorDriftSpec, segment: Sequence[Rows], number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of a segment, by a specification without biases, what gives its ticks for any bias.

    Gyro less attitude rate and vertical specific force of each usable tick, (u, 4); of all k ticks `_ticks`, means of
    cos psi, sin psi, sin phi / cos theta and cos phi / cos theta, whether they are whole, and the segment's number,
    (k, 14); and of their rows what turns about the vertical and the last two, (k tick, 3).
    """
    joined = [_joined(_fresh(), rows.block) for rows in segment]
    n = sum(len(one[2]) for one in joined) // spec.tick
    used = n * spec.tick
    rows = np.concatenate([one[0] for one in joined])[:used]
    whole = np.concatenate([one[2] for one in joined])[:used].reshape(n, spec.tick).all(axis=1)
    (_, q, r), (phi, theta, psi) = rows[:, :3].T, rows[:, 6:].T
    each = np.stack((np.cos(psi), np.sin(psi), np.sin(phi) / np.cos(theta), np.cos(phi) / np.cos(theta)))
    means = np.add.reduce(each.reshape(4, n, spec.tick), axis=2).T / spec.tick
    ticks = np.column_stack((*_ticks(spec, rows, n), means, whole, np.full(n, number)))
    return _gyro_errors(spec, rows, n)[whole], ticks, np.stack((q * each[2] + r * each[3], each[2], each[3]), axis=1)


def _squares(spec: SensorDriftSpec, ticks: FloatArray, turns: FloatArray) -> tuple[int, FloatArray]:
    """How many ticks of a flight count, and the sums of squares of |dE|, |dY| and |V| beyond what is excused, (3,)."""
    p, q, r = spec.bias
    span_s = spec.tick * spec.dt_s
    c, s, a, b = ticks[:, 8:12].T
    steps, seen = ticks[:, :4].copy(), ticks[:, 4:8].copy()
    # integral of (p - b_p) cos psi - (q - b_q) sin psi and so on, of which the first part is in the ticks
    steps[:, 0] -= span_s * (p * c - q * s)
    steps[:, 1] -= span_s * (p * s + q * c)
    steps[:, 2] -= span_s * (q * a + r * b)
    turning = np.abs(turns[:, 0] - q * turns[:, 1] - r * turns[:, 2])
    steps[:, 3] = turning.reshape(-1, spec.tick).sum(axis=1) * spec.dt_s
    seen[:, 3] -= spec.vertical
    count, squares = 0, np.zeros(3)
    for number in np.unique(ticks[:, 13]):
        here = ticks[:, 13] == number
        memory = (np.zeros(4), np.empty((0, COLUMNS)))
        _, parts, excused, full = _walked(spec, memory, steps[here], seen[here], ticks[here, 12] > 0.5)
        found = np.maximum(parts - excused[:, None] * ANGLES, 0.0)[full]
        count, squares = count + len(found), squares + np.square(found).sum(axis=0)
    return count, squares


def _gyro_errors(spec: SensorDriftSpec, rows: FloatArray, n: int) -> FloatArray:
    """(n, 4) of each tick: gyro less the rate of the attitude in it, and vertical specific force beyond -g."""
    ticks = rows.reshape(n, spec.tick, 9)
    mean = ticks.mean(axis=1)
    span_s = max(1, spec.tick - 1) * spec.dt_s
    dphi, dtheta, dpsi = ((ticks[:, -1, 6:] - ticks[:, 0, 6:]) / span_s).T
    phi, theta = mean[:, 6], mean[:, 7]
    turn = np.cos(theta) * dpsi
    rates = (
        dphi - np.sin(theta) * dpsi,
        np.cos(phi) * dtheta + np.sin(phi) * turn,
        np.cos(phi) * turn - np.sin(phi) * dtheta,
    )
    down = _ticks(spec, rows, n)[1][:, 3]
    return np.column_stack((mean[:, :3] - np.column_stack(rates), down))
