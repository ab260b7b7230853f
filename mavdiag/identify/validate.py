"""How good is a model: fit figures and residual tests (T 4.1.3, Model validation)."""

import numpy as np

from mavdiag.errors import IdentificationError
from mavdiag.quantities import FloatArray

__all__ = ["nrmse_percent", "r_squared"]


def r_squared(y: FloatArray, y_sim: FloatArray) -> float:
    """R_T^2 = 1 - var(y - y_sim)/var(y), both (n,): 1 is perfect, 0 is no better than a constant (T 5.4).

    Blind to a constant offset. Raises IdentificationError if y is constant.
    """
    spread = float(np.var(y))
    if spread == 0.0:
        raise IdentificationError("y is constant; there is nothing to explain")
    return 1.0 - float(np.var(y - y_sim)) / spread


def nrmse_percent(y: FloatArray, y_sim: FloatArray) -> float:
    """Fit percentage 100 (1 - |y - y_sim| / |y - mean y|), both (n,) (T 4.1.3). Sees a constant offset.

    Raises IdentificationError if y is constant.
    """
    spread = float(np.linalg.norm(y - np.mean(y)))
    if spread == 0.0:
        raise IdentificationError("y is constant; there is nothing to explain")
    return 100.0 * (1.0 - float(np.linalg.norm(y - y_sim)) / spread)
