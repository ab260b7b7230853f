"""Known models and simulated records for the identification tests."""

from dataclasses import dataclass

import numpy as np

from mavdiag.identify import ArxModel, Method
from mavdiag.telemetry import FloatArray

#: Well-damped second order, poles 0.6 +- 0.4j.
WELL = ArxModel(np.array([1.0, -1.2, 0.52]), np.array([0.0, 0.5, 0.25]), 0.01, (2, 2, 1), Method.PUBLISHED)

#: The thesis's roll model (T Eq 5.1): a pole at 0.9985, where least squares fails.
ROLL = ArxModel(np.array([1.0, -1.5326, 0.5333]), np.array([0.0, 0.0743, 0.0616]), 0.001, (2, 2, 1), Method.PUBLISHED)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """White input u, clean output, and output with white noise of `noise` times its standard deviation, (n,) each."""

    u: FloatArray
    clean: FloatArray
    y: FloatArray


def record(model: ArxModel, n: int, noise: float, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    clean = model.simulate(u)
    return Record(u, clean, clean + noise * clean.std() * rng.standard_normal(n))
