"""The innovation monitor: how badly one step ahead of the gyro is predicted, against healthy flight.

The one-step prediction follows the measured rate, so a slow disturbance explains itself away and what is left is what
is new in each sample. That makes it the monitor for upsets and for a rough, fast-fluctuating rotor; a weak rotor that
is trimmed away leaves no trace in it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.decision.events import Reading
from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify.data import triangle
from mavdiag.monitors.base import Rows
from mavdiag.rows.running import MeanState, ema, forgetting, sliding_mean, start_mean, window_rows
from mavdiag.telemetry import Axis, BoolArray, FloatArray, IntArray
from mavdiag.thresholds.heldout import Flights
from mavdiag.thresholds.rule import Guard

__all__ = ["GUARD", "Innovation", "InnovationSpec", "InnovationState", "fit", "judgeable"]

NA = NB = LAG = 4  # METHOD section 5; 2 to 5 change no verdict on the recorded flights
WINDOW_S = 1.0  # our choice; 0.7 to 1.3 s change no verdict
MEMORY_S = 0.35  # METHOD section 4
MIN_SHARE = 0.05  # of the mean square, left to k0 however busy the set-point (our choice)
MIN_ROWS = 500  # 60 a parameter (our choice)
TRAIN_ROWS = 120_000  # more of it no longer changes the coefficients (our choice)
RANK_TOLERANCE = 1e-10
MIN_RATE_HZ = 20.0  # below it a step ahead is too far to predict a rate (our choice)
LIMIT = 1e6  # healthy rms; a normalised innovation is cut here (our choice)

GUARD = Guard()  # the rule's own floor on beta is what it needs

Three = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class InnovationSpec:
    """Healthy prediction of roll, pitch and yaw rate, in that order, at the row period `dt_s` [s].

    mean: healthy mean gyro [rad/s]. a: (3, 4) a_1..a_4; b: (3, 4) b_1..b_4. k0, k1: variance of the innovation at rest
    [(rad/s)^2], and per mean square of the commanded rate. Raises InputError if they do not fit together.
    """

    kind: Literal["innovation"] = "innovation"
    dt_s: float
    mean: Three
    a: tuple[tuple[float, ...], ...]
    b: tuple[tuple[float, ...], ...]
    k0: Three
    k1: Three
    window_s: float = WINDOW_S
    memory_s: float = MEMORY_S

    def __post_init__(self) -> None:
        shapes = [len(self.a), len(self.b), *(len(row) for row in (*self.a, *self.b))]
        figures = (*self.mean, *self.k0, *self.k1, *(x for row in (*self.a, *self.b) for x in row))
        if shapes != [3, 3, *[NA] * 3, *[NB] * 3] or not all(math.isfinite(x) for x in figures):
            raise InputError(f"innovation: three rows of {NA} a and {NB} b, all finite, are needed")
        if min(self.dt_s, self.window_s, self.memory_s, *self.k0) <= 0 or min(self.k1) < 0:
            raise InputError("innovation: spans and k0 must be positive, k1 not negative")


@dataclass(frozen=True, slots=True, eq=False)
class InnovationState:
    """What the next rows need.

    waiting_ns (w,), waiting (w, 3): raw gyro whose commanded rate is not known yet. past: (4, 6) commanded and
    measured rates of the last rows, past_valid (4,); busy (3,): exponential mean of the squared command.
    """

    segment: int
    waiting_ns: IntArray
    waiting: FloatArray
    past: FloatArray
    past_valid: BoolArray
    busy: FloatArray
    mean: MeanState


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Commanded and measured rate of n rows after the 4 before them, (4 + n, 3) each.

    valid: (n,) the row and the 4 before it may be judged. busy: (n, 3) exponential mean of u^2.
    """

    u: FloatArray
    y: FloatArray
    valid: BoolArray
    busy: FloatArray


