"""Where the rotors are and which way they turn: the mixing of roll, pitch and yaw, and how to find it from a flight.

A frame is its table of signs: what one rotor's thrust does to the vehicle, in FRD (roll right, pitch nose up, yaw nose
right are positive). Rotors are numbered as the vehicle numbers its outputs. Everything that names a rotor, in a
monitor or in an alert, means this numbering.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from mavdiag.errors import UsageError
from mavdiag.rows.block import Block
from mavdiag.rows.front import Rows
from mavdiag.telemetry import FloatArray

__all__ = ["LAYOUTS", "RotorLayout", "detect_layout", "layout_likeness", "layout_named"]

SQRT2 = math.sqrt(2.0)
LAGS_S = (0.0, 0.02, 0.04, 0.06, 0.1, 0.15)  # of the acceleration: motor lag and gyro filter (our choice)
MIN_ROWS = 200
MIN_LIKENESS = 0.6  # cosine between the fitted and a frame's table; below it nothing is claimed (our choice)
MIN_LEAD = 0.2  # and the next frame must be less like it by this much (our choice)
MIN_OUTPUT = 0.05  # mean output below which the motors do not carry (our choice)


@dataclass(frozen=True, slots=True)
class RotorLayout:
    """Rotor geometry.

    signs: per rotor its (roll, pitch, yaw) effect, scaled so that the squares of each column sum to the number of
    rotors. torque_gain: share of the full output of a motor that a full-scale (roll, pitch, yaw) torque command adds,
    None where the vehicle's mixing is not known; then only its outputs tell the trims.
    Raises UsageError if roll, pitch and yaw cannot be told apart.
    """

    name: str
    signs: tuple[tuple[float, float, float], ...]
    torque_gain: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.mixing.shape[1:] != (3,) or np.linalg.matrix_rank(self.mixing) < 3:
            raise UsageError(f"frame {self.name}: its rotors cannot command roll, pitch and yaw independently")

    @property
    def rotors(self) -> int:
        """How many there are."""
        return len(self.signs)

    @property
    def mixing(self) -> FloatArray:
        """B, (rotors, 3): outputs w = B m that make a trim m of roll, pitch and yaw."""
        return np.array(self.signs, dtype=np.float64).reshape(len(self.signs), -1)

    @property
    def unmixing(self) -> FloatArray:
        """C = pinv(B), (3, rotors), read-only: trim m = C w; column j is the trim that a unit rise of rotor j makes."""
        return _unmixing(self.signs)


@cache
def _unmixing(signs: tuple[tuple[float, float, float], ...]) -> FloatArray:
    """Of a frame's signs; kept, for a stream asks for it in every step."""
    C = np.asarray(np.linalg.pinv(np.array(signs, dtype=np.float64)), dtype=np.float64)
    C.setflags(write=False)
    return C


_KNOWN = (
    # T Eq 2.2-2.4, turned from y left, z up into FRD. 1 rear right, 2 front right, 3 rear left, 4 front left.
    RotorLayout("qdrone2", ((-1, -1, -1), (-1, 1, 1), (1, -1, 1), (1, 1, -1))),
    # Crazyflie 2.1, seen from above: 1 front right, 2 rear right, 3 rear left, 4 front left. Its firmware adds
    # half the roll and pitch commands and the whole yaw command, each of int16, to a thrust of uint16
    # (power_distribution_quadrotor.c, legacy mixing).
    RotorLayout(
        "crazyflie",
        ((-1, 1, 1), (-1, -1, -1), (1, -1, 1), (1, 1, -1)),
        (0.5 * 32767 / 65535, 0.5 * 32767 / 65535, 32767 / 65535),
    ),
    # ArduPilot X, AP_MotorsMatrix: 1 front right, 2 rear left, 3 front left, 4 rear right. PX4's quad X is the same.
    RotorLayout("x", ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))),
    # ArduPilot plus: 1 right, 2 left, 3 front, 4 rear.
    RotorLayout("plus", ((-SQRT2, 0, 1), (SQRT2, 0, 1), (0, SQRT2, -1), (0, -SQRT2, -1))),
)

#: The frames known by name. Six and eight rotors are further rows.
LAYOUTS = {frame.name: frame for frame in _KNOWN}


def layout_named(name: str) -> RotorLayout:
    """The frame of that name. Raises UsageError, listing the names, if there is none."""
    if name not in LAYOUTS:
        raise UsageError(f"no frame {name}; there are {', '.join(LAYOUTS)}")
    return LAYOUTS[name]


