"""The rotor-signature monitor: an unsteady rotor tips and lifts the airframe along its own arm, and along no other.

A cracked blade hardly shakes, but its thrust wanders. What the healthy model does not explain of roll and pitch rate
then grows along one diagonal, in step with the vertical acceleration.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import Method
from mavdiag.identify import fit as identify
from mavdiag.identify.model import ModelRecord
from mavdiag.jit import cached, jit
from mavdiag.monitors.base import Feature, Flights, LearnContext, Monitor, RotorEvidence
from mavdiag.monitors.columns import LEVEL, SIGNAL, SOUND, VALUE, Floats, Ints
from mavdiag.monitors.fitting import commanded, cut_to_share, of_each, smoothed
from mavdiag.monitors.model_residual import (
    DRIFT_S,
    HEAD,
    KNOWN,
    NEWEST,
    SAMPLE_S,
    HealthyMotion,
    N,
    R,
    advance_residual,
    decimate,
    decimator_memory,
    residual_memory,
    residual_parameters,
    samples_of,
    taps_of,
    with_variances,
)
from mavdiag.monitors.spec import Positive, spec
from mavdiag.rows.block import ALL
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.running import FRESH, mean_size, push, total
from mavdiag.rows.windows import forgetting, spans
from mavdiag.telemetry import FloatArray, Signal
from mavdiag.thresholds.rule import Prior

WINDOW_S = 10.0  # our choice: in wind a correlation over 3 s (METHOD section 4 has 4 s) scatters too much
LEAST_S = 3.0  # of unbroken flight before anything is judged; the level's window (our choice)
LIKENESS_WEIGHT = 2.0  # exponent of the correlations; 1 and 3 separate faults from wind less well (our choice)
# Means of the products in healthy flight (see `_products`), in place of rows that are not there yet.
HEALTHY_PRODUCTS = (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ORDERS = ((3, 3, 1), (2, 2, 1))  # the rate loop has three poles that count; the second order is what T uses
HEAVE_ORDER = (2, 2, 1)
TRAIN_SAMPLES = 120_000  # more of it no longer changes the coefficients (our choice)
MIN_PIECE_S = 1.0  # shorter valid stretches train nothing (our choice)
MIN_RATE_HZ = 50.0  # METHOD section 4: below it the residual degrades
LEAST_POWER = 1e-12  # of a normalised residual; keeps a channel without noise from a division by zero


@spec
class RotorSignatureSpec:
    """How the healthy airframe moves, and where its rotors are.

    layout: where the rotors are.
    motion: its models, and how large their residuals are.
    window_s: length of the means [s].
    """

    kind: Literal["rotor_signature"] = "rotor_signature"
    layout: RotorLayout
    motion: HealthyMotion
    window_s: Positive = WINDOW_S

    @property
    def samples(self) -> int:
        """Samples in the window."""
        return max(self.least, round(self.window_s / self.motion.period_s))

    @property
    def least(self) -> int:
        """Samples that must be there before anything is judged, and of the level's window."""
        return max(2, round(min(LEAST_S, self.window_s) / self.motion.period_s))


# Places in the parameters, behind those of the residuals: of the decimator; samples of the window and of the level's;
# how many rotors; where the memory of the decimator and of this monitor begin; where the rotors' patterns stand.
DECIMATOR = HEAD
SAMPLES, LEAST, ROTORS, SAMPLED, MINE, PATTERNS = range(DECIMATOR + 3, DECIMATOR + 9)
TAIL = DECIMATOR + 9
# Of a rotor: the arm; what makes of products the mean square along the arm, and across it; of correlations the S_j.
ARM, ALONG, ACROSS, SIGNS, OF_ROTOR = 0, 2, 5, 8, 11
PRODUCTS = len(HEALTHY_PRODUCTS)
COUNT, RUN, MEAN = 0, 1, 2  # places in this monitor's memory: samples so far, valid ones in a row; its two means