@dataclass(frozen=True, slots=True)
class Innovation:
    """Statistic: rms of the normalised one-step prediction error over 1 s and three axes [times healthy rms].

        e(t) = A(z^-1) y(t) - B(z^-1) u(t),    z = e / sqrt(k0 + k1 EMA_0.35s(u^2)),    s = sqrt(mean_1s,3 axes z^2)

    u: commanded rate (derivative of the attitude set-point), y: raw gyro less its healthy mean, one ARX(4, 4, 1) by
    least squares for each of p, q, r. k0 and k1 by non-negative least squares of e^2, so a sharp manoeuvre that the
    healthy flights had does not count. About 1 in healthy flight. `level` equals the statistic, `signal` is the
    largest |z| of the row. It says nothing of rotors.

    Warm-up: half an SG window, 4 rows and 1 s. RunLength: half an SG window and up to 1 s. Price: see `threshold`.
    Blind spots: a weak rotor that is trimmed away (AUC 0.70 on recorded propeller cuts, where the threshold catches 1
    in 57); anything slow. Aerobatics, landings and wind that the healthy flights lacked raise it without a fault.

    >>> from mavdiag.testing import example_rows
    >>> rng = np.random.default_rng(4)
    >>> monitor = Innovation(fit([[example_rows(2000, rate=rng.normal(0.0, 0.1, (2000, 3)))]]))
    >>> _, rough = monitor.step(monitor.start(), example_rows(500, rate=rng.normal(0.0, 0.3, (500, 3))))
    >>> float(rough.statistic[-1].round(1))
    3.0
    """

    spec: InnovationSpec

    @property
    def name(self) -> str:
        """Key in the baseline, the journal and the scan report."""
        return "innovation"

    @property
    def unit(self) -> str:
        """Unit of the statistic."""
        return "x healthy rms"

    @property
    def axis(self) -> Axis | None:
        """It concerns the whole vehicle."""
        return None

    def start(self) -> InnovationState:
        """Nothing seen yet."""
        return _fresh(-1)

    def step(self, state: InnovationState, rows: Rows) -> tuple[InnovationState, Reading]:
        """The level at each row whose commanded rate became known."""
        spec = self.spec
        state, pairs = _pair(state, rows, spec.memory_s)
        e = _errors(pairs.u, pairs.y - np.array(spec.mean), np.array(spec.a), np.array(spec.b))
        z = np.clip(e / np.sqrt(np.array(spec.k0) + np.array(spec.k1) * pairs.busy), -LIMIT, LIMIT)
        window = window_rows(spec.window_s, rows.rates.dt_s)
        mean_state, mean, full = sliding_mean(state.mean, z**2, pairs.valid, window)
        level = np.sqrt(np.maximum(mean.mean(axis=1), 0.0))
        worst = np.abs(z).max(axis=1, initial=0.0)
        reading = Reading(rows.rates.t_ns, level, level, worst, full, np.empty((len(level), 0)))
        return replace(state, mean=mean_state), reading


def fit(flights: Flights, window_s: float = WINDOW_S, memory_s: float = MEMORY_S) -> InnovationSpec:
    """Identify the healthy one-step prediction.

    Of each flight's valid rows, until 120,000 rows are reached. Raises IdentificationError if there are too few.
    """
    reason = judgeable([rows for flight in flights for rows in flight])
    if reason is not None:
        raise IdentificationError(f"innovation: {reason}")
    pairs = _training_pairs(flights, memory_s)
    rows = sum(int(one.valid.sum()) for one in pairs)
    if rows < MIN_ROWS:
        raise IdentificationError(f"innovation: only {rows} rows of healthy flight, {MIN_ROWS} are needed; fly longer")
    mean = np.concatenate([one.y[LAG:][one.valid] for one in pairs]).mean(axis=0)
    a, b = np.empty((3, NA)), np.empty((3, NB))
    for axis in range(3):
        a[axis], b[axis] = _identify(pairs, axis, float(mean[axis]))
    squares = np.concatenate([_errors(one.u, one.y - mean, a, b)[one.valid] ** 2 for one in pairs])
    busy = np.concatenate([one.busy[one.valid] for one in pairs])
    k = [_variance(squares[:, axis], busy[:, axis]) for axis in range(3)]
    return InnovationSpec(
        dt_s=flights[0][0].rates.dt_s,
        mean=_three(mean.tolist()),
        a=tuple(tuple(row) for row in a.tolist()),
        b=tuple(tuple(row) for row in b.tolist()),
        k0=_three([k0 for k0, _ in k]),
        k1=_three([k1 for _, k1 in k]),
        window_s=window_s,
        memory_s=memory_s,
    )


def judgeable(rows: Sequence[Rows]) -> str | None:
    """Why these rows cannot be predicted, or None. A link is judged by a flight over it."""
    if not any(one.rates.valid.any() for one in rows):
        return "no flight with a gyro and an attitude set-point"
    rate_hz = 1 / rows[0].rates.dt_s
    if rate_hz < MIN_RATE_HZ:
        return f"the gyro comes at {rate_hz:.3g} Hz; a one-step prediction needs {MIN_RATE_HZ:.0f} Hz"
    return None


