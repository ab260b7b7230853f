"""The rotor-trim monitor: one rotor works harder, against the others, than it did when all were healthy.

A controller with an integrator hides a weak rotor from its own attitude error: it commands more. That command is the
evidence, and it names the rotor (METHOD section 5). What it cannot tell is why: a changed propeller, a payload hung off
the centre or a damaged blade all shift the trim. So its alert says "trim shift".
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavdiag.airframe.layout import RotorLayout, layout_named
from mavdiag.decision.events import Reading
from mavdiag.errors import IdentificationError, InputError
from mavdiag.monitors.base import Rows
from mavdiag.rows.block import Block
from mavdiag.rows.running import MeanState, sliding_mean, start_mean, window_rows
from mavdiag.telemetry import Axis, BoolArray, FloatArray
from mavdiag.thresholds.heldout import Flights
from mavdiag.thresholds.rule import Guard

__all__ = ["ALERT_TEXT", "GUARD", "RotorTrim", "RotorTrimSpec", "RotorTrimState", "fit", "judgeable"]

ALERT_TEXT = "trim shift"
WINDOW_S = 5.0  # our choice; 3.5 s works as well on the recorded flights
YAW_FLOOR = 0.002  # of the hover command: smallest yaw spread that is believed (our choice)
LEVEL_RATIO = 3.0  # least spread of roll and pitch over that of yaw; METHOD section 5 measured .07 to .012
MIN_OUTPUT = 0.05  # mean output or thrust below which nothing flies (our choice)

# Few flights do not show how the trim changes from session to session: 0.06 more with one flight, nothing more from
# five on. Found on subsets of the five healthy recorded flights of one airframe, so an estimate. And a shift of less
# than 0.02 is what wind and new propellers make (thrust coefficients differ by 0.8 %, METHOD section 3).
GUARD = Guard(few_flights=0.06, enough_flights=5, least=0.02)


@dataclass(frozen=True, slots=True, kw_only=True)
class RotorTrimSpec:
    """Healthy trim. frame: key of `layout.LAYOUTS`; source: what tells the trim, the motors' outputs or the torque
    commands over the thrust. mean, spread: of the 5 s means of roll, pitch and yaw trim [fraction of hover].

    Raises InputError if they do not describe a vehicle.
    """

    kind: Literal["effort"] = "effort"
    frame: str
    source: Literal["actuator", "torque"]
    mean: tuple[float, float, float]
    spread: tuple[float, float, float]
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        frame = layout_named(self.frame)
        if not all(math.isfinite(x) for x in (*self.mean, *self.spread)) or min(*self.spread, self.window_s) <= 0:
            raise InputError("effort: the healthy trim must be finite, its spread and the window positive")
        if self.source == "torque" and frame.torque_gain is None:
            raise InputError(f"effort: what a torque command does to the motors of frame {self.frame} is not known")


@dataclass(frozen=True, slots=True, eq=False)
class RotorTrimState:
    """Segment of the last rows and the sliding mean of the trim."""

    segment: int
    mean: MeanState


@dataclass(frozen=True, slots=True)
class RotorTrim:
    """Statistic: the rise of ONE rotor's command that explains the trim shift best [fraction of hover].

        w_i = o_i/mean(o) - 1,    m = C w averaged over 5 s,    C = pinv(B), B the frame's signs
        a_j = c_j' W (m - mu) / (c_j' W c_j),    W = diag(1/sd^2),    statistic = max_j a_j,    rotor = argmax_j a_j

    o: motor outputs 0..1; or m itself from torque commands over thrust (a Crazyflie logs no outputs). a_j is the
    least-squares rise of rotor j alone, c_j its column of C, mu and sd the healthy trim's. A payload, a weak battery
    or a shifted centre of mass move roll and pitch, not yaw; W gives them at least three times yaw's spread, so the
    evidence lives on yaw, and roll and pitch settle which rotor it is. `level` is the same amplitude, which grades
    the damage; `signal` is the yaw trim's shift; `rotors` are the a_j.

    Warm-up: 5 s of unbroken valid flight. RunLength: up to 5 s. Price: see `threshold`; two flights from two sessions
    are the worst basis. Blind spots: hops shorter than 5 s; vibration without loss of thrust; all rotors ageing
    alike; a rotor whose outputs saturate. A change of propellers or of the centre of mass raises it without a fault.

    >>> from mavdiag.testing import example_rows
    >>> outputs = np.random.default_rng(3).normal([0.5, 0.55, 0.5, 0.5], 0.02, (1000, 4))   # rotor 2 works harder
    >>> monitor = RotorTrim(RotorTrimSpec(frame="x", source="actuator", mean=(0.0, 0.0, 0.0), spread=(0.03, 0.03, 0.01)))
    >>> _, reading = monitor.step(monitor.start(), example_rows(1000, 0.01, actuator=outputs))
    >>> float(reading.statistic[-1].round(2)), int(reading.rotors[-1].argmax()) + 1, reading.valid[[498, 499]].tolist()
    (0.1, 2, [False, True])
    """

    spec: RotorTrimSpec

    @property
    def name(self) -> str:
        """Key in the baseline, the journal and the scan report."""
        return "effort"

    @property
    def unit(self) -> str:
        """Unit of the statistic."""
        return "fraction of hover"

    @property
    def axis(self) -> Axis | None:
        """It concerns the whole vehicle."""
        return None

    def start(self) -> RotorTrimState:
        """Nothing seen yet."""
        return RotorTrimState(-1, start_mean(3))

    def step(self, state: RotorTrimState, rows: Rows) -> tuple[RotorTrimState, Reading]:
        """The best single-rotor rise at each of the next rows."""
        frame, block = layout_named(self.spec.frame), rows.block
        mean_state, mean, full = _trims(state, block, frame, self.spec.source, self.spec.window_s)
        shift = mean - np.array(self.spec.mean)
        # (n, rotors) = (n, 3) (3,) @ (3, rotors) / (rotors,)
        C, W = frame.unmixing, np.array(self.spec.spread) ** -2
        rotors = np.einsum("nk,kr->nr", shift * W, C) / np.einsum("k,kr,kr->r", W, C, C)
        rise = rotors.max(axis=1)
        return RotorTrimState(block.segment, mean_state), Reading(block.t_ns, rise, rise, shift[:, 2], full, rotors)


def fit(flights: Flights, frame: RotorLayout, window_s: float = WINDOW_S) -> RotorTrimSpec:
    """Healthy trim from healthy flights: mean over flights of their means, spread of all their windows about it.

    sd_yaw is widened by 0.002, sd_roll and sd_pitch are at least 3 sd_yaw. Raises InputError if the flights do not
    tell the trim, IdentificationError if none of them has an unbroken window.
    """
    reason = judgeable([rows for flight in flights for rows in flight], frame)
    if reason is not None:
        raise InputError(f"effort: {reason}")
    source = _source([rows for flight in flights for rows in flight], frame)
    means = [found for found in (_windows(flight, frame, source, window_s) for flight in flights) if len(found)]
    if not means:
        raise IdentificationError(f"effort: no unbroken {window_s:g} s of flight to average the trim over; fly longer")
    mu = np.mean([found.mean(axis=0) for found in means], axis=0)
    roll, pitch, yaw = np.sqrt(np.mean((np.concatenate(means) - mu) ** 2, axis=0)).tolist()
    yaw = math.hypot(yaw, YAW_FLOOR)
    spread = (max(roll, LEVEL_RATIO * yaw), max(pitch, LEVEL_RATIO * yaw), yaw)
    return RotorTrimSpec(frame=frame.name, source=source, mean=_three(mu), spread=spread, window_s=window_s)


def judgeable(rows: Sequence[Rows], frame: RotorLayout | None) -> str | None:
    """Why the trim of these rows cannot be judged, or None. A link is judged by a flight over it."""
    if frame is None:
        return "the rotor layout is not known; name the frame"
    for source in ("actuator", "torque"):
        if any((one.block.valid & _trim(one.block, frame, source)[1]).any() for one in rows if len(one.block)):
            return None
    return f"it needs the outputs of {frame.rotors} motors above idle, or torque commands whose mixing is known"


def _source(rows: Sequence[Rows], frame: RotorLayout) -> Literal["actuator", "torque"]:
    """The outputs where they are told, for they are what the rotors really got."""
    told = any((one.block.valid & _trim(one.block, frame, "actuator")[1]).any() for one in rows if len(one.block))
    return "actuator" if told else "torque"


def _windows(flight: Sequence[Rows], frame: RotorLayout, source: str, window_s: float) -> FloatArray:
    """The full window means of a flight, (k, 3)."""
    state, found = RotorTrimState(-1, start_mean(3)), [np.empty((0, 3))]
    for rows in flight:
        mean_state, mean, full = _trims(state, rows.block, frame, source, window_s)
        state = RotorTrimState(rows.block.segment, mean_state)
        found.append(mean[full])
    return np.concatenate(found)


def _trims(
    state: RotorTrimState, block: Block, frame: RotorLayout, source: str, window_s: float
) -> tuple[MeanState, FloatArray, BoolArray]:
    """Sliding mean of the trim at each row, (n, 3), and where its window is full."""
    trim, told = _trim(block, frame, source)
    before = state.mean if state.segment == block.segment else start_mean(3)
    return sliding_mean(before, trim, told & block.valid, window_rows(window_s, block.dt_s))


def _trim(block: Block, frame: RotorLayout, source: str) -> tuple[FloatArray, BoolArray]:
    """Roll, pitch and yaw trim of each row, (n, 3) [fraction of hover], and where it is told; zero elsewhere."""
    if source == "actuator":
        return _actuator_trim(block, frame)
    if frame.torque_gain is None:
        return np.zeros((len(block), 3)), np.zeros(len(block), dtype=np.bool_)
    # B m = w is what the mixer adds to the thrust, so m is the command itself, over the thrust.
    told = (block.thrust > MIN_OUTPUT) & np.isfinite(block.torque).all(axis=1)
    command = block.torque * np.array(frame.torque_gain)
    return np.divide(command, block.thrust[:, None], out=np.zeros((len(block), 3)), where=told[:, None]), told


def _actuator_trim(block: Block, frame: RotorLayout) -> tuple[FloatArray, BoolArray]:
    outputs = block.actuator[:, : frame.rotors]
    if outputs.shape[1] < frame.rotors:
        return np.zeros((len(block), 3)), np.zeros(len(block), dtype=np.bool_)
    level = outputs.mean(axis=1)
    told = np.isfinite(outputs).all(axis=1) & (level > MIN_OUTPUT)
    w = np.divide(outputs, level[:, None], out=np.ones(outputs.shape), where=told[:, None]) - 1.0
    return np.einsum("nr,kr->nk", w, frame.unmixing), told


def _three(values: FloatArray) -> tuple[float, float, float]:
    roll, pitch, yaw = values.tolist()
    return roll, pitch, yaw
