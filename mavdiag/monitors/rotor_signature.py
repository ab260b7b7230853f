"""The rotor-signature monitor: an unsteady rotor tips and lifts the airframe along its own arm, and along no other.

A cracked blade hardly shakes, but its thrust wanders. What the healthy model does not explain of roll and pitch rate
then grows along one diagonal, in step with the vertical acceleration.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout
from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import Method
from mavdiag.identify import fit as identify
from mavdiag.identify.model import ModelRecord
from mavdiag.monitors.base import Feature, LearnContext, Monitor, RotorEvidence, Summaries, Summary
from mavdiag.monitors.decimated import Decimated, stride_of
from mavdiag.monitors.healthy import cut_to_share, smoothed
from mavdiag.monitors.model_residual import DRIFT_S, HealthyMotion, ModelResidual, Residuals, ResidualState
from mavdiag.monitors.motion_fit import gathered, samples_of, with_variances
from mavdiag.rows.block import ALL, Block
from mavdiag.rows.conditions import Condition
from mavdiag.rows.front import Rows
from mavdiag.rows.statistic import Statistic
from mavdiag.rows.windows import forgetting, spans, window_all, window_mean
from mavdiag.telemetry import BoolArray, FloatArray, Signal
from mavdiag.thresholds.guard import Guard

__all__ = ["RotorSignature", "RotorSignatureSpec", "RotorSignatureState"]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class RotorSignatureSpec:
    """How the healthy airframe moves, and where its rotors are.

    layout: where the rotors are.
    motion: its models, and how large their residuals are.
    window_s: length of the means [s].
    Raises InputError if the window is not positive.
    """

    kind: Literal["rotor_signature"] = "rotor_signature"
    layout: RotorLayout
    motion: HealthyMotion
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        if not (math.isfinite(self.window_s) and self.window_s > 0):
            raise InputError(f"rotor_signature: the window must be positive, not {self.window_s} s")

    @property
    def samples(self) -> int:
        """Samples in the window."""
        return max(self.least, round(self.window_s / self.motion.period_s))

    @property
    def least(self) -> int:
        """Samples that must be there before anything is judged, and of the level's window."""
        return max(2, round(min(LEAST_S, self.window_s) / self.motion.period_s))


@dataclass(frozen=True, slots=True, eq=False)
class RotorSignatureState:
    """Memory of the residuals, and of the window's samples: (h, 9) products, (h,) whether they may be used."""

    inner: ResidualState
    products: FloatArray
    valid: BoolArray


