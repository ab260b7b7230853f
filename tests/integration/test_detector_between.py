"""The detector between a vehicle and a ground station: mavsdk behind `--forward` meets both, and gets the alert."""

import asyncio
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mavsdk", reason="mavsdk is not installed for this platform")

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from plant_process import flying

from mavdiag.learning import LearnOptions, learn
from mavdiag.logs.tlog import read_tlog

pytestmark = pytest.mark.realtime
PATIENCE_S = 60.0
FLIGHT = ("--rate", "200", "--seed", "5")


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    """Of the emulated vehicle, at the rate it will fly with."""
    log, path = tmp_path / "healthy.tlog", tmp_path / "baseline.json"
    command = [sys.executable, "-m", "sitl_plant", "record", "-o", str(log), "--duration", "40", *FLIGHT]
    subprocess.run(command, check=True, capture_output=True, timeout=120.0)
    learn([read_tlog(log)], LearnOptions(), created="2026-01-01T00:00:00Z").save(path)
    return path


async def wait_for_the_fault(address: str) -> str:
    """Connect as a ground station does, and wait for the alert."""
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(address)
        system = await mavsdk.first_autopilot(20.0)
        assert system is not None
        async for text in TelemetryAsync(system).subscribe_status_text():
            if "FAULT" in text.text:
                return str(text.text)
    raise AssertionError("the texts ended")


def test_mavsdk_behind_the_detector_meets_the_vehicle_and_gets_the_alert(baseline: Path) -> None:
    with flying(*FLIGHT, "--fault", "F2/SV3", "--onset", "8") as (address,):
        detector = subprocess.Popen(
            [
                *(sys.executable, "-m", "detector", "--connect", address, "--baseline", str(baseline)),
                *("--forward", "udpin:127.0.0.1:0"),
            ],
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert detector.stderr is not None
            ready = next(line for line in detector.stderr if line.startswith("ready"))
            port = re.findall(r"127\.0\.0\.1:(\d+)", ready)[1]
            text = asyncio.run(asyncio.wait_for(wait_for_the_fault(f"udpout://127.0.0.1:{port}"), PATIENCE_S))
        finally:
            detector.terminate()
            detector.communicate(timeout=20.0)
    what = r"vibrates [\d.]+x|thrust unsteady [\d.]+x|lost \d+% thrust|attitude unlike the model"
    assert re.fullmatch(rf"PROP FAULT (motor 1 |rotor unknown: |roll |pitch )?({what})(, F[123](/SV[123])?)?", text)
    assert detector.returncode == 0
