"""pymavlink's own decoder and helpers, as scripts use them, understand the plant."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest
from plant_process import ALERT, companion, flying
from pymavlink import mavutil

pytestmark = pytest.mark.realtime
PATIENCE_S = 20.0
ONBOARD, GCS, INVALID = 18, 6, 8


@contextmanager
def connected(address: str) -> Iterator[mavutil.mavfile]:
    connection = mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="ardupilotmega")
    with closing(connection):
        connection.mav.heartbeat_send(GCS, INVALID, 0, 0, 4)
        yield connection


def command(connection: mavutil.mavfile, number: int, first: float, second: float) -> dict[str, int | float | str]:
    connection.mav.command_long_send(1, 1, number, 0, first, second, 0, 0, 0, 0, 0)
    answer = connection.recv_match(type="COMMAND_ACK", blocking=True, timeout=PATIENCE_S)
    assert answer is not None
    return answer.to_dict()


def test_pymavlink_hears_every_message_in_si_sense() -> None:
    with flying("--rate", "100") as (address,), connected(address) as connection:
        seen: dict[str, dict[str, int | float | str]] = {}
        until = time.monotonic() + PATIENCE_S
        wanted = {"HEARTBEAT", "SYS_STATUS", "ATTITUDE", "ATTITUDE_TARGET", "RAW_IMU", "SERVO_OUTPUT_RAW"}
        wanted |= {"HIGHRES_IMU", "LOCAL_POSITION_NED", "EXTENDED_SYS_STATE"}
        while not wanted <= seen.keys() and time.monotonic() < until:
            message = connection.recv_match(blocking=True, timeout=1.0)
            if message is not None and message.get_type() in wanted:
                assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 1)
                seen[message.get_type()] = message.to_dict()
    assert wanted <= seen.keys()
    assert seen["HEARTBEAT"]["type"] == 2
    assert -1100 < float(seen["RAW_IMU"]["zacc"]) < -900  # mG
    assert 1300 < float(seen["SERVO_OUTPUT_RAW"]["servo1_raw"]) < 1700
    assert seen["SERVO_OUTPUT_RAW"]["servo5_raw"] == 0
    assert -1.2 < float(seen["LOCAL_POSITION_NED"]["z"]) < -0.8


def test_pymavlink_changes_rates_and_reads_parameters() -> None:
    with flying("--rate", "50") as (address,), connected(address) as connection:
        assert command(connection, 511, 27, -1)["result"] == 0
        assert command(connection, 511, 30, 10_000)["result"] == 0
        assert command(connection, 511, 30, 10)["result"] == 2
        connection.mav.param_request_list_send(1, 1)
        value = connection.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S)
        assert value is not None
        assert value.to_dict()["param_id"] == "SYSID_THISMAV"
        counts: Counter[str] = Counter()
        stamps: list[float] = []
        while len(stamps) < 100:
            message = connection.recv_match(blocking=True, timeout=PATIENCE_S)
            assert message is not None
            counts[message.get_type()] += 1
            if message.get_type() == "ATTITUDE":
                stamps.append(float(message.to_dict()["time_boot_ms"]))
    assert counts["RAW_IMU"] == 0
    assert (stamps[-1] - stamps[0]) / 99 == pytest.approx(10.0)


def test_pymavlink_hears_the_alert_of_a_companion_once_it_has_spoken_itself() -> None:
    with (
        flying("--rate", "20", links=2) as (address, companion_address),
        companion(companion_address) as alerter,
        connected(address) as connection,
    ):
        until = time.monotonic() + PATIENCE_S
        text = None
        while text is None and time.monotonic() < until:
            alerter.alert()
            text = connection.recv_match(type="STATUSTEXT", blocking=True, timeout=0.3)
    assert text is not None
    assert text.to_dict()["text"] == ALERT
    assert (text.get_srcSystem(), text.get_srcComponent()) == (1, 191)
