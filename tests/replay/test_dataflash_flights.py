"""The DataFlash reader on recorded flights, against pymavlink's own reader as the oracle."""

from collections import defaultdict
from collections.abc import Collection, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared

from mavdiag.logs.dataflash import Walk, read_dataflash
from mavdiag.logs.log import Table
from mavdiag.telemetry import FloatArray, Signal, Telemetry

REAL = "data/ardupilot_real/log171.bin"  # Copter 3.3-dev, 2015
SIMULATED = "data/arducopter_sitl/jsonplant_flight.bin"  # Copter 4.5.6
CHECKED = {
    REAL: ("IMU", "ATT", "RATE", "RCOU", "CTUN", "CURR", "BARO", "GPS", "EV"),
    SIMULATED: ("IMU", "ATT", "RATE", "RCOU", "CTUN", "POS", "BARO", "VIBE", "BAT", "ARM", "EV", "GPS"),
}
INSTANCE = {"IMU": "I", "BARO": "I", "VIBE": "IMU", "BAT": "Inst", "GPS": "I"}


@cache
def oracle(path: Path, wanted: Collection[str]) -> dict[str, dict[str, FloatArray]]:
    """Every numeric column of these messages, first instances only, as pymavlink reads them."""
    reader = import_module("pymavlink.DFReader").DFReader_binary(str(path), zero_time_base=False)
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    while (message := reader.recv_match(type=list(wanted))) is not None:
        name = message.get_type()
        fields = message.to_dict()
        if fields.get(INSTANCE.get(name, ""), 0) == 0:
            rows[name].append({k: v for k, v in fields.items() if isinstance(v, int | float)})
    reader.close()
    return {name: {k: np.array([row[k] for row in all_rows]) for k in all_rows[0]} for name, all_rows in rows.items()}


@cache
def tables(path: Path, wanted: Collection[str]) -> Mapping[str, Table]:
    walk = Walk(wanted)
    walk.feed(path.read_bytes())
    return walk.finish()[0]


@pytest.mark.parametrize(("file", "name"), [(file, name) for file, names in CHECKED.items() for name in names])
def test_counts_and_values_are_those_of_pymavlink(file: str, name: str) -> None:
    path = shared(file)
    expected = oracle(path, CHECKED[file])[name]
    table = tables(path, CHECKED[file])[name]
    assert len(table.starts) == len(next(iter(expected.values())))
    for label, values in expected.items():
        np.testing.assert_allclose(table.column(label), values, rtol=1e-12, atol=1e-12, err_msg=label)


@cache
def real() -> Telemetry:
    return read_dataflash(shared(REAL)).telemetry


def test_the_upset_of_the_real_flight_is_where_it_was() -> None:
    attitude = real().need(Signal.ATTITUDE)
    over = np.abs(attitude.values[:, 0]) > np.radians(100)
    assert float(attitude.t_ns[over][0]) * 1e-9 == pytest.approx(240, abs=3)
    armed = real().need(Signal.ARMED)
    assert (armed.t_ns * 1e-9).tolist() == pytest.approx([72.6], abs=0.1)
