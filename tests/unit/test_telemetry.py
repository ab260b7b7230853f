"""What a user takes out of telemetry and logs by name."""

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavdiag.errors import InputError, UsageError
from mavdiag.telemetry import Log, Series, Signal, Telemetry

T_NS = np.array([1_000_000_000, 1_500_000_000], dtype=np.int64)
RATE = Series(Signal.BODY_RATE, T_NS, T_NS, np.arange(6.0).reshape(2, 3))
OUTPUTS = Series(Signal.ACTUATOR, T_NS, T_NS, np.zeros((2, 4)))
LOG = Log("flight.bin", "00", "ardupilot-log", Telemetry((RATE, OUTPUTS)))


@pytest.mark.parametrize("name", ["body_rate", Signal.BODY_RATE])
def test_a_series_by_its_name(name: str) -> None:
    assert LOG[name] is LOG.telemetry[name] is RATE
    assert RATE.t_s.tolist() == [1.0, 1.5]
    assert (RATE.unit, RATE.columns) == ("rad/s", ("p", "q", "r"))
    assert (OUTPUTS.unit, OUTPUTS.columns) == ("", ("1", "2", "3", "4"))
    assert (LOG.started_ns, LOG.notes) == (0, ())
    assert list(LOG.telemetry) == [RATE, OUTPUTS]


@pytest.mark.parametrize(
    ("name", "words"),
    [("voltage", "no voltage in the data; there is body_rate, actuator"), ("gyro", "no signal is named 'gyro'")],
)
def test_what_is_not_there_says_what_is(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        LOG[name]


def test_each_signal_has_a_unit_and_columns() -> None:
    for signal in Signal:
        series = Series(signal, T_NS[:0], T_NS[:0], np.empty((0, 1)))
        assert isinstance(series.unit, str)
        assert len(series.columns) in (1, 3)


def test_values_print_in_one_short_line() -> None:
    assert repr(RATE) == "<Series body_rate: 2 x 3 [rad/s] in 0.500 s>"
    assert repr(LOG.telemetry) == "<Telemetry: body_rate (2), actuator (2)>"
    assert repr(LOG) == "<Log flight.bin: profile ardupilot-log, 2 signals>"
    assert repr(Telemetry()) == "<Telemetry: empty>"


def test_a_frame_needs_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(UsageError, match="pip install pandas"):
        RATE.to_frame()
    made = SimpleNamespace(Index=lambda values, name: (name, values.tolist()), DataFrame=lambda *a, **k: (a, k))
    monkeypatch.setattr(importlib, "import_module", lambda name: made)
    (values,), named = RATE.to_frame()
    assert values is RATE.values
    assert named == {"index": ("t_s", [1.0, 1.5]), "columns": ["p", "q", "r"]}
