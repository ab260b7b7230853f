"""The guards of teaching and the fingerprint on recorded flights: healthy ones teach, a crash does not."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
from shared_data import shared

from mavdiag.airframe.fingerprint import Outcome, compare, fingerprint_of
from mavdiag.airframe.load import airframe_named
from mavdiag.errors import InputError
from mavdiag.learning import airborne, front_for
from mavdiag.learning.teaching import taught
from mavdiag.logs import between, read_log
from mavdiag.rows.front import Rows
from mavdiag.telemetry import Log

CRAZYFLIE = airframe_named("crazyflie").layout
UPSET_S = 239.0  # of log171.bin, as the data's own notes have it


@cache
def crazypad(folder: str) -> tuple[Log, ...]:
    return tuple(read_log(path) for path in sorted(shared(f"data/crazypad/{folder}").glob("E8_log*")))


def part(log: Log, from_s: float | None, to_s: float | None) -> Log:
    return replace(log, telemetry=between(log.telemetry, from_s, to_s))


def test_a_real_flight_teaches_up_to_its_upset_and_is_refused_with_it() -> None:
    log = read_log(shared("data/ardupilot_real/log171.bin"))
    assert taught([part(log, 75, 217)], 0.1, None, robust=False).left_out == ()
    with pytest.raises(
        InputError, match=r"log171\.bin: the flight ends in an upset, at 23\d\.\d s: .*cut the log before"
    ):
        taught([log], 0.1, None, robust=False)
    found = taught([log], 0.1, None, robust=True)
    assert found.flights[0].rows[-1].block.t_ns[-1] / 1e9 < UPSET_S
    assert found.flights[0].judged_s == pytest.approx(taught([part(log, None, 236)], 0.1, None, robust=False)
                                                      .flights[0].judged_s, abs=3)  # fmt: skip
    assert len(found.left_out) == 1


def rows(log: Log) -> Sequence[Rows]:
    return airborne(front_for(crazypad("normal_flight"), 0.1), log).rows


@pytest.mark.parametrize(
    "folder",
    [
        "cut_propeller_M3_0.5mm_46.5mm",
        "cut_propeller_M3_4mm_4mm_39mm",
        "cut_propeller_M3_3mm",
        "tape_on_propeller_M1_M3_M4",
        "add_weight_W1_near_M3_M4",
    ],
)
def test_damage_and_load_do_not_make_e8_another_vehicle(folder: str) -> None:
    healthy = [rows(log) for log in crazypad("normal_flight")]
    for learnt in (healthy, healthy[:3], healthy[3:]):
        fingerprint = fingerprint_of(learnt, CRAZYFLIE)
        assert fingerprint is not None
        for log in crazypad(folder):
            assert compare(fingerprint, rows(log), CRAZYFLIE).outcome is not Outcome.FAR
