"""mavsdk, the native library of the MAVLink project, takes the plant for a vehicle."""

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from typing import TypeVar

import pytest
from patience import PATIENCE_S

pytest.importorskip("mavsdk", reason="mavsdk is not installed for this platform")

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.failure import FailureAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.failure import FailureType, FailureUnit
from mavsdk.plugins.mission_raw import MissionItem
from plant_process import flying

from sitl_plant.autopilot.stream import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG

pytestmark = pytest.mark.realtime
T = TypeVar("T")


async def until(stream: AsyncGenerator[T, None], wanted: Callable[[T], bool]) -> T:
    """The first update that is wanted."""
    while True:
        try:
            async with asyncio.timeout(PATIENCE_S):
                async for update in stream:
                    if wanted(update):
                        return update
        finally:
            await stream.aclose()


async def found(mavsdk: Mavsdk, address: str) -> System:
    await mavsdk.add_any_connection(address.replace("udpout:", "udpout://"))
    system = await mavsdk.first_autopilot(PATIENCE_S)
    assert system is not None
    assert await system.get_system_id() == 1
    return system


def ground_station() -> Mavsdk:
    return Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))


METRE_DEG = 1.0 / 111_195.0


async def fly_about(system: System) -> None:
    """Take off, go, fail, fly a mission, come home; an error of mavsdk's ends it."""
    telemetry, action, mission = TelemetryAsync(system), ActionAsync(system), MissionRawAsync(system)
    await action.set_takeoff_altitude(1.5)
    await action.arm()
    await action.takeoff()
    await until(telemetry.subscribe_position(), lambda one: one.relative_altitude_m > 1.3)
    with pytest.raises(ActionError):
        await action.disarm()  # not in flight
    north = HOME_LAT_DEG + 2.0 * METRE_DEG
    await action.goto_location(north, HOME_LON_DEG, HOME_ALT_M + 2.0, 0.0)
    await until(telemetry.subscribe_position(), lambda one: abs(one.latitude_deg - north) < 0.2 * METRE_DEG)
    failure = FailureAsync(system)
    await failure.inject(FailureUnit.SYSTEM_MOTOR, FailureType.SLOW, 2)
    await failure.inject(FailureUnit.SYSTEM_MOTOR, FailureType.OK, 0)
    places = [(round((HOME_LAT_DEG + k * METRE_DEG) * 1e7), round(HOME_LON_DEG * 1e7), 1.5) for k in (2, 1)]
    flat = (0.0, 0.0, 0.0, math.nan)
    await mission.upload_mission([MissionItem(k, 6, 16, k == 0, 1, *flat, *place, 0) for k, place in enumerate(places)])
    assert [item.x for item in await mission.download_mission()] == [place[0] for place in places]
    await mission.start_mission()
    last = places[1][0] * 1e-7
    await until(telemetry.subscribe_position(), lambda one: abs(one.latitude_deg - last) < 0.2 * METRE_DEG)
    await mission.clear_mission()
    await action.return_to_launch()
    await action.land()
    await until(telemetry.subscribe_armed(), lambda armed: not armed)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_mavsdk_flies_it_from_the_ground_to_the_ground(profile: str) -> None:
    async def fly(address: str) -> None:
        async with ground_station() as mavsdk:
            system = await found(mavsdk, address)
            health = await until(TelemetryAsync(system).subscribe_health_all_ok(), bool)
            assert health
            parameters = ParamAsync(system)
            assert len((await parameters.get_all_params()).int_params) > 5
            await parameters.set_param_int("SIM_PROP_FAULT", 1)
            assert await parameters.get_param_int("SIM_PROP_FAULT") == 1
            await parameters.set_param_int("SIM_PROP_FAULT", 0)
            await fly_about(system)

    with flying("--profile", profile, "--trajectory", "commanded") as (address,):
        asyncio.run(fly(address))
