"""`sitl-plant fleet`: several vehicles with system ids of their own to one port or many, a fault in those named."""

import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import patch

import pytest
from patience import PATIENCE_S
from plant_process import process

from mavdiag.errors import UsageError
from mavdiag.link.codec import Decoder, field_index
from mavdiag.link.messages import MessageId, ModeFlag
from mavdiag.link.ports import Endpoint, open_endpoint
from sitl_plant.fleet import fleet
from sitl_plant.options import flight_plan

FLEET = [sys.executable, "-m", "sitl_plant", "fleet", "--profile", "ardupilot", "--rate", "50"]
MODE = field_index(MessageId.HEARTBEAT, "base_mode")


def heard(ends: list[Endpoint], until_disarmed: set[int]) -> list[dict[int, list[bool]]]:
    """For each end, whether each system id was armed, heartbeat by heartbeat, until these landed."""
    found: list[dict[int, list[bool]]] = [{} for _ in ends]
    deadline, decoder = time.monotonic() + PATIENCE_S, Decoder({MessageId.HEARTBEAT})
    landed = set[int]()
    while landed < until_disarmed and time.monotonic() < deadline:
        for end, own in zip(ends, found, strict=True):
            for data, host_ns in end.receive(0.05):
                for frame in decoder.feed_datagram(data, host_ns):
                    armed = bool(int(frame.fields[MODE]) & ModeFlag.SAFETY_ARMED)
                    told = own.setdefault(frame.sysid, [])
                    landed |= {frame.sysid} if told and told[-1] and not armed else set()
                    told.append(armed)
    assert landed == until_disarmed
    return found


@pytest.mark.realtime
def test_a_fleet_takes_off_and_lands_on_one_port() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as end:
        out = end.address.replace("udpin", "udpout")
        options = ["-n", "3", "--system-id", "7", "--out", out, "--takeoff", "--duration", "18"]
        with process([*FLEET, *options]) as plant:
            (found,) = heard([end], {7, 8, 9})
            assert plant.wait(PATIENCE_S) == 0
    assert set(found) == {7, 8, 9}
    assert all(True in told for told in found.values())


@pytest.mark.realtime
def test_each_vehicle_of_a_fleet_has_a_port_of_its_own_and_a_signal_ends_all() -> None:
    with open_endpoint("udpin:127.0.0.1:0") as low:
        port = int(low.address.rpartition(":")[2])
        with open_endpoint(f"udpin:127.0.0.1:{port + 1}") as high:
            out = f"udpout:127.0.0.1:{port}"
            with process([*FLEET, "-n", "2", "--out", out, "--port-each"]) as plant:
                deadline, found = time.monotonic() + PATIENCE_S, [set[int](), set[int]()]
                decoder = Decoder({MessageId.HEARTBEAT})
                while not all(found) and time.monotonic() < deadline:
                    for end, ids in zip((low, high), found, strict=True):
                        chunks = end.receive(0.05)
                        ids |= {frame.sysid for data, ns in chunks for frame in decoder.feed_datagram(data, ns)}
                plant.terminate()
                assert plant.wait(PATIENCE_S) == 0
    assert found == [{1}, {2}]


def test_only_the_vehicles_that_are_named_get_the_fault() -> None:
    flown: list[tuple[int, str | None, int]] = []

    class Inline:
        """In place of a process."""

        def __init__(self, target: object, args: tuple[object, ...]) -> None:
            plan = args[0]
            flown.append((plan.dialect.sysid, plan.config.fault, plan.config.seed))  # type: ignore[attr-defined]  # a plan

        def start(self) -> None: ...
        def join(self) -> None: ...
        def is_alive(self) -> bool:
            return False

    with patch("multiprocessing.context.ForkContext.Process", Inline):
        fleet.__wrapped__(flight_plan(fault="F2/SV2", seed=5), 4, "2,4", "udpout:127.0.0.1:9")  # type: ignore[attr-defined]  # the command without its options
    assert flown == [(1, None, 5), (2, "F2/SV2", 6), (3, None, 7), (4, "F2/SV2", 8)]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"faulty": "9"}, r"name system ids of the fleet, 1 to 2"),
        ({"faulty": "x"}, r"name system ids of the fleet"),
        ({"count": 300}, r"system ids end at 255"),
    ],
)
def test_a_fleet_that_cannot_be_flown_is_refused(options: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        fleet.__wrapped__(flight_plan(fault="F2/SV2"), **{"count": 2, "out": "udpout:127.0.0.1:9"} | options)  # type: ignore[attr-defined]  # the command without its options


def test_the_help_of_a_fleet_has_the_options_of_a_flight() -> None:
    shown = subprocess.run([*FLEET, "--help"], capture_output=True, text=True, check=True, cwd=Path.cwd()).stdout
    for option in ("--fault", "--onset", "--faulty", "--port-each", "--system-id", "--trajectory"):
        assert option in shown
