"""A flight by mavsdk 3, for an interpreter that has it: `python mavsdk3_flight.py udpout://HOST:PORT SERVER_PORT`.

mavsdk 3 and 4 cannot be installed side by side. `nox -s clients` makes an environment with the former and runs
`test_clients_mavsdk3.py`, which starts this script. Each line that it prints is a step and what came of it.
"""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib import import_module
from typing import Any

PATIENCE_S = 30.0
LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = 47.397742, 8.545594, 488.0
METRE_DEG = 1.0 / 111_195.0


def say(step: str, result: object) -> None:
    print(json.dumps({"step": step, "result": result}), flush=True)  # noqa: T201


async def until(stream: AsyncIterator[Any], wanted: Callable[[Any], bool]) -> Any:
    """The first update that is wanted."""

    async def search() -> Any:
        async for update in stream:
            if wanted(update):
                return update
        return None

    return await asyncio.wait_for(search(), PATIENCE_S)


async def refusal(call: Awaitable[Any]) -> str:
    """What a call that must fail says."""
    try:
        await call
    except Exception as error:  # noqa: BLE001
        return str(error).split(":", 1)[0]
    return "SUCCESS"


async def main(address: str, server_port: str) -> None:
    sdk = import_module("mavsdk")
    failure = import_module("mavsdk.failure")
    mission = import_module("mavsdk.mission_raw")
    drone = sdk.System(port=int(server_port))
    await drone.connect(system_address=address)
    await until(drone.core.connection_state(), lambda state: state.is_connected)
    say("connected", True)
    health = await until(
        drone.telemetry.health(), lambda one: one.is_global_position_ok and one.is_home_position_ok and one.is_armable
    )
    say("healthy", health.is_local_position_ok)
    say("parameters", len((await drone.param.get_all_params()).int_params) > 0)
    await drone.param.set_param_int("SIM_PROP_FAULT", 1)
    say("parameter", await drone.param.get_param_int("SIM_PROP_FAULT"))
    await drone.action.set_takeoff_altitude(1.5)
    await drone.action.arm()
    await drone.action.takeoff()
    await until(drone.telemetry.position(), lambda one: one.relative_altitude_m > 1.3)
    say("took off", True)
    say("disarmed in flight", await refusal(drone.action.disarm()))
    north = LATITUDE_DEG + 2.0 * METRE_DEG
    await drone.action.goto_location(north, LONGITUDE_DEG, ALTITUDE_M + 2.0, 0.0)
    await until(drone.telemetry.position(), lambda one: abs(one.latitude_deg - north) < 0.2 * METRE_DEG)
    say("went", True)
    await drone.failure.inject(failure.FailureUnit.SYSTEM_MOTOR, failure.FailureType.OFF, 2)
    await drone.failure.inject(failure.FailureUnit.SYSTEM_MOTOR, failure.FailureType.OK, 0)
    say("injected", True)
    flat = (0.0, 0.0, 0.0, float("nan"))
    places = [(round((LATITUDE_DEG + k * METRE_DEG) * 1e7), round(LONGITUDE_DEG * 1e7), 1.5) for k in (2, 1)]
    items = [mission.MissionItem(k, 6, 16, int(k == 0), 1, *flat, *place, 0) for k, place in enumerate(places)]
    await drone.mission_raw.upload_mission(items)
    say("mission", [item.x for item in await drone.mission_raw.download_mission()] == [x for x, _, _ in places])
    await drone.mission_raw.start_mission()
    await until(drone.telemetry.position(), lambda one: abs(one.latitude_deg - places[1][0] * 1e-7) < 0.2 * METRE_DEG)
    await drone.mission_raw.clear_mission()
    say("mission flown", True)
    await drone.action.return_to_launch()
    await drone.action.land()
    await until(drone.telemetry.armed(), lambda armed: not armed)
    say("landed", True)


asyncio.run(main(*sys.argv[1:]))
