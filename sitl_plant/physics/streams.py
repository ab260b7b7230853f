"""The random numbers of a flight: one independent stream for each purpose, consumed in order of time.

How a flight is cut into calls therefore changes nothing, and a purpose that is not asked for changes no other.
"""

import math

import numpy as np

from mavdiag.telemetry import BoolArray, FloatArray
from sitl_plant.physics.air import Dryden, Turbulence
from sitl_plant.physics.kernel import Model, Noise
from sitl_plant.physics.sensors import CHANNELS, IMUS

OUTAGE_S = (0.3, 2.0)  # an outage lasts so long, uniform (our choice)
MOST_OUTAGES_PER_MIN = 20.0


class Outages:
    """When the cameras see no marker at all: from t = 0 on, `per_min` times a minute on average, at random times.

    The gap from the end of one to the beginning of the next is exponential.
    """

    def __init__(self, per_min: float, rng: np.random.Generator) -> None:
        self._gap_s, self._rng = 60.0 / per_min, rng
        self._spans = [self._after(0.0)]

    def _after(self, t_s: float) -> tuple[float, float]:
        start = t_s + float(self._rng.exponential(self._gap_s))
        return start, start + float(self._rng.uniform(*OUTAGE_S))

    def during(self, t_s: FloatArray) -> BoolArray:
        """Which of these times, ascending, lie in an outage."""
        while len(t_s) and self._spans[-1][0] <= t_s[-1]:
            self._spans.append(self._after(self._spans[-1][1]))
        lost = np.zeros(len(t_s), dtype=np.bool_)
        for start, end in self._spans:
            lost |= (start <= t_s) & (t_s < end)
        return lost


class Streams:
    """The streams of one flight.

    turbulence: Dryden gusts and where the wind blows to [rad]; None for the gusts of the vehicle's file.
    outages_per_min: of the cameras; 0 for none.
    """

    def __init__(
        self, seed: int, dt_s: float, turbulence: tuple[Dryden, float] | None = None, outages_per_min: float = 0.0
    ) -> None:
        *children, gusts, outages = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(8))
        self.angle, self.rotors, self.imu, self.wind, self.markers, self.occlusion = children
        self._dt_s, self._imu_columns = dt_s, CHANNELS
        self._gusts = Turbulence(*turbulence, dt_s, gusts) if turbulence is not None else None
        self._outages = Outages(outages_per_min, outages) if outages_per_min else None

    def take_imus(self, imus: np.random.Generator) -> None:
        """Draw from now on for both IMUs of a vehicle as it was recorded, from a stream of their own."""
        self.imu, self._imu_columns = imus, 2 * IMUS * CHANNELS

    def draw(self, first: int, count: int, model: Model) -> Noise:
        """Numbers for `count` steps from step `first` on."""
        period, markers = model.mocap.period, len(model.mocap.markers)
        frame = math.ceil(first / period)
        frames = math.ceil((first + count) / period) - frame
        occlusion = self.occlusion.random((frames, markers))
        if self._outages is not None:
            at_s = np.arange(frame, frame + frames, dtype=np.float64) * (period * self._dt_s)
            occlusion[self._outages.during(at_s)] = -1.0  # less than any probability: hidden
        return Noise(
            rotors=self.rotors.standard_normal((count, 2 * len(model.rotors.sign))),
            imu=self.imu.standard_normal((count, self._imu_columns)),
            wind=self.wind.standard_normal((count, 3)) if self._gusts is None else self._gusts.draw(count),
            markers=self.markers.standard_normal((frames, markers, 3)),
            occlusion=occlusion,
        )
