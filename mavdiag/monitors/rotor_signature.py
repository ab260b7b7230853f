"""The energy monitor: an unsteady rotor tips and lifts the airframe along its own arm, and along no other.

A cracked blade hardly shakes, but its thrust wanders. What the healthy model does not explain of roll and pitch rate
then grows along one diagonal, in step with the vertical acceleration.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.decision.events import Reading
from mavdiag.errors import IdentificationError, InputError
from mavdiag.identify import fit as identify
from mavdiag.monitors.base import Rows
from mavdiag.monitors.model_residual import (
    DRIFT_S,
    Arx,
    Disturbance,
    DisturbanceState,
    HealthyMotion,
    Observer,
    Picked,
    Picker,
    stride_of,
)
from mavdiag.rows.running import ema, forgetting
from mavdiag.rows.savgol import window_samples
from mavdiag.rows.windows import window_all, window_mean
from mavdiag.telemetry import Axis, BoolArray, FloatArray
from mavdiag.thresholds.heldout import Flights
from mavdiag.thresholds.rule import Guard

__all__ = ["GUARD", "RotorSignature", "RotorSignatureSpec", "RotorSignatureState", "fit", "judgeable"]

WINDOW_S = 3.0  # our choice; METHOD section 4 has 4 s, and 2 s find the same faults
ORDERS = ((3, 3, 1), (2, 2, 1))  # the rate loop has three poles that count; the second order is what T uses
HEAVE_ORDER = (2, 2, 1)
TRAIN_SAMPLES = 120_000  # more of it no longer changes the coefficients (our choice)
MIN_PIECE_S = 1.0  # shorter valid stretches train nothing (our choice)
MIN_RATE_HZ = 50.0  # METHOD section 4: below it the residual degrades
MIN_SHARE = 0.05  # of the mean square, left to k0 however busy the set-point (our choice)
LEAST_POWER = 1e-12  # of a normalised residual; keeps a silent channel from dividing by zero
NO_ANSWER = Arx((1.0, 0.0), (0.0,))

# A few flights do not show how restless a healthy one can be: of five recorded ones the fifth read three times the
# others. So with few flights more is asked for, and nothing more from ten on; an estimate from that one airframe.
GUARD = Guard(few_flights=4.5, enough_flights=10)


@dataclass(frozen=True, slots=True, kw_only=True)
class RotorSignatureSpec:
    """How the healthy airframe moves, and where its rotors are: frame is a key of `layout.LAYOUTS`.

    Raises InputError if the window is not positive, UsageError for an unknown frame.
    """

    kind: Literal["energy"] = "energy"
    frame: str
    motion: HealthyMotion
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        layout_named(self.frame)
        if not (math.isfinite(self.window_s) and self.window_s > 0):
            raise InputError(f"energy: the window must be positive, not {self.window_s} s")

    @property
    def samples(self) -> int:
        """Samples in the window."""
        return max(2, round(self.window_s / self.motion.period_s))


@dataclass(frozen=True, slots=True, eq=False)
class RotorSignatureState:
    """Memory of the residuals, and the products of the window's samples, (h, 9), with their validity."""

    inner: DisturbanceState
    products: FloatArray
    valid: BoolArray


