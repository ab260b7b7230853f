"""The innovation monitor: how badly one step ahead of the gyro is predicted, against healthy flight."""

import math
from collections.abc import Iterable
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.identify.arx import triangle, without_rounding
from mavdiag.jit import allocating, cached
from mavdiag.monitors.base import Begin, Flights, LearnContext, Monitor, segments
from mavdiag.monitors.fitting import MEMORY_S, cut_to_share, need_commanded, of_each, smoothed, three, variance_law
from mavdiag.monitors.spec import Delay, NotNegative, Period, Positive, Span, spec
from mavdiag.rows.block import COMMANDED, GYRO, LEVEL, MADE_UP, SOUND, VALID, VALUE, Floats, Ints, U
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import forgetting, window_all, window_rows
from mavdiag.telemetry import BoolArray, FloatArray, IntArray, Signal, Three

LAG = 4  # rows that A and B look back: METHOD section 5; 2 to 5 change no verdict on the recorded flights
SETTLED = 3.0  # so many times the memory after a command what it made has passed (our choice)
WINDOW_S = 1.0  # our choice; 0.7 to 1.3 s change no verdict
SLOW_S = 0.016  # memory of the mean error: what changes below 10 Hz is no news, for gusts make it (our choice)
GUST_RAD_S, GUST_S = 0.05, 0.2  # rms and memory of the rate that gusts make (our choice, after RotorPy's of 0.3 m/s)
# rad/s by which a command is wrong (our choice; 0.0003 to 0.003 answer alike). Else a calm command, which is smooth, is
# fitted best by its third differences, which gusts make large.
ROUNDED_RAD_S = 0.001
MIN_ROWS = 500  # 60 a parameter (our choice)
TRAIN_ROWS = 120_000  # more of it no longer changes the coefficients (our choice)
SHIFTS = 0.06, 0.12  # of a rotor's frequency: its line moves so far with a load that counts as covered (our choice)
CONSTANT = "the gyro is constant or noise-free; is it a real sensor?"
RANK_TOLERANCE = 1e-10
GLITCH_ROWS = 3 + LAG  # whose innovations three bad samples spoil
# Healthy rms; of what is larger only the share that no glitch explains counts. A Gaussian residual reaches it in years
# (our choice).
LIMIT, MOST = 6.0, 1e6
STILL_ROWS = 3  # equal ones after another say nothing new, be they rounded or repeated (our choice)
# Places in the parameters: of how many rows ago rates are, of each axis mean, k0, k1, a and b; in the memory: good,
# equal, measured and idle rows in a row, of each axis mean square of the command and mean error; mean of innovations.
WINDOW, ALPHA, SLOW, BEHIND, AXES = range(5)
MEAN_AT, K0, K1, A, B, OF_AXIS = 0, 1, 2, 3, 3 + LAG, 3 + 2 * LAG
GOOD, SAME, MEASURED, IDLE, BUSY, DRIFT, MEAN = 0, 1, 2, 3, 4, 7, 10

Four: TypeAlias = tuple[float, float, float, float]


@spec
class InnovationSpec:
    """Healthy prediction of roll, pitch and yaw rate, in that order."""

    kind: Literal["innovation"] = "innovation"
    dt_s: Period
    mean: Three  # bias of the healthy gyro, mean(gyro - commanded rate) [rad/s]: a nose that turns steadily is none
    a: tuple[Four, Four, Four]  # of each axis a_1..a_4
    b: tuple[Four, Four, Four]
    k0: tuple[Positive, Positive, Positive]  # variance of the innovation at rest [(rad/s)^2]
    k1: tuple[NotNegative, NotNegative, NotNegative]  # and per mean square of the commanded rate
    window_s: Span = WINDOW_S
    memory_s: Span = MEMORY_S  # of the command
    slow_s: Span = SLOW_S  # memory of the mean error
    delay_s: Delay = 0.0  # half the window of the rate filters


