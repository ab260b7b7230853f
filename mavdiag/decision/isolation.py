"""Which rotor it is: what several monitors say of each rotor, put into one answer or an honest "unknown".

    logit_j = sum over monitors of  w_m g_m e_mj,    p = softmax(logit),    named if max p >= 0.9

e_mj: the monitor's evidence for rotor j, as its reading gives it. g_m = 0..1: a monitor has no say below half of its
threshold and full say at it, so that the noise of one that sees nothing cannot outvote one that does. w_m: how many
logits a unit of its evidence is worth, chosen on emulated flights so that a name at p = 0.9 is right in 99 of 100:

    vibration   8   the sense of turning and the place agree (1) or do not (0 and below)
    energy      8   a difference of 0.3 between mean correlations has named the right rotor in 99 of 100
    effort     10   evidence over its own threshold: of 35 recorded cuts a lead of 0.12 of it was right every time
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from mavdiag.errors import UsageError

__all__ = ["VOICES", "Isolation", "Outcome", "Voice", "Witness", "isolate"]

NAME_AT = 0.9  # our choice; see the module's text
SILENT_BELOW = 0.5  # of the threshold (our choice)


@dataclass(frozen=True, slots=True)
class Voice:
    """weight: logits per unit of evidence. relative: the evidence counts in units of the monitor's threshold.

    direct: it hears the damaged rotor itself. One that is not direct is heard only where no direct one is above its
    threshold: a trim tells which rotor is commanded more, and a blade with more drag has the others commanded more.
    """

    weight: float
    relative: bool = False
    direct: bool = True


VOICES: Mapping[str, Voice] = {
    "vibration": Voice(8.0),
    "energy": Voice(8.0),
    "effort": Voice(10.0, relative=True, direct=False),
}


class Outcome(Enum):
    """What came of it, as a sentence."""

    NAMED = "the evidence points at one rotor"
    UNDECIDED = "the evidence fits more than one rotor"
    SILENT = "no monitor that has something to say knows of rotors"


@dataclass(frozen=True, slots=True)
class Witness:
    """One monitor's latest word. ratio: statistic over threshold. rotors: evidence for each; empty if it knows none.

    Raises UsageError if the threshold is not positive.
    """

    monitor: str
    ratio: float
    threshold: float
    rotors: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.threshold > 0:
            raise UsageError(f"{self.monitor}: a threshold must be positive, not {self.threshold}")


@dataclass(frozen=True, slots=True)
class Isolation:
    """rotor: 1, 2, .. if named, else None. confidence: of the likeliest rotor, 1/R..1; 0 if nobody has a say."""

    outcome: Outcome
    rotor: int | None
    confidence: float


def isolate(witnesses: Sequence[Witness], voices: Mapping[str, Voice] = VOICES) -> Isolation:
    """Put the words together.

    >>> shaking = Witness("vibration", ratio=4.0, threshold=0.5, rotors=(0.1, 0.9, -0.4, -0.5))
    >>> idle = Witness("energy", ratio=0.3, threshold=4.0, rotors=(0.4, -0.1, 0.0, 0.0))
    >>> isolate([shaking, idle]).rotor, round(isolate([shaking, idle]).confidence, 3), isolate([idle]).outcome.name
    (2, 0.998, 'SILENT')
    """
    logits: list[float] = []
    heard = any(
        one.ratio > 1 and one.rotors and voices[one.monitor].direct for one in witnesses if one.monitor in voices
    )
    for one in witnesses:
        voice = voices.get(one.monitor)
        if voice is not None and heard and not voice.direct:
            continue
        gate = min(max((one.ratio - SILENT_BELOW) / (1.0 - SILENT_BELOW), 0.0), 1.0)
        if voice is None or not one.rotors or gate == 0.0 or not all(math.isfinite(x) for x in one.rotors):
            continue
        unit = voice.weight * gate / (one.threshold if voice.relative else 1.0)
        before = logits or [0.0] * len(one.rotors)
        logits = [a + unit * b for a, b in zip(before, one.rotors, strict=True)]
    if not logits:
        return Isolation(Outcome.SILENT, None, 0.0)
    highest = max(logits)
    confidence = 1.0 / math.fsum(math.exp(one - highest) for one in logits)
    if confidence < NAME_AT:
        return Isolation(Outcome.UNDECIDED, None, confidence)
    return Isolation(Outcome.NAMED, logits.index(highest) + 1, confidence)
