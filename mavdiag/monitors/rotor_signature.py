"""The rotor-signature monitor: an unsteady rotor tips and lifts the airframe along its own arm, and along no other.

A cracked blade hardly shakes, but its thrust wanders. What the healthy model does not explain of roll and pitch rate
then grows along one diagonal, in step with the vertical acceleration:

    r_roll, r_pitch = y - y_sim                  free run of a closed-loop ARX model on the commanded rate (T 5.5)
    r_heave         = a_z - a_sim                the same on the commanded thrust
    r  <- r - EMA_0.5s(r)                        from the first known r on; slow wind and trim are no fault
    r  <- r - g f - h df/dt                      f: y_sim without its slow part; g, h: least squares of the last 10 s
    n   = r / sqrt(k0 + k1 EMA_0.35s(u^2))       u: what was commanded; a sharp manoeuvre may leave more (METHOD 4)
    n  <- clip(n, +-4 s)                         s^2 = max(1, EMA_10s(n^2)): a jolt counts little, unrest in full

g and h are errors of the loop's gain and speed, drawn to zero where little was commanded: battery, payload and new
propellers change them slowly and for every manoeuvre alike. The filtered rates hold nothing above some 8 Hz, so all of
this runs on every tenth row at 1 kHz. A step of commanded motion that began before the first row cannot be simulated:
the first 1.5 s of a segment are left out.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from mavdiag.airframe.layout import RotorLayout
from mavdiag.airframe.trim import ALONG_Z
from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import Method
from mavdiag.identify import fit as identify
from mavdiag.identify.arx import ModelRecord, without_rounding
from mavdiag.jit import cached, jit, summing
from mavdiag.monitors.base import Begin, Feature, Flights, LearnContext, Monitor, RotorEvidence, parted
from mavdiag.monitors.fitting import MEMORY_S, cut_to_share, need_commanded, of_each, smoothed, three, variance_law
from mavdiag.monitors.run_length import at_rest, free_run, taps_of
from mavdiag.monitors.spec import NotNegative, Period, Positive, Span, spec
from mavdiag.rows.block import COMMANDED, FORCE, LEVEL, OUTPUTS, SOUND, THRUST, TRACE, VALUE, Floats, Ints, U, Y
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, follow, mean_size, push
from mavdiag.rows.savgol import coefficients
from mavdiag.rows.windows import forgetting, spans
from mavdiag.telemetry import BoolArray, FloatArray, Signal

SAMPLE_S = 0.01  # between two samples, our choice: ten times what the 0.1 s window passes
DRIFT_S = 0.5  # our choice; 0.3 to 1 s find the same faults, and longer ones have circles in the residual
FOLLOW_S = 10.0  # memory of the gain error; 5 to 20 s judge alike (our choice)
GAIN_RMS = 0.3  # gain and speed errors that are expected before anything was seen (our choice)
SPEED_S = 0.05  # time that h is in units of (our choice)
CORRELATION_S = 0.1  # residuals this far apart are independent (METHOD section 4: 8 Hz pass)
JOLT = 4.0  # of the rms of the last 10 s: what is larger is a jolt, such as a payload that is taken up (our choice)
SETTLE_S = 1.5  # our choice: the slowest pole that T's models have without their integrator dies out in it
WINDOW_S = 10.0  # our choice: in wind a correlation over 3 s (METHOD section 4 has 4 s) scatters too much
LEAST_S = 3.0  # of unbroken flight before anything is judged; the level's window (our choice)
LIKENESS_WEIGHT = 2.0  # exponent of the correlations; 1 and 3 separate faults from wind less well (our choice)
ORDERS = ((3, 3, 1), (2, 2, 1))  # the rate loop has three poles that count; the second order is what T uses
HEAVE_ORDER = (2, 2, 1)
TRAIN_SAMPLES = 120_000  # more of it no longer changes the coefficients (our choice)
MIN_PIECE_S = 1.0  # shorter valid stretches train nothing (our choice)
LEAST_POWER = 1e-12  # of a normalised residual; keeps a channel without noise from a division by zero
# Means of n_r^2, n_p^2, n_r n_p, n_h^2, n_r n_h, n_p n_h in healthy flight, in place of rows that are not there yet.
HEALTHY = (1.0, 1.0, 0.0, 1.0, 0.0, 0.0)

# Places in the parameters: rows between samples; length of the smoothing and where its taps stand; samples of the two
# windows; where the rotors' patterns stand; forgetting of the drift, the command and the errors; SPEED_S in samples;
# period; samples to settle; whether errors of gain and speed are taken out, and whether the thrust explains anything;
# of each channel k0, k1, prior, and of its model where taps and past stand, and its order.
STRIDE, LENGTH, TAPS, SAMPLES, LEAST, PATTERNS = range(6)
DRIFT, MEMORY, FOLLOW, SPEED, PERIOD, SETTLE, FOLLOWS, BY_THRUST, CHANNELS = range(6, 15)
K0, K1, PRIOR, MODEL, OWN, ORDER, OF_PAR = range(7)
HEAD = CHANNELS + 3 * 6
# Of a rotor: what makes of products the mean square along its arm, and across it; of correlations its S.
ALONG, ACROSS, SIGNS, OF_ROTOR = 0, 3, 6, 9
# Places in the memory: rows until the next sample; samples so far, known ones in a row, in all; last heave and thrust,
# and their means; of each channel r, n, the means of r, of the squared command, of n squared, the last simulated value,
# means of it and of its slope, and of their 5 products; then the models' past, and the two windows.
WAIT, SEEN, RUN, TOLD, HEAVE, LEVELS, STATES = 0, 1, 2, 3, 4, 6, 8
R, N, SLOW, BUSY, UNREST, SIMULATED, TREND, PRODUCTS, OF_STATE = 0, 1, 2, 3, 4, 5, 6, 8, 13
PASTS = STATES + 3 * OF_STATE


@spec
class HealthyMotion:
    """How the healthy airframe answers. Raises InputError for an even window."""

    dt_s: Period
    stride: Annotated[int, Field(ge=1)]  # rows from one sample to the next
    window: int  # rows of the rate filters, odd
    roll: ModelRecord  # rate [rad/s] on commanded rate
    pitch: ModelRecord
    heave: ModelRecord  # vertical acceleration [m/s^2] on thrust 0..1, both less their slow mean
    k0: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)  # variance of the residuals at rest
    k1: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)  # per mean square of what was commanded

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


@spec
class RotorSignatureSpec:
    """How the healthy airframe moves, and where its rotors are. window_s: length of the means [s]."""

    kind: Literal["rotor_signature"] = "rotor_signature"
    layout: RotorLayout
    motion: HealthyMotion
    window_s: Span = WINDOW_S

    @property
    def samples(self) -> int:
        """Samples in the window."""
        return max(self.least, round(self.window_s / self.motion.period_s))

    @property
    def least(self) -> int:
        """Samples that must be there before anything is judged, and of the level's window."""
        return max(2, round(min(LEAST_S, self.window_s) / self.motion.period_s))


