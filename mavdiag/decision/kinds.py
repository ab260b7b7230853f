"""What kind of fault it is, and which rotor has it: the evidence of all slots, put into one answer or "unknown".

The gravest of what the alarms of the monitors above their thresholds mean holds (`mavdiag.monitors.base.FaultKind`); it
never shrinks while the fault is seen. A propeller fault becomes a sensor fault only within 10 s of its declaration.

    logit_j = sum over monitors of  w_m g_m e_mj,    p = softmax(logit),    named if max p >= 0.9

e_mj: a monitor's evidence for rotor j. w_m: logits that a unit of it is worth (`Monitor.evidence`), chosen on emulated
flights so that a name at p = 0.9 is right in 99 of 100. g_m = 0..1: nothing below half of its threshold, all at it. No
rotor is named of a sensor fault, nor anew while a sensor's check is at 0.85 or above, in an upset (a monitor of the
loss of control or of thrust at half its threshold) or a loss of control. Of a gross loss of thrust the name that was
given stays, else the one that the loss itself shows. Of two trims the one farther above its threshold counts.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from mavdiag.kernel import AT, LOOK_NS, RATIO, READ, READ_ROTORS, Slot
from mavdiag.monitors.base import FaultKind
from mavdiag.units import NS_PER_S

SENSOR_WITHIN_NS = 10 * NS_PER_S  # of a declaration (our choice: the slower half of the sensors' checks takes so long)
# Of the threshold of a monitor of that kind: from there on a rotor's evidence is doubtful (our choice).
DOUBTFUL_FROM = {FaultKind.SENSOR: 0.85, FaultKind.LOSS_OF_CONTROL: 0.5, FaultKind.GROSS_LOSS: 0.5}
NAME_AT = 0.9  # our choice; see the module's text
SILENT_BELOW = 0.5  # of the threshold (our choice)


class Reading(NamedTuple):
    """A slot's latest look that had a valid value: the highest statistic over threshold, the last statistic in it, the
    last evidence for each rotor, or arm that rotors share (empty if the slot has none), and when that was [ns]."""

    slot: Slot
    ratio: float
    value: float = math.nan
    rotors: tuple[float, ...] = ()
    at_ns: float = math.inf

    @classmethod
    def of(cls, slot: Slot, row: Sequence[float]) -> "Reading":
        """From `kernel.RATIO` and its fellows of a slot."""
        arms, rotors = slot.evidence.arms if slot.evidence else (), row[READ_ROTORS:] if slot.monitor.rotors else ()
        by_arm = (max(rotors[rotor - 1] for rotor in arm.members) for arm in arms)
        return cls(slot, row[RATIO], row[READ], tuple(by_arm if arms and rotors else rotors), row[AT] * LOOK_NS)

    def motor(self, place: int) -> int:
        """The rotor, or the arm, whose evidence stands there."""
        return self.slot.evidence.arms[place] if self.slot.evidence and self.slot.evidence.arms else place + 1

    @property
    def unit(self) -> float:
        """Logits that a unit of its evidence is worth; 0 if it tells nothing of rotors."""
        how = self.slot.evidence
        if how is None or not self.rotors or not all(map(math.isfinite, self.rotors)):
            return 0.0
        return how.weight / (max(self.slot.threshold, how.least) if how.relative else 1.0)

    @property
    def direct(self) -> bool:
        """It observes a damaged rotor itself, or tells nothing of rotors."""
        return self.slot.evidence is None or self.slot.evidence.direct


class Isolation(NamedTuple):
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
    worth = [(reading, reading.unit) for reading in readings]
    observed = any(one.ratio > 1 and one.direct and unit and _sure(unit, one.rotors) >= NAME_AT for one, unit in worth)
    trim = max((one.ratio for one, unit in worth if unit and not one.direct), default=0.0)  # that is farthest above
    logits = [0.0] * most
    for reading, unit in worth:
        gate = min(max((reading.ratio - SILENT_BELOW) / (1.0 - SILENT_BELOW), 0.0), 1.0)
        counts = reading.direct or (not observed and reading.ratio == trim)  # one change of trim is not two facts
        if unit * gate and len(reading.rotors) == most and counts:
            logits = [a + unit * gate * b for a, b in zip(logits, reading.rotors, strict=True)]
    if not any(logits):
        return Isolation()
    first, second = sorted(logits, reverse=True)[:2] if most > 1 else (logits[0], logits[0])
    sure, whose = _sure(1.0, logits), next(reading for reading in readings if len(reading.rotors) == most)
    return Isolation(whose.motor(logits.index(first)) if sure >= NAME_AT else None, sure, first - second)


def _sure(unit: float, evidence: Sequence[float]) -> float:
    highest = max(evidence)
    return 1.0 / math.fsum(math.exp(unit * (x - highest)) for x in evidence)


def grown(kind: FaultKind | None, readings: Sequence[Reading], lasted_ns: int) -> FaultKind:
    """The kind after these readings. kind: until now, None if the fault is new; lasted_ns: since its declaration."""
    over = [reading.slot.monitor.kind for reading in readings if reading.slot.decides and reading.ratio > 1.0]
    if kind is FaultKind.PROPELLER and lasted_ns > SENSOR_WITHIN_NS:
        over = [one for one in over if one is not FaultKind.SENSOR]
    return max((kind or FaultKind.PROPELLER, *over), key=lambda one: one.rank)


def named(kind: FaultKind, readings: Sequence[Reading], has_name: bool) -> Isolation:
    """Which rotor the evidence of this moment names, if any may be named. has_name: a rotor was named before."""
    lost = kind is FaultKind.GROSS_LOSS and not has_name
    doubtful = any(one.ratio >= DOUBTFUL_FROM.get(one.slot.monitor.kind, math.inf) for one in readings)
    if not lost and (kind is not FaultKind.PROPELLER or doubtful):
        return Isolation()
    return isolate([one for one in readings if one.slot.monitor.kind is kind and one.slot.evidence is not None])
