"""Faults that the daemon survives: nothing is corrupted, and what it did before it does again."""

import errno
import json
import os
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import NoReturn

import pytest
from made_session import baseline_for
from made_vehicle import RATE_HZ, TICK_S, Bench, FakeFitter, MadeVehicle, VirtualHost, received

from detector.config import Settings
from detector.states import State
from mavdiag.link.messages import MessageId, Severity

UDP_IN = "udpin:127.0.0.1:0"
WATCH = Settings(connect=UDP_IN, baseline=Path("b.json"))


@pytest.fixture
def watching() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(host: VirtualHost | None = None) -> Bench:
        bench = Bench(WATCH, vehicles=[MadeVehicle(1)], baseline=baseline_for(), host=host or VirtualHost())
        made.append(bench)
        bench.run(6.0)
        assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
        return bench

    yield make
    for bench in made:
        bench.close()


def unheard(bench: Bench, seconds: float) -> None:
    """The vehicle flies on, and nothing of it arrives."""
    for _ in range(round(seconds / TICK_S)):
        bench.vehicles[0].samples(round(TICK_S * RATE_HZ))
        bench.host.sleep(TICK_S)
        bench.daemon.tick()


def alarms(bench: Bench) -> list[str]:
    """The texts of declared faults since the last time."""
    texts = [frame for frame in received(bench.far) if frame.msgid == MessageId.STATUSTEXT]
    return [one.text("text") for one in texts if one.numbers("severity") <= (Severity.CRITICAL,)]


def finds_a_fault(bench: Bench) -> bool:
    """Whether it judges again: quiet so far, and an alarm within 3 s of a fault."""
    quiet = not alarms(bench)
    bench.vehicles[0].turning = 0.5
    bench.run(3.0)
    return quiet and bool(alarms(bench))


def test_a_vehicle_that_reboots_is_watched_again(watching: Callable[..., Bench]) -> None:
    bench = watching()
    unheard(bench, 4.0)
    bench.vehicles[0].sent = 0
    bench.run(8.0)
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == 1
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
    assert finds_a_fault(bench)


@pytest.mark.parametrize("cut_s", [1.0, 60.0])
def test_a_link_that_was_cut_is_judged_again(watching: Callable[..., Bench], cut_s: float) -> None:
    bench = watching()
    unheard(bench, cut_s)
    assert (bench.daemon.fleet.vehicles[1].session.state is State.LOST) == (cut_s > 3.0)
    bench.run(6.0)
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == 0
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
    assert finds_a_fault(bench)


def test_an_error_of_the_program_takes_one_vehicle_off_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = tmp_path / "j.jsonl"
    bench = Bench(WATCH, vehicles=[MadeVehicle(1), MadeVehicle(2)], baseline=baseline_for(), journal=journal)
    bench.run(6.0)

    def fails(*_: object) -> NoReturn:
        raise KeyError("a bug")

    monkeypatch.setattr(bench.daemon.fleet.link.vehicles[2], "step", fails)
    bench.run(3.0)
    states = {one.vehicle: one.state for one in bench.daemon.fleet.figures()}
    assert states == {1: State.MONITORING, 2: State.FAULTED}
    texts = [frame.text("text") for frame in received(bench.far) if frame.msgid == MessageId.STATUSTEXT]
    assert [text for text in texts if "OFF" in text] == ["PROP OFF: KeyError: internal error"]
    assert finds_a_fault(bench)
    bench.close()
    lines = [json.loads(one) for one in journal.read_text().splitlines()]
    assert [one for one in lines if one["vehicle"] == 2 and "KeyError('a bug')" in one.get("text", "")]
    assert lines[-1]["kind"] == "stop"


class SteppedHost(VirtualHost):
    """A machine whose wall clock is set by hand; the monotonic clock goes on."""

    ahead = timedelta(0)

    def utc(self) -> datetime:
        return super().utc() + self.ahead


@pytest.mark.parametrize("days", [-400, 400])
def test_a_step_of_the_wall_clock_changes_nothing(watching: Callable[..., Bench], days: int) -> None:
    host = SteppedHost()
    bench = watching(host)
    (before,) = bench.daemon.fleet.figures()
    host.ahead = timedelta(days=days)
    bench.run(5.0)
    (after,) = bench.daemon.fleet.figures()
    assert after.judged_s == pytest.approx(before.judged_s + 5.0, abs=0.1)
    assert bench.daemon.fleet.link.vehicles[1].state.timeline.reboots == 0
    assert finds_a_fault(bench)


def test_a_baseline_that_finds_the_disk_full_leaves_the_old_one_and_watching_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "b.json"
    baseline_for(rate_hz=200).save(path)
    before = path.read_bytes()

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    settings = Settings(connect=UDP_IN, learn=5.0, save=path)
    bench = Bench(settings, vehicles=[MadeVehicle(1)], fitter=FakeFitter(baseline_for()))
    bench.run(12.0)
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["b.json"]
    assert any("baseline is not saved" in line and "No space left" in line for line in bench.host.lines)
    assert bench.daemon.fleet.vehicles[1].session.state is State.MONITORING
    assert finds_a_fault(bench)
    bench.close()
