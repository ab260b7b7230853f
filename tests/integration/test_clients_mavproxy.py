"""MAVProxy, a ground station that people use, finds the vehicle and prints the alert that the plant passes on."""

import os
import shutil
import sys
import threading
import time
from pathlib import Path

import pytest
from patience import PATIENCE_S
from plant_process import ALERT, companion, flying, process

pytestmark = pytest.mark.realtime
MODULES = "link,param,output,mode,arm,cmdlong,wp"


def mavproxy(address: str, *options: str) -> list[str]:
    program = shutil.which("mavproxy.py", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("MAVProxy is not installed")
    return [
        sys.executable,
        program,
        f"--default-modules={MODULES}",
        f"--master={address}",
        "--target-system=1",  # without these two it hides the companion's component 191
        "--target-component=0",
        *options,
    ]


def test_mavproxy_prints_the_alert_of_a_companion(tmp_path: Path) -> None:
    environment = {**os.environ, "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    printed: list[str] = []
    with (
        flying("--rate", "100", links=2) as (address, companion_address),
        process(mavproxy(address, "--daemon", "--non-interactive"), cwd=tmp_path, env=environment) as ground_station,
        companion(companion_address) as alerter,
    ):
        assert ground_station.stdout is not None
        reader = threading.Thread(target=printed.extend, args=(ground_station.stdout,), daemon=True)
        reader.start()
        until = time.monotonic() + PATIENCE_S
        while not any(ALERT in line for line in printed) and time.monotonic() < until:
            alerter.alert()
            time.sleep(2.1)  # MAVProxy prints the same text only every 2 s
    reader.join(PATIENCE_S)
    output = "".join(printed)
    assert f"AP: {ALERT}" in output, output
    assert "Detected vehicle 1:1" in output
    assert "ARMED" in output