@allocating
def _squares(par: Floats, mem: Floats, x: Floats, known: int) -> Floats:
    """z^2 of the three axes, (3, n)."""
    out, alpha, slow = np.empty((3, x.shape[1] - known)), par[ALPHA], par[SLOW]
    for axis in range(3):
        of, to = par[AXES + axis * OF_AXIS : AXES + (axis + 1) * OF_AXIS], out[axis]
        busy, drift = mem[BUSY + axis], mem[DRIFT + axis]
        u, y, mean = x[U + axis, known - LAG :], x[GYRO + axis, known - LAG :], of[MEAN_AT]
        for k in range(len(to)):
            e = y[k + LAG] - mean
            for j in range(LAG):
                e += of[A + j] * (y[k + LAG - 1 - j] - mean) - of[B + j] * u[k + LAG - 1 - j]
            command = u[k + LAG] if math.isfinite(u[k + LAG]) else 0.0
            busy += alpha * (command * command - busy)
            new, variance = e - drift, of[K0] + of[K1] * busy
            to[k] = min(new * new / variance, MOST * MOST)
            if to[k] <= LIMIT * LIMIT:
                drift += slow * new
            elif math.isfinite(new):
                drift += slow * math.copysign(LIMIT * math.sqrt(variance), new)
        mem[BUSY + axis], mem[DRIFT + axis] = busy, drift
    return out


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The level at each row whose commanded rate became known."""
    window, row, squares, behind = int(par[WINDOW]), MEAN + FRESH, _squares(par, mem, x, known), int(par[BEHIND])
    for k in range(squares.shape[1]):
        i, sum_, same, usual, most, level = known + k, 0.0, True, 0.0, 0.0, 0.0
        for axis in range(3):
            sum_, same = sum_ + x[U + axis, i] + x[GYRO + axis, i], same and x[GYRO + axis, i] == x[GYRO + axis, i - 1]
            usual, most = usual + min(squares[axis, k], LIMIT * LIMIT), most + squares[axis, k]
        mem[SAME] = mem[SAME] + 1.0 if same else 0.0
        good = x[COMMANDED, i] > 0.5 and math.isfinite(sum_) and mem[SAME] < STILL_ROWS
        mem[GOOD] = mem[GOOD] + 1.0 if good else 0.0
        mem[MEASURED] = mem[MEASURED] + 1.0 if x[VALID, i - behind] != MADE_UP else 0.0
        sound = mem[GOOD] > LAG
        if sound:  # the last second of *measured* rows: a gap within a segment does not start the window anew
            mem[IDLE] = 0.0 if mem[MEASURED] > LAG else mem[IDLE] + 1.0
            if mem[IDLE] == 0.0:
                mem[row], mem[row + 1], mem[row + 2] = usual, most - usual, 1.0 if most > usual else 0.0
                push(mem, MEAN, window, 3, True)
            sound = mem[MEAN + 1] >= window > mem[IDLE]
            rough = total(mem, MEAN, 3, 2)
            share = 1.0 - GLITCH_ROWS / rough if rough > GLITCH_ROWS + 0.5 else 0.0
            sum_ = total(mem, MEAN, 3, 0) + share * total(mem, MEAN, 3, 1)
            level = math.sqrt(max(sum_, 0.0) / (3 * window))
        out[VALUE, k], out[SOUND, k], out[LEVEL, k], at[k] = level, sound, level, k
    return len(at) - (known - first)


class Innovation(Monitor[InnovationSpec]):
    """Statistic: rms of the normalised one-step prediction error over 1 s and three axes [times healthy rms].

        e(t) = A(z^-1) y(t) - B(z^-1) u(t),    s = sqrt(mean_1s,3 axes z^2)
        z(t) = (e(t) - EMA_16ms(e)(t - 1)) / sqrt(k0 + k1 EMA_0.35s(u^2)(t))

    u: commanded rate, y: raw gyro less its healthy bias, one ARX(4, 4, 1) by least squares for each axis. Of what z^2
    is beyond 36, in n rows of the second, the share 1 - 7/n counts: a glitch of three samples spoils 7 rows. Rows that
    repeat or rest on lost samples are left out. Gusts move e below 10 Hz: what the errors before had on the mean is no
    news. Without a filter in the stream A and B are fitted to the gyro as it is, and with what is fast in it shifted by
    6 and 12 % of a rotor's frequency, for a folded line moves with a load. In calm air u alone says where y is, and A,
    B that fit it best are wrong in gusts: as many rows are added in which y moves as gusts move it (`_unseen`).

    Warm-up: half an SG window, 4 rows and 1 s; after a gap of less than a second only the first two. Latency: half an
    SG window and up to 1 s. False alarms: aerobatics and storms that the healthy flights lacked. Blind spots: a weak
    rotor that is trimmed away (AUC 0.66 on 57 recorded propeller cuts); anything slow; a loss of each fifth row.
    """

    name = "innovation"
    label = "innovation"
    observes = "motion that is predicted badly one step ahead"
    phrase = "attitude unlike the model"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT})
    depends = frozenset(Condition) - {Condition.TILT}
    least_hz = 20.0  # below it a step ahead is too far to predict a rate (our choice)
    why_hz = "a one-step prediction needs {:.0f} Hz"
    by_rates = True
    spec_type = InnovationSpec
    unit = "x healthy rms"
    reach = MOST  # where a normalised error is cut
    run = staticmethod(run)

    def __init__(self, spec: InnovationSpec) -> None:
        super().__init__(spec)
        self.memory_s = spec.window_s + SETTLED * spec.memory_s

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[InnovationSpec, ...]:
        """Identify the healthy one-step prediction, of a like share of every flight's rows."""
        need_commanded(flights)
        pairs = _training_pairs(flights)
        still = all((one.y[:, LAG:] == one.y[:, LAG : LAG + 1]).all() for one in pairs)
        if still and sum(len(one.valid) for one in pairs) >= MIN_ROWS:
            raise IdentificationError(CONSTANT)
        rows = sum(int(one.valid.sum()) for one in pairs)
        if rows < MIN_ROWS:
            raise IdentificationError(f"only {rows} rows of healthy flight, {MIN_ROWS} are needed; fly longer")
        rest = [np.compress(one.valid, one.y[:, LAG:] - one.u[:, LAG:], axis=1) for one in pairs]
        mean = np.concatenate(rest, axis=1).mean(axis=1)
        busy = np.concatenate([np.compress(one.valid, one.busy, axis=1) for one in pairs], axis=1)
        a, b, laws = list[Four](), list[Four](), list[tuple[float, float]]()
        speed = None if context.imu_corner_hz else context.airframe.hover_rad_s  # a filter leaves no line
        turns = [shift * speed * context.dt_s for shift in SHIFTS] if speed else []
        shifted = [_shifted(one, turn) for turn in turns for one in pairs]
        borders, slow = np.cumsum([one.valid.sum() for one in pairs])[:-1], forgetting(SLOW_S, context.dt_s)
        unseen = _unseen(context.dt_s)
        for axis in range(3):
            # [ -y(t-1) .. -y(t-4)   u(t-1) .. u(t-4)   y(t) ]'    (9, n), the valid rows of all flights
            stacked = np.concatenate([_regression(one, axis, float(mean[axis])) for one in pairs], axis=1)
            triangles = [triangle(_regression(one, axis, float(mean[axis])).T) for one in shifted]
            R = triangle(np.concatenate((triangle(stacked.T), *triangles)))
            R = triangle(np.concatenate((R, math.sqrt((1 + len(triangles)) * stacked.shape[1]) * unseen)))
            scale = np.linalg.norm(R[:, :-1], axis=0)
            theta = np.linalg.lstsq(R[:, :-1] / scale, R[:, -1], rcond=RANK_TOLERANCE)[0] / scale
            errors = np.split((stacked[-1] - theta @ stacked[:-1])[:, None], borders)
            squares = np.concatenate([np.square((e - smoothed(e, slow)) / (1.0 - slow)) for e in errors])[:, 0]
            steps = np.abs(np.diff(stacked[-1]))
            if squares.mean() == 0.0 or not steps.any():
                raise IdentificationError(CONSTANT)
            k0, k1 = variance_law(squares, busy[axis])
            resolution = float(steps[steps > 0.0].min())  # a gyro that rests on one value has no less noise than this
            laws.append((max(k0, resolution**2 / 12.0), k1))
            a.append(_four(theta[:LAG]))
            b.append(_four(theta[LAG:]))
        found = InnovationSpec(
            dt_s=context.dt_s,
            mean=three(mean),
            a=(a[0], a[1], a[2]),
            b=(b[0], b[1], b[2]),
            k0=three([k0 for k0, _ in laws]),
            k1=three([k1 for _, k1 in laws]),
            delay_s=context.delay_s,
        )
        return (found,)

    def begin(self, dt_s: float) -> Begin:
        """No row yet."""
        spec, window, behind = self.spec, window_rows(self.spec.window_s, dt_s), round(self.spec.delay_s / dt_s)
        axes = zip(spec.mean, spec.k0, spec.k1, spec.a, spec.b, strict=True)
        each = [value for mean, k0, k1, a, b in axes for value in (mean, k0, k1, *a, *b)]
        par = np.array([window, forgetting(spec.memory_s, dt_s), forgetting(spec.slow_s, dt_s), behind, *each])
        return Begin(par, np.zeros(MEAN + mean_size(window, 3)), max(LAG, behind))


