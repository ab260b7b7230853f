"""What kind of fault it is, and which rotor has it: the evidence of all slots, put into one answer or "unknown".

The kind follows from the monitors above their thresholds: the gravest of what their alarms mean holds, in the order
propeller fault, sensor fault, loss of control, gross loss of thrust (`mavdiag.monitors.base.FaultKind`). It may grow
while a fault lasts, and never shrinks. A propeller fault becomes a sensor fault only within 10 s of its declaration,
because what a sensor does to the propeller monitors shows before the slow checks of the sensors have spoken.

    logit_j = sum over monitors of  w_m g_m e_mj,    p = softmax(logit),    named if max p >= 0.9

e_mj: a monitor's evidence for rotor j, as its statistic gives it. w_m: how many logits a unit of it is worth; each
monitor states it (`Monitor.evidence`), chosen on emulated flights so that a name at p = 0.9 is right in 99 of 100.
g_m = 0..1: a monitor counts for nothing below half of its threshold and in full at it, so that the noise of one that
finds nothing cannot outweigh one that does. A rotor is named while that is certain, and only then:

    a sensor is at fault                   no rotor, and a name that was given is withdrawn
    a sensor's check is at 0.85 or above    no new name: what the propeller monitors see may be the sensor
    an upset, or the loss of control       no new name: the one that was given before it is kept
    a gross loss of thrust                 the name that was given, else the one that the loss itself shows

An upset begins where a monitor of the loss of control, or of thrust, is at half its threshold: this is its only
measure.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavdiag.kernel import Slot
from mavdiag.monitors.base import FaultKind
from mavdiag.units import NS_PER_S

SENSOR_WITHIN_NS = 10 * NS_PER_S  # of a declaration (our choice: the slower half of the sensors' checks takes so long)
DOUBTFUL_FROM = 0.85  # of a sensor monitor's threshold: what counts as not calm (our choice)
UPSET_FROM = 0.5  # of the threshold of a loss (our choice)
NAME_AT = 0.9  # our choice; see the module's text
SILENT_BELOW = 0.5  # of the threshold (our choice)
LOSSES = (FaultKind.LOSS_OF_CONTROL, FaultKind.GROSS_LOSS)


@dataclass(frozen=True, slots=True)
class Reading:
    """A slot's latest look that had a valid value.

    ratio: highest statistic over threshold in the look. value: the last statistic in it.
    rotors: the last evidence for each rotor; empty if the slot has none.
    """

    slot: Slot
    ratio: float
    value: float = math.nan
    rotors: tuple[float, ...] = ()

    @property
    def unit(self) -> float:
        """Logits that a unit of its evidence is worth; 0 if it tells nothing of rotors."""
        how, known = self.slot.evidence, self.rotors and all(math.isfinite(x) for x in self.rotors)
        if how is None or not known:
            return 0.0
        return how.weight / (self.slot.threshold if how.relative else 1.0)

    @property
    def direct(self) -> bool:
        """It observes a damaged rotor itself, or tells nothing of rotors."""
        return self.slot.evidence is None or self.slot.evidence.direct


@dataclass(frozen=True, slots=True)
class Isolation:
    """Which rotor it is.

    rotor: from 1; None if the evidence fits more than one, or if there is none.
    confidence: of the likeliest rotor, 1/R..1; 0 without evidence.
    lead: logits by which it leads the next; it tells names apart whose confidence is near 1.
    """

    rotor: int | None = None
    confidence: float = 0.0
    lead: float = 0.0


def isolate(readings: Sequence[Reading]) -> Isolation:
    """Put the evidence together. Evidence on fewer rotors than the most is of another layout, and does not count."""
    most = max((len(reading.rotors) for reading in readings), default=0)
    observed = any(reading.ratio > 1 and reading.direct and _sure(reading) for reading in readings)
    logits = [0.0] * most
    for reading in readings:
        gate = min(max((reading.ratio - SILENT_BELOW) / (1.0 - SILENT_BELOW), 0.0), 1.0)
        unit = reading.unit * gate if len(reading.rotors) == most and (reading.direct or not observed) else 0.0
        if unit:
            logits = [a + unit * b for a, b in zip(logits, reading.rotors, strict=True)]
    if not any(logits):
        return Isolation()
    highest = max(logits)
    confidence = 1.0 / math.fsum(math.exp(one - highest) for one in logits)
    lead = highest - sorted(logits)[-2] if len(logits) > 1 else 0.0
    return Isolation(logits.index(highest) + 1 if confidence >= NAME_AT else None, confidence, lead)


def _sure(reading: Reading) -> bool:
    """Whether a monitor names a rotor by itself."""
    unit, highest = reading.unit, max(reading.rotors, default=0.0)
    return unit > 0 and math.fsum(math.exp(unit * (x - highest)) for x in reading.rotors) <= 1.0 / NAME_AT


def upset(readings: Sequence[Reading]) -> bool:
    """Whether the vehicle is on its way out of control."""
    return any(reading.slot.monitor.kind in LOSSES and reading.ratio >= UPSET_FROM for reading in readings)


def grown(kind: FaultKind | None, readings: Sequence[Reading], lasted_ns: int) -> FaultKind:
    """The kind after these readings. kind: until now, None if the fault is new; lasted_ns: since its declaration."""
    over = [reading.slot.monitor.kind for reading in readings if reading.slot.decides and reading.ratio > 1.0]
    if kind is FaultKind.PROPELLER and lasted_ns > SENSOR_WITHIN_NS:
        over = [one for one in over if one is not FaultKind.SENSOR]
    return max((kind or FaultKind.PROPELLER, *over), key=lambda one: one.rank)


def named(kind: FaultKind, readings: Sequence[Reading], has_name: bool) -> Isolation:
    """Which rotor the evidence of this moment names, if any may be named. has_name: a rotor was named before."""
    lost = kind is FaultKind.GROSS_LOSS and not has_name
    doubtful = any(one.slot.monitor.kind is FaultKind.SENSOR and one.ratio >= DOUBTFUL_FROM for one in readings)
    if not lost and (kind is not FaultKind.PROPELLER or doubtful or upset(readings)):
        return Isolation()
    return isolate([one for one in readings if one.slot.monitor.kind is kind and one.slot.evidence is not None])
