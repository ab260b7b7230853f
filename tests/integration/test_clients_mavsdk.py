"""mavsdk, the native library of the MAVLink project, takes the plant for a vehicle."""

import asyncio
import math
from collections.abc import AsyncGenerator
from typing import TypeVar

import pytest

pytest.importorskip("mavsdk", reason="mavsdk is not installed for this platform")

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from plant_process import ALERT, companion, flying

pytestmark = pytest.mark.realtime
T = TypeVar("T")
PATIENCE_S = 20.0


async def take(stream: AsyncGenerator[T, None], n: int) -> list[T]:
    """The first n updates of a subscription."""

    async def collect() -> list[T]:
        updates: list[T] = []
        async for update in stream:
            updates.append(update)
            if len(updates) == n:
                break
        return updates

    try:
        return await asyncio.wait_for(collect(), PATIENCE_S)
    finally:
        await stream.aclose()


async def connected(mavsdk: Mavsdk, address: str) -> TelemetryAsync:
    await mavsdk.add_any_connection(address.replace("udpout:", "udpout://"))
    system = await mavsdk.first_autopilot(PATIENCE_S)
    assert system is not None
    assert await system.get_system_id() == 1
    return TelemetryAsync(system)


def ground_station() -> Mavsdk:
    return Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))


@pytest.mark.parametrize("profile", ["qdrone2", "px4"])
def test_mavsdk_receives_imu_and_attitude(profile: str) -> None:
    async def listen(address: str) -> None:
        async with ground_station() as mavsdk:
            telemetry = await connected(mavsdk, address)
            imu = await take(telemetry.subscribe_imu(), 50)
            down = [reading.acceleration_frd.down_m_s2 for reading in imu]
            assert sum(down) / len(down) == pytest.approx(-9.81, abs=0.5)
            assert all(abs(reading.angular_velocity_frd.forward_rad_s) < 5.0 for reading in imu)
            attitude = await take(telemetry.subscribe_attitude_euler(), 10)
            assert all(abs(math.radians(angle.roll_deg)) < 0.5 for angle in attitude)
            assert await take(telemetry.subscribe_armed(), 1) == [True]
            assert await take(telemetry.subscribe_in_air(), 1) == [True]

    with flying("--profile", profile) as (address,):
        asyncio.run(listen(address))


def test_mavsdk_sets_a_rate_and_gets_it() -> None:
    async def ask(address: str) -> float:
        async with ground_station() as mavsdk:
            telemetry = await connected(mavsdk, address)
            await telemetry.set_rate_imu(20.0)
            await take(telemetry.subscribe_imu(), 5)
            stamps = [reading.timestamp_us for reading in await take(telemetry.subscribe_imu(), 21)]
            return 20 / ((stamps[-1] - stamps[0]) * 1e-6)

    with flying() as (address,):
        assert asyncio.run(ask(address)) == pytest.approx(20.0, rel=0.05)


def test_mavsdk_hears_the_alert_of_a_companion() -> None:
    async def hear(address: str, companion_address: str) -> str:
        async with ground_station() as mavsdk:
            telemetry = await connected(mavsdk, address)
            texts = telemetry.subscribe_status_text()
            with companion(companion_address) as alerter:
                waiting = asyncio.create_task(take(texts, 1))
                while not waiting.done():
                    alerter.alert()
                    await asyncio.sleep(0.2)
            return waiting.result()[0].text

    with flying(links=2) as (address, companion_address):
        assert asyncio.run(hear(address, companion_address)) == ALERT
