"""Windows of a judged log, beside the accounts of the whole flight and the plain definition."""

from dataclasses import replace

import numpy as np
import pytest
from flying_telemetry import flying, without
from made_baselines import logged, whole

from mavdiag.archive.figures import windows_of
from mavdiag.judging import JudgedFlight, LogVerdict, Verdict, judge_in_full

NEW = flying(4000, 5, weak_rotor=3, rise=0.2)


@pytest.fixture(scope="module")
def flight() -> JudgedFlight:
    """Healthy for 20 s, then with a weak rotor for 20 s, after a gap of one second."""
    healthy = without(flying(4000, 5), (20.0, 100.0))
    weak = without(NEW, (0.0, 21.0))
    parts = tuple(
        replace(
            one,
            t_ns=np.concatenate((one.t_ns, two.t_ns)),
            host_ns=np.concatenate((one.host_ns, two.host_ns)),
            values=np.concatenate((one.values, two.values)),
        )
        for one, two in zip(healthy.series, weak.series, strict=True)
    )
    return judge_in_full(logged(replace(healthy, series=parts)), whole())


def test_the_windows_add_up_to_the_accounts_of_the_flight(flight: JudgedFlight) -> None:
    windows = windows_of(flight, 5.0)
    assert [(one.from_s, one.to_s) for one in windows] == [(5.0 * k, 5.0 * k + 5.0) for k in range(9)]
    for monitor in flight.verdict.monitors:
        own = [one for window in windows for one in window.monitors if one.name == monitor.name]
        assert len(own) == len(windows)
        assert sum(one.judged_s for one in own) == pytest.approx(monitor.judged_s, abs=0.5)
        assert monitor.maximum is not None
        highest = max(one.ratio for one in own if one.ratio is not None)
        assert highest == pytest.approx(monitor.maximum / monitor.threshold)
    assert sum(one.judged_s for one in windows) == pytest.approx(flight.verdict.judged_s, abs=0.5)
    decided = [(one.maximum or 0.0) / one.threshold for one in flight.verdict.monitors if one.decides]
    assert max(one.ratio or 0.0 for one in windows) == pytest.approx(max(decided))


def test_no_window_is_made_up_where_nothing_flew() -> None:
    """A gap of 20 s has no windows; a log that could not be judged has none at all."""
    gap = judge_in_full(logged(without(flying(6000, 7), (20.0, 45.0))), whole())
    begins = [one.from_s for one in windows_of(gap, 5.0)]
    assert 30.0 not in begins
    assert {15.0, 50.0} <= set(begins)
    assert windows_of(JudgedFlight(LogVerdict("x", Verdict.NOT_JUDGEABLE, "")), 5.0) == ()
