"""The history: trends with their errors, warnings, the store, and flights together."""

import json
import math
import os
import pwd
import shutil
import sqlite3
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_history import DAY_NS, START_NS, record, records, series
from sqlalchemy import create_engine, text, update

from mavdiag.archive import together as module
from mavdiag.archive.figures import FlightRecord
from mavdiag.archive.together import Reference, Taught, together
from mavdiag.errors import UsageError
from mavdiag.history.show import FLIGHT_COLUMNS, TREND_COLUMNS, flight_rows, lines_of, overview_json, trend_rows
from mavdiag.history.store import VERSION, address_of, open_history
from mavdiag.history.trend import MEMORY, Sessions, Trend, changes_of, sessions_of, trend_of
from mavdiag.history.warn import (
    WATCHED,
    Mark,
    MarkKind,
    Outlook,
    overview_of,
    review,
    series_of,
    stretches_of,
    warned_at,
)
from mavdiag.judging import Verdict
from mavdiag.telemetry import FloatArray
from mavdiag.thresholds.evidence import Evidence, Flown, evidence_of

shares = st.lists(st.floats(0.0, 3.0) | st.just(math.nan), min_size=1, max_size=40)
C = np.array([[-0.25, -0.25, 0.25, 0.25], [0.25, -0.25, -0.25, 0.25], [0.25, -0.25, 0.25, -0.25]])
HOUR_NS = DAY_NS // 24
TAUGHT = tuple(Taught("abcd"[i] * 64, START_NS + i // 2 * DAY_NS, i // 2, 0, 60.0, (0.0, 0.0, 0.1)) for i in range(4))
REFERENCE = Reference("sha256:b", tuple(map(tuple, C.tolist())), TAUGHT)


def one_each(share: FloatArray) -> Sessions:
    n = len(share)
    return sessions_of(range(1, n + 1), range(n), share)


def forecast(trend: Trend, flights: float) -> tuple[float, float]:
    """Level so many flights from now, and its standard error."""
    variance = trend.level_variance + 2 * flights * trend.covariance + flights**2 * trend.slope_variance
    return trend.level + trend.slope * flights, math.sqrt(max(variance, 0.0))


def test_the_line_is_that_of_a_weighted_polynomial_fit() -> None:
    """`numpy.polyfit`, where no session is odd, so that Huber's weights are all 1."""
    x = np.arange(1.0, 61.0)
    y = 0.3 + 0.004 * x + 0.02 * np.sign(np.sin(x))
    found = trend_of(one_each(y), 60.0)
    slope, level = np.polyfit(x - 60.0, y, 1, w=np.sqrt(np.exp((x - 60.0) / MEMORY)))
    assert found is not None
    assert (found.level, found.slope) == pytest.approx((level, slope), rel=1e-9)


def test_the_stated_error_is_the_scatter_of_repetitions() -> None:
    """Sessions of one flight with normal errors, 300 times."""
    rng = np.random.default_rng(2)
    x = np.arange(1.0, 101.0)
    found = [trend_of(one_each(0.4 + 0.002 * x + 0.03 * rng.standard_normal(100)), 100.0) for _ in range(300)]
    trends = [one for one in found if one is not None]
    levels, slopes = np.array([one.level for one in trends]), np.array([one.slope for one in trends])
    assert np.median([math.sqrt(one.level_variance) for one in trends]) == pytest.approx(levels.std(), rel=0.3)
    assert np.median([math.sqrt(one.slope_variance) for one in trends]) == pytest.approx(slopes.std(), rel=0.3)
    ahead = [forecast(one, 20.0) for one in trends]
    within = [abs(value - (0.4 + 0.002 * 120)) < 1.645 * error for value, error in ahead]
    assert np.mean(within) > 0.8  # 0.9 for many sessions; the memory leaves some twenty
    assert levels.mean() == pytest.approx(0.6, abs=0.005)


@given(st.floats(0.3, 1.1), st.floats(1e-4, 0.05), st.floats(1e-6, 1e-3), st.floats(0.001, 0.9), st.floats(-0.9, 0.9))
def test_the_interval_of_the_remaining_flights_holds_what_cannot_be_told_from_the_threshold(
    level: float, slope: float, level_variance: float, relative: float, correlation: float
) -> None:
    """Fieller's inequality, asked directly over a grid of flights."""
    slope_variance = (relative * slope) ** 2
    covariance = correlation * math.sqrt(level_variance * slope_variance)
    trend = Trend(level, slope, level_variance, covariance, slope_variance, 0.05, 20)
    found = trend.remaining()
    assert found is not None
    assert found.low <= found.flights <= found.high
    for ahead in np.linspace(0.0, 2 * (1.0 + found.flights), 50).tolist():
        value, error = forecast(trend, ahead)
        inside = abs(1.0 - value) <= 1.645 * error
        near = min(abs(ahead - found.low), abs(ahead - found.high)) < 1e-6 * (1 + ahead)
        if level < 1.0 and not near:
            assert inside == (found.low <= ahead <= found.high)


@given(shares)
def test_no_series_is_too_odd_for_a_trend_and_its_changes(share: list[float]) -> None:
    sessions = one_each(np.array(share))
    trend = trend_of(sessions, float(len(share)))
    assert (trend is None) == (len(sessions) < 5)
    if trend is not None:
        assert math.isfinite(trend.level)
        assert trend.slope_variance > 0
    assert all(1 < one.number <= len(share) for one in changes_of(sessions))


def worn(flights: int, power: float, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(0.4 + 0.6 * (np.arange(1, flights + 1) / flights) ** power + 0.03 * rng.standard_normal(flights))


@pytest.mark.parametrize("power", [0.8, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_wear_is_warned_of_5_to_40_flights_before_its_threshold(power: float, seed: int) -> None:
    found = warned_at(series(worn(150, power, seed)))
    assert found is not None
    assert 5 <= 150 - found <= 40


def test_a_warning_stands_while_the_level_does_and_ends_when_it_falls_back() -> None:
    slow = np.concatenate((worn(150, 1.0, 1)[:140], np.full(10, 0.93)))
    found = review(series(slow))
    assert found.outlook is Outlook.WARNING
    assert found.warned_at is not None
    assert found.warned_at < 140
    assert review(series(np.concatenate((slow, np.full(60, 0.4))))).outlook is Outlook.STEADY
    assert review(series(np.concatenate((slow, np.full(40, 1.1))))).outlook is Outlook.REACHED


def test_marks_and_other_baselines_begin_a_stretch() -> None:
    flights = (*records([0.5] * 10), *(record(number, baseline="sha256:new") for number in range(11, 16)))
    marks = (
        Mark("one", START_NS + 4 * DAY_NS + 1, MarkKind.NEW_PROPELLERS),
        Mark("one", START_NS + 90 * DAY_NS, MarkKind.REPAIR),
    )
    found = [(one.first, one.began, len(one.flights)) for one in stretches_of(flights, marks)]
    assert found == [(1, "", 4), (5, "new propellers", 6), (11, "new baseline", 5), (16, "repair", 0)]
    assert stretches_of((), marks) == ()


def test_a_series_has_the_monitors_of_propellers_the_sessions_and_the_highest_threshold() -> None:
    times = [START_NS, START_NS + DAY_NS // 48, START_NS + DAY_NS, 0, 0]
    (stretch,) = stretches_of([record(n, 0.5 if n != 2 else None, t_ns=t) for n, t in enumerate(times)], ())
    found = series_of(stretch)
    assert [one.name for one in found] == ["fsd roll", "fsd pitch", "unbalance"]
    assert "control_loss" not in WATCHED
    assert found[2].session.tolist() == [0, 0, 1, 2, 3]
    assert np.isnan(found[2].share[2])
    assert (found[0].share[0], found[2].share[0]) == (0.5, 0.5)


@given(st.lists(st.floats(0.0, 5.0) | st.none(), min_size=1, max_size=60), st.integers(1, 150), st.booleans())
def test_a_drawing_keeps_to_the_width_of_the_terminal(peaks: list[float | None], width: int, marked: bool) -> None:
    marks = (Mark("one", START_NS + 5 * DAY_NS + 1, MarkKind.NEW_PROPELLERS),) if marked else ()
    found = overview_of("one", records(peaks), marks)
    drawn = [line.text for line in lines_of(found, width) if line.text.startswith("    ")]
    assert len(drawn) == sum(one.trend is not None for one in found.found)
    assert all(len(text) <= max(width, 5) for text in drawn)
    json.dumps(overview_json(found), allow_nan=False)
    assert all(set(TREND_COLUMNS) <= set(row) for row in trend_rows(found))
    assert all(set(row) <= set(FLIGHT_COLUMNS) for one in found.flights for row in flight_rows(1, one))


pytest.importorskip("sqlalchemy", reason="the history is an extra")


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """The URL of an empty database of a server of its own. It refuses to run as root."""
    pytest.importorskip("psycopg", reason="the driver is in the extra `history`")
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: float(path.parts[-2]))
    if not programs:
        pytest.skip("PostgreSQL is not installed: apt install postgresql")
    user = pwd.getpwnam("nobody").pw_uid if os.getuid() == 0 else os.getuid()
    home = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))  # a socket's path must be short
    os.chown(home, user, -1)

    def run(program: str, *options: str) -> None:
        told: list[str | Path] = [programs[-1] / program, "-D", home / "data", *options]
        subprocess.run(told, user=user, cwd=home, check=True, stdout=subprocess.DEVNULL, timeout=120)

    run("initdb", *("-U", "owner", "-A", "trust", "-N", "-E", "UTF8", "--locale=C"))
    run("pg_ctl", "start", "-w", "-s", "-l", str(home / "log"), "-o", f"-k {home} -c listen_addresses= -c fsync=off")
    try:
        yield f"postgresql://owner@/postgres?host={home}"
    finally:
        run("pg_ctl", "stop", "-w", "-s", "-m", "fast")  # whoever is connected is let go
        shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    if request.param == "sqlite":
        yield str(tmp_path / "history.sqlite")
        return
    url: str = request.getfixturevalue("server")
    yield url
    engine = create_engine(address_of(url))
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE; CREATE SCHEMA public"))
    engine.dispose()


def test_what_is_kept_comes_back_in_order_of_time(database: str) -> None:
    kept = records([0.5, None, 0.7])
    unknown = replace(record(9), started_ns=0, rotor_trim=(), slots=(), verdict=Verdict.NOT_JUDGEABLE)
    with open_history(database, create=True) as history:
        assert history.names() == ()
        assert [history.add(one) for one in (kept[2], kept[0], unknown, kept[1])] == [True] * 4
    with open_history(database) as history:
        assert history.names() == ("one",)
        assert history.flights("one") == (unknown, *kept)  # added on the first of January
        assert history.flights("another") == ()


def test_what_a_baseline_s_flights_are_compared_with_is_kept_once(database: str) -> None:
    taught = (Taught("a" * 64, 0, 0, 0, 60.0, (0.0, 0.01, 0.02)),)
    reference = Reference("sha256:1", ((0.25, -0.25),) * 3, taught)
    with open_history(database, create=True) as history:
        history.refer(reference)
        history.refer(reference)
        history.refer(replace(reference, baseline="sha256:2"))
    with open_history(database) as history:
        assert history.references() == (reference, replace(reference, baseline="sha256:2"))


def test_a_flight_is_kept_once_and_replaced_when_asked(database: str) -> None:
    with open_history(database, create=True) as history:
        assert history.add(record(1))
        assert not history.add(replace(record(1), airframe="another", reason="changed"))
        assert history.airframe_of(record(1).content) == "one"
        assert history.add(replace(record(1, 0.9), reason="changed"), again=True)
        assert [one.reason for one in history.flights("one")] == ["changed"]
        assert history.flights("one")[0].slots[2].peak == 0.9
        assert history.airframe_of("unknown") is None


def test_several_that_add_at_once_keep_each_flight_once(database: str) -> None:
    """Eight at a time open it, which makes the tables, and add the same ten flights."""

    def add(_: int) -> int:
        with open_history(database, create=True) as history:
            return sum(history.add(one) for one in records([0.5] * 10))

    with ThreadPoolExecutor(8) as pool:
        added = sum(pool.map(add, range(8)))
    with open_history(database) as history:
        assert added == len(history.flights("one")) == 10


def test_a_database_of_another_schema_is_refused(database: str) -> None:
    with open_history(database, create=True) as history:
        history.add(record(1))
    engine = create_engine(address_of(database))
    with engine.begin() as connection:
        connection.execute(update(VERSION).values(version_num="0001"))
    engine.dispose()
    with pytest.raises(UsageError, match=r"of schema 0001.*add the logs to a new history"), open_history(database):
        pass


def test_a_reader_needs_no_rights_to_write(tmp_path: Path) -> None:
    """As little as while another one writes: a lock to write would have to wait for it."""
    path = tmp_path / "h.sqlite"
    with open_history(str(path), create=True) as history:
        history.add(record(1))
    before = path.stat().st_mtime_ns
    held = sqlite3.connect(path, isolation_level=None)
    held.execute("BEGIN IMMEDIATE")  # another one writes at the moment
    with open_history(str(path)) as history:
        assert len(history.flights("one")) == 1
    held.close()
    assert path.stat().st_mtime_ns == before


def flown(starts_ns: Sequence[int], rise: float = 0.0) -> list[FlightRecord]:
    """Flights that began then, with a rise of rotor 3."""
    trim = tuple((np.array([0.0, 0.0, 0.1]) + rise * C[:, 2]).tolist())
    return [replace(record(i, t_ns=t_ns), trim=trim) for i, t_ns in enumerate(starts_ns)]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Flown]:
    found: list[Flown] = []

    def ask(flights: Flown, *rest: object) -> Evidence:
        found.append(flights)
        return evidence_of(flights, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "evidence_of", ask)
    return found


def test_flights_within_an_hour_share_a_session_and_those_without_a_clock_may(asked: list[Flown]) -> None:
    day = START_NS + 9 * DAY_NS
    together(REFERENCE, flown([START_NS + HOUR_NS // 2, day, day + HOUR_NS // 2, 0, day + DAY_NS, day + 2 * DAY_NS]))
    assert [one.sessions.tolist()[4:] for one in asked] == [[0, 3, 3, 3, 3, 4], [0, 3, 3, 4, 5, 6]]
    asked.clear()
    together(REFERENCE, flown([START_NS, START_NS + 1]), new_propellers=True)
    assert [one.sessions.tolist()[4:] for one in asked] == [[2, 2]]
    assert asked[0].propellers.tolist() == [0, 0, 0, 0, 1, 1]


def test_without_clocks_the_lower_odds_of_both_readings_are_told(asked: list[Flown]) -> None:
    said = together(REFERENCE, flown([0, 0, 0], rise=0.1))
    odds = [evidence_of(one, C, module.priors_of(C)).odds for one in asked]
    assert said.evidence is not None
    assert len(odds) == 2
    assert said.evidence.odds == min(odds)


def test_flights_that_taught_and_those_without_a_trim_do_not_count(asked: list[Flown]) -> None:
    one, other, third = flown([START_NS + i * DAY_NS for i in (5, 6, 7)])
    said = together(REFERENCE, [replace(one, content="a" * 64 + ":1"), replace(other, trim=()), third])
    assert said.flights == 1
    assert said.since is third
    assert len(asked[0].trims) == 5
    assert together(REFERENCE, [replace(third, trim=())]).evidence is None
    assert "nothing can be said" in str(together(replace(REFERENCE, flights=()), [third]))


def test_a_change_is_told_with_its_rotor_odds_and_first_flight() -> None:
    days = [START_NS + i * DAY_NS for i in range(5, 13)]
    healthy, damaged = flown(days[:4]), flown(days[4:], rise=0.1)
    said = together(REFERENCE, [*healthy, *damaged])
    assert said.changed
    assert said.rotors == (3,)
    assert said.since == damaged[0]
    assert "8 flights together: rotor 3 has changed, " in str(said)
    assert str(said).endswith(" to 1, since flight 0.tlog")
    assert not together(REFERENCE, healthy).changed
    assert "no rotor is known to have changed" in str(together(REFERENCE, healthy))


def test_new_propellers_begin_anew_and_may_differ() -> None:
    flights = [*flown([START_NS + i * DAY_NS for i in range(5, 13)], rise=0.1)]
    found = overview_of("one", flights, (), (REFERENCE,))
    assert found.together is not None
    assert found.together.changed
    assert overview_json(found)["together"]["rotors"] == [3]
    assert any(line.loud and "rotor 3 has changed" in line.text for line in lines_of(found))
    mark = Mark("one", flights[3].started_ns + 1, MarkKind.NEW_PROPELLERS)
    fresh = overview_of("one", flown([one.started_ns for one in flights], rise=0.02), (mark,), (REFERENCE,))
    assert fresh.together is not None
    assert fresh.together.flights == 4
    assert not fresh.together.changed
    assert overview_of("one", flights, (), ()).together is None