@summing
def _dot(taps: Floats, values: Floats) -> float:
    found = 0.0
    for k in range(len(taps)):
        found += taps[k] * values[k]
    return found


@jit
def _channel(par: Floats, mem: Floats, i: int, command: float, measured: float, moved: float, known: bool) -> None:
    """Take a channel's next sample. moved: what makes its residual larger."""
    own, state = par[CHANNELS + OF_PAR * i : HEAD], mem[STATES + OF_STATE * i : PASTS]
    drift, slow = par[DRIFT], par[FOLLOW]
    f = free_run(par, int(own[MODEL]), int(own[ORDER]), mem, int(own[OWN]), command)
    r = 0.0  # what is not known is not unexplained
    if known:
        r = measured - f
        state[SLOW] += max(drift, 1.0 / (mem[TOLD] + 1.0)) * (r - state[SLOW])  # at first the mean so far
        r -= state[SLOW]
    if par[FOLLOWS] > 0.5:  # what the errors of gain and speed, as known before this sample, explain of it
        df, prior = (f - state[SIMULATED]) * par[SPEED], own[PRIOR]
        state[SIMULATED] = f
        state[TREND] += drift * (f - state[TREND])
        state[TREND + 1] += drift * (df - state[TREND + 1])
        f, df = f - state[TREND], df - state[TREND + 1]
        # [ mean f f + prior   mean f df          ] [ g ]   [ mean f r  ]
        # [ mean f df          mean df df + prior ] [ h ] = [ mean df r ]
        ff, fd, dd = state[PRODUCTS], state[PRODUCTS + 1], state[PRODUCTS + 2]
        fr, dr = state[PRODUCTS + 3], state[PRODUCTS + 4]
        g, h = (dd + prior) * fr - fd * dr, (ff + prior) * dr - fd * fr
        explained = (g * f + h * df) / ((ff + prior) * (dd + prior) - fd * fd)
        state[PRODUCTS], state[PRODUCTS + 1] = ff + slow * (f * f - ff), fd + slow * (f * df - fd)
        state[PRODUCTS + 2] = dd + slow * (df * df - dd)
        state[PRODUCTS + 3], state[PRODUCTS + 4] = fr + slow * (f * r - fr), dr + slow * (df * r - dr)
        r -= explained
    state[BUSY] += par[MEMORY] * (moved * moved - state[BUSY])
    n = r / math.sqrt(own[K0] + own[K1] * state[BUSY])
    if abs(n) > JOLT:
        most = JOLT * math.sqrt(max(state[UNREST], 1.0))
        n = min(max(n, -most), most)
    state[UNREST] += slow * (n * n - state[UNREST])
    state[R], state[N] = r, n


