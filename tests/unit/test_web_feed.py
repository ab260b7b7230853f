"""What the live page is told on a virtual clock: entries always, figures while somebody looks."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from made_session import Story, baseline_for
from made_vehicle import START_NS, Bench, MadeVehicle

from detector.config import SessionSettings, Settings
from detector.values import SessionSpec, VehicleFigures
from detector.web.child import ServerProcess
from detector.web.feed import Feed
from detector.web.snapshot import TRACK_POINTS, Json, Level, Snapshots, Track, about
from mavdiag.as_json import json_line
from mavdiag.kernel import Piece
from mavdiag.link.profiles import PROFILES
from mavdiag.telemetry import Instant, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

SETTINGS = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))


@dataclass
class FakeChild:
    """Keeps the lines that it is given; says what a test wants it to."""

    where: str = "http://127.0.0.1:1/"
    lines: list[str] = field(default_factory=list)
    says: list[str] = field(default_factory=list)
    fresh: bool = True
    room: bool = True
    closed: bool = False

    def look(self, now: Instant) -> tuple[bool, list[str]]:
        fresh, self.fresh = self.fresh, False
        said, self.says = self.says, []
        return fresh, said

    def put(self, data: bytes) -> bool:
        if self.room:
            self.lines += data.decode().splitlines()
        return self.room

    def close(self) -> None:
        self.closed = True

    def of(self, kind: str) -> list[Any]:
        """The contents of the lines of a kind."""
        rest = 1 if kind in "FP" else 2
        return [json.loads(line.split(" ", rest)[rest]) for line in self.lines if line.startswith(f"{kind} ")]

    @property
    def numbers(self) -> list[int]:
        return [int(line.split(" ")[1]) for line in self.lines if line.startswith("J ")]


@pytest.fixture
def child() -> FakeChild:
    return FakeChild()


@pytest.fixture
def bench(child: FakeChild, tmp_path: Path) -> Iterator[Bench]:
    web = Feed(cast(ServerProcess, child), Instant(START_NS))
    one = Bench(
        SETTINGS, baseline_for(), vehicles=[MadeVehicle(1), MadeVehicle(2)], web=web, journal=tmp_path / "j.jsonl"
    )
    yield one
    one.close()


def test_the_page_gets_the_lines_of_the_journal_numbered(bench: Bench, child: FakeChild) -> None:
    bench.run(12.0)
    bench.vehicles[0].turning = 0.5
    bench.run(5.0)
    assert bench.journal is not None
    written = [json.loads(line) for line in bench.journal.read_text().splitlines()]
    assert child.of("J") == written
    assert child.numbers == list(range(1, len(written) + 1))
    assert any(one["kind"] == "text" and "FAULT" in one["text"] for one in written)


def test_figures_come_only_while_somebody_looks(bench: Bench, child: FakeChild) -> None:
    bench.run(8.0)
    assert child.of("N") == []
    assert len(child.of("F")) == pytest.approx(8, abs=1)
    child.says = ["watch 2"]
    bench.run(8.0)
    assert {one["vehicle"] for one in child.of("N")} == {2}
    assert len(child.of("N")) == pytest.approx(40, abs=2)
    assert [one["vehicle"] for one in child.of("A")] == [2]
    child.says = ["watch"]
    bench.run(1.0)
    count = len(child.of("N"))
    bench.run(4.0)
    assert len(child.of("N")) == count


def test_a_child_without_room_loses_figures_and_no_entry(bench: Bench, child: FakeChild) -> None:
    child.says = ["watch 1"]
    bench.run(6.0)
    child.room = False
    bench.vehicles[0].turning = 0.5
    bench.run(8.0)
    child.room = True
    bench.run(1.0)
    assert child.numbers == list(range(1, child.numbers[-1] + 1))
    assert any("FAULT" in str(one.get("text")) for one in child.of("J"))


def placed(signal: Signal, second: float, *place: float) -> Telemetry:
    t_ns = np.array([round(second * NS_PER_S)])
    return Telemetry((Series(signal, t_ns, t_ns, np.array([place])),))


def test_a_track_has_a_point_a_second_of_the_signal_that_came_first() -> None:
    track = Track()
    for tenth in range(3000):
        track.take(placed(Signal.POSITION, 0.1 * tenth + 0.01, 0.1 * tenth, -1.0))
        track.take(placed(Signal.COORDINATES, 0.1 * tenth + 0.02, 0.8, 0.1))
        track.take(Telemetry())
    assert len(track.points) == TRACK_POINTS
    assert track.points[-1] == (299.9, -1.0)
    assert [point[0] for point in track.points][:2] == [180.9, 181.9]
    track.take(placed(Signal.POSITION, 301.0, math.nan, 1.0))
    assert track.points[-1] == (299.9, -1.0)


@dataclass
class Watched:
    """A made flight, and what the page shows of it."""

    story: Story
    snapshots: Snapshots = field(default_factory=Snapshots)

    def after(self, seconds: float, **how: Any) -> dict[str, Any]:
        """Fly on, and return the last snapshot as the page gets it."""
        shown = ""
        for _ in range(round(seconds / 0.2)):
            pieces = list[Piece]()
            for _ in range(2):
                self.story.fly(0.1, **how)
                judge = self.story.session.judge
                pieces += judge.pieces if judge is not None else ()
            shown = json_line(self.shown(*pieces))
        found: dict[str, Any] = json.loads(shown)
        return found

    def shown(self, *pieces: Piece) -> Json:
        session = self.story.session
        figures = VehicleFigures(1, session.state, 10, 0, 1.0, 0)
        return self.snapshots.next(figures, session, pieces, Track(), self.story.now)


@pytest.fixture
def watched() -> Watched:
    baseline = baseline_for(names=("fsd", "rotor_trim", "vibration_level", "unbalance"))
    settings = SessionSettings(negotiate=False)
    return Watched(Story(SessionSpec(PROFILES["qdrone2"], baseline, settings)))


def test_a_flight_from_waiting_to_a_fault_and_to_the_ground(watched: Watched) -> None:
    first = watched.after(0.6)
    assert (first["level"], first["state"]) == (Level.NOT_JUDGED, "waiting")
    quiet = watched.after(15.0, outputs=True)
    assert (quiet["level"], quiet["advice"], quiet["rotor"]) == (Level.QUIET, "", None)
    assert quiet["sentence"].startswith("2 of 4 monitors judge; nearest to its threshold is rotor trim, with")
    assert len(quiet["rises"]) == 4
    by_name = dict(zip([one["name"] for one in slots_of(watched)], quiet["slots"], strict=True))
    assert by_name["fsd"]["value"] is not None
    assert by_name["rotor_trim"]["value"] is not None
    assert by_name["vibration_level"] == {"value": None, "reason": "no VIBRATION"}
    found = watched.after(4.0, outputs=True, push=0.4)
    assert found["level"] == Level.SUSPECTED  # beside others, the thesis rule does not decide
    assert found["sentence"].startswith(
        "A propeller fault is suspected, not declared, rotor unknown: how long the body"
    )
    assert found["advice"].startswith("Look at the propellers before the next flight")
    ground = watched.after(10.0, outputs=True, armed=False)
    assert ground["level"] == Level.NOT_JUDGED
    assert ground["sentence"].startswith("Nothing is judged at this moment: it reads disarmed while its thrust says")
    assert {slot["reason"] for slot in ground["slots"]} == {"not armed", "no VIBRATION"}
    assert all(slot["value"] is None for slot in ground["slots"])


def slots_of(watched: Watched) -> list[Json]:
    slots: list[Json] = about(1, "qdrone2", watched.story.session.judge)["slots"]
    return slots


# --- The strips: the same points however the flight is cut, and no peak is lost