@jit
def _products(mem: FloatArray, to: int) -> None:
    """n_r^2, n_p^2, n_r n_p, n_h^2, n_r n_h, n_p n_h, then r_r^2, r_p^2, r_r r_p before normalising."""
    roll, pitch, heave = mem[N], mem[N + 1], mem[N + 2]
    mem[to], mem[to + 1], mem[to + 2] = roll * roll, pitch * pitch, roll * pitch
    mem[to + 3], mem[to + 4], mem[to + 5] = heave * heave, roll * heave, pitch * heave
    roll, pitch = mem[R], mem[R + 1]
    mem[to + 6], mem[to + 7], mem[to + 8] = roll * roll, pitch * pitch, roll * pitch


@jit
def _along(par: FloatArray, of: int, mem: FloatArray, at: int, columns: int, first: int, rows: int) -> float:
    """Mean square along an arm, of the means of roll^2, pitch^2 and roll pitch."""
    found = 0.0
    for j in range(3):
        found += par[of + j] * total(mem, at, columns, first + j) / rows
    return found


@jit
def _judge(par: FloatArray, mem: FloatArray, out: FloatArray, rotors: FloatArray, k: int) -> None:
    """The statistic of the present window."""
    window, least, at = int(par[SAMPLES]), int(par[LEAST]), int(par[MINE]) + MEAN
    recent = at + FRESH + 2 * PRODUCTS + window * PRODUCTS
    roll = math.sqrt(max(total(mem, at, PRODUCTS, 0) / window, LEAST_POWER))
    pitch = math.sqrt(max(total(mem, at, PRODUCTS, 1) / window, LEAST_POWER))
    heave = math.sqrt(max(total(mem, at, PRODUCTS, 3) / window, LEAST_POWER))
    roll_pitch = total(mem, at, PRODUCTS, 2) / window / (roll * pitch)
    roll_heave = total(mem, at, PRODUCTS, 4) / window / (roll * heave)
    pitch_heave = total(mem, at, PRODUCTS, 5) / window / (pitch * heave)
    best, highest = 0, -1.0
    for rotor in range(rotors.shape[1]):
        of = int(par[PATTERNS]) + OF_ROTOR * rotor
        likeness = par[of + SIGNS] * roll_pitch + par[of + SIGNS + 1] * roll_heave + par[of + SIGNS + 2] * pitch_heave
        across = max(_along(par, of + ACROSS, mem, at, PRODUCTS, 0, window), 1.0)
        along = max(_along(par, of + ALONG, mem, at, PRODUCTS, 0, window), 0.0)
        strength = math.sqrt(along / across) * math.exp(LIKENESS_WEIGHT * likeness)
        rotors[k, rotor] = likeness
        if strength > highest:
            best, highest = rotor, strength
    of = int(par[PATTERNS]) + OF_ROTOR * best
    out[VALUE, k] = highest
    out[LEVEL, k] = math.sqrt(max(_along(par, of + ALONG, mem, recent, 3, 0, least), 0.0))
    out[SIGNAL, k] = mem[N] * par[of + ARM] + mem[N + 1] * par[of + ARM + 1]


@cached
def run(par: Floats, mem: Floats, x: Floats, flags: Floats, lag: int, out: Floats, rotors: Floats, at: Ints) -> int:
    """The statistic about every 10 ms, at the time of the newest row that it rests on."""
    sampled, mine, window, least = int(par[SAMPLED]), int(par[MINE]), int(par[SAMPLES]), int(par[LEAST])
    recent, k = mine + MEAN + FRESH + 2 * PRODUCTS + window * PRODUCTS, 0
    for i in range(x.shape[1]):
        if not decimate(par, DECIMATOR, mem, sampled, x, flags, lag, i):
            continue
        of, row = sampled + NEWEST, mine + MEAN + FRESH
        rates = (mem[of], mem[of + 1], mem[of + 2], mem[of + 3])
        advance_residual(par, mem, rates, mem[of + 4], mem[of + 5], mem[of + 6] > 0.5)
        if mem[KNOWN] > 0.5:
            _products(mem, row)
            mem[mine + RUN] += 1.0
        else:
            for j in range(PRODUCTS):
                mem[row + j] = HEALTHY_PRODUCTS[j]
            mem[mine + RUN] = 0.0
        for j in range(3):
            mem[recent + FRESH + j] = mem[row + 6 + j]
        push(mem, mine + MEAN, window, PRODUCTS, True)
        push(mem, recent, least, 3, True)
        mem[mine + COUNT] += 1.0
        if mem[mine + COUNT] >= least:
            _judge(par, mem, out, rotors, k)
            out[SOUND, k], at[k] = mem[mine + RUN] >= least, i
            k += 1
    return k