class RotorSignature:
    """Statistic: how much one rotor's arm moves beyond the model, weighed by how much it looks like a rotor [x rms].

        A_j^2 = mean_3s (g_j . (n_roll, n_pitch))^2,     g_j: unit vector of rotor j's (roll, pitch) effect
        S_j   = weighted mean over the pairs of roll, pitch, heave of  sign_j cor_3s(n, n')
        statistic = max_j A_j exp(S_j)

    n: residuals of roll rate, pitch rate and vertical acceleration, high-passed at 1 s and normalised by what was
    commanded (see `disturbance`). A is about 0.7 to 1.5 in healthy flight, S below 0.6; a wandering rotor has S near
    0.7. It is METHOD section 4's E > .. and S > .. as one figure, ln statistic = E/2 + S, so that one threshold can be
    set on it; on the linear scale, because in the logarithm the calm flights widen the healthy law more than the busy
    ones raise it. `level` is the same arm's rms before normalising [rad/s], which grades the damage; `signal` the
    arm's n; `rotors` are the S_j.

    Warm-up: half an SG window, 1.5 s to settle, then 3 s unbroken and valid. RunLength: 50 ms and the time until the
    rms is there: about 0.4 s for a thrust that wanders by 6 %, 1 s for 3 %. Price: see `threshold`. Blind spots: a
    rotor that is weak but steady (the trim shows it), balanced damage, gusts of a kind that the healthy flights
    lacked, vibration.

    >>> from mavdiag.testing import example_rows
    >>> rng = np.random.default_rng(8)
    >>> command = np.cumsum(rng.normal(0, 0.01, (3000, 3)), axis=0)
    >>> def fly(fault):
    ...     push = fault * np.convolve(rng.normal(0, 1, 3019), np.ones(20) / 20, "valid")[:, None]
    ...     rate = rng.normal(0, 0.05, (3000, 3)) + np.gradient(command, 0.01, axis=0)
    ...     force = rng.normal(0, 0.1, (3000, 3)) + push * [0, 0, -2]
    ...     return example_rows(3000, setpoint=command, rate=rate + push * [-1, 1, 0], force=force)   # rotor 2
    >>> monitor = RotorSignature(fit([[fly(0.0)]], layout_named("qdrone2"), window=5))
    >>> calm, faulty = (monitor.step(monitor.start(), fly(fault))[1] for fault in (0.0, 1.0))
    >>> [float(one.statistic[one.valid].max().round(1)) for one in (calm, faulty)], int(faulty.rotors[-1].argmax()) + 1
    ([2.0, 4.3], 2)
    """

    def __init__(self, spec: RotorSignatureSpec) -> None:
        self.spec = spec
        effects = _effects(layout_named(spec.frame))
        self._arms, self._square, self._signs = effects[:, :2], _square(effects), _signs(effects)
        self._observer = Observer(spec.motion)

    @property
    def name(self) -> str:
        """Key in the baseline, the journal and the scan report."""
        return "energy"

    @property
    def unit(self) -> str:
        """Unit of the statistic."""
        return "x healthy rms"

    @property
    def axis(self) -> Axis | None:
        """It concerns the whole vehicle."""
        return None

    def start(self) -> RotorSignatureState:
        """Nothing seen yet."""
        return RotorSignatureState(self._observer.start(), np.empty((0, 9)), np.empty(0, dtype=np.bool_))

    def step(self, state: RotorSignatureState, rows: Rows) -> tuple[RotorSignatureState, Reading]:
        """The statistic about every 10 ms, at the time of the newest row that it rests on."""
        window = self.spec.samples
        if rows.block.segment != state.inner.pick.segment:
            state = self.start()
        inner, d = self._observer.step(state.inner, rows)
        products = np.concatenate((state.products, _products(d)))
        valid = np.concatenate((state.valid, d.valid))
        mean, full = window_mean(products, window), window_all(valid, window)
        known = len(mean)
        likeness = _correlations(mean) @ self._signs
        evidence = np.sqrt(np.maximum(mean[:, :3] @ self._square, 0.0)) * np.exp(likeness)
        best = evidence.argmax(axis=1)
        at = np.arange(known)
        level = np.sqrt(np.maximum(mean[:, 6:] @ self._square, 0.0))[at, best]
        latest = len(d.t_ns) - known
        signal = np.einsum("nk,nk->n", d.n[latest:, :2], self._arms[best])
        reading = Reading(d.t_ns[latest:], evidence[at, best], level, signal, full, likeness)
        return RotorSignatureState(inner, products[known:], valid[known:]), reading


