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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify.model import ModelRecord
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import segments
from mavdiag.monitors.columns import COMMANDED, FORCE, THRUST, Floats, U, Y, columns_of
from mavdiag.monitors.fitting import MEMORY_S, three, variance_law
from mavdiag.monitors.run_length import at_rest, free_run
from mavdiag.monitors.spec import NotNegative, Positive, spec
from mavdiag.rows.front import Rows
from mavdiag.rows.running import dot, follow, past_size, shift
from mavdiag.rows.savgol import coefficients
from mavdiag.rows.windows import forgetting
from mavdiag.telemetry import BoolArray, FloatArray

SAMPLE_S = 0.01  # between two samples, our choice: ten times what the 0.1 s window passes
DRIFT_S = 1.0  # our choice; 0.5 to 2 s find the same faults
FOLLOW_S = 10.0  # memory of the gain error; 5 to 20 s judge alike (our choice)
GAIN_RMS = 0.3  # gain and speed errors that are expected before anything was seen (our choice)
SPEED_S = 0.05  # time that h is in units of (our choice)
CORRELATION_S = 0.1  # residuals this far apart are independent (METHOD section 4: 8 Hz pass)
JOLT = 4.0  # of the rms of the last 10 s: what is larger is a jolt, such as a payload that is taken up (our choice)
SETTLE_S = 1.5  # our choice: the slowest pole that T's models have without their integrator dies out in it


@spec
class HealthyMotion:
    """How the healthy airframe answers.

    dt_s: row period [s].
    stride: rows from one sample to the next.
    window: rows of the rate filters, odd.
    roll, pitch: rate [rad/s] on commanded rate.
    heave: vertical acceleration [m/s^2] on thrust 0..1, both less their 1 s mean.
    k0: variance of the residuals of roll, pitch and heave at rest.
    k1: variance per mean square of what was commanded.
    Raises InputError for an even window.
    """

    dt_s: Positive
    stride: Annotated[int, Field(ge=1)]
    window: int
    roll: ModelRecord
    pitch: ModelRecord
    heave: ModelRecord
    k0: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    k1: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.window % 2 == 0:
            raise InputError("rotor_signature: the filter window must be odd")

    @property
    def period_s(self) -> float:
        """Time between two samples [s]."""
        return self.dt_s * self.stride

    @property
    def uses_thrust(self) -> bool:
        """Whether the thrust explains part of the vertical acceleration."""
        return any(self.heave.b)


# Of the decimation. A sample: roll and pitch rate commanded, the same measured, acceleration down, thrust, 1 if it is
# valid. Places in the parameters: rows between samples, length of the window, where its taps stand. And in the memory:
# rates so far, the sample, the last accelerations and thrusts.
SAMPLE = 7
STRIDE, LENGTH, TAPS = range(3)
COUNT, NEWEST, PAST = 0, 1, 1 + SAMPLE


def taps_of(window: int) -> FloatArray:
    """Of the smoothing of acceleration and thrust, which is that of the rates."""
    taps: FloatArray = coefficients(window, min(2, window - 1))[0]
    return taps


def decimator_memory(window: int) -> FloatArray:
    """No row yet: what came before is unknown."""
    mem = np.full(PAST + 2 * past_size(window), np.nan)
    mem[COUNT] = mem[PAST] = mem[PAST + past_size(window)] = 0.0
    return mem


@jit
def decimate(par: Floats, of: int, mem: Floats, own: int, x: Floats, flags: Floats, lag: int, i: int) -> bool:
    """Take a row; True where it completes a sample, which stands at `NEWEST`. of, own: where the places above begin."""
    length, taps = int(par[of + LENGTH]), int(par[of + TAPS])
    past = own + PAST
    heave = shift(mem, past, length, x[FORCE + 2, i])
    thrust = shift(mem, past + 1 + 2 * length, length, x[THRUST, i])
    if i < lag:
        return False
    count = int(mem[own + COUNT])
    mem[own + COUNT] = count + 1.0
    if count % int(par[of + STRIDE]):
        return False
    sample = own + NEWEST
    mem[sample], mem[sample + 1], mem[sample + 2], mem[sample + 3] = x[U, i], x[U + 1, i], x[Y, i], x[Y + 1, i]
    mem[sample + 4] = dot(par, taps, mem, heave, length)
    mem[sample + 5] = dot(par, taps, mem, thrust, length)
    valid = flags[COMMANDED, i] > 0.5
    for column in range(5):
        valid = valid and math.isfinite(mem[sample + column])
    mem[sample + 6] = 1.0 if valid else 0.0
    return True


@cached
def _samples(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats) -> int:
    """The samples of some rows, to (n, SAMPLE)."""
    k = 0
    for i in range(x.shape[1]):
        if decimate(par, 0, mem, 0, x, flags, lag, i):
            out[k] = mem[NEWEST : NEWEST + SAMPLE]
            k += 1
    return k


