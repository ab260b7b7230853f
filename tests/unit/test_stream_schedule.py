"""The rhythm of messages: exact in the mean, never early, changed and denied as an autopilot does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavdiag.link.messages import MavResult, MessageId
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.autopilot.schedule import Schedule

FAST, SLOW, QUIET = 27, 0, 105
STEP_NS = 1_000_000


def times(first: int, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.arange(first, first + n, dtype=np.int64) * STEP_NS


def schedule() -> Schedule:
    return Schedule({FAST: 1000.0, SLOW: 1.0, QUIET: 0.0}, ceiling_hz=1000.0)


@given(rate_hz=st.floats(0.5, 1000.0), blocks=st.lists(st.integers(1, 400), min_size=1, max_size=12))
def test_any_rate_is_met_to_one_message_however_the_time_is_cut(rate_hz: float, blocks: list[int]) -> None:
    one = Schedule({FAST: rate_hz}, ceiling_hz=1000.0)
    rows, first = [], 0
    for n in blocks:
        due = dict(one.due(times(first, n)))
        rows += [first + int(row) for row in due.get(FAST, ())]
        first += n
    whole = Schedule({FAST: rate_hz}, ceiling_hz=1000.0).due(times(0, first))
    assert rows == dict(whole)[FAST].tolist()
    assert abs(len(rows) - first * 1e-3 * rate_hz) <= 1.0


@pytest.mark.parametrize(("msgid", "interval_us"), [(FAST, 999 / 1.01), (FAST, 1), (999, 10_000)])
def test_what_cannot_be_sent_is_denied_and_changes_nothing(msgid: int, interval_us: float) -> None:
    one = schedule()
    assert one.set_interval(msgid, interval_us) is MavResult.DENIED
    assert one.interval_us(FAST) == 1000
    assert one.interval_us(999) == 0


@pytest.mark.parametrize(
    ("profile", "asked_us", "result", "attained_hz"),
    [
        ("qdrone2", 5_000, MavResult.ACCEPTED, 200.0),
        ("px4", 5_000, MavResult.ACCEPTED, 165.0),  # 160 to 170 were measured
        ("px4", 10_000, MavResult.ACCEPTED, 100.0),
        ("ardupilot", 6_667, MavResult.ACCEPTED, 1000.0 / 6.0),  # whole milliseconds
        ("ardupilot", 3_000, MavResult.ACCEPTED, 1000.0 / 3.0),
        ("ardupilot", 2_900, MavResult.DENIED, 0.0),  # above 0.8 of its loop rate
    ],
)
def test_a_profile_grants_rates_as_its_autopilot_does(
    profile: str, asked_us: int, result: MavResult, attained_hz: float
) -> None:
    one = dialect_named(profile).schedule(None, fresh=profile != "qdrone2")
    assert one.set_interval(MessageId.ATTITUDE_TARGET, asked_us) == result
    seconds = 20
    rows = [rows for msgid, rows in one.due(times(0, 1000 * seconds)) if msgid == MessageId.ATTITUDE_TARGET]
    if result == MavResult.ACCEPTED:
        assert len(rows[0]) == pytest.approx(attained_hz * seconds, rel=0.01)