def fit(
    flights: Flights, frame: RotorLayout, *, window: int | None = None, window_s: float = WINDOW_S
) -> RotorSignatureSpec:
    """Identify the healthy motion. window: rows of the rate filters, 0.1 s of them if not given.

    Raises InputError if a signal is missing, IdentificationError if the flights cannot carry the models.
    """
    reason = judgeable([rows for flight in flights for rows in flight], frame)
    if reason is not None:
        raise InputError(f"energy: {reason}")
    dt_s = flights[0][0].block.dt_s
    stride, rows = stride_of(dt_s), window_samples(dt_s) if window is None else window
    motion = HealthyMotion(dt_s=dt_s, stride=stride, window=rows, roll=NO_ANSWER, pitch=NO_ANSWER, heave=NO_ANSWER)
    pieces = list(_pieces(flights, motion))
    if not pieces:
        raise IdentificationError(f"energy: no unbroken {MIN_PIECE_S:g} s of flight to identify from; fly longer")
    motion = replace(
        motion, roll=_rate(pieces, 0, motion), pitch=_rate(pieces, 1, motion), heave=_heave(pieces, motion)
    )
    k = _variances(flights, motion)
    motion = replace(motion, k0=(k[0][0], k[1][0], k[2][0]), k1=(k[0][1], k[1][1], k[2][1]))
    return RotorSignatureSpec(frame=frame.name, motion=motion, window_s=window_s)


def judgeable(rows: Sequence[Rows], frame: RotorLayout | None) -> str | None:
    """Why these rows cannot be judged, or None. A link is judged by a flight over it."""
    if frame is None:
        return "the rotor layout is not known; name the frame"
    flown = [one for one in rows if one.rates.valid.any()]
    if not flown:
        return "no flight with a gyro and an attitude set-point"
    if 1 / flown[0].block.dt_s < 0.98 * MIN_RATE_HZ:
        return f"the gyro comes at {1 / flown[0].block.dt_s:.3g} Hz; {MIN_RATE_HZ:.0f} Hz are needed, better 100"
    if not any(np.isfinite(one.block.force[one.block.valid, 2]).any() for one in flown):
        return "no accelerometer, which tells a rotor from its opposite"
    return None


def _effects(frame: RotorLayout) -> FloatArray:
    """What a rise of each rotor's thrust does, (rotors, 3): unit vector in roll and pitch, and -1 for a_z (FRD)."""
    arms = frame.mixing[:, :2] / np.linalg.norm(frame.mixing[:, :2], axis=1, keepdims=True)
    return np.column_stack((arms, -np.ones(frame.rotors)))


def _products(d: Disturbance) -> FloatArray:
    """(k, 9): n_r^2, n_p^2, n_r n_p, n_h^2, n_r n_h, n_p n_h, then r_r^2, r_p^2, r_r r_p before normalising."""
    out = np.empty((len(d.t_ns), 9))
    roll, pitch, heave = d.n.T
    out[:, 0], out[:, 1], out[:, 2] = roll * roll, pitch * pitch, roll * pitch
    out[:, 3], out[:, 4], out[:, 5] = heave * heave, roll * heave, pitch * heave
    roll, pitch = d.r[:, 0], d.r[:, 1]
    out[:, 6], out[:, 7], out[:, 8] = roll * roll, pitch * pitch, roll * pitch
    return out


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
    roll, pitch, heave = np.sqrt(np.maximum(mean[:, [0, 1, 3]], LEAST_POWER)).T
    out = mean[:, [2, 4, 5]]
    out[:, 0] /= roll * pitch
    out[:, 1] /= roll * heave
    out[:, 2] /= pitch * heave
    return out


def _pieces(flights: Flights, motion: HealthyMotion) -> Iterator[Picked]:
    """Unbroken valid stretches of the flights, until there are enough samples."""
    least, taken = math.ceil(MIN_PIECE_S / motion.period_s), 0
    for flight in flights:
        if taken >= TRAIN_SAMPLES:
            return
        for one in _segments(flight, motion):
            edges = np.flatnonzero(np.diff(one.valid, prepend=False, append=False))
            for first, stop in zip(edges[::2], edges[1::2], strict=True):
                if stop - first >= least:
                    taken += int(stop - first)
                    cut = slice(first, stop)
                    yield Picked(one.t_ns[cut], one.u[cut], one.y[cut], one.heave[cut], one.valid[cut])