@jit
def _sample(par: Floats, mem: Floats, x: Floats, i: int) -> bool:
    """The residuals at a row; whether all is known. What is no number counts as zero; heave and thrust as they were."""
    taps, begin = par[int(par[TAPS]) : int(par[TAPS]) + int(par[LENGTH])], i - int(par[LENGTH]) + 1
    u0, u1, y0, y1 = x[U, i], x[U + 1, i], x[Y, i], x[Y + 1, i]
    heave, thrust = _dot(taps, x[FORCE + 2, begin : i + 1]), _dot(taps, x[THRUST, begin : i + 1])
    known = x[COMMANDED, i] > 0.5 and math.isfinite(u0 + u1 + y0 + y1 + heave) and mem[SEEN] >= par[SETTLE]
    known_thrust = math.isfinite(thrust)
    u0, u1 = u0 if math.isfinite(u0) else 0.0, u1 if math.isfinite(u1) else 0.0
    y0, y1 = y0 if math.isfinite(y0) else 0.0, y1 if math.isfinite(y1) else 0.0
    heave, thrust = heave if math.isfinite(heave) else mem[HEAVE], thrust if known_thrust else mem[HEAVE + 1]
    if mem[SEEN] == 0.0:  # the means begin with the first values, the models at rest in the first rates
        mem[LEVELS] = mem[HEAVE] = heave
        mem[LEVELS + 1] = mem[HEAVE + 1] = thrust
        for j in range(2):
            of, u, y = CHANNELS + OF_PAR * j, u0 if j == 0 else u1, y0 if j == 0 else y1
            at_rest(par, int(par[of + MODEL]), int(par[of + ORDER]), mem, int(par[of + OWN]), u, y)
    lift, pushed = heave - follow(mem, LEVELS, heave, par[DRIFT]), thrust - follow(mem, LEVELS + 1, thrust, par[DRIFT])
    slope = (thrust - mem[HEAVE + 1]) / par[PERIOD]
    mem[HEAVE], mem[HEAVE + 1] = heave, thrust
    _channel(par, mem, 0, u0, y0, u0, known)
    _channel(par, mem, 1, u1, y1, u1, known)
    _channel(par, mem, 2, pushed, lift, slope, known)
    mem[SEEN], mem[TOLD] = mem[SEEN] + 1.0, mem[TOLD] + known
    return known and (known_thrust or par[BY_THRUST] < 0.5)


