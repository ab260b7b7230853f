"""Programs of others take the plant for a vehicle and the detector for its component: mavsdk and MAVProxy."""

import asyncio
import math
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.failure import FailureAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.failure import FailureType, FailureUnit
from mavsdk.plugins.mission_raw import MissionItem
from mavsdk.plugins.param import ParamError, ProtocolVersion
from processes import ALERT, PATIENCE_S, companion, flying, process, running

from detector.component import PARAMETERS
from mavdiag.link.messages import Component
from sitl_plant.autopilot.stream import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG

pytestmark = pytest.mark.realtime
T = TypeVar("T")
METRE_DEG = 1.0 / 111_195.0
MODULES = "link,param,output,mode,arm,cmdlong,wp"


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


@pytest.fixture(scope="module")
def behind(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """An emulated vehicle, the detector, and the address of a link behind it."""
    saved = tmp_path_factory.mktemp("behind") / "b.json"
    options = ("--learn", "500", "--save", str(saved), "--forward", "udpin:127.0.0.1:0")
    with flying("--rate", "100") as (address,), running("--connect", address, *options) as (_, line):
        found = re.search(r"forwarding to udpin:(127\.0\.0\.1:\d+)", line)
        assert found, line
        yield f"udpout:{found[1]}"


def test_mavsdk_reads_and_sets_them(behind: str) -> None:
    async def read(address: str) -> None:
        async with ground_station() as mavsdk:
            parameters = ParamAsync(await found(mavsdk, address))
            until, told = time.monotonic() + PATIENCE_S, dict[str, float]()
            while len(told) < 3 and time.monotonic() < until:  # it answers once the vehicle has entered
                with suppress(ParamError):  # the binding of 4.1 says "unknown" after it has selected it, too
                    await parameters.select_component(Component.ONBOARD_COMPUTER, ProtocolVersion.V1)
                with suppress(ParamError):  # one by one: all at once it mixes with those of the autopilot that it hears
                    told |= {name: await parameters.get_param_float(name) for name in PARAMETERS}
            assert told == {"PROP_SCALE": 1.0, "PROP_TEXTS": 30.0, "PROP_ACK": 0.0}
            await parameters.set_param_float("PROP_TEXTS", 12.0)
            assert await parameters.get_param_float("PROP_TEXTS") == 12.0

    asyncio.run(read(behind))


def test_mavproxy_shows_them(behind: str, tmp_path: Path) -> None:
    computer = Component.ONBOARD_COMPUTER
    with mavproxy(tmp_path, behind, "--cmd=param fetch", component=computer) as ground_station:
        output = printed(ground_station, "Received 3 parameters", lambda: None, 0.2)
    assert "Received 3 parameters" in output, output


@contextmanager
def mavproxy(folder: Path, address: str, *options: str, component: int = 0) -> Iterator[subprocess.Popen[str]]:
    program = shutil.which("mavproxy.py", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("MAVProxy is not installed")
    # without the two targets it hides the companion's component 191
    targets = ("--target-system=1", f"--target-component={component}", "--daemon", "--non-interactive")
    command = [sys.executable, program, f"--default-modules={MODULES}", f"--master={address}", *targets, *options]
    environment = {**os.environ, "HOME": str(folder), "PYTHONUNBUFFERED": "1"}
    with process(command, cwd=folder, env=environment) as station:
        yield station


def printed(station: subprocess.Popen[str], words: str, meanwhile: Callable[[], None], pause_s: float) -> str:
    """What it prints until these words come. meanwhile: what is done every `pause_s`."""
    lines: list[str] = []
    assert station.stdout is not None
    threading.Thread(target=lines.extend, args=(station.stdout,), daemon=True).start()
    until = time.monotonic() + PATIENCE_S
    while not any(words in line for line in lines) and time.monotonic() < until:
        meanwhile()
        time.sleep(pause_s)
    return "".join(lines)


def test_mavproxy_prints_the_alert_of_a_companion(tmp_path: Path) -> None:
    with (
        flying("--rate", "100", links=2) as (address, companion_address),
        mavproxy(tmp_path, address) as ground_station,
        companion(companion_address) as alerter,
    ):
        output = printed(ground_station, ALERT, alerter.alert, 2.1)  # it prints the same text only every 2 s
    assert f"AP: {ALERT}" in output, output
    assert "Detected vehicle 1:1" in output
    assert "ARMED" in output