def _segments(flight: Sequence[Rows], motion: HealthyMotion) -> list[Picked]:
    """What is picked of each segment of a flight, in one piece."""
    found: dict[int, list[Picked]] = {}
    picker = Picker(motion.stride, motion.window)
    state = picker.start()
    for rows in flight:
        state, one = picker.step(state, rows)
        found.setdefault(rows.block.segment, []).append(one)
    return [
        Picked(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("t_ns", "u", "y", "heave", "valid"))
        )
        for parts in found.values()
    ]


def _rate(pieces: Sequence[Picked], axis: int, motion: HealthyMotion) -> Arx:
    """The rate model of one axis: of order 3 if the flights carry it, else of order 2."""
    u, y = [one.u[:, axis] for one in pieces], [one.y[:, axis] for one in pieces]
    for order in ORDERS[:-1]:
        try:
            return Arx.of(identify(u, y, order, dt=motion.period_s))
        except IdentificationError:
            continue
    try:
        return Arx.of(identify(u, y, ORDERS[-1], dt=motion.period_s))
    except IdentificationError as error:
        raise IdentificationError(f"energy, {('roll', 'pitch')[axis]}: {error}") from error


def _heave(pieces: Sequence[Picked], motion: HealthyMotion) -> Arx:
    """Vertical acceleration on thrust, both less their 1 s mean; nothing where thrust is not told or not moved."""
    alpha = forgetting(DRIFT_S, motion.period_s)
    moved = [one.heave - ema(one.heave[0], one.heave, alpha)[1] for one in pieces if np.isfinite(one.heave).all()]
    try:
        model = identify(
            [one[:, 1] for one in moved], [one[:, 0] for one in moved], HEAVE_ORDER, dt=motion.period_s, method="ls"
        )
    except IdentificationError:
        return NO_ANSWER
    return Arx.of(model)


def _variances(flights: Flights, motion: HealthyMotion) -> list[tuple[float, float]]:
    """k0 and k1 of roll, pitch and heave."""
    observer, squares, busy = Observer(motion), [np.empty((0, 3))], [np.empty((0, 3))]
    for flight in flights:
        state = observer.start()
        for rows in flight:
            state, d = observer.step(state, rows)
            squares.append(d.r[d.valid] ** 2)
            busy.append(d.busy[d.valid])
    r2, u2 = np.concatenate(squares), np.concatenate(busy)
    if len(r2) == 0 or r2.mean(axis=0).min() == 0:
        raise IdentificationError("energy: no settled flight with a live gyro and accelerometer; fly longer than 3 s")
    return [_variance(r2[:, axis], u2[:, axis]) for axis in range(3)]


def _variance(squares: FloatArray, busy: FloatArray) -> tuple[float, float]:
    """k0 > 0 and k1 >= 0 of r^2 = k0 + k1 busy, by non-negative least squares; k0 at least 5 % of the mean of r^2.

    [ n      sum x   ] [ k0 ]   [ sum r^2   ]      two unknowns: if one comes out negative, it is zero and the other
    [ sum x  sum x^2 ] [ k1 ] = [ sum x r^2 ]      is its own least-squares solution
    """
    mean, size = float(squares.mean()), float(busy.mean())
    x = busy / size if size > 0 else busy
    spread = float(np.mean(x * x)) - float(np.mean(x)) ** 2
    k1 = (float(np.mean(x * squares)) - mean * float(np.mean(x))) / spread if spread > 0 else 0.0
    k0 = mean - k1
    if k1 <= 0:
        return mean, 0.0
    if k0 < 0:
        k0, k1 = 0.0, float(np.mean(x * squares) / np.mean(x * x))
    return max(k0, MIN_SHARE * mean), k1 / size