class RotorSignature(Monitor[RotorSignatureSpec, RotorSignatureState]):
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
    guard = Guard(least=3.5)
    evidence = RotorEvidence(8.0)  # a difference of 0.3 between mean correlations named the right rotor in 99 of 100
    needs_layout = True
    spec_type = RotorSignatureSpec
    unit = "x healthy rms"
    feature = Feature.MOTION

    def __init__(self, spec: RotorSignatureSpec) -> None:
        super().__init__(spec)
        effects = _effects(spec.layout)
        self._arms, self._square, self._signs = effects[:, :2], _square(effects), _signs(effects)
        self._across = _square(np.column_stack((-effects[:, 1], effects[:, 0])))
        self._residual = ModelResidual(spec.motion)

    @classmethod
    def gather(cls, flight: Sequence[Rows], context: LearnContext) -> Summary:
        """Whether the flight has a set-point, and then an accelerometer; the decimated samples (`motion_fit`)."""
        flown = [rows.block for rows in flight if rows.rates.commanded.any()]
        felt = any((block.valid & np.isfinite(block.force[:, 2])).any() for block in flown)
        return (np.array([bool(flown), felt]), *gathered(flight, _unknown(context)))

    @classmethod
    def settle(cls, summaries: Summaries, context: LearnContext) -> tuple[RotorSignatureSpec, ...]:
        """Identify the healthy motion."""
        layout, motion = _layout(summaries, context), _unknown(context)
        flights = [one[1:] for one in summaries]
        pieces = _pieces(flights, motion)
        if not pieces:
            raise IdentificationError(f"no unbroken {MIN_PIECE_S:g} s of flight to identify from; fly longer")
        roll, pitch = (_rate(pieces, axis, motion, context) for axis in (0, 1))
        motion = replace(motion, roll=roll, pitch=pitch, heave=_heave(pieces, motion))
        return (RotorSignatureSpec(layout=layout, motion=with_variances(flights, motion)),)

    @property
    def signals(self) -> frozenset[Signal]:
        """The thrust counts only where the healthy flights showed its effect."""
        return self.needs if self.spec.motion.uses_thrust else self.needs - {Signal.THRUST_SETPOINT}

    def known(self, block: Block, signal: Signal) -> BoolArray:
        """Of the accelerometer its z."""
        return block.known(signal, slice(2, 3) if signal is Signal.SPECIFIC_FORCE else ALL)

    @property
    def memory_s(self) -> float:
        """Its window, and what the high-pass keeps [s]."""
        return self.spec.window_s + DRIFT_S

    def start(self) -> RotorSignatureState:
        """No row yet."""
        missing = self.spec.samples - self.spec.least  # so the first value comes after `least` samples
        healthy = np.tile(np.array(HEALTHY_PRODUCTS)[:, None], missing).T
        return RotorSignatureState(self._residual.start(), healthy, np.ones(missing, dtype=np.bool_))

    def step(self, state: RotorSignatureState, rows: Rows) -> tuple[RotorSignatureState, Statistic]:
        """The statistic about every 10 ms, at the time of the newest row that it rests on."""
        window = self.spec.samples
        inner, d = self._residual.step(state.inner, rows)
        fresh = _products(d)
        if np.count_nonzero(d.valid) < len(d.valid):
            fresh = np.where(d.valid[:, None], fresh, HEALTHY_PRODUCTS)
        products = np.concatenate((state.products, fresh))
        valid = np.concatenate((state.valid, d.valid))
        mean, full = window_mean(products, window), window_all(valid[window - self.spec.least :], self.spec.least)
        known = len(mean)
        likeness = _correlations(mean) @ self._signs
        across = np.maximum(mean[:, :3] @ self._across, 1.0)
        along = np.maximum(mean[:, :3] @ self._square, 0.0)
        strength = np.sqrt(along / across) * np.exp(LIKENESS_WEIGHT * likeness)
        best = strength.argmax(axis=1)
        at = np.arange(known)
        recent = window_mean(products[window - self.spec.least :, 6:], self.spec.least)
        level = np.sqrt(np.maximum(recent @ self._square, 0.0))[at, best]
        latest = len(d.t_ns) - known
        signal = np.einsum("nk,nk->n", d.n[latest:, :2], self._arms[best])
        period_s = self.spec.motion.period_s
        found = Statistic(d.t_ns[latest:], period_s, strength[at, best], full, level, signal, likeness)
        return RotorSignatureState(inner, products[known:], valid[known:]), found


def _unknown(context: LearnContext) -> HealthyMotion:
    """The motion before any flight: nothing answers."""
    stride = stride_of(context.dt_s)
    none = _no_answer(stride * context.dt_s)
    return HealthyMotion(dt_s=context.dt_s, stride=stride, window=context.window, roll=none, pitch=none, heave=none)


def _layout(summaries: Summaries, context: LearnContext) -> RotorLayout:
    """The rotor layout. Raises InputError if it is not known or the flights cannot be judged."""
    layout = context.layout
    if not any(one[0][0] for one in summaries):
        raise InputError("no flight with a gyro and an attitude set-point")
    rate_hz = 1 / context.dt_s
    if rate_hz < 0.98 * MIN_RATE_HZ:
        raise InputError(f"the gyro comes at {rate_hz:.3g} Hz; {MIN_RATE_HZ:.0f} Hz are needed, better 100")
    if not any(one[0][1] for one in summaries):
        raise InputError("no accelerometer, which separates a rotor from its opposite")
    return layout


def _no_answer(dt_s: float) -> ModelRecord:
    """The model whose output is zero."""
    return ModelRecord(a=(1.0, 0.0), b=(0.0,), dt_s=dt_s, order=(1, 1, 0), method=Method.LS)


