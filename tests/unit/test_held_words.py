"""What is held of a vehicle in flight, as sentences for a person."""

import math
from dataclasses import replace

import pytest

from mavdiag.decision.diagnosis import Diagnosis, RotorSpan, Stage
from mavdiag.decision.words import held_advice, held_sentence
from mavdiag.monitors.base import FaultKind

EVIDENCE = Diagnosis(monitor="rotor_trim", statistic=0.066, threshold=0.02, kind=FaultKind.PROPELLER)
CRACK = replace(EVIDENCE, rotor=3, fault_type="F2", severity=2, seen=True, rotors=(RotorSpan(3, 0),))


@pytest.mark.parametrize(
    ("held", "sentence", "advice"),
    [
        (Diagnosis(), "", ""),
        (replace(EVIDENCE, stage=Stage.QUIET), "", ""),
        (
            replace(CRACK, stage=Stage.FAULT),
            "A propeller fault of motor 3 was found, most like a crack (F2, severity 2 of 3): one rotor commanded more "
            "than in health, 3.3 times its threshold.",
            "Land, then look at the propeller of motor 3 first, then the others: nicks, cracks, a bent blade, a loose "
            "propeller.",
        ),
        (
            Diagnosis(Stage.FAULT, kind=FaultKind.SENSOR, statistic=math.inf, threshold=1.0),
            "A sensor fault was found. It is not seen at this moment, which does not mean that it is gone.",
            "Land, then check the inertial sensor and its mount; no propeller is blamed.",
        ),
        (
            Diagnosis(Stage.FAULT, kind=FaultKind.GROSS_LOSS, seen=True, rotor=2),
            "A gross loss of thrust at motor 2 was found.",
            "Land, then look at motors, controllers, propellers and their wiring.",
        ),
        (
            replace(EVIDENCE, stage=Stage.SUSPECTED),
            "A propeller fault is suspected, not declared, rotor unknown: one rotor commanded more than in health, 3.3 "
            "times its threshold.",
            "Look at the propellers before the next flight; it may also be a manoeuvre that was not learnt.",
        ),
        (
            Diagnosis(Stage.INSPECT, rotor=3, rotors=(RotorSpan(3, 0),)),
            "A fault was found in an earlier flight (motor 3), and nobody has said yet that it was looked at.",
            "Before the next flight, look at the propeller of motor 3 first, then the others: nicks, cracks, a bent "
            "blade, a loose propeller.",
        ),
    ],
)
def test_what_is_held_and_what_to_do(held: Diagnosis, sentence: str, advice: str) -> None:
    assert (held_sentence(held), held_advice(held)) == (sentence, advice)
