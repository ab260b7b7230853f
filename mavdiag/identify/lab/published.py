"""The two models that the thesis prints (T Eq 5.1, 5.2), kept for comparison. Nothing is judged with them.

Their sample time is not stated, and their gains at zero frequency are 194 and 317. So each carries an input scale,
fitted by us: with it they explain about 0.55 (roll) and 0.85 (pitch) of the emulated aircraft's output variance.
"""

from dataclasses import dataclass, replace

import numpy as np

from mavdiag.identify.model import ArxModel, Method
from mavdiag.telemetry import Axis

ASSUMED_DT_S = 0.001  # the logs were taken at 1 kHz (T 5.3); the models do not say


@dataclass(frozen=True, slots=True)
class ReferenceModel:
    """A published model, as printed, with the factor on an input in rad/s that gives an output in rad/s (estimated)."""

    axis: Axis
    model: ArxModel
    input_scale: float
    source: str

    @property
    def scaled(self) -> ArxModel:
        """The model from a commanded to a measured rate, both in rad/s."""
        return replace(self.model, b=self.model.b * self.input_scale)


def _printed(*coefficients: list[float]) -> ArxModel:
    a, b = map(np.array, coefficients)
    return ArxModel(a, b, ASSUMED_DT_S, (2, 2, 1), Method.PUBLISHED)


#: Poles 0.9985 and 0.534, gain 194.
THESIS_ROLL = ReferenceModel(Axis.ROLL, _printed([1.0, -1.5326, 0.5333], [0.0, 0.0743, 0.0616]), 1 / 75, "T Eq 5.1")

#: Poles 0.9908 and 0.9455, gain 317.
THESIS_PITCH = ReferenceModel(Axis.PITCH, _printed([1.0, -1.9363, 0.9368], [0.0, 0.1014, 0.0573]), 1 / 298, "T Eq 5.2")
