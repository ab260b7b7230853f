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
from mavdiag.monitors.decimated import Decimator, DecimatorState
from mavdiag.monitors.healthy import MEMORY_S, Three
from mavdiag.rows.front import Rows
from mavdiag.rows.windows import EmaState, ema, forgetting, raised, start_ema
from mavdiag.telemetry import BoolArray, FloatArray, IntArray

__all__ = [
    "DRIFT_S",
    "HealthyMotion",
    "ModelResidual",
    "ResidualState",
    "Residuals",
    "without_jolts",
]

DRIFT_S = 1.0  # our choice; 0.5 to 2 s find the same faults
FOLLOW_S = 10.0  # memory of the gain error; 5 to 20 s judge alike (our choice)
GAIN_RMS = 0.3  # gain and speed errors that are expected before anything was seen (our choice)
SPEED_S = 0.05  # time that h is in units of (our choice)
CORRELATION_S = 0.1  # residuals this far apart are independent (METHOD section 4: 8 Hz pass)
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
    heave: (2,) the last acceleration and thrust that were known; they hold until the next ones.
    errors: what the correction of gain and speed needs.
    unrest: (3,) running mean square of n.
    """

    waiting: DecimatorState
    seen: int
    runs: tuple[FreeRunState, ...]
    level: EmaState
    drift: EmaState
    busy: EmaState
    heave: FloatArray
    errors: "_Errors"
    unrest: EmaState


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Memory of the gain and speed errors.

    simulated: (3,) the last simulated values. slow: (6,) running means of f and df/dt. sums: (15,) running means of
    f f, f df, df df, f r and df r, each of roll, pitch and heave. means: (15,) their values.
    """

    simulated: FloatArray
    slow: EmaState
    sums: EmaState
    means: FloatArray


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
            level=start_ema(np.zeros(2)),
            drift=start_ema(np.zeros(3)),
            busy=start_ema(np.zeros(3)),
            heave=np.zeros(2),
            errors=_no_errors(),
            unrest=start_ema(np.ones(3)),
        )

    def step(self, state: ResidualState, rows: Rows) -> tuple[ResidualState, Residuals]:
        """The residuals that the next rows complete."""
        waiting, samples = self._decimator.step(state.waiting, rows)
        k = len(samples.t_ns)
        if k == 0:
            empty = np.empty((0, 3))
            return replace(state, waiting=waiting), Residuals(samples.t_ns, empty, empty, empty, samples.valid)
        u, y, heave = _finite(samples.u), _finite(samples.y), held(samples.heave, state.heave)
        if not state.runs:
            state = self._begin(state, u, y, heave)
        level, mean = ema(state.level, heave, self._drift)
        slope = _steps(heave[:, 1:], state.heave[1:]) / self.motion.period_s
        runs, r, simulated = self._simulate(state, u, y, heave - mean)
        settled = np.arange(state.seen, state.seen + k) >= SETTLE_S / self.motion.period_s
        known = samples.valid & settled
        if np.count_nonzero(known) < k:  # what is not known is not unexplained
            r[~known] = 0.0
        drift, slow = ema(state.drift, r, self._drift)
        r -= slow
        errors = state.errors
        if self._follows:
            errors, explained = self._explained(errors, simulated, r)
            r -= explained
        busy, trace = ema(state.busy, np.square(np.concatenate((u, slope), axis=1)), self._memory)
        unrest, n = without_jolts(state.unrest, r / np.sqrt(self._k0 + self._k1 * trace), self._follow)
        state = ResidualState(waiting, state.seen + k, runs, level, drift, busy, heave[-1], errors, unrest)
        if self.motion.uses_thrust:
            known = known & np.isfinite(samples.heave[:, 1])
        return state, Residuals(samples.t_ns, r, n, trace, known)

    def _begin(self, state: ResidualState, u: FloatArray, y: FloatArray, heave: FloatArray) -> ResidualState:
        """Start the models from the first measured rates at rest in them, and the means from the first values."""
        rates = [
            freerun.start(model, np.full(len(model.b), u[0, i]), np.full(len(model.a), y[0, i]))
            for i, model in enumerate(self._models[:2])
        ]
        runs = (*rates, freerun.start(self._models[2]))
        return replace(state, runs=runs, level=start_ema(heave[0]), heave=heave[0])

    def _simulate(
        self, state: ResidualState, u: FloatArray, y: FloatArray, lift: FloatArray
    ) -> tuple[tuple[FreeRunState, ...], FloatArray, FloatArray]:
        """Measured less simulated roll rate, pitch rate and a_z, and the simulated, (k, 3). lift: a_z and thrust."""
        runs, r, y_sim = [], np.empty((3, len(u))), np.empty((3, len(u)))
        pairs = ((u[:, 0], y[:, 0]), (u[:, 1], y[:, 1]), (lift[:, 1], lift[:, 0]))
        for i, (command, measured) in enumerate(pairs):
            run, simulated = freerun.step(self._models[i], state.runs[i], command)
            runs.append(run)
            r[i], y_sim[i] = measured - simulated, simulated
        return tuple(runs), r.T, y_sim.T

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
        before = np.concatenate((errors.means[None], means[:-1]))
        ff, fd, dd, fr, dr = (before[:, i : i + 3] for i in range(0, 15, 3))
        ff, dd = ff + self._prior, dd + self._prior
        determinant = ff * dd - fd * fd
        g, h = (dd * fr - fd * dr) / determinant, (ff * dr - fd * fr) / determinant
        return _Errors(simulated[-1], slow, sums, means[-1]), g * f + h * df


