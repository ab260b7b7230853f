"""What kind of fault it is, and whether a rotor may be named.

The kind follows from the monitors above their thresholds: the gravest of what their alarms mean holds, in the order
propeller fault, sensor fault, loss of control, gross loss of thrust (`mavdiag.monitors.base.FaultKind`). It may grow
while a fault lasts, and never shrinks. A propeller fault becomes a sensor fault only within 10 s of its declaration,
because what a sensor does to the propeller monitors shows before the slow checks of the sensors have spoken.

A rotor is named while that is certain, and only then:

    a sensor is at fault                   no rotor, and a name that was given is withdrawn
    a sensor's check is at 0.85 or above    no new name: what the propeller monitors see may be the sensor
    an upset, or the loss of control       no new name: the one that was given before it is kept
    a gross loss of thrust                 the name that was given, else the one that the loss itself shows

An upset begins where a monitor of the loss of control, or of thrust, is at half its threshold: this is its only
measure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mavdiag.decision.isolation import Isolation, RotorReading, isolate
from mavdiag.monitors.base import FaultKind, RotorEvidence
from mavdiag.units import NS_PER_S

__all__ = ["KindReading", "grown", "named", "upset"]

SENSOR_WITHIN_NS = 10 * NS_PER_S  # of a declaration (our choice: the slower half of the sensors' checks takes so long)
DOUBTFUL_FROM = 0.85  # of a sensor monitor's threshold: what counts as not calm (our choice)
UPSET_FROM = 0.5  # of the threshold of a loss (our choice)
NOBODY = Isolation(None, 0.0)
LOSSES = (FaultKind.LOSS_OF_CONTROL, FaultKind.GROSS_LOSS)


@dataclass(frozen=True, slots=True)
class KindReading:
    """One slot's latest reading.

    kind: what its alarm means.
    decides: its alarm is a fault by itself.
    ratio: statistic over threshold.
    evidence, threshold, rotors: as in `RotorReading`; evidence is None if it knows nothing of rotors.
    """

    kind: FaultKind
    decides: bool
    ratio: float
    threshold: float
    evidence: RotorEvidence | None = None
    rotors: tuple[float, ...] = ()


def upset(readings: Sequence[KindReading]) -> bool:
    """Whether the vehicle is on its way out of control."""
    return any(one.kind in LOSSES and one.ratio >= UPSET_FROM for one in readings)


def grown(kind: FaultKind | None, readings: Sequence[KindReading], lasted_ns: int) -> FaultKind:
    """The kind after these readings. kind: until now, None if the fault is new; lasted_ns: since its declaration.

    >>> weak, lying = (KindReading(one, True, 1.5, 1.0) for one in (FaultKind.PROPELLER, FaultKind.SENSOR))
    >>> print(grown(None, [weak], 0), grown(FaultKind.PROPELLER, [weak, lying], NS_PER_S), sep=", ")
    propeller fault, sensor fault
    """
    over = [one.kind for one in readings if one.decides and one.ratio > 1.0]
    held = kind or FaultKind.PROPELLER
    if kind is FaultKind.PROPELLER and lasted_ns > SENSOR_WITHIN_NS:
        over = [one for one in over if one is not FaultKind.SENSOR]
    return max((held, *over), key=lambda one: one.rank)


def named(kind: FaultKind, readings: Sequence[KindReading], has_name: bool) -> Isolation:
    """Which rotor the evidence of this moment names, if any may be named; see the module's text.

    has_name: a rotor was named before.
    """
    if kind is FaultKind.GROSS_LOSS and not has_name:
        return _isolated(FaultKind.GROSS_LOSS, readings)
    doubtful = any(one.kind is FaultKind.SENSOR and one.ratio >= DOUBTFUL_FROM for one in readings)
    if kind is not FaultKind.PROPELLER or doubtful or upset(readings):
        return NOBODY
    return _isolated(FaultKind.PROPELLER, readings)


def _isolated(kind: FaultKind, readings: Sequence[KindReading]) -> Isolation:
    return isolate(
        [
            RotorReading(one.evidence, one.ratio, one.threshold, one.rotors)
            for one in readings
            if one.kind is kind and one.evidence is not None
        ]
    )
