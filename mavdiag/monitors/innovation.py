"""The innovation monitor: how badly one step ahead of the gyro is predicted, against healthy flight.

The one-step prediction follows the measured rate, so a slow disturbance explains itself away and what is left is what
is new in each sample. That makes it the monitor for upsets and for a rough, fast-fluctuating rotor; a weak rotor that
is trimmed away leaves no trace in it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify.arx import triangle
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Flights, LearnContext, Monitor, segments
from mavdiag.monitors.columns import COMMANDED, GYRO, LEVEL, SIGNAL, SOUND, VALUE, Floats, Ints, U
from mavdiag.monitors.fitting import (
    LIMIT,
    MEMORY_S,
    MOST,
    commanded,
    cut_to_share,
    of_each,
    smoothed,
    three,
    variance_law,
)
from mavdiag.monitors.spec import Delay, NotNegative, Positive, spec
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, follow, mean_size, push, total
from mavdiag.rows.windows import forgetting, window_all, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, Signal, Three
from mavdiag.thresholds.rule import Prior

NA = NB = LAG = 4  # METHOD section 5; 2 to 5 change no verdict on the recorded flights
WINDOW_S = 1.0  # our choice; 0.7 to 1.3 s change no verdict
MIN_ROWS = 500  # 60 a parameter (our choice)
TRAIN_ROWS = 120_000  # more of it no longer changes the coefficients (our choice)
CONSTANT = "the gyro is constant or noise-free; is it a real sensor?"
RANK_TOLERANCE = 1e-10
GLITCH_ROWS = 3 + LAG  # whose innovations three bad samples spoil
STILL_ROWS = 3  # equal ones after another say nothing new, be they rounded or repeated (our choice)
MIN_RATE_HZ = 20.0  # below it a step ahead is too far to predict a rate (our choice)


Four: TypeAlias = tuple[float, float, float, float]


@spec
class InnovationSpec:
    """Healthy prediction of roll, pitch and yaw rate, in that order.

    dt_s: row period [s].
    mean: healthy mean gyro [rad/s].
    a, b: of each axis a_1..a_4 and b_1..b_4.
    k0: variance of the innovation at rest [(rad/s)^2].
    k1: variance per mean square of the commanded rate.
    window_s, memory_s: lengths of the mean and of the memory of the command [s].
    delay_s: half the window of the rate filters [s].
    """

    kind: Literal["innovation"] = "innovation"
    dt_s: Positive
    mean: Three
    a: tuple[Four, Four, Four]
    b: tuple[Four, Four, Four]
    k0: tuple[Positive, Positive, Positive]
    k1: tuple[NotNegative, NotNegative, NotNegative]
    window_s: Positive = WINDOW_S
    memory_s: Positive = MEMORY_S
    delay_s: Delay = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """n rows and the 4 before them.

    u, y: (4 + n, 3) commanded and measured rate [rad/s].
    valid: (n,) the row and the 4 before it may be judged.
    busy: (n, 3) exponential mean of u^2.
    """

    u: FloatArray
    y: FloatArray
    valid: BoolArray
    busy: FloatArray

    def __len__(self) -> int:
        return len(self.valid)


# Places in the parameters, of each axis mean, k0, k1, a and b, and in the memory, of each axis the last inputs and
# outputs, the newest first, and the mean square of the command.
WINDOW, ALPHA, AXES = range(3)
OF_AXIS = 3 + NA + NB
GOOD, SAME, ROWS = range(3)
OF_PAST = NB + NA + 1
MEAN = ROWS + 3 * OF_PAST


@jit
def _error(par: FloatArray, mem: FloatArray, axis: int, u: float, y: float) -> float:
    """z of an axis, after its next command and raw rate."""
    of, past = AXES + axis * OF_AXIS, ROWS + axis * OF_PAST
    busy = follow(mem, past + NB + NA, u * u, par[ALPHA])
    e = y - par[of]
    for i in range(NA):
        e += par[of + 3 + i] * mem[past + NB + i] - par[of + 3 + NA + i] * mem[past + i]
    for i in range(NA - 1, 0, -1):
        mem[past + i], mem[past + NB + i] = mem[past + i - 1], mem[past + NB + i - 1]
    mem[past], mem[past + NB] = u, y - par[of]
    return float(e / math.sqrt(par[of + 1] + par[of + 2] * busy))


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The level at each row whose commanded rate became known."""
    window = int(par[WINDOW])
    for i in range(lag, x.shape[1]):
        k, known, same, usual, most, worst = i - lag, flags[COMMANDED, i] > 0.5, True, 0.0, 0.0, 0.0
        for axis in range(3):
            u, y = x[U + axis, i], x[GYRO + axis, i]
            known = known and math.isfinite(u) and math.isfinite(y)
            u, y = u if math.isfinite(u) else 0.0, y if math.isfinite(y) else 0.0
            same = same and y - par[AXES + axis * OF_AXIS] == mem[ROWS + axis * OF_PAST + NB]
            z = abs(_error(par, mem, axis, u, y))
            worst, square = max(worst, z), min(z, MOST) ** 2
            usual, most = usual + min(square, LIMIT * LIMIT), most + square
        mem[SAME] = mem[SAME] + 1.0 if same else 0.0
        mem[GOOD] = mem[GOOD] + 1.0 if known and mem[SAME] < STILL_ROWS else 0.0
        sound, level = mem[GOOD] > LAG, 0.0
        if sound:  # the last second of *valid* rows: a gap within a segment does not start the window anew
            row = MEAN + FRESH
            mem[row], mem[row + 1], mem[row + 2] = usual, most - usual, 1.0 if most > usual else 0.0
            sound = push(mem, MEAN, window, 3, True)
            many = total(mem, MEAN, 3, 2) > GLITCH_ROWS + 0.5
            sum_ = total(mem, MEAN, 3, 0) + (total(mem, MEAN, 3, 1) if many else 0.0)
            level = math.sqrt(max(sum_, 0.0) / (3 * window))
        out[VALUE, k], out[SOUND, k], out[LEVEL, k], out[SIGNAL, k], at[k] = level, sound, level, worst, k
    return len(at) - lag


