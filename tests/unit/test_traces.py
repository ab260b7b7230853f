"""What figures are drawn from: the same numbers as the verdict rests on, and the model's own simulation."""

import numpy as np
from made_baselines import logged, thesis
from made_telemetry import flight
from scipy.signal import lfilter

from mavdiag.judging import judge_in_full
from mavdiag.monitors.run_length import RunLength
from mavdiag.telemetry import Axis
from mavdiag.traces import rate_traces


def test_the_traces_hold_the_highest_statistic_of_the_verdict() -> None:
    push = np.zeros(10_000)
    push[5000:5600] = 0.3
    judged = judge_in_full(logged(flight(10_000, 50, push=push), "qdrone2"), thesis())
    assert judged.chain is not None
    roll = next(one for one in rate_traces(judged.chain, judged.pieces) if one.axis is Axis.ROLL)
    assert roll.fsd_s[roll.judged].max() == judged.verdict.monitors[0].maximum
    assert roll.fml_s == judged.verdict.monitors[0].threshold
    assert (roll.fsd_s > 0).sum() == (roll.judged & (np.abs(roll.residual) > roll.margin_rad_s)).sum()


def test_the_simulated_rate_is_the_models_output_to_the_commanded_rate_alone() -> None:
    judged = judge_in_full(logged(flight(6000, 4), "qdrone2"), thesis())
    assert judged.chain is not None
    (trace, _) = rate_traces(judged.chain, judged.pieces)
    (slot, _) = judged.chain.slots
    assert isinstance(slot.monitor, RunLength)
    model = slot.monitor.spec.model.model()
    free = lfilter(model.b, model.a, trace.commanded)
    settled = len(free) // 2  # what the start gets wrong has died out
    np.testing.assert_allclose(trace.simulated[settled:], free[settled:], atol=2e-3)
