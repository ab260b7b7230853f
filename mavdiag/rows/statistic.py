"""What a monitor makes of the rows: one figure at a time, with the time that it stands for."""

from dataclasses import dataclass, field

import numpy as np

from mavdiag.telemetry import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Statistic:
    """A monitor's n values over consecutive rows of one segment.

    t_ns: vehicle time. period_s: span of flight that one value stands for [s].
    value: in the monitor's unit; it is compared with the threshold. valid: False where nothing may be concluded.
    level: a second figure that describes an alarm (for the fsd monitor the excess over the margin [rad/s]).
    signal: what a display draws: the residual [rad/s] or the value. rotors: (n, R) evidence, or (n, 0).
    """

    t_ns: IntArray
    period_s: float
    value: FloatArray
    valid: BoolArray
    level: FloatArray
    signal: FloatArray
    rotors: FloatArray = field(default_factory=lambda: np.empty((0, 0)))

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def judged_s(self) -> float:
        """Judged time in it [s]."""
        return float(np.count_nonzero(self.valid)) * self.period_s
