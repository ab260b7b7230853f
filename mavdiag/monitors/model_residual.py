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
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavdiag.errors import InputError
from mavdiag.identify.model import ModelRecord
from mavdiag.jit import cached, jit, source_digest
from mavdiag.monitors.healthy import MEMORY_S
from mavdiag.monitors.run_length import at_rest, free_run
from mavdiag.rows.running import follow
from mavdiag.rows.windows import forgetting
from mavdiag.telemetry import BoolArray, FloatArray, Three

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


# Places in the parameters: forgetting of the drift, the command and the errors; SPEED_S in samples; period; samples to
# settle; whether the errors of gain and speed are taken out, and whether the thrust explains anything; k0, k1 and
# prior of each channel; and of each model how many inputs and outputs it looks back, and where its coefficients and its
# past stand.
DRIFT, MEMORY, FOLLOW, SPEED, PERIOD, SETTLE, FOLLOWS, BY_THRUST, K0, K1, PRIOR, MODELS = *range(9), 11, 14, 17
HEAD = MODELS + 12
# Places in the memory: samples so far; what is known of the present one, the residuals r and n of it; running means of
# the heave and the thrust, of r, of the squared command; the last heave and thrust; the last simulated values, running
# means of these and their slopes, of their 5 products (each of three channels), of n squared.
SEEN, KNOWN, R, N, LEVEL, SLOW, BUSY, HEAVE, SIMULATED, TREND, PRODUCTS, UNREST = (
    0,
    1,
    2,
    5,
    8,
    10,
    13,
    16,
    18,
    21,
    27,
    42,
)
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


def _compiled(digest: int) -> Callable[[FloatArray, FloatArray, FloatArray, FloatArray], None]:
    @cached
    def residuals(par: FloatArray, mem: FloatArray, samples: FloatArray, out: FloatArray) -> None:
        """Of samples (k, 7) the residuals r and n, mean squares of the command, and whether all is known: (k, 10)."""
        for k in range(len(samples) if digest else 0):
            rates = (samples[k, 0], samples[k, 1], samples[k, 2], samples[k, 3])
            advance_residual(par, mem, rates, samples[k, 4], samples[k, 5], samples[k, 6] > 0.5)
            for i in range(3):
                out[k, i], out[k, 3 + i], out[k, 6 + i] = mem[R + i], mem[N + i], mem[BUSY + i]
            out[k, 9] = mem[KNOWN]

    return residuals


_residuals = _compiled(source_digest())


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
    """The residuals of a whole segment. samples: (k, 7) as `monitors.decimated` has them."""
    head, tail, size = residual_parameters(motion, follows, HEAD)
    out = np.empty((len(samples), 10))
    _residuals(np.array([*head, *tail]), residual_memory(size), samples, out)
    return Residuals(out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9] > 0.5)
