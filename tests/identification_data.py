"""Known models, simulated records, and Octave's reference values for the identification tests."""

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from shared_data import shared

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


@cache
def octave(index: int) -> tuple[dict[str, Any], FloatArray, FloatArray]:
    folder = shared("reference/octave")
    table = np.genfromtxt(folder / "data_well.csv", delimiter=",", names=True)
    case: dict[str, Any] = json.loads((folder / "arx_reference_well.json").read_text())[index]
    return case, np.asarray(table["u"], dtype=np.float64), np.asarray(table[case["output"]], dtype=np.float64)
