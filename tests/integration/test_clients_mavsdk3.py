"""mavsdk 3, which talks to a server process of its own, flies the plant. It needs an environment without mavsdk 4."""

import json
import os
import socket
import subprocess
from pathlib import Path

import pytest
from plant_process import flying

pytestmark = pytest.mark.realtime
SCRIPT = Path(__file__).with_name("mavsdk3_flight.py")
PATIENCE_S = 120.0


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_mavsdk_3_connects_and_flies(profile: str) -> None:
    python = os.environ.get("MAVDIAG_MAVSDK3")
    if python is None:
        pytest.skip("`nox -s clients` runs this: MAVDIAG_MAVSDK3 must name a python that has mavsdk 3")
    with flying("--profile", profile, "--trajectory", "commanded") as (address,):
        done = subprocess.run(
            [python, str(SCRIPT), address.replace("udpout:", "udpout://"), str(free_port())],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        )
    steps = {line["step"]: line["result"] for line in map(json.loads, done.stdout.splitlines())}
    assert steps == {
        "connected": True,
        "healthy": True,
        "parameters": True,
        "parameter": 1,
        "took off": True,
        "disarmed in flight": "COMMAND_DENIED" if profile == "px4" else "FAILED",
        "went": True,
        "injected": True,
        "mission": True,
        "mission flown": True,
        "landed": True,
    }, done.stderr
