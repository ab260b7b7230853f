"""The unbalance monitor on the emulated vehicle, taught by healthy flights of the same airframe alone."""

import numpy as np
import pytest

from mavdiag.airframe.airframe import Airframe
from mavdiag.airframe.layout import layout_named
from mavdiag.monitors.base import LearnContext
from mavdiag.monitors.unbalance import Unbalance
from mavdiag.rows.align import AlignSpec, Grid
from mavdiag.rows.front import Front, Rows
from mavdiag.rows.gate import GateSpec
from mavdiag.rows.rates import RateSpec
from sitl_plant.autopilot.telemetry import flight_telemetry
from sitl_plant.plant import PlantConfig

FRONT = Front(AlignSpec(0.001, Grid.NATIVE), GateSpec(min_thrust=0.1), RateSpec.of(0.001, 101))
QDRONE2 = Airframe(layout=layout_named("qdrone2"), mass_kg=1.504, hover_rad_s=1047.2)


def fly(seed: int, fault: str | None = None, rotor: int = 1, seconds: float = 16.0) -> list[Rows]:
    config = PlantConfig(drone=1, seed=seed, fault=fault, rotor=rotor, wind_m_s=0.5)
    state, rows = FRONT.step(FRONT.start(), flight_telemetry(config, seconds)[0])
    return [one for one in (*rows, *FRONT.finish(state)[1]) if isinstance(one, Rows)]


def test_the_estimated_unbalance_is_that_of_the_table_and_placed() -> None:
    monitor = Unbalance(*Unbalance.fit([fly(11), fly(12)], LearnContext(QDRONE2, None, 0.001, 101)))
    found = [(one.level[one.valid], one.rotors[one.valid]) for one in monitor.over(fly(51, "F3/SV1", 2, seconds=6.0))]
    level, rotors = (np.concatenate(columns) for columns in zip(*found, strict=True))
    assert float(level.mean()) == pytest.approx(3.77, rel=0.15)  # T Table 3.2; own unbalance adds
    assert int(rotors.sum(axis=0).argmax()) + 1 == 2
