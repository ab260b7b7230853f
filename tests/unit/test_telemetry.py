"""What a user takes out of telemetry and logs by name."""

import numpy as np
import pytest

from mavdiag.errors import InputError
from mavdiag.telemetry import Log, Series, Signal, Telemetry

T_NS = np.array([1_000_000_000, 1_500_000_000], dtype=np.int64)
RATE = Series(Signal.BODY_RATE, T_NS, T_NS, np.arange(6.0).reshape(2, 3))
OUTPUTS = Series(Signal.ACTUATOR, T_NS, T_NS, np.zeros((2, 4)))
LOG = Log("flight.bin", "00", "ardupilot-log", Telemetry((RATE, OUTPUTS)))


@pytest.mark.parametrize("name", ["body_rate", Signal.BODY_RATE])
def test_a_series_by_its_name(name: str) -> None:
    assert LOG[name] is LOG.telemetry[name] is RATE
    assert RATE.t_s.tolist() == [1.0, 1.5]
    assert (RATE.unit, OUTPUTS.unit) == ("rad/s", "")
    assert list(LOG.telemetry) == [RATE, OUTPUTS]


@pytest.mark.parametrize(
    ("name", "words"),
    [("voltage", "no voltage in the data; there is body_rate, actuator"), ("gyro", "no signal is named 'gyro'")],
)
def test_what_is_not_there_says_what_is(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        LOG[name]