@jit
def _push(mem: Floats, known: bool, window: int, least: int, means: int, recent: int) -> None:
    """Put the sample into the windows; healthy values where it is not known."""
    states, to = mem[STATES:PASTS], mem[means + FRESH : means + FRESH + 6]
    level = mem[recent + FRESH : recent + FRESH + 3]
    mem[RUN] = mem[RUN] + 1.0 if known else 0.0
    if known:
        p, q, w = states[N], states[OF_STATE + N], states[2 * OF_STATE + N]
        to[0], to[1], to[2], to[3], to[4], to[5] = p * p, q * q, p * q, w * w, p * w, q * w
        p, q = states[R], states[OF_STATE + R]
        level[0], level[1], level[2] = p * p, q * q, p * q
    else:
        level[:] = 0.0
        for j in range(6):
            to[j] = HEALTHY[j]
    push(mem, means, window, 6, True)
    push(mem, recent, least, 3, True)


@jit
def _judge(par: Floats, mem: Floats, means: int, recent: int, out: Floats, rotors: Floats, k: int) -> None:
    """The statistic of the present window."""
    share, sums = 1.0 / par[SAMPLES], mem[means + FRESH + 6 : means + FRESH + 12]
    rr, pp, rp, patterns = share * sums[0], share * sums[1], share * sums[2], par[int(par[PATTERNS]) :]
    roll, pitch = math.sqrt(max(rr, LEAST_POWER)), math.sqrt(max(pp, LEAST_POWER))
    heave = math.sqrt(max(share * sums[3], LEAST_POWER))
    roll_pitch, roll_heave = rp / (roll * pitch), share * sums[4] / (roll * heave)
    pitch_heave, best, most, highest = share * sums[5] / (pitch * heave), 0, -1.0, -1.0
    for rotor in range(rotors.shape[1]):
        own = patterns[OF_ROTOR * rotor : OF_ROTOR * (rotor + 1)]
        likeness = own[SIGNS] * roll_pitch + own[SIGNS + 1] * roll_heave + own[SIGNS + 2] * pitch_heave
        along = own[ALONG] * rr + own[ALONG + 1] * pp + own[ALONG + 2] * rp
        across = own[ACROSS] * rr + own[ACROSS + 1] * pp + own[ACROSS + 2] * rp
        power = max(along, 0.0) / max(across, 1.0)
        rotors[k, rotor] = likeness
        if power > most or likeness > rotors[k, best]:  # else it cannot be higher
            strength = math.sqrt(power) * math.exp(LIKENESS_WEIGHT * likeness)
            if strength > highest:
                best, most, highest = rotor, power, strength
    own, sums = patterns[OF_ROTOR * best + ALONG :], mem[recent + FRESH + 3 : recent + FRESH + 6]
    square = (own[0] * sums[0] + own[1] * sums[1] + own[2] * sums[2]) / par[LEAST]
    out[VALUE, k], out[LEVEL, k] = highest, math.sqrt(max(square, 0.0))


