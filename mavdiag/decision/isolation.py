"""Which rotor it is: the evidence of several monitors, put into one answer or an honest "unknown".

    logit_j = sum over monitors of  w_m g_m e_mj,    p = softmax(logit),    named if max p >= 0.9

e_mj: a monitor's evidence for rotor j, as its statistic gives it. w_m: how many logits a unit of it is worth; each
monitor states it (`Monitor.evidence`), chosen on emulated flights so that a name at p = 0.9 is right in 99 of 100.
g_m = 0..1: a monitor counts for nothing below half of its threshold and in full at it, so that the noise of one that
finds nothing cannot outweigh one that does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavdiag.errors import UsageError
from mavdiag.monitors.base import RotorEvidence

__all__ = ["Isolation", "RotorReading", "isolate"]

NAME_AT = 0.9  # our choice; see the module's text
SILENT_BELOW = 0.5  # of the threshold (our choice)


@dataclass(frozen=True, slots=True)
class RotorReading:
    """One monitor's latest evidence.

    how: how its evidence counts.
    ratio: statistic over threshold.
    threshold: of the statistic; positive, else UsageError.
    rotors: evidence for each rotor.
    """

    how: RotorEvidence
    ratio: float
    threshold: float
    rotors: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.threshold > 0:
            raise UsageError(f"a threshold must be positive, not {self.threshold}")


def _sure(one: RotorReading) -> bool:
    """Whether a monitor names a rotor by itself."""
    if not one.rotors or not all(math.isfinite(x) for x in one.rotors):
        return False
    unit = one.how.weight / (one.threshold if one.how.relative else 1.0)
    highest = max(one.rotors)
    return math.fsum(math.exp(unit * (x - highest)) for x in one.rotors) <= 1.0 / NAME_AT


@dataclass(frozen=True, slots=True)
class Isolation:
    """The answer.

    rotor: from 1; None if the evidence fits more than one, or if there is none.
    confidence: of the likeliest rotor, 1/R..1; 0 without evidence.
    lead: logits by which it leads the next; it tells names apart whose confidence is near 1.
    """

    rotor: int | None
    confidence: float
    lead: float = 0.0


def isolate(readings: Sequence[RotorReading]) -> Isolation:
    """Put the evidence together.

    >>> shaking = RotorReading(RotorEvidence(8.0), ratio=4.0, threshold=0.5, rotors=(0.1, 0.9, -0.4, -0.5))
    >>> idle = RotorReading(RotorEvidence(8.0), ratio=0.3, threshold=4.0, rotors=(0.4, -0.1, 0.0, 0.0))
    >>> isolate([shaking, idle]).rotor, round(isolate([shaking, idle]).confidence, 3), isolate([idle]).rotor
    (2, 0.998, None)
    """
    logits: list[float] = []
    most = max((len(one.rotors) for one in readings), default=0)  # evidence on fewer rotors is of another layout
    observed = any(one.ratio > 1 and one.how.direct and _sure(one) for one in readings)
    for one in readings:
        gate = min(max((one.ratio - SILENT_BELOW) / (1.0 - SILENT_BELOW), 0.0), 1.0)
        if (observed and not one.how.direct) or gate == 0.0 or not all(math.isfinite(x) for x in one.rotors):
            continue
        if len(one.rotors) != most or not one.rotors:
            continue
        unit = one.how.weight * gate / (one.threshold if one.how.relative else 1.0)
        logits = [a + unit * b for a, b in zip(logits or [0.0] * len(one.rotors), one.rotors, strict=True)]
    if not logits:
        return Isolation(None, 0.0)
    highest = max(logits)
    confidence = 1.0 / math.fsum(math.exp(one - highest) for one in logits)
    lead = highest - sorted(logits)[-2] if len(logits) > 1 else 0.0
    return Isolation(logits.index(highest) + 1 if confidence >= NAME_AT else None, confidence, lead)