def detect_layout(rows: Sequence[Rows], known: Sequence[RotorLayout] = _KNOWN) -> RotorLayout | None:
    """The known frame that healthy flying fits; None where the outputs are missing or it stays unclear.

    See `layout_likeness`. A frame is named if its likeness reaches 0.6 and the next one is 0.2 behind.
    """
    likeness = layout_likeness(rows, known)
    if likeness is None:
        return None
    order = np.argsort(-likeness)
    lead = likeness[order[0]] - (likeness[order[1]] if len(order) > 1 else 0.0)
    best = int(order[0])
    return known[best] if likeness[best] >= MIN_LIKENESS and lead >= MIN_LEAD else None


def layout_likeness(rows: Sequence[Rows], known: Sequence[RotorLayout] = _KNOWN) -> FloatArray | None:
    """How well each known frame explains the outputs of a flight, (frames,) in -1..1; None without outputs.

    What drives the outputs is, in this order, what the vehicle tells: the torque command, the rate error (set-point
    minus gyro, to which the rate controller answers), or the angular acceleration that the outputs make some lag
    later. With w = o/mean(o) - 1 and drivers x, both as changes from row to row so that trims and drifts do not count,
        B_fit = cor(w, x),     likeness = mean over roll and pitch of cos(B_fit column, B column);
    for the acceleration at the lag with the longest B_fit. Yaw does not count: it is too weak to be seen in a calm
    hover, and no two of the known frames differ in nothing else. Its price: some hundred rows in which the vehicle
    turns.
    """
    driver = next((one for one in (_torque, _rate_error) if _told(rows, one)), _acceleration)
    cuts = [cut for cut in (_relative(one, driver) for one in rows) if cut is not None]
    rotors = cuts[0][0].shape[1] if cuts else 0
    candidates = [i for i, frame in enumerate(known) if frame.rotors == rotors]
    if not candidates or sum(len(w) for w, _ in cuts) < MIN_ROWS:
        return None
    lags_s = LAGS_S if driver is _acceleration else (0.0,)
    fits = [_correlation(cuts, lag) for lag in sorted({round(lag_s / rows[0].block.dt_s) for lag_s in lags_s})]
    best = max(fits, key=lambda fit: float(np.square(fit).sum()))
    likeness = np.full(len(known), -1.0)
    for i in candidates:
        likeness[i] = float(np.mean([_cosine(best[:, k], known[i].mixing[:, k]) for k in (0, 1)]))
    return likeness


def _torque(block: Block) -> FloatArray:
    return block.torque


def _rate_error(block: Block) -> FloatArray:
    return block.rate_setpoint - block.rate


def _acceleration(block: Block) -> FloatArray:
    change = np.full(block.rate.shape, np.nan)
    change[1:] = np.diff(block.rate, axis=0)
    return change


def _told(rows: Sequence[Rows], driver: Callable[[Block], FloatArray]) -> bool:
    """Whether the vehicle tells this driver throughout, and it moves."""
    x = [driver(one.block)[one.block.valid] for one in rows]
    return all(np.isfinite(part).all() for part in x) and any(len(part) and np.ptp(part) > 0 for part in x)


def _relative(rows: Rows, driver: Callable[[Block], FloatArray]) -> tuple[FloatArray, FloatArray] | None:
    """Outputs relative to their mean, (n, rotors), and what drives them, (n, 3), of the valid rows."""
    block = rows.block
    if block.actuator.shape[1] < 3 or len(block) == 0:
        return None
    mean, x = block.actuator.mean(axis=1), driver(block)
    good = block.valid & (mean > MIN_OUTPUT) & np.isfinite(x).all(axis=1)
    if not good.any():
        return None
    return block.actuator[good] / mean[good, None] - 1.0, x[good]


def _correlation(cuts: Sequence[tuple[FloatArray, FloatArray]], lag: int) -> FloatArray:
    """Correlation of output changes with driver changes `lag` rows later, (rotors, 3)."""
    w = np.concatenate([np.diff(w, axis=0)[: max(len(w) - 1 - lag, 0)] for w, _ in cuts])
    x = np.concatenate([np.diff(x, axis=0)[lag:] for _, x in cuts])
    scale = np.outer(np.linalg.norm(w, axis=0), np.linalg.norm(x, axis=0))
    product = w.T @ x
    return np.asarray(np.divide(product, scale, out=np.zeros_like(product), where=scale > 0), dtype=np.float64)


def _cosine(a: FloatArray, b: FloatArray) -> float:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0
