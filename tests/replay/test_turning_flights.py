"""An autopilot in the loop: its own healthy flight teaches, and the damaged motor is named."""

from dataclasses import replace

import pytest
from shared_data import shared

import mavdiag as md
from mavdiag.judging import Verdict
from mavdiag.learning import LearnOptions, learn
from mavdiag.logs import between
from mavdiag.telemetry import Signal

STAMP = "1970-01-01T00:00:00+00:00"


@pytest.mark.parametrize("autopilot", ["ap463", "px4"])
def test_an_autopilot_in_the_loop_names_the_damaged_motor_and_is_silent_in_health(autopilot: str) -> None:
    """Each half of the healthy flight teaches, the other half and the flight with F2/SV2 on motor 4 are judged."""
    folder = shared("data/autopilots_in_the_loop")
    healthy, faulty = (md.read_log(folder / f"{autopilot}_hil_{name}.tlog") for name in ("healthy", "F2SV2_rotor1"))
    times_s = healthy.telemetry.need(Signal.BODY_RATE).t_s
    edges = (None, float(times_s[0] + times_s[-1]) / 2, None)
    halves = [replace(healthy, telemetry=between(healthy.telemetry, *edges[k : k + 2])) for k in range(2)]
    for taught, other in (halves, halves[::-1]):
        base = learn([taught], LearnOptions(), created=STAMP)
        assert {"rotor_trim", "trim_step"} <= {one.spec.kind for one in base.monitors}
        assert md.judge(other, base).verdict is not Verdict.FAULT
        verdict = md.judge(faulty, base)
        assert verdict.verdict is Verdict.FAULT
        assert {one.rotor for one in verdict.changes if one.rotor} == {4}