class RotorSignature(Monitor[RotorSignatureSpec]):
    """Statistic: how much one rotor's arm moves beyond the model, weighed by how much it looks like a rotor [x rms].

        A_j^2 = mean_10s (g_j . (n_roll, n_pitch))^2,    g_j: unit vector of rotor j's (roll, pitch) effect
        B_j^2 = the same across the arm, at right angles to g_j
        S_j   = weighted mean over the pairs of roll, pitch, heave of  sign_j cor_10s(n, n')
        statistic = max_j A_j / max(1, B_j) exp(2 S_j)

    n: residuals of roll rate, pitch rate and vertical acceleration, high-passed at 1 s, freed of gain errors and
    normalised by what was commanded (see `model_residual`). A is about 0.7 to 1.5 in healthy flight, S below 0.3; a
    wandering rotor has S near 0.7. Gusts and turbulence push along and across every arm alike, so they raise A and B
    together: the statistic measures how much one arm stands out of them, and a fault must be larger to be seen in
    wind. It is METHOD section 4's E > .. and S > .. as one figure, so that one threshold can be set on it; on the
    linear scale, because in the logarithm the calm flights widen the healthy law more than the busy ones raise it.
    Healthy values stand for the rows of a window that are missing or not valid. `level` is the
    arm's rms over 3 s before normalising [rad/s], which grades the damage; `signal` the arm's n; `rotors` are the S_j.

    Warm-up: half an SG window, 1.5 s to settle, then 3 s unbroken and valid. Latency: 50 ms and the time until the
    rms is there: about 0.4 s for a thrust that wanders by 6 %, 1 s for 3 %. False alarms: see `thresholds`.
    Blind spots: a rotor that is weak but steady (the trim shows it), balanced damage, vibration; in wind of 5 m/s a
    crack of half the fitted strength is near the threshold.

    >>> from mavdiag.testing import example_context, example_rows
    >>> rng = np.random.default_rng(8)
    >>> command = np.cumsum(rng.normal(0, 0.01, (3000, 3)), axis=0)
    >>> def fly(fault):
    ...     push = fault * np.convolve(rng.normal(0, 1, 3019), np.ones(20) / 20, "valid")[:, None]
    ...     rate = rng.normal(0, 0.05, (3000, 3)) + np.gradient(command, 0.01, axis=0)
    ...     force = rng.normal(0, 0.1, (3000, 3)) + push * [0, 0, -2]
    ...     return example_rows(3000, setpoint=command, rate=rate + push * [-1, 1, 0], force=force)   # rotor 2
    >>> monitor = RotorSignature(*RotorSignature.fit([[fly(0.0)]], example_context("qdrone2")))
    >>> calm, faulty = (monitor.step(monitor.start(), fly(fault))[1] for fault in (0.0, 1.0))
    >>> [float(one.value[one.valid].max().round(1)) for one in (calm, faulty)], int(faulty.rotors[-1].argmax()) + 1
    ([1.9, 8.2], 2)
    """

    name = "rotor_signature"
    label = "signature"
    phrase = "thrust unsteady {times}x"
    needs = frozenset({Signal.BODY_RATE, Signal.ATTITUDE_SETPOINT, Signal.SPECIFIC_FORCE, Signal.THRUST_SETPOINT})
    depends = frozenset(
        {Condition.YAW_RATE, Condition.HEIGHT, Condition.COMMANDED_RATE, Condition.COMMANDED_ACCELERATION}
    )
    # A jolt that is no fault (a payload taken up beside the centre) reaches 3.1 in emulated flights, which few healthy
    # flights show (our choice).
    prior = Prior(session=0.15, least=3.5)
    evidence = RotorEvidence(8.0)  # a difference of 0.3 between mean correlations named the right rotor in 99 of 100
    needs_layout = True
    spec_type = RotorSignatureSpec
    unit = "x healthy rms"
    feature = Feature.MOTION

    @classmethod
    def fit(cls, flights: Flights, context: LearnContext) -> tuple[RotorSignatureSpec, ...]:
        """Identify the healthy motion."""
        layout, stride = context.layout, max(1, round(SAMPLE_S / context.dt_s))
        if not any(of_each(flights, "commanded", commanded)):
            raise InputError("no flight with a gyro and an attitude set-point")
        rate_hz = 1 / context.dt_s
        if rate_hz < 0.98 * MIN_RATE_HZ:
            raise InputError(f"the gyro comes at {rate_hz:.3g} Hz; {MIN_RATE_HZ:.0f} Hz are needed, better 100")
        if not any(of_each(flights, "felt z", _felt)):
            raise InputError("no accelerometer, which separates a rotor from its opposite")
        gathered = of_each(flights, cls.name, lambda flight: samples_of(flight, stride, context.window))
        samples = [segment for flight in gathered for segment in flight]
        pieces, period_s = _pieces(samples, stride * context.dt_s), stride * context.dt_s
        if not pieces:
            raise IdentificationError(f"no unbroken {MIN_PIECE_S:g} s of flight to identify from; fly longer")
        roll, pitch = (_rate(pieces, axis, period_s, context) for axis in (0, 1))
        heave = _heave(pieces, period_s)
        motion = HealthyMotion(
            dt_s=context.dt_s, stride=stride, window=context.window, roll=roll, pitch=pitch, heave=heave
        )
        return (RotorSignatureSpec(layout=layout, motion=with_variances(motion, samples)),)

    @property
    def signals(self) -> frozenset[Signal]:
        """The thrust counts only where the healthy flights showed its effect."""
        return self.needs if self.spec.motion.uses_thrust else self.needs - {Signal.THRUST_SETPOINT}

    def columns(self, signal: Signal) -> slice:
        """Of the accelerometer its z."""
        return slice(2, 3) if signal is Signal.SPECIFIC_FORCE else ALL

    @property
    def memory_s(self) -> float:
        """Its window, and what the high-pass keeps [s]."""
        return self.spec.window_s + DRIFT_S

    def period_s(self, dt_s: float) -> float:
        """Time between two samples [s]."""
        return self.spec.motion.period_s

    def parameters(self, dt_s: float) -> FloatArray:
        """See `PATTERNS`."""
        spec, motion, effects = self.spec, self.spec.motion, _effects(self.spec.layout)
        across = np.column_stack((-effects[:, 1], effects[:, 0]))
        patterns = np.column_stack((effects[:, :2], _square(effects).T, _square(across).T, _signs(effects).T)).ravel()
        head, tail, size = residual_parameters(motion, True, TAIL)
        taps, begin = taps_of(motion.window), TAIL + len(tail)
        sampler = [motion.stride, motion.window, begin]
        mine = size + len(decimator_memory(motion.window))
        own = [spec.samples, spec.least, self.rotors, size, mine, begin + len(taps)]
        return np.array([*head, *sampler, *own, *tail, *taps, *patterns])

    def memory(self, dt_s: float) -> FloatArray:
        """No row yet; the window holds what healthy samples have on average."""
        spec, window = self.spec, self.spec.samples
        mean = np.zeros(mean_size(window, PRODUCTS))
        mean[FRESH + PRODUCTS : FRESH + 2 * PRODUCTS] = window * np.array(HEALTHY_PRODUCTS)
        mean[FRESH + 2 * PRODUCTS :] = np.repeat(HEALTHY_PRODUCTS, window)
        before = residual_memory(residual_parameters(spec.motion, True, TAIL)[2])
        parts = (before, decimator_memory(spec.motion.window), np.zeros(MEAN), mean, np.zeros(mean_size(spec.least, 3)))
        return np.concatenate(parts)

    run = staticmethod(run)


