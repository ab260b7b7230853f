"""What is held of a vehicle in flight, told to a person: the rotor is named, and no more is blamed than is known."""

import math
import re
from dataclasses import replace

import pytest

from mavdiag.decision.diagnosis import Diagnosis, RotorSpan, Stage
from mavdiag.decision.words import held_advice, held_sentence
from mavdiag.monitors.base import FaultKind

PROPELLER = Diagnosis(monitor="rotor_trim", statistic=0.066, threshold=0.02, kind=FaultKind.PROPELLER)
CRACK = replace(PROPELLER, rotor=3, fault_type="F2", severity=2, seen=True, rotors=(RotorSpan(3, 0),))
SENSOR = Diagnosis(Stage.FAULT, kind=FaultKind.SENSOR, statistic=math.inf, threshold=1.0)


@pytest.mark.parametrize(
    ("held", "words", "advice"),
    [
        (Diagnosis(), "", ""),
        (replace(PROPELLER, stage=Stage.QUIET), "", ""),
        (replace(CRACK, stage=Stage.FAULT), "motor 3 .*crack .*3.3 times its threshold", "Land, .*motor 3 first"),
        (SENSOR, "sensor fault .*does not mean that it is gone", "no propeller is blamed"),
        (Diagnosis(Stage.FAULT, kind=FaultKind.GROSS_LOSS, seen=True, rotor=2), "thrust at motor 2", "motors, contr"),
        (replace(PROPELLER, stage=Stage.SUSPECTED), "suspected, not declared, rotor unknown", "before the next flight"),
        (Diagnosis(Stage.INSPECT, rotor=3, rotors=(RotorSpan(3, 0),)), "earlier flight .motor 3", "motor 3 first"),
    ],
)
def test_what_is_held_and_what_to_do(held: Diagnosis, words: str, advice: str) -> None:
    for said, wanted in ((held_sentence(held), words), (held_advice(held), advice)):
        assert re.search(wanted, said)
        assert bool(said) == bool(wanted)