def samples_of(flight: Sequence[Rows], stride: int, window: int) -> list[FloatArray]:
    """The samples of each segment of a flight, (k, 7). window: rows of the smoothing, odd."""
    par, found = np.array([stride, window, 3, *taps_of(window)]), []
    for segment in segments(flight):
        mem, parts = decimator_memory(window), []
        for columns in map(columns_of, segment):
            out = np.empty((columns.flags.shape[1], SAMPLE))
            parts.append(out[: _samples(par, mem, columns.x, columns.flags, columns.lag, out)].copy())
        found.append(np.concatenate(parts))
    return found


# Places in the parameters: forgetting of the drift, the command and the errors; SPEED_S in samples; period; samples to
# settle; whether the errors of gain and speed are taken out, and whether the thrust explains anything; k0, k1 and
# prior of each channel; and of each model how many inputs and outputs it looks back, and where its coefficients and its
# past stand.
DRIFT, MEMORY, FOLLOW, SPEED, PERIOD, SETTLE, FOLLOWS, BY_THRUST, K0, K1, PRIOR, MODELS = *range(9), 11, 14, 17
HEAD = MODELS + 12
# Places in the memory: samples so far; what is known of the present one, the residuals r and n of it; running means of
# the heave and the thrust, of r, of the squared command; the last heave and thrust; the last simulated values, running
# means of these and their slopes, of their 5 products (each of three channels), of n squared.
SEEN, KNOWN, R, N, LEVEL, SLOW, BUSY, HEAVE, SIMULATED, TREND = 0, 1, 2, 5, 8, 10, 13, 16, 18, 21
PRODUCTS, UNREST = 27, 42
OWN = 45  # the models' past follows


def residual_parameters(motion: HealthyMotion, follows: bool, tail_at: int) -> tuple[list[float], list[float], int]:
    """See `MODELS`: the head; the coefficients, which are to stand from `tail_at` on; and the length of the memory.

    follows: the errors of gain and speed are taken out.
    """
    period_s, own, models, tail = motion.period_s, OWN, list[float](), list[float]()
    for record in (motion.roll, motion.pitch, motion.heave):
        inputs, back = len(record.b), len(record.a) - 1
        models += [inputs, back, tail_at + len(tail), own]
        tail += [*record.b, *record.a[1:]]
        own += inputs - 1 + back
    alphas = [forgetting(memory_s, period_s) for memory_s in (DRIFT_S, MEMORY_S, FOLLOW_S)]
    prior = [k0 * (CORRELATION_S / (FOLLOW_S * GAIN_RMS**2)) for k0 in motion.k0]
    flags = [float(follows), float(motion.uses_thrust)]
    head = [*alphas, SPEED_S / period_s, period_s, SETTLE_S / period_s, *flags, *motion.k0, *motion.k1, *prior, *models]
    return head, tail, own


def residual_memory(size: int) -> FloatArray:
    """Before the first sample."""
    mem = np.zeros(size)
    mem[UNREST : UNREST + 3] = 1.0
    return mem


@jit
def advance_residual(
    par: FloatArray, mem: FloatArray, rates: tuple[float, float, float, float], heave: float, thrust: float, valid: bool
) -> None:
    """Take the next sample: roll and pitch rate commanded, the same measured, vertical acceleration and thrust.

    What is no number counts as zero or, of heave and thrust, as it was last.
    """
    known_thrust = math.isfinite(thrust)
    u0, u1, y0, y1 = rates
    u0, u1 = u0 if math.isfinite(u0) else 0.0, u1 if math.isfinite(u1) else 0.0
    y0, y1 = y0 if math.isfinite(y0) else 0.0, y1 if math.isfinite(y1) else 0.0
    heave = heave if math.isfinite(heave) else mem[HEAVE]
    thrust = thrust if known_thrust else mem[HEAVE + 1]
    if mem[SEEN] == 0.0:  # the means begin with the first values, the models at rest in the first rates
        mem[LEVEL] = mem[HEAVE] = heave
        mem[LEVEL + 1] = mem[HEAVE + 1] = thrust
        at_rest(mem, int(par[MODELS + 3]), int(par[MODELS]), int(par[MODELS + 1]), u0, y0)
        at_rest(mem, int(par[MODELS + 7]), int(par[MODELS + 4]), int(par[MODELS + 5]), u1, y1)
    lift = heave - follow(mem, LEVEL, heave, par[DRIFT])
    push_ = thrust - follow(mem, LEVEL + 1, thrust, par[DRIFT])
    slope = (thrust - mem[HEAVE + 1]) / par[PERIOD]
    mem[HEAVE], mem[HEAVE + 1] = heave, thrust
    known = valid and mem[SEEN] >= par[SETTLE]
    for i in range(3):
        command = u0 if i == 0 else u1 if i == 1 else push_
        measured = y0 if i == 0 else y1 if i == 1 else lift
        moved = slope if i == 2 else command
        of = MODELS + 4 * i
        f = free_run(par, int(par[of + 2]), int(par[of]), int(par[of + 1]), mem, int(par[of + 3]), command)
        r = measured - f if known else 0.0  # what is not known is not unexplained
        r -= follow(mem, SLOW + i, r, par[DRIFT])
        if par[FOLLOWS] > 0.5:
            r -= _explained(par, mem, i, f, r)
        busy = follow(mem, BUSY + i, moved * moved, par[MEMORY])
        n = r / math.sqrt(par[K0 + i] + par[K1 + i] * busy)
        if abs(n) > JOLT:
            most = JOLT * math.sqrt(max(mem[UNREST + i], 1.0))
            n = min(max(n, -most), most)
        follow(mem, UNREST + i, n * n, par[FOLLOW])
        mem[R + i], mem[N + i] = r, n
    mem[SEEN] += 1.0
    mem[KNOWN] = 1.0 if known and (known_thrust or par[BY_THRUST] < 0.5) else 0.0


