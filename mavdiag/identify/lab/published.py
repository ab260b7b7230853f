"""The two models that the thesis prints (T Eq 5.1, 5.2), kept for comparison. Nothing is judged with them.

They cannot be used as they stand. Their sample time is not stated, and their gains at zero frequency, 194 and 317,
are not those of a rate that follows its reference, which is near 1. So each one carries an explicit input scale. The
scales 1/75 and 1/298 are fitted (our estimate, not the thesis's); with them the models explain about 0.55 (roll) and
0.85 (pitch) of the output variance of the emulated aircraft, without them R_T^2 is about -3e3 and -7e4.
"""

from dataclasses import dataclass, replace

import numpy as np

from mavdiag.identify.model import ArxModel, Method
from mavdiag.telemetry import Axis

__all__ = ["THESIS_PITCH", "THESIS_ROLL", "ReferenceModel"]

ASSUMED_DT_S = 0.001  # the logs were taken at 1 kHz (T 5.3); the models do not say


@dataclass(frozen=True, slots=True)
class ReferenceModel:
    """A published model with the scale that its input needs.

    model: as printed, input and output in the thesis's unstated units.
    input_scale: factor on an input in rad/s that gives an output in rad/s; estimated.
    source: equation of the thesis.
    """

    axis: Axis
    model: ArxModel
    input_scale: float
    source: str

    @property
    def scaled(self) -> ArxModel:
        """The model from a commanded to a measured rate, both in rad/s."""
        return replace(self.model, b=self.model.b * self.input_scale)


def _printed(axis: Axis, b: tuple[float, float], a: tuple[float, float], scale: float, source: str) -> ReferenceModel:
    model = ArxModel(np.array([1.0, *a]), np.array([0.0, *b]), ASSUMED_DT_S, (2, 2, 1), Method.PUBLISHED)
    return ReferenceModel(axis, model, scale, source)


#: Poles 0.9985 and 0.534, gain 194.
THESIS_ROLL = _printed(Axis.ROLL, (0.0743, 0.0616), (-1.5326, 0.5333), 1 / 75, "T Eq 5.1")

#: Poles 0.9908 and 0.9455, gain 317.
THESIS_PITCH = _printed(Axis.PITCH, (0.1014, 0.0573), (-1.9363, 0.9368), 1 / 298, "T Eq 5.2")
