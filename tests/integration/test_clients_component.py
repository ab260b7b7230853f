"""Programs of others read and set the parameters of the detector's component, by a link behind it."""

import asyncio
import os
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from detector_process import running
from patience import PATIENCE_S
from plant_process import flying, process
from test_clients_mavproxy import mavproxy

from detector.component import CHANGES
from mavdiag.link.messages import Component

pytestmark = pytest.mark.realtime


@contextmanager
def behind(folder: Path) -> Iterator[str]:
    """An emulated vehicle, the detector, and the address of a link behind it."""
    options = ("--learn", "500", "--save", str(folder / "b.json"), "--forward", "udpin:127.0.0.1:0")
    with flying("--rate", "100") as (address,), running("--connect", address, *options) as (_, line):
        found = re.search(r"forwarding to udpin:(127\.0\.0\.1:\d+)", line)
        assert found, line
        yield found[1]


def test_mavsdk_reads_and_sets_them(tmp_path: Path) -> None:
    pytest.importorskip("mavsdk", reason="mavsdk is not installed for this platform")
    from mavsdk.asyncio.plugins.param import ParamAsync
    from mavsdk.plugins.param import ParamError, ProtocolVersion
    from test_clients_mavsdk import found, ground_station

    async def read(address: str) -> None:
        async with ground_station() as mavsdk:
            parameters = ParamAsync(await found(mavsdk, f"udpout:{address}"))
            until, told = time.monotonic() + PATIENCE_S, dict[str, float]()
            while len(told) < 3 and time.monotonic() < until:  # it answers once the vehicle has entered
                with suppress(ParamError):  # the binding of 4.1 says "unknown" after it has selected it, too
                    await parameters.select_component(Component.ONBOARD_COMPUTER, ProtocolVersion.V1)
                with suppress(ParamError):  # one by one: all at once it mixes with those of the autopilot that it hears
                    told |= {name: await parameters.get_param_float(name) for name in CHANGES}
            assert told == {"PROP_SCALE": 1.0, "PROP_TEXTS": 30.0, "PROP_ACK": 0.0}
            await parameters.set_param_float("PROP_TEXTS", 12.0)
            assert await parameters.get_param_float("PROP_TEXTS") == 12.0

    with behind(tmp_path) as address:
        asyncio.run(read(address))


def test_mavproxy_shows_them(tmp_path: Path) -> None:
    environment = {**os.environ, "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    printed: list[str] = []
    with behind(tmp_path) as address:
        command = mavproxy(f"udpout:{address}", "--daemon", "--non-interactive")
        command = [part.replace("component=0", f"component={int(Component.ONBOARD_COMPUTER)}") for part in command]
        with process([*command, "--cmd=param fetch"], cwd=tmp_path, env=environment) as station:
            assert station.stdout is not None
            reader = threading.Thread(target=printed.extend, args=(station.stdout,), daemon=True)
            reader.start()
            until = time.monotonic() + PATIENCE_S
            while not any("Received 3 parameters" in line for line in printed) and time.monotonic() < until:
                time.sleep(0.2)
        reader.join(PATIENCE_S)
    assert "Received 3 parameters" in "".join(printed), "".join(printed)