def _effects(layout: RotorLayout) -> FloatArray:
    """What a rise of each rotor's thrust does, (rotors, 3): unit vector in roll and pitch, and -1 for a_z (FRD)."""
    arms = layout.mixing[:, :2] / np.linalg.norm(layout.mixing[:, :2], axis=1, keepdims=True)
    return np.column_stack((arms, -np.ones(layout.rotors)))


def _products(d: Residuals) -> FloatArray:
    """(k, 9): n_r^2, n_p^2, n_r n_p, n_h^2, n_r n_h, n_p n_h, then r_r^2, r_p^2, r_r r_p before normalising."""
    out = np.empty((9, len(d.t_ns)))
    roll, pitch, heave = d.n.T
    out[0], out[1], out[2] = roll * roll, pitch * pitch, roll * pitch
    out[3], out[4], out[5] = heave * heave, roll * heave, pitch * heave
    roll, pitch = d.r[:, 0], d.r[:, 1]
    out[6], out[7], out[8] = roll * roll, pitch * pitch, roll * pitch
    return out.T


def _square(effects: FloatArray) -> FloatArray:
    """(3, rotors): turns means of roll^2, pitch^2 and roll pitch into the mean square along each arm."""
    a, b = effects[:, 0], effects[:, 1]
    return np.stack((a * a, b * b, 2 * a * b))


def _signs(effects: FloatArray) -> FloatArray:
    """(3, rotors): turns the correlations of roll-pitch, roll-heave and pitch-heave into S_j."""
    a, b, h = (effects / np.abs(effects).max(axis=0)).T  # equal weights on an X; on a plus the idle axis drops out
    weights = np.stack((a * b, a * h, b * h))
    return np.asarray(weights / np.abs(weights).sum(axis=0), dtype=np.float64)


def _correlations(mean: FloatArray) -> FloatArray:
    """Roll-pitch, roll-heave and pitch-heave, (n, 3)."""
    roll, pitch, _, heave = np.sqrt(np.maximum(mean.T[:4], LEAST_POWER))
    return np.stack((mean[:, 2] / (roll * pitch), mean[:, 4] / (roll * heave), mean[:, 5] / (pitch * heave))).T


def _pieces(flights: Summaries, motion: HealthyMotion) -> list[Decimated]:
    """Unbroken valid stretches, a like share of every flight."""
    least = math.ceil(MIN_PIECE_S / motion.period_s)
    found = [
        (one, first, stop)
        for flight in flights
        for one in samples_of(flight)
        for first, stop in spans(one.valid)
        if stop - first >= least
    ]
    taken = cut_to_share([stop - first for _, first, stop in found], TRAIN_SAMPLES, least)
    return [_cut(one, slice(first, first + most)) for (one, first, _), most in zip(found, taken, strict=True)]


def _cut(one: Decimated, kept: slice) -> Decimated:
    return Decimated(one.t_ns, one.u[kept], one.y[kept], one.heave[kept], one.valid[kept])


def _rate(pieces: Sequence[Decimated], axis: int, motion: HealthyMotion, context: LearnContext) -> ModelRecord:
    """The rate model of one axis: of order 3 if the flights carry it, else of order 2."""
    near = next(((one.motion.roll, one.motion.pitch)[axis].model() for one in context.near), None)
    u, y = [one.u[:, axis] for one in pieces], [one.y[:, axis] for one in pieces]
    reason = ""
    for order in ORDERS:
        try:
            return ModelRecord.of(identify(u, y, order, dt=motion.period_s, figures=context.figures, near=near))
        except IdentificationError as error:
            reason = str(error)
    raise IdentificationError(f"{('roll', 'pitch')[axis]}: {reason}")


def _heave(pieces: Sequence[Decimated], motion: HealthyMotion) -> ModelRecord:
    """Vertical acceleration on thrust, both less their 1 s mean; nothing where thrust is unknown or not moved."""
    alpha = forgetting(DRIFT_S, motion.period_s)
    moved = [one.heave - smoothed(one.heave, alpha, one.heave[0]) for one in pieces if np.isfinite(one.heave).all()]
    u, y = [one[:, 1] for one in moved], [one[:, 0] for one in moved]
    try:
        return ModelRecord.of(identify(u, y, HEAVE_ORDER, dt=motion.period_s, method=Method.LS))
    except IdentificationError:
        return _no_answer(motion.period_s)