class _Pairs(NamedTuple):
    u: FloatArray  # (3, 4 + n) commanded and measured rate [rad/s]
    y: FloatArray
    valid: BoolArray  # (n,) the row and the 4 before it may be judged
    busy: FloatArray  # (3, n) exponential mean of u^2
    fast: FloatArray  # (3, 4 + n) what the rate filters take from y


def _training_pairs(flights: Flights) -> list[_Pairs]:
    """Of each segment of all flights the first rows, so many that a like share of what is commanded is in them."""
    found = of_each(flights, "told rows", lambda one: [[r.rates.commanded.sum() for r in s] for s in segments(one)])
    counts = [int(sum(parts)) for one in found for parts in one]
    shares = iter(cut_to_share(counts, TRAIN_ROWS, 0))  # of one flight after the other, so that one is in memory
    pairs = (pair for flight in flights for pair in zip(segments(flight), shares, strict=False))
    return [_pairs_of(segment, most) for segment, most in pairs if most]


def _pairs_of(segment: Iterable[Rows], most: int) -> _Pairs:
    """The pairs of a segment up to so many commanded rows."""
    parts, dt_s, made_up = [], 0.0, list[IntArray]()
    for rates, block in ((rows.rates, rows.block) for rows in segment):
        dt_s = rates.dt_s
        made_up.append(block.t_ns[block.x[VALID] == MADE_UP])
        n = int(np.searchsorted(np.cumsum(rates.commanded), most)) + 1
        gyro = rates.gyro[:n].T
        parts.append((rates.u[:n].T, gyro, gyro - rates.y[:n].T, rates.commanded[:n], rates.t_ns[:n]))
        most -= int(np.count_nonzero(rates.commanded[:n]))
        if most <= 0:
            break
    u, y, fast, good, t_ns = (np.concatenate(column, axis=-1) for column in zip(*parts, strict=True))
    known = np.isfinite(u).all(axis=0) & np.isfinite(y).all(axis=0)
    u, y, fast = (np.pad(np.where(np.isfinite(one), one, 0.0), ((0, 0), (LAG, 0))) for one in (u, y, fast))
    u = np.stack([without_rounding([one], [rate])[0] for one, rate in zip(u, y, strict=True)])
    changed = np.concatenate(([False], (y[:, 1:] != y[:, :-1]).any(axis=0)))
    stirred = ~window_all(~changed, STILL_ROWS)[LAG - STILL_ROWS + 1 :]
    good = good & known & stirred & ~np.isin(t_ns, np.concatenate(made_up))
    busy = smoothed(np.square(u[:, LAG:]).T, forgetting(MEMORY_S, dt_s)).T
    return _Pairs(u, y, window_all(np.concatenate((np.zeros(LAG, dtype=np.bool_), good)), LAG + 1), busy, fast)


