"""How wear grows over the flights, for `history_wear.py`: shares of the last level, 1 at the last flight.

`TUNED` were looked at when the figures of the warning were chosen first; all, on seeds of their own, when they were
chosen again after a first judging (seed 9100: 173 of 200). The judging that is reported has a seed that nothing was
chosen by.
"""

from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from mavdiag.telemetry import FloatArray

__all__ = ["FURTHER", "HARSH", "LAWS", "TUNED", "Law", "growth"]

Law = Callable[[FloatArray, np.random.Generator], FloatArray]


def _linear(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    return t


def _power(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Exponents of 0.7 to 3: it slows down or speeds up."""
    power: FloatArray = t ** np.exp(rng.uniform(np.log(0.7), np.log(3.0)))
    return power


def _late(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Nothing over the first 20 to 60 %, then a line."""
    begin = rng.uniform(0.2, 0.6)
    share: FloatArray = np.clip((t - begin) / (1 - begin), 0.0, 1.0)
    return share


def _nicks_of(count: tuple[int, int], spread: float) -> Law:
    """Jumps of random size at random flights, the last one at the last flight."""

    def law(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        n = int(rng.integers(count[0], count[1] + 1))
        at = np.append(rng.uniform(0.0, 1.0, n - 1), t[-1])
        size = rng.dirichlet(np.full(n, spread))
        share: FloatArray = (size * (t[:, None] >= at)).sum(axis=1)
        return share

    return law


def _gamma(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A gamma process: some flights wear much, most little (van Noortwijk, Reliab. Eng. Syst. Saf. 94 (2009) 2)."""
    total = np.cumsum(rng.gamma(rng.uniform(0.3, 3.0), 1.0, len(t)))
    share: FloatArray = total / total[-1]
    return share


def _bent(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Two lines, the second 2 to 5 times as steep."""
    bend, ratio = rng.uniform(0.3, 0.7), rng.uniform(2.0, 5.0)
    found: FloatArray = np.where(t < bend, t, bend + ratio * (t - bend))
    share: FloatArray = found / found[-1]
    return share


def _s_curve(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Slow, fast, and slower again towards the end."""
    steep, middle = rng.uniform(3.0, 6.0), rng.uniform(0.5, 0.7)
    found: FloatArray = 1 / (1 + np.exp(-steep * (t - middle) / 0.5))
    begin = 1 / (1 + np.exp(steep * middle / 0.5))
    share: FloatArray = (found - begin) / (found[-1] - begin)
    return share


TUNED = MappingProxyType({"linear": _linear, "power": _power, "late": _late, "nicks": _nicks_of((12, 40), 2.0)})
FURTHER = MappingProxyType({"gamma process": _gamma, "bent": _bent, "s-curve": _s_curve})
LAWS = MappingProxyType({**TUNED, **FURTHER})
HARSH = MappingProxyType({"few large nicks": _nicks_of((5, 11), 3.0), "square root": lambda t, rng: np.sqrt(t)})
"""Not among those that the demanded figure is about: jumps that nothing announces, and wear that slows down much."""


def growth(law: Law, flights: int, rng: np.random.Generator) -> FloatArray:
    """(flights,) the share after each flight."""
    return law(np.arange(1, flights + 1) / flights, rng)
