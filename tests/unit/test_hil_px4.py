"""PX4's simulator messages by their bytes: what is sent, how often, and what the controls do."""

from collections import Counter
from itertools import chain

import numpy as np
import pytest
from hil_bytes import controls_bytes, frames_in

from mavdiag.link.codec import Decoder
from sitl_plant.hil.px4 import WANTED, Bridge
from sitl_plant.hil.simulation import Simulation, output_map
from sitl_plant.plant import PlantConfig

RATE_HZ = 250


def bridge() -> Bridge:
    simulation = Simulation(PlantConfig(seed=3))
    return Bridge(simulation, output_map(simulation.config.vehicle, "px4"), RATE_HZ)


def hear(link: Bridge, data: bytes) -> None:
    for frame in Decoder(WANTED).feed(data, 0):
        link.hear(frame)


def sent(link: Bridge, periods: int) -> list[tuple[int, tuple[float, ...]]]:
    return [
        (msgid, values)
        for message in chain.from_iterable(link.advance() for _ in range(periods))
        for msgid, values, _ in frames_in(message)
    ]


def of(messages: list[tuple[int, tuple[float, ...]]], msgid: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([values for one, values in messages if one == msgid])


def test_messages_come_at_their_rates() -> None:
    counts = Counter(msgid for msgid, _ in sent(bridge(), 10 * RATE_HZ))
    within = {107: 0, 113: 2, 115: 10, 0: 1}
    assert counts == {
        msgid: pytest.approx(10 * rate_hz, abs=within[msgid])
        for msgid, rate_hz in {107: RATE_HZ, 113: 10, 115: 50, 0: 1}.items()
    }


def test_the_sensors_of_a_vehicle_at_rest() -> None:
    """Gravity, the field of Zurich in body axes, and the pressure at 488 m by the standard atmosphere."""
    rows = of(sent(bridge(), 4 * RATE_HZ), 107)
    np.testing.assert_array_equal(np.diff(rows[:, 0]), 4000)
    np.testing.assert_allclose(rows[:, 1:4].mean(axis=0), [0.0, 0.0, -9.81], atol=0.02)
    np.testing.assert_allclose(rows[:, 4:7].mean(axis=0), 0.0, atol=0.004)
    updated = rows[:, 14].astype(int)
    assert np.all(updated & 0b111_111 == 0b111_111)
    compass, baro = updated & 0b111_000_000 != 0, updated & 0b1_000_000_000 != 0
    assert set(updated[baro] & 0b1_101_000_000_000) == {0b1_101_000_000_000}
    assert compass.sum() == pytest.approx(200, abs=4)
    assert baro.sum() == pytest.approx(80, abs=2)
    np.testing.assert_allclose(rows[compass, 7:10].mean(axis=0), [0.21523, 0.00771, 0.42741], atol=0.002)
    assert rows[baro, 10].mean() == pytest.approx(1013.25 * (1 - 0.0065 * 488 / 288.15) ** 5.2559, abs=0.1)
    assert len(np.unique(rows[compass, 7])) > 100, "a reading that stands still is a broken sensor to PX4"


def test_controls_turn_the_motors_only_if_armed() -> None:
    link = bridge()
    hear(link, controls_bytes(0, [0.62] * 4, armed=False))
    sent(link, 100)
    assert link.simulation.now.rotor_speed.max() < 1.0
    hear(link, controls_bytes(0, [0.62] * 4))
    assert (link.answered, link.lockstep, link.controls) == (True, True, 2)
    rows = of(sent(link, 100), 115)
    assert not link.answered
    assert rows[-1][13] < -20, "climbs, in cm/s down"
    assert rows[-1][10] > 488_010
