"""QGroundControl's start-up sequence, replayed by pymavlink: every request gets its message, or a proper refusal.

The list was written down from QGroundControl's InitialConnectStateMachine and its managers (4.4), not recorded from it.
"""

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import NamedTuple

import pytest
from plant_process import flying
from pymavlink import mavutil

pytestmark = pytest.mark.realtime
PATIENCE_S = 10.0
GCS, INVALID = 6, 8
ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3


class Request(NamedTuple):
    """REQUEST_MESSAGE of a message, the results that are proper, and what must come; None for nothing."""

    msgid: int
    results: tuple[int, ...]
    comes: str | None


REQUESTS = (
    Request(148, (ACCEPTED,), "AUTOPILOT_VERSION"),
    Request(300, (ACCEPTED,), "UNKNOWN_300"),  # PROTOCOL_VERSION, which pymavlink does not know
    Request(435, (ACCEPTED,), "UNKNOWN_435"),  # AVAILABLE_MODES
    Request(397, (DENIED, UNSUPPORTED), None),  # COMPONENT_METADATA
    Request(395, (DENIED, UNSUPPORTED), None),  # COMPONENT_INFORMATION
    Request(280, (DENIED, UNSUPPORTED), None),  # GIMBAL_MANAGER_INFORMATION
    Request(242, (ACCEPTED,), "HOME_POSITION"),
    Request(49, (ACCEPTED,), "GPS_GLOBAL_ORIGIN"),
)
SEEN = {"HEARTBEAT", "SYS_STATUS", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "VFR_HUD", "BATTERY_STATUS", "ATTITUDE"}
SEEN |= {"EXTENDED_SYS_STATE", "HOME_POSITION"}


@contextmanager
def station(address: str) -> Iterator[mavutil.mavfile]:
    connection = mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="ardupilotmega")
    with closing(connection):
        connection.mav.heartbeat_send(GCS, INVALID, 0, 0, 4)
        assert connection.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S) is not None
        yield connection


def answers(connection: mavutil.mavfile, *kinds: str) -> dict[str, dict[str, int | float | str]]:
    """One message of each kind."""
    found: dict[str, dict[str, int | float | str]] = {}
    until = time.monotonic() + PATIENCE_S
    while not set(kinds) <= found.keys() and time.monotonic() < until:
        message = connection.recv_match(type=list(kinds), blocking=True, timeout=1.0)
        if message is not None:
            found[message.get_type()] = message.to_dict()
    assert set(kinds) <= found.keys(), f"no {set(kinds) - found.keys()}"
    return found


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_every_request_of_the_start_up_is_answered(profile: str) -> None:
    with flying("--profile", profile, "--trajectory", "commanded") as (address,), station(address) as connection:
        for request in REQUESTS:
            connection.mav.command_long_send(1, 1, 512, 0, request.msgid, 0, 0, 0, 0, 0, 0)
            kinds = ("COMMAND_ACK",) if request.comes is None else ("COMMAND_ACK", request.comes)
            ack = answers(connection, *kinds)["COMMAND_ACK"]
            assert (ack["command"], ack["result"] in request.results) == (512, True), request
        if profile == "ardupilot":
            connection.mav.request_data_stream_send(1, 1, 10, 20, 1)  # EXTRA1 at 20 Hz; it has no answer
        connection.mav.param_request_list_send(1, 1)
        names: dict[int, str] = {}
        count = 1
        while len(names) < count:
            value = answers(connection, "PARAM_VALUE")["PARAM_VALUE"]
            names[int(value["param_index"])] = str(value["param_id"])
            count = int(value["param_count"])
        assert set(names) == set(range(count))
        for kind in (0, 1, 2):
            connection.mav.mission_request_list_send(1, 1, kind)
            told = answers(connection, "MISSION_COUNT")["MISSION_COUNT"]
            assert (told["count"], told["mission_type"]) == (0, kind)
        connection.mav.ping_send(7, 1, 0, 0)
        assert answers(connection, "PING")["PING"]["time_usec"] == 7
        state = answers(connection, *SEEN)
        assert state["GPS_RAW_INT"]["fix_type"] == 3
        assert state["SYS_STATUS"]["battery_remaining"] == pytest.approx(100, abs=3)
        assert (
            state["SYS_STATUS"]["onboard_control_sensors_health"]
            == state["SYS_STATUS"]["onboard_control_sensors_enabled"]
        )
        assert int(state["HEARTBEAT"]["base_mode"]) & 128 == 0  # not armed
        assert state["EXTENDED_SYS_STATE"]["landed_state"] == 1