@cached
def run(par: Floats, mem: Floats, x: Floats, first: int, known: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The statistic about every 10 ms, at the time of the newest row that it rests on."""
    window, least, stride, columns, k = int(par[SAMPLES]), int(par[LEAST]), int(par[STRIDE]), x.shape[1], 0
    recent = len(mem) - FRESH - 3 * (2 + least)  # `mean_size` of the two windows, which are the last of the memory
    means, i = recent - FRESH - 6 * (2 + window), known + int(mem[WAIT])
    while i < columns:
        whole = _sample(par, mem, x, i)
        _push(mem, whole, window, least, means, recent)
        if mem[SEEN] >= least:
            if rotors.shape[1] > 0:
                _judge(par, mem, means, recent, out, rotors, k)
            for j in range(3 if out.shape[0] > TRACE else 0):
                of = STATES + OF_STATE * j
                out[TRACE + j, k], out[TRACE + 3 + j, k] = mem[of + R], mem[of + N]
                out[TRACE + 6 + j, k], out[TRACE + 9, k] = mem[of + BUSY], 1.0 if whole else 0.0
            out[SOUND, k], at[k] = mem[RUN] >= least, i - first
            k += 1
        i += stride
    mem[WAIT] = i - columns
    return k


class RotorSignature(Monitor[RotorSignatureSpec]):
    """Statistic: how much one rotor's arm moves beyond the model, weighed by how much it looks like a rotor [x rms].

        A_j^2 = mean_10s (g_j . (n_roll, n_pitch))^2,    g_j: unit vector of rotor j's (roll, pitch) effect
        B_j^2 = the same across the arm, at right angles to g_j
        S_j   = weighted mean over the pairs of roll, pitch, heave of  sign_j cor_10s(n, n')
        statistic = max_j A_j / max(1, B_j) exp(2 S_j)

    A is about 0.7 to 1.5 in healthy flight, S below 0.3; a wandering rotor has S near 0.7. Gusts raise A and B
    together. It is METHOD section 4's E > .. and S > .. as one figure. Healthy values stand for the rows of a window
    that are missing or not valid. `level`: the arm's rms over 3 s before normalising [rad/s]; `rotors`: the S_j.

    Warm-up: half an SG window, 1.5 s to settle, then 3 s unbroken and valid. Latency: 50 ms and about 0.4 s for a
    thrust that wanders by 6 %, 1 s for 3 %. False alarms: jolts beside the centre; sharp stops with an unlearnt load, a
    seventh of the weight, at half an arm or farther. Blind spots: a rotor that is weak but steady, balanced damage,
    vibration; in wind of 5 m/s a crack of half the fitted strength is near the threshold.
    """

    name = "rotor_signature"
    label = "signature"
    observes = "unexplained motion along the arm of one rotor"
    phrase = "thrust unsteady {times}x"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, Signal.SPECIFIC_FORCE, Signal.THRUST_SETPOINT})
    depends = frozenset(Condition) - {Condition.TILT, Condition.YAW_ACCELERATION}
    # A jolt that is no fault (a payload taken up beside the centre) reaches 3.6 in emulated flights, a circle after
    # hovers 3.5, which few healthy flights show (our choice).
    least = 4.0
    evidence = RotorEvidence(8.0)  # a difference of 0.3 between mean correlations named the right rotor in 99 of 100
    least_hz = 50.0  # METHOD section 4: below it the residual degrades
    why_hz = "{:.0f} Hz are needed, better 100"
    needs_layout = True
    tick_s = SAMPLE_S
    spec_type = RotorSignatureSpec
    unit = "x healthy rms"
    feature = Feature.MOTION
    takes = MappingProxyType({Signal.SPECIFIC_FORCE: ALONG_Z})
    run = staticmethod(run)

    def __init__(self, spec: RotorSignatureSpec) -> None:
        super().__init__(spec)
        self.memory_s = spec.window_s + DRIFT_S
        if not spec.motion.uses_thrust:  # the healthy flights did not show its effect
            self.signals = self.needs - {Signal.THRUST_SETPOINT}

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[RotorSignatureSpec, ...]:
        """Identify the healthy motion."""
        layout, stride, dt_s = context.layout, cls.tick(context.dt_s), context.dt_s
        need_commanded(flights)
        if not any(of_each(flights, "felt z", lambda flight: any(map(_felt, flight)))):
            raise InputError("no accelerometer, which separates a rotor from its opposite")
        gathered = of_each(flights, cls.name, lambda flight: samples_of(flight, stride, context.window))
        samples = [segment for flight in gathered for segment in flight]
        pieces, period_s = _pieces(samples, stride * dt_s), stride * dt_s
        if not pieces:
            raise IdentificationError(f"no unbroken {MIN_PIECE_S:g} s of flight to identify from; fly longer")
        roll, pitch = (_rate(pieces, axis, period_s, context) for axis in (0, 1))
        heave = _heave(pieces, period_s, context)
        motion = HealthyMotion(dt_s=dt_s, stride=stride, window=context.window, roll=roll, pitch=pitch, heave=heave)
        return (RotorSignatureSpec(layout=layout, motion=_with_variances(motion, samples)),)

    def begin(self, dt_s: float) -> Begin:
        """No row yet; the window holds what healthy samples have on average."""
        spec, motion = self.spec, self.spec.motion
        taps: FloatArray = coefficients(motion.window, min(2, motion.window - 1))[0]
        return _begin(motion, True, motion.stride, taps, (spec.samples, spec.least), _patterns(spec.layout).ravel())


def _begin(
    motion: HealthyMotion, follows: bool, stride: int, taps: FloatArray, windows: tuple[int, int], patterns: FloatArray
) -> Begin:
    """See `HEAD`. windows: samples of the two windows. follows: the errors of gain and speed are taken out."""
    period_s, (window, least), channels, past, tail = motion.period_s, windows, list[float](), PASTS, list[float]()
    for record, k0, k1 in zip((motion.roll, motion.pitch, motion.heave), motion.k0, motion.k1, strict=True):
        prior, own = k0 * (CORRELATION_S / (FOLLOW_S * GAIN_RMS**2)), taps_of(record)
        channels += [k0, k1, prior, HEAD + len(tail), past, len(own) // 2]
        past, tail = past + len(own) // 2, tail + own
    at = HEAD + len(tail)
    alphas = [forgetting(memory_s, period_s) for memory_s in (DRIFT_S, MEMORY_S, FOLLOW_S)]
    times = [*alphas, SPEED_S / period_s, period_s, SETTLE_S / period_s, float(follows), float(motion.uses_thrust)]
    par = [stride, len(taps), at, window, least, at + len(taps), *times, *channels, *tail, *taps, *patterns]
    mean = np.zeros(mean_size(window, 6))
    mean[FRESH + 6 : FRESH + 12], mean[FRESH + 12 :] = window * np.array(HEALTHY), np.repeat(HEALTHY, window)
    before = np.zeros(past)
    before[STATES + UNREST : PASTS : OF_STATE] = 1.0
    return Begin(np.array(par), np.concatenate((before, mean, np.zeros(mean_size(least, 3)))), len(taps) - 1)


def samples_of(flight: Sequence[Rows], stride: int, window: int) -> list[FloatArray]:
    """The samples of each segment of a flight, (k, 7): roll and pitch rate commanded, the same measured, acceleration
    down, thrust, 1 where all but the thrust is known. window: rows of the smoothing, odd."""
    taps, found, felt, wait = coefficients(window, min(2, window - 1))[0], list[list[FloatArray]](), np.empty((2, 0)), 0
    for begins, rows in parted(flight):
        if begins:
            felt, wait = np.full((2, window - 1), np.nan), 0
            found.append([])
        felt = np.concatenate((felt, (rows.block.force[:, 2], rows.block.thrust)), axis=1)
        rates, n, size = rows.rates, len(rows.rates), felt.shape[1]
        windows = np.lib.stride_tricks.sliding_window_view(felt, window, axis=1)[:, -n or size :][:, wait::stride]
        u, y, told = rates.u[wait::stride, :2], rates.y[wait::stride, :2], rates.commanded[wait::stride]
        samples = np.column_stack((u, y, np.einsum("skw,w->ks", windows, taps)))
        known = told & np.isfinite(samples[:, :5]).all(axis=1)
        found[-1].append(np.column_stack((samples, known)))
        felt, wait = felt[:, size - window + 1 :], (wait - n) % stride
    return [np.concatenate(parts) for parts in found]


class Residuals(NamedTuple):
    """What the models do not explain of the samples of a segment."""

    r: FloatArray  # (k, 3) residuals of roll and pitch rate [rad/s] and heave [m/s^2]
    n: FloatArray  # (k, 3) the same, normalised
    busy: FloatArray  # (k, 3) exponential mean square of what was commanded
    valid: BoolArray  # (k,) all that it rests on was known


def residuals_of(motion: HealthyMotion, samples: FloatArray, follows: bool = True) -> Residuals:
    """The residuals of a whole segment, by the loop that judges. samples: (k, 7)."""
    begun, n = _begin(motion, follows, 1, np.ones(1), (1, 1), np.empty(0)), len(samples)
    x, out = np.empty((OUTPUTS, n)), np.empty((TRACE + 10, n))  # the loop reads no other rows than these
    x[U : U + 2], x[Y : Y + 2], x[FORCE + 2], x[THRUST], x[COMMANDED] = np.split(samples.T, (2, 4, 5, 6))
    RotorSignature.run(begun.par, begun.mem, x, 0, 0, out, np.empty((n, 0)), np.empty(n, dtype=np.int64))
    r, n_, busy = (out[TRACE + 3 * i : TRACE + 3 * i + 3].T for i in range(3))
    return Residuals(r, n_, busy, out[TRACE + 9] > 0.5)


def _with_variances(motion: HealthyMotion, samples: Sequence[FloatArray]) -> HealthyMotion:
    """The motion with the variances k0 and k1 of its residuals. Raises IdentificationError without a live sensor."""
    for follows in (False, True):  # how far the gain is followed depends on the variance at rest
        found = [residuals_of(motion, one, follows) for one in samples]
        squares = np.concatenate([np.square(np.compress(one.valid, one.r.T, axis=1)) for one in found], axis=1)
        busy = np.concatenate([np.compress(one.valid, one.busy.T, axis=1) for one in found], axis=1)
        if not squares.any(axis=1).all():
            raise IdentificationError("no settled flight with a live gyro and accelerometer; fly longer than 3 s")
        k = [variance_law(*channel) for channel in zip(squares, busy, strict=True)]
        motion = replace(motion, k0=three([k0 for k0, _ in k]), k1=three([k1 for _, k1 in k]))
    return motion


def _felt(rows: Rows) -> bool:
    return bool(rows.rates.commanded.any() and (rows.block.valid & np.isfinite(rows.block.force[:, 2])).any())


def _patterns(layout: RotorLayout) -> FloatArray:
    """See `OF_ROTOR`. A rise of a rotor's thrust moves roll and pitch along its arm, and a_z by -1 (FRD)."""
    arms = layout.mixing[:, :2] / np.linalg.norm(layout.mixing[:, :2], axis=1, keepdims=True)
    squares = [(a * a, b * b, 2 * a * b) for a, b in (arms.T, (-arms[:, 1], arms[:, 0]))]
    a, b = (arms / np.abs(arms).max(axis=0)).T  # equal weights on an X; on a plus the idle axis drops out
    signs = np.stack((a * b, -a, -b))
    return np.vstack((*squares, signs / np.abs(signs).sum(axis=0))).T


def _pieces(samples: Sequence[FloatArray], period_s: float) -> list[FloatArray]:
    """Samples of unbroken valid stretches, a like share of every flight."""
    least, found = math.ceil(MIN_PIECE_S / period_s), list[FloatArray]()
    for segment in samples:
        found += [segment[first:stop] for first, stop in spans(segment[:, 6] > 0.5) if stop - first >= least]
    taken = cut_to_share([len(piece) for piece in found], TRAIN_SAMPLES, least)
    return [piece[:most] for piece, most in zip(found, taken, strict=True)]


def _rate(pieces: Sequence[FloatArray], axis: int, period_s: float, context: LearnContext) -> ModelRecord:
    """The rate model of one axis: of order 3 if the flights carry it, else of order 2."""
    near = next(((one.motion.roll, one.motion.pitch)[axis].model() for one in context.near), None)
    y = [piece[:, 2 + axis] for piece in pieces]
    u = without_rounding([piece[:, axis] for piece in pieces], y)
    reason = ""
    for order in ORDERS:
        try:
            return ModelRecord.of(identify(u, y, order, dt=period_s, figures=context.figures, near=near))
        except IdentificationError as error:
            reason = str(error)
    raise IdentificationError(f"{('roll', 'pitch')[axis]}: {reason}")


def _heave(pieces: Sequence[FloatArray], period_s: float, context: LearnContext) -> ModelRecord:
    """Vertical acceleration on thrust, both less their slow mean; nothing where thrust is unknown or not moved."""
    alpha = forgetting(DRIFT_S, period_s)
    heaves = [piece[:, 4:6] for piece in pieces if np.isfinite(piece[:, 4:6]).all()]
    moved = [heave - smoothed(heave, alpha, heave[0]) for heave in heaves]
    y, u = ([one[:, column] for one in moved] for column in (0, 1))
    try:
        return ModelRecord.of(identify(u, y, HEAVE_ORDER, dt=period_s, method=Method.LS, figures=context.figures))
    except IdentificationError:
        return ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=period_s, order=(1, 1, 0), method=Method.LS)