class Innovation(Monitor[InnovationSpec]):
    """Statistic: rms of the normalised one-step prediction error over 1 s and three axes [times healthy rms].

        e(t) = A(z^-1) y(t) - B(z^-1) u(t),    z = e / sqrt(k0 + k1 EMA_0.35s(u^2)),    s = sqrt(mean_1s,3 axes z^2)

    u: commanded rate (derivative of the attitude set-point), y: raw gyro less its healthy mean, one ARX(4, 4, 1) by
    least squares for each of p, q, r. k0 and k1 by non-negative least squares of e^2, so a sharp manoeuvre that the
    healthy flights had does not count. What z^2 is beyond 36 counts where more than 7 rows of the second have it, as a
    glitch of three samples has not; and a row whose gyro is that of the three before is left out. About 1 in healthy
    flight. `level` equals the statistic, `signal` is the
    largest |z| of the row. It knows nothing of rotors.

    Warm-up: half an SG window, 4 rows and 1 s; after a gap of less than a second only the first two. Latency: half an
    SG window and up to 1 s. False alarms: see `thresholds`; aerobatics, landings and wind that the healthy flights
    lacked raise it without a fault. Blind spots: a weak rotor that is trimmed away (AUC 0.66 on 57 recorded propeller
    cuts; the threshold catches none); anything slow.

    >>> from mavdiag.testing import example_rows, example_context
    >>> rng = np.random.default_rng(4)
    >>> healthy = example_rows(2000, rate=rng.normal(0.0, 0.1, (2000, 3)))
    >>> monitor = Innovation(*Innovation.fit([[healthy]], example_context()))
    >>> _, rough = monitor.step(monitor.start(), example_rows(500, rate=rng.normal(0.0, 0.3, (500, 3))))
    >>> float(rough.value[-1].round(1))
    3.0
    """

    name = "innovation"
    label = "innovation"
    prior = Prior(session=0.15, block=0.08)  # emulated 0.03, 0.01, 0.01; real vehicles vary more (our choice)
    phrase = "attitude unlike the model"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT})
    depends = frozenset({Condition.YAW_RATE, Condition.HEIGHT, Condition.THROTTLE, Condition.COMMANDED_ACCELERATION})
    by_rates = True
    spec_type = InnovationSpec
    unit = "x healthy rms"
    reach = MOST  # where a normalised error is cut

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[InnovationSpec, ...]:
        """Identify the healthy one-step prediction, of a like share of every flight's rows."""
        if not any(of_each(flights, "commanded", commanded)):
            raise InputError("no flight with a gyro and an attitude set-point")
        if 1 / context.dt_s < MIN_RATE_HZ:
            rate_hz = 1 / context.dt_s
            raise InputError(f"the gyro comes at {rate_hz:.3g} Hz; a one-step prediction needs {MIN_RATE_HZ:.0f} Hz")
        pairs = _training_pairs(flights)
        if all((one.y[LAG:] == one.y[LAG]).all() for one in pairs) and sum(map(len, pairs)) >= MIN_ROWS:
            raise IdentificationError(CONSTANT)
        rows = sum(int(one.valid.sum()) for one in pairs)
        if rows < MIN_ROWS:
            raise IdentificationError(f"only {rows} rows of healthy flight, {MIN_ROWS} are needed; fly longer")
        mean = np.concatenate([one.y[LAG:][one.valid] for one in pairs]).mean(axis=0)
        a, b = np.empty((3, NA)), np.empty((3, NB))
        for axis in range(3):
            a[axis], b[axis] = _identify(pairs, axis, float(mean[axis]))
        squares = np.concatenate([_errors(one.u, one.y - mean, a, b)[one.valid] ** 2 for one in pairs])
        if squares.mean(axis=0).min() == 0.0:
            raise IdentificationError(CONSTANT)
        busy = np.concatenate([one.busy[one.valid] for one in pairs])
        k = [variance_law(squares[:, axis], busy[:, axis]) for axis in range(3)]
        found = InnovationSpec(
            dt_s=context.dt_s,
            mean=three(mean),
            a=(_four(a[0]), _four(a[1]), _four(a[2])),
            b=(_four(b[0]), _four(b[1]), _four(b[2])),
            k0=three([k0 for k0, _ in k]),
            k1=three([k1 for _, k1 in k]),
            delay_s=context.window // 2 * context.dt_s,
        )
        return (found,)

    @property
    def memory_s(self) -> float:
        """Its window, and the memory of the command [s]."""
        return self.spec.window_s + self.spec.memory_s

    def parameters(self, dt_s: float) -> FloatArray:
        """See `AXES`."""
        spec = self.spec
        axes = zip(spec.mean, spec.k0, spec.k1, spec.a, spec.b, strict=True)
        each = [x for mean, k0, k1, a, b in axes for x in (mean, k0, k1, *a, *b)]
        return np.array([window_rows(spec.window_s, dt_s), forgetting(spec.memory_s, dt_s), *each])

    def memory(self, dt_s: float) -> FloatArray:
        """No row yet: as if the gyro had repeated zero."""
        mem = np.zeros(MEAN + mean_size(window_rows(self.spec.window_s, dt_s), 3))
        mem[SAME] = STILL_ROWS
        for axis, mean in enumerate(self.spec.mean):
            first = ROWS + axis * OF_PAST + NB
            mem[first : first + NA] = -mean
        return mem

    run = staticmethod(run)


