"""What pushes the airframe: the parts of roll rate, pitch rate and vertical acceleration that the model cannot explain.

    r_roll, r_pitch = y - y_sim                  free run of a closed-loop ARX model on the commanded rate (T 5.5)
    r_heave         = a_z - a_sim                the same on the commanded thrust
    r  <- r - EMA_1s(r)                          slow wind and trim are no fault
    r  <- r - g f - h df/dt                      f: y_sim without its slow part; g, h follow the last 10 s
    n   = r / sqrt(k0 + k1 EMA_0.35s(u^2))       u: what was commanded; a sharp manoeuvre may leave more (METHOD 4)
    n  <- clip(n, +-4 s)                         s^2 = max(1, EMA_10s(n^2)): a jolt counts little, unrest in full

g is an error of the loop's gain and h one of its speed: a battery that empties, a payload and new propellers change
them by some percent, slowly and for every manoeuvre alike. They are the least-squares fit to the last 10 s, drawn to
zero where little was commanded; an unsteady rotor has no part in them, since what it does does not follow f.

The filtered rates hold nothing above some 8 Hz, so all of this runs on every tenth row at 1 kHz. A step of commanded
motion that began before the first row cannot be simulated: the first 1.5 s of a segment are left out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from mavdiag.errors import InputError
from mavdiag.identify import freerun
from mavdiag.identify.freerun import FreeRunState
from mavdiag.identify.model import ModelRecord
from mavdiag.monitors.healthy import MEMORY_S, Three
from mavdiag.rows.front import Rows
from mavdiag.rows.savgol import coefficients
from mavdiag.rows.windows import ema, forgetting
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = [
    "DRIFT_S",
    "Decimated",
    "Decimator",
    "DecimatorState",
    "HealthyMotion",
    "ModelResidual",
    "ResidualState",
    "Residuals",
    "stride_of",
]

PERIOD_S = 0.01  # our choice: ten times what the 0.1 s window passes
DRIFT_S = 1.0  # our choice; 0.5 to 2 s find the same faults
FOLLOW_S = 10.0  # memory of the gain error; 5 to 20 s judge alike (our choice)
GAIN_RMS = 0.3  # gain and speed errors that are expected before anything was seen (our choice)
SPEED_S = 0.05  # time that h is in units of (our choice)
CORRELATION_S = 0.1  # residuals this far apart are independent (METHOD section 4: 8 Hz pass)
TOGETHER = 16  # windows that one matrix product smooths (our choice)
JOLT = 4.0  # of the rms of the last 10 s: what is larger is a jolt, such as a payload that is taken up (our choice)
SETTLE_S = 1.5  # our choice: the slowest pole that T's models have without their integrator dies out in it


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthyMotion:
    """How the healthy airframe answers.

    dt_s: row period [s].
    stride: rows from one sample to the next.
    window: rows of the rate filters, odd.
    roll, pitch: rate [rad/s] on commanded rate.
    heave: vertical acceleration [m/s^2] on thrust 0..1, both less their 1 s mean.
    k0: variance of the residuals of roll, pitch and heave at rest.
    k1: variance per mean square of what was commanded.
    Raises InputError if they do not fit together.
    """

    dt_s: float
    stride: int
    window: int
    roll: ModelRecord
    pitch: ModelRecord
    heave: ModelRecord
    k0: Three = (1.0, 1.0, 1.0)
    k1: Three = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dt_s) and self.dt_s > 0) or self.stride < 1 or self.window % 2 == 0:
            raise InputError("rotor_signature: row period, stride and an odd filter window must be positive")
        if not all(math.isfinite(x) for x in (*self.k0, *self.k1)) or min(self.k0) <= 0 or min(self.k1) < 0:
            raise InputError("rotor_signature: k0 must be positive and k1 not negative")

    @property
    def period_s(self) -> float:
        """Time between two samples [s]."""
        return self.dt_s * self.stride

    @property
    def uses_thrust(self) -> bool:
        """Whether the thrust explains part of the vertical acceleration."""
        return any(self.heave.b)


@dataclass(frozen=True, slots=True, eq=False)
class Decimated:
    """Every so many rows.

    t_ns: (k,) time of the newest row behind it.
    u, y: (k, 2) roll and pitch rate, commanded and measured [rad/s].
    heave: (k, 2) vertical acceleration [m/s^2] and thrust, filtered alike.
    valid: (k,) rates and acceleration are known.
    """

    t_ns: IntArray
    u: FloatArray
    y: FloatArray
    heave: FloatArray
    valid: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class DecimatorState:
    """Rows that wait.

    skip: rate rows until the next sample.
    raw, raw_ns: (2, h) acceleration and thrust, and (h,) their times.
    rates: (p, 5) u, y and valid of samples without their heave.
    heave, heave_ns: (q, 2) and (q,) of samples without their rates.
    """

    skip: int
    raw: FloatArray
    raw_ns: IntArray
    rates: FloatArray
    heave: FloatArray
    heave_ns: IntArray


def stride_of(dt_s: float) -> int:
    """Rows between two samples at a row period [s]."""
    return max(1, round(PERIOD_S / dt_s))


class Decimator:
    """Takes every `stride`-th of the rates, with acceleration and thrust smoothed by the same `window` (odd)."""

    def __init__(self, stride: int, window: int) -> None:
        self._stride, self._window = stride, window
        self._taps = coefficients(window, min(2, window - 1))[0]
        self._shifted = np.zeros(((TOGETHER - 1) * stride + window, TOGETHER))
        for i in range(TOGETHER):
            self._shifted[i * stride : i * stride + window, i] = self._taps

    def start(self) -> DecimatorState:
        """Before the first row of a segment."""
        never = np.empty(0, dtype=np.int64)
        return DecimatorState(0, np.empty((2, 0)), never, np.empty((0, 5)), np.empty((0, 2)), never)

    def step(self, state: DecimatorState, rows: Rows) -> tuple[DecimatorState, Decimated]:
        """Take the next rows; return the samples that they complete."""
        block, rates, stride = rows.block, rows.rates, self._stride
        at = np.arange(state.skip, len(rates), stride)
        fresh = np.empty((len(at), 5))
        fresh[:, :2], fresh[:, 2:4], fresh[:, 4] = rates.u[at, :2], rates.y[at, :2], rates.commanded[at]
        skip = state.skip + len(at) * stride - len(rates)

        raw = np.concatenate((state.raw, [block.force[:, 2], block.thrust]), axis=1)
        raw_ns = np.concatenate((state.raw_ns, block.t_ns))
        smoothed = self._smooth(raw)
        count = len(smoothed)
        both, heave = np.concatenate((state.rates, fresh)), np.concatenate((state.heave, smoothed))
        heave_ns = np.concatenate((state.heave_ns, raw_ns[self._window - 1 :: stride][:count]))
        n, used = min(len(both), len(heave)), count * stride
        valid = (both[:n, 4] > 0.5) & np.isfinite(heave[:n, 0])
        if not math.isfinite(float(np.add.reduce(both[:n], axis=None))):
            valid &= np.isfinite(both[:n]).all(axis=1)
        out = Decimated(heave_ns[:n], both[:n, :2], both[:n, 2:4], heave[:n], valid)
        return DecimatorState(skip, raw[:, used:], raw_ns[used:], both[n:], heave[n:], heave_ns[n:]), out

    def _smooth(self, raw: FloatArray) -> FloatArray:
        """(2, h) -> (count, 2): the full windows that begin at rows 0, stride, 2 stride .."""
        window, stride = self._window, self._stride
        count = max(0, (raw.shape[1] - window) // stride + 1)
        out = np.empty((count, 2))
        for first in range(0, count, TOGETHER):
            n = min(TOGETHER, count - first)
            reach = (n - 1) * stride + window
            rows = raw[:, first * stride : first * stride + reach]
            if math.isfinite(float(np.add.reduce(rows, axis=None))):
                base = rows[:, :1]  # the taps add up to 1; without it a constant would get the rounding of its sums
                out[first : first + n] = ((rows - base) @ self._shifted[:reach, :n] + base).T
            else:  # what is unknown spoils the windows that hold it, and no other
                for i in range(n):
                    out[first + i] = rows[:, i * stride : i * stride + window] @ self._taps
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What the models do not explain.

    t_ns: (k,) time of the newest row behind it.
    r: (k, 3) residuals of roll and pitch rate [rad/s] and heave [m/s^2].
    n: (k, 3) the same, normalised.
    busy: (k, 3) exponential mean square of what was commanded.
    valid: (k,) all that it rests on was known.
    """

    t_ns: IntArray
    r: FloatArray
    n: FloatArray
    busy: FloatArray
    valid: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class ResidualState:
    """What the next rows need.

    waiting: rows of an unfinished sample.
    seen: samples since the segment began.
    runs: the three simulations; empty before the first sample.
    level: (2,) running mean of acceleration and thrust.
    drift: (3,) running mean of the residuals.
    busy: (3,) running mean square of what was commanded.
    thrust: the last one.
    errors: what the correction of gain and speed needs.
    unrest: (3,) running mean square of n.
    """

    waiting: DecimatorState
    seen: int
    runs: tuple[FreeRunState, ...]
    level: FloatArray
    drift: FloatArray
    busy: FloatArray
    thrust: float
    errors: "_Errors"
    unrest: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Memory of the gain and speed errors.

    simulated: (3,) the last simulated values. slow: (6,) running means of f and df/dt. sums: (15,) running means of
    f f, f df, df df, f r and df r, each of roll, pitch and heave.
    """

    simulated: FloatArray
    slow: FloatArray
    sums: FloatArray


class ModelResidual:
    """The healthy models at work: rows in, residuals out. follows: the errors of gain and speed are taken out."""

    def __init__(self, motion: HealthyMotion, follows: bool = True) -> None:
        self.motion, self._follows = motion, follows
        self._decimator = Decimator(motion.stride, motion.window)
        self._models = tuple(record.model() for record in (motion.roll, motion.pitch, motion.heave))
        self._k0, self._k1 = np.array(motion.k0), np.array(motion.k1)
        self._drift = forgetting(DRIFT_S, motion.period_s)
        self._memory = forgetting(MEMORY_S, motion.period_s)
        self._follow = forgetting(FOLLOW_S, motion.period_s)
        self._prior = self._k0 * (CORRELATION_S / (FOLLOW_S * GAIN_RMS**2))

    def start(self) -> ResidualState:
        """Before the first row."""
        return ResidualState(
            waiting=self._decimator.start(),
            seen=0,
            runs=(),
            level=np.zeros(2),
            drift=np.zeros(3),
            busy=np.zeros(3),
            thrust=0.0,
            errors=_no_errors(),
            unrest=np.ones(3),
        )

    def step(self, state: ResidualState, rows: Rows) -> tuple[ResidualState, Residuals]:
        """The residuals that the next rows complete."""
        waiting, samples = self._decimator.step(state.waiting, rows)
        k = len(samples.t_ns)
        if k == 0:
            empty = np.empty((0, 3))
            return replace(state, waiting=waiting), Residuals(samples.t_ns, empty, empty, empty, samples.valid)
        u, y, heave = (_finite(part) for part in (samples.u, samples.y, samples.heave))
        if not state.runs:
            state = self._begin(state, u, y, heave)
        level, mean = ema(state.level, heave, self._drift)
        slope = _steps(heave[:, 1:], np.array([state.thrust])) / self.motion.period_s
        runs, r, simulated = self._simulate(state, u, y, heave - mean)
        settled = np.arange(state.seen, state.seen + k) >= SETTLE_S / self.motion.period_s
        if not settled[0]:
            r[~settled] = 0.0
        drift, slow = ema(state.drift, r, self._drift)
        r -= slow
        errors = state.errors
        if self._follows:
            errors, explained = self._explained(errors, simulated, r)
            r -= explained
        busy, trace = ema(state.busy, np.square(np.concatenate((u, slope), axis=1)), self._memory)
        unrest, n = _without_jolts(state.unrest, r / np.sqrt(self._k0 + self._k1 * trace), self._follow)
        state = ResidualState(waiting, state.seen + k, runs, level, drift, busy, float(heave[-1, 1]), errors, unrest)
        known = np.isfinite(samples.heave[:, 1]) if self.motion.uses_thrust else settled
        return state, Residuals(samples.t_ns, r, n, trace, samples.valid & settled & known)

    def _begin(self, state: ResidualState, u: FloatArray, y: FloatArray, heave: FloatArray) -> ResidualState:
        """Start the models from the first measured rates at rest in them, and the means from the first values."""
        rates = [
            freerun.start(model, np.full(len(model.b), u[0, i]), np.full(len(model.a), y[0, i]))
            for i, model in enumerate(self._models[:2])
        ]
        runs = (*rates, freerun.start(self._models[2]))
        return replace(state, runs=runs, level=heave[0].copy(), thrust=float(heave[0, 1]))

    def _simulate(
        self, state: ResidualState, u: FloatArray, y: FloatArray, lift: FloatArray
    ) -> tuple[tuple[FreeRunState, ...], FloatArray, FloatArray]:
        """Measured less simulated roll rate, pitch rate and a_z, and the simulated, (k, 3). lift: a_z and thrust."""
        runs, r, y_sim = [], np.empty((len(u), 3)), np.empty((len(u), 3))
        pairs = ((u[:, 0], y[:, 0]), (u[:, 1], y[:, 1]), (lift[:, 1], lift[:, 0]))
        for i, (command, measured) in enumerate(pairs):
            run, simulated = freerun.step(self._models[i], state.runs[i], command)
            runs.append(run)
            r[:, i], y_sim[:, i] = measured - simulated, simulated
        return tuple(runs), r, y_sim

    def _explained(self, errors: _Errors, simulated: FloatArray, r: FloatArray) -> tuple[_Errors, FloatArray]:
        """What the errors of gain and speed, as known before each sample, explain of it: (k, 3)."""
        df = _steps(simulated, errors.simulated) * (SPEED_S / self.motion.period_s)
        both = np.concatenate((simulated, df), axis=1)
        slow, trace = ema(errors.slow, both, self._drift)
        both -= trace
        f, df = both[:, :3], both[:, 3:]
        # [ mean f f + prior   mean f df          ] [ g ]   [ mean f r  ]
        # [ mean f df          mean df df + prior ] [ h ] = [ mean df r ]
        products = np.concatenate((f * f, f * df, df * df, f * r, df * r), axis=1)
        sums, means = ema(errors.sums, products, self._follow)
        before = np.concatenate((errors.sums[None], means[:-1]))
        ff, fd, dd, fr, dr = (before[:, i : i + 3] for i in range(0, 15, 3))
        ff, dd = ff + self._prior, dd + self._prior
        determinant = ff * dd - fd * fd
        g, h = (dd * fr - fd * dr) / determinant, (ff * dr - fd * fr) / determinant
        return _Errors(simulated[-1], slow, sums), g * f + h * df


def _no_errors() -> _Errors:
    return _Errors(np.zeros(3), np.zeros(6), np.zeros(15))


def _without_jolts(unrest: FloatArray, n: FloatArray, alpha: float) -> tuple[FloatArray, FloatArray]:
    """n, (k, 3), clipped at `JOLT` times its rms of the last seconds; at least at `JOLT`."""
    if np.maximum.reduce(np.abs(n), axis=None) <= JOLT:  # nothing to clip, whatever came before
        return ema(unrest, np.square(n), alpha)[0], n
    out = np.empty(n.shape)
    last = unrest.tolist()
    for column, values in enumerate(n.T.tolist()):
        square, kept = last[column], []
        for value in values:
            most = JOLT * math.sqrt(square) if square > 1.0 else JOLT
            clipped = most if value > most else -most if value < -most else value
            square += alpha * (clipped * clipped - square)
            kept.append(clipped)
        out[:, column], last[column] = kept, square
    return np.array(last), out


def _steps(x: FloatArray, before: FloatArray) -> FloatArray:
    """Differences of rows, (n, k) after (k,) -> (n, k)."""
    out = np.empty(x.shape)
    out[0] = x[0] - before
    np.subtract(x[1:], x[:-1], out=out[1:])
    return out


def _finite(x: FloatArray) -> FloatArray:
    """x with zeros for what is no number; such samples are marked invalid."""
    return x if math.isfinite(float(np.add.reduce(x, axis=None))) else np.where(np.isfinite(x), x, 0.0)