@jit
def _explained(par: FloatArray, mem: FloatArray, i: int, simulated: float, r: float) -> float:
    """What the errors of gain and speed, as known before this sample, explain of it."""
    df = (simulated - mem[SIMULATED + i]) * par[SPEED]
    mem[SIMULATED + i] = simulated
    f = simulated - follow(mem, TREND + 2 * i, simulated, par[DRIFT])
    df -= follow(mem, TREND + 2 * i + 1, df, par[DRIFT])
    # [ mean f f + prior   mean f df          ] [ g ]   [ mean f r  ]
    # [ mean f df          mean df df + prior ] [ h ] = [ mean df r ]
    of = PRODUCTS + 5 * i
    ff, fd, dd = mem[of] + par[PRIOR + i], mem[of + 1], mem[of + 2] + par[PRIOR + i]
    fr, dr = mem[of + 3], mem[of + 4]
    determinant = ff * dd - fd * fd
    g, h = (dd * fr - fd * dr) / determinant, (ff * dr - fd * fr) / determinant
    follow(mem, of, f * f, par[FOLLOW])
    follow(mem, of + 1, f * df, par[FOLLOW])
    follow(mem, of + 2, df * df, par[FOLLOW])
    follow(mem, of + 3, f * r, par[FOLLOW])
    follow(mem, of + 4, df * r, par[FOLLOW])
    return float(g * f + h * df)


@cached
def _residuals(par: Floats, mem: Floats, samples: Floats, out: Floats) -> None:
    """Of samples (k, 7) the residuals r and n, mean squares of the command, and whether all is known: (k, 10)."""
    for k in range(len(samples)):
        rates = (samples[k, 0], samples[k, 1], samples[k, 2], samples[k, 3])
        advance_residual(par, mem, rates, samples[k, 4], samples[k, 5], samples[k, 6] > 0.5)
        for i in range(3):
            out[k, i], out[k, 3 + i], out[k, 6 + i] = mem[R + i], mem[N + i], mem[BUSY + i]
        out[k, 9] = mem[KNOWN]


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What the models do not explain of the samples of a segment.

    r: (k, 3) residuals of roll and pitch rate [rad/s] and heave [m/s^2].
    n: (k, 3) the same, normalised.
    busy: (k, 3) exponential mean square of what was commanded.
    valid: (k,) all that it rests on was known.
    """

    r: FloatArray
    n: FloatArray
    busy: FloatArray
    valid: BoolArray


def residuals_of(motion: HealthyMotion, samples: FloatArray, follows: bool = True) -> Residuals:
    """The residuals of a whole segment. samples: (k, 7)."""
    head, tail, size = residual_parameters(motion, follows, HEAD)
    out = np.empty((len(samples), 10))
    _residuals(np.array([*head, *tail]), residual_memory(size), samples, out)
    return Residuals(out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9] > 0.5)


def with_variances(motion: HealthyMotion, segments_: Sequence[FloatArray]) -> HealthyMotion:
    """The motion with the variances k0 and k1 of its residuals, from the samples of healthy segments.

    Raises IdentificationError without a live sensor.
    """
    for follows in (False, True):  # how far the gain is followed depends on the variance at rest
        found = [residuals_of(motion, samples, follows) for samples in segments_]
        squares = np.concatenate([np.empty((0, 3)), *(np.square(one.r[one.valid]) for one in found)])
        busy = np.concatenate([np.empty((0, 3)), *(one.busy[one.valid] for one in found)])
        if not squares.any(axis=0).all():
            raise IdentificationError("no settled flight with a live gyro and accelerometer; fly longer than 3 s")
        k = [variance_law(squares[:, axis], busy[:, axis]) for axis in range(3)]
        motion = replace(motion, k0=three([k0 for k0, _ in k]), k1=three([k1 for _, k1 in k]))
    return motion