def _felt(flight: Sequence[Rows]) -> bool:
    """Whether a flight that follows a set-point has an accelerometer along z."""
    flown = (rows.block for rows in flight if rows.rates.commanded.any())
    return any((block.valid & np.isfinite(block.force[:, 2])).any() for block in flown)


def _no_answer(dt_s: float) -> ModelRecord:
    """The model whose output is zero."""
    return ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=dt_s, order=(1, 1, 0), method=Method.LS)


def _effects(layout: RotorLayout) -> FloatArray:
    """What a rise of each rotor's thrust does, (rotors, 3): unit vector in roll and pitch, and -1 for a_z (FRD)."""
    arms = layout.mixing[:, :2] / np.linalg.norm(layout.mixing[:, :2], axis=1, keepdims=True)
    return np.column_stack((arms, -np.ones(layout.rotors)))


def _square(effects: FloatArray) -> FloatArray:
    """(3, rotors): turns means of roll^2, pitch^2 and roll pitch into the mean square along each arm."""
    a, b = effects[:, 0], effects[:, 1]
    return np.stack((a * a, b * b, 2 * a * b))


def _signs(effects: FloatArray) -> FloatArray:
    """(3, rotors): turns the correlations of roll-pitch, roll-heave and pitch-heave into S_j."""
    a, b, h = (effects / np.abs(effects).max(axis=0)).T  # equal weights on an X; on a plus the idle axis drops out
    weights = np.stack((a * b, a * h, b * h))
    return np.asarray(weights / np.abs(weights).sum(axis=0), dtype=np.float64)