def _shifted(pairs: _Pairs, turn: float) -> _Pairs:
    """With what is fast higher and lower by so much [rad a row], in equal parts of the same power."""
    carrier = math.sqrt(2.0) * np.cos(turn * np.arange(pairs.y.shape[1]))
    return pairs._replace(y=pairs.y + pairs.fast * (carrier - 1.0))


def _regression(pairs: _Pairs, axis: int, mean: float) -> FloatArray:
    """The regression of one axis, (9, k) of its valid rows."""
    y, u, n = pairs.y[axis] - mean, pairs.u[axis], len(pairs.valid)
    columns = [signal[LAG - i : LAG - i + n] for signal in (-y, u) for i in range(1, LAG + 1)]
    return np.compress(pairs.valid, [*columns, y[LAG:]], axis=1)


def _unseen(dt_s: float) -> FloatArray:
    """R of the regression of one row of what calm flights do not show: (9, 9).

    A rate that gusts make and no command is white noise behind two poles at GUST_S, whose correlation after a time t is
    (1 + t/GUST_S) e^(-t/GUST_S). And a command is wrong by white noise, which no rate follows.
    """
    late = np.abs(np.subtract.outer(range(LAG + 1), range(LAG + 1))) * dt_s / GUST_S
    y = GUST_RAD_S * np.linalg.cholesky((1.0 + late) * np.exp(-late)).T  # of now and of the rows before
    gust = np.column_stack((-y[:, 1:], np.zeros((LAG + 1, LAG)), y[:, 0]))
    return np.concatenate((gust, ROUNDED_RAD_S * np.eye(LAG, 2 * LAG + 1, LAG)))


def _four(values: FloatArray) -> Four:
    first, second, third, fourth = values.tolist()
    return first, second, third, fourth
