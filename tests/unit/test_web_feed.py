"""The live page's feed: what it is given, what a reader gets, and who may ask."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_session import Story, baseline_for
from made_vehicle import START_NS, Bench, MadeVehicle, record

from detector.config import SessionSettings, Settings, load_settings
from detector.fleet import Vehicle
from detector.replay import Judged, Player, serve
from detector.values import SessionSpec
from detector.web.access import Access, Answer
from detector.web.board import BATCH, FIRST, KEPT, Board, Reader, parse_last
from detector.web.child import ServerProcess, read_token
from detector.web.feed import Feed
from detector.web.snapshot import TRACK_POINTS, Snapshots, Track, about
from mavdiag.as_json import json_line
from mavdiag.decision.diagnosis import Stage
from mavdiag.errors import UsageError
from mavdiag.judging import judge
from mavdiag.link.profiles import PROFILES
from mavdiag.logs import read_log
from mavdiag.telemetry import Instant, Log, Series, Signal, Telemetry
from mavdiag.units import NS_PER_S

SETTINGS = Settings(connect="udpin:127.0.0.1:0", baseline=Path("b.json"))
LOCAL = Access("127.0.0.1", 8080)
BEHIND = Access("0.0.0.0", 8080, names=("BlueOS.local",))
OPEN = Access("0.0.0.0", 8080, "a-token-of-24-characters")
START = Instant(1_000_000_000_000)


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
    vehicles, web = [MadeVehicle(1), MadeVehicle(2)], Feed(cast(ServerProcess, child), Instant(START_NS))
    one = Bench(SETTINGS, baseline_for(), vehicles=vehicles, web=web, journal=tmp_path / "j.jsonl")
    yield one
    one.close()


def test_the_page_gets_the_lines_of_the_journal_numbered(bench: Bench, child: FakeChild) -> None:
    bench.run(12.0)
    bench.vehicles[0].turning = 0.5
    bench.run(5.0)
    assert bench.journal is not None
    written = [json.loads(line) for line in bench.journal.read_text().splitlines()]
    assert (child.of("J"), child.numbers) == (written, list(range(1, len(written) + 1)))
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
    assert (len(track.points), track.points[-1]) == (TRACK_POINTS, (299.9, -1.0))
    assert [point[0] for point in track.points][:2] == [180.9, 181.9]
    track.take(placed(Signal.POSITION, 301.0, math.nan, 1.0))
    assert track.points[-1] == (299.9, -1.0)


def test_a_flight_from_waiting_to_a_fault_and_to_the_ground() -> None:
    baseline, snapshots = baseline_for(names=("fsd", "rotor_trim", "vibration_level", "unbalance")), Snapshots()
    spec = SessionSpec(PROFILES["qdrone2"], baseline, SessionSettings(negotiate=False))
    story, vehicle = Story(spec), Vehicle(1, spec, START)
    vehicle.session = story.session

    def after(seconds: float, **how: Any) -> dict[str, Any]:
        """Fly on; the last snapshot as the page gets it."""
        for _ in range(round(seconds / 0.2)):
            for _ in range(2):
                story.fly(0.1, **how)
                snapshots.pieces.extend(story.session.judge.pieces if story.session.judge is not None else ())
            _, shown = snapshots.next(vehicle, Track(), story.now)
        return dict(json.loads(json_line(shown)))

    first = after(0.6)
    assert (first["level"], first["state"]) == (Stage.NOT_JUDGED, "waiting")
    quiet = after(15.0, outputs=True)
    assert (quiet["level"], quiet["advice"], quiet["rotor"]) == (Stage.QUIET, "", None)
    assert quiet["sentence"].startswith("2 of 4 monitors judge; nearest to its threshold is rotor trim, with")
    assert len(quiet["rises"]) == 4
    names = [one["name"] for one in about(1, "qdrone2", story.session.judge)["slots"]]
    by_name = dict(zip(names, quiet["slots"], strict=True))
    assert by_name["fsd"]["value"] is not None
    assert by_name["rotor_trim"]["value"] is not None
    assert by_name["vibration_level"] == {"value": None, "reason": "no VIBRATION"}
    found = after(4.0, outputs=True, push=0.4)
    assert found["level"] == Stage.SUSPECTED  # beside others, the thesis rule does not decide
    assert found["sentence"].startswith("A propeller fault is suspected, not declared, rotor unknown")
    assert found["advice"].startswith("Look at the propellers before the next flight")
    ground = after(10.0, outputs=True, armed=False)
    assert ground["level"] == Stage.NOT_JUDGED
    assert ground["sentence"].startswith("Nothing is judged at this moment: it reads disarmed while its thrust says")
    told = {(slot["value"], slot["reason"]) for slot in ground["slots"]}
    assert told == {(None, "not armed"), (None, "no VIBRATION")}


def filled(count: int, run: str = "r") -> Board:
    board = Board(run)
    for number in range(1, count + 1):
        board.take(f"J {number} {number}")
    return board


def events(data: bytes) -> list[dict[str, str]]:
    """Server-sent events as a browser reads them (WHATWG HTML, 9.2.6)."""
    return [dict(line.split(": ", 1) for line in block.split("\n")) for block in data.decode().split("\n\n")[:-1]]


def numbers(data: bytes) -> list[int]:
    return [int(one["id"].split("-")[1]) for one in events(data) if one["event"] == "entry"]


def drained(reader: Reader) -> list[int]:
    found: list[int] = []
    while data := reader.next():
        found += numbers(data)
    return found


@given(st.lists(st.tuples(st.integers(0, 1500), st.booleans()), max_size=12))
def test_a_page_that_comes_and_goes_gets_every_entry_once(steps: list[tuple[int, bool]]) -> None:
    board, got, total = Board("r"), list[int](), 0
    reader = board.enter(None, 0)
    for count, leaves in steps:
        for _ in range(count):
            total += 1
            board.take(f"J {total} {{}}")
        got += numbers(reader.next())
        if leaves:
            board.readers.discard(reader)
            reader = board.enter(None, parse_last(f"r-{got[-1] if got else 0}", "r"))
    got += drained(reader)
    assert got == list(range(1, total + 1))


def test_a_replay_that_jumps_begins_anew_for_every_page() -> None:
    board = filled(20)
    reader = board.enter(1, None)
    reader.next()
    for line in ('P {"at_s": 3}', "N 1 old", "C r-1", "A 1 {}", "J 1 {}", "N 1 {}"):
        board.take(line)
    found = events(reader.next())
    assert [one["event"] for one in found] == ["hello", "about", "now", "entry"]
    assert (json.loads(found[0]["data"]), found[-1]["id"]) == ({"run": "r-1", "newest": 0, "fresh": True}, "r-1-1")
    again = [one["event"] for one in events(board.enter(1, parse_last("r-20", board.run)).next())]
    assert again == ["hello", "playing", "about", "now", "entry"]


def test_a_new_page_gets_the_latest_entries_and_one_that_was_away_for_long_all_that_are_kept() -> None:
    board = filled(KEPT + 300)
    assert drained(board.enter(None, None)) == list(range(KEPT + 301 - FIRST, KEPT + 301))
    hello = json.loads(events(board.enter(None, 100).next())[0]["data"])
    assert hello == {"run": "r", "newest": KEPT + 300, "fresh": False}
    assert drained(board.enter(None, 100)) == list(range(301, KEPT + 301))
    assert (len(board.entries), len(numbers(board.enter(None, 0).next()))) == (KEPT, BATCH)


def test_figures_go_to_those_who_look_at_the_vehicle_and_a_slow_page_loses_the_oldest() -> None:
    board = Board("r")
    one, other = board.enter(1, None), board.enter(2, None)
    assert board.watched == (1, 2)
    for reader in (one, other):
        reader.next()
    board.take('A 1 {"drawing":1}')
    for k in range(1000):
        board.take(f"N 1 {k}")
    assert other.next() == b""
    kept = [int(event["data"]) for event in events(one.next()) if event["event"] == "now"]
    assert kept == list(range(1000 - len(kept), 1000))
    assert 100 <= len(kept) <= 300
    late = events(board.enter(1, None).next())
    assert ([event["event"] for event in late[:2]], late[-1]["data"]) == (["hello", "about"], "999")


def judged(access: Access, path: str = "/stream", method: str = "GET", token: str | None = None, **more: str) -> Answer:
    headers = {"host": "127.0.0.1:8080"} | {name.replace("_", "-"): value for name, value in more.items()}
    return access.judge(method, path, headers, headers.pop("cookie", None), token)


@given(st.text(max_size=40).filter(lambda text: text.lower() not in ("127.0.0.1:8080", "localhost:8080", "[::1]:8080")))
def test_every_other_host_is_refused(host: str) -> None:
    if host.lower().strip() != "::1:8080":  # no name: nothing can be rebound to it
        assert judged(LOCAL, host=host) is Answer.REFUSED


@pytest.mark.parametrize(
    ("headers", "path", "answer"),
    [
        ({"origin": "http://127.0.0.1:8080"}, "/stream", Answer.PASS),
        ({"origin": "http://evil.example"}, "/stream", Answer.REFUSED),
        ({"origin": "null"}, "/stream", Answer.REFUSED),
        ({"origin": "https://127.0.0.1:8080"}, "/stream", Answer.REFUSED),
        ({"sec_fetch_site": "same-origin"}, "/stream", Answer.PASS),
        ({"sec_fetch_site": "cross-site"}, "/stream", Answer.REFUSED),
        ({"sec_fetch_site": "same-site"}, "/stream", Answer.REFUSED),
        ({"sec_fetch_site": "cross-site", "sec_fetch_mode": "no-cors"}, "/app.js", Answer.REFUSED),
        ({"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate"}, "/", Answer.PASS),
        ({"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate"}, "/stream", Answer.REFUSED),
    ],
)
def test_another_sites_script_is_refused(headers: Mapping[str, str], path: str, answer: Answer) -> None:
    assert judged(LOCAL, path, **headers) is answer


@pytest.mark.parametrize(
    ("host", "answer"),
    [
        ("blueos.local", Answer.PASS),
        ("BlueOS.local:80", Answer.PASS),
        ("192.168.2.2", Answer.PASS),  # an address cannot be made to point elsewhere
        ("evil.example", Answer.REFUSED),
        ("blueos.local.evil.example", Answer.REFUSED),
        ("localhost", Answer.REFUSED),
    ],
)
def test_behind_a_proxy_its_names_are_known(host: str, answer: Answer) -> None:
    assert judged(BEHIND, host=host) is answer
    for origin in (f"http://{host}", "https://blueos.local", "http://BlueOS.local:8443"):  # a proxy may keep no `Host`
        assert judged(BEHIND, "/acknowledge", "POST", host=host, origin=origin) is answer
    assert judged(BEHIND, "/acknowledge", "POST", host=host, origin="https://192.168.2.2") is Answer.REFUSED
    assert judged(BEHIND, "/acknowledge", "POST", host=host, origin="http://evil.org") is Answer.REFUSED


def test_the_token_is_asked_for_everywhere() -> None:
    assert judged(OPEN, "/") is Answer.NO_TOKEN
    assert judged(OPEN, "/", token="wrong") is Answer.NO_TOKEN
    assert judged(OPEN, "/", token=OPEN.token) is Answer.SIGN_IN
    assert judged(OPEN, "/app.js", cookie=OPEN.cookie_value) is Answer.PASS
    assert judged(OPEN, "/app.js", cookie=OPEN.token or "") is Answer.NO_TOKEN
    assert judged(OPEN, authorization=f"bearer {OPEN.token}") is Answer.PASS
    assert judged(OPEN, authorization=f"Basic {OPEN.token}") is Answer.NO_TOKEN
    assert judged(OPEN, "/", token="ü" * 24) is Answer.NO_TOKEN
    assert (OPEN.token or "") not in repr(OPEN) + OPEN.cookie_value


@pytest.mark.parametrize("web", ["0.0.0.0:8080", "192.168.1.7:8080", "drone.local:8080", "[::]:8080"])
def test_elsewhere_than_on_loopback_a_token_is_needed(web: str) -> None:
    with pytest.raises(UsageError, match=r"name a --web-token-file FILE, or 127\.0\.0\.1$"):
        load_settings(None, {"learn": 9.0, "save": "b.json", "web": web})
    assert load_settings(None, {"learn": 9.0, "save": "b.json", "web": web, "web_token_file": "t"}).web == web


@given(st.text(st.characters(codec=None), max_size=20), st.sampled_from(["authorization", "cookie", "host", "token"]))
def test_no_header_leaves_the_rules_by_an_exception(text: str, where: str) -> None:
    for value in (text, f"Bearer {text}", "\udcff", f"127.0.0.1:{'8' * 5000}"):
        headers = {"host": "127.0.0.1:8080", where: value}
        given = value if where == "token" else None
        assert OPEN.judge("GET", "/", headers, headers.pop("cookie", None), given) in (Answer.NO_TOKEN, Answer.REFUSED)


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        ("short\n", 0o600, "16 or more ASCII characters"),
        ("long enough but with blanks\n", 0o600, "without blanks"),
        ("0123456789abcdef\n", 0o644, "others may read the web token; run `chmod 600"),
    ],
)
def test_a_token_file_keeps_the_rules_of_a_key_file(tmp_path: Path, content: str, mode: int, words: str) -> None:
    (path := tmp_path / "token").write_text(content)
    path.chmod(mode)
    with pytest.raises(UsageError) as error:
        read_token(path)
    assert words in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    with pytest.raises(UsageError, match="malformed web address"):  # before the log is read
        serve(tmp_path / "absent.tlog", tmp_path / "absent.json", "x")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("replay") / "flight.tlog"
    record(path, ((30.0, 0.0), (10.0, 0.5), (20.0, 0.0)))
    return read_log(path)


def scanned(log: Log, most_s: float = 1e9) -> Judged:
    found = Judged(log, baseline_for(), 1)
    while not found.done and (not found.moments or found.moments[-1].t_ns - found.begin_ns < most_s * 1e9):
        found.go_on()
    return found


def player(child: FakeChild, found: Judged, speed: float = 1.0, at_s: float = 0.0) -> Player:
    return Player(cast(ServerProcess, child), found, speed, at_s)


def test_a_log_is_judged_as_a_scan_judges_it_and_said_as_the_detector_says_it(log: Log) -> None:
    entries = [json.loads(entry) for moment in scanned(log).moments for entry in moment.entries]
    stages = [(one["stage"], one["t_s"]) for one in entries if one["kind"] == "stage"]
    changes = [(change.stage, change.t_ns / 1e9) for change in judge(log, baseline_for()).changes]
    assert stages[: len(changes)] == [(stage, pytest.approx(t_s, abs=1e-6)) for stage, t_s in changes]
    assert ("fault", pytest.approx(35.3, abs=1.0)) in stages  # its stamps begin at 5 s
    assert any(one["text"].startswith("PROP FAULT") for one in entries if one["kind"] == "text")
    assert entries[0]["utc"].startswith("2026-05-01T")


def test_a_log_that_lacks_an_axis_of_the_accelerometer_is_judged(log: Log) -> None:
    series = (
        replace(one, values=one.values * (float("nan"), 1.0, 1.0)) if one.signal is Signal.SPECIFIC_FORCE else one
        for one in log.telemetry
    )
    moments = scanned(replace(log, telemetry=Telemetry(tuple(series)))).moments
    assert Stage.FAULT in {moment.level for moment in moments}


def test_it_plays_at_its_speed_and_begins_when_somebody_looks(log: Log, child: FakeChild) -> None:
    one, now = player(child, scanned(log), speed=10.0), START
    for _ in range(20):
        now += 0.1
        one.look(now)
    assert one.at_s == 0.0
    assert [line["vehicles"][0]["vehicle"] for line in child.of("F")] == [1]  # for a page to choose
    child.says = ["watch 1"]
    for _ in range(10):
        now += 0.1
        one.look(now)
    assert one.at_s == pytest.approx(10.0)
    assert len(child.of("N")) == pytest.approx(50, abs=2)  # of a flight of 10 s, none is left out
    assert child.of("P")[-1]["speed"] == 10.0
    child.says = ["play speed 0.0"]
    one.look(now + 5.0)
    one.look(now + 9.0)
    assert one.at_s == pytest.approx(10.0)


def test_a_jump_begins_anew_with_what_was_until_then(log: Log, child: FakeChild) -> None:
    one, now = player(child, scanned(log), at_s=50.0), START
    one.look(now)
    assert any("FAULT" in entry.get("text", "") for entry in child.of("J"))
    child.lines, child.says = [], ["play at 3.0", "play at 25.0"]
    one.look(now + 0.1)
    assert child.lines[0].startswith("C ")
    assert child.numbers == list(range(1, len(child.numbers) + 1))
    assert all(entry["vehicle_s"] <= 30.1 for entry in child.of("J"))
    (now_told,) = child.of("N")
    bins = [number for strip in now_told["strips"] if strip["axis"] == "roll" for number in strip["bins"]]
    assert bins == sorted(bins)
    assert bins[-1] - bins[0] == pytest.approx(20 / 0.05, abs=8)  # 20 s
    assert len(child.of("A")) == 1
    track = now_told["track"]  # of a circle of 5 m
    assert len(track) == pytest.approx(2 * 26, abs=2)
    radii = [math.hypot(north, east - 5) for north, east in zip(track[::2], track[1::2], strict=True)]
    assert radii == pytest.approx([5.0] * len(radii), abs=0.02)
    assert child.of("F")[-1]["vehicles"][0]["level"] == Stage.QUIET
    assert [level for _, level in child.of("P")[-1]["spans"]][1:3] == [Stage.QUIET, Stage.FAULT]


def test_a_jump_to_what_is_not_judged_yet_waits_for_it(log: Log, child: FakeChild) -> None:
    found = scanned(log, 10.0)
    one = player(child, found)
    one.look(START)
    child.says = ["play at 40.0"]
    one.look(START + 0.3)
    assert (one.at_s, child.of("P")[-1]["wanted_s"]) == (0.0, 40.0)
    while not found.done:
        found.go_on()
    one.look(START + 0.6)
    assert one.at_s == pytest.approx(40.0)
    assert child.of("P")[-1]["wanted_s"] is None