def _pieces(samples: Sequence[FloatArray], period_s: float) -> list[FloatArray]:
    """Samples of unbroken valid stretches, a like share of every flight."""
    least = math.ceil(MIN_PIECE_S / period_s)
    found = [
        segment[first:stop]
        for segment in samples
        for first, stop in spans(segment[:, 6] > 0.5)
        if stop - first >= least
    ]
    taken = cut_to_share([len(piece) for piece in found], TRAIN_SAMPLES, least)
    return [piece[:most] for piece, most in zip(found, taken, strict=True)]


def _rate(pieces: Sequence[FloatArray], axis: int, period_s: float, context: LearnContext) -> ModelRecord:
    """The rate model of one axis: of order 3 if the flights carry it, else of order 2."""
    near = next(((one.motion.roll, one.motion.pitch)[axis].model() for one in context.near), None)
    u, y = [piece[:, axis] for piece in pieces], [piece[:, 2 + axis] for piece in pieces]
    reason = ""
    for order in ORDERS:
        try:
            return ModelRecord.of(identify(u, y, order, dt=period_s, figures=context.figures, near=near))
        except IdentificationError as error:
            reason = str(error)
    raise IdentificationError(f"{('roll', 'pitch')[axis]}: {reason}")


def _heave(pieces: Sequence[FloatArray], period_s: float) -> ModelRecord:
    """Vertical acceleration on thrust, both less their 1 s mean; nothing where thrust is unknown or not moved."""
    alpha = forgetting(DRIFT_S, period_s)
    heaves = [piece[:, 4:6] for piece in pieces if np.isfinite(piece[:, 4:6]).all()]
    moved = [heave - smoothed(heave, alpha, heave[0]) for heave in heaves]
    try:
        return ModelRecord.of(
            identify(
                [one[:, 1] for one in moved], [one[:, 0] for one in moved], HEAVE_ORDER, dt=period_s, method=Method.LS
            )
        )
    except IdentificationError:
        return _no_answer(period_s)