def _fresh(segment: int) -> InnovationState:
    never = np.zeros(LAG, dtype=np.bool_)
    nothing = np.empty(0, dtype=np.int64)
    return InnovationState(segment, nothing, np.empty((0, 3)), np.zeros((LAG, 6)), never, np.zeros(3), start_mean(3))


def _pair(state: InnovationState, rows: Rows, memory_s: float) -> tuple[InnovationState, _Pairs]:
    """Give each commanded rate the raw gyro of its own time."""
    block, rates = rows.block, rows.rates
    if state.segment != block.segment:
        state = _fresh(block.segment)
    waiting_ns = np.concatenate((state.waiting_ns, block.t_ns))
    waiting = np.concatenate((state.waiting, block.rate))
    if len(rates) == 0:
        nothing = np.empty((0, 3))
        kept = replace(state, waiting_ns=waiting_ns, waiting=waiting)
        return kept, _Pairs(state.past[:, :3], state.past[:, 3:], np.empty(0, dtype=np.bool_), nothing)
    at = np.minimum(np.searchsorted(waiting_ns, rates.t_ns), len(waiting_ns) - 1)
    fresh = np.concatenate((rates.u, waiting[at]), axis=1)
    good = rates.valid & (waiting_ns[at] == rates.t_ns) & np.isfinite(fresh).all(axis=1)
    both = np.concatenate((state.past, np.where(np.isfinite(fresh), fresh, 0.0)))
    valid = np.concatenate((state.past_valid, good))
    whole = np.logical_and.reduce([valid[i : len(valid) - LAG + i] for i in range(LAG + 1)])
    busy, trace = ema(state.busy, both[LAG:, :3] ** 2, forgetting(memory_s, rates.dt_s))
    used = int(at[-1]) + 1
    state = InnovationState(
        state.segment, waiting_ns[used:], waiting[used:], both[-LAG:], valid[-LAG:], busy, state.mean
    )
    return state, _Pairs(both[:, :3], both[:, 3:], whole, trace)


def _errors(u: FloatArray, y: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """One-step prediction errors e(t) = y(t) + a_1 y(t-1) + .. - b_1 u(t-1) - .., (LAG + n, 3) -> (n, 3)."""
    n = len(y) - LAG
    e = y[LAG:].copy()
    for i in range(1, NA + 1):
        e += a[:, i - 1] * y[LAG - i : LAG - i + n]
    for i in range(1, NB + 1):
        e -= b[:, i - 1] * u[LAG - i : LAG - i + n]
    return e


def _training_pairs(flights: Flights, memory_s: float) -> list[_Pairs]:
    pairs: list[_Pairs] = []
    for flight in flights:
        state = _fresh(-1)
        if sum(int(one.valid.sum()) for one in pairs) >= TRAIN_ROWS:
            break
        for rows in flight:
            state, one = _pair(state, rows, memory_s)
            pairs.append(one)
    return pairs


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


def _variance(squares: FloatArray, busy: FloatArray) -> tuple[float, float]:
    """k0 > 0 and k1 >= 0 of e^2 = k0 + k1 busy, by non-negative least squares; k0 at least 5 % of the mean of e^2."""
    floor = float(squares.mean())
    if floor == 0.0:
        raise IdentificationError("innovation: the gyro is constant or noise-free; is it a real sensor?")
    size = float(busy.mean())
    if size == 0.0:
        return floor, 0.0
    x = busy / size
    # [ n      sum x   ] [ k0 ]   [ sum e^2   ]      two unknowns: if one comes out negative, it is zero and the other
    # [ sum x  sum x^2 ] [ k1 ] = [ sum x e^2 ]      is its own least-squares solution
    spread = float(np.mean(x * x)) - 1.0
    k1 = (float(np.mean(x * squares)) - floor) / spread if spread > 0 else 0.0
    k0 = floor - k1
    if k1 < 0:
        k0, k1 = floor, 0.0
    elif k0 < 0:
        k0, k1 = 0.0, float(np.mean(x * squares) / np.mean(x * x))
    return max(k0, MIN_SHARE * floor), k1 / size


def _three(values: Sequence[float]) -> Three:
    roll, pitch, yaw = values
    return roll, pitch, yaw
