"""What `import mavdiag as md` gives: cheap to import, and short ways that end at the same functions."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying_telemetry import flying
from made_archive import archive_baseline, made
from made_baselines import FRAME, healthy, whole
from made_logs import ULOG_HEAD
from made_telemetry import START_NS, cut, flight

import mavdiag as md
from mavdiag.chain import chain_of
from mavdiag.decision.alarm import Change, Event, Stage
from mavdiag.errors import BaselineError, InputError, UsageError
from mavdiag.look.inspection import summary
from mavdiag.telemetry import Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

HEAVY = {"numpy", "scipy", "pydantic", "pymavlink", "control", "matplotlib", "pandas", "rich", "typer", "numba"}
EVERY = list(range(0, 70 * 10**9, 10**8))
T_NS = np.array([1_000_000_000, 1_500_000_000], dtype=np.int64)
RATE = Series(Signal.BODY_RATE, T_NS, T_NS, np.arange(6.0).reshape(2, 3))
OUTPUTS = Series(Signal.ACTUATOR, T_NS, T_NS, np.zeros((2, 4)))
LOG = Log("flight.bin", "00", "ardupilot-log", Telemetry((RATE, OUTPUTS)))


def test_the_import_loads_nothing_heavy_and_every_name_is_there() -> None:
    program = "import sys, mavdiag; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert not HEAVY & set(loaded.split())
    assert {name for name in dir(md) if not name.startswith("__")} == set(md.__all__)
    for name in md.__all__:
        assert getattr(md, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        md.absent  # noqa: B018


def test_rates_of_a_log_carry_the_model_that_made_them() -> None:
    log = md.Log("made", "", "qdrone2", flight(20_000, 3))
    u, y, dt = md.rates(log, "roll", window_s=0.05)
    assert dt == pytest.approx(0.001)
    assert sum(map(len, u)) == sum(map(len, y)) > 10_000
    model = md.identify.fit(u, y, dt=dt)
    assert model.r2t > 0.97
    assert model.dc_gain == pytest.approx(1.0, abs=0.05)
    with pytest.raises(UsageError, match="sideways"):
        md.rates(log, "sideways")


def test_all_logs_of_a_folder_are_judged_and_one_that_is_damaged_is_told(tmp_path: Path) -> None:
    paths = made(tmp_path, "a.tlog", "b.tlog", shaken=("b.tlog",))
    (tmp_path / "c.tlog").write_bytes(ULOG_HEAD)
    archive_baseline().save(tmp_path / "b.json")
    verdicts = list(md.scan(tmp_path, tmp_path / "b.json"))
    assert [str(one.verdict) for one in verdicts] == ["healthy", "fault", "error"]
    assert [one.log for one in verdicts[:2]] == [str(path) for path in paths]
    assert str(verdicts[1]) == str(md.judge(paths[1], archive_baseline()))
    assert next(md.scan([paths[1]], archive_baseline())) == verdicts[1]


def test_a_watch_gives_what_the_verdict_on_the_log_gives() -> None:
    telemetry = flying(3000, 5, weak_rotor=3, rise=0.2)
    watch, news = md.Watch(whole()), list[Change | Event]()
    for chunk in cut(telemetry, list(range(START_NS, START_NS + 30 * 10**9, 250_000_000))):
        news += watch.step(chunk)
    assert watch.diagnosis.stage is Stage.FAULT
    assert (watch.diagnosis.rotor, repr(watch)) == (3, f"<Watch: fault, {watch.diagnosis.reason}>")
    verdict = md.judge(md.Log("x", "", "px4", telemetry), whole())
    changes = [one for one in news if isinstance(one, Change)]
    assert [(one.stage, one.t_ns) for one in changes] == [(one.stage, one.t_ns) for one in verdict.changes]
    assert {one.start_ns for one in news if isinstance(one, Event)} == {one.start_ns for one in verdict.events}
    closed = watch.end_flight()
    assert not [one for one in watch.end_flight() if isinstance(one, Event)]
    assert [one.end_ns is not None for one in closed if isinstance(one, Event)] == [True]
    assert str(watch.diagnosis) == "inspect: the flight with the fault has ended, rotor 3"


def test_1_a_watch_refuses_a_link_of_another_rate_or_profile() -> None:
    """1: 50 Hz data on a baseline of 1 kHz were judged for 54 s, and the verdict was quiet."""
    halved = [replace(one, t_ns=one.t_ns * 2, host_ns=one.host_ns * 2) for one in flying(3000, 5).series]
    watch = md.Watch(whole())
    with pytest.raises(BaselineError, match=r"another link: link.*50\.0 Hz"):
        list(map(watch.step, cut(Telemetry(tuple(halved)), EVERY)))
    assert watch.diagnosis.stage == "not judged"
    assert "50.0 Hz" in watch.diagnosis.reason
    assert not watch.output.pieces


@pytest.mark.parametrize(("slower", "judged"), [(1, True), (2, False)])
def test_a_link_that_comes_in_chunks_is_measured_and_a_refused_one_never_judged(slower: int, judged: bool) -> None:
    times = [replace(one, t_ns=one.t_ns * slower, host_ns=one.host_ns * slower) for one in flying(600, 5).series]
    chain, found = chain_of(whole()), 0.0
    state, edges = chain.start(), list(range(START_NS, START_NS + 12 * 10**9, 10**7))
    for one in (one for chunk in cut(Telemetry(tuple(times)), edges) for one in chunk.series):
        found += chain.step(state, Telemetry((one,))).judged_s
    assert (found + chain.end_flight(state).judged_s > 1.0) is judged
    assert bool(state.refused) is not judged


def test_a_link_of_which_too_few_stamps_do_not_leap_is_not_measured_yet() -> None:
    """21 samples of which 3 leap were an error of the program."""
    t_ns, chain = 10**8 * np.arange(21), chain_of(whole())
    t_ns[5::7] += 51 * 10**7
    chain.step(state := chain.start(), Telemetry((Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((21, 3))),)))
    assert (state.refused, state.measured, len(state.waiting)) == ("", False, 1)


def test_a_log_of_arrays_is_learnt_from_and_judged(tmp_path: Path) -> None:
    def of_arrays(name: str, telemetry: Telemetry) -> md.Log:
        arrays = {series.signal: (series.t_s - 5.0, series.values) for series in telemetry}
        return md.Log.from_arrays(name, arrays, motor_order=False)

    logs = [of_arrays(log.name, log.telemetry) for log in healthy(3)]
    baseline = md.learn(logs, FRAME, name="drone\udcff7", created="2026-01-01T00:00:00+00:00")
    baseline.save(tmp_path / "b.json")
    verdict = md.judge(of_arrays("weak", flying(3000, 5, weak_rotor=3, rise=0.2)), tmp_path / "b.json")
    assert (verdict.verdict, baseline.airframe.name) == (md.Verdict.FAULT, r"drone\udcff7")
    assert str(verdict).startswith("weak: fault, rotor_trim 0.1")
    assert (verdict.events[0].rotor, len({log.sha256 for log in logs})) == (3, 3)


@pytest.mark.parametrize(
    ("signals", "says"),
    [
        ({"gyro": ([0.0], [[0.0] * 3])}, "no signal is named 'gyro'; there are attitude_setpoint"),
        ({"body_rate": ([0.0, 0.1], [[0.0] * 3])}, "body_rate: give times .* not .2,., .1, 3."),
        *(({"body_rate": ([t], [[0.0] * 3])}, "body_rate: give times .* not NaN or beyond") for t in (np.nan, 1.7e18)),
        ({"body_rate": ([0.0], [[0.0] * 2])}, "body_rate: it has 3 columns, not 2"),
        *(({"height": it}, "height: give times and values, two arrays") for it in (([0.0], ["low"]), ([0.0],))),
        *(({"height": (np.array([0], x), [0.0])}, "neither dates nor complex ones") for x in ("m8[ms]", "c16")),
        ({"height": (np.ma.masked_equal([0.0], 0.0), [0.0])}, "height: give times .* not NaN"),
    ],
)
def test_arrays_of_no_signal_are_refused(signals: dict[str, tuple[list[float], list[list[float]]]], says: str) -> None:
    with pytest.raises(md.InputError, match=says):
        md.Log.from_arrays("x", signals)


def test_an_argument_of_another_kind_is_refused_in_one_line() -> None:
    api: Any = md
    cases: tuple[tuple[Any, str], ...] = (
        (lambda: api.judge(archive_baseline(), "a.tlog"), "a path is needed here, not Baseline"),
        (lambda: api.scan("a.tlog", archive_baseline(), jobs=0), "jobs must be 1 or more, not 0"),
        (lambda: api.Watch(archive_baseline()).step(LOG), "step takes Telemetry, as `log.telemetry`, not Log"),
        (lambda: api.Watch(archive_baseline(), "none"), "link.profile: the baseline is for '.*', the data are 'none'"),
        (api.Baseline, "airframe: Field required; make the baseline anew"),
        (lambda: api.Airframe(layout="x"), "layout must be a RotorLayout, not 'x'"),
        (lambda: api.open_link("udpin:127.0.0.1:0", vehicle=256), "vehicle must be a system id, 1 to 255, not 256"),
        (lambda: api.identify("u", "y", dt=0.01), "u and y must be arrays of real numbers"),
        (lambda: api.Series(Signal.HEIGHT, RATE.t_s, RATE.t_s, RATE.values), "t_ns and host_ns .n,. of int64"),
    )
    for call, says in cases:
        with pytest.raises(md.MavdiagError, match=says):
            call()


def test_a_series_by_its_name() -> None:
    assert LOG["body_rate"] is LOG[Signal.BODY_RATE] is LOG.telemetry["body_rate"] is RATE
    assert RATE.t_s.tolist() == [1.0, 1.5]
    assert (RATE.unit, OUTPUTS.unit) == ("rad/s", "")
    assert list(LOG.telemetry) == [RATE, OUTPUTS]
    with pytest.raises(InputError, match="no voltage in the data; there is body_rate, actuator"):
        LOG["voltage"]
    with pytest.raises(InputError, match="no signal is named 'gyro'"):
        LOG["gyro"]


def test_r8_the_rate_is_the_mean_rate_and_not_that_of_the_median_step() -> None:
    kept = np.arange(1000) % 4 != 0  # a logger at 250 Hz that drops every fourth sample
    t_ns = (np.arange(1000, dtype=np.int64) * NS_PER_S // 250)[kept]
    found = summary(Series(Signal.BODY_RATE, t_ns, t_ns, np.zeros((len(t_ns), 3))))
    assert found.rate_hz == pytest.approx(187.5, rel=0.01)
    one = summary(Series(Signal.BODY_RATE, t_ns[:1], t_ns[:1], np.zeros((1, 3))))
    assert (one.rate_hz, one.jitter_ms, one.longest_gap_s) == (None, None, None)