def _no_errors() -> _Errors:
    return _Errors(np.zeros(3), start_ema(np.zeros(6)), start_ema(np.zeros(15)), np.zeros(15))


def without_jolts(unrest: EmaState, n: FloatArray, alpha: float) -> tuple[EmaState, FloatArray]:
    """n, (k, 3), clipped at `JOLT` times its rms of the last seconds; at least at `JOLT`.

    The mean square is that of the samples that are not clipped whatever came before, and what each other one adds,
    which decays: so one sample after the other is looked at only where one is large.
    """
    large = np.abs(n) > JOLT
    if not np.count_nonzero(large):
        return ema(unrest, np.square(n), alpha)[0], n
    unrest, trace = ema(unrest, np.square(np.where(large, 0.0, n)), alpha)
    out, added, kept = n.copy(), np.zeros(n.shape[1]), 1.0 - alpha
    for column in range(n.shape[1]):
        more, last = 0.0, 0  # what the large ones have added, after the row before `last`
        for row in np.flatnonzero(large[:, column]).tolist():
            more *= kept ** (row - last)
            square, value = float(trace[row, column]) / kept + more, float(n[row, column])
            most = JOLT * math.sqrt(square) if square > 1.0 else JOLT
            clipped = min(max(value, -most), most)
            out[row, column], more, last = clipped, kept * more + alpha * clipped * clipped, row + 1
        added[column] = more * kept ** (len(n) - last)
    return raised(unrest, added, alpha), out


def _steps(x: FloatArray, before: FloatArray) -> FloatArray:
    """Differences of rows, (n, k) after (k,) -> (n, k)."""
    out = np.empty_like(x)
    out[0] = x[0] - before
    np.subtract(x[1:], x[:-1], out=out[1:])
    return out


def held(x: FloatArray, before: FloatArray) -> FloatArray:
    """x, (n, k), with the last known value where it is no number; before: (k,) the one before the first row.

    >>> held(np.array([[np.nan], [2.0], [np.nan]]), np.array([1.0])).T.tolist()
    [[1.0, 2.0, 2.0]]
    """
    if math.isfinite(float(np.add.reduce(x, axis=None))):
        return x
    both = np.concatenate((before[None], x))
    at = np.maximum.accumulate(np.where(np.isfinite(both), np.arange(len(both))[:, None], 0), axis=0)
    return np.take_along_axis(both, at, axis=0)[1:]


def _finite(x: FloatArray) -> FloatArray:
    """x with zeros for what is no number; such samples are marked invalid."""
    return x if math.isfinite(float(np.add.reduce(x, axis=None))) else np.where(np.isfinite(x), x, 0.0)