def _training_pairs(flights: Flights) -> list[_Pairs]:
    """Of each segment of all flights the first rows, so many that a like share of what is commanded is in them."""
    counts = [count for of_flight in of_each(flights, "commanded rows", _commanded_rows) for count in of_flight]
    pieces = [segment for flight in flights for segment in segments(flight)]
    shares = zip(pieces, cut_to_share(counts, TRAIN_ROWS, 0), strict=True)
    return [_pairs_of(segment, most) for segment, most in shares if most]


def _commanded_rows(flight: Sequence[Rows]) -> list[int]:
    """How many rows of each segment are commanded."""
    return [sum(int(np.count_nonzero(rows.rates.commanded)) for rows in segment) for segment in segments(flight)]


def _pairs_of(segment: Sequence[Rows], most: int) -> _Pairs:
    """The pairs of a segment up to so many commanded rows."""
    parts = []
    for rates in (rows.rates for rows in segment):
        n = int(np.searchsorted(np.cumsum(rates.commanded), most)) + 1
        parts.append((rates.u[:n], rates.gyro[:n], rates.commanded[:n]))
        most -= int(np.count_nonzero(rates.commanded[:n]))
        if most <= 0:
            break
    u, y, good = (np.concatenate(column) for column in zip(*parts, strict=True))
    known = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    u, y = (np.concatenate((np.zeros((LAG, 3)), np.where(np.isfinite(one), one, 0.0))) for one in (u, y))
    changed = np.concatenate(([False], (y[1:] != y[:-1]).any(axis=1)))
    stirred = ~window_all(~changed, STILL_ROWS)[LAG - STILL_ROWS + 1 :]
    valid = np.concatenate((np.zeros(LAG, dtype=np.bool_), good & known & stirred))
    busy = smoothed(np.square(u[LAG:]), forgetting(MEMORY_S, segment[0].rates.dt_s))
    return _Pairs(u, y, window_all(valid, LAG + 1), busy)


def _errors(u: FloatArray, y: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """One-step prediction errors e(t) = y(t) + a_1 y(t-1) + .. - b_1 u(t-1) - .., (LAG + n, 3) -> (n, 3)."""
    e = np.empty((3, len(y) - LAG))
    for axis in range(3 if len(y) > LAG else 0):  # numpy turns a correlation with fewer rows than weights about
        e[axis] = np.correlate(y[:, axis], [*a[axis, ::-1], 1.0])
        e[axis] -= np.correlate(u[:-1, axis], b[axis, ::-1])
    return e.T


def _identify(pairs: Sequence[_Pairs], axis: int, mean: float) -> tuple[FloatArray, FloatArray]:
    """Least-squares ARX(4, 4, 1) of one axis: a_1..a_4 and b_1..b_4.

    An axis that is never commanded leaves the b undetermined; the smallest solution sets them to zero.
    """
    # [ -y(t-1) .. -y(t-4)   u(t-1) .. u(t-4)   y(t) ]    (n, 9), the valid rows of all flights
    stacked = []
    for one in pairs:
        y, u, n = one.y[:, axis] - mean, one.u[:, axis], len(one.valid)
        columns = [-y[LAG - i : LAG - i + n] for i in range(1, NA + 1)]
        columns += [u[LAG - i : LAG - i + n] for i in range(1, NB + 1)]
        stacked.append(np.column_stack((*columns, y[LAG:]))[one.valid])
    R = triangle(np.concatenate(stacked))
    scale = np.linalg.norm(R[:, :-1], axis=0)
    scale[scale == 0.0] = 1.0
    theta = np.linalg.lstsq(R[:, :-1] / scale, R[:, -1], rcond=RANK_TOLERANCE)[0] / scale
    return theta[:NA], theta[NA:]


def _four(values: FloatArray) -> Four:
    first, second, third, fourth = values.tolist()
    return first, second, third, fourth
