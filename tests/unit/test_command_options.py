"""Options of the commands: what is refused, in which words, and what a log's signals look like to `inspect`."""

import numpy as np
import pytest

from mavdiag.look.inspection import summary
from mavdiag.telemetry import Series, Signal
from mavdiag.units import NS_PER_S


def test_r8_the_rate_is_the_mean_rate_and_not_that_of_the_median_step() -> None:
    kept = np.arange(1000) % 4 != 0  # a logger at 250 Hz that drops every fourth sample
    t_ns = (np.arange(1000, dtype=np.int64) * NS_PER_S // 250)[kept]
    found = summary(Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((len(t_ns), 3))))
    assert found.rate_hz == pytest.approx(187.5, rel=0.01)
    one = summary(Series(Signal.BODY_RATE, t_ns[:1], t_ns[:1], np.zeros((1, 3))))
    assert (one.rate_hz, one.jitter_ms, one.longest_gap_s) == (None, None, None)
