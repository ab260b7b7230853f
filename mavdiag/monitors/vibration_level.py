"""Unbalance as the autopilot measures it: the VIBRATION message, where the IMU stream itself is low-passed.

ArduPilot filters RAW_IMU at 20 Hz, so a rotor's unbalance (100-200 Hz) is gone from it. Its VIBRATION message is made
before that filter and passes 30-150 Hz at 95 % (METHOD section 4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mavdiag.decision.events import Reading
from mavdiag.errors import InputError
from mavdiag.monitors.base import Rows
from mavdiag.rows.block import Block
from mavdiag.rows.running import MeanState, sliding_mean, start_mean, window_rows
from mavdiag.telemetry import Axis, BoolArray
from mavdiag.thresholds.heldout import Flights
from mavdiag.thresholds.rule import Guard

__all__ = ["GUARD", "VibrationLevel", "VibrationLevelSpec", "VibrationLevelState", "fit", "judgeable"]

WINDOW_S = 5.0  # our choice; 3.5 to 6.5 s change no verdict on the recorded flights
LIMIT_M_S2 = 1e4  # a reading is cut here: more is damage, not vibration (our choice)

# A vehicle in a simulator or on a calm day hardly shakes: 0.5 m/s^2 more is asked for at least (our choice).
GUARD = Guard(above_mean=0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class VibrationLevelSpec:
    """The length of the mean [s], and the healthy mean level [m/s^2], for a report. Raises InputError."""

    kind: Literal["shake"] = "shake"
    healthy: float
    window_s: float = WINDOW_S

    def __post_init__(self) -> None:
        if not (math.isfinite(self.healthy) and self.healthy >= 0 and self.window_s > 0):
            raise InputError("shake: the healthy level and the window must be finite and not negative")


@dataclass(frozen=True, slots=True, eq=False)
class VibrationLevelState:
    """Segment of the last rows and the sliding mean."""

    segment: int
    mean: MeanState


@dataclass(frozen=True, slots=True)
class VibrationLevel:
    """Statistic: the 5 s mean of |VIBRATION|, the norm of its x, y and z [m/s^2].

    The message comes a few times a second; its last value holds between. `level` is the rise over the healthy mean,
    `signal` the latest value. The message says nothing of rotors.

    Warm-up: 5 s of unbroken valid flight. RunLength: up to 5 s. Price: see `threshold`, and never less than 0.5 m/s^2
    above the mean healthy maximum. Blind spots: a propeller that lost thrust but kept its balance; a message that
    stops, for its last value goes on; clipped accelerometers. Wind, landing gear contact and loose mounts raise it.

    >>> from mavdiag.testing import example_rows
    >>> shaking = np.abs(np.random.default_rng(1).normal(0.0, [0.6, 0.6, 2.0], (1000, 3)))
    >>> monitor = VibrationLevel(VibrationLevelSpec(healthy=0.4))
    >>> _, reading = monitor.step(monitor.start(), example_rows(1000, 0.01, vibration=shaking))
    >>> float(reading.statistic[-1].round(1)), reading.valid[[498, 499]].tolist()
    (1.9, [False, True])
    """

    spec: VibrationLevelSpec

    @property
    def name(self) -> str:
        """Key in the baseline, the journal and the scan report."""
        return "vibration"

    @property
    def unit(self) -> str:
        """Unit of the statistic."""
        return "m/s^2"

    @property
    def axis(self) -> Axis | None:
        """It concerns the whole vehicle."""
        return None

    def start(self) -> VibrationLevelState:
        """Nothing seen yet."""
        return VibrationLevelState(-1, start_mean(1))

    def step(self, state: VibrationLevelState, rows: Rows) -> tuple[VibrationLevelState, Reading]:
        """The mean level at each of the next rows."""
        block = rows.block
        told = _told(block)
        size = np.linalg.norm(np.clip(np.where(told[:, None], block.vibration, 0.0), -LIMIT_M_S2, LIMIT_M_S2), axis=1)
        before = state.mean if state.segment == block.segment else start_mean(1)
        window = window_rows(self.spec.window_s, block.dt_s)
        mean_state, mean, full = sliding_mean(before, size[:, None], told & block.valid, window)
        level = mean[:, 0]
        reading = Reading(block.t_ns, level, level - self.spec.healthy, size, full, np.empty((len(block), 0)))
        return VibrationLevelState(block.segment, mean_state), reading


def fit(flights: Flights, window_s: float = WINDOW_S) -> VibrationLevelSpec:
    """Healthy mean level. Raises InputError if the vehicle sends no VIBRATION in flight."""
    reason = judgeable([rows for flight in flights for rows in flight])
    if reason is not None:
        raise InputError(f"vibration: {reason}")
    blocks = [rows.block for flight in flights for rows in flight]
    sizes = [np.linalg.norm(block.vibration[block.valid & _told(block)], axis=1) for block in blocks]
    return VibrationLevelSpec(healthy=float(np.concatenate(sizes).mean()), window_s=window_s)


def judgeable(rows: Sequence[Rows]) -> str | None:
    """Why the VIBRATION of these rows cannot be judged, or None. A link is judged by a flight over it.

    A profile whose message means something else (PX4's) gives no such signal.
    """
    if any((one.block.valid & _told(one.block)).any() for one in rows):
        return None
    return "the vehicle sends no VIBRATION message with acceleration per axis"


def _told(block: Block) -> BoolArray:
    return np.asarray(np.isfinite(block.vibration).all(axis=1))
